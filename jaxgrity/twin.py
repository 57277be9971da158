"""The other contact model of a scene: what holds on both is not an artefact of one."""

import equinox as eqx
import numpy as np

from jaxgrity.friction import ConeFriction, SmoothFriction, SwitchFriction
from jaxgrity.ground import Ground
from jaxgrity.scene import Scene
from jaxgrity.structure import InputError, Members, edge_lengths

SINKS = 2e-3
"""of the body's length, by which three nodes that carry the weight sink into penalty ground"""
RELAXES = 1.8e-3
"""s, c/K of spring struts"""
DISSIPATES = 2.0
"""s/m, alpha of Hunt and Crossley's law"""
CREEPS = 0.01
"""m/s, slip speed of smooth friction"""


def exact_twin(scene: Scene) -> Scene:
    """The scene with rigid struts of the same rest lengths, exact contact without rebound, and Coulomb's cone.

    It is the limit of stiff struts and a stiff ground that give nothing back, and of a slip speed of zero; the Coulomb
    switch keeps its kinetic friction.
    """
    struts, ground, friction = scene.structure.struts, scene.ground, scene.friction
    if struts is not None and not struts.rigid:
        rigid = Members(struts.edges, None, struts.rest_length, stuck=struts.stuck)
        scene = eqx.tree_at(lambda s: s.structure.struts, scene, rigid)
    if ground is None or ground.exact:
        return scene
    cone = None
    if friction is not None:
        assert not isinstance(friction, ConeFriction), "a cone goes with exact contact"
        cone = ConeFriction(friction.mu_kinetic if isinstance(friction, SwitchFriction) else friction.mu)
    return eqx.tree_at(
        lambda s: (s.ground, s.friction), scene, (Ground(None, incline=ground.incline), cone), is_leaf=_absent
    )


def penalty_twin(scene: Scene) -> Scene:
    """The scene with spring struts, penalty contact and smooth friction.

    The ground is as stiff as lets three nodes that carry the weight sink by `SINKS`, a strut twice as stiff; they
    dissipate as on scenes/reference.toml, whose numbers follow from those of scenes/exact.toml by this rule. Raises
    `InputError` where no weight says how stiff a ground should be.
    """
    struts, ground, friction = scene.structure.struts, scene.ground, scene.friction
    if scene.gravity is None:
        raise InputError("gravity: not modelled; expected it, since the weight says how stiff a ground should be")
    members = struts or scene.structure.cables
    if members is None:
        raise InputError("the structure has no members; expected some, whose length says how deep it may sink")
    size = float(edge_lengths(scene.structure.nodes, members.edges).max())
    stiffness = float(scene.structure.mass) * float(scene.gravity) / (3 * SINKS * size)
    if struts is not None and struts.rigid:
        each = np.full(len(struts.edges), 2 * stiffness)
        springs = Members(struts.edges, each, struts.rest_length, RELAXES * each, stuck=struts.stuck)
        scene = eqx.tree_at(lambda s: s.structure.struts, scene, springs)
    if ground is None or not ground.exact:
        return scene
    smooth = SmoothFriction(friction.mu, CREEPS) if isinstance(friction, ConeFriction) else None
    soft = Ground(stiffness, DISSIPATES, ground.incline)
    return eqx.tree_at(lambda s: (s.ground, s.friction), scene, (soft, smooth), is_leaf=_absent)


def twin(scene: Scene) -> Scene:
    """The scene's other contact model."""
    return penalty_twin(scene) if scene.constrained else exact_twin(scene)


def _absent(x: object) -> bool:
    return x is None

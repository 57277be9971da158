"""The contact twin of a scene: the same robot on the other contact model. What holds on both is no artefact of one."""

import dataclasses

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.model.friction import ConeFriction, SmoothFriction
from jaxgrity.model.ground import ExactGround, PenaltyGround
from jaxgrity.model.rigid_struts import LARGEST_GAP
from jaxgrity.model.scales import length_scale, speed_scale, time_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure, edge_lengths

DEPTH = 2e-3
"""Depth to which three nodes that carry the weight sink into penalty ground, as a share of the body's length."""
RELAXATION = 1.8e-3
"""Ratio c/K of the springs that replace rigid struts, s for a body of one metre."""
DISSIPATION = 2.0
"""Coefficient alpha of Hunt and Crossley's law, s/m for a body of one metre."""
SLIP_SPEED = 0.01
"""Slip speed eps of smooth friction, m/s for a body of one metre."""


@typed
def exact_twin(scene: Scene) -> Scene:
    """The scene with rigid struts, exact contact without rebound, and Coulomb's cone, in a pose that it can start from.

    It is the limit of stiff struts and a stiff ground that give nothing back, and of a slip speed of zero; the Coulomb
    switch keeps its kinetic friction. Where struts start strained, the rigid ones have the lengths of the start: those
    are what the springs have under load. A start below the ground is lifted until it touches.

    Raises `InputError` where struts are in motion at t = 0, since each gait then needs a start of its own.
    """
    _check_starts_still(scene)
    structure, struts = scene.structure, scene.structure.struts
    nodes, ground, friction, size = structure.nodes, scene.ground, scene.friction, float(length_scale(scene))
    if struts is not None and not struts.rigid:
        rest = _built_lengths(struts, nodes, size)
        structure = _with_struts(structure, dataclasses.replace(struts, stiffness=None, damping=None, rest_length=rest))
    if ground is not None and not ground.impulsive:
        lowest = -float(ground.measured(np.asarray(nodes, float)).distance.min())
        if lowest > LARGEST_GAP * size:
            structure = dataclasses.replace(structure, nodes=ground.set_down(np.asarray(nodes, float), 0.0, size))
        cone = None if friction is None else ConeFriction(friction.sliding_mu)
        surface, offset, balls = ground.surface, ground.offset, ground.balls
        ground, friction = ExactGround(ground.incline, surface=surface, offset=offset, balls=balls), cone
    return dataclasses.replace(scene, structure=structure, ground=ground, friction=friction)


@typed
def penalty_twin(scene: Scene) -> Scene:
    """The scene with spring struts, penalty contact and smooth friction.

    The ground is as stiff as lets three nodes that carry the weight sink by `DEPTH`, a strut twice as stiff; they
    dissipate as in the scene "reference", whose numbers follow from those of the scene "exact" by this rule.

    Raises `InputError` where no weight says how stiff a ground should be.
    """
    struts, ground, friction = scene.structure.struts, scene.ground, scene.friction
    if scene.gravity is None:
        raise InputError("gravity: not modelled; expected it, since the weight says how stiff a ground should be")
    members = struts or scene.structure.cables
    if members is None:
        raise InputError("the structure has no members; expected some, whose length says how deep it may sink")
    size = float(edge_lengths(scene.structure.nodes, members.edges).max())
    stiffness, structure = float(scene.structure.mass) * float(scene.gravity) / (3 * DEPTH * size), scene.structure
    speed = float(speed_scale(scene))
    if struts is not None and struts.rigid:
        each = np.full(len(struts.edges), 2 * stiffness)
        springs = dataclasses.replace(struts, stiffness=each, damping=RELAXATION * float(time_scale(scene)) * each)
        structure = _with_struts(structure, springs)
    if ground is not None and ground.impulsive:
        friction = None if friction is None else SmoothFriction(friction.sliding_mu, SLIP_SPEED * speed)
        alpha, incline, surface = DISSIPATION / speed, ground.incline, ground.surface
        offset, balls = ground.offset, ground.balls
        ground = PenaltyGround(stiffness, alpha, incline, surface=surface, offset=offset, balls=balls)
    return dataclasses.replace(scene, structure=structure, ground=ground, friction=friction)


@typed
def contact_twin(scene: Scene) -> Scene:
    """The scene on the other contact model. Raises as `exact_twin` and `penalty_twin` do."""
    return penalty_twin(scene) if scene.constrained else exact_twin(scene)


def _check_starts_still(scene: Scene) -> None:
    gait, struts = scene.gait, scene.structure.struts
    if gait is not None and struts is not None and any(k < len(struts.edges) for k in gait.members) and gait.start < 0:
        raise InputError(
            f"gait.start = {float(gait.start):g}: struts are in motion at t = 0, and rigid ones cannot start from the "
            "same pose in every gait; expected 0 or later"
        )


def _built_lengths(struts: Members, nodes, size: float) -> np.ndarray:
    """The struts' rest lengths, m, but the lengths at the start where those differ from them."""
    built, rest = edge_lengths(nodes, struts.edges), struts.rest_length
    return np.where(np.abs(built - rest) > LARGEST_GAP * size, built, rest)


def _with_struts(structure: Structure, struts: Members) -> Structure:
    return dataclasses.replace(structure, struts=struts)

"""The contact twin of a scene: the same robot on the other contact model."""

import dataclasses

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.model.friction import ConeFriction, SmoothFriction
from jaxgrity.model.ground import ExactGround, PenaltyGround
from jaxgrity.model.rigid_struts import LARGEST_GAP
from jaxgrity.model.rigidity import lines_between_points
from jaxgrity.model.rod_contact import ALONG_STRUTS, lifted, radii_along_struts, with_contact_along_struts
from jaxgrity.model.scales import length_scale, speed_scale, time_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, edge_lengths
from jaxgrity.model.strut_contact import touching_like, without_strut_contact

DEPTH = 2e-3
"""Depth to which three nodes that carry the weight sink into penalty ground, as a fraction of the body length."""
RELAXATION = 1.8e-3
"""Ratio c/K of the springs that replace rigid struts, s for a body of one metre."""
DISSIPATION = 2.0
"""Coefficient alpha of Hunt and Crossley's law, s/m for a body of one metre."""
POINTS = 5
"""Number of points of penalty contact along a strut that touches exact ground between its ends."""
SLIP_SPEED = 0.01
"""Slip speed eps of smooth friction, m/s for a body of one metre."""


@typed
def exact_twin(scene: Scene) -> Scene:
    """The scene with rigid struts, exact contact without restitution, and Coulomb's cone.

    It is the limit of stiff struts, a stiff ground without rebound, and a slip speed of zero. The Coulomb switch keeps
    its kinetic friction. If struts start strained, the rigid struts have their lengths at the start. A start below the
    ground is lifted until it touches. Struts that touch between their ends do so at one point each.

    Raises `InputError` if struts move at t = 0, since each gait then needs its own start. Raises it also for supports
    that would have to be lifted.
    """
    _check_starts_still(scene)
    structure, struts = scene.structure, scene.structure.struts
    nodes, ground, friction, size = structure.nodes, scene.ground, scene.friction, float(length_scale(scene))
    if struts is not None and not struts.rigid:
        rest = _built_lengths(struts, nodes, size)
        rigid = dataclasses.replace(struts, stiffness=None, damping=None, rest_length=rest)
        structure = dataclasses.replace(structure, struts=rigid)
    if ground is not None and not ground.impulsive:
        lowest = -float(ground.measured(np.asarray(nodes, float)).distance.min())
        if lowest > LARGEST_GAP * size:
            structure = dataclasses.replace(structure, nodes=ground.set_down(np.asarray(nodes, float), 0.0, size))
        cone = None if friction is None else ConeFriction(friction.sliding_mu)
        surface, offset, balls = ground.surface, ground.offset, ground.balls
        ground, friction = ExactGround(ground.incline, surface=surface, offset=offset, balls=balls), cone
    terms = tuple(law for law in without_strut_contact(scene).terms if not isinstance(law, ALONG_STRUTS))
    twin = dataclasses.replace(scene, structure=structure, ground=ground, friction=friction, terms=terms)
    twin = _touching_along_struts(twin, radii_along_struts(scene), 1)
    nodes = lifted(twin, structure.nodes, LARGEST_GAP * size)
    _check_supports_stay(scene, np.asarray(nodes, float))
    twin = dataclasses.replace(twin, structure=dataclasses.replace(structure, nodes=nodes))
    return touching_like(twin, scene)


@typed
def penalty_twin(scene: Scene) -> Scene:
    """The scene with spring struts, penalty contact and smooth friction.

    Three nodes that carry the weight sink into the ground by `DEPTH`, which gives the stiffness. A strut is twice as
    stiff. Damping follows the scene "reference", which is the penalty twin of the scene "exact".

    Raises `InputError` without gravity, and without members and bodies, since the stiffness follows from them.
    """
    struts, ground, friction = scene.structure.struts, scene.ground, scene.friction
    if scene.gravity is None:
        raise InputError(
            "gravity: not modelled; expected [gravity], since the ground's stiffness follows from the weight"
        )
    members = struts or scene.structure.cables
    lines = lines_between_points(scene.structure.bodies) if members is None else members.edges
    if not lines:
        found = "the structure has no members, and no bodies"
        raise InputError(f"{found}; expected some, since the ground's stiffness follows from their length")
    size = float(edge_lengths(scene.structure.nodes, lines).max())
    stiffness, structure = float(scene.structure.mass) * float(scene.gravity) / (3 * DEPTH * size), scene.structure
    speed = float(speed_scale(scene))
    if struts is not None and struts.rigid:
        each = np.full(len(struts.edges), 2 * stiffness)
        springs = dataclasses.replace(struts, stiffness=each, damping=RELAXATION * float(time_scale(scene)) * each)
        structure = dataclasses.replace(structure, struts=springs)
    if ground is not None and ground.impulsive:
        friction = None if friction is None else SmoothFriction(friction.sliding_mu, SLIP_SPEED * speed)
        alpha, incline, surface = DISSIPATION / speed, ground.incline, ground.surface
        offset, balls = ground.offset, ground.balls
        ground = PenaltyGround(stiffness, alpha, incline, surface=surface, offset=offset, balls=balls)
    twin = dataclasses.replace(without_strut_contact(scene), structure=structure, ground=ground, friction=friction)
    return touching_like(_touching_along_struts(twin, radii_along_struts(scene), POINTS), scene)


@typed
def contact_twin(scene: Scene) -> Scene:
    """The same robot on the other contact model. If a result holds on both, it does not come from one model alone.

    Raises `InputError` as `exact_twin` and `penalty_twin` do.
    """
    return penalty_twin(scene) if is_exact(scene) else exact_twin(scene)


def is_exact(scene: Scene) -> bool:
    """Whether its contact model is the exact one: rigid struts or exact contact. Rigid bodies are in both models."""
    struts, ground = scene.structure.struts, scene.ground
    return (struts is not None and struts.rigid) or (ground is not None and ground.impulsive)


def _check_starts_still(scene: Scene) -> None:
    gait, struts = scene.gait, scene.structure.struts
    if gait is not None and struts is not None and any(k < len(struts.edges) for k in gait.members) and gait.start < 0:
        raise InputError(
            f"gait.start = {float(gait.start):g}: struts move at t = 0, so rigid struts cannot start from the "
            "same pose in every gait; expected 0 or later"
        )


def _check_supports_stay(scene: Scene, nodes: np.ndarray) -> None:
    up = nodes - np.asarray(scene.structure.nodes, float)
    if np.any(up[scene.structure.supported]):
        found = f"structure.fixed: the start is {np.linalg.norm(up[0]):.3g} m in the ground"
        raise InputError(f"{found}, and supports cannot be lifted; expected a start that is not below it")


def _touching_along_struts(scene: Scene, radii: dict[int, float], count: int) -> Scene:
    """The scene in which these struts touch the ground between their ends; itself if they do already."""
    if not radii or radii_along_struts(scene):
        return scene
    return with_contact_along_struts(scene, count, tuple(radii), list(radii.values()))


def _built_lengths(struts: Members, nodes, size: float) -> np.ndarray:
    """Rest lengths of the struts, m; for struts that start strained, their lengths at the start."""
    built, rest = edge_lengths(nodes, struts.edges), struts.rest_length
    return np.where(np.abs(built - rest) > LARGEST_GAP * size, built, rest)

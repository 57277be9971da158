"""What of a MuJoCo model touches its plane: radii, friction and places, as MuJoCo itself combines them."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import lazy_loader
import numpy as np
from scipy.optimize import nnls

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import Losses, cone_of
from jaxgrity.formats.mjcf_losses import (
    SMALL,
    check_spring,
    largest_first,
    lose_beside_sites,
    lose_rims,
    name_of,
    restitution_of,
)
from jaxgrity.model.friction import ConeFriction
from jaxgrity.model.ground import ExactGround

mujoco: Any = lazy_loader.load("mujoco")

SAME_PLACE = 1e-4
"""Largest difference of places, and of radii, that count as the same, as a share of the robot's size."""
PYRAMID = (
    "friction there is a pyramid (option cone): between the two tangents it is up to 29 % weaker; here it is a cone, "
    "alike in all directions"
)
"""Note on the pyramidal cone, MuJoCo's default: along a tangent the friction is mu, half-way between two mu/sqrt(2)."""
LEAST_FRICTION = 1.01e-5
"""Friction written in place of none: MuJoCo accepts no smaller value."""


class Touching(NamedTuple):
    """A ball of a body that touches the plane: a sphere, an end of a capsule, or a corner of a box."""

    geom: int
    body: int
    centre: np.ndarray
    """m"""
    radius: float
    """m, with MuJoCo's margin"""
    mu: float


class GroundFound(NamedTuple):
    """What of the model is ground; nothing where nothing touches a plane."""

    ground: ExactGround | None
    friction: ConeFriction | None
    lift: np.ndarray
    """(3,), m: shift of the nodes, which then touch a plane through the origin as their balls touched the model's"""
    more: np.ndarray = np.zeros((0, 3))
    """(k, 3), m: further nodes, at the centres of balls of rigid bodies, or so that these are not flat"""
    carrier: np.ndarray = np.zeros(0, int)
    """(k,), their bodies"""
    normal: np.ndarray = np.array([0.0, 0.0, 1.0])
    """(3,), unit vector, of the plane; the ground is level until it is turned"""
    along: Mapping[int, float] = MappingProxyType({})
    """radius, m, with MuJoCo's margin, of each geom that may touch the ground along its length"""
    turning: Mapping[int, int] = MappingProxyType({})
    """bodies of the balls at nodes"""


def touched_plane(model: Any, data: Any, x: np.ndarray, carrier: np.ndarray, losses: Losses) -> GroundFound:
    """The plane, for nodes `x` (m) of the bodies `carrier`; friction and radii at each of them.

    Raises `InputError` where contact would be another one here, unless the caller drops it.
    """
    size, moving = float(np.ptp(x, axis=0).max()), carrier != 0
    plane, n, balls, bounce = what_touches(model, data, size, losses)
    if plane is None:
        return GroundFound(None, None, np.zeros(3))
    at = _at_nodes(model, balls, x, carrier, SAME_PLACE * size, losses)
    radius = _one_radius([r for r, _ in at.values()], SAME_PLACE * size, losses)
    _only_nodes(model, balls, x, np.where(moving, carrier, -1), set(at), (radius, SAME_PLACE * size), losses)
    lift = lift_of(n, data.geom_xpos[plane], radius, x[moving], size, losses)
    losses.note("contact is between nodes and the plane; it is exact, where MuJoCo's is soft")
    highest = max((m for _, m in at.values()), default=0.0)
    each = np.array([at[k][1] if k in at else highest for k in range(len(x))])
    return GroundFound(ExactGround(restitution=bounce), cone_of(each), lift, normal=n)


def what_touches(
    model: Any, data: Any, size: float, losses: Losses
) -> tuple[int | None, np.ndarray, list[Touching], float | None]:
    """The plane that is touched, its normal, the balls of all bodies, and the ground's restitution."""
    plane, contacts = _contacts(model, data)
    if plane is None:
        if np.any(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE):
            losses.note("nothing touches the plane: the scene has no ground")
        return None, np.zeros(3), [], None
    n = data.geom_xmat[plane].reshape(3, 3)[:, 2]
    mu = {geom: friction_of(model, geom, found[0], size, losses) for geom, found in contacts.items()}
    if any(mu.values()) and model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL:
        losses.note(PYRAMID)
    balls = [ball for geom, found in contacts.items() for ball in _balls(model, data, geom, found[0], mu[geom], losses)]
    back = {geom: check_spring(model, geom, found[0][3:], SMALL * size, losses) for geom, found in contacts.items()}
    return plane, n, balls, restitution_of(model, back, losses)


def _contacts(model: Any, data: Any) -> tuple[int | None, dict[int, list[Any]]]:
    """The plane that moving bodies touch, and of each of their geoms what MuJoCo makes of its contacts with it.

    All bodies are moved through the plane, and MuJoCo itself says what touches. So masks, pairs, priorities,
    exclusions, margins and overrides count as they do there.
    """
    found: dict[int, list[Any]] = {}
    touched = []
    for plane in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).tolist():
        normal = data.geom_xmat[plane].reshape(3, 3)[:, 2]
        reach = float((data.geom_xpos @ normal + model.geom_rbound).max() - data.geom_xpos[plane] @ normal)
        beyond = _moved(model, -(abs(reach) + 1) * normal)
        contacts = [contact for contact in beyond.contact if plane in contact.geom]
        for contact in contacts:
            geom = int(contact.geom[0] if contact.geom[1] == plane else contact.geom[1])
            found.setdefault(geom, []).append(as_found(contact))
        touched += [plane] if contacts else []
    if len(touched) > 1:
        raise InputError(f"has {len(touched)} planes that bodies touch; expected one, or none")
    return (touched[0] if touched else None), found


def as_found(contact: Any) -> tuple[int, np.ndarray, float, np.ndarray, np.ndarray]:
    """Of MuJoCo's contact: dimension, friction, margin (m), `solref` and `solimp`."""
    spring = (np.array(contact.solref), np.array(contact.solimp))
    return int(contact.dim), np.array(contact.friction), float(contact.includemargin), *spring


def _moved(model: Any, way: np.ndarray) -> Any:
    """MuJoCo's data with every body that stands on the world, or on what is fixed to it, moved by `way`, m."""
    data, places = mujoco.MjData(model), model.body_pos.copy()
    mujoco.mj_kinematics(model, data)
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    for k in range(3):
        data.qpos[model.jnt_qposadr[free] + k] += way[k]
    for body in np.flatnonzero((model.body_weldid != 0) & (model.body_weldid[model.body_parentid] == 0)):
        model.body_pos[body] += data.xmat[model.body_parentid[body]].reshape(3, 3).T @ way
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    model.body_pos[:] = places
    if data.warning[mujoco.mjtWarning.mjWARN_CONTACTFULL].number:
        raise InputError("has more contacts than MuJoCo has memory for; expected fewer parts")
    return data


def friction_of(model: Any, geom: int, contact: Any, size: float, losses: Losses) -> float:
    """mu of a contact of a geom, of which `as_found` says what MuJoCo makes."""
    dim, friction = contact[:2]
    if dim == 1:
        return 0.0
    name = f"geom {name_of(model, 'geom', geom)}"
    if friction[0] != friction[1]:
        losses.lose("friction", f"{name}: friction {friction[0]:g} and {friction[1]:g} along two tangents")
    arms = {"spins": friction[2] if dim >= 4 else 0.0, "rolls": max(friction[3:]) if dim == 6 else 0.0}
    for motion, arm in arms.items():
        if arm > SMALL * size:
            losses.lose("friction", f"{name}: friction against what {motion}, with an arm of {arm:g} m")
    mu = float(max(friction[:2]))
    return mu if mu > LEAST_FRICTION else 0.0


def _balls(model: Any, data: Any, geom: int, contact: Any, mu: float, losses: Losses) -> list[Touching]:
    """What of a geom touches planes, as balls. Cylinders are discs at both ends: within other balls, or lost."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    at, turn, margin = data.geom_xpos[geom].copy(), data.geom_xmat[geom].reshape(3, 3), contact[2]
    types, body = mujoco.mjtGeom, int(model.body_weldid[model.geom_bodyid[geom]])
    if kind == types.mjGEOM_SPHERE:
        places, radius = [at], float(size[0])
    elif kind in (types.mjGEOM_CAPSULE, types.mjGEOM_CYLINDER):
        places, radius = list(axis_ends(model, data, geom)), float(size[0])
    elif kind == types.mjGEOM_BOX:
        corners = np.stack(np.meshgrid(*[(-1, 1)] * 3), -1).reshape(-1, 3)
        places, radius = list(at + (corners * size) @ turn.T), 0.0
    else:
        losses.lose("contact", f"geom {name_of(model, 'geom', geom)} touches the plane with a shape of its own")
        return []
    return [Touching(geom, body, place, radius + margin, mu) for place in places]


def axis_ends(model: Any, data: Any, geom: int) -> np.ndarray:
    """(2, 3), m: both ends of the axis of a capsule or cylinder."""
    half = model.geom_size[geom][1] * data.geom_xmat[geom].reshape(3, 3)[:, 2]
    return np.stack([data.geom_xpos[geom] - half, data.geom_xpos[geom] + half])


class RodGeom(NamedTuple):
    """A geom that touches something as a capsule: also a cylinder whose ends are within balls of its body."""

    body: int
    ends: np.ndarray
    """(2, 3), m"""
    radius: float
    """m"""


def rod_geoms(model: Any, data: Any) -> dict[int, RodGeom]:
    """Those of bodies that move, by their numbers."""
    types, body, found = mujoco.mjtGeom, model.body_weldid[model.geom_bodyid], {}
    touches = (model.geom_contype | model.geom_conaffinity) != 0
    touches[np.r_[model.pair_geom1, model.pair_geom2]] = True
    spheres = np.flatnonzero((model.geom_type == types.mjGEOM_SPHERE) & touches)
    long = np.isin(model.geom_type, (types.mjGEOM_CAPSULE, types.mjGEOM_CYLINDER))
    for geom in np.flatnonzero(touches & long & (body != 0)).tolist():
        ends, radius = axis_ends(model, data, geom), float(model.geom_size[geom][0])
        balls = spheres[body[spheres] == body[geom]]
        within = np.linalg.norm(data.geom_xpos[balls] - ends[:, None], axis=2) + radius <= model.geom_size[balls, 0]
        if model.geom_type[geom] == types.mjGEOM_CAPSULE or np.all(np.any(within, axis=1)):
            found[geom] = RodGeom(int(body[geom]), ends, radius)
    return found


def _at_nodes(
    model: Any, balls: list[Touching], x: np.ndarray, carrier: np.ndarray, within: float, losses: Losses
) -> dict[int, tuple[float, float]]:
    """Radius and mu at each node that is the centre of a ball: those of the largest one."""
    found: dict[int, tuple[float, float]] = {}
    for ball in largest_first(model, balls):
        own = np.flatnonzero(carrier == ball.body)
        if not len(own):
            continue
        node = int(own[np.argmin(np.linalg.norm(x[own] - ball.centre, axis=1))])
        if np.linalg.norm(x[node] - ball.centre) > within:
            continue
        if node in found:
            radius, mu = found[node]
            if abs(radius - ball.radius) <= within and mu != ball.mu:
                name = name_of(model, "geom", ball.geom)
                losses.lose("friction", f"geom {name}: friction {ball.mu:g}, where another geom has {mu:g}")
                found[node] = (radius, max(mu, ball.mu))
            if ball.radius <= radius + within:
                continue
        lose_rims(model, ball.geom, ball.radius, losses)
        found[node] = (ball.radius, ball.mu)
    return found


def _one_radius(radii: list[float], within: float, losses: Losses) -> float:
    if not radii:
        return 0.0
    if max(radii) - min(radii) > within:
        losses.lose("radius", f"nodes touch the plane with radii from {min(radii):g} to {max(radii):g} m")
    return max(radii)


def _only_nodes(
    model: Any,
    balls: list[Touching],
    x: np.ndarray,
    carrier: np.ndarray,
    at: set[int],
    sizes: tuple[float, float],
    losses: Losses,
) -> None:
    """Nothing but nodes touches the plane, and every node that can reach it does; `carrier` is -1 of what is fixed."""
    radius, within = sizes
    corners = {body: x[[k for k in at if carrier[k] == body]] for body in set(carrier.tolist())}
    for ball in balls:
        inside = ball.radius <= radius + within and is_within(corners.get(ball.body), ball.centre, within)
        if not inside:
            lose_beside_sites(model, ball.geom, ball.centre, losses)
    for node in np.flatnonzero(carrier != -1):
        if not is_within(corners[int(carrier[node])], x[node], within):
            name, place = name_of(model, "body", int(carrier[node])), x[node].round(4).tolist()
            losses.lose("contact", f"body {name}: its site at {place} m touches nothing, but nodes touch the plane")


def is_within(corners: np.ndarray | None, place: np.ndarray, within: float) -> bool:
    """Whether a place is in the convex hull of `corners`."""
    if corners is None or not len(corners):
        return False
    away = (corners - place).T
    scale = max(float(np.abs(away).max()), within)
    return bool(nnls(np.vstack([away / scale, np.ones(len(corners))]), np.r_[0, 0, 0, 1.0])[1] * scale <= 2 * within)


def lift_of(n: np.ndarray, plane: np.ndarray, radius: float, x: np.ndarray, size: float, losses: Losses) -> np.ndarray:
    level = float(n @ plane) + radius
    deep = level - float((x @ n).min())
    if deep > SMALL * size:
        losses.lose("contact", f"the robot starts {deep:.4g} m inside the plane, and is pushed out of it")
    elif deep > 1e-12:
        losses.note(f"the robot starts {deep:.4g} m inside the plane; here it starts on it")
    away = level - max(deep, 0.0)
    if radius > 0:
        losses.note(
            f"what touches the plane has a radius of {radius:.4g} m: the plane is so much higher here, and nodes slide "
            "or stick on it where their balls would roll"
        )
    if abs(away) > 1e-12:
        losses.note(f"nodes are moved by {away:.4g} m against the plane's normal, onto a plane through the origin")
    return away * n

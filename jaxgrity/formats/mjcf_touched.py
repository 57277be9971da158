"""What of a MuJoCo model touches what stands in its world: as MuJoCo itself combines masks, pairs and friction."""

import copy
from typing import Any, NamedTuple

import lazy_loader
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import Losses
from jaxgrity.formats.mjcf_losses import REBOUND_NOTED, SMALL, check_spring, name_of, restitution_of
from jaxgrity.formats.mjcf_solids import solid_of
from jaxgrity.model.surface import Surface

mujoco: Any = lazy_loader.load("mujoco")

PYRAMID = (
    "friction there is a pyramid (option cone): between the two tangents it is up to 29 % weaker; here it is a cone, "
    "alike in all directions"
)
"""Note on the pyramidal cone, MuJoCo's default: along a tangent the friction is mu, half-way between two mu/sqrt(2)."""
LEAST_FRICTION = 1.01e-5
"""Friction written in place of none: MuJoCo accepts no smaller value."""


MOVED_ALIKE = 1e-9
"""Largest difference of numbers of two contacts of a geom that count as the same."""


class Touching(NamedTuple):
    """A ball of a body that touches the plane: a sphere, an end of a capsule, or a corner of a box."""

    geom: int
    body: int
    centre: np.ndarray
    """m"""
    radius: float
    """m, with MuJoCo's margin"""
    mu: float


class Touched(NamedTuple):
    """What stands and is touched, and by what."""

    plane: int | None
    solids: dict[int, Surface]
    """boxes, balls and cylinders of the world, by their geoms, as the model places them"""
    balls: list[Touching]
    bounce: float | None
    """restitution"""


def what_touches(model: Any, data: Any, size: float, losses: Losses) -> Touched:
    """The plane and the solids that moving bodies touch, the balls of all bodies, and the ground's restitution.

    `size` is the robot's, m. Raises `InputError` where bodies touch several planes. Loses what differs from one
    standing geom to another: here a node touches all of them, with one friction coefficient.
    """
    standing = _standing(model)
    found = {geom: _contacts(model, data, geom) for geom in standing}
    found = {geom: contacts for geom, contacts in found.items() if contacts}
    planes = [geom for geom in found if standing[geom]]
    if len(planes) > 1:
        raise InputError(f"has {len(planes)} planes that bodies touch; expected one, or none")
    if not found:
        if any(standing.values()):
            losses.note("nothing touches the plane: the scene has no ground")
        return Touched(None, {}, [], None)
    contacts = {geom: contact for each in reversed(found.values()) for geom, contact in each.items()}
    mu = {geom: _one_friction(model, geom, found, size, losses) for geom in contacts}
    if any(mu.values()) and model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL:
        losses.note(PYRAMID)
    balls = [ball for geom in contacts for ball in _balls(model, data, geom, contacts[geom], mu[geom], losses)]
    back = {geom: _one_spring(model, geom, found, size, losses) for geom in contacts}
    solids = {geom: solid_of(model, data, geom) for geom in found if not standing[geom]}
    if solids:
        _lose_edges(model, [*contacts], [*solids], losses)
    return Touched(planes[0] if planes else None, solids, balls, restitution_of(model, back, losses))


def _standing(model: Any) -> dict[int, bool]:
    """The planes and solids that do not move, planes first, and whether each is a plane."""
    types = mujoco.mjtGeom
    solid = (types.mjGEOM_BOX, types.mjGEOM_SPHERE, types.mjGEOM_CYLINDER, types.mjGEOM_CAPSULE)
    planes, body = model.geom_type == types.mjGEOM_PLANE, model.body_weldid[model.geom_bodyid]
    still = (body == 0) & (model.body_mocapid[model.geom_bodyid] < 0) & np.isin(model.geom_type, solid)
    return dict.fromkeys(np.flatnonzero(planes).tolist(), True) | dict.fromkeys(np.flatnonzero(still).tolist(), False)


def _contacts(model: Any, data: Any, geom: int) -> dict[int, Any]:
    """Of each moving geom that can touch a standing one, what MuJoCo makes of their contact.

    The standing one is a plane for a while. All bodies are moved through it, and MuJoCo itself says what touches. So
    masks, pairs, priorities, exclusions, margins and overrides count as they do there.
    """
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE:
        model = copy.copy(model)
        model.geom_type[geom], model.geom_rbound[geom] = mujoco.mjtGeom.mjGEOM_PLANE, 0.0
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    normal = data.geom_xmat[geom].reshape(3, 3)[:, 2]
    reach = float((data.geom_xpos @ normal + model.geom_rbound).max() - data.geom_xpos[geom] @ normal)
    moving, found = model.body_weldid[model.geom_bodyid] != 0, dict[int, Any]()
    for contact in _moved(model, -(abs(reach) + 1) * normal).contact:
        if geom in contact.geom:
            other = int(contact.geom[0] if contact.geom[1] == geom else contact.geom[1])
            if moving[other]:
                found.setdefault(other, as_found(contact))
    return found


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


def _one_friction(model: Any, geom: int, found: dict[int, dict[int, Any]], size: float, losses: Losses) -> float:
    """mu of a geom on all that it touches; loses what it does not touch, and other friction or margins there."""
    own = {each: contacts[geom] for each, contacts in found.items() if geom in contacts}
    mu = {each: friction_of(model, geom, contact, size, losses) for each, contact in own.items()}
    first, *_ = own
    name, there = (f"geom {name_of(model, 'geom', each)}" for each in (geom, first))
    for each in found:
        other = f"geom {name_of(model, 'geom', each)}"
        if each not in own:
            losses.lose("contact", f"{name}: touches {there}, and not {other}")
        elif abs(own[each][2] - own[first][2]) > MOVED_ALIKE:
            losses.lose("contact", f"{name}: has a margin of {own[first][2]:g} m to {there}, and another to {other}")
        elif abs(mu[each] - mu[first]) > MOVED_ALIKE:
            losses.lose("friction", f"{name}: friction {mu[first]:g} on {there}, and {mu[each]:g} on {other}")
    return max(mu.values())


def _one_spring(model: Any, geom: int, found: dict[int, dict[int, Any]], size: float, losses: Losses) -> float:
    """The share of its speed that a geom's contact gives back; loses shares that differ by what it touches."""
    own = {each: contacts[geom][3:] for each, contacts in found.items() if geom in contacts}
    back = {each: check_spring(model, geom, spring, SMALL * size, losses) for each, spring in own.items()}
    if max(back.values()) - min(back.values()) > REBOUND_NOTED:
        name = name_of(model, "geom", geom)
        losses.lose(
            "contact", f"geom {name}: bounces off at {min(back.values()):.2g} to {max(back.values()):.2g} times"
        )
    return max(back.values())


def _lose_edges(model: Any, geoms: list[int], solids: list[int], losses: Losses) -> None:
    """Loses moving boxes, of which corners alone are read, where they touch more than a plane."""
    for geom in geoms:
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            name, other = (name_of(model, "geom", each) for each in (geom, solids[0]))
            losses.lose("contact", f"geom {name}: a box that moves touches geom {other} with edges and faces, too")


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

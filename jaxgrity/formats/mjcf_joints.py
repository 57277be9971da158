"""Joints of MuJoCo models as points that two bodies share: ball joints one, hinges two; `connect` is a ball joint.

Bodies that `weld` holds to each other are one body.
"""

from copy import copy
from typing import Any, NamedTuple

import lazy_loader
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import Losses
from jaxgrity.formats.mjcf_losses import SMALL, name_of, watched

mujoco: Any = lazy_loader.load("mujoco")

APART = 1e-6
"""Largest distance between the two points of a joint at the start, in sizes of the model. For welds also the largest
angle, rad, between the pose at the start and the pose that the weld holds."""
NEAR = 0.1
"""Sites on a hinge's axis closer than this share of a body's radius of gyration say too little where it turns."""


class Joint(NamedTuple):
    """A point of two bodies."""

    x: np.ndarray
    """(3,), m"""
    bodies: tuple[int, int]
    """0: the world, to which the point is fixed; of a hinge the one that turns comes first"""
    hinge: int = -1
    """number of the model's joint, of both points on a hinge's axis"""


def merge_welded(model: Any, data: Any, losses: Losses) -> Any:
    """The model with welded bodies as one: in `body_weldid` they have the number of the first, or 0 with the world.

    MuJoCo has this number for bodies without joints of their own. It is for reading alone: `data` keeps the model as
    MuJoCo moves it.

    Raises `InputError` where a weld holds its bodies in another pose than at the start, or locks a body that slides.
    """
    welds = [e for e in _active(model, data) if model.eq_type[e] == mujoco.mjtEq.mjEQ_WELD]
    merged = copy(model) if welds else model
    for e in welds:
        _check_pose(model, data, e)
        one, other = (int(merged.body_weldid[body]) for body in _ends(model, e))
        merged.body_weldid[np.isin(merged.body_weldid, (one, other))] = min(one, other)
    for e in welds:
        joints = outer_joints(merged, int(merged.body_weldid[_ends(model, e)[0]]))
        slides = joints[model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE]
        if len(slides):
            name = name_of(model, "body", int(model.jnt_bodyid[slides[0]]))
            raise InputError(
                f"equality {name_of(model, 'equality', e)}: welds body {name}, which slides, to another; "
                "expected free bodies, or joints that turn"
            )
    if welds:
        losses.note(f"{len(welds)} welds make one body of two")
    return merged


def _active(model: Any, data: Any) -> list[int]:
    """The equalities that hold at the start."""
    off = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
    return [] if off else np.flatnonzero(data.eq_active).tolist()


def _ends(model: Any, e: int) -> tuple[int, int]:
    """The two bodies of a `connect` or a `weld`, which may be given by sites."""
    one, other = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
    if model.eq_objtype[e] == mujoco.mjtObj.mjOBJ_SITE:
        return int(model.site_bodyid[one]), int(model.site_bodyid[other])
    return one, other


def _rows(data: Any, e: int) -> np.ndarray:
    """The rows of MuJoCo's constraints that an equality has; none where its bodies cannot move."""
    return np.flatnonzero(data.efc_id[: data.ne] == e)


def _check_pose(model: Any, data: Any, e: int) -> None:
    """Raises `InputError` where a weld turns or moves its bodies at the start, or leaves them free to turn."""
    name, arm = name_of(model, "equality", e), float(model.eq_data[e, 10])
    if arm == 0:
        raise InputError(f"equality {name}: a weld with torquescale 0 lets its bodies turn; expected connect")
    off = np.r_[data.efc_pos[_rows(data, e)], np.zeros(6)][:6]  # three of the place; three of half the angle, by `arm`
    away, turned = np.linalg.norm(off[:3]), 2 * np.linalg.norm(off[3:] / arm)
    if away > APART * model.stat.extent or turned > APART:
        raise InputError(
            f"equality {name}: holds its bodies {away:.3g} m and {turned:.3g} rad away from their pose at the start; "
            "expected that pose; MuJoCo takes it if you leave out relpose"
        )


def outer_joints(model: Any, body: int) -> np.ndarray:
    """The joints by which a body, with all that is welded to it, moves."""
    own, parent = model.body_weldid[model.jnt_bodyid], model.body_weldid[model.body_parentid[model.jnt_bodyid]]
    return np.flatnonzero((own == body) & (parent != body) & (body != 0))


def joints_of(model: Any, data: Any, losses: Losses) -> list[Joint]:
    """The shared points. Raises `InputError` where bodies are joined in other ways."""
    found = []
    for j in range(model.njnt):
        own = int(model.jnt_bodyid[j])
        body, parent = int(model.body_weldid[own]), int(model.body_weldid[model.body_parentid[own]])
        if body == parent:
            continue
        hinge = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
        if not hinge and model.jnt_type[j] != mujoco.mjtJoint.mjJNT_BALL:
            if parent:
                raise InputError(
                    f"body {name_of(model, 'body', own)}: slides on another body; expected ball joints and hinges"
                )
            continue
        if model.body_jntnum[own] > 1:
            raise InputError(f"body {name_of(model, 'body', own)}: has several joints; expected one")
        ends = _along_hinge(model, data, j, {body, parent}) if hinge else (data.xanchor[j],)
        found += [Joint(x.copy(), _world_last(body, parent), j if hinge else -1) for x in ends]
    active = _active(model, data)
    found += [joint for e in active if (joint := _connected(model, data, e))]
    if found:
        losses.note(f"{len(found)} points of joints are rigid")
    _note_softness(model, data, active, losses)
    return found


def _along_hinge(model: Any, data: Any, j: int, bodies: set[int]) -> tuple[np.ndarray, np.ndarray]:
    """Two points on the axis of a hinge: the outermost sites there of its bodies, or as far out as the mass is."""
    own, axis, anchor = int(model.jnt_bodyid[j]), data.xaxis[j], data.xanchor[j]
    welded = model.body_weldid == model.body_weldid[own]
    mass, at = model.body_mass[welded], data.xipos[welded]
    away = at - mass @ at / mass.sum()
    arm = float(np.sqrt((model.body_inertia[welded].sum() + mass @ (away**2).sum(1)) / mass.sum()))
    sites = data.site_xpos[np.isin(model.body_weldid[model.site_bodyid], sorted(bodies - {0}))] - anchor
    along = sites @ axis
    there = along[np.linalg.norm(sites - np.outer(along, axis), axis=1) <= APART * model.stat.extent]
    low, high = (there.min(), there.max()) if np.ptp(there if len(there) else np.zeros(1)) > NEAR * arm else (-arm, arm)
    return anchor + low * axis, anchor + high * axis


def _world_last(one: int, other: int) -> tuple[int, int]:
    return (one, other) if one else (other, one)


def _connected(model: Any, data: Any, e: int) -> Joint | None:
    """The point that a `connect` holds; none within one body, nor of a `weld`."""
    one, other, name = int(model.eq_obj1id[e]), int(model.eq_obj2id[e]), name_of(model, "equality", e)
    if model.eq_type[e] == mujoco.mjtEq.mjEQ_WELD:
        return None
    if model.eq_type[e] != mujoco.mjtEq.mjEQ_CONNECT:
        kind = mujoco.mjtEq(int(model.eq_type[e])).name.removeprefix("mjEQ_").lower()
        raise InputError(f"equality {name}: a {kind} is not read; expected connect or weld")
    if model.eq_objtype[e] == mujoco.mjtObj.mjOBJ_SITE:
        x, there = data.site_xpos[one], data.site_xpos[other]
    else:
        x = data.xpos[one] + data.xmat[one].reshape(3, 3) @ model.eq_data[e, :3]
        there = data.xpos[other] + data.xmat[other].reshape(3, 3) @ model.eq_data[e, 3:6]
    if np.linalg.norm(x - there) > APART * model.stat.extent:
        raise InputError(f"equality {name}: its points are {np.linalg.norm(x - there):.3g} m apart; expected one place")
    first, second = (int(model.body_weldid[body]) for body in _ends(model, e))
    return None if first == second else Joint(x.copy(), _world_last(first, second))


def _note_softness(model: Any, data: Any, active: list[int], losses: Losses) -> None:
    """Loses equalities that give way by over `SMALL` of the model's size while MuJoCo moves it for a while."""
    size, number = float(model.stat.extent), data.efc_id[: data.ne].copy()
    scale, away, time = np.ones(data.ne), np.zeros(data.ne), 0.0
    for e in active:
        if model.eq_type[e] == mujoco.mjtEq.mjEQ_WELD:  # half the angle, by an arm: what that moves across the model
            scale[_rows(data, e)[3:]] = 2 * size / model.eq_data[e, 10]
    for moved in watched(data) if active else ():
        away, time = np.maximum(away, scale * np.abs(moved.efc_pos[: moved.ne])), moved.time
    for e in active:
        own = float(away[number == e].max(initial=0.0))
        if own > SMALL * size:
            name = name_of(model, "equality", e)
            losses.lose("forces", f"equality {name}: gives way by {own:.1g} m of {size:.2g} m (solref, solimp)")
    if np.any(away):
        most = f"{away.max():.1g} m within {time:.2g} s"
        losses.note(f"connect and weld give way there, by up to {most} after the start; here they are rigid")


class Shared(NamedTuple):
    """Joints as nodes."""

    node: int
    bodies: tuple[int, int]


def shared_nodes(
    x: np.ndarray, carrier: np.ndarray, joints: list[Joint]
) -> tuple[np.ndarray, np.ndarray, list[Shared]]:
    """Nodes and carriers, with those of joints, and which these are: a node of such a body where one is there."""
    within, shared = APART * float(np.ptp(x, axis=0).max()), list[Shared]()
    for joint in joints:
        there = np.flatnonzero(np.linalg.norm(x - joint.x, axis=1) <= within).tolist()
        own = [k for k in there if set(joint.bodies) - {0} & {int(carrier[k]), *_bodies_at(shared, k)}]
        if not own:
            own, x, carrier = [len(x)], np.r_[x, joint.x[None]], np.r_[carrier, joint.bodies[0]]
        shared.append(Shared(own[0], joint.bodies))
    return x, carrier, shared


def _bodies_at(shared: list[Shared], node: int) -> set[int]:
    return {body for each in shared if each.node == node for body in each.bodies}


def points_of(shared: list[Shared], body: int) -> list[int]:
    """The nodes of joints that a body shares with others, or with the world."""
    return list(dict.fromkeys(each.node for each in shared if body in each.bodies))


def own_nodes(carrier: np.ndarray, shared: list[Shared], body: int) -> np.ndarray:
    """The nodes of a body, those of joints first."""
    joined = points_of(shared, body)
    return np.array([*joined, *(k for k in np.flatnonzero(carrier == body).tolist() if k not in joined)], int)

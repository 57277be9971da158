"""Joints of MuJoCo models as points that two bodies share: ball joints one, hinges two; `connect` is a ball joint."""

from typing import Any, NamedTuple

import lazy_loader
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import Losses
from jaxgrity.formats.mjcf_losses import name_of

mujoco: Any = lazy_loader.load("mujoco")

APART = 1e-6
"""Largest distance between the two points of a joint at the start, in sizes of the model."""


class Joint(NamedTuple):
    """A point of two bodies."""

    x: np.ndarray
    """(3,), m"""
    bodies: tuple[int, int]
    """0: the world, to which the point is fixed"""


def joints_of(model: Any, data: Any, losses: Losses) -> list[Joint]:
    """The shared points. Raises `InputError` where bodies are joined in other ways."""
    found = []
    for j in range(model.njnt):
        body = int(model.jnt_bodyid[j])
        parent = int(model.body_weldid[model.body_parentid[body]])
        hinge = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
        if not hinge and model.jnt_type[j] != mujoco.mjtJoint.mjJNT_BALL:
            if parent:
                raise InputError(
                    f"body {name_of(model, 'body', body)}: slides on another body; expected ball joints and hinges"
                )
            continue
        if model.body_jntnum[body] > 1:
            raise InputError(f"body {name_of(model, 'body', body)}: has several joints; expected one")
        arm = np.sqrt(model.body_inertia[body].sum() / model.body_mass[body]) * data.xaxis[j] if hinge else np.zeros(3)
        ends = (data.xanchor[j] - arm, data.xanchor[j] + arm) if hinge else (data.xanchor[j],)
        found += [Joint(x.copy(), (body, parent)) for x in ends]
    for e in np.flatnonzero(data.eq_active).tolist():
        found.append(_connected(model, data, e))
    if found:
        losses.note(f"{len(found)} points of joints are rigid, where those of MuJoCo's constraints give way a little")
    return found


def _connected(model: Any, data: Any, e: int) -> Joint:
    one, other, name = int(model.eq_obj1id[e]), int(model.eq_obj2id[e]), name_of(model, "equality", e)
    if model.eq_type[e] != mujoco.mjtEq.mjEQ_CONNECT:
        kind = mujoco.mjtEq(int(model.eq_type[e])).name.removeprefix("mjEQ_").lower()
        raise InputError(f"equality {name}: a {kind} is not read; expected connect, or one body in place of two")
    if model.eq_objtype[e] == mujoco.mjtObj.mjOBJ_SITE:
        x, there = data.site_xpos[one], data.site_xpos[other]
        one, other = int(model.site_bodyid[one]), int(model.site_bodyid[other])
    else:
        x = data.xpos[one] + data.xmat[one].reshape(3, 3) @ model.eq_data[e, :3]
        there = data.xpos[other] + data.xmat[other].reshape(3, 3) @ model.eq_data[e, 3:6]
    if np.linalg.norm(x - there) > APART * model.stat.extent:
        raise InputError(f"equality {name}: its points are {np.linalg.norm(x - there):.3g} m apart; expected one place")
    bodies = int(model.body_weldid[one]), int(model.body_weldid[other])
    return Joint(x.copy(), bodies if bodies[0] else bodies[::-1])


class Shared(NamedTuple):
    """Joints as nodes."""

    node: int
    bodies: tuple[int, int]


def points_of(shared: list[Shared], body: int) -> list[int]:
    """The nodes of joints that a body shares with others, or with the world."""
    return [each.node for each in shared if body in each.bodies]

"""Springs and dampers of the hinges of MuJoCo models, read and written."""

from typing import Any

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import Losses
from jaxgrity.formats.links import Link, LinkJoint
from jaxgrity.formats.mjcf_joints import Joint, Shared, own_nodes
from jaxgrity.formats.mjcf_losses import name_of, watched
from jaxgrity.model.hinges import OFF_AXIS, HingeDampers, HingeSprings, hinge_angles
from jaxgrity.model.laws import Law
from jaxgrity.model.scene import Scene

WINDING = "MuJoCo counts the turns of a hinge: one wound by more than half a turn has another torque there"
"""Note on the springs of hinges, which take differences of angles from -pi to pi."""


def with_nodes_of_the_world(
    model: Any, x: np.ndarray, carrier: np.ndarray, joints: list[Joint]
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and carriers, with a node of the world beside the axis of each hinge there that has a spring or damper."""
    for one, other in _sprung(model, joints):
        if (
            joints[one].bodies[1] == 0
            and _beside(x, np.flatnonzero(carrier == 0), joints[one].x, joints[other].x) is None
        ):
            axis = joints[other].x - joints[one].x
            across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
            x, carrier = np.r_[x, (joints[one].x + across)[None]], np.r_[carrier, 0]
    return x, carrier


def hinge_laws(
    model: Any,
    data: Any,
    at: tuple[np.ndarray, np.ndarray],
    joints: list[Joint],
    shared: list[Shared],
    losses: Losses,
) -> tuple[Law, ...]:
    """The laws of hinges with springs and dampers, of nodes and their carriers.

    The shared nodes are those of the joints, in their order.
    """
    x, carrier = at
    rows: list[tuple[int, int, int, int]] = []
    K, rest, c = list[float](), list[float](), list[float]()
    for one, other in _sprung(model, joints):
        j, (body, parent) = joints[one].hinge, joints[one].bodies
        p, q = shared[one].node, shared[other].node
        name = name_of(model, "body", int(model.jnt_bodyid[j]))
        own = [own_nodes(carrier, shared, each) if each else np.flatnonzero(carrier == 0) for each in (parent, body)]
        first, second = (_beside(x, nodes, x[p], x[q]) for nodes in own)
        if first is None or second is None:
            raise InputError(
                f"body {name}: its hinge has a spring or damper, but no site beside its axis; expected one"
            )
        rows.append((first, p, q, second))
        away = float(data.qpos[model.jnt_qposadr[j]] - model.qpos_spring[model.jnt_qposadr[j]])
        K.append(float(np.ravel(model.jnt_stiffness)[j]))
        rest.append(float(hinge_angles(x, (rows[-1],))[0]) - away)
        c.append(float(np.ravel(model.dof_damping)[model.jnt_dofadr[j]]))
        if K[-1] and _beyond(model, data, j):
            losses.lose("forces", f"body {name}: the spring of its joint is wound by more than half a turn")
    if not rows:
        return ()
    losses.note(f"{len(rows)} hinges have springs or dampers")
    if any(K):
        losses.note(WINDING)
    springs = HingeSprings(tuple(rows), np.array(K), np.array(rest))
    dampers = HingeDampers(tuple(rows), np.array(c))
    return *([springs] if any(K) else []), *([dampers] if any(c) else [])


def _sprung(model: Any, joints: list[Joint]) -> list[tuple[int, int]]:
    """The numbers of both points of each hinge that has a spring or a damper."""
    firsts = [k for k, joint in enumerate(joints[:-1]) if joint.hinge >= 0 and joints[k + 1].hinge == joint.hinge]
    stiffness, damping = np.ravel(model.jnt_stiffness), np.ravel(model.dof_damping)
    return [(k, k + 1) for k in firsts if stiffness[joints[k].hinge] or damping[model.jnt_dofadr[joints[k].hinge]]]


def _beside(x: np.ndarray, own: np.ndarray, start: np.ndarray, end: np.ndarray) -> int | None:
    """Which of these nodes is farthest from an axis; None where none is beside it."""
    if not len(own):
        return None
    size = float(np.linalg.norm(end - start))
    off = np.linalg.norm(np.cross(x[own] - start, (end - start) / size), axis=1)
    return int(own[off.argmax()]) if off.max() > OFF_AXIS * size else None


def _beyond(model: Any, data: Any, j: int) -> bool:
    """Whether a spring is wound by more than half a turn at the start, or while MuJoCo moves the robot for a while."""
    place = model.jnt_qposadr[j]
    rest = model.qpos_spring[place]
    if abs(data.qpos[place] - rest) >= np.pi:
        return True
    return any(abs(moved.qpos[place] - rest) >= np.pi for moved in watched(data))


def joint_attributes(
    scene: Scene, joint: LinkJoint, links: list[Link], axis: np.ndarray
) -> tuple[dict[str, float], set[tuple[int, ...]]]:
    """`stiffness`, `damping` and `springref` (degrees) of a hinge about an `axis`, and which hinges these are."""
    given: dict[str, float] = {}
    x, done = np.asarray(scene.structure.nodes, float), set[tuple[int, ...]]()
    for term in scene.terms:
        if not isinstance(term, HingeSprings | HingeDampers):
            continue
        for k, nodes in enumerate(term.nodes):
            a, p, q, b = nodes
            own = links[joint.link].nodes
            if {p, q} != set(joint.nodes) or (a in own) == (b in own):
                continue
            done.add(nodes)
            if isinstance(term, HingeDampers):
                given["damping"] = given.get("damping", 0.0) + float(term.damping[k])
                continue
            way = (1 if b in own else -1) * (1 if (x[q] - x[p]) @ axis > 0 else -1)
            away = float(term.rest_angle[k]) - float(hinge_angles(x, (nodes,))[0])
            given["stiffness"] = float(term.stiffness[k])
            given["springref"] = way * float(np.degrees(np.arctan2(np.sin(away), np.cos(away))))
    return given, done

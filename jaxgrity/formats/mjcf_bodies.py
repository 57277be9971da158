"""The bodies of a MuJoCo model as nodes with masses, supports, and rods: as heavy, and as hard to turn."""

from typing import Any

import lazy_loader
import numpy as np
from scipy.optimize import nnls

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import Edges, Supports
from jaxgrity.formats.foreign import Losses
from jaxgrity.formats.mjcf_joints import Shared, outer_joints, own_nodes, points_of
from jaxgrity.formats.mjcf_losses import name_of
from jaxgrity.model.bodies import Bodies, Body, Joints, rigid_body
from jaxgrity.model.joints import joined_bodies
from jaxgrity.model.structure import Members, edge_lengths

mujoco: Any = lazy_loader.load("mujoco")

MASS_WITHIN, MASS_NOTED = 0.02, 1e-3
"""Largest relative errors of second moments where masses and rods replace a body: at all, and without a note."""
LEAST_SHARE = 1e-3
"""Smallest share of a body's mass at each of its nodes, used where some node would have none."""
Rod = tuple[tuple[int, int], float]
"""The two nodes that a rod joins, and its mass in kg."""


def carried(
    model: Any,
    data: Any,
    at: tuple[np.ndarray, np.ndarray],
    shared: list[Shared],
    turning: dict[int, int],
    losses: Losses,
) -> tuple[np.ndarray, Supports, list[Rod], Bodies]:
    """Masses of nodes, supports, rods with their masses, and rigid bodies, of the nodes `at` and their carriers.

    `turning` has nodes with balls, and the bodies with which these turn.
    """
    (x, carrier), notes = at, losses.notes
    mass, rods, solid = np.zeros(len(x)), [], dict[int, np.ndarray]()
    fixed = [(node, "xyz") for node in points_of(shared, 0)]
    for body in sorted({*carrier.tolist(), *(body for each in shared for body in each.bodies)}):
        own = own_nodes(carrier, shared, body) if body else np.flatnonzero(carrier == 0)
        name = name_of(model, "body", body)
        joints = outer_joints(model, body)
        kinds = model.jnt_type[joints]
        if body == 0:
            fixed += [(int(node), "xyz") for node in own]
        elif points_of(shared, body):
            if np.any(kinds == mujoco.mjtJoint.mjJNT_SLIDE):
                raise InputError(f"body {name}: slides, and has a joint with another body; expected a free joint")
            solid[body] = own
        elif is_free(model, body) and len(own) > 2:
            solid[body] = own
        elif is_free(model, body):
            found, shares = _as_rods(inertia_of(model, data, body), name, own, x, notes)
            rods += found
            mass[own] = shares
        elif len(own) == 1 and len(kinds) and np.all(kinds == mujoco.mjtJoint.mjJNT_SLIDE):
            mass[own] = model.body_subtreemass[body]
            held = _held(data.xaxis[joints], name)
            fixed += [(int(own[0]), held)] if held else []
        else:
            raise InputError(f"body {name}: expected a free joint, or slides along axes and a single node")
    numbers = _turning_first(model, solid, turning, losses)

    def made(number: int, joints: Joints) -> Body:
        body = numbers[number]
        return _as_body(inertia_of(model, data, body), name_of(model, "body", body), solid[body], x, joints)

    rigid = joined_bodies([solid[body].tolist() for body in numbers], tuple(fixed), made)
    return mass, tuple(fixed), rods, rigid


def _turning_first(model: Any, solid: dict[int, np.ndarray], turning: dict[int, int], losses: Losses) -> list[int]:
    """The rigid bodies in an order in which balls at joints turn with their own: with the first of the joint's."""
    left, found = list(solid), list[int]()
    before = {body: {turning.get(node, body) for node in solid[body].tolist()} - {body} for body in left}
    while left:
        ready = [body for body in left if not before[body] & {*left}]
        if not ready:
            name = name_of(model, "body", left[0])
            losses.lose("contact", f"body {name}: balls at its joints turn with several bodies in a ring")
        found.append((ready or left)[0])
        left.remove(found[-1])
    return found


def rigid_bodies(
    model: Any, data: Any, at: tuple[np.ndarray, np.ndarray], shared: list[Shared], solid: set[int]
) -> list[int]:
    """The bodies that no strut stands for: `solid`, with joints, of more than two nodes, heavier beside their line."""
    found = {body for each in shared for body in each.bodies if body}
    for body in found:
        if len(own_nodes(at[1], shared, body)) < 2:
            name = name_of(model, "body", body)
            raise InputError(f"body {name}: has a joint and no site; expected sites that say where it is")
    counted = np.unique(at[1], return_counts=True)
    for body, count in zip(*(each.tolist() for each in counted)):
        if is_free(model, body) and (
            count > 2 or (count == 2 and (body in solid or not _is_rod(model, data, body, at)))
        ):
            found.add(body)
    return sorted(found)


def is_free(model: Any, body: int) -> bool:
    """Whether nothing holds it."""
    kinds = model.jnt_type[outer_joints(model, body)]
    return bool(body and len(kinds) and np.all(kinds == mujoco.mjtJoint.mjJNT_FREE))


def _is_rod(model: Any, data: Any, body: int, at: tuple[np.ndarray, np.ndarray]) -> bool:
    """Whether point masses and a thin rod are as hard to turn."""
    try:
        _as_rods(inertia_of(model, data, body), name_of(model, "body", body), np.flatnonzero(at[1] == body), at[0], [])
    except InputError:
        return False
    return True


def _as_body(
    moments: tuple[float, np.ndarray, np.ndarray],
    name: str,
    own: np.ndarray,
    x: np.ndarray,
    joints: Joints,
) -> Body:
    total, centre, second = moments
    try:
        return rigid_body(x, own.tolist(), total, np.trace(second) * np.eye(3) - second, centre, joints)
    except InputError as error:
        raise InputError(f"body {name}: {str(error).removeprefix('rigid_body: ')}") from error


def _held(axes: np.ndarray, name: str) -> str:
    """The axes along which a body does not move that slides along these of the world."""
    axes = np.abs(axes)
    if not np.allclose(axes.max(1), 1) or len(set(axes.argmax(1))) < len(axes):
        raise InputError(f"body {name}: its slides are not along x, y or z; expected them to be")
    return "".join(axis for k, axis in enumerate("xyz") if k not in axes.argmax(1))


def _as_rods(
    moments: tuple[float, np.ndarray, np.ndarray], name: str, own: np.ndarray, x: np.ndarray, notes: list[str]
) -> tuple[list[Rod], np.ndarray]:
    """A thin rod, and point masses, kg, at its `own` nodes, as heavy as a free body, and as hard to turn.

    How hard it is to turn about the line through the nodes does not matter to them.
    """
    total, centre, second = moments
    if len(own) < 2:
        raise InputError(
            f"body {name}: a free body has one node; expected two or more, so that struts can stand for it"
        )
    edges: Edges = ((int(own[0]), int(own[1])),)
    size = np.ptp(x[own], axis=0).max()
    second, thick = _on_line(second, x[own[1]] - x[own[0]])
    rows = [_of_rod(x[[n, n]] - centre, size) for n in own] + [_of_rod(x[list(e)] - centre, size) for e in edges]
    wanted = np.r_[1.0, np.zeros(3), (second / total / size**2)[np.triu_indices(3)]]
    columns, shares = np.array(rows).T, np.zeros(len(rows))
    # few masses suffice, but a node without any could not move by itself: then each gets a least share
    for least in (0.0, LEAST_SHARE):
        shares[: len(own)] = least
        shares = shares + nnls(columns, wanted - columns[:, : len(own)].sum(1) * least)[0]
        carries = {node for e, share in zip(edges, shares[len(own) :]) if share > 0 for node in e}
        if all(share > 0 or int(node) in carries for node, share in zip(own, shares)):
            break
        shares = np.zeros(len(rows))
    missed = np.abs(columns @ shares - wanted).max() / np.abs(wanted[4:]).max()
    if max(missed, thick) > MASS_WITHIN:
        raise InputError(
            f"body {name}: point masses and thin rods between its {len(own)} nodes miss its centre of mass or moments "
            f"of inertia by {max(missed, thick):.0%}; expected nodes that span it"
        )
    if missed > MASS_NOTED:
        notes.append(f"body {name}: point masses and thin rods miss its moments of inertia by {missed:.1%}")
    rods = [(edge, float(share * total)) for edge, share in zip(edges, shares[len(own) :])]
    return rods, shares[: len(own)] * total


def _on_line(second: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, float]:
    """Second moments of a thin body that is as hard to turn about what is normal to a line; how thick the body is.

    A moment of inertia about a normal is the sum of the second moments along the line and along the other normal.
    """
    line = np.outer(along, along) / (along @ along)
    across = np.eye(3) - line
    beside = float(np.sum(across * second)) / 2
    return second + beside * (line - across), beside / max(float(np.sum(line * second)), beside)


def inertia_of(model: Any, data: Any, body: int) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre, and the integral of d d' dm about it, of a body and of all that is welded to it."""
    welded = np.flatnonzero(model.body_weldid == body)
    m, at = model.body_mass[welded], data.xipos[welded]
    total = float(m.sum())
    centre = m @ at / total
    second = np.zeros((3, 3))
    for k, mass, place in zip(welded, m, at):
        # principal moments: half of their sum less one of them is the integral of the square along its axis
        turn, inertia = data.ximat[k].reshape(3, 3), model.body_inertia[k]
        second += turn @ np.diag(inertia.sum() / 2 - inertia) @ turn.T + mass * np.outer(place - centre, place - centre)
    return total, centre, second


def _of_rod(ends: np.ndarray, size: float) -> np.ndarray:
    """(10,): mass, first and second moments of a thin rod of mass 1, lengths in units of `size`."""
    a, b = ends / size
    second = (2 * np.outer(a, a) + 2 * np.outer(b, b) + np.outer(a, b) + np.outer(b, a)) / 6
    return np.r_[1.0, (a + b) / 2, second[np.triu_indices(3)]]


def rod_members(x: np.ndarray, rods: list[Rod]) -> Members | None:
    if not rods:
        return None
    edges, mass = tuple(edge for edge, _ in rods), np.array([m for _, m in rods])
    return Members(edges, None, edge_lengths(x, edges), mass=mass if mass.any() else None)

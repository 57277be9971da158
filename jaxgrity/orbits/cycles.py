"""Shapes that return: what is invariant under shifts along the ground and turns about its normal."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, NodeVectors, Scalar, namespace_of
from jaxgrity.model.energy import UP
from jaxgrity.model.external import Push
from jaxgrity.model.laws import SAME, Symmetry
from jaxgrity.model.scene import Scene

MOST_PERIODS = 12
"""Most periods of actuation that a cycle may have."""
RETURNED = 1.5
"""Factor on the least change of shape over any number of periods. A number of periods with a change within it is a
cycle: two cycles come back as closely as one."""
ALIKE = 1e-4
"""Change of shape, in body lengths, that counts as a return even where more periods come back more closely. Orbits of
the library come back within 1e-9 after a cycle. After a part of a cycle, shapes of the orbits that we met differ by
2e-4 or more."""

TURN = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
"""A turn about the vertical, by no part of a circle, that laws without a direction keep."""


class Plane(NamedTuple):
    """The ground on which a robot moves."""

    axes: Float[np.ndarray, "3 3"]
    """its columns: down the slope, across it, and the normal"""
    turns: bool
    """whether a robot that is turned about the normal moves alike: where the plane is level, and neither gravity nor
    wind leans"""


def plane_of(scene: Scene) -> Plane:
    """The plane of a scene; a level one without ground. Raises `InputError` for a ground that is no plane.

    Laws of your own that do not say which symmetries they keep are taken for laws without a direction. Pushes end.
    """
    if scene.ground is not None and scene.ground.surface is not None:
        raise InputError("ground.surface: expected a plane, on which a motion can repeat itself, for an orbit")
    incline = 0.0 if scene.ground is None else scene.ground.incline
    s, c = np.sin(incline), np.cos(incline)
    axes = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    up = np.asarray(UP if scene.up is None or scene.gravity is None else scene.up, float)
    level = not incline and bool(np.allclose(up, UP, rtol=0, atol=SAME))
    nodes, members = range(len(scene.structure.nodes)), range(scene.structure.member_count)
    turn = Symmetry(tuple(nodes), TURN, tuple(members))
    directed = [law for law in scene.terms if not isinstance(law, Push) and law.keeps(turn) is False]
    return Plane(axes, level and not directed)


def shape(q: NodeVectors, plane: Plane) -> np.ndarray:
    """The invariants under motions along the plane, m, of nodes in its axes: their heights, and distances between them.

    Where a turn changes the plane: the nodes' places about their mean instead of distances.
    """
    if not plane.turns:
        return np.concatenate([q[:, 2], (q - q.mean(0))[:, :2].ravel()])
    i, j = np.triu_indices(len(q), 1)
    return np.concatenate([q[:, 2], np.linalg.norm(q[i] - q[j], axis=1)])


def cycle(shapes: Float[np.ndarray, "periods numbers"], path: Float[np.ndarray, "periods 2"], size: float) -> int:
    """The smallest number of periods after which shapes return.

    They return if their change is below `ALIKE`, or within `RETURNED` of the least over any number of periods.
    Smaller differences between numbers of periods are what is left of settling. In a cycle the path bends by a
    semicircle at most: beyond that the direction of the turn is not seen.

    Args:
        shapes: by `shape`, m.
        path: the robot's places, m.
        size: body length, m.

    Returns:
        The number, at most `MOST_PERIODS`.
    """
    steps, lags = np.diff(path, axis=0), range(1, MOST_PERIODS + 1)
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    bends = np.array([abs(np.mean(heading[n:] - heading[:-n])) for n in lags])
    changes = np.array([np.median(np.abs(shapes[n:] - shapes[:-n]).max(1)) for n in lags])
    # a single period always stays, so that there is a cycle in any case
    changes[1:][bends[1:] > np.pi] = np.inf
    return int(np.argmax(changes <= max(RETURNED * changes.min(), ALIKE * size))) + 1


def way_along(path: Float[AnyArray, "places 2"], angle: Scalar) -> Scalar:
    """The mean distance from one place to the next, along a line or about the centre of a turning motion.

    A motion that turns by `angle` (rad) from place to place is c + exp(i angle k) w_k with its centre c, and w the same
    in every cycle. Turned back, the steps of a whole cycle have the mean angle |mean w|, up to the chord of one step.
    This mean does not depend on the moment at which the cycle begins. Swaying about the mean does not count.
    """
    xp = namespace_of(path)
    (dx, dy), back = xp.diff(path, axis=0).T, angle * (xp.arange(len(path) - 1) + 0.5)
    x, y = xp.mean(xp.cos(back) * dx + xp.sin(back) * dy), xp.mean(xp.cos(back) * dy - xp.sin(back) * dx)
    return xp.sqrt(x * x + y * y) / xp.sinc(angle / (2 * np.pi))


def turned_by(share: AnyArray, before: NodeVectors, after: NodeVectors) -> Scalar:
    """The angle, rad, of the turn about the normal that moves nodes best onto others, with `share` of the mass each."""
    a, b = ((q - share @ q)[:, :2] for q in (before, after))
    across = share @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return namespace_of(across).arctan2(across, share @ (a * b).sum(1))


def moved_onto(mass: AnyArray, q: NodeVectors, other: NodeVectors, plane: Plane) -> tuple[np.ndarray, float]:
    """Nodes moved along the plane onto others by the best fit, and the angle of the turn, rad, where the plane allows
    one. Nodes are in the plane's axes."""
    share = np.asarray(mass) / np.sum(mass)
    angle = turned_by(share, q, other) if plane.turns else 0.0
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = np.column_stack([(q - share @ q)[:, :2] @ turn.T + (share @ other)[:2], q[:, 2]])
    return moved, float(angle)

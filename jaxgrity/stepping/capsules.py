"""Exact ground between the ends of struts: the planes that points of them meet in a step, and how these points move."""

from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.types import AnyArray, MemberVectors, NodeVectors, PerMember, Scalar, State
from jaxgrity.model.capsules import Capsules, Nearest, nearest
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.surface import frame_about
from jaxgrity.stepping.constraints import exact_ground
from jaxgrity.stepping.entering import Met, depth_inside

LEANING = 0.005
"""Slope of a rod to the ground, rad, up to which both ends of what lies along it are points of contact. A rod that
rocks in a step by more than that meets one end after the other."""
APART = 1e-6
"""Smallest distance of two points of contact of one rod, as a share of its length."""


class Touching(NamedTuple):
    """The points of struts that may touch the ground in a step."""

    met: Met
    """the ground that each of them meets, as a plane"""
    share: PerMember
    """s of each, its position along its strut from 0 to 1, the same for the whole step"""
    found: AnyArray
    """whether there is such a point; without one, an end is nearer"""


def capsules_of(scene: Scene) -> Capsules | None:
    """The struts that touch exact ground between their ends; None on a plane, which an end touches first."""
    ground = exact_ground(scene)
    return None if ground is None or ground.surface is None else ground.capsules


def ends_of(capsules: Capsules) -> tuple[np.ndarray, np.ndarray]:
    """Nodes i and j of each point: two points for each part of each strut."""
    i, j = (np.repeat(np.array(nodes), 2 * capsules.parts) for nodes in capsules.ends)
    return i, j


def touching_points(scene: Scene, size: Scalar, h: Scalar, start: State) -> Touching:
    """The points of struts that may touch in a step of h (s) from `start`, q, m, and v, m/s.

    Each strut has the nearest one, and where it lies along a face within `LEANING`, the other end of what lies there.
    In contact the plane has the normal at the start of the step, and the distance where the strut is if it follows the
    ground. A strut that arrives meets the plane where it first touches. Impulses are divided among both ends by 1 - s
    and s.
    """
    ground, capsules = exact_ground(scene), cast(Capsules, capsules_of(scene))
    q, way = ground.relative(start[0]), h * start[1]
    shape = len(capsules.struts), capsules.parts, 3
    rows = np.repeat(np.arange(shape[0]), shape[1] * shape[2])
    edges = np.tile(np.repeat(np.arange(shape[1]), 3), shape[0]) / capsules.parts
    part = jnp.asarray(np.stack([edges, edges + 1 / capsules.parts]), q.dtype)
    leaning = jnp.asarray(np.tile([0, LEANING, -LEANING], shape[0] * shape[1]), q.dtype)
    (i, j), radius = (np.array(nodes)[rows] for nodes in capsules.ends), capsules.radius[rows]
    a, b, way_a, way_b = q[i], q[j], way[i], way[j]

    def at(a, b) -> tuple[Nearest, AnyArray]:
        near = nearest(ground.surface, a, b, part, leaning)
        moves = way_a + near.share[:, None] * (way_b - way_a)
        return near._replace(distance=near.distance - radius), jnp.sum(moves * near.normal, axis=1)

    first, approach = at(a, b)
    gap = first.distance - depth_inside(size, q.dtype)
    # a strut in contact ends a step on the ground but for the square of its way
    moved = jnp.maximum(jnp.sum(way_a * way_a, axis=1), jnp.sum(way_b * way_b, axis=1))
    held = first.found & (gap <= moved / size)
    lands = first.found & (gap < -approach)
    share = jnp.where(lands, gap / jnp.where(lands, -approach, 1), 1)
    follows = -approach[:, None] * first.normal
    shift = lambda x: jnp.where(held[:, None], x + follows, share[:, None] * x)  # noqa: E731
    last, _ = at(a + shift(way_a), b + shift(way_b))
    last = last._replace(distance=jnp.where(last.found, last.distance, first.distance))
    # the plane at the start, at the distance at the end
    point = jax.tree.map(lambda x, y: jnp.where(held.reshape(-1, *[1] * (x.ndim - 1)), x, y), first, last)
    point = point._replace(distance=jnp.where(held, last.distance, point.distance))
    return _pairs(point, jnp.where(held, 0, share))


def _pairs(points: Nearest, share: AnyArray) -> Touching:
    """Of three points of each part, one for each leaning, the first and what is farther from it of the others."""
    each = jax.tree.map(lambda x: x.reshape(-1, 3, *x.shape[1:]), (points, share))
    s, found = each[0].share, each[0].found
    apart = jnp.where(found, jnp.abs(s - s[:, :1]), -1)
    other = jnp.where(apart[:, 1] >= apart[:, 2], 1, 2)
    chosen = jnp.stack([jnp.zeros_like(other), other], axis=1)
    two = lambda x: jnp.take_along_axis(x, chosen.reshape(*chosen.shape, *[1] * (x.ndim - 2)), 1)  # noqa: E731
    near, share = jax.tree.map(lambda x: two(x).reshape(-1, *x.shape[2:]), each)
    # one point is not to count twice
    again = jnp.stack([jnp.zeros_like(other, bool), (two(apart)[:, 1] < APART) & found[:, 0]], axis=1).ravel()
    return Touching(Met(frame_about(*near.normal.T), near.distance, share), near.share, near.found & ~again)


def points_of(touching: Touching, capsules: Capsules, x: NodeVectors) -> MemberVectors:
    """Positions or velocities of the points, from those of the nodes."""
    i, j = ends_of(capsules)
    return x[i] + touching.share[:, None] * (x[j] - x[i])


def weights_of(touching: Touching, capsules: Capsules, nodes: int) -> AnyArray:
    """(points, nodes): the share that each node has in the motion of a point."""
    (i, j), rows = ends_of(capsules), np.arange(len(touching.share))
    none = jnp.zeros((len(rows), nodes), touching.share.dtype)
    return none.at[rows, i].set(1 - touching.share).at[rows, j].set(touching.share)


def on_ends(scene: Scene, h: Scalar, start: State, impulses: AnyArray) -> list[NodeVectors]:
    """The `impulses` of the ground on the points, (points, 3), N s, on nodes: along the normal and both tangents."""
    touching = touching_points(scene, length_scale(scene), h, start)
    weights = weights_of(touching, cast(Capsules, capsules_of(scene)), len(start[0]))
    axes = touching.met.frame.normal, *touching.met.frame.tangents
    return [weights.T @ (impulses[:, k, None] * axis) for k, axis in enumerate(axes)]

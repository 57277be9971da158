"""Exact ground between the ends of struts: the planes that points of them meet in a step, and how these points move."""

from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.elementwise import rows_where
from jaxgrity.core.primitives import length
from jaxgrity.core.types import AnyArray, MemberVectors, NodeVectors, PerMember, Scalar, State
from jaxgrity.model.capsules import Capsules, Nearest, nearest
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.rods import turned
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.surface import Surface, frame_about, frame_axes
from jaxgrity.stepping.constraints import exact_ground
from jaxgrity.stepping.entering import Met, depth_inside

LEANING = 0.005
"""Slope of a rod to the ground, rad, up to which both ends of what lies along it are points of contact. A rod that
rocks in a step by more than that meets one end after the other."""
APART = 0.02
"""Smallest distance of two points of contact of one part, as a share of the strut's length. On a log, or about an edge
of a capsule, points that differ by `LEANING` are nearer than that. There the rod rocks, and has one point."""


class TouchingPoints(NamedTuple):
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


def touching_points(scene: Scene, h: Scalar, start: State) -> TouchingPoints:
    """The points of struts that may touch in a step of h (s) from `start`, q, m, and v, m/s.

    Each part of a strut has two. The first is the nearest one. In contact its plane has the normal at the start of the
    step, and the distance where the strut is if it follows the ground. If the strut arrives in the step, it is the
    plane that it touches first. The second point is where a strut in contact would end in the ground at another place.
    If a strut leans to a face by less than `LEANING`, it is the other end of the part that lies along this face.
    """
    size, rows = length_scale(scene), _rows(scene, h, start)
    first, approach = rows.at(jnp.zeros_like(rows.way[0]), jnp.zeros_like(rows.way[1]))
    gap = first.distance - depth_inside(size, rows.a.dtype)
    # a strut in contact ends a step on the ground but for the square of its way
    moved = sum(jnp.sum(way * way, axis=1) for way in rows.way)
    held = first.found & (gap <= moved / size)
    lands = first.found & ~held & (gap < -approach)
    share = jnp.where(lands, gap / jnp.where(lands, -approach, 1), 1)
    follows = -approach[:, None] * first.normal
    last, _ = rows.at(*(jnp.where(held[:, None], way + follows, share[:, None] * way) for way in rows.way))
    along = length(rows.b - rows.a) * (last.share - first.share)
    elsewhere = held & last.found & (along * along > 4 * moved)
    # the distance there is that of a strut that moves as it did, not as it follows the ground
    turned = jnp.where(held, approach * jnp.sum(first.normal * last.normal, axis=1), 0)
    late = _Planes(last._replace(distance=last.distance + turned), jnp.where(held, 1, share))
    followed = jnp.where(last.found & ~elsewhere, last.distance, first.distance)
    on_time = _Planes(first._replace(distance=followed), jnp.zeros_like(share))
    kept = held & ~(elsewhere & (rows.leaning != 0))
    return _pairs(rows_where(kept, on_time, late), late._replace(near=late.near._replace(found=elsewhere)))


class _Planes(NamedTuple):
    """What struts meet at their nearest points."""

    near: Nearest
    share: AnyArray
    """of the way in the step, at which that is"""


class _Rows(NamedTuple):
    """All parts of struts, each of them thrice: as it is, and leaning to either side."""

    surface: Surface
    a: NodeVectors
    b: NodeVectors
    way: tuple[NodeVectors, NodeVectors]
    """m, of both ends in the step"""
    part: AnyArray
    leaning: AnyArray
    radius: AnyArray

    def at(self, shift_a: NodeVectors, shift_b: NodeVectors) -> tuple[Nearest, AnyArray]:
        """The nearest points when the ends have moved by that, and the ways of these points along the normal, m."""
        near = nearest(self.surface, self.a + shift_a, self.b + shift_b, self.part, self.leaning)
        moves = self.way[0] + near.share[:, None] * (self.way[1] - self.way[0])
        return near._replace(distance=near.distance - self.radius), jnp.sum(moves * near.normal, axis=1)


def _rows(scene: Scene, h: Scalar, start: State) -> _Rows:
    ground, capsules = cast(ExactGround, scene.ground), cast(Capsules, capsules_of(scene))
    q, way, parts = ground.relative(start[0]), h * start[1], capsules.parts
    strut, part, leaning = (x.ravel() for x in np.indices((len(capsules.struts), parts, 3)))
    (i, j), dtype = (np.array(nodes)[strut] for nodes in capsules.ends), q.dtype
    edges = jnp.asarray(np.stack([part, part + 1]) / parts, dtype)
    leanings = jnp.asarray(np.array([0, LEANING, -LEANING])[leaning], dtype)
    surface = cast(Surface, ground.surface)
    return _Rows(surface, q[i], q[j], (way[i], way[j]), edges, leanings, capsules.radius[strut])


def _pairs(planes: _Planes, elsewhere: _Planes) -> TouchingPoints:
    """Of each part the first of three rows, and of both others and what the first meets `elsewhere` the farthest."""
    three, more = (jax.tree.map(lambda x: x.reshape(-1, 3, *x.shape[1:]), each) for each in (planes, elsewhere))
    four = jax.tree.map(lambda x, y: jnp.concatenate([x, y[:, :1]], axis=1), three, more)
    s, found = four.near.share, four.near.found
    apart = jnp.where(found, jnp.abs(s - s[:, :1]), -1)[:, 1:]
    second = 1 + jnp.argmax(apart, axis=1)
    chosen = jnp.stack([jnp.zeros_like(second), second], axis=1)
    two = lambda x: jnp.take_along_axis(x, chosen.reshape(*chosen.shape, *[1] * (x.ndim - 2)), 1)  # noqa: E731
    counts = jnp.stack([found[:, 0], (jnp.max(apart, axis=1) >= APART) | ~found[:, 0]], axis=1)
    near, share = jax.tree.map(lambda x: two(x).reshape(-1, *x.shape[2:]), four)
    met = Met(frame_about(*near.normal.T), near.distance, share)
    return TouchingPoints(met, near.share, near.found & counts.ravel())


def of_points(touching: TouchingPoints, capsules: Capsules, x: NodeVectors) -> MemberVectors:
    """Positions or velocities of the points, from those of the nodes."""
    i, j = ends_of(capsules)
    return x[i] + touching.share[:, None] * (x[j] - x[i])


def weights_of(scene: Scene, touching: TouchingPoints, q: NodeVectors) -> tuple[AnyArray, AnyArray]:
    """(points, nodes) each: the share that each node has in the motion of a point of the axis, and of the surface."""
    capsules = cast(Capsules, capsules_of(scene))
    (i, j), rows = ends_of(capsules), np.arange(len(touching.share))
    none = jnp.zeros((len(rows), len(q)), touching.share.dtype)
    axis = none.at[rows, i].set(1 - touching.share).at[rows, j].set(touching.share)
    each = np.repeat(np.arange(len(capsules.struts)), 2 * capsules.parts)
    arms = -jnp.asarray(capsules.radius, q.dtype)[each, None] * frame_axes(touching.met.frame)[:, 0]
    spun = turned(scene.structure, [capsules.struts[k] for k in each], arms, q)
    return axis, axis if spun is None else axis + spun


def on_ends(scene: Scene, h: Scalar, start: State, impulses: AnyArray) -> list[NodeVectors]:
    """The `impulses` of the ground on the points, (points, 3), N s, on nodes: along the normal and both tangents."""
    touching = touching_points(scene, h, start)
    axis, surface = weights_of(scene, touching, start[0])
    axes = frame_axes(touching.met.frame)
    each = enumerate((axis, surface, surface))
    return [weights.T @ (impulses[:, k, None] * axes[:, k]) for k, weights in each]

"""The place where exact ground is linearised in a step: where a node touches it first, or its next place."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.elementwise import derived_as
from jaxgrity.core.primitives import component, over
from jaxgrity.core.types import AnyArray, NodeVectors, PerNode, Scalar, State
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.surface import Frame, Surface, coordinates, frame_about, length_of

INSIDE = 1e-9
"""Depth, m for a body of one metre, from which on a node counts as inside the ground. There the nearest face still is
the one that it came through."""
ROUNDINGS = 16
"""The same depth in roundings of the body's length. The larger of both counts."""
SAME_SIDE = 0.5
"""Smallest cosine of the angle between two normals: where a node enters a solid, and where its way ends. Up to that
angle, a later step still pushes the node out of the face that it came through."""
OTHER_SIDE = 8.0
"""Factor on the node's way and on its distance from a solid. A solid that the node would leave on another side counts
as deeper by that much, so that the node meets it before all others."""
TRIALS = 16
"""Most places on a node's way at which the search for its entry looks at the ground. Most searches need two."""
FOUND = 4
"""The search ends at a place inside, if its depth there is less than this many times the depth at which the inside
begins."""

HARD = 2.0
"""Smallest speed of a hard impact, in units of the speed that a step's acceleration gives. A slower bounce lasts for a
step or two, and steps do not resolve its time."""


Coordinates = tuple[PerNode, ...]
"""x, y and z of each node, m"""


class Met(NamedTuple):
    """The exact ground that each node meets in a step, as a plane."""

    frame: Frame
    """of that plane"""
    distance: PerNode
    """phi, m, where it is laid against the ground"""
    share: PerNode | float
    """of the node's way in the step, from its start, at which that is"""


def where_met(ground: ExactGround, size: Scalar, h: Scalar, q: NodeVectors, v: NodeVectors) -> Met:
    """Where exact ground is linearised in a step of h (s) from q (m) with v (m/s).

    `size` is that of the body (`length_scale`). A plane is met at the nodes, and ground without edges where nodes, or
    balls about them, touch it first (`_followed`). Impulses move nodes a little from their way, and the gap is wrong by
    the square of that. A node whose way leads into ground with edges meets it where it enters: farther on another face
    may be nearer. One that stands meets the wall that it runs into. Of several solids it meets the one in which it
    would end deepest. A solid that it would leave on another side comes before all others: a node that lies on one
    solid may run into the next.
    """
    surface = ground.surface
    if surface is None:
        return Met(ground.frame(q), ground.signed_distance(q), 0.0)
    start, way = coordinates(ground.relative(q)), coordinates(h * v)
    if ground.balls is not None:
        surface = ground.balls.around(surface, q)
    if surface.smooth:
        *normal, distance, share = _followed(surface, size, start, way)
        return Met(frame_about(*normal), distance, share)
    shares = _shares(surface, size, start, way)
    if len(surface.solids) == 1:
        shares = jnp.where(shares > 0, shares, 1)
    each = [_met_of(solid, size, share, start, way) for solid, share in zip(surface.solids, shares)]
    which = jnp.argmin(jnp.stack([ends for ends, *_ in each]), axis=0)
    *normal, distance, at = (_chosen(which, rows) for rows in zip(*(met for _, *met in each)))
    return Met(frame_about(*normal), distance, at)


def _followed(
    surface: Surface, size: Scalar, start: Coordinates, way: Coordinates, entry: PerNode | float = 1.0
) -> list[PerNode]:
    """The normal where nodes touch a curved face first, its distance, and the share of their ways at which they do.

    The share is `entry` where that is below 1. Else it is as on flat ground: 0 in contact, 1 where nodes do not reach
    the face. The distance is that of the place where they end if they follow the face from there. So a node in contact
    has the normal at its place, and ends the step on the ground again: its impulse is that of a constraint phi(q1) = 0
    (SHAKE; Ryckaert, Ciccotti and Berendsen 1977, doi:10.1016/0021-9991(77)90098-5), which keeps the energy of a node
    that slides along a curve. The normal at its next place would brake it.
    """
    before = surface.normal(*start)
    approach = _along(way, before)
    gap = surface.distance(*start) - depth_inside(size, start[0].dtype)
    lands = (gap > 0) & (jnp.abs(approach) >= gap)
    # divided where it is chosen alone: elsewhere the quotient may have an infinite derivative, and 0 times it is NaN
    first = jnp.where(lands, gap / jnp.where(lands, jnp.abs(approach), 1), (gap > 0).astype(gap.dtype))
    share = jnp.where(entry < 1, entry, first)
    end = tuple(x + a - (1 - share) * approach * n for x, a, n in zip(start, way, before))
    # between the normals at both places: to look at the ground where it is touched would cost half as much again
    between = tuple((1 - share) * a + share * b for a, b in zip(before, surface.normal(*end)))
    norm = length_of(*between)
    normal = tuple(over(x, norm) for x in between)
    turned = (1 - share) * (_along(way, normal) - approach * _along(before, normal))
    return [*normal, surface.distance(*end) - turned, share]


def _along(way: Coordinates, normal: Coordinates) -> PerNode:
    return sum((a * n for a, n in zip(way[1:], normal[1:])), way[0] * normal[0])


def _met_of(solid: Surface, size: Scalar, share: PerNode, start: Coordinates, way: Coordinates) -> list[PerNode]:
    """How far from one solid of several nodes would end without it, m, negative inside; and where they meet it: its
    normal, distance, and share.

    From a solid that they would leave on another side they are said to end as deep as it takes to choose that one.
    """
    place = lambda s: tuple(x + s * a for x, a in zip(start, way))  # noqa: E731
    first, last = solid.normal(*place(share)), solid.normal(*place(1))
    turns = (share < 1) & (sum(a * b for a, b in zip(first, last)) < SAME_SIDE)
    share = jnp.where(turns | (share > 0), share, 1)
    normal = [jnp.where(share < 1, a, b) for a, b in zip(first, last)]
    distance = solid.distance(*place(share))
    if solid.curved:
        # where it touches its face first, unless the way leads from there to another face
        *there, farther, touched = _followed(solid, size, start, way, entry=share)
        same = ~turns & (_along(tuple(there), last) >= SAME_SIDE)
        normal = [jnp.where(same, a, b) for a, b in zip(there, normal)]
        distance, share = jnp.where(same, farther, distance), jnp.where(same, touched, share)
    ends = distance + (1 - share) * _along(way, tuple(normal))
    deepest = ends - OTHER_SIDE * (jnp.abs(distance) + sum(map(jnp.abs, way)))
    return [jnp.where(turns, deepest, ends), *normal, distance, share]


def _chosen(which: AnyArray, rows: tuple[PerNode, ...]) -> PerNode:
    """Of each node the row of the solid that it meets."""
    found = rows[0]
    for k, row in enumerate(rows[1:], 1):
        # not a gather by `which`: mapped over a population it would bring the robots to the front in memory
        found = jnp.where(which == k, row, found)
    return found


def contacts_met(ground: ExactGround, size: Scalar, h: Scalar, start: State) -> tuple[Met, NodeVectors]:
    """The ground that all nodes, or the balls, meet in a step of h (s) from `start`; and their velocities, m/s."""
    met, v = where_met(ground, size, h, *start), start[1]
    if ground.balls is None:
        return met, v
    rows = np.array(ground.balls.nodes)
    if ground.surface is None:
        return met._replace(distance=met.distance[rows]), v[rows]
    return jax.tree.map(lambda x: x[rows], met), v[rows]


def frame_met(ground: ExactGround, size: Scalar, h: Scalar, start: State) -> Frame:
    """Normal and tangents at each node's place of contact in that step."""
    return where_met(ground, size, h, *start).frame


def landings(
    ground: ExactGround, size: Scalar, h: Scalar, v: NodeVectors, met: Met
) -> tuple[PerNode, PerNode, AnyArray]:
    """Of each node its distance from the ground that it meets, m, its normal velocity, m/s, and whether it arrives
    there in a step of size h (s): a node at rest does not."""
    phi, approach = met.distance, component(v, met.frame.normal)
    gap = phi if ground.surface is None else phi - h * approach * met.share
    way = -h * approach
    return gap, approach, (way > gap) & (way > depth_inside(size, gap.dtype))


def closing_speed(ground: ExactGround, size: Scalar, h: Scalar, v: NodeVectors, met: Met) -> PerNode:
    """The normal velocity (m/s) with which each node reaches or leaves the ground in a step of size h (s).

    A negative restitution lets nodes that arrive pass (`impact_times.py`).
    """
    gap, approach, arrives = landings(ground, size, h, v, met)
    closing = -gap / h
    if ground.restitution is None:
        return closing
    # forces bring it there at the very end of the step, and it bounces in the next: that is when its impact has a time,
    # and until then derivatives are those of its flight
    late = ~arrives & (-h * approach > depth_inside(size, gap.dtype)) & (gap / h + approach < -approach / HARD)
    closing = jnp.where(late, derived_as(closing, approach), closing)
    hits = (gap + h * approach < 0) & (approach < 0)
    after = jnp.where(hits, -ground.restitution * approach, closing)
    return jnp.where((ground.restitution < 0) & arrives, after, jnp.maximum(closing, after))


class _Place(NamedTuple):
    """Of each solid and node, (solids, nodes), a place along the node's way."""

    s: AnyArray
    """share of the way"""
    f: AnyArray
    """m, the distance there, and the depth from which on a node is inside: negative in the solid"""


class _Bracket(NamedTuple):
    """The known bracket of each node's way."""

    before: _Place
    """outside, before the next"""
    out: _Place
    """the last place that is known outside"""
    inside: _Place
    """the first inside, or the end of the way"""
    trials: Any
    """how many places between were looked at"""


def _distances(surface: Surface, x: AnyArray, y: AnyArray, z: AnyArray) -> AnyArray:
    """phi, m, of each solid, (solids, nodes), at a place of each node, or at one for each solid."""
    shape = jnp.broadcast_shapes((len(surface.solids), 1), jnp.shape(x))
    places = zip(*(jnp.broadcast_to(a, shape) for a in (x, y, z)))
    return jnp.stack([solid.distance(*place) for solid, place in zip(surface.solids, places)])


# a search in a `while_loop` has no reverse mode: the derivative is that of the root that it finds
@jax.custom_jvp
def _shares(surface: Surface, size: Scalar, start: tuple[PerNode, ...], way: tuple[PerNode, ...]) -> AnyArray:
    """The share of each node's way at which it is just inside each solid; 1 where it does not enter, 0 where it was.

    From two places outside a secant leads on. It never passes the first root in a convex body, whose distance is convex
    along a line; the first secant falls as fast as any distance can. Where one leads nowhere, along a face, the bracket
    about the root is halved.
    """
    deep = depth_inside(size, start[0].dtype)
    at = lambda s: _Place(s, _distances(surface, *(x + s * a for x, a in zip(start, way))) + deep)  # noqa: E731
    none = jnp.zeros((len(surface.solids), *start[0].shape), start[0].dtype)
    first, last = at(none), at(none + 1)
    fastest = _Place(first.s - 1, first.f + jnp.sqrt(sum(a * a for a in way)))

    def goes_on(known: _Bracket) -> AnyArray:
        return jnp.any(_next(known, deep)[1]) & (known.trials < TRIALS)

    def tried(known: _Bracket) -> _Bracket:
        s, searched = _next(known, deep)
        new = at(s)
        enters, stays = searched & (new.f < 0), searched & (new.f >= 0)
        before, out = _where(stays, known.out, known.before), _where(stays, new, known.out)
        return _Bracket(before, out, _where(enters, new, known.inside), known.trials + 1)

    inside = jax.lax.while_loop(goes_on, tried, _Bracket(fastest, first, last, 0)).inside
    return jnp.where(first.f < 0, 0, jnp.where(inside.f < 0, inside.s, 1))


def depth_inside(size: Scalar, dtype: Any) -> Scalar:
    """m, from which on a point counts as inside the ground of a body of this `size`, m."""
    return jnp.asarray(size * max(INSIDE, ROUNDINGS * float(jnp.finfo(dtype).eps)), dtype)


def _next(known: _Bracket, deep: Scalar) -> tuple[AnyArray, AnyArray]:
    """The share at which to look next, and of which nodes anything is left to find."""
    before, out, inside, _ = known
    falls = before.f - out.f
    ahead = out.s + (out.f + deep) * (out.s - before.s) / jnp.where(falls > 0, falls, 1)
    leads = (falls > 0) & (ahead > out.s) & (ahead < inside.s)
    found = (inside.f < 0) & (inside.f > -FOUND * deep)
    s = jnp.where(leads, ahead, (out.s + inside.s) / 2)
    return s, (out.f >= 0) & (leads | (inside.f < 0)) & ~found


def _where(condition: AnyArray, one: _Place, other: _Place) -> _Place:
    return _Place(*(jnp.where(condition, a, b) for a, b in zip(one, other)))


@_shares.defjvp
def _shares_jvp(primals, tangents):
    """The root's: what the distance gains where the share is held, over how fast it falls along the way."""
    s = _shares(*primals)
    distances = lambda surface, _size, start, way, s: _distances(surface, *(x + s * a for x, a in zip(start, way)))  # noqa: E731
    _, gains = jax.jvp(lambda *held: distances(*held, s), primals, tangents)
    _, slope = jax.jvp(lambda s: distances(*primals, s), (s,), (jnp.ones_like(s),))
    found = (s > 0) & (s < 1) & (slope < 0)
    return s, jnp.where(found, gains, 0) / jnp.where(found, -slope, 1)

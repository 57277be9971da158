"""Exact contact between struts in a step: the planes that keep pairs of struts apart, and how their points move."""

from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.elementwise import rows_where
from jaxgrity.core.primitives import dot, inverse, length, scale
from jaxgrity.core.types import AnyArray, NodeVectors, PerMember, Scalar, State
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.strut_contact import exact_strut_contact
from jaxgrity.model.strut_pairs import (
    Ends,
    ExactStrutContact,
    Share,
    candidates,
    difference,
    nearest_share,
    turned_between,
    weights,
)
from jaxgrity.model.surface import frame_about, frame_axes
from jaxgrity.stepping.capsules import TouchingPoints, capsules_of, touching_points
from jaxgrity.stepping.entering import depth_inside

POINTS = 2
"""Points of contact of a pair. Struts that are nearly parallel need two, since they rock from one to the other."""
APART = 0.02
"""Smallest distance of both points, as a share of a strut's length."""
ADVANCES = 32
"""Most moves of two struts along their ways, each as far as they cannot touch, until they do or the step ends. Struts
that meet head-on need one or two."""
TOUCHED = 1e-3
"""Gap at which that search ends, as a share of the distance of the axes where struts touch."""


class StrutContacts(NamedTuple):
    """The points at which struts may touch each other in a step."""

    axes: AnyArray
    """(points, 3, 3): the normal, from the second strut to the first, and two tangents"""
    gap: PerMember
    """m, along the normal at the start of the step"""
    weights: AnyArray
    """(points, nodes): the share that each node has in the motion of the first strut's point against the second's"""
    surface: AnyArray
    """the same of the points at their surfaces"""
    found: AnyArray
    """whether there is such a point"""
    rows: AnyArray
    """(points,): its number among those of all pairs"""
    missed: AnyArray
    """whether a pair that is not among them may touch in the step"""


class TouchingStruts(NamedTuple):
    """Where struts may touch in a step; None: they do not."""

    ground: TouchingPoints | None = None
    each_other: StrutContacts | None = None


def touching_struts(scene: Scene, h: Scalar, start: State) -> TouchingStruts:
    """The points of struts that may touch in a step of h (s) from `start`, q, m, and v, m/s."""
    ground = None if capsules_of(scene) is None else touching_points(scene, h, start)
    return TouchingStruts(ground, strut_contacts(scene, h, start))


def points_between(scene: Scene) -> int:
    """The number of points of all pairs; 0 where no struts touch each other by impulses."""
    law = exact_strut_contact(scene)
    return 0 if law is None else POINTS * len(law.between.pairs)


def strut_contacts(scene: Scene, h: Scalar, start: State) -> StrutContacts | None:
    """The points of a step of h (s) from `start`, q, m, and v, m/s; None where no struts touch by impulses.

    A pair in contact has the normal at the start of the step. Its distance is that after the step, if it comes no
    nearer. So it stays in contact to second order. A pair that arrives in the step has the normal where it touches
    first. Any other pair has that at the end of its way. Ways are those with the velocities at the start.

    The second point is where the pair would be nearest after the step. If that is the first point, it is an end of a
    strut that would come next.
    """
    law = exact_strut_contact(scene)
    if law is None:
        return None
    between, size = law.between, length_scale(scene)
    ends, ways = between.at_ends(start[0]), between.at_ends(h * start[1])
    ends, ways, apart, numbers, missed = _near(law, ends, ways)
    # an arc of this radius leaves its chord by so much: struts in contact are no farther apart after a step
    bent = jnp.square(_reach(ways)) / (8 * apart)
    held = _least(ends) - apart <= depth_inside(size, apart.dtype) + bent
    share = jnp.where(held, 0, _first_touch(ends, ways, apart))
    there = moved_ends(ends, ways, share)
    which, beside = _features(there, ways, 1 - share)
    first, following = _kept((ends, ways), there, share, which[:, 0])
    second, _ = _kept((ends, ways), there, share, which[:, 1])
    late, elsewhere = _elsewhere(ends, following, which[:, 0])
    second = rows_where(elsewhere, late, second)
    found = jnp.stack([jnp.ones_like(beside), beside | elsewhere], axis=1).ravel()
    at, normal, distance = jax.tree.map(lambda *x: jnp.stack(x, axis=1).reshape(-1, *x[0].shape[1:]), first, second)
    gap = distance - jnp.repeat(apart, POINTS)
    rows = (POINTS * numbers[:, None] + jnp.arange(POINTS)).ravel()
    axes = frame_axes(frame_about(*normal.T))
    each = _weights(law, numbers, at, len(start[0]))
    spun = turned_between(scene.structure, between, axes[:, 0], start[0], jnp.repeat(numbers, POINTS))
    free = jnp.asarray(scene.structure.free.any(1))
    surface = each if spun is None else each + spun
    return StrutContacts(axes, gap, each, surface, found & jnp.any((each != 0) & free, axis=1), rows, missed)


def moved_ends(ends: Ends, ways: Ends, share: PerMember) -> Ends:
    """The ends after this share of their ways."""
    i, j, k, l = (x + scale(way, share) for x, way in zip(ends, ways))  # noqa: E741
    return i, j, k, l


def _near(law: ExactStrutContact, ends: Ends, ways: Ends) -> tuple[Any, Any, AnyArray, AnyArray, AnyArray]:
    """Ends, ways and distance in contact of the pairs that may touch first, their numbers, and whether others may."""
    apart, count = jnp.asarray(law.between.apart, ends[0].dtype), law.at_once
    if count == len(apart):
        return ends, ways, apart, jnp.arange(count), jnp.zeros((), bool)
    last = _least(ends) - _reach(ways) - apart
    order = jnp.argsort(jax.lax.stop_gradient(last))
    near = order[:count]
    ends, ways, apart = jax.tree.map(lambda x: x[near], (ends, ways, apart))
    return ends, ways, apart, near, last[order[count]] <= 0


def _reach(ways: Ends) -> PerMember:
    """m, by which points of both struts can come nearer in the step, at most."""
    each = [length(ways[a] - ways[b]) for a in (0, 1) for b in (2, 3)]
    return jnp.max(jnp.stack(each), axis=0)


def _least(ends: Ends) -> PerMember:
    """m, between the axes."""
    return length(difference(ends, nearest_share(ends)))


def _first_touch(ends: Ends, ways: Ends, apart: PerMember) -> PerMember:
    """The share of their ways after which struts touch first; 1 where they do not."""
    fixed = jax.lax.stop_gradient((ends, ways, apart))
    reach, enough = _reach(fixed[1]), TOUCHED * fixed[2]
    gap = lambda share: _least(moved_ends(*fixed[:2], share)) - fixed[2]  # noqa: E731

    def going(state):
        share, gap, count = state
        return jnp.any((gap > enough) & (share < 1)) & (count < ADVANCES)

    def advance(state):
        share, before, count = state
        ahead = share + jnp.maximum(before, 0) * inverse(reach)
        share = jnp.where(before > enough, jnp.where(reach > 0, jnp.minimum(ahead, 1), 1), share)
        return share, gap(share), count + 1

    start = 0 * reach
    share, *_ = jax.lax.while_loop(going, advance, (start, gap(start), 0))
    # the derivative is that of the root
    there = moved_ends(ends, ways, share)
    at = nearest_share(there)
    d = difference(there, at)
    slope = jax.lax.stop_gradient(dot(difference(ways, at), d) * inverse(length(d)))
    distance, lands = length(d) - apart, (share < 1) & (slope < 0)
    return share - jnp.where(lands, distance - jax.lax.stop_gradient(distance), 0) / jnp.where(lands, slope, 1)


class _Plane(NamedTuple):
    """What keeps both struts of a pair apart."""

    at: Share
    normal: AnyArray
    distance: PerMember
    """m, of the axes along the normal at the start of the step"""


def _kept(motion: tuple[Ends, Ends], there: Ends, share: PerMember, which: AnyArray) -> tuple[_Plane, Ends]:
    """The planes at the chosen `candidates` where the ends are `there`, after a `share` of their ways.

    And the ends after the step, if struts come no nearer at that place from there on. The distance is that of these.
    """
    ends, ways = motion
    at = _chosen(there, which)
    d = difference(there, at)
    normal = scale(d, inverse(length(d)))
    approach = dot(difference(ways, at), normal)
    back = scale(normal, (share - 1) * approach)
    i, j, k, l = (x + way for x, way in zip(ends, ways))  # noqa: E741
    following = i + back, j + back, k, l
    after = length(difference(following, _chosen(following, which)))
    return _Plane(at, normal, after - share * approach), following


def _elsewhere(ends: Ends, following: Ends, which: AnyArray) -> tuple[_Plane, AnyArray]:
    """The planes where struts would be nearest after the step, and whether that is apart from the chosen places."""
    at, place = nearest_share(following), _chosen(following, which)
    d = difference(following, at)
    normal = scale(d, inverse(length(d)))
    moves = difference(following, at) - difference(ends, at)
    apart = jnp.maximum(jnp.abs(at[0] - place[0]), jnp.abs(at[1] - place[1])) >= APART
    return _Plane(at, normal, length(d) - dot(moves, normal)), apart


def _features(there: Ends, ways: Ends, rest: PerMember) -> tuple[AnyArray, AnyArray]:
    """Of each pair, (pairs, points), which of the `candidates` its points are, and whether there is a second point.

    The second is an end, apart from the first point, that would be deepest after the `rest` of the ways.
    """
    places, crosses = candidates(there)
    each = [difference(there, place) for place in places]
    distance = jnp.stack([length(d) for d in each])
    nearest = jnp.argmin(distance.at[0].set(jnp.where(crosses, distance[0], jnp.inf)), axis=0)
    units = [scale(d, inverse(length(d))) for d in each]
    approach = jnp.stack([dot(difference(ways, place), u) for place, u in zip(places, units)])
    ends = (distance + rest * approach)[1:]
    s, t = (jnp.stack(x) for x in zip(*places))
    beside = [jnp.abs(x - jnp.take_along_axis(x, nearest[None], 0))[1:] >= APART for x in (s, t)]
    counts = beside[0] | beside[1]
    second = 1 + jnp.argmin(jnp.where(counts, ends, jnp.inf), axis=0)
    return jnp.stack([nearest, second], axis=1), jnp.any(counts, axis=0)


def _chosen(ends: Ends, which: AnyArray) -> Share:
    """The places of the chosen candidates."""
    s, t = (jnp.take_along_axis(jnp.stack(x), which[None], 0)[0] for x in zip(*candidates(ends)[0]))
    return s, t


def _weights(law: ExactStrutContact, numbers: AnyArray, at: Share, nodes: int) -> AnyArray:
    """(points, nodes)."""
    rows, found = np.arange(len(at[0])), jnp.zeros((len(at[0]), nodes), at[0].dtype)
    for each, w in zip(law.between.ends, weights(at)):
        found = found.at[rows, jnp.repeat(jnp.array(each)[numbers], POINTS)].add(w)
    return found


def struts_on_nodes(scene: Scene, h: Scalar, start: State, impulses: AnyArray) -> list[NodeVectors]:
    """The `impulses` of struts on each other, (points of all pairs, 3), N s, on nodes: along normal and tangents."""
    points = cast(StrutContacts, strut_contacts(scene, h, start))
    p = impulses[points.rows]
    each = enumerate((points.weights, points.surface, points.surface))
    return [weights.T @ (p[:, k, None] * points.axes[:, k]) for k, weights in each]

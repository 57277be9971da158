"""Struts that touch each other: where two of them are nearest, and the constraint that keeps them apart.

Two segments are x(s) = a + s d and y(t) = c + t e. At the nearest points both are perpendicular to x - y. Else one of
these points is an end of a segment.
"""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.elementwise import clipped
from jaxgrity.core.primitives import dot, inverse, length, over, place_rows, scale, take_rows
from jaxgrity.core.tracing import evaluated
from jaxgrity.core.types import AnyArray, Edges, MemberVectors, NodeVectors, PerMember, PerNode, as_float
from jaxgrity.model.laws import Constraint, Symmetry, rows_on_nodes
from jaxgrity.model.placing import TOUCHING
from jaxgrity.model.rods import Carriers, carriers_of, moved_beside
from jaxgrity.model.structure import Structure

PARALLEL = 0.75
"""Power of the precision, the square of the sine of the angle below which segments count as parallel (1e-6 rad in
float64). Then an end of one of them is nearest, to rounding."""
DEEP = 5e-4
"""Depth of struts in each other at which they may start on exact contact, m for a body of one metre."""

Share = tuple[PerMember, PerMember]
"""of each pair, the places s and t of a point along both struts, from 0 to 1"""
Ends = tuple[MemberVectors, MemberVectors, MemberVectors, MemberVectors]
"""of each pair, both ends of the first strut, then of the second, (pairs, 3) each"""


class NearestPoints(NamedTuple):
    """The nearest points of pairs of struts."""

    share: Share
    normal: MemberVectors
    """(pairs, 3), from the second strut to the first"""
    gap: PerMember
    """m, between their surfaces, negative where they overlap"""


class StrutPairs(eqx.Module):
    """Pairs of struts, or rods of bodies, that may touch."""

    pairs: Edges = eqx.field(static=True)
    """numbers of both struts of each pair, as in `rods.py`"""
    ends: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    """nodes: both ends of each first strut, then of each second"""
    radius: AnyArray = eqx.field(converter=as_float)
    """(pairs, 2), m, of both struts"""
    strength: PerMember = eqx.field(converter=as_float)
    """(pairs,), factor of the stiffness of penalty contact"""

    @property
    def apart(self) -> PerMember:
        """Distance of the axes at which the struts touch, m."""
        return self.radius.sum(1)

    def at_ends(self, x: NodeVectors) -> Ends:
        """Positions or velocities of all ends, from those of the nodes."""
        i, j, k, l = (take_rows(x, nodes) for nodes in self.ends)  # noqa: E741
        return i, j, k, l

    def nearest(self, q: NodeVectors) -> NearestPoints:
        """The nearest points, where nodes are at q, m."""
        ends = self.at_ends(q)
        share = nearest_share(ends)
        d = difference(ends, share)
        distance = length(d)
        return NearestPoints(share, scale(d, inverse(distance)), distance - self.apart)

    def on_nodes(self, force: MemberVectors, share: Share, nodes: int) -> NodeVectors:
        """(nodes, 3), from forces on the points of the first struts, N; those on the second are opposite."""
        placed = [place_rows(scale(force, w), each, nodes) for w, each in zip(weights(share), self.ends)]
        return placed[0] + placed[1] + placed[2] + placed[3]

    def mean(self, x: PerNode, share: Share) -> PerMember:
        """The mean of a number of the nodes at both points."""
        # the weights of each point add up to 1 in absolute value, and there are two points
        each = [jnp.abs(w) * take_rows(x, nodes) for w, nodes in zip(weights(share), self.ends)]
        return (each[0] + each[1] + each[2] + each[3]) / 2

    def names(self, what: str) -> tuple[str, ...]:
        return tuple(f"{what} rods {i} and {j}" for i, j in self.pairs)

    def times(self, factors: AnyArray) -> "StrutPairs":
        return eqx.tree_at(lambda p: p.strength, self, self.strength * factors)

    def keep(self, symmetry: Symmetry) -> bool:
        """Whether the symmetry maps pairs on pairs with the same radii."""
        radii = np.asarray(self.radius, float).tolist()
        rows = [(ends[:2], r, ends[2:], s) for ends, (r, s) in zip(zip(*self.ends), radii)]
        there = {frozenset([(frozenset(a), r), (frozenset(b), s)]) for a, r, b, s in rows}
        moved = lambda ends: frozenset(symmetry.nodes[k] for k in ends)  # noqa: E731
        return all(frozenset([(moved(a), r), (moved(b), s)]) in there for a, r, b, s in rows)


def weights(share: Share) -> tuple[PerMember, PerMember, PerMember, PerMember]:
    """The share of each end in x - y."""
    s, t = share
    return 1 - s, s, t - 1, -t


def difference(ends: Ends, share: Share) -> MemberVectors:
    """x - y at these places."""
    i, j, k, l = (scale(x, w) for x, w in zip(ends, weights(share)))  # noqa: E741
    return (i + k) + (j + l)


def turned_between(
    structure: Structure, between: StrutPairs, normal: MemberVectors, q: NodeVectors, rows: AnyArray | None = None
) -> AnyArray | None:
    """(pairs, nodes): the weights of nodes in the motion of the surfaces at x and y against each other, beside x - y.

    `rows`: the numbers of the pairs; by default all. None: none of the struts turns with a body.
    """
    each = [carriers_of(structure, rods) for rods in zip(*between.pairs)]
    if not any(carriers.turns.any() for carriers in each):
        return None
    radius = jnp.asarray(between.radius, q.dtype)
    if rows is not None:
        radius, each = radius[rows], [Carriers(*(jnp.asarray(x)[rows] for x in carriers)) for carriers in each]
    first, second = (moved_beside(carriers, -r[:, None] * normal, q) for carriers, r in zip(each, radius.T))
    return first + second


def candidates(ends: Ends) -> tuple[list[Share], AnyArray]:
    """The five places that may be nearest, and whether the first of them is on both segments.

    The first is where the segments cross. The others are at one end each.
    """
    d, e, r = ends[1] - ends[0], ends[3] - ends[2], ends[0] - ends[2]
    dd, ee, de, dr, er = dot(d, d), dot(e, e), dot(d, e), dot(d, r), dot(e, r)
    level = dd * ee - de * de
    # of nearly parallel segments `level` and both numerators are rounding, and an end is as near as the crossing
    leans = level > float(jnp.finfo(d.dtype).eps) ** PARALLEL * (dd * ee)
    s, t = (over(x, jnp.where(leans, level, 0 * level)) for x in (de * er - ee * dr, dd * er - de * dr))
    crosses = leans & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    none = 0 * dd
    first, second = (clipped(over(x, dd), 0.0, 1.0) for x in (-dr, de - dr))
    third, fourth = (clipped(over(x, ee), 0.0, 1.0) for x in (er, er + de))
    return [(s, t), (none, third), (none + 1, fourth), (first, none), (second, none + 1)], crosses


def nearest_share(ends: Ends) -> Share:
    """The places of the nearest points."""
    (found, *others), crosses = candidates(ends)
    least = length(difference(ends, found))
    least = jnp.where(crosses, least, least + jnp.inf)
    for other in others:
        distance = length(difference(ends, other))
        nearer = distance < least
        least = jnp.where(nearer & ~crosses, distance, least)
        s, t = (jnp.where(nearer & ~crosses, a, b) for a, b in zip(other, found))
        found = s, t
    return found


class ExactStrutContact(Constraint):
    """|x - y| >= r_i + r_j for each pair of struts, by impulses along x - y that never pull, and Coulomb's cone."""

    between: StrutPairs
    at_once: int = eqx.field(static=True)
    """number of pairs, the nearest ones, that a step solves"""
    name: ClassVar[str] = "exact contact between struts"

    def keeps(self, symmetry):
        return self.between.keep(symmetry)

    def directions(self, q, size):
        share, normal, gap = known_nearest(self.between, q)
        touching = np.flatnonzero(gap <= TOUCHING * size)
        nodes, each = np.array(self.between.ends)[:, touching].T, np.array(weights(share))[:, touching].T
        return rows_on_nodes(each[:, :, None] * np.asarray(normal)[touching, None], nodes, q.size)

    def gaps(self, q, t):
        found = known_nearest(self.between, q) if isinstance(q, np.ndarray) else self.between.nearest(q)
        return -found.gap

    @property
    def left_by_steps(self) -> float:
        return DEEP

    def complaint(self, q, t, part):
        return overlap(self.between, q, part)


def overlap(between: StrutPairs, q: np.ndarray, part: int) -> str:
    """Words for how deep the struts of a pair are in each other at q, m."""
    (i, j), depth = between.pairs[part], -known_nearest(between, q).gap[part]
    return f"rods {i} and {j} start {depth:.3g} m in each other; expected: beside each other, by their radii"


def known_nearest(between: StrutPairs, q: np.ndarray) -> NearestPoints:
    """The nearest points at known positions q, m, in float64."""
    with jax.enable_x64(True), evaluated():
        return jax.tree.map(np.asarray, between.nearest(jnp.asarray(np.asarray(q, float))))

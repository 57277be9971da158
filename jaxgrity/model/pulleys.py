"""Pulleys: cables that wrap around cylinders about the nodes through which they run.

A cable is a tangent beside a pulley, and an arc on it. Take two circles with radii r_i and r_j, whose centres are D
apart, and a cable that turns the same way about both. The tangent is sqrt(D^2 - (r_i - r_j)^2) long. It leans against
the line of centres by asin((r_i - r_j)/D). A point is a circle of radius 0. The arc is r times the angle between both
tangents.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_each, check_index, check_indices, is_count
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import length
from jaxgrity.core.types import (
    AnyArray,
    Edges,
    MemberVectors,
    NodeVectors,
    PerMember,
    Scalar,
    Vector,
    as_float,
    as_float_or_none,
    namespace_of,
)
from jaxgrity.model.clusters import Clusters, nodes_along

PARALLEL = 1e-3
"""Largest sine of the angle between the axes of two pulleys with a span between them: it errs by its square."""


class Pulley(eqx.Module):
    """A pulley without mass, over which a cable through several nodes runs: see docs/cables.md.

    Its centre is the node between two successive segments of the cable. In this order the cable turns about the axis by
    the right-hand rule. The opposite axis is the other side. A cable off the pulley is straight from neighbour to
    neighbour.

    Raises `InputError` if numbers do not fit.
    """

    between: tuple[int, int] = eqx.field(static=True)
    """numbers (from 0) of the two segments, in the order of their cluster"""
    radius: Scalar = eqx.field(converter=as_float)
    """m"""
    axis: Vector | None = eqx.field(converter=as_float_or_none, default=None)
    """(3,), direction of the axis, fixed in space, of any length; None: along the axle"""
    axle: tuple[int, int] | None = eqx.field(static=True, default=None)
    """two nodes, of the body that holds the pulley; the axis points from the first to the second"""
    turns: int = eqx.field(static=True, default=0)
    """whole turns, added to the angle between the lines to both neighbours, from -1/4 to 3/4 of a turn"""
    mu: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """coefficient of friction on a drum that turns only with its mount; None: no friction"""
    slip_speed: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """speed eps of sliding, m/s, below which friction is smoothed"""
    drum: int | None = eqx.field(static=True, default=None)
    """a node that turns about the axis with the drum, such as one of its body; None: the drum turns with none"""

    def __check_init__(self):
        between = check_indices("pulley.between", self.between)
        where = f"pulley between {list(between)}"
        if len(between) != 2:
            raise InputError(f"{where}: expected two successive cables of a cluster")
        check_each(f"{where}: radius", self.radius, shape=(), above=0.0, unit="m")
        check_each(f"{where}: axis", self.axis, shape=(3,))
        if (self.axis is None) == (self.axle is None):
            raise InputError(f"{where}: expected either an axis (a direction) or an axle (two nodes)")
        if isinstance(self.axis, np.ndarray) and not self.axis.any():
            raise InputError(f"{where}: axis = {self.axis.tolist()}: expected a direction")
        if self.axle is not None and len(set(check_indices(f"{where}: axle", self.axle))) != 2:
            raise InputError(f"{where}: axle = {list(self.axle)}: expected two nodes")
        if not is_count(self.turns, 0):
            raise InputError(f"{where}: turns = {self.turns}: expected a whole number of turns, 0 or more")
        check_each(f"{where}: mu", self.mu, shape=(), least=0.0)
        check_each(f"{where}: slip_speed", self.slip_speed, shape=(), above=0.0, unit="m/s")
        if (self.mu is None) != (self.slip_speed is None):
            raise InputError(f"{where}: mu and slip_speed belong together; expected both or none")
        if self.drum is not None:
            check_index(f"{where}: drum", self.drum)

    def direction(self, q: NodeVectors) -> Vector:
        """(3,), unit vector along the axis."""
        xp = namespace_of(q)
        a = self.axis if self.axle is None else q[self.axle[1]] - q[self.axle[0]]
        assert a is not None, "there is an axis where there is no axle"
        return a / xp.sqrt((a * a).sum())


class CableRoute(NamedTuple):
    """What of `Members` says where cables run."""

    edges: Edges
    clusters: Clusters
    pulleys: tuple[Pulley, ...]


def path_lengths(members: Any, d: MemberVectors, q: NodeVectors) -> PerMember:
    """l, m, of each of the members, or of a `CableRoute`, with the vectors `d` between nodes at `q`, m.

    Beside pulleys, a segment is its tangent and half of each arc. NaN where no cable runs like that: a node is within a
    pulley, or the cable leaves a pulley beside another one.
    """
    straight = length(d) if namespace_of(d) is jnp else np.linalg.norm(d, axis=1)
    return _paths(members, _wraps(members, d, q), straight)[0] if members.pulleys else straight


def on_drums(members: Any, d: MemberVectors, q: NodeVectors) -> tuple[dict, dict]:
    """For pulleys with friction, by what each is `between`: the angle of the arc, rad, and how far the cable has slid.

    That is half of what the side after the drum has gained, m, and the side before it has lost, up to a constant.
    Arguments are those of `path_lengths`.
    """
    wraps, slid = _wraps(members, d, q), dict[tuple[int, int], Any]()
    along, angles, leans = _paths(members, wraps, length(d))
    for wrap in (wrap for wrap in wraps if wrap.pulley.mu is not None):
        (cluster,) = (each for each in members.clusters if wrap.first in each)
        _, node, _ = way_of(members, wrap.pulley)
        drum = wrap.pulley.drum
        arm = jax.lax.stop_gradient(wrap.into) if drum is None else q[drum] - q[node]
        middle = (_angle(wrap.axis, arm, wrap.into) + _angle(wrap.axis, arm, wrap.out) + leans[wrap.between]) / 2
        after = cluster.index(wrap.last)
        more = sum(along[k] for k in cluster[after:]) - sum(along[k] for k in cluster[:after])
        slid[wrap.between] = more / 2 + wrap.pulley.radius * middle
    return angles, slid


def built_lengths(members: Any, nodes: NodeVectors) -> np.ndarray:
    """`path_lengths` with nodes as built, m; NumPy, for use before a simulation."""
    x, (i, j) = np.asarray(nodes), np.asarray(members.edges, int).reshape(-1, 2).T
    return np.asarray(path_lengths(members, x[i] - x[j], x))


def check_pulleys(members: Any) -> None:
    """Raises `InputError` for pulleys that are not between two successive segments, or there twice."""
    pairs = [list(pulley.between) for pulley in members.pulleys]
    for pulley in members.pulleys:
        if not (way := way_of(members, pulley)):
            raise InputError(
                f"pulley between {list(pulley.between)}: these do not follow each other in clusters = "
                f"{[list(cluster) for cluster in members.clusters]}; expected two cables that do, in this order"
            )
        if pairs.count(list(pulley.between)) > 1:
            raise InputError(f"pulleys between {pairs}: expected one at most between two cables")
        if pulley.drum == way[1]:
            raise InputError(
                f"pulley between {list(pulley.between)}: drum = {pulley.drum}, its centre; expected another"
            )
        if pulley.mu is not None and not way_of(members, pulley, belts=False):
            raise InputError(f"pulley between {list(pulley.between)}: friction on a closed belt; expected an open one")


def check_wraps(members: Any, nodes: NodeVectors) -> None:
    """Raises `InputError` where cables cannot run over their pulleys with the nodes as built, as far as known."""
    if members is None or not members.pulleys:
        return
    for pulley in members.pulleys:
        named = [*(pulley.axle or ()), *([] if pulley.drum is None else [pulley.drum])]
        if named and max(named) >= len(nodes):
            where = f"pulley between {list(pulley.between)}: axle or drum has node {max(named)}"
            raise InputError(f"{where}; expected 0 to {len(nodes) - 1}")
    if not all(isinstance(x, np.ndarray) for x in jax.tree.leaves((nodes, members.pulleys))):
        return
    i, j = np.asarray(members.edges, int).T
    wraps = _wraps(members, nodes[i] - nodes[j], nodes)
    for one in wraps:
        for other in wraps:
            if one.last == other.first and np.linalg.norm(np.cross(one.axis, other.axis)) > PARALLEL:
                pairs = f"{list(one.pulley.between)} and {list(other.pulley.between)}"
                raise InputError(f"pulleys between {pairs}: axes across each other; expected parallel ones, or a node")
    found = built_lengths(members, nodes)
    for wrap in wraps:
        if np.isnan(found[[wrap.first, wrap.last]]).any():
            raise InputError(
                f"pulley between {list(wrap.between)}, radius {float(wrap.pulley.radius):g} m: no cable runs "
                "over it with the nodes as built; expected neighbours farther away, and the axis on the other side if "
                "another pulley is beside it"
            )


class _Wrap(NamedTuple):
    """A pulley with the lines of centres to both its neighbours."""

    pulley: Pulley
    axis: AnyArray
    """(3,), unit vector"""
    into: AnyArray
    """(3,), m, from the neighbour before"""
    out: AnyArray
    """(3,), m, to the neighbour after"""

    @property
    def between(self) -> tuple[int, int]:
        return self.pulley.between

    @property
    def first(self) -> int:
        """The segment that ends here."""
        return self.between[0]

    @property
    def last(self) -> int:
        """The segment that begins here."""
        return self.between[1]

    @property
    def turn(self) -> Scalar:
        """Angle between both lines about the axis, rad, from -1/4 to 3/4 of a turn, and whole turns."""
        side = namespace_of(self.into).cross(self.axis, self.into)  # a quarter of a turn on
        return _angle(self.axis, side, self.out) + np.pi / 2 + 2 * np.pi * self.pulley.turns


def _angle(axis: AnyArray, one: AnyArray, other: AnyArray) -> Scalar:
    """From one direction to another, rad, about the axis."""
    xp = namespace_of(other)
    across = (one * other).sum() - (axis * one).sum() * (axis * other).sum()
    return xp.arctan2((axis * xp.cross(one, other)).sum(), across)


def _wraps(members: Any, d: MemberVectors, q: NodeVectors) -> list[_Wrap]:
    found = []
    for pulley in members.pulleys:
        (first, last), (start, node, end) = pulley.between, way_of(members, pulley)
        into = d[first] if tuple(members.edges[first]) == (node, start) else -d[first]
        out = d[last] if tuple(members.edges[last]) == (end, node) else -d[last]
        found.append(_Wrap(pulley, pulley.direction(q), into, out))
    return found


def _paths(members: Any, wraps: list[_Wrap], straight: PerMember) -> tuple[PerMember, dict, dict]:
    """`path_lengths`; the angle of each arc, rad; and by how much the sum of its tangents' directions leans, rad."""
    xp, ends, starts = namespace_of(straight), {wrap.first: wrap for wrap in wraps}, {wrap.last: wrap for wrap in wraps}
    along, lean, same = dict[int, Any](), dict[int, Any](), dict[int, Any]()
    angles, leans = dict[tuple[int, int], Any](), dict[tuple[int, int], Any]()
    for k in {**ends, **starts}:
        left = starts[k].pulley.radius if k in starts else 0.0
        right = ends[k].pulley.radius if k in ends else 0.0
        same[k] = xp.sign((starts[k].axis * ends[k].axis).sum()) if k in starts and k in ends else 1.0
        apart = left - same[k] * right
        with np.errstate(invalid="ignore"):
            along[k], lean[k] = xp.sqrt(straight[k] ** 2 - apart**2), xp.arcsin(apart / straight[k])
    for wrap in wraps:
        k, m, turn = wrap.first, wrap.last, wrap.turn
        angle, leans[wrap.between] = turn + lean[m] - same[k] * lean[k], lean[m] + same[k] * lean[k]
        off = angle < 0
        if k in starts or m in ends:
            angle = xp.where(off, np.nan, angle)
        else:
            angle, cosine = xp.where(off, 0, angle), xp.where(off, xp.cos(turn), 1)
            whole = xp.sqrt(straight[k] ** 2 + straight[m] ** 2 + 2 * straight[k] * straight[m] * cosine)
            for one, other in ((k, m), (m, k)):
                foot = straight[one] * (straight[one] + straight[other] * cosine) / whole
                along[one] = xp.where(off, foot, along[one])
        for each in (k, m):
            along[each] = along[each] + wrap.pulley.radius * angle / 2
        angles[wrap.between] = angle
    unit = np.eye(len(members.edges), dtype=straight.dtype)
    return straight + sum(unit[k] * (path - straight[k]) for k, path in along.items()), angles, leans


def way_of(members: Any, pulley: Pulley, belts: bool = True) -> tuple[int, ...]:
    """The nodes before the pulley, at its centre, and after it; none where its segments do not follow each other.

    Without `belts`, cables that end where they begin are left out.
    """
    for cluster in members.clusters:
        path = nodes_along(tuple(members.edges[k] for k in cluster))
        parts = list(zip(cluster, path, path[1:]))
        closed = parts[:1] if path[0] == path[-1] else []
        if closed and not belts:
            continue
        for (first, start, node), (last, _, end) in zip(parts, parts[1:] + closed):
            if (first, last) == pulley.between:
                return start, node, end
    return ()

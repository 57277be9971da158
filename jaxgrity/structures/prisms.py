"""Prisms and towers: rings of nodes about an axis, twisted against each other by the angle with a self-stress."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import scipy

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import Edges
from jaxgrity.structures.geometry import Geometry, at_least, at_most, check_positive, joined, ring

MOST_NODES, MOST_OVERLAPPING = 50_000, 100
"""Most nodes of one ring, summed over all stages, and most stages that overlap: those need a dense matrix six times as
large."""
SCAN = np.linspace(0.15, np.pi - 0.15, 30)
"""Twists of a tower's stages between which one that carries a stress is looked for, rad."""


def prism(struts: int = 3, radius: float = 0.3, height: float = 0.6, upper_radius: float | None = None) -> Geometry:
    """A prism of n struts and 3n cables: two n-gons, the upper one turned by pi/2 + pi/n, at any radii and height.

    Strut i goes from lower node i to upper node i, vertical cable i to upper node i - 1. At this twist alone there is a
    self-stress, with q_vertical/q_polygon = 2 sin(pi/n) and q_strut = -q_vertical where both polygons are equal, and
    it is super-stable (Connelly and Terrell 1995, Structural Topology 21, 59-78; Tibert and Pellegrino 2003).
    """
    at_least("struts", struts, 3)
    top = radius if upper_radius is None else upper_radius
    check_positive(radius=radius, height=height, upper_radius=top)
    nodes = np.concatenate([ring(struts, radius, 0.0, 0.0), ring(struts, top, np.pi / 2 + np.pi / struts, height)])
    polygons = joined(0, 0, struts, 1) + joined(struts, struts, struts, 1)
    return Geometry(nodes, joined(0, struts, struts), polygons + joined(0, struts, struts, -1))


def three_strut_robot(strut_length: float = 1.0) -> Geometry:
    """The prism of three struts and nine cables of equal length, the start of three-strut robots.

    The topology of Paul, Valero-Cuevas and Lipson's walking robot (2006). With polygons of side
    a = sqrt(3) R, vertical cables span a chord 2 R sin(pi/12) over the height, struts 2 R sin(5 pi/12).
    """
    check_positive(strut_length=strut_length)
    short, long = 2 * np.sin(np.pi / 12), 2 * np.sin(5 * np.pi / 12)
    height = np.sqrt(3 - short**2)
    scale = strut_length / np.hypot(long, height)
    return prism(3, scale, scale * height)


def tower(
    struts: int = 3, stages: int = 2, overlap: float = 0.3, radius: float = 0.3, stage_height: float = 0.6
) -> Geometry:
    """Stages of n struts with alternating twist, each overlapping the next: no two struts touch.

    `overlap` is the share of its height by which a stage reaches into the next. Between two stages, saddle cables join
    upper ring and lower ring in a zigzag. Vertical cables join lower with lower rings, and upper with upper rings. Each
    stage has diagonal cables, and both ends have a polygon. This is the "SVD" tower of Sultan, Corless and Skelton
    2001; for cylinders see Nishimura and Murakami 2001. By symmetry there are as many orbits of members as equations,
    so a stress exists where a determinant is zero: that decides the twist of the stages. With an overlap of 0 stages
    are prisms that share their rings instead, and struts meet there. Raises `InputError` where no twist carries a
    stress with every cable in tension.
    """
    at_least("struts", struts, 3)
    at_least("stages", stages, 1)
    check_positive(radius=radius, stage_height=stage_height)
    if not 0 <= overlap < 1:
        raise InputError(f"overlap = {overlap}: expected a share of a stage's height, at least 0 and less than 1")
    at_most("stages", stages, MOST_NODES // struts)
    if stages == 1 or overlap == 0:
        return _stacked_prisms(struts, stages, radius, stage_height)
    at_most("stages", stages, MOST_OVERLAPPING)
    level = [k * stage_height * (1 - overlap) for k in range(stages)]

    def shape(twist: float) -> np.ndarray:
        rings, turn = [], 0.0
        for stage, z in enumerate(level):
            upper = turn + (twist if stage % 2 == 0 else -twist)
            rings += [ring(struts, radius, turn, z), ring(struts, radius, upper, z + stage_height)]
            turn = upper + np.pi / struts
        return np.concatenate(rings)

    orbits = [joined(2 * k * struts, (2 * k + 1) * struts, struts) for k in range(stages)]
    orbits += _cable_orbits(struts, stages)
    twist = _stressed_twist(shape, orbits, stages, struts)
    if twist is None:
        raise InputError(f"overlap = {overlap}: no twist of the stages carries a stress; expected another, or 0")
    return Geometry(shape(twist), sum(orbits[:stages], ()), sum(orbits[stages:], ()))


def _cable_orbits(n: int, stages: int) -> list[Edges]:
    """Both polygons; of each stage the diagonals; of each pair of stages saddle and vertical cables."""
    last = (2 * stages - 1) * n
    orbits = [joined(0, 0, n, 1), joined(last, last, n, 1)]
    for k in range(stages):
        low, high = 2 * k * n, (2 * k + 1) * n
        left = k % 2 == 0
        orbits.append(joined(low, high, n, -1 if left else 1))
        if k + 1 < stages:
            orbits += [joined(high, high + n, n), joined(high, high + n, n, -1)]
            orbits += [joined(low, high + n, n, -1 if left else 0), joined(high, high + 2 * n, n, 0 if left else -1)]
    return orbits


def _stressed_twist(shape: Callable[[float], np.ndarray], orbits: list[Edges], stages: int, n: int) -> float | None:
    """The first twist with a stress of the orbits and tension in every cable, if any."""
    # members at the first node of each ring stand for all others: (orbit, node, its neighbour)
    ends = [(k, *pair) for k, orbit in enumerate(orbits) for i, j in orbit for pair in ((i, j), (j, i))]
    orbit, node, neighbour = np.array([end for end in ends if end[1] % n == 0]).T

    def reduced(twist: float) -> np.ndarray:
        """Equilibrium of those nodes radially, around and along the axis, for a unit force density of each orbit."""
        nodes = shape(twist)
        outward = nodes[node] * [1, 1, 0]
        d = nodes[node] - nodes[neighbour]
        rows = np.zeros((3, 2 * stages, len(orbits)))
        for axis, direction in enumerate((outward, np.cross([0, 0, 1], outward), np.tile([0, 0, 1], (len(d), 1)))):
            np.add.at(rows[axis], (node // n, orbit), (d * direction).sum(1))
        return rows.reshape(6 * stages, -1)

    def determinant(twist: float) -> float:
        # two of the equations follow from the others: no force along the axis and no moment about it is left
        rows = np.delete(reduced(twist), [2 * stages, 4 * stages], axis=0)
        sign, logarithm = np.linalg.slogdet(rows / np.linalg.norm(rows, axis=0))
        # its root of the order of its size neither over- nor underflows, and is zero where it is
        return float(sign * np.exp(logarithm / len(rows)))

    values = [determinant(twist) for twist in SCAN]
    for (low, before), (high, after) in pairwise(zip(SCAN, values)):
        if before * after < 0:
            twist = scipy.optimize.brentq(determinant, low, high, xtol=1e-15, rtol=1e-15)
            density = np.linalg.svd(reduced(twist))[2][-1]
            density = density * np.sign(density[-1])
            if np.all(density[stages:] > 0):
                return twist
    return None


def _stacked_prisms(n: int, stages: int, radius: float, height: float) -> Geometry:
    """Prisms, each on the upper polygon of the one below."""
    turn = np.pi / 2 + np.pi / n
    nodes = np.concatenate([ring(n, radius, k * turn, k * height) for k in range(stages + 1)])
    struts = sum((joined(k * n, (k + 1) * n, n) for k in range(stages)), ())
    polygons = sum((joined(k * n, k * n, n, 1) for k in range(stages + 1)), ())
    return Geometry(nodes, struts, polygons + sum((joined(k * n, (k + 1) * n, n, -1) for k in range(stages)), ()))

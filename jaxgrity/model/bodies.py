"""Rigid bodies in natural coordinates: a few basic points give a body's place, and its other points follow.

A body that moves without changing shape moves each of its points as x = sum_a w_a x_a, with the same weights w at all
times. So kinetic energy is a quadratic form of the basic points' velocities with a constant matrix, and rigidity is one
distance for each pair of them. A rod is the body of two basic points, and a strut with mass has its matrix. García de
Jalón 2007, doi:10.1007/s11044-007-9068-0.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_each, check_indices, is_count
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, Edges, NodeVectors, Scalar, Vector, as_float, as_float_or_none

FLAT = 1e-9
"""Share of the largest second moment of mass below which a body has no extent along an axis: roundings leave less."""
FAR = 0.05
"""Share of a body's size: points nearer to a line or plane through others are no good basic points with these."""
LEAST_APART = 1e-3
"""Smallest volume of three unit vectors, from a pinned node to the points that hold it: less is lost in float32."""
BESIDE_POINTS = 1e-6
"""Share of a body's size by which points may lie beside the line or the plane in which all its mass lies."""


class Body(eqx.Module):
    """A rigid body: its basic points, their nodes, and the weights of its other points. See `rigid_body`.

    Raises `InputError` for arrays that contradict each other.
    """

    points: tuple[int, ...] = eqx.field(static=True)
    """the nodes that are fixed to the body: the basic ones, the others, and the pinned ones"""
    matrix: AnyArray = eqx.field(converter=as_float)
    """(basic, basic), kg: T = 1/2 sum_ab m_ab v_a·v_b; two basic points, three or four"""
    weights: AnyArray = eqx.field(converter=as_float)
    """(others, basic): x = sum_a w_a x_a of each other point"""
    lengths: AnyArray = eqx.field(converter=as_float)
    """m, of `edges`"""
    rods: Edges = eqx.field(static=True, default=())
    """pairs of its points: lines along which contact may act as along struts"""
    pinned: tuple[tuple[int, ...], ...] = eqx.field(static=True, default=())
    """nodes that move freely, but for their distances from three points of the body: each with these three"""

    def __check_init__(self):
        count = np.shape(self.matrix)[0] if np.ndim(self.matrix) else 0
        if not all(is_count(k, 0) for k in self.points) or len(set(self.points)) < len(self.points):
            raise InputError(f"body.points = {list(self.points)}: expected numbers of nodes, each once")
        pinned = tuple(pin[0] for pin in self.pinned)
        if count not in (2, 3, 4) or len(self.points) < count + len(pinned):
            raise InputError(f"body.matrix has {count} rows; expected 2, 3 or 4, one for each basic point")
        for rod in self.rods:
            if len(rod) != 2 or rod[0] == rod[1] or not set(rod) <= set(self.points):
                raise InputError(f"body.rods has {list(rod)}: expected two of the points {list(self.points)}")
        if len(set(map(frozenset, self.rods))) < len(self.rods):
            raise InputError(f"body.rods = {list(map(list, self.rods))}: expected each pair once")
        if pinned != self.points[len(self.points) - len(pinned) :] or any(len(pin) != 4 for pin in self.pinned):
            raise InputError(f"body.pinned = {self.pinned}: expected the last points, each with three others")
        shapes = {
            "matrix": (count, count),
            "weights": (len(self.points) - count - len(pinned), count),
            "lengths": (len(self.edges),),
        }
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise InputError(f"body.{name} has shape {np.shape(getattr(self, name))}; expected {shape}")

    @property
    def basic(self) -> tuple[int, ...]:
        """The nodes of the basic points."""
        return self.points[: np.shape(self.matrix)[0]]

    @property
    def carried(self) -> tuple[int, ...]:
        """The nodes that follow the basic points."""
        return self.points[np.shape(self.matrix)[0] : len(self.points) - len(self.pinned)]

    @property
    def edges(self) -> Edges:
        """The pairs of points at constant distances: of basic points, and of pinned ones with three others."""
        pins = ((node, other) for node, *others in self.pinned for other in others)
        return (*itertools.combinations(self.basic, 2), *pins)


Bodies = tuple[Body, ...]
Joints = Sequence[int | tuple[int, int]]
"""Nodes of several bodies, or supports; two on the axis of a hinge as a pair."""


@typed
def rigid_body(
    nodes: NodeVectors,
    points: Sequence[int],
    mass: Scalar,
    inertia: AnyArray | Sequence,
    centre: AnyArray | Sequence[float] | None = None,
    basic: Joints = (),
    rods: Edges = (),
) -> Body:
    """A rigid body through some nodes, from its mass, its inertia and its centre of mass.

    Nodes of several bodies are basic points of each, where that can be. If a body has more than four, or if they lie in
    a plane, some are *pinned* instead: basic points of another body, at constant distances from three points of this
    one. Only bodies with an extent along all axes can have them.

    Args:
        nodes: all nodes of the structure at the start, m.
        points: the numbers of the body's nodes: four or more that do not lie in a plane; three in the plane of a flat
            body; two on the line of a straight one. Cables, struts, supports and contact act there.
        mass: kg.
        inertia: kg m^2 about the centre of mass along x, y and z at the start: (3, 3), or (3,) of principal axes.
            A plate has as much about its normal as about both other axes together, a rod nothing about its line.
        centre: (3,), m, of mass; by default the mean of the points.
        basic: nodes of several bodies (joints), and supports. The first ones become basic points, if they can. Give the
            two nodes of a hinge as a pair, since the other body holds their distance too.
        rods: pairs of points: lines along which the body may touch, as struts do (docs/terrain.md). By default it
            touches at its points alone.

    Returns:
        The body, one of `Structure.bodies`. It is the same in any pose; its numbers may be traced but for `nodes`.

    Raises:
        InputError: no body has such an inertia, or the points do not determine the body's pose.

    Example:
        >>> ends = np.array([[0.0, 0, 0], [1, 0, 0]])
        >>> jaxgrity.model.rigid_body(ends, (0, 1), 6.0, [0.0, 0.5, 0.5]).matrix.round(9).tolist()
        [[2.0, 1.0], [1.0, 2.0]]
    """
    x = np.asarray(as_float(nodes))
    check_each("rigid_body: nodes", x, shape=(len(x) if x.ndim else 0, 3))
    hinges = tuple((joint[0], joint[-1]) for joint in basic if isinstance(joint, Sequence))
    if any(isinstance(joint, Sequence) and len(joint) != 2 for joint in basic):
        raise InputError(f"rigid_body: basic = {list(basic)}: expected nodes, and pairs of them for hinges")
    named = dict.fromkeys(k for joint in basic for k in (joint if isinstance(joint, Sequence) else (joint,)))
    points, joints = (check_indices("rigid_body: points", given, len(x)) for given in (points, [*named]))
    mass, moments, middle = as_float(mass), as_float(inertia), as_float_or_none(centre)
    check_each("rigid_body: mass", mass, shape=(), above=0.0, unit="kg")
    check_each("rigid_body: centre", middle, shape=(3,))
    check_each("rigid_body: inertia", moments)
    if not points or not set(joints) <= set(points):
        raise InputError(f"rigid_body: points = {list(points)}: expected some, the basic ones too")
    if np.shape(moments) not in ((3,), (3, 3)):
        raise InputError(f"rigid_body: inertia has shape {np.shape(moments)}; expected (3, 3), or (3,)")
    made = _body(x, points, (mass, moments, x[list(points)].mean(0) if middle is None else middle), joints, hinges)
    return dataclasses.replace(made, rods=tuple((int(i), int(j)) for i, j in rods))


def _body(x: np.ndarray, points: tuple, inertia: tuple, basic: tuple, hinges: Edges) -> Body:
    """`rigid_body`, of mass, inertia and centre."""
    mass, moments, middle = inertia
    known = not traced(inertia)
    xp = np if known else jnp
    moments = xp.diag(moments) if np.ndim(moments) == 1 else moments
    spread = xp.trace(moments) / 2 * xp.eye(3) - moments
    axes = _axes(spread, float(mass)) if known else np.eye(3)
    size = np.ptp(x[list(points)], axis=0).max()
    if known:
        _check_beside(x, points, middle, axes, size)
    tries = [_spanning(x, points, axes, basic, size, least) for least in (FAR, BESIDE_POINTS)]
    chosen = next((each for each in tries if set(basic) <= set(each)), tries[0])
    pinned = _pinned(x, chosen, tuple(k for k in basic if k not in chosen), hinges)
    others = tuple(k for k in points if k not in chosen and k not in basic)
    # 1 and the place within the line, plane or space in which the mass lies: what a linear function of points takes
    affine = lambda which: xp.concatenate(  # noqa: E731
        [xp.ones((len(which), 1)), (x[list(which)].reshape(-1, 3) - middle) @ axes.T], axis=1
    )
    inverse = xp.linalg.inv(affine(chosen))
    whole = xp.concatenate(
        [
            xp.stack([xp.asarray(mass, float), *xp.zeros(len(axes))])[None],
            xp.concatenate([xp.zeros((len(axes), 1)), axes @ spread @ axes.T], axis=1),
        ]
    )
    pairs = [*itertools.combinations(chosen, 2), *((node, other) for node, *three in pinned for other in three)]
    lengths = np.linalg.norm(x[[i for i, _ in pairs]] - x[[j for _, j in pairs]], axis=1)
    nodes = (*chosen, *others, *(node for node, *_ in pinned))
    return Body(nodes, inverse.T @ whole @ inverse, affine(others) @ inverse, lengths, pinned=pinned)


@typed
def body_moments(body: Body, q: NodeVectors) -> tuple[Scalar, Vector, AnyArray]:
    """Mass, kg, centre of mass, (3,), m, and the inertia about it along x, y and z, (3, 3), kg m^2, of nodes at q."""
    x = q[np.array(body.basic)]
    mass, first = body.matrix.sum(), body.matrix.sum(0) @ x
    r = x - first / mass
    second = r.T @ body.matrix @ r
    return mass, first / mass, second.trace() * np.eye(3) - second


def with_factors(body: Body, mass: Scalar = 1.0, inertia: Scalar = 1.0) -> Body:
    """The body with factors on its mass, and on its inertia about the centre of mass, which stays where it is."""
    whole = body.matrix
    total, shares = whole.sum((0, 1)), whole.sum(0)
    of_centre = shares[:, None] * shares[None] / total
    return eqx.tree_at(lambda b: b.matrix, body, mass * of_centre + inertia * (whole - of_centre))


def _axes(spread: np.ndarray, mass: float) -> np.ndarray:
    """(axes, 3): the unit vectors along which a body of these second moments (kg m^2) extends."""
    moments, vectors = np.linalg.eigh((spread + spread.T) / 2)
    if not (mass > 0 and np.isfinite(mass)) or not moments.max() > 0:
        raise InputError(f"rigid_body: mass = {mass:g} kg, inertia {spread.trace() * 2 / 3:.3g}: expected both above 0")
    if not np.allclose(spread, spread.T, rtol=0, atol=FLAT * moments.max()) or moments.min() < -FLAT * moments.max():
        raise InputError(
            "rigid_body: no body has this inertia; expected a symmetric matrix, none of whose principal moments is "
            "more than the sum of the other two"
        )
    return vectors[:, moments > FLAT * moments.max()].T[::-1]


def _check_beside(x: np.ndarray, points: tuple, middle: np.ndarray, axes: np.ndarray, size: float) -> None:
    """Refuse points beside the line or plane of a body without extent across it."""
    r = x[list(points)] - middle
    off = np.linalg.norm(r - r @ axes.T @ axes, axis=1)
    if off.max() > BESIDE_POINTS * size:
        raise InputError(
            f"rigid_body: node {points[int(off.argmax())]} lies {off.max():.3g} m beside the "
            f"{'line' if len(axes) == 1 else 'plane'} of a body without thickness; expected points on it, or another "
            "inertia"
        )


def _spanning(
    x: np.ndarray, points: tuple, axes: np.ndarray, given: tuple, size: float, least: float
) -> tuple[int, ...]:
    """The basic points: `given` ones that are far from the point, line or plane before, or else the farthest point."""
    chosen: list[int] = []
    left = x[list(points)] @ axes.T
    left = left - left.mean(0)
    for number in range(len(axes) + 1):
        away = np.linalg.norm(left, axis=1)
        far = [
            points.index(k) for k in given if k not in chosen and (not chosen or away[points.index(k)] > least * size)
        ]
        best = max(far[:1] or range(len(points)), key=lambda k: (away[k], -k))
        if number and away[best] <= BESIDE_POINTS * size:
            what = {1: "two points on its line", 2: "three points in its plane", 3: "four points not in a plane"}
            raise InputError(
                f"rigid_body: points {list(points)} do not say where the body is; expected {what[len(axes)]}"
            )
        chosen.append(points[best])
        if not number:
            left = left - left[best]
        else:
            axis = left[best] / away[best]
            left = left - np.outer(left @ axis, axis)
    return tuple(chosen)


def _pinned(x: np.ndarray, basic: tuple, nodes: tuple, hinges: Edges) -> tuple[tuple[int, ...], ...]:
    """Each of these nodes with the three points of the body that hold it best.

    A distance that another body holds, too, is among those: then it counts once, and no constraint follows from others.
    """
    if nodes and len(basic) < 4:
        raise InputError(
            f"rigid_body: basic = {[*basic, *nodes]}: a body without extent along an axis has at most {len(basic)} "
            "joints and supports; expected an inertia with extent along all axes"
        )
    pins: list[tuple[int, ...]] = []
    for node in nodes:
        before = (*basic, *(pin[0] for pin in pins))
        held = {other for pair in hinges if node in pair for other in pair if other != node and other in before}
        threes = [three for three in itertools.combinations((*basic, *(held - {*basic})), 3) if held <= {*three}]
        best = max(threes, key=lambda three: _apart(x[list(three)] - x[node]), default=())
        if not best or _apart(x[list(best)] - x[node]) <= LEAST_APART:
            raise InputError(
                f"rigid_body: points {list(before)} do not hold node {node}; expected points farther apart, and no "
                "more joints and supports than hold the body"
            )
        pins.append((node, *best))
    return tuple(pins)


def _apart(ways: np.ndarray) -> float:
    """How far three directions are from a plane: the volume that their unit vectors span."""
    return abs(float(np.linalg.det(ways / np.linalg.norm(ways, axis=1)[:, None])))

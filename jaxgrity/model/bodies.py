"""Rigid bodies in natural coordinates: a few basic points give a body's place, and its other points follow.

A body that moves without changing shape moves each of its points as x = sum_a w_a x_a, with the same weights w at all
times. So kinetic energy is a quadratic form of the basic points' velocities with a constant matrix, and rigidity is one
distance for each pair of them. A rod is the body of two basic points, and a strut with mass has its matrix. García de
Jalón 2007, doi:10.1007/s11044-007-9068-0.
"""

import dataclasses
import itertools
from collections import Counter
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
BESIDE_POINTS = 1e-6
"""Share of a body's size by which points may lie beside the line or the plane in which all its mass lies."""


class Body(eqx.Module):
    """A rigid body: its basic points, their nodes, and the weights of its other points. See `rigid_body`.

    Raises `InputError` for arrays that contradict each other.
    """

    points: tuple[int, ...] = eqx.field(static=True)
    """the nodes that are fixed to the body, the basic ones first"""
    matrix: AnyArray = eqx.field(converter=as_float)
    """(basic, basic), kg: T = 1/2 sum_ab m_ab v_a·v_b; two basic points, three or four"""
    weights: AnyArray = eqx.field(converter=as_float)
    """(others, basic): x = sum_a w_a x_a of each other point"""
    lengths: AnyArray = eqx.field(converter=as_float)
    """m, between the basic points, in the order of `edges`"""
    rods: Edges = eqx.field(static=True, default=())
    """pairs of its points: lines along which contact may act as along struts"""

    def __check_init__(self):
        count = np.shape(self.matrix)[0] if np.ndim(self.matrix) else 0
        if not all(is_count(k, 0) for k in self.points) or len(set(self.points)) < len(self.points):
            raise InputError(f"body.points = {list(self.points)}: expected numbers of nodes, each once")
        if count not in (2, 3, 4) or len(self.points) < count:
            raise InputError(f"body.matrix has {count} rows; expected 2, 3 or 4, one for each basic point")
        for rod in self.rods:
            if len(rod) != 2 or rod[0] == rod[1] or not set(rod) <= set(self.points):
                raise InputError(f"body.rods has {list(rod)}: expected two of the points {list(self.points)}")
        if len(set(map(frozenset, self.rods))) < len(self.rods):
            raise InputError(f"body.rods = {list(map(list, self.rods))}: expected each pair once")
        pairs = (count * (count - 1) // 2,)
        shapes = {"matrix": (count, count), "weights": (len(self.points) - count, count), "lengths": pairs}
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise InputError(f"body.{name} has shape {np.shape(getattr(self, name))}; expected {shape}")

    @property
    def basic(self) -> tuple[int, ...]:
        """The nodes of the basic points."""
        return self.points[: np.shape(self.matrix)[0]]

    @property
    def carried(self) -> tuple[int, ...]:
        """The nodes of the other points."""
        return self.points[np.shape(self.matrix)[0] :]

    @property
    def edges(self) -> Edges:
        """The pairs of basic points."""
        return tuple(itertools.combinations(self.basic, 2))


Bodies = tuple[Body, ...]


@typed
def rigid_body(
    nodes: NodeVectors,
    points: Sequence[int],
    mass: Scalar,
    inertia: AnyArray | Sequence,
    centre: AnyArray | Sequence[float] | None = None,
    basic: Sequence[int] = (),
    rods: Edges = (),
) -> Body:
    """A rigid body through some nodes, from its mass, its inertia and its centre of mass.

    Args:
        nodes: all nodes of the structure at the start, m.
        points: the numbers of the body's nodes: four or more that do not lie in a plane; three in the plane of a flat
            body; two on the line of a straight one. Cables, struts, supports and contact act there.
        mass: kg.
        inertia: kg m^2 about the centre of mass along x, y and z at the start: (3, 3), or (3,) of principal axes.
            A plate has as much about its normal as about both other axes together, a rod nothing about its line.
        centre: (3,), m, of mass; by default the mean of the points.
        basic: the points that must be basic: nodes of several bodies (joints), and supports.
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
    points, basic = (check_indices("rigid_body: points", given, len(x)) for given in (points, basic))
    mass, moments, middle = as_float(mass), as_float(inertia), as_float_or_none(centre)
    check_each("rigid_body: mass", mass, shape=(), above=0.0, unit="kg")
    check_each("rigid_body: centre", middle, shape=(3,))
    check_each("rigid_body: inertia", moments)
    if not points or not set(basic) <= set(points):
        raise InputError(f"rigid_body: points = {list(points)}: expected some, the basic ones too")
    if np.shape(moments) not in ((3,), (3, 3)):
        raise InputError(f"rigid_body: inertia has shape {np.shape(moments)}; expected (3, 3), or (3,)")
    made = _body(x, points, (mass, moments, x[list(points)].mean(0) if middle is None else middle), basic)
    return dataclasses.replace(made, rods=tuple((int(i), int(j)) for i, j in rods))


def _body(x: np.ndarray, points: tuple, inertia: tuple, basic: tuple) -> Body:
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
    chosen = _spanning(x, points, axes, basic, size)
    others = tuple(k for k in points if k not in chosen)
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
    lengths = [np.linalg.norm(x[i] - x[j]) for i, j in itertools.combinations(chosen, 2)]
    return Body((*chosen, *others), inverse.T @ whole @ inverse, affine(others) @ inverse, np.array(lengths))


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


def check_bodies(bodies: Bodies, nodes: int, fixed: Sequence[int]) -> None:
    """Raises `InputError` for bodies with missing nodes, and for a carried point that is fixed or in another body."""
    joined = Counter(k for body in bodies for k in body.points)
    for number, body in enumerate(bodies):
        if max(body.points) >= nodes:
            raise InputError(f"structure.bodies[{number}] has node {max(body.points)}; expected 0 to {nodes - 1}")
        if shared := sorted(k for k in body.carried if joined[k] > 1 or k in set(fixed)):
            raise InputError(
                f"structure.bodies[{number}]: node {shared[0]} is fixed, or a point of another body too, and follows "
                f"basic points here; expected rigid_body(..., basic=({shared[0]},))"
            )


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


def _spanning(x: np.ndarray, points: tuple, axes: np.ndarray, given: tuple, size: float) -> tuple[int, ...]:
    """The basic points: the `given` ones, then the farthest from the point, line or plane before."""
    chosen: list[int] = []
    left = x[list(points)] @ axes.T
    left = left - left.mean(0)
    for number in range(len(axes) + 1):
        away = np.linalg.norm(left, axis=1)
        candidates = [points.index(k) for k in given[number : number + 1]] or list(range(len(points)))
        best = max(candidates, key=lambda k: (away[k], -k))
        if number and away[best] <= BESIDE_POINTS * size:
            what = {1: "two points on its line", 2: "three points in its plane", 3: "four points not in a plane"}
            raise InputError(
                f"rigid_body: points {list(points)} do not say where the body is; expected {what[len(axes)]}, as basic "
                "points too"
            )
        chosen.append(points[best])
        if not number:
            left = left - left[best]
        else:
            axis = left[best] / away[best]
            left = left - np.outer(left @ axis, axis)
    if set(given) - set(chosen):
        raise InputError(f"rigid_body: basic = {list(given)}: expected at most {len(axes) + 1} points of this body")
    return tuple(chosen)

"""Solids with closed-form signed distances: balls and bowls, boxes, cylinders, stairs."""

import itertools
from typing import ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_count, check_each
from jaxgrity.core.elementwise import larger, magnitude, smaller
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import positive_part
from jaxgrity.core.types import AnyArray, PerNode, Scalar, Vector, as_float, namespace_of
from jaxgrity.model.surface import Surface, length_of

EDGE = 1e-12
"""Distance, as a fraction of a solid's size, at which a vertical line beside it still meets its edge: room for
rounding."""

CORNERS = np.array([*itertools.product((-1.0, 1.0), repeat=3)])
"""Corners of a cube about the origin."""


class Sphere(Surface):
    """A ball, f = |x - c| - r. If hollow, the ground is everything outside of it: a bowl for robots."""

    centre: AnyArray = eqx.field(converter=as_float)
    """(3,), centre c, m"""
    radius: Scalar = eqx.field(converter=as_float)
    """radius r, m"""
    hollow: bool = eqx.field(static=True, default=False)
    curved: ClassVar[bool] = True
    smooth = property(lambda self: self.hollow)

    def __check_init__(self):
        if self.hollow not in (True, False):
            raise InputError(f"sphere.hollow = {self.hollow!r}: expected True or False")
        check_each("sphere.centre", self.centre, shape=(3,))
        check_each("sphere.radius", self.radius, shape=(), above=0.0, unit="m")

    def level(self, x, y, z):
        f = length_of(x - self.centre[0], y - self.centre[1], z - self.centre[2]) - self.radius
        return -f if self.hollow else f

    def height(self, x, y):
        square = self.radius**2 - (x - self.centre[0]) ** 2 - (y - self.centre[1]) ** 2
        depth = jnp.sqrt(jnp.maximum(square, 0))
        if self.hollow:
            return self.centre[2] - depth
        return jnp.where(square < 0, -jnp.inf, self.centre[2] + depth)


class Box(Surface):
    """A block, turned about the vertical or about any axis; its edges may be rounded."""

    centre: AnyArray = eqx.field(converter=as_float)
    """(3,), centre, m"""
    size: AnyArray = eqx.field(converter=as_float)
    """(3,), size along its own axes, m"""
    turn: Scalar | Vector = eqx.field(converter=as_float, default=0.0)
    """turn about z, from x towards y, rad; or (3,), about any axis: a vector along it, of the angle's size, rad"""
    rounding: Scalar = eqx.field(converter=as_float, default=0.0)
    """radius of its edges, m"""

    def __check_init__(self):
        check_each("box.centre", self.centre, shape=(3,))
        check_each("box.size", self.size, shape=(3,), above=0.0, unit="m")
        check_each("box.turn", self.turn, shape=(3,) if np.ndim(self.turn) else ())
        _check_rounding("box", self.rounding, self.size)

    @property
    def axes(self) -> AnyArray:
        """(3, 3), its own three axes, unit vectors in rows."""
        xp, upright = namespace_of(self.turn), np.ndim(self.turn) == 0
        x, y, z = (0.0, 0.0, self.turn) if upright else cast(AnyArray, self.turn)
        square = x * x + y * y + z * z
        angle = xp.sqrt(xp.where(square > 0, square, 1.0))
        a, b = (xp.where(square > 0, way, 1.0) for way in (xp.sin(angle) / angle, (1 - xp.cos(angle)) / angle**2))
        cross = xp.stack([xp.stack(row) for row in ((0 * x, z, -y), (-z, 0 * y, x), (y, -x, 0 * z))])
        return xp.eye(3, dtype=cross.dtype) + a * cross + b * cross @ cross

    @property
    def corners(self) -> AnyArray:
        """(8, 3), m."""
        return self.centre + (CORNERS * self.size / 2) @ self.axes

    def level(self, x, y, z):
        if np.ndim(self.turn):
            away = (x - self.centre[0], y - self.centre[1], z - self.centre[2])
            ways = [sum(n * d for n, d in zip(axis, away)) for axis in self.axes]
        else:
            ways = [*self._turned(x, y), z - self.centre[2]]
        return _beyond_faces([magnitude(way) - side / 2 for way, side in zip(ways, self.size)], self.rounding)

    def height(self, x, y):
        if np.ndim(self.turn):
            return _from_above(self, x, y, self.centre[2], jnp.linalg.norm(self.size) / 2)
        beyond = [jnp.maximum(abs(a) - s / 2 + self.rounding, 0) for a, s in zip(self._turned(x, y), self.size)]
        return self.centre[2] + self.size[2] / 2 - _fall(jnp.hypot(*beyond), self.rounding)

    def _turned(self, x, y):
        """Coordinates along the two level axes of an upright box, from its centre."""
        x, y, cosine, sine = x - self.centre[0], y - self.centre[1], jnp.cos(self.turn), jnp.sin(self.turn)
        return cosine * x + sine * y, cosine * y - sine * x


class Cylinder(Surface):
    """A round bar with flat ends, such as a log or a post."""

    curved: ClassVar[bool] = True

    start: AnyArray = eqx.field(converter=as_float)
    """(3,), middle of one end, m"""
    end: AnyArray = eqx.field(converter=as_float)
    """(3,), middle of the other end, m"""
    radius: Scalar = eqx.field(converter=as_float)
    """radius, m"""
    rounding: Scalar = eqx.field(converter=as_float, default=0.0)
    """radius of the edges of its ends, m"""

    def __check_init__(self):
        check_each("cylinder.start", self.start, shape=(3,))
        check_each("cylinder.end", self.end, shape=(3,))
        check_each("cylinder.radius", self.radius, shape=(), above=0.0, unit="m")
        known = isinstance(self.start, np.ndarray) and isinstance(self.end, np.ndarray)
        if known and np.all(self.start == self.end):
            raise InputError(f"cylinder.end = {self.end.tolist()}: start is there too; expected two points apart")
        # ends rounder than half of the length would make it thinner than its radius
        length = np.linalg.norm(self.end - self.start) if known else np.inf
        _check_rounding("cylinder", self.rounding, self.radius * 2, length)

    def level(self, x, y, z):
        axis = self.end - self.start
        size = jnp.sqrt(axis @ axis)
        unit = [axis[k] / size for k in range(3)]
        middle = (self.start + self.end) / 2
        a = [x - middle[0], y - middle[1], z - middle[2]]
        ahead = sum(n * d for n, d in zip(unit, a))
        out = length_of(*(d - n * ahead for n, d in zip(unit, a)))
        return _beyond_faces([out - self.radius, magnitude(ahead) - size / 2], self.rounding)

    def height(self, x, y):
        reach = jnp.linalg.norm(self.end - self.start) / 2 + self.radius
        return _from_above(self, x, y, (self.start[2] + self.end[2]) / 2, reach)


class Stairs(Surface):
    """Steps that rise along +x over the whole width; before the first step the ground is level at 0."""

    rise: Scalar = eqx.field(converter=as_float)
    """height of each step, m"""
    run: Scalar = eqx.field(converter=as_float)
    """length of each step, m; the last step never ends"""
    steps: int = eqx.field(static=True, default=1)
    start: Scalar = eqx.field(converter=as_float, default=0.0)
    """position of the first step's face along the direction of rise, m"""
    turn: Scalar = eqx.field(converter=as_float, default=0.0)
    """turn of that direction about z, from x towards y, rad"""
    rounding: Scalar = eqx.field(converter=as_float, default=0.0)
    """radius of the steps' edges, m"""

    def __check_init__(self):
        check_count("stairs.steps", self.steps, 1)
        check_each("stairs.rise", self.rise, shape=(), above=0.0, unit="m")
        check_each("stairs.run", self.run, shape=(), above=0.0, unit="m")
        check_each("stairs.start", self.start, shape=())
        check_each("stairs.turn", self.turn, shape=())
        _check_rounding("stairs", self.rounding, np.inf if self.steps == 1 else self.run)

    def level(self, x, y, z):
        ahead = self._ahead(x, y)
        f = z
        for k in range(self.steps):
            # each step is a block without an end, so that no gap is left between two of them
            faces = [self.start + k * self.run - ahead, z - (k + 1) * self.rise]
            f = smaller(f, _beyond_faces(faces, self.rounding))
        return f

    def height(self, x, y):
        ahead, highest = self._ahead(x, y) - self.start, 0 * x
        for k in range(self.steps):
            beyond = jnp.maximum(k * self.run + self.rounding - ahead, 0)
            highest = jnp.maximum(highest, (k + 1) * self.rise - _fall(beyond, self.rounding))
        return highest

    def _ahead(self, x, y):
        return jnp.cos(self.turn) * x + jnp.sin(self.turn) * y


def _beyond_faces(outside: list[PerNode], rounding: Scalar) -> PerNode:
    """Signed distance of a solid with faces at right angles, from the distances `outside` of each face, m."""
    beyond = [way + rounding for way in outside]
    deepest = beyond[0]
    for way in beyond[1:]:
        deepest = larger(deepest, way)
    # min(deepest, 0), by what keeps the population last in memory
    inside = deepest - positive_part(deepest)
    return length_of(*(positive_part(way) for way in beyond)) + inside - rounding


def _fall(beyond: AnyArray, rounding: Scalar) -> AnyArray:
    """Drop of a rounded edge below its top face, m, at a distance `beyond` the flat part."""
    return jnp.where(beyond > rounding, jnp.inf, rounding - jnp.sqrt(jnp.maximum(rounding**2 - beyond**2, 0)))


def _from_above(solid: Surface, x: AnyArray, y: AnyArray, middle: Scalar, reach: Scalar) -> AnyArray:
    """`Surface.height` of a convex solid within `reach` of a height `middle`.

    Its distance is convex along a vertical line: a ternary search finds the minimum, and bisection the zero above it.
    """
    f = solid.level
    low = jnp.broadcast_to(jnp.asarray(middle - reach, jnp.result_type(x, middle)), jnp.shape(x))
    high = low + 2 * reach

    def thirds(_, ends):
        low, high = ends
        first, second = low + (high - low) / 3, high - (high - low) / 3
        falls = f(x, y, first) > f(x, y, second)
        return jnp.where(falls, first, low), jnp.where(falls, high, second)

    def halves(_, ends):
        low, high = ends
        inside = f(x, y, (low + high) / 2) <= EDGE * reach
        return jnp.where(inside, (low + high) / 2, low), jnp.where(inside, high, (low + high) / 2)

    deepest, _ = jax.lax.fori_loop(0, 90, thirds, (low, high))
    z, _ = jax.lax.fori_loop(0, 60, halves, (deepest, high))
    return jnp.where(f(x, y, deepest) <= EDGE * reach, z, -jnp.inf)


def _check_rounding(kind: str, value: Scalar, *sizes: AnyArray | Scalar) -> None:
    check_each(f"{kind}.rounding", value, shape=(), least=0.0, unit="m")
    known = isinstance(value, np.ndarray) and not any(isinstance(size, jax.Array) for size in sizes)
    if known and not 0 <= value <= min(map(np.min, sizes)) / 2:
        raise InputError(f"{kind}.rounding = {value}: expected a radius from 0 to half of its smallest side")

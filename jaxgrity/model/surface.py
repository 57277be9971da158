"""Where the ground is: surfaces as signed distances. Any way to push back (`ground.py`) goes with any of them."""

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.elementwise import larger, magnitude, smaller
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import along, component, inner, ones, over, positive_part
from jaxgrity.core.tracing import as_incline
from jaxgrity.core.types import AnyArray, NodeVectors, PerNode, Scalar, as_float

AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
Direction = tuple[float, float, float] | NodeVectors
"""a unit vector: one for all nodes, or a row for each"""


class Frame(NamedTuple):
    """Three unit vectors at right angles: out of the ground, and two along it."""

    normal: Direction
    tangents: tuple[Direction, Direction]


class Measured(NamedTuple):
    """Of positions, in NumPy."""

    distance: np.ndarray
    """(...,), m, signed"""
    axes: np.ndarray
    """(..., 3, 3), the normal and two tangents"""


class Surface(eqx.Module):
    """Where the ground is, in place of a plane. Written for coordinates x, y, z, one number a node, element by element.
    Signed distance phi = f/|grad f|, and normal n = grad f/|grad f|, with f = `level` and its gradient by `jax.grad`.
    Where f is a distance itself, phi = f; elsewhere phi is one to first order near the surface.
    """

    @abstractmethod
    def level(self, x: PerNode, y: PerNode, z: PerNode) -> PerNode:
        """f, m: 0 on the surface, positive above it, negative inside."""

    @abstractmethod
    def height(self, x: AnyArray, y: AnyArray) -> AnyArray:
        """m, z of the highest point of the ground at (x, y); -infinity where there is none."""

    @property
    def level_is_distance(self) -> bool:
        """Whether |grad f| = 1."""
        return True

    @property
    def smooth(self) -> bool:
        """Whether the normal changes little on a node's way in a step: no edges, and no bodies to pass through."""
        return False

    @property
    def solids(self) -> tuple["Surface", ...]:
        """What it is made of, each of which a node enters by itself."""
        return (self,)

    def signed_distance(self, q: NodeVectors) -> PerNode:
        """phi, m, of each node."""
        return self.distance(*coordinates(q))

    def frame(self, q: NodeVectors) -> Frame:
        """n at each node, and two tangents."""
        return frame_about(*self.normal(*coordinates(q)))

    def normal(self, x: PerNode, y: PerNode, z: PerNode) -> tuple[PerNode, PerNode, PerNode]:
        """The three components of n at coordinates."""
        slopes = _gradient(self.level, x, y, z)
        size = _length(*slopes)
        a, b, c = (over(slope, size) for slope in slopes)
        return a, b, c

    def distance(self, x: PerNode, y: PerNode, z: PerNode) -> PerNode:
        """phi, m, at coordinates."""
        f = self.level(x, y, z)
        return f if self.level_is_distance else f / _length(*_gradient(self.level, x, y, z))


class Slope(Surface):
    """A plane through the origin that falls towards +x: f = x sin theta + z cos theta."""

    incline: float = eqx.field(static=True, converter=as_incline, default=0.0)
    """theta, rad"""
    smooth: ClassVar[bool] = True

    def level(self, x, y, z):
        return math.sin(self.incline) * x + math.cos(self.incline) * z

    def height(self, x, y):
        return -math.tan(self.incline) * x


class Sphere(Surface):
    """f = |x - c| - r; hollow, the ground is all but the ball: a bowl, of which the lower half can be stood in."""

    centre: AnyArray = eqx.field(converter=as_float)
    """c, (3,), m"""
    radius: Scalar = eqx.field(converter=as_float)
    """r, m"""
    hollow: bool = eqx.field(static=True, default=False)
    smooth = property(lambda self: self.hollow)

    def __check_init__(self):
        _check_size("sphere", "radius", self.radius)

    def level(self, x, y, z):
        f = _length(x - self.centre[0], y - self.centre[1], z - self.centre[2]) - self.radius
        return -f if self.hollow else f

    def height(self, x, y):
        square = self.radius**2 - (x - self.centre[0]) ** 2 - (y - self.centre[1]) ** 2
        depth = jnp.sqrt(jnp.maximum(square, 0))
        if self.hollow:
            return self.centre[2] - depth
        return jnp.where(square < 0, -jnp.inf, self.centre[2] + depth)


class Box(Surface):
    """A block with its sides upright, turned about the vertical; its edges may be rounded."""

    centre: AnyArray = eqx.field(converter=as_float)
    """(3,), m"""
    size: AnyArray = eqx.field(converter=as_float)
    """(3,), m, along its own axes"""
    turn: Scalar = eqx.field(converter=as_float, default=0.0)
    """rad, about z, from x towards y"""
    rounding: Scalar = eqx.field(converter=as_float, default=0.0)
    """m, radius of its edges"""

    def __check_init__(self):
        _check_size("box", "size", self.size)
        _check_rounding("box", self.rounding, self.size)

    def level(self, x, y, z):
        ways = (*self._turned(x, y), z - self.centre[2])
        return _beyond_faces([magnitude(way) - side / 2 for way, side in zip(ways, self.size)], self.rounding)

    def height(self, x, y):
        inside = [abs(a) <= s / 2 for a, s in zip(self._turned(x, y), self.size)]
        return jnp.where(inside[0] & inside[1], self.centre[2] + self.size[2] / 2, -jnp.inf)

    def _turned(self, x, y):
        """Along the box's own two level axes, from its centre."""
        x, y, cosine, sine = x - self.centre[0], y - self.centre[1], jnp.cos(self.turn), jnp.sin(self.turn)
        return cosine * x + sine * y, cosine * y - sine * x


class Cylinder(Surface):
    """A round bar with flat ends, such as a log that lies or a post that stands."""

    start: AnyArray = eqx.field(converter=as_float)
    """(3,), m, the middle of one end"""
    end: AnyArray = eqx.field(converter=as_float)
    """(3,), m, of the other"""
    radius: Scalar = eqx.field(converter=as_float)
    """m"""
    rounding: Scalar = eqx.field(converter=as_float, default=0.0)
    """m, radius of the edges of its ends"""

    def __check_init__(self):
        _check_size("cylinder", "radius", self.radius)
        _check_rounding("cylinder", self.rounding, self.radius * 2)
        if isinstance(self.start, np.ndarray) and isinstance(self.end, np.ndarray) and np.all(self.start == self.end):
            raise InputError(f"cylinder.end = {self.end.tolist()}: start is there too; expected two points apart")

    def level(self, x, y, z):
        axis = self.end - self.start
        size = jnp.sqrt(axis @ axis)
        unit = [axis[k] / size for k in range(3)]
        middle = (self.start + self.end) / 2
        a = [x - middle[0], y - middle[1], z - middle[2]]
        ahead = sum(n * d for n, d in zip(unit, a))
        out = _length(*(d - n * ahead for n, d in zip(unit, a)))
        return _beyond_faces([out - self.radius, magnitude(ahead) - size / 2], self.rounding)

    def height(self, x, y):
        return _from_above(self, x, y, jnp.maximum(self.start[2], self.end[2]) + self.radius)


class Stairs(Surface):
    """Steps that rise along +x, each over the whole width; before the first the ground is level at 0."""

    rise: Scalar = eqx.field(converter=as_float)
    """m, of each step"""
    run: Scalar = eqx.field(converter=as_float)
    """m, length of each step; the last one goes on for ever"""
    steps: int = eqx.field(static=True, default=1)
    start: Scalar = eqx.field(converter=as_float, default=0.0)
    """m, along the direction in which they rise, of the first step's face"""
    turn: Scalar = eqx.field(converter=as_float, default=0.0)
    """rad, of that direction about z, from x towards y"""
    rounding: Scalar = eqx.field(converter=as_float, default=0.0)
    """m, radius of the steps' edges"""

    def __check_init__(self):
        for name in ("rise", "run"):
            _check_size("stairs", name, getattr(self, name))
        _check_rounding("stairs", self.rounding, np.inf if self.steps == 1 else self.run)
        if self.steps < 1:
            raise InputError(f"stairs.steps = {self.steps}: expected at least 1")

    def level(self, x, y, z):
        ahead = self._ahead(x, y)
        f = z
        for k in range(self.steps):
            faces = [self.start + k * self.run - ahead, z - (k + 1) * self.rise]
            f = smaller(f, _beyond_faces(faces, self.rounding))
        return f

    def height(self, x, y):
        return self.rise * jnp.clip(jnp.floor((self._ahead(x, y) - self.start) / self.run) + 1, 0, self.steps)

    def _ahead(self, x, y):
        return jnp.cos(self.turn) * x + jnp.sin(self.turn) * y


def frame_about(x: PerNode, y: PerNode, z: PerNode) -> Frame:
    """The normal with these components, and two tangents that turn with it (Duff et al. 2017,
    jcgt.org/published/0006/01/01).
    """
    sign = 1 - 2 * (z < 0).astype(z.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    first = rows_of_xyz(1 + sign * x * x * a, sign * b, -sign * x)
    return Frame(rows_of_xyz(x, y, z), (first, rows_of_xyz(b, sign + y * y * a, -y)))


def coordinates(q: NodeVectors) -> tuple[PerNode, PerNode, PerNode]:
    """x, y and z of each node."""
    x, y, z = (component(q, axis) for axis in AXES)
    return x, y, z


def rows_of_xyz(x: PerNode, y: PerNode, z: PerNode) -> NodeVectors:
    """The inverse of `coordinates`."""
    parts = [along(s, axis) for s, axis in zip((x, y, z), AXES)]
    return parts[0] + parts[1] + parts[2]


def as_double(part):
    """The same with every number in float64."""
    return jax.tree.map(lambda x: np.asarray(x, float), part)


def _gradient(f: Callable, *x: PerNode) -> tuple[PerNode, ...]:
    """df/dx of an elementwise function of several arrays, each by itself."""
    return jax.grad(lambda *x: inner(f(*x), ones(x[0])), tuple(range(len(x))))(*x)


def _length(*parts: PerNode) -> PerNode:
    """The root of the sum of squares, with derivative 0 where all are 0."""
    first, *others = (part * part for part in parts)
    square = sum(others, first)
    positive = (square > 0).astype(square.dtype)
    return positive * jnp.sqrt(square + (1 - positive))


def _beyond_faces(outside: list[PerNode], rounding: Scalar) -> PerNode:
    """Signed distance of a solid with faces at right angles, from how far `outside` of each a node is, m."""
    beyond = [way + rounding for way in outside]
    deepest = beyond[0]
    for way in beyond[1:]:
        deepest = larger(deepest, way)
    inside = deepest - positive_part(deepest)
    return _length(*(positive_part(way) for way in beyond)) + inside - rounding


def _from_above(surface: Surface, x: AnyArray, y: AnyArray, top: Scalar) -> AnyArray:
    """`Surface.height` of one whose f is a distance: from the height `top` down by f, which never goes too far."""
    f = surface.level
    z = jnp.broadcast_to(jnp.asarray(top, jnp.result_type(x, top)), jnp.shape(x))
    z = jax.lax.fori_loop(0, 64, lambda _, z: z - f(x, y, z), z)
    return jnp.where(f(x, y, z) < 1e-6, z, -jnp.inf)


def _check_size(kind: str, name: str, value: AnyArray | Scalar) -> None:
    if isinstance(value, np.ndarray) and not np.all(value > 0):
        raise InputError(f"{kind}.{name} = {value.tolist()}: expected positive numbers")


def _check_rounding(kind: str, value: Scalar, size: AnyArray | Scalar) -> None:
    known = isinstance(value, np.ndarray) and not isinstance(size, jax.Array)
    if known and not 0 <= value <= np.min(size) / 2:
        raise InputError(f"{kind}.rounding = {value}: expected a radius from 0 to half of its smallest side")

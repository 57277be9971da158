"""Shapes of the ground as signed distances. Every contact model (`ground.py`) works with every surface."""

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_all_finite
from jaxgrity.core.primitives import along, component, inner, ones, over
from jaxgrity.core.tracing import as_incline, evaluated
from jaxgrity.core.types import AnyArray, NodeVectors, PerNode

AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""Unit vectors along x, y and z."""
Direction = tuple[float, float, float] | NodeVectors
"""A unit vector for all nodes, or one row per node."""


class Frame(NamedTuple):
    """Three orthogonal unit vectors: the normal out of the ground, and two tangents."""

    normal: Direction
    tangents: tuple[Direction, Direction]


class DistanceAndAxes(NamedTuple):
    """Signed distances of positions from the ground, and the axes there, as NumPy arrays."""

    distance: np.ndarray
    """(...,), signed distance, m"""
    axes: np.ndarray
    """(..., 3, 3), normal and two tangents"""


class Surface(eqx.Module):
    """Interface of ground surfaces. You write f = `level`, element by element, for coordinates x, y, z of the nodes.

    The signed distance is phi = f/|grad f|, and the normal is n = grad f/|grad f|. `jax.grad` gives the gradient. If f
    is a distance, phi = f. Otherwise phi is a distance to first order near the surface.
    """

    def __check_init__(self):
        check_all_finite(self, type(self).__name__.lower())

    @abstractmethod
    def level(self, x: PerNode, y: PerNode, z: PerNode) -> PerNode:
        """f, m: 0 on the surface, positive above, negative inside."""

    @abstractmethod
    def height(self, x: AnyArray, y: AnyArray) -> AnyArray:
        """Highest z of the ground at (x, y), m; -infinity without ground."""

    @property
    def level_is_distance(self) -> bool:
        """Whether |grad f| = 1."""
        return True

    @property
    def smooth(self) -> bool:
        """Whether the normal changes little over a step: no edges, and no thin bodies to pass through."""
        return False

    @property
    def curved(self) -> bool:
        """Whether it has faces that are not flat, such as a ball's: nodes in contact follow them within a step."""
        return False

    @property
    def solids(self) -> tuple["Surface", ...]:
        """Parts of the surface that nodes can enter separately."""
        return (self,)

    def signed_distance(self, q: NodeVectors) -> PerNode:
        """(nodes,), phi, m."""
        return self.distance(*coordinates(q))

    def frame(self, q: NodeVectors) -> Frame:
        """Normal and two tangents at each node."""
        return frame_about(*self.normal(*coordinates(q)))

    def normal(self, x: PerNode, y: PerNode, z: PerNode) -> tuple[PerNode, PerNode, PerNode]:
        """Components of the normal n at coordinates."""
        slopes = _gradient(self._level, x, y, z)
        size = length_of(*slopes)
        a, b, c = (over(slope, size) for slope in slopes)
        return a, b, c

    def distance(self, x: PerNode, y: PerNode, z: PerNode) -> PerNode:
        """phi, m, at coordinates."""
        f = self._level(x, y, z)
        return f if self.level_is_distance else f / length_of(*_gradient(self._level, x, y, z))

    def _level(self, x: PerNode, y: PerNode, z: PerNode) -> PerNode:
        """f in the precision of the coordinates: a user's own level or heights may hold numbers in another."""
        return jnp.asarray(self.level(x, y, z), x.dtype)


class Slope(Surface):
    """A plane through the origin that falls towards +x: f = x sin theta + z cos theta."""

    incline: float = eqx.field(static=True, converter=as_incline, default=0.0)
    """angle theta, rad"""
    smooth: ClassVar[bool] = True

    def level(self, x, y, z):
        return math.sin(self.incline) * x + math.cos(self.incline) * z

    def height(self, x, y):
        return -math.tan(self.incline) * x


def frame_axes(frame: Frame) -> AnyArray:
    """(points, 3, 3), the normal and the tangents of each point's own frame."""
    return jnp.stack([jnp.asarray(axis) for axis in (frame.normal, *frame.tangents)], axis=1)


def frame_about(x: PerNode, y: PerNode, z: PerNode) -> Frame:
    """The normal with these components, and two tangents that vary smoothly with it.

    Duff et al. 2017, jcgt.org/published/0006/01/01.
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
    """The part with all numbers in float64."""
    return jax.tree.map(lambda x: np.asarray(x, float), part)


def height_at(surface: Surface, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Highest z of the ground at x, y, m, in float64. Do not use it in rollouts."""
    x, y = np.broadcast_arrays(x, y)
    with jax.enable_x64(True), evaluated():
        z = _height(as_double(surface), _padded(x.ravel()), _padded(y.ravel()))
    return np.asarray(z)[: x.size].reshape(x.shape)


def measured_at(ground: Any, q: np.ndarray) -> DistanceAndAxes:
    """Distances and frames at positions `q` (..., nodes, 3), m, in float64, of a ground or a surface."""
    rows = q.reshape(-1, *q.shape[-2:])
    with jax.enable_x64(True), evaluated():
        phi, axes = (np.asarray(part)[: len(rows)] for part in _measured(as_double(ground), _padded(rows)))
    return DistanceAndAxes(phi.reshape(q.shape[:-1]), axes.reshape(*q.shape[:-1], 3, 3))


def _padded(rows: np.ndarray) -> np.ndarray:
    """Rows padded to the next power of two, so that growing paths share compiled programs."""
    return np.resize(rows, (1 << max(len(rows) - 1, 0).bit_length(), *rows.shape[1:]))


@eqx.filter_jit
def _height(surface: Surface, x: PerNode, y: PerNode) -> AnyArray:
    return surface.height(x, y)


@eqx.filter_jit
def _measured(ground: Any, q: AnyArray) -> tuple[AnyArray, AnyArray]:
    def each(q: NodeVectors) -> tuple[PerNode, AnyArray]:
        frame = ground.frame(q)
        return ground.signed_distance(q), jnp.stack([frame.normal, *frame.tangents], axis=-2)

    return jax.vmap(each)(q)


def _gradient(f: Callable, *x: PerNode) -> tuple[PerNode, ...]:
    """Partial derivatives of an elementwise function of several arrays."""
    return jax.grad(lambda *x: inner(f(*x), ones(x[0])), tuple(range(len(x))))(*x)


def length_of(*parts: PerNode) -> PerNode:
    """Root of the sum of squares, with derivative 0 if all are 0."""
    first, *others = (part * part for part in parts)
    square = sum(others, first)
    positive = (square > 0).astype(square.dtype)
    return positive * jnp.sqrt(square + (1 - positive))

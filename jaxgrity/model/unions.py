"""Unions of surfaces, such as an obstacle on a plane."""

import itertools
from collections.abc import Iterator
from typing import cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.elementwise import smaller
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import evaluated, traced
from jaxgrity.core.types import AnyArray
from jaxgrity.model.solids import Box, Cylinder
from jaxgrity.model.surface import Surface

TOUCHING = 1e-6
"""Largest gap between two surfaces that count as touching, as a fraction of the solid's size."""
OPPOSITE = -0.999
"""Largest cosine of the angle between the normals of two faces that touch."""
INNER = 0.98 * np.linspace(-1, 1, 5)
"""Positions on a face where other faces are searched, in halves of its size."""


class Union(Surface):
    """A union of surfaces: phi is the smallest of their distances, exact outside all of them.

    Solids that touch must overlap by more than nodes sink into them. On a common wall phi is 0, and nodes would pass
    through. A step of exact contact sees one face per node: a node that lands in a corner may sink into the other face
    for a step, and be pushed out. Walls must be thicker than the distance that a node moves in a step.

    Raises `InputError` if a face of a box or an end of a cylinder lies on another part.
    """

    parts: tuple[Surface, ...]

    def __check_init__(self):
        if not (isinstance(self.parts, tuple) and self.parts and all(isinstance(part, Surface) for part in self.parts)):
            parts = type(self.parts).__name__ if isinstance(self.parts, list) else self.parts
            raise InputError(f"union.parts = {parts}: expected at least one surface, in a tuple")
        if traced(self.parts):
            return
        solids = self.solids
        for first, second, below in _touching(solids):
            raise InputError(
                f"union: a face of part {first} ({_name(solids[first])}) lies on part {second} "
                f"({_name(solids[second])}), and nodes would pass between them; expected solids that overlap"
                + (_hint(solids[first]) if below else "")
            )

    @property
    def solids(self):
        return tuple(solid for part in self.parts for solid in part.solids)

    def level(self, x, y, z):
        first, *others = (part.distance(x, y, z) for part in self.parts)
        for f in others:
            first = smaller(first, f)
        return first

    def height(self, x, y):
        first, *others = (part.height(x, y) for part in self.parts)
        for h in others:
            first = jnp.maximum(first, h)
        return first


def _hint(part: Surface) -> str:
    """Text of a box with the same top that reaches further down, as a proposal."""
    if not isinstance(part, Box) or np.ndim(part.turn):
        return ""
    size = np.asarray(part.size, float)
    lower, longer = np.asarray(part.centre, float) - [0, 0, size[2] / 2], size * [1, 1, 2]
    centre, size = np.round(lower, 9).tolist(), np.round(longer, 9).tolist()
    return f", such as centre = {centre}, size = {size}, which has the same top"


def _name(part: Surface) -> str:
    return type(part).__name__.lower()


def _touching(parts: tuple[Surface, ...]) -> Iterator[tuple[int, int, bool]]:
    """Pairs of parts of which a face of the first lies on the second, and whether it is the bottom face.

    Faces inside a third part do not count.
    """
    for (i, part), (j, other) in itertools.permutations(enumerate(parts), 2):
        faces = _faces(part)
        if faces is None:
            continue
        points, normals, size = faces
        with evaluated():
            distance, normal = _met(other, points)
            touching = (np.abs(distance) <= TOUCHING * size) & (np.sum(normal * normals, axis=1) < OPPOSITE)
            if not touching.any():
                continue
            for third in (part for k, part in enumerate(parts) if k not in (i, j)):
                touching &= np.asarray(_met(third, points)[0]) > -TOUCHING * size
        if touching.any():
            yield i, j, bool(normals[touching][0, 2] < OPPOSITE)


@eqx.filter_jit
def _met(surface: Surface, points: AnyArray) -> tuple[AnyArray, AnyArray]:
    return surface.signed_distance(points), cast(AnyArray, surface.frame(points).normal)


def _faces(part: Surface) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Points on the flat faces of a solid, (points, 3), normals there, and its size, m; None for other surfaces."""
    if isinstance(part, Box):
        half, axes = np.asarray(part.size, float) / 2, np.asarray(part.axes, float)
        a, b = (x.ravel() for x in np.meshgrid(INNER, INNER))
        points, normals = [], []
        for axis, side in itertools.product(range(3), (-1.0, 1.0)):
            points.append(np.insert(np.stack([a, b], 1), axis, side, axis=1) * half)
            normals.append(np.tile(side * np.eye(3)[axis], (len(a), 1)))
        at = np.concatenate(points) @ axes + np.asarray(part.centre, float)
        return at, np.concatenate(normals) @ axes, float(half.max())
    if isinstance(part, Cylinder):
        start, end = np.asarray(part.start, float), np.asarray(part.end, float)
        axis = (end - start) / np.linalg.norm(end - start)
        across = np.linalg.svd(axis[None])[2][1:]
        a, b = (x.ravel() for x in np.meshgrid(INNER, INNER))
        within = a * a + b * b <= 1
        disc = float(part.radius) * np.stack([a[within], b[within]], 1) @ across
        outward = np.repeat([-axis, axis], len(disc), axis=0)
        return np.concatenate([start + disc, end + disc]), outward, float(np.linalg.norm(end - start))
    return None

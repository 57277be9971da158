"""The equilibria of a structure whose loads grow, past limit points, and where on the way something happens."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import NodeVectors
from jaxgrity.model.scene import Scene
from jaxgrity.model.springs import largest_force, smallest_stiffness
from jaxgrity.statics.slide_springs import Tangent
from jaxgrity.statics.spring_struts import with_spring_struts
from jaxgrity.statics.stiffness import coordinate_map, factor_if_definite, tangent_of

FIRST, LONGEST = 0.05, 0.05
"""First step as a share of the whole loads, and the longest one as a share of the structure's size."""
GROWTH, SHORTEST, QUICK = 1.5, 1e-6, 5
"""Factor by which steps grow after at most `QUICK` Newton iterations; the shortest step as a share of the longest."""
ITERATIONS, STEPS, HALVINGS = 12, 2000, 30
"""Most Newton iterations for a point, steps of a path, and halvings of the step in which something happens."""
RESISTED = 1e-8
"""Stiffness of a motion that counts as none, as a share of the softest member's."""


class PathPoint(NamedTuple):
    """An equilibrium under a share of the loads."""

    q: NodeVectors
    """m"""
    factor: float
    """load factor"""
    stable: bool
    """whether U less the loads' work rises in every direction, and the loads grow along the path"""
    direction: np.ndarray
    """unit vector along the path: free coordinates, and the load factor times `LoadPath.scale`, m"""
    iterations: int


class LoadPath:
    """The equilibria K(q) dq = f d(factor) from one on, by the length of the path (Riks 1979,
    doi:10.1016/0020-7683(79)90081-7).

    Raises `InputError` where a motion meets no resistance there.
    """

    def __init__(self, scene: Scene, first: NodeVectors, loads: NodeVectors, factor: float = 0.0):
        springs = with_spring_struts(scene)
        self._tangent = tangent_of(springs)
        whole, self._free = coordinate_map(scene.structure)
        self._place = whole[:, self._free]
        self._pull = self._place.T @ np.asarray(loads, float).ravel()
        rounding = 100 * np.finfo(float).eps * largest_force(springs.structure)
        self._limit = max(1e-10 * largest_force(scene.structure), rounding)
        self._least = RESISTED * smallest_stiffness(springs.structure)
        q = np.asarray(first, float)
        self.size = float(np.linalg.norm(np.ptp(q, axis=0)))
        K = self._stiffness(self._tangent(q))
        if not self._resists(K):
            raise InputError(
                "the structure does not resist every motion; expected supports (structure.fixed) that hold it, and "
                "prestress where it has mechanisms"
            )
        along = spla.splu(sp.csc_matrix(K)).solve(self._pull)
        self.scale = float(np.linalg.norm(along)) or self.size
        """m for a load factor of 1"""
        along = np.r_[along, self.scale]
        self.start = PathPoint(q, factor, True, along / np.linalg.norm(along), 0)

    def points(self) -> Iterator[PathPoint]:
        """Points of the path, one after the other, until no next one is found."""
        longest = LONGEST * self.size
        here, step = self.start, min(FIRST * np.sqrt(2) * self.scale, longest)
        yield here
        for _ in range(STEPS):
            new = self._next(here, step * here.direction, step)
            while new is None and step > SHORTEST * longest:
                step /= 4
                new = self._next(here, step * here.direction, step)
            if new is None:
                return
            step = min(step * (GROWTH if new.iterations <= QUICK else 1.0), longest)
            here = new
            yield here

    def between(self, before: PathPoint, after: PathPoint, happened: Callable[[PathPoint], bool]) -> PathPoint:
        """The first point of the step after which something has happened, to rounding."""
        for _ in range(HALVINGS):
            chord = self._chord(before, after)
            new = self._next(before, chord / 2, float(np.linalg.norm(chord)))
            if new is None:
                break
            before, after = (before, new) if happened(new) else (new, after)
        return after

    def at(self, factor: float, before: PathPoint, after: PathPoint) -> PathPoint:
        """The point of the step at this load factor; its begin where none is found."""
        chord = self._chord(before, after)
        share = (factor - before.factor) / (after.factor - before.factor)
        loads = np.eye(1, len(chord), len(chord) - 1)[0]
        return self._next(before, share * chord, float(np.linalg.norm(chord)), loads) or before

    def _chord(self, before: PathPoint, after: PathPoint) -> np.ndarray:
        return np.r_[(after.q - before.q).ravel()[self._free], self.scale * (after.factor - before.factor)]

    def _next(
        self, here: PathPoint, ahead: np.ndarray, within: float, normal: np.ndarray | None = None
    ) -> PathPoint | None:
        """The equilibrium in the plane at the end of the vector `ahead`, m, normal to it or to another unit vector.

        None where Newton's method finds none `within` a distance, m, of that end.
        """
        direction = ahead / np.linalg.norm(ahead) if normal is None else normal
        last, moved = np.inf, np.zeros(len(ahead))
        q, factor = here.q.copy(), here.factor + ahead[-1] / self.scale
        q += (self._place @ ahead[:-1]).reshape(q.shape)
        for iteration in range(ITERATIONS):
            tangent = self._tangent(q)
            force = factor * self._pull - self._place.T @ tangent.gradient.ravel()
            left = float(np.abs(force).max())
            K = self._stiffness(tangent)
            solve = self._bordered(K, direction)
            if solve is None or not np.isfinite(left) or np.linalg.norm(moved) > within:
                return None
            if left <= self._limit and left >= last / 10:
                along = solve(np.r_[np.zeros(len(force)), 1.0])
                stable = along[-1] > 0 and self._resists(K)
                return PathPoint(q, float(factor), stable, along / np.linalg.norm(along), iteration)
            last, change = left, solve(np.r_[force, 0.0])
            moved = moved + change
            q = q + (self._place @ change[:-1]).reshape(q.shape)
            factor += change[-1] / self.scale
        return None

    def _stiffness(self, tangent: Tangent) -> sp.csc_array:
        """K of the free coordinates, N/m."""
        return sp.csc_array(self._place.T @ tangent.stiffness() @ self._place)

    def _bordered(self, K: sp.csc_array, direction: np.ndarray) -> Callable | None:
        column = sp.csc_array(-self._pull[:, None] / self.scale)
        row, corner = sp.csc_array(direction[None, :-1]), sp.csc_array(direction[None, -1:])
        weight = float(K.diagonal().max(initial=1.0))
        whole = sp.csc_matrix(sp.block_array([[K, column], [weight * row, weight * corner]]))
        try:
            solve = spla.splu(whole).solve
        except RuntimeError:  # exactly singular
            return None
        return lambda right: solve(np.r_[right[:-1], weight * right[-1]])

    def _resists(self, K: sp.csc_array) -> bool:
        return factor_if_definite(sp.csc_array(K - self._least * sp.eye_array(K.shape[0], format="csc"))) is not None

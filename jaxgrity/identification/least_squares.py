"""Residuals of a scene beside what was measured, and Levenberg and Marquardt's method for their squares."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.linalg

from jaxgrity.core.types import AnyArray
from jaxgrity.identification.measurements import Measurement
from jaxgrity.identification.parameters import Parameter, changed

FIRST_DAMPING, SMALLEST_DAMPING, LARGEST_DAMPING = 1e-3, 1e-9, 1e8
"""of Levenberg and Marquardt's steps, relative to the curvature along each unknown"""
ROUGHNESS = 3e-6
"""of the sum of squares: what a step changes by less is not worth another"""


class Problem(eqx.Module):
    """What is to be fitted. Its arrays are inputs of what is compiled, so that new data compile nothing."""

    scene: eqx.Module
    parameters: tuple[Parameter, ...] = eqx.field(static=True)
    every: tuple[Measurement, ...]
    starts: tuple[tuple[AnyArray, AnyArray], ...]
    """of each measurement: further unknowns, a guess and its standard deviation"""

    @property
    def sizes(self) -> list[int]:
        return [len(self.parameters), *(len(guess) for guess, _ in self.starts)]

    def split(self, y) -> list:
        """The z of the parameters, and the further unknowns of each measurement, from multiples of their spreads."""
        z, *further = jnp.split(y, np.cumsum(self.sizes)[:-1])
        return [z, *(guess + spread * own for (guess, spread), own in zip(self.starts, further))]

    def misses(self, y):
        """Residuals of the data, 0 where they are missing, and of what goes with them, in standard deviations.

        And their derivatives by y, (residuals, unknowns).
        """
        z, *starts = self.split(y)
        found, slopes, first = [], [], len(z)
        for each, start, (_, spread) in zip(self.every, starts, self.starts):
            (seen, further), (by_y, further_by_y) = each.linearised(self._scene_at, z, start)
            missing = jnp.isnan(each.values)
            miss = jnp.where(missing, 0, (seen - jnp.nan_to_num(each.values)) / each.noise).ravel()
            by_y = jnp.where(missing[..., None], 0, by_y / each.noise[..., None]).reshape(miss.size, -1)
            own = jnp.concatenate([by_y, further_by_y])
            columns = jnp.zeros((len(own), len(y))).at[:, : len(z)].set(own[:, : len(z)])
            slopes.append(columns.at[:, first : first + len(start)].set(own[:, len(z) :] * spread))
            found += [miss, further]
            first += len(start)
        return jnp.concatenate(found), jnp.concatenate(slopes)

    def _scene_at(self, z):
        return changed(self.scene, self.parameters, z)


def fitting_problem(scene, parameters, every) -> Problem:
    return Problem(scene, tuple(parameters), every, tuple(each.starts() for each in every))


class Point(NamedTuple):
    """Unknowns in multiples of their spreads, and the residuals of the data with their derivatives there."""

    y: np.ndarray
    r: np.ndarray
    J: np.ndarray

    @property
    def cost(self) -> float:
        """The sum of squares, y itself included; infinite where a rollout fails."""
        cost = float(self.r @ self.r + self.y @ self.y)
        return cost if np.isfinite(cost) else np.inf


class Found(NamedTuple):
    at: Point
    converged: bool
    steps: int


def least_squares(problem: Problem, at: Point, tolerance: float, max_steps: int) -> Found:
    """Levenberg and Marquardt's method: steps that fail are tried again shorter, until they do not matter any more."""
    damping, curvature, slope = FIRST_DAMPING, *_normal_equations(at)
    for number in range(1, max_steps + 1):
        # what a full step would gain by the linear model
        if slope @ scipy.linalg.solve(curvature, slope, assume_a="pos") <= tolerance:
            return Found(at, True, number)
        damped = curvature + damping * np.diag(np.diag(curvature))
        y = at.y - scipy.linalg.solve(damped, slope, assume_a="pos")
        tried = Point(y, *linearised(y, problem))
        # or where a nearly full step makes no difference that corners of forces would not make too
        if damping <= FIRST_DAMPING and abs(tried.cost - at.cost) <= tolerance + ROUGHNESS * at.cost:
            return Found(min(at, tried, key=lambda point: point.cost), True, number)
        if tried.cost < at.cost and np.isfinite(tried.J).all():
            at, damping = tried, max(damping / 10, SMALLEST_DAMPING)
            curvature, slope = _normal_equations(at)
        elif damping > LARGEST_DAMPING:
            break
        else:
            damping *= 10
    return Found(at, False, number)


def _normal_equations(at: Point) -> tuple[np.ndarray, np.ndarray]:
    """J'J + 1, and J'r + y."""
    return at.J.T @ at.J + np.eye(len(at.y)), at.J.T @ at.r + at.y


def linearised(y: np.ndarray, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of the data, (residuals,), and their derivatives, (residuals, unknowns)."""
    r, J = _compiled_misses(jnp.asarray(y), problem)
    return np.asarray(r), np.asarray(J)


@eqx.filter_jit
def _compiled_misses(y, problem: Problem):
    return problem.misses(y)

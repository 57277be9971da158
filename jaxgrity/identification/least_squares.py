"""Residuals of a scene's predictions, and Levenberg and Marquardt's method for their squares."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray
from jaxgrity.identification.measurements import Measurement
from jaxgrity.identification.parameters import Parameter, changed

FIRST_DAMPING, SMALLEST_DAMPING, LARGEST_DAMPING = 1e-3, 1e-9, 1e8
"""Damping of Levenberg and Marquardt's steps, relative to the curvature along each unknown."""
ROUGHNESS = 3e-6
"""Share of the sum of squares by which a step must change it for another step to follow."""
NEAR = 0.1
"""Largest error of parameters, in standard errors, at which a descent may end where corners of forces stop it."""
CORRECTIONS, WORTH = 6, 0.5
"""Most steps that share a Jacobian, and the share of the last sum of squares below which each must get."""
LOOSE, LOOSE_STEPS = (1000.0, 100.0, 10.0), 2
"""Factors on the allowed jumps between windows in the first fits, and the number of Jacobians in each of these."""


class Problem(eqx.Module):
    """A fit. Its arrays are inputs of the compiled program: new data compile nothing."""

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

    def residuals(self, y):
        """The residuals of `misses` alone."""
        z, *starts = self.split(y)
        found = []
        for each, start in zip(self.every, starts):
            seen, further = each.predict(self._scene_at(z), start)
            missing = jnp.isnan(each.values)
            found += [jnp.where(missing, 0, (seen - jnp.nan_to_num(each.values)) / each.noise).ravel(), further]
        return jnp.concatenate(found)

    @property
    def sizes_of_data(self) -> list[tuple[int, int]]:
        """For each measurement: the number of residuals of the data, and of further residuals."""
        starts = (start for start, _ in self.starts)
        further = (jax.eval_shape(each.predict, self.scene, start)[1].size for each, start in zip(self.every, starts))
        return [(each.values.size, size) for each, size in zip(self.every, further)]

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
        return _sum_of_squares(self.y, self.r)


class Found(NamedTuple):
    at: Point
    converged: bool
    steps: int
    """Jacobians that were computed"""


class Weighted(NamedTuple):
    """A problem with weighted residuals."""

    problem: Problem
    weights: np.ndarray

    def linearised(self, y: np.ndarray) -> Point:
        r, J = linearised(y, self.problem)
        return Point(y, r * self.weights, J * self.weights[:, None])

    def residuals(self, y: np.ndarray) -> np.ndarray:
        return np.asarray(residuals(y, self.problem)) * self.weights

    def reweighted(self, weights: np.ndarray, at: Point) -> tuple["Weighted", Point]:
        """The problem with other weights, and the point under them."""
        ratio = weights / self.weights
        return Weighted(self.problem, weights), Point(at.y, at.r * ratio, at.J * ratio[:, None])


def least_squares(problem: Problem, y: np.ndarray, tolerance: float, max_steps: int) -> Found:
    """The least sum of squares from y on, with windows at first left loose that must nearly meet.

    Windows that must nearly meet make a narrow, curved valley, with side valleys for a first guess that is far off.
    Loose windows follow their own data, and a few steps bring parameters near. So the allowed jumps go from `LOOSE`
    times the wanted ones down to them. Raises `InputError` without derivatives.
    """
    jumps = np.concatenate([np.arange(sum(sizes)) >= sizes[0] for sizes in problem.sizes_of_data])
    levels = (*LOOSE, 1.0) if jumps.any() else (1.0,)
    weighted = Weighted(problem, np.where(jumps, 1 / levels[0], 1.0))
    at, taken = weighted.linearised(y), 1
    if not np.isfinite(at.J).all():
        raise InputError("scene: derivatives of what it predicts are not finite; expected one that is not at a corner")
    for times in levels:
        weighted, at = weighted.reweighted(np.where(jumps, 1 / times, 1.0), at)
        most = max_steps - taken if times == 1 else min(LOOSE_STEPS, max_steps - taken)
        found = _descended(weighted, at, tolerance, most)
        at, taken = found.at, taken + found.steps
    return found._replace(steps=taken)


def _descended(problem: Weighted, at: Point, tolerance: float, most: int) -> Found:
    """Levenberg and Marquardt's method: failed steps are tried again, shorter, until they no longer matter.

    From a point with known derivatives; they are computed up to `most` times more.
    """
    damping, steps = FIRST_DAMPING, 0
    while True:
        # the unit matrix and y belong to the prior: unknowns are counted in their plausible spreads
        curvature, slope = at.J.T @ at.J + np.eye(len(at.y)), at.J.T @ at.r + at.y
        full = scipy.linalg.solve(curvature, slope, assume_a="pos")
        # what a full step would gain by the linear model
        if slope @ full <= tolerance:
            return Found(at, True, steps)
        y, cost = _advanced(problem, at, curvature, damping)
        while not cost < at.cost and damping < LARGEST_DAMPING:
            damping *= 10
            y, cost = _advanced(problem, at, curvature, damping)
        # no step makes a difference that corners of forces would not make too
        rough = at.cost - cost <= tolerance + ROUGHNESS * at.cost
        if rough and _offset(len(problem.problem.parameters), curvature, full) <= NEAR:
            return Found(at, True, steps)
        if steps == most or not cost < at.cost:
            return Found(at, False, steps)
        tried, steps = problem.linearised(y), steps + 1
        if not np.isfinite(tried.J).all():
            return Found(at, False, steps)
        at, damping = tried, max(damping / 10, SMALLEST_DAMPING)


def _advanced(problem: Weighted, at: Point, curvature: np.ndarray, damping: float) -> tuple[np.ndarray, float]:
    """The best of some steps by one Jacobian, and its sum of squares.

    The first is that of Levenberg and Marquardt. Where windows have to meet, the nonlinearity of the motion leaves
    jumps after it, which alone would forbid all but tiny steps. The further ones correct that (second-order
    corrections, Nocedal and Wright 2006, section 15.6), and cost a rollout each, not a Jacobian.
    """
    factors = scipy.linalg.cho_factor(curvature + damping * np.diag(np.diag(curvature)))
    y, r, best = at.y, at.r, (at.y, np.inf)
    for _ in range(CORRECTIONS):
        y = y - scipy.linalg.cho_solve(factors, at.J.T @ r + y)
        r = problem.residuals(y)
        cost, last = _sum_of_squares(y, r), best[1]
        best = min(best, (y, cost), key=lambda one: one[1])
        if not cost < WORTH * last:
            break
    return best


def _offset(size: int, curvature: np.ndarray, full: np.ndarray) -> float:
    """Root mean square change of the parameters by a full step, in standard errors."""
    covariance = np.linalg.inv(curvature)[:size, :size]
    return float(np.sqrt(full[:size] @ np.linalg.solve(covariance, full[:size]) / size)) if size else 0.0


def _sum_of_squares(y: np.ndarray, r: np.ndarray) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        cost = float(r @ r + y @ y)
    return cost if np.isfinite(cost) else np.inf


def linearised(y: np.ndarray, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of the data, (residuals,), and their derivatives, (residuals, unknowns)."""
    r, J = _compiled_misses(jnp.asarray(y), problem)
    return np.asarray(r), np.asarray(J)


@eqx.filter_jit
def residuals(y: AnyArray, problem: Problem) -> AnyArray:
    """Residuals of the data alone, for a hundredth of the cost of their derivatives."""
    return problem.residuals(y)


@eqx.filter_jit
def _compiled_misses(y, problem: Problem):
    return problem.misses(y)

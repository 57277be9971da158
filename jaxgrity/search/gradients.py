"""Gradients of rollouts: pathwise by reverse mode, smoothed by regression on perturbed gaits, and both combined."""

import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtri
from jaxtyping import Float

from jaxgrity.core import draws
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, FinalPositions, PerGait, Phases, Scalar, State, Vectors
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene, start_of
from jaxgrity.populations.lanes import discretise_lanes, in_lanes, lanes_last, over_lanes
from jaxgrity.populations.population import Outcomes
from jaxgrity.populations.uncertainty import Differences, ensemble
from jaxgrity.search.judging import Judging, judge
from jaxgrity.search.problem import SearchProblem
from jaxgrity.stepping.dynamics import centre_of_mass
from jaxgrity.stepping.final_state import stepped
from jaxgrity.stepping.options import ResolvedOptions


class ClimbTask(NamedTuple):
    """What stays the same through a climb."""

    problem: SearchProblem
    options: ResolvedOptions
    """of the problem's own scene, with its step, needed by reverse mode"""
    judging: Judging
    """for smoothed gradients"""
    width: Scalar
    """standard deviation s of the smoothed gradient's perturbations, as `PolishConfig.width`"""


@typed
def distance_and_gradient(
    scene: Scene, gaits: Gait, horizon: float, options: ResolvedOptions
) -> tuple[PerGait, Phases]:
    """Horizontal distance of each gait after `horizon` (s), m, and its gradient in the phases, m/rad, by reverse mode.

    Compile it with `jax.jit`.

    Args:
        scene: the robot; it starts at rest.
        gaits: a population of gaits, as from `gaits_of`.
        horizon: simulated time, s.
        options: from `resolve`, with a fixed step; not `as_inputs` of them, since steps are counted before tracing.

    Returns:
        (gaits,), and (gaits, actuators).
    """

    def total(phase):
        distance = distances(scene, eqx.tree_at(lambda g: g.phase, gaits, phase), horizon, options)
        return jnp.sum(distance), distance

    gradient, distance = jax.grad(total, has_aux=True)(gaits.phase)
    return distance, gradient


@typed
def distances(
    scene: Scene, gaits: Gait, horizon: float, options: ResolvedOptions, end: Callable | None = None
) -> PerGait:
    """(gaits,), horizontal distance of each gait after `horizon` (s), m, differentiable in reverse mode.

    Arguments as of `distance_and_gradient`. `end` integrates all gaits at once; by default `checkpointed_end`.
    """
    first, last, _ = ends(scene, gaits, None, horizon, options, end)
    moved = (last - first)[:, :2]
    return jnp.sqrt(jnp.sum(moved * moved, axis=1))


def ends(
    scene: Scene,
    gaits: Gait,
    differences: Differences | None,
    horizon: float,
    options: ResolvedOptions,
    end: Callable | None = None,
) -> tuple[Vectors, Vectors, FinalPositions]:
    """Of each robot, as for `distances`: centre of mass at the start and at `horizon`, and all nodes there, m."""
    scene, axes = in_lanes(scene, lanes_last(gaits), lanes_last(differences))
    start = start_of(scene)
    q, _ = (end or checkpointed_end)(scene, axes, start, horizon, options)
    com = over_lanes(centre_of_mass, (axes, -1))
    return com(scene, start[0]).T, com(scene, q).T, jnp.moveaxis(q, -1, 0)


@typed
def checkpointed_end(scene: Scene, axes: Scene, start: State, horizon: float, options: ResolvedOptions) -> State:
    """Positions and velocities after `horizon` (s), as the method carries them, robots last, for reverse mode.

    `axes` is a scene with -1 in place of each array that has robots last, and None in place of others (`in_lanes`). Two
    nested scans save memory: see `stepped`.
    """
    return stepped(scene, start, (0.0, horizon), options, discretise_lanes(options, axes))[0]


class Gradient(NamedTuple):
    """An estimate of a gradient; of several at once, each array has a row for each."""

    value: AnyArray | float
    """of the differentiated quantity, mean over the gradient's rollouts"""
    mean: AnyArray
    """(genes,), per turn of the circle or per width of the bounds"""
    noise: AnyArray
    """squared standard error of `mean`, summed over the genes; NaN where there is none"""
    scale: AnyArray | float = 1.0
    """of the fitness among the rollouts: without it, steps weigh alike on steep and on flat ground"""


def combine(smoothed: Gradient, pathwise: Gradient) -> tuple[Gradient, Scalar]:
    """The mean of two gradients by the inverse of their variances, and the second one's weight in it.

    Suh, Simchowitz, Zhang, Tedrake 2022. Where one has no variance the other counts alone. The value is the smoothed
    one's.
    """
    noise, other = jnp.asarray(smoothed.noise), jnp.asarray(pathwise.noise)
    share = jnp.where(jnp.isfinite(noise), noise / jnp.maximum(noise + other, jnp.finfo(noise.dtype).tiny), 1.0)
    share = jnp.where(jnp.isfinite(other), share, 0.0)
    mean = jnp.where(share < 1, (1 - share) * smoothed.mean, 0) + jnp.where(share > 0, share * pathwise.mean, 0)
    both = jnp.where(share == 0, noise, jnp.where(share == 1, other, share * other))
    return Gradient(smoothed.value, mean, both, smoothed.scale), share


def smoothed_gradients(
    key, genes: Float[AnyArray, "starts genes"], task: ClimbTask, horizon: float, samples: int, robots: int
) -> Gradient:
    """g = c mean of (u(x + s e) - u(x - s e))/(2 s) e over pairs of perturbed gaits; u are their utilities.

    Of every row of genes, whose gaits are rolled out side by side in one call. The e are `right_angled`.

    Each gait has the fitness of an ensemble of `robots`; all meet the same draws, given which the noise is. Fitness
    counts by its rank: good gaits lie close to cliffs, and one robot that falls off would outweigh all others. Of many
    gaits with linear fitness g is the gradient; of 12 it is an eighth longer, in the mean, and for two genes a third.
    """
    drawn, disturbed = jax.random.split(key)
    starts, size = genes.shape
    e = right_angled(drawn, (starts, samples // 2, size), genes.dtype)
    scene, genome, *_ = task.problem
    perturbed = genome.clipped(genes[:, None] + task.width * jnp.concatenate([e, -e], axis=1))
    gaits = genome.gaits(scene.gait, np.asarray(perturbed).reshape(-1, size))
    scores = judge(disturbed, task.judging.with_robots(robots, horizon), gaits)
    value, merit = (np.asarray(each).reshape(starts, samples) for each in (scores.fitness, scores.merit))
    return _estimates(value, merit, e, task.width)


def right_angled(key, shape: tuple[int, int, int], dtype) -> Float[AnyArray, "starts pairs genes"]:
    """Directions at right angles to each other, as many at a time as there are genes, turned at random.

    Each is as long as a normal deviate is in the mean square. If their number is that of the genes, or a multiple of
    it, the mean of e e^T is exactly 1. Then directions by themselves add no noise to a gradient (Choromanski, Rowland,
    Sindhwani, Turner, Weller 2018, arXiv:1804.02395).
    """
    normal, size = np.asarray(draws.normal(key, shape, dtype)), shape[-1]
    # NumPy: a program to compile for some hundred numbers would take longer than they do
    turned = [np.linalg.qr(block.swapaxes(1, 2))[0] for block in np.split(normal, range(size, shape[1], size), axis=1)]
    return math.sqrt(size) * np.concatenate(turned, axis=2).swapaxes(1, 2)


@eqx.filter_jit
def _estimates(
    fitness: Float[AnyArray, "starts samples"], merit: Float[AnyArray, "starts samples"], e: AnyArray, width: Scalar
) -> Gradient:
    def estimate(fitness, merit, e):
        utility, scale = utilities(merit)[0], utilities(fitness)[1]
        plus, minus = jnp.split(scale * utility, 2)
        slope = (plus - minus) / (2 * width)
        mean, noise = _mean_and_noise(slope[:, None] * e)
        known = scale > 0
        return Gradient(_mean(fitness), mean, jnp.where(known, noise, jnp.nan), jnp.where(known, scale, 1))

    return jax.vmap(estimate)(fitness, merit, e)


def utilities(fitness: PerGait) -> tuple[PerGait, Scalar]:
    """u = max(0, ln(n/2 + 1) - ln rank), and by what to multiply it to replace the fitness, c.

    Wierstra, Schaul, Glasmachers, Sun, Peters, Schmidhuber 2014, by whom the worse half of the n gaits counts alike.
    Normally distributed fitness has with c u the covariance that it has with itself. c is 0 where the quartiles of the
    fitness are not two finite numbers: where a quarter of the gaits or more failed.
    """
    above = jnp.argsort(jnp.argsort(fitness)).astype(fitness.dtype)
    utility = jnp.maximum(0, math.log(above.size / 2 + 1) - jnp.log(above.size - above))
    normal, quartiles = ndtri((above + 0.5) / above.size), np.array([0.25, 0.75], fitness.dtype)
    spread = jnp.diff(jnp.quantile(fitness, quartiles))[0] / jnp.diff(jnp.quantile(normal, quartiles))[0]
    scale = spread / jnp.mean(utility * normal)
    return utility, jnp.where(jnp.isfinite(scale), scale, 0)


@eqx.filter_jit
def pathwise_gradient(key, genes, task: ClimbTask, horizon: float, robots: int) -> Gradient:
    """The mean gradient of the objective over an ensemble of robots, by reverse mode."""

    scene, genome, _, fitness = task.problem

    def total(each):
        gaits = genome.gaits(scene.gait, each)
        many, differences = ensemble(key, scene, gaits, fitness.uncertainty, 1, common=False)
        start, end, q = ends(scene, many, differences, horizon, task.options)
        failure = jnp.where(jnp.isfinite(q).all((1, 2)), 0, 1)
        steps = jnp.full(robots, round(horizon / task.options.dt))
        name = task.options.method.name
        outcomes = Outcomes(jnp.stack([start, end], 1), q, failure, steps, 0 * steps, None, name, None)
        worth = fitness.objective.worth(scene, outcomes, horizon)
        return jnp.sum(worth), worth

    gradients, worth = jax.grad(total, has_aux=True)(jnp.tile(genes, (robots, 1)))
    # draws come in pairs of opposite signs, whose gradients are no independent samples
    pairs = gradients.reshape(2, -1, genes.size).mean(0) if robots % 2 == 0 else gradients
    return Gradient(_mean(worth), *_mean_and_noise(pairs))


def _mean(worth: PerGait) -> Scalar:
    """Over those that did not fail; NaN where all did."""
    return jnp.nanmean(jnp.where(jnp.isfinite(worth), worth, jnp.nan))


def _mean_and_noise(samples) -> tuple[AnyArray, AnyArray]:
    """The mean over those samples that are finite, 0 where none is, and its squared standard error."""
    good = jnp.isfinite(samples).all(1, keepdims=True)
    count = jnp.sum(good)
    kept = jnp.where(good, samples, 0)
    mean = kept.sum(0) / jnp.maximum(count, 1)
    spread = jnp.sum(jnp.where(good, kept - mean, 0) ** 2)
    return mean, jnp.where(count > 1, spread / jnp.maximum(count, 1) / jnp.maximum(count - 1, 1), jnp.nan)

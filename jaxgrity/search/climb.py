"""One climb: steps of optax along estimates of the gradient, from one gait."""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Float

from jaxgrity.core.types import AnyArray
from jaxgrity.model.actuation import Gait
from jaxgrity.rollout.population import one_gait
from jaxgrity.search.gradients import ClimbTask, Gradient, combine, pathwise_gradient, smoothed_gradient
from jaxgrity.search.polish_config import GradientKind, PolishConfig, cost_of_gradient

AVERAGED = 0.2
"""share of a climb's steps, the last, whose gaits' mean is its end: it is less noisy than any of them"""

OneGait = Float[AnyArray, " genes"]


class ClimbStep(NamedTuple):
    """One step of polishing."""

    horizon: float
    """s, of the gradient"""
    gradient_norm: float
    """of the fitness, per turn of the circle or per width of the bounds"""
    pathwise_share: float
    """weight of the pathwise gradient, 0 to 1"""
    fitness: float
    """at the horizon, in the mean over what the gradient was taken from"""


class Route(NamedTuple):
    """From where to climb, and how."""

    genes: OneGait
    kind: GradientKind
    horizon: float
    """s"""


class Climb(NamedTuple):
    """What became of a climb."""

    end: OneGait
    steps: tuple[ClimbStep, ...]
    cost: int
    """in rollouts over the whole duration"""


def climb(
    task: ClimbTask,
    config: PolishConfig,
    route: Route,
    rollouts: int,
    key,
    on_step: Callable[[ClimbStep], None] | None = None,
) -> Climb:
    """Climb for as many steps as the rollouts pay for."""
    genes, kind, horizon = route
    _, genome, duration, fitness = task.problem
    ahead = [horizon] if kind == "smoothed" else [(horizon + _shortest(task, genes)) / 2, horizon]
    costs = [cost_of_gradient(config, fitness, kind, reach / duration) for reach in ahead]
    count = int(rollouts / np.mean(costs))
    optimiser = _optimiser(config, count)
    # NumPy: on all devices, as a step leaves it, x would have the next one compiled again
    first = x = np.asarray(genes, task.options.dtype)
    state, path, found, spent = optimiser.init(x), [], [], 0.0
    widths = np.geomspace(*config.width, count).astype(task.options.dtype)
    for number in range(count):
        half = min(len(ahead) - 1, 2 * number // count)
        now = task._replace(width=widths[number])
        gradient, share = _gradient(jax.random.fold_in(key, number), x, now, route, ahead[half], config)
        spent += costs[half]
        if jnp.any(gradient.mean):
            update, state = optimiser.update(gradient.mean / gradient.scale, state)
            # angles go on beyond a turn, so that their mean is one
            x = np.asarray(genome.bounded(x + update))
        path.append(x)
        found.append(ClimbStep(ahead[half], float(jnp.linalg.norm(gradient.mean)), share, float(gradient.value)))
        if on_step is not None:
            on_step(found[-1])
    last = np.stack(path[-math.ceil(AVERAGED * count) :])
    # genes that did not move keep the digits that the climb's precision lacks
    end = np.where((last == first).all(0), genes, genome.within(last.mean(0, dtype=float)))
    return Climb(end, tuple(found), int(spent))


def one_period(gait: Gait) -> float:
    """The time, s, when every actuator has gone through a period at full amplitude."""
    return float(gait.start + gait.ramp + 1 / np.max(gait.frequency))


def _shortest(task: ClimbTask, genes: OneGait) -> float:
    scene, genome, _, _ = task.problem
    return one_period(one_gait(genome.gaits(scene.gait, genes[None]), 0))


def _optimiser(config: PolishConfig, count: int) -> optax.GradientTransformation:
    """Momentum, and steps whose length falls by a cosine."""
    schedule = optax.cosine_decay_schedule(config.learning_rate, count, alpha=0.2)
    return optax.chain(
        optax.trace(config.momentum), optax.normalize_by_update_norm(), optax.scale_by_schedule(schedule)
    )


def _gradient(
    key, genes: OneGait, task: ClimbTask, route: Route, ahead: float, config: PolishConfig
) -> tuple[Gradient, float]:
    """Of the fitness at the time `ahead` (s), and the share that the pathwise one has in it."""
    one, other = jax.random.split(key)
    if route.kind == "pathwise":
        return pathwise_gradient(other, genes, task, ahead, config.samples), 1.0
    any_step = task._replace(options=task.options.as_inputs())
    smoothed = smoothed_gradient(one, genes, any_step, np.asarray(ahead), config.samples, config.robots)
    if route.kind == "smoothed":
        return smoothed, 0.0
    both, share = combine(smoothed, pathwise_gradient(other, genes, task, ahead, config.samples))
    return both, float(share)

"""Climbs from the best gaits: which gradient each may use, and steps of optax along estimates of it."""

import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Float

from jaxgrity.core.display import in_digits
from jaxgrity.core.elementwise import rows_where
from jaxgrity.core.types import AnyArray
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import with_gait
from jaxgrity.populations.population import one_gait
from jaxgrity.search.genome import Genome
from jaxgrity.search.gradients import ClimbTask, Gradient, combine, pathwise_gradient, smoothed_gradients
from jaxgrity.search.polish_config import GradientKind, PolishConfig, cost_of_gradient, share_simulated
from jaxgrity.search.problem import SearchProblem
from jaxgrity.stepping.options import ResolvedOptions
from jaxgrity.trust.sensitivity import Sensitivity, sensitivity

AVERAGED = 0.2
"""Share of a climb's steps, counted from its end, whose mean gait is its result: it is less noisy than a single one."""

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
    """at the horizon: mean over the gaits of which the gradient was taken; on an orbit, of the gait that is kept"""


class Route(NamedTuple):
    """The start of a climb, and its kind."""

    genes: OneGait
    kind: GradientKind
    horizon: float
    """s"""


class Routes(NamedTuple):
    """Climbs that the starts allow, and facts about them."""

    routes: list[Route]
    sensitivity: Sensitivity | None
    """sensitivity of the first start"""
    remarks: list[str]


class Climb(NamedTuple):
    """The result of a climb."""

    end: OneGait
    steps: tuple[ClimbStep, ...]
    cost: int
    """in rollouts over the whole duration"""
    remark: str = ""
    """why it ended before its rollouts were spent"""


def routes_from(problem: SearchProblem, genes, options: ResolvedOptions, config: PolishConfig) -> Routes:
    """A route from each start: where gradients are pathwise, as far as its sensitivity allows."""
    scene, genome, duration, fitness = problem
    if config.kind not in ("pathwise", "combined"):
        horizon = duration * share_simulated(config.kind, fitness)
        return Routes([Route(start, config.kind, horizon) for start in genes], None, [])
    routes, growth, refused = [], [], 0
    gaits, bound = genome.gaits(scene.gait, genes), config.largest_sensitivity
    for k, start in enumerate(genes):
        gait = one_gait(gaits, k)
        growth.append(sensitivity(with_gait(scene, gait), duration, options=options))
        horizon = min(duration, growth[-1].horizon(bound))
        if horizon >= one_period(gait):
            routes.append(Route(start, config.kind, horizon))
        else:
            refused += 1
            routes += [Route(start, "smoothed", duration)] if config.kind == "combined" else []
    remarks = []
    if refused == len(genes):
        horizon = min(duration, growth[0].horizon(bound))
        ends = "the rollout ends" if horizon == duration else f"|d com/d phase| passes {bound:g} m/rad"
        early = f"{ends} after {in_digits(horizon)} s, before one period of full actuation is over"
        remarks.append(f"no pathwise gradient was used: {early}")
    elif refused:
        remarks.append(f"{refused} of {len(genes)} starts are too sensitive for pathwise gradients")
    return Routes(routes, growth[0], remarks)


def climb(
    task: ClimbTask,
    config: PolishConfig,
    routes: list[Route],
    rollouts: int,
    key,
    on_step: Callable[[ClimbStep], None] | None = None,
) -> list[Climb]:
    """Climb from every start until the budget is spent: `rollouts` are those of one climb.

    The routes have one kind and one horizon, and are climbed side by side: rollouts of few gaits cost more for each.
    """
    genes, (_, kind, horizon) = np.stack([route.genes for route in routes]), routes[0]
    _, genome, duration, fitness = task.problem
    horizons = [horizon] if kind == "smoothed" else [(horizon + _shortest(task, genes[0])) / 2, horizon]
    costs = [cost_of_gradient(config, fitness, kind, each / duration) for each in horizons]
    count = int(rollouts / np.mean(costs))
    optimiser = _optimiser(config, count)
    first = x = np.asarray(genes, task.options.dtype)
    state, path, spent = jax.vmap(optimiser.init)(x), [], 0.0
    found: list[list[ClimbStep]] = [[] for _ in routes]
    for number in range(count):
        stage = min(len(horizons) - 1, 2 * number // count)
        gradient, share = _gradients(jax.random.fold_in(key, number), x, task, kind, horizons[stage], config)
        spent += costs[stage]
        moved, state = _moved(optimiser, genome, gradient, x, state)
        # NumPy: on all devices, as a step leaves it, x would have the next one compiled again
        x = np.asarray(moved)
        path.append(x)
        norms = np.linalg.norm(gradient.mean, axis=1)
        for steps, norm, weight, value in zip(found, norms, share, np.asarray(gradient.value)):
            steps.append(ClimbStep(horizons[stage], float(norm), float(weight), float(value)))
            if on_step is not None:
                on_step(steps[-1])
    last = np.stack(path[-math.ceil(AVERAGED * count) :])
    # genes that did not move keep the digits that the climb's precision lacks
    ends = np.where((last == first).all(0), genes, genome.wrapped(last.mean(0, dtype=float)))
    return [Climb(end, tuple(steps), int(spent)) for end, steps in zip(ends, found)]


@eqx.filter_jit
def _moved(optimiser: optax.GradientTransformation, genome: Genome, gradient: Gradient, x: AnyArray, state):
    """Every row of genes one step on; rows without a gradient stay."""
    update, after = jax.vmap(optimiser.update)(gradient.mean / jnp.reshape(gradient.scale, (-1, 1)), state)
    moves = jnp.any(gradient.mean != 0, axis=1)
    # angles go on beyond a turn, so that their mean is one
    return rows_where(moves, (genome.clipped(x + update), after), (x, state))


def one_period(gait: Gait) -> float:
    """The time, s, after a period of every actuator at full amplitude."""
    return float(gait.start + gait.ramp + 1 / np.max(gait.frequency))


def _shortest(task: ClimbTask, genes: OneGait) -> float:
    scene, genome, *_ = task.problem
    return one_period(one_gait(genome.gaits(scene.gait, genes[None]), 0))


def _optimiser(config: PolishConfig, count: int) -> optax.GradientTransformation:
    """Momentum, and a step length that falls by a cosine."""
    schedule = optax.cosine_decay_schedule(config.learning_rate, count, alpha=0.2)
    return optax.chain(
        optax.trace(config.momentum), optax.normalize_by_update_norm(), optax.scale_by_schedule(schedule)
    )


def _gradients(
    key, genes: np.ndarray, task: ClimbTask, kind: GradientKind, horizon: float, config: PolishConfig
) -> tuple[Gradient, np.ndarray]:
    """Gradients of the fitness at the time `horizon` (s), a row for each of the genes, and the share of the pathwise
    ones."""
    one, other = jax.random.split(key)

    def smoothed() -> Gradient:
        return smoothed_gradients(one, genes, task, horizon, config.samples, config.robots)

    if kind == "smoothed":
        return smoothed(), np.zeros(len(genes))
    rows = [pathwise_gradient(other, each, task, horizon, config.samples) for each in genes]
    pathwise = jax.tree.map(lambda *parts: jnp.stack([jnp.asarray(part) for part in parts]), *rows)
    if kind == "pathwise":
        return pathwise, np.ones(len(genes))
    both, share = jax.vmap(combine)(smoothed(), pathwise)
    return both, np.asarray(share)

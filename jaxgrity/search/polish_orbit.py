"""Polish on the orbit: a climb by the derivative of the steady speed itself, which no horizon bounds.

Each gradient is of the orbit of the robot as the scene says, found anew at every gait; each step has to be worth it to
an ensemble of robots that differ, the same for all steps of a climb. A step that is not is taken back and halved.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree

from jaxgrity.core.types import AnyArray, Scalar
from jaxgrity.model.actuation import Gait, actuated_lengths, peak_rates
from jaxgrity.model.scene import Scene, body_length, with_gait
from jaxgrity.orbits.finding import IN_TIME, find_orbit, shortest_watch
from jaxgrity.orbits.orbit_gradient import FEWEST_CYCLES, MOST_CYCLES, derivatives_along, numbers_of
from jaxgrity.populations.population import one_gait
from jaxgrity.search.climb import Climb, ClimbStep, OneGait
from jaxgrity.search.genome import Genome
from jaxgrity.search.judging import Judging, Scores, judge
from jaxgrity.search.objectives import INSIDE
from jaxgrity.search.polish_config import PolishConfig, judges_of_a_step
from jaxgrity.search.problem import SearchProblem
from jaxgrity.search.search_space import with_longest_cables
from jaxgrity.stepping.options import ResolvedOptions

TANGENT = 3.5
"""Cost of a forward tangent, in rollouts: 28 for eight were measured."""
DOUBLE = 2.0
"""Cost of a rollout in float64, in rollouts in float32."""
SHORTEST = 1 / 16
"""A climb ends where steps are shorter than this share of its first step."""
NO_ORBIT = f"the robot settles on no orbit {IN_TIME}"
"""Why there is no gradient, in words."""
PULLS = 4
"""Number of corrections that bring a gait back within the bound on rates."""


class OrbitSlope(NamedTuple):
    """Of one gait's orbit."""

    speed: float
    """body lengths/s"""
    gradient: OneGait
    """body lengths/s per turn of the circle or per width of the bounds"""
    cost: float
    """in rollouts over the whole duration"""
    watched: float
    """s, through which tangents were carried"""
    remark: str
    """why there is no gradient; empty where there is"""


def climb_on_orbit(
    problem: SearchProblem,
    options: ResolvedOptions,
    judging: Judging,
    config: PolishConfig,
    start: tuple[OneGait, int],
    key,
    on_step: Callable[[ClimbStep], None] | None,
) -> Climb:
    """Climb from one gait for as long as the rollouts pay: `start` is its genes, and how many they are."""
    genes: OneGait = np.asarray(start[0], float)
    rollouts = start[1]
    judges = judging.with_robots(judges_of_a_step(config, judging.fitness))
    price = judges.fitness.rollouts
    optimiser = optax.chain(optax.trace(config.momentum), optax.normalize_by_update_norm())

    def judged(each: OneGait) -> Scores:
        gaits = problem.genome.gaits(problem.scene.gait, jnp.asarray(each, judging.dtype)[None])
        return judge(key, judges, gaits)

    best, length, steps = judged(genes), config.learning_rate, []
    spent, memory, slope = float(price), optimiser.init(genes), orbit_slope(problem, genes, options, rollouts - price)
    spent += slope.cost
    while not slope.remark and spent + price <= rollouts and length >= SHORTEST * config.learning_rate:
        update, after = optimiser.update(slope.gradient, memory)
        tried = np.asarray(problem.genome.wrapped(_within_rate(problem, genes, genes + length * np.asarray(update))))
        found = judged(tried)
        better = bool(found.merit[0] > best.merit[0])
        spent += price
        steps.append(
            ClimbStep(
                slope.watched, float(np.linalg.norm(slope.gradient)), 1.0, float((found if better else best).fitness[0])
            )
        )
        if on_step is not None:
            on_step(steps[-1])
        if better:
            best, genes, memory = found, tried, after
            if spent + slope.cost + price > rollouts:
                break
            slope = orbit_slope(problem, genes, options, rollouts - spent)
            spent += slope.cost
        else:
            # a step too long, and momentum is what led there
            length, memory = length / 2, optimiser.init(genes)
    return Climb(genes, tuple(steps), int(spent), slope.remark)


def orbit_slope(
    problem: SearchProblem, genes: OneGait, options: ResolvedOptions, rollouts: float = np.inf
) -> OrbitSlope:
    """The steady speed of the gait that genes stand for, and its gradient in them, as far as there is an orbit, and
    `rollouts` pay for the tangents."""
    scene, genome, duration, _ = problem
    assert scene.gait is not None, "a search refuses a scene without a gait"
    here = with_gait(scene, one_gait(genome.gaits(scene.gait, jnp.asarray(genes)[None]), 0))
    directions = np.asarray(_numbers_by_genes(genome, scene.gait, jnp.asarray(genes, float))).T
    # a tangent costs as much as some rollouts, so genes that move no number of the gait get none
    counts = np.flatnonzero(np.abs(directions).max(1) > 0)
    watch, size = shortest_watch(here.gait) * (1 + 1e-6), float(body_length(scene))
    orbit = find_orbit(here, watch, options=options)
    cost, nothing = DOUBLE * watch / duration, np.zeros(len(directions))
    if not orbit.settled:
        return OrbitSlope(orbit.speed / size, nothing, cost, 0.0, NO_ORBIT)
    price = DOUBLE * (1 + TANGENT * len(counts)) * orbit.cycle / duration
    most = int(min(MOST_CYCLES, (rollouts - cost) / price))
    if most < FEWEST_CYCLES:
        remark = "the derivative of the orbit's speed costs more rollouts than are left"
        return OrbitSlope(orbit.speed / size, nothing, cost, 0.0, remark)
    found = derivatives_along(here, orbit, directions[counts], options=options, most_cycles=most)
    watched = found.cycles * orbit.cycle
    cost += price * found.cycles
    gradient = nothing.copy()
    gradient[counts] = found.rows[:, 0] / size
    remark = "" if found.settled else "the orbit has no derivative: tangents do not settle"
    return OrbitSlope(orbit.speed / size, gradient, cost, watched, remark)


@eqx.filter_jit
def _numbers_by_genes(genome: Genome, own: Gait, genes: AnyArray) -> AnyArray:
    """(numbers, genes), the derivative of the numbers of the gait that genes stand for."""

    def numbers(each):
        return ravel_pytree(numbers_of(one_gait(genome.gaits(own, each[None]), 0)))[0]

    return jax.jacfwd(numbers)(genes)


def _within_rate(problem: SearchProblem, before: OneGait, genes: OneGait) -> OneGait:
    """Genes brought back along the gradient of the largest rate, to where no robot passes the bound on it.

    Robots whose amplitudes or cables are off leave less than the bound; a gait that began beyond that may stay as it
    is.
    """
    genome, fitness = problem.genome, problem.fitness
    if fitness.bounds.rate is None:
        return np.asarray(genome.clipped(jnp.asarray(genes)))
    least = INSIDE * fitness.bounds.rate / (1 + fitness.uncertainty.actuation)
    longest = with_longest_cables(problem.scene, fitness.uncertainty)
    return np.asarray(_brought_back(longest, genome, least, jnp.asarray(before), jnp.asarray(genes)))


@eqx.filter_jit
def _brought_back(scene: Scene, genome: Genome, least: Scalar, before: AnyArray, genes: AnyArray) -> AnyArray:
    def rate(each) -> Scalar:
        gaits = genome.gaits(scene.gait, each[None])
        return peak_rates(gaits, actuated_lengths(scene.structure, gaits.members)).max()

    genes, limit = genome.clipped(genes), jnp.maximum(least, rate(before))
    for _ in range(PULLS):
        now, slope = jax.value_and_grad(rate)(genes)
        genes = genome.clipped(genes - jnp.maximum(now - limit, 0) * slope / jnp.maximum(slope @ slope, 1e-12))
    return genes

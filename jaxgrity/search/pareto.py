"""A Pareto front: the fastest gaits for each force, power or rate that actuators may need, by one population.

Selection by ranks of non-dominated gaits and their crowding: Deb, Pratap, Agarwal and Meyarivan 2002 (NSGA-II),
doi:10.1109/4235.996017. Unlike there, every gait meets new robots in each generation, the best ones too. It is a search
of its own, which `search_gaits` does not use.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxgrity.core import draws
from jaxgrity.core.arguments import check_count
from jaxgrity.core.errors import InputError, check_known
from jaxgrity.core.typed import typed
from jaxgrity.core.types import PerGait
from jaxgrity.search.genetic_algorithm import GAConfig, Generation, breed
from jaxgrity.search.judging import Judging, Scores, judge
from jaxgrity.search.objectives import ActuatorBounds
from jaxgrity.search.problem import SearchProblem
from jaxgrity.stepping.options import Options

LEAST = 1e-3
"""Smallest need that is told apart, as a share of the bound of the problem; smaller ones count as this. The largest is
`FARTHEST` times as large."""


class ParetoFront(NamedTuple):
    """Gaits of which none is both better and less demanding than another, the least demanding first."""

    genes: Float[np.ndarray, "gaits genes"]
    fitness: Float[np.ndarray, " gaits"]
    """in the unit of the objective; by the draws that chose it, so that it is less by others"""
    need: Float[np.ndarray, " gaits"]
    """largest force (N), power (W) or rate (m/s) of any actuator, in the mean over the robots"""
    rollouts: int


@typed
def pareto_front(
    problem: SearchProblem,
    config: GAConfig | None = None,
    *,
    against: Literal["force", "power", "rate"] = "power",
    least: float = -math.inf,
    seed: int = 0,
    options: Options = None,
    on_generation: Callable[[ParetoFront], None] | None = None,
) -> ParetoFront:
    """Evolve a population towards the front of fitness against what actuators need.

    The start from rest counts, as it does for bounds. The bound of the problem on `against` only sets the scale: needs
    are told apart from a thousandth of it to a thousand times as much. No other bound counts, except where the genome
    scales amplitudes down to the bound on rates.

    Args:
        problem: scene, genome, duration (s) and fitness.
        config: population, generations and breeding; parents are the best half by default.
        against: what actuators need: the largest force, power or rate.
        least: smallest fitness of interest. Gaits below it come last, best first, however little they need. Without it,
            much of a front may be gaits that hardly move.
        seed: seed of the random number generator.
        options: solver options; by default the scene decides.
        on_generation: gets the front after each generation.

    Returns:
        The front of the last generation; empty where all its gaits fail, or are below `least`.

    Raises:
        InputError: no bound on `against`, or no such need; a `least` that is not a number; CMA-ES; bad options.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> problem = jaxgrity.search.search_problem(scene, jaxgrity.SearchConfig(duration=1.5))
        >>> config = jaxgrity.GAConfig(population=8, generations=2, elites=4)
        >>> found = jaxgrity.search.pareto_front(problem, config, options=jaxgrity.SolverOptions(dt=0.01))
        >>> bool((np.diff(found.fitness) > 0).all() and (np.diff(found.need) > 0).all())
        True
    """
    config = config or GAConfig(elites=32, parents=64, mutation_rate=1.0)
    check_count("seed", seed, 0)
    if math.isnan(least):
        raise InputError(f"least = {least}: expected a number")
    judging = _judging_needs(problem, config, against, options)
    key, first = jax.random.split(jax.random.key(seed))
    genes = np.asarray(draws.uniform(first, (config.drawn or config.population, problem.genome.size), judging.dtype))
    rollouts = 0
    for number in range(config.generations):
        tried, varied = jax.random.split(jax.random.fold_in(key, number))
        scores = judge(tried, judging, problem.genome.gaits(problem.scene.gait, genes))
        need = _needs(scores, getattr(judging.fitness.bounds, against), least)
        order = best_first(scores.fitness, need)[: config.population]
        rollouts += scores.each.size
        best = Generation(genes[order], scores.fitness[order], scores.spread[order], np.sum(scores.failed))
        found = _front(best, need[order], rollouts)
        if on_generation is not None:
            on_generation(found)
        genes = np.asarray(breed(varied, best, config.progress(number, genes.dtype), problem.genome, config))
    return found


def _judging_needs(problem: SearchProblem, config: GAConfig, against: str, options: Options) -> Judging:
    """The judging of a front: within a bound on `against` so small that the excess over it is the need itself."""
    if config.optimiser != "genetic":
        raise InputError(f"optimiser = {config.optimiser!r}: a front is bred; expected 'genetic'")
    check_known("against", against, vars(problem.fitness.bounds))
    unit = getattr(problem.fitness.bounds, against)
    if unit is None:
        raise InputError(f"bounds: none on the {against}; expected ActuatorBounds({against}=...), which sets the scale")
    bounds = ActuatorBounds(**{against: LEAST * unit})
    return problem.judging(options, fitness=replace(problem.fitness, bounds=bounds))


def _needs(scores: Scores, bound: float, least: float) -> Float[np.ndarray, " gaits"]:
    """What gaits need, in the unit of the bound; infinite for those that fail, or are below the least fitness."""
    out = scores.failed | (scores.fitness < least)
    return np.where(out, np.inf, bound * (1 + scores.excess.mean(1)))


def _front(best: Generation, need: Float[np.ndarray, " gaits"], rollouts: int) -> ParetoFront:
    """The gaits of a generation that no other one dominates."""
    first = np.flatnonzero(ranks_of(best.fitness, need) == 0)
    first = first[np.isfinite(need[first])]
    chosen = first[np.argsort(need[first])]
    return ParetoFront(np.asarray(best.genes)[chosen], np.asarray(best.fitness)[chosen], need[chosen], rollouts)


def best_first(fitness: PerGait, need: PerGait) -> np.ndarray:
    """(gaits,), their numbers: lower ranks first, and among the same rank those with the most room about them."""
    ranks, room = ranks_of(fitness, need), np.zeros(len(need))
    for rank in np.unique(ranks):
        same = np.flatnonzero(ranks == rank)
        room[same] = _room(fitness[same], need[same])
    return np.lexsort((-room, ranks))


def ranks_of(fitness: PerGait, need: PerGait) -> np.ndarray:
    """(gaits,), 0 for gaits that none dominates, 1 for those that only these dominate, and so on.

    A gait dominates another if it is no worse in both, and better in one.
    """
    better = (fitness[:, None] >= fitness) & (need[:, None] <= need)
    dominates = better & ((fitness[:, None] > fitness) | (need[:, None] < need))
    ranks, left, rank = np.zeros(len(need), int), np.ones(len(need), bool), 0
    while left.any():
        now = left & ~dominates[left].any(0)
        ranks[now], left, rank = rank, left & ~now, rank + 1
    return ranks


def _room(fitness: PerGait, need: PerGait) -> np.ndarray:
    """(gaits,), crowding distance: gap between the neighbours in both, as shares of the range. Ends: infinite."""
    room = np.zeros(len(need))
    if not np.isfinite(need).all():  # failed gaits, or those below the least fitness, which have ranks of their own
        return room
    for values in (fitness, need):
        order = np.argsort(values)
        room[order[[0, -1]]] = np.inf
        room[order[1:-1]] += (values[order[2:]] - values[order[:-2]]) / max(np.ptp(values), np.finfo(float).tiny)
    return room

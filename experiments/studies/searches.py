"""Searches for phases by which an ensemble of robots rolls far, each at the cost of so many rollouts.

Random search, CMA-ES and differential evolution (DE) of evosax (the extra `baselines`), and this library's genetic
algorithm (GA) alone, running on, and with polish. A search pays for all its rollouts, those too by which it chooses its
answer from the best that it ends with.
"""

from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxgrity import Fitness, GAConfig, InputError, PolishConfig, SearchProblem, SolverOptions, Uncertainty, polish
from jaxgrity.search import FidelityLevel, distinct, evolve_through, judge_at

GRADIENTS = ("smoothed", "pathwise", "combined")
"""by which a gait is polished"""
EVOSAX = {"CMA-ES": "CMA_ES", "DE": "DifferentialEvolution"}
FINALISTS, POOL = 8, 16
"""gaits of a search's end, and of the GA's, of which more robots choose the answer, or where polish starts"""
OWN_ROBOTS, FINAL_ROBOTS, PAIR_ROBOTS = 4, 32, 64
"""robots by which the GA searches, by which finalists are compared, and a polished gait with its start"""
SCREENED = 0.25
"""share of what the GA spends before polish that goes into screening on the contact twin, where it screens there"""
DRAWS = 10**6
"""seeds of draws that each search has to itself; those below it are for the judgement of the answers"""
UNCERTAIN = Uncertainty(phase=0.03)


def robust(robots: int, caution: float = 0.0) -> Fitness:
    """The mean distance of so many robots whose phases are off, less some of its spread."""
    return Fitness(uncertainty=UNCERTAIN, robots=robots, caution=caution)


class Task(NamedTuple):
    """What all searches on one scene have in common."""

    problem: SearchProblem
    population: int
    levels: tuple[FidelityLevel, ...]
    """where the GA searches; all others use the last of them, the cheapest of the scene's own model"""
    weights: tuple[float, ...]
    """cost of a rollout on each level, in rollouts of the own model at its default step"""
    polished: float
    """share of the rollouts for polish"""

    def judged_by(self, fitness: Fitness) -> SearchProblem:
        """The problem with another fitness."""
        return self.problem._replace(fitness=fitness)


@dataclass
class Trace:
    """What became of a search, generation by generation."""

    rollouts: list[float] = field(default_factory=list)
    """spent so far"""
    best: list[float] = field(default_factory=list)
    """robust distance of the best, by the search's own ensemble, m"""
    failed: list[int] = field(default_factory=list)
    """gaits that failed so far"""

    def spend(self, rollouts: float, best: float, failed: int = 0) -> None:
        """Note one more generation."""
        self.rollouts.append((self.rollouts[-1] if self.rollouts else 0.0) + rollouts)
        self.best.append(float(best))
        self.failed.append((self.failed[-1] if self.failed else 0) + int(failed))

    def __len__(self) -> int:
        return len(self.rollouts)


class Found(NamedTuple):
    """What a search ends with."""

    genes: np.ndarray
    """of its answer"""
    trace: Trace
    polish: dict[str, Any] | None = None
    """what polish did"""


def random_search(task: Task, budget: int, seed: int, *, fitness: Fitness) -> Found:
    """The best of gaits drawn at random."""
    size = task.population * OWN_ROBOTS // fitness.robots
    trace, count = Trace(), generations(task, budget, size * fitness.robots)
    genes = np.random.default_rng(seed).uniform(size=(count, size, task.problem.genome.size))
    found = np.concatenate([_try_out(task, some, fitness, seed, trace, keeps=True) for some in genes])
    return _choose(task, np.concatenate(genes)[np.argsort(-found)[:FINALISTS]], seed, trace)


def evosax_search(name: str, task: Task, budget: int, seed: int, *, fitness: Fitness) -> Found:
    """CMA-ES from 1 rad around a random gait, or DE, which judges none twice; angles go on beyond a turn for both."""
    cma, trace, key = name == "CMA-ES", Trace(), jax.random.key(seed)
    size, finalists = (task.population // 2, 2) if cma else (task.population, FINALISTS)
    algorithm, parameters = built(name, size, task.problem.genome.size)
    genes = jax.random.uniform(key, (size, task.problem.genome.size))
    first = [genes[0]] if cma else [genes, -_try_out(task, genes, fitness, seed, trace, keeps=True)]
    state = algorithm.init(key, *first, parameters)
    while len(trace) < generations(task, budget, size * fitness.robots, finalists):
        asked, told = jax.random.split(jax.random.fold_in(key, len(trace)))
        genes, state = algorithm.ask(asked, state, parameters)
        found = _try_out(task, genes, fitness, seed, trace, keeps=not cma)
        state, _ = algorithm.tell(told, genes, -found, state, parameters)
    last = [state.mean, genes[np.argmax(found)]] if cma else state.population[np.argsort(state.fitness)[:finalists]]
    return _choose(task, last, seed, trace)


@cache
def built(name: str, population: int, size: int):
    """One of evosax's algorithms and its parameters, once for all seeds: a new object would be compiled anew.

    Raises `InputError` where evosax is missing.
    """
    try:
        from evosax import algorithms
    except ImportError as error:
        raise InputError("CMA-ES and DE need evosax: pip install -e '.[baselines]'") from error
    algorithm = getattr(algorithms, EVOSAX[name])(population, np.zeros(size))
    parameters = algorithm.default_params
    return algorithm, parameters.replace(std_init=1 / (2 * np.pi)) if name == "CMA-ES" else parameters


def genetic_search(task: Task, budget: int, seed: int, then: str | None = None, caution: float = 0.0) -> Found:
    """The GA on each of the levels. With `then` it has only a part of the budget, and after it the rest is spent on
    more generations with mutations that no longer shrink ("more"), or on polish by one of the `GRADIENTS`."""
    trace, each, draws = Trace(), task.population * OWN_ROBOTS, DRAWS * (seed + 1)
    problem = task.judged_by(robust(OWN_ROBOTS, caution))
    searches = evolve_through(task.levels, problem, _ga_configs(task, budget, then), seed=draws)
    for weight, search in zip(task.weights, searches):
        for best, failed in zip(search.best, search.failed):
            trace.spend(weight * each, best, failed)
    genes = distinct(searches[-1].last, task.problem.genome, POOL)
    best = genes[np.argmax(_try_out(task, genes, robust(FINAL_ROBOTS), seed, trace))]
    if then in (None, "more"):
        return Found(best, trace)
    last = 2 * task.weights[-1] * 2 * PAIR_ROBOTS  # float64 counts twice
    rollouts = int((task.polished * budget - last) / task.weights[-1])
    config = PolishConfig(rollouts, then, robots=OWN_ROBOTS, final_robots=PAIR_ROBOTS)
    step = SolverOptions(dt=task.levels[-1].dt)
    polished = polish(problem, best[None], config, options=step, final_options=step, seed=draws + len(trace))
    judged = polished.after if polished.improved else polished.before
    trace.spend(task.weights[-1] * polished.rollouts + last, judged.mean[0])
    share = np.mean([done.pathwise_share for done in polished.steps]) if polished.steps else None
    said = {"improved": polished.improved, "horizon": polished.horizon, "pathwise_share": share}
    return Found(polished.genes, trace, {**said, "reason": polished.reason})


def _ga_configs(task: Task, budget: int, then: str | None) -> tuple[GAConfig, ...]:
    """How many generations the GA has on each of the levels."""
    each, elites = task.population * OWN_ROBOTS, task.population // 8
    left = (1 - task.polished) * budget if then else budget
    counts = [max(1, int(SCREENED * left / (weight * each))) for weight in task.weights[:-1]]
    screening = each * np.dot(counts, task.weights[:-1])
    counts.append(generations(task, left - screening, each, POOL))
    configs = [GAConfig(task.population, count, elites) for count in counts]
    if then == "more":
        more = generations(task, budget - screening, each, POOL)
        configs[-1] = GAConfig(task.population, more, elites, shrinking=counts[-1])
    return tuple(configs)


def generations(task: Task, budget: float, rollouts: int, finalists: int = FINALISTS) -> int:
    """How many generations of so many rollouts can be paid, when the choice of the answer is paid too.

    Raises `InputError` where that is none.
    """
    count = int((budget / task.weights[-1] - finalists * FINAL_ROBOTS) / rollouts)
    if count < 1:
        raise InputError(f"{budget:g} rollouts: expected more, for a generation and the choice of an answer")
    return count


def _try_out(task: Task, genes, fitness: Fitness, seed: int, trace: Trace, keeps: bool = False) -> np.ndarray:
    """The merit of each gait, by new draws; the best of all so far counts where the search `keeps` it."""
    scene, genome = task.problem.scene, task.problem.genome
    gaits = genome.gaits(scene.gait, genome.within(np.asarray(genes, float)))
    scores = judge_at(task.levels[-1], gaits, task.judged_by(fitness), DRAWS * (seed + 1) + len(trace))
    best = max(scores.merit.max(), trace.best[-1] if keeps and trace else -np.inf)
    trace.spend(task.weights[-1] * scores.each.size, best, scores.failed.sum())
    return scores.merit


def _choose(task: Task, genes, seed: int, trace: Trace) -> Found:
    """The best of the finalists, by more robots."""
    genes = np.asarray(task.problem.genome.within(np.asarray(genes, float)))
    return Found(genes[np.argmax(_try_out(task, genes, robust(FINAL_ROBOTS), seed, trace))], trace)

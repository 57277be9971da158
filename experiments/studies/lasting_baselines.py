"""Searches for gaits that last, at equal cost: random search, CMA-ES of evosax (the extra `baselines`) and this
library's genetic algorithm (GA), all without polish.

Phases, amplitudes and frequency are free; what counts is steady speed by robots that differ. Gaits are waves, or each
actuator moves as it likes. All searches screen by the same rough rollouts, and may have as many of them; each compares
its finalists by more robots. All answers are then judged by one and the same ensemble, on both contact models.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import product
from typing import Literal, NamedTuple, get_args

import jax
import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import by_name, columns, table

from jaxgrity import GAConfig, InputError, SearchConfig, SearchProblem, contact_twin, evolve, load_scene
from jaxgrity.search import (
    SearchSpace,
    distinct,
    fidelity_levels,
    ga_configs,
    judge_at,
    search_problem,
    with_robots,
    without_force_bounds,
)

Method = Literal["random", "CMA-ES", "GA without crossover", "GA"]
Freedom = Literal["waves", "waves with overtones", "free"]
OVERTONES = 2
"""of waves with overtones"""
DRAWN = 4
"""times the population: random gaits with which every search begins"""
FINALISTS, COMPARED, JUDGES, JUDGED_FOR = 8, 32, 64, 60.0
"""answers that are compared, and the robots by which; those by which all answers are judged, and for how long, s"""
SPREAD = 1 / (2 * np.pi)
"""Standard deviation of the first draws of CMA-ES, where 1 is a turn of the circle or the width of the bounds."""
FEW = 96
"""Gaits of a search up to which it is a look at whether all of it works."""
DRAWS = 10**6
"""seeds of draws that each search has to itself; those below it are for the judgement of the answers"""


class Size(NamedTuple):
    """How large a search may be."""

    gaits: int
    """that it may try"""
    population: int
    """of the GA, and of CMA-ES half as many"""


@measurement(
    page="search_records.md",
    quick={"seeds": 1, "gaits": 96, "population": 16, "duration": 10.0},
    raw=("answers",),
    drawn=("speeds",),
)
def lasting_baselines(
    freedoms: tuple[Freedom, ...] = get_args(Freedom),
    methods: tuple[Method, ...] = get_args(Method),
    seeds: int = 8,
    gaits: int = 512,
    population: int = 32,
    duration: float = SearchConfig().duration,
) -> Iterator[Record]:
    """A row for each answer until all are done; then one for each search, of its answers' steady speeds.

    Args:
        freedoms: what gaits may be
        methods: searches to compare
        seeds: searches by each method
        gaits: that a search may try, each on as many robots as in the default search
        population: of the GA, and of CMA-ES half as many
        duration: s, of a rollout
    """
    if "CMA-ES" in methods:
        built(4, 1, SPREAD)
    scene, size, answers = load_scene("exact"), Size(gaits, population), []
    searches: dict[str, Callable] = {"random": random_search, "CMA-ES": cma_es, "GA": genetic}
    searches["GA without crossover"] = partial(genetic, crossover=0.0)
    # all robots judge for longer than searches take: small sizes have few of them
    judges, judged_for = (JUDGES, JUDGED_FOR) if gaits > FEW else (8, duration)
    for freedom, seed, method in product(freedoms, range(seeds), methods):
        waves, overtones = "none" if freedom == "free" else "every", OVERTONES * (freedom == "waves with overtones")
        space = SearchSpace(waves=waves, overtones=overtones)
        problem = search_problem(scene, SearchConfig(duration, population, space=space))
        genes = chosen(problem, searches[method](problem, size, DRAWS * (seed + 1)), DRAWS * (seed + 1))
        known = {"freedom": freedom, "method": method, "seed": seed}
        answers.append(known | judged(problem, genes, judges, judged_for))
        yield answers[-1]
    about = {"gaits": gaits, "duration": duration}
    speeds = by_name(answers, "freedom", "method", "own")
    return about | {"rows": told(answers), "answers": answers, "speeds": speeds}


def told(answers: list[Record]) -> list[Record]:
    """Of each search: its answers' steady speeds on both contact models."""
    rows = []
    for freedom, method in dict.fromkeys((row["freedom"], row["method"]) for row in answers):
        mine = [row for row in answers if (row["freedom"], row["method"]) == (freedom, method)]
        # not a number where a robot failed
        own, other = ([row[name] for row in mine if np.isfinite(row[name])] for name in ("own", "other"))
        about = {"freedom": freedom, "method": method, "seeds": len(mine), "stood": len(own)}
        low, median, high = (float(x) for x in np.quantile(own, (0.25, 0.5, 0.75))) if own else 3 * (None,)
        found = {"median": median, "quartiles": [low, high], "other": float(np.median(other)) if other else None}
        rows.append(about | found)
    return rows


@lasting_baselines.table
def words(record: Record) -> str:
    """Steady speeds of each search's answers, and how much each could try."""
    cells = {
        "gaits": "{freedom}",
        "search": "{method}",
        "steady speed, body lengths/s (quartiles)": "{median:.3f} ({quartiles[0]:.3f} to {quartiles[1]:.3f})",
        "on the other contact model": "{other:.3f}",
    }
    stood, seeds = (sum(row[name] for row in record["rows"]) for name in ("stood", "seeds"))
    about = [str(record["gaits"]), f"{record['duration']:g} s", f"{stood} of {seeds}"]
    settings = table(
        ["gaits that each search tries", "duration", "gaits found with which no simulation failed"], [about]
    )
    return f"{columns(record['rows'], cells)}\n\n{settings}"


def tried(problem: SearchProblem, genes: np.ndarray, seed: int) -> np.ndarray:
    """The merit of gaits by rough rollouts."""
    gaits = problem.genome.gaits(problem.scene.gait, problem.genome.wrapped(np.asarray(genes, float)))
    return np.asarray(judge_at(fidelity_levels(problem.scene).screening, gaits, plain(problem), seed).merit)


def plain(problem: SearchProblem) -> SearchProblem:
    """The problem without bounds on forces and powers, which rough rollouts are not measured for."""
    return problem._replace(fitness=without_force_bounds(problem.fitness))


def first(problem: SearchProblem, size: Size, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The random gaits with which a search begins, and their fitness, best first."""
    genes = np.random.default_rng(seed).uniform(size=(DRAWN * size.population, problem.genome.size))
    found = tried(problem, genes, seed)
    order = np.argsort(-found)
    return genes[order], found[order]


def random_search(problem: SearchProblem, size: Size, seed: int) -> np.ndarray:
    """The best of gaits drawn at random."""
    genes = np.random.default_rng(seed).uniform(size=(size.gaits, problem.genome.size))
    return genes[np.argsort(-tried(problem, genes, seed))[:FINALISTS]]


@cache
def built(population: int, size: int, spread: float):
    """CMA-ES of evosax and its parameters, once for all seeds: a new object would be compiled anew.

    Its first draws have this standard deviation. Raises `InputError` where evosax is missing.
    """
    try:
        from evosax.algorithms import CMA_ES
    except ImportError as error:
        raise InputError("CMA-ES needs evosax: pip install -e '.[baselines]'") from error
    algorithm = CMA_ES(population, np.zeros(size))
    return algorithm, algorithm.default_params.replace(std_init=spread)


def cma_es(problem: SearchProblem, size: Size, seed: int) -> np.ndarray:
    """CMA-ES from the best of the random gaits; its mean, and the best of its last generations."""
    genes, _ = first(problem, size, seed)
    each, key = size.population // 2, jax.random.key(seed)
    algorithm, parameters = built(each, problem.genome.size, SPREAD)
    state, best = algorithm.init(key, genes[0], parameters), []
    for number in range((size.gaits - len(genes)) // each):
        asked, told = jax.random.split(jax.random.fold_in(key, number))
        some, state = algorithm.ask(asked, state, parameters)
        found = tried(problem, some, seed + 1 + number)
        state, _ = algorithm.tell(told, some, -found, state, parameters)
        best.append(np.asarray(some)[np.argmax(found)])
    return np.array([np.asarray(state.mean), *best[::-1]])[:FINALISTS]


def genetic(problem: SearchProblem, size: Size, seed: int, crossover: float = 1.0) -> np.ndarray:
    """The GA as the default search screens, with this share of children of two parents."""
    count = size.gaits // size.population - DRAWN + 1
    ga: GAConfig = ga_configs(SearchConfig(population=size.population, generations=(count, 0)), 1)[0]
    options = fidelity_levels(problem.scene).screening.options
    ga = replace(ga, crossover=crossover)
    return distinct(evolve(plain(problem), ga, options=options, seed=seed).last, problem.genome, FINALISTS)


def chosen(problem: SearchProblem, genes: np.ndarray, seed: int) -> np.ndarray:
    """The best of the finalists, by more robots."""
    genes = np.asarray(problem.genome.wrapped(np.asarray(genes, float)))
    more = problem._replace(fitness=with_robots(problem.fitness, COMPARED))
    return genes[int(np.argmax(tried(more, genes, seed - 1)))]


def judged(problem: SearchProblem, genes: np.ndarray, judges: int, duration: float) -> dict[str, float]:
    """Mean steady speed of an answer over robots on both contact models, body lengths/s, the same for all searches; not
    a number where a robot failed."""
    gaits = problem.genome.gaits(problem.scene.gait, genes[None])
    here = problem._replace(fitness=with_robots(plain(problem).fitness, judges), duration=duration)
    models = {"own": problem.scene, "other": contact_twin(problem.scene)}
    return {name: float(judge_at(fidelity_levels(each).own, gaits, here, 0).mean[0]) for name, each in models.items()}


@lasting_baselines.figure(5)
def figure(record: Record, chart: Figure) -> None:
    """Every answer's steady speed on the own contact model, and the medians."""
    each = {name: np.array(values) for name, values in record["speeds"].items()}
    speeds = each["own"].astype(float)
    freedoms, methods = (list(dict.fromkeys(each[name])) for name in ("freedom", "method"))
    panes = chart.subplots(1, len(freedoms), sharey=True, squeeze=False)[0]
    for axes, freedom in zip(panes, freedoms, strict=True):
        for k, method in enumerate(methods):
            found = speeds[(each["freedom"] == freedom) & (each["method"] == method)]
            named = ("a search", "median") if k == 0 else (None, None)
            axes.plot(found, k + np.linspace(-0.2, 0.2, len(found)), "o", ms=5, alpha=0.6, color="C0", label=named[0])
            axes.plot(np.nanmedian(found), k, "|", color="black", ms=16, markeredgewidth=2, label=named[1])
        axes.set_yticks(range(len(methods)), methods)
        fastest = np.nanmax(speeds[each["freedom"] == freedom])
        axes.set(title="free gaits" if freedom == "free" else freedom, xlim=(0, 1.05 * fastest))
        axes.set_xlabel("steady speed (body lengths/s)")
    panes[0].invert_yaxis()
    chart.legend(*panes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)

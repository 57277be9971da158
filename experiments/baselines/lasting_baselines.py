"""Searches for gaits that last, at equal cost: random search, CMA-ES of evosax (the extra `baselines`) and this
library's genetic algorithm (GA), each alone and followed by either polish.

Phases, amplitudes and frequency are free; what counts is steady speed by robots that differ. Gaits are waves, or each
actuator moves as it likes. All searches screen by the same rough rollouts, and may have as many of them; each compares
its finalists by more robots. All answers are then judged by one and the same ensemble, on both contact models.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from jaxgrity.cli.script import measured, run

import jax
import numpy as np
from matplotlib.figure import Figure
from searches import built
from tqdm import tqdm

from jaxgrity import GAConfig, PolishConfig, SearchConfig, SearchProblem, contact_twin, evolve, load_scene, polish
from jaxgrity.io.files import save_json
from jaxgrity.report import plot
from jaxgrity.search import (
    distinct,
    fidelity_levels,
    ga_configs,
    judge_at,
    search_problem,
    with_robots,
    without_measuring,
)

Method = Literal["random", "CMA-ES", "GA"]
Freedom = Literal["waves", "free"]
DRAWN = 4
"""times the population: random gaits with which every search begins"""
FINALISTS, COMPARED, JUDGES, JUDGED_FOR = 8, 32, 64, 60.0
"""answers that are compared, and the robots by which; those by which all answers are judged, and for how long, s"""
POLISH = ("smoothed", "orbit")
"""kinds of it"""
DRAWS = 10**6
"""seeds of draws that each search has to itself; those below it are for the judgement of the answers"""


@dataclass
class Settings:
    freedoms: tuple[Freedom, ...] = get_args(Freedom)
    """what gaits may be"""
    methods: tuple[Method, ...] = get_args(Method)
    """searches to compare"""
    seeds: int = 8
    """searches by each method"""
    gaits: int = 512
    """that a search may try, each on as many robots as in the default search"""
    population: int = 32
    """of the GA, and of CMA-ES half as many"""
    polish: int = PolishConfig().rollouts
    """rollouts of each kind of polish after each search; 0: none"""
    out: Path = Path("results/lasting_baselines")
    """folder for lasting_baselines.json and its figure"""
    quick: bool = False
    """one seed, 96 gaits, 10 s"""


def main(settings: Settings) -> None:
    duration, polishing = SearchConfig().duration, PolishConfig(settings.polish)
    if settings.quick:
        settings.seeds, settings.gaits, settings.population, duration = 1, 96, 16, 10.0
        polishing = PolishConfig(min(settings.polish, 64), final_robots=16)
    if "CMA-ES" in settings.methods:
        built("CMA-ES", 4, 1)
    scene, rows = load_scene("exact"), []
    searches: dict[str, Callable] = {"random": random_search, "CMA-ES": cma_es, "GA": genetic}
    wanted = [(f, s, m) for f in settings.freedoms for s in range(settings.seeds) for m in settings.methods]
    for freedom, seed, method in tqdm(wanted, unit="search"):
        waves = "every" if freedom == "waves" else "none"
        problem = search_problem(scene, SearchConfig(duration, settings.population, waves=waves))
        found = searches[method](problem, settings, DRAWS * (seed + 1))
        genes = chosen(problem, found, DRAWS * (seed + 1))
        answers = {method: genes}
        kept: dict[str, bool] = {}
        for kind in POLISH if settings.polish else ():
            own, config = fidelity_levels(scene)[1].options, polishing._replace(kind=kind)
            polished = polish(problem, genes[None], config, options=own, final_options=own, seed=seed)
            answers[name := f"{method}, polish {kind}"] = polished.genes
            kept[name] = polished.improved
        for name, answer in answers.items():
            known = {"freedom": freedom, "method": name, "seed": seed, "kept": kept.get(name)}
            rows.append(known | judged(problem, answer, settings.quick))
        facts = {**measured(), "gaits": settings.gaits, "duration": duration, "polish": polishing.rollouts}
        save_json(settings.out / "lasting_baselines.json", {**facts, "rows": rows})
    plot.save(figure(rows), settings.out / "lasting_baselines.png")
    for freedom, method in dict.fromkeys((row["freedom"], row["method"]) for row in rows):
        speeds = [row["own"] for row in rows if (row["freedom"], row["method"]) == (freedom, method)]
        print(f"{freedom}, {method}: median {np.nanmedian(speeds):.3f} body lengths/s")
    print(f"wrote {settings.out}/")


def tried(problem: SearchProblem, genes: np.ndarray, seed: int) -> np.ndarray:
    """The merit of gaits by rough rollouts."""
    gaits = problem.genome.gaits(problem.scene.gait, problem.genome.within(np.asarray(genes, float)))
    return np.asarray(judge_at(fidelity_levels(problem.scene)[0], gaits, unmeasured(problem), seed).merit)


def unmeasured(problem: SearchProblem) -> SearchProblem:
    """The problem without bounds on forces and powers, which rough rollouts are not measured for."""
    return problem._replace(fitness=without_measuring(problem.fitness))


def first(problem: SearchProblem, settings: Settings, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The random gaits with which a search begins, and their fitness, best first."""
    genes = np.random.default_rng(seed).uniform(size=(DRAWN * settings.population, problem.genome.size))
    found = tried(problem, genes, seed)
    order = np.argsort(-found)
    return genes[order], found[order]


def random_search(problem: SearchProblem, settings: Settings, seed: int) -> np.ndarray:
    """The best of gaits drawn at random."""
    genes = np.random.default_rng(seed).uniform(size=(settings.gaits, problem.genome.size))
    return genes[np.argsort(-tried(problem, genes, seed))[:FINALISTS]]


def cma_es(problem: SearchProblem, settings: Settings, seed: int) -> np.ndarray:
    """CMA-ES from the best of the random gaits; its mean, and the best of its last generations."""
    genes, _ = first(problem, settings, seed)
    size, key = settings.population // 2, jax.random.key(seed)
    algorithm, parameters = built("CMA-ES", size, problem.genome.size)
    state, best = algorithm.init(key, genes[0], parameters), []
    for number in range((settings.gaits - len(genes)) // size):
        asked, told = jax.random.split(jax.random.fold_in(key, number))
        some, state = algorithm.ask(asked, state, parameters)
        found = tried(problem, some, seed + 1 + number)
        state, _ = algorithm.tell(told, some, -found, state, parameters)
        best.append(np.asarray(some)[np.argmax(found)])
    return np.array([np.asarray(state.mean), *best[::-1]])[:FINALISTS]


def genetic(problem: SearchProblem, settings: Settings, seed: int) -> np.ndarray:
    """The GA as the default search screens."""
    config = SearchConfig(population=settings.population)
    count = settings.gaits // settings.population - DRAWN + 1
    ga: GAConfig = ga_configs(SearchConfig(population=config.population, generations=(count, 0)), 1)[0]
    options = fidelity_levels(problem.scene)[0].options
    return distinct(evolve(unmeasured(problem), ga, options=options, seed=seed).last, problem.genome, FINALISTS)


def chosen(problem: SearchProblem, genes: np.ndarray, seed: int) -> np.ndarray:
    """The best of the finalists, by more robots."""
    genes = np.asarray(problem.genome.within(np.asarray(genes, float)))
    more = problem._replace(fitness=with_robots(problem.fitness, COMPARED))
    return genes[int(np.argmax(tried(more, genes, seed - 1)))]


def judged(problem: SearchProblem, genes: np.ndarray, quick: bool) -> dict[str, Any]:
    """Mean steady speed of an answer over robots on both contact models, body lengths/s, the same for all searches; not
    a number where a robot failed."""
    gaits = problem.genome.gaits(problem.scene.gait, genes[None])
    fitness = with_robots(unmeasured(problem).fitness, 8 if quick else JUDGES)
    here = problem._replace(fitness=fitness, duration=problem.duration if quick else JUDGED_FOR)
    models = {"own": problem.scene, "other": contact_twin(problem.scene)}
    return {name: float(judge_at(fidelity_levels(each)[1], gaits, here, 0).mean[0]) for name, each in models.items()}


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """Every answer's steady speed on the own contact model, and the medians."""
    freedoms = list(dict.fromkeys(row["freedom"] for row in rows))
    chart = Figure(figsize=(5 * len(freedoms), 4.5), layout="constrained")
    for axes, freedom in zip(chart.subplots(1, len(freedoms), sharey=True, squeeze=False)[0], freedoms, strict=True):
        methods = list(dict.fromkeys(row["method"] for row in rows if row["freedom"] == freedom))
        for k, method in enumerate(methods):
            found = [row["own"] for row in rows if (row["freedom"], row["method"]) == (freedom, method)]
            axes.plot(k + np.linspace(-0.15, 0.15, len(found)), found, "o", ms=4, color=f"C{k}")
            axes.hlines(np.nanmedian(found), k - 0.3, k + 0.3, color=f"C{k}")
        axes.set_xticks(range(len(methods)), methods, rotation=30, ha="right")
        axes.set(title={"waves": "gaits are waves", "free": "each actuator as it likes"}[freedom], ylim=(0, None))
        axes.set_ylabel("steady speed (body lengths/s)")
    return chart


if __name__ == "__main__":
    run(main, Settings)

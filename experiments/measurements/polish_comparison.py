"""Polish by different gradients, at equal rollouts: what each gains over where it began, and over a longer search.

Short searches for steady speed, one for each seed, end with a gait. From there go on: polish by smoothed gradients,
polish by the derivative of the orbit's own speed, and the search itself with more generations, both as it was and with
the overtones that polishing shapes. Each may spend the same number of rollouts. All answers are judged by the same
robots, which nothing was chosen by.
"""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from jaxgrity.cli.script import measured, run

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import GAConfig, PolishConfig, SearchConfig, SearchProblem, load_scene, polish
from jaxgrity.io.files import save_json
from jaxgrity.report import plot
from jaxgrity.search import (
    FidelityLevel,
    SearchState,
    distinct,
    evolve_through,
    fidelity_levels,
    ga_configs,
    genome_to_polish,
    judge_at,
    search_levels,
    search_problem,
    with_robots,
    without_measuring,
)

WAYS = ("search runs on", "search with overtones", "smoothed", "orbit")
FINALISTS, COMPARED = 4, 32
"""of a search, and the robots by which they are compared"""
WIDTH = 0.004
"""of the last mutations, with which a search runs on: a turn of the circle, or the width of the bounds, is 1"""
UNSEEN = 10**6
"""seed of the draws by which answers are judged"""


@dataclass
class Settings:
    seeds: int = 8
    """searches, with seeds that nothing was tuned on"""
    population: int = 48
    """gaits in a generation of the search"""
    generations: tuple[int, int] = (6, 2)
    """as in `jaxgrity search`"""
    rollouts: int = PolishConfig().rollouts
    """that each way may spend"""
    judges: int = 256
    """robots by which all answers are judged"""
    duration: float = 40.0
    """s"""
    waves: bool = True
    """whether gaits are waves; else each actuator moves as it likes"""
    out: Path = Path("results/polish_comparison")
    """folder for polish_comparison.json and its figure"""
    quick: bool = False
    """one seed, few rollouts"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.seeds, settings.population, settings.generations, settings.judges = 1, 16, (2, 1), 8
        settings.rollouts = 256
    scene, rows = load_scene("exact"), []
    config = SearchConfig(
        settings.duration, settings.population, settings.generations, waves="every" if settings.waves else "none"
    )
    problem = search_problem(scene, config)
    plain = problem._replace(fitness=without_measuring(problem.fitness))
    levels = fidelity_levels(scene, None, False, config.wide)
    searched, configs = search_levels(levels), ga_configs(config, len(search_levels(levels)))
    for seed in tqdm(range(100, 100 + settings.seeds), unit="seed"):
        states: dict[int, SearchState] = {}
        searches = evolve_through(searched, plain, configs, seed=seed, on_generation=states.__setitem__)
        start = compared(plain, levels[1], distinct(searches[-1].last, plain.genome, FINALISTS), seed)
        begun = start, states[max(states)], configs[-1]
        genome, wider = genome_to_polish(plain, start, config)
        shaped = plain._replace(genome=genome)
        answers = {"start": (wider, {})}
        for way in WAYS:
            began = perf_counter()
            if way == "search runs on":
                found = runs_on(plain, levels[1], begun, settings.rollouts, seed)
                genes, facts = genome_to_polish(plain, found, config)[1], {}
            else:
                genes, facts = gone_on(way, shaped, levels[1], (wider, *begun[1:]), settings, seed)
            answers[way] = genes, {**facts, "seconds": perf_counter() - began}
        rows += [
            {"seed": seed, "way": way, **facts, **judged}
            for (way, (_, facts)), judged in zip(
                answers.items(), judgement(shaped, levels[1], [genes for genes, _ in answers.values()], settings)
            )
        ]
        save_json(settings.out / "polish_comparison.json", {**measured(), "rollouts": settings.rollouts, "rows": rows})
    plot.save(figure(rows), settings.out / "polish_comparison.png")
    for way in WAYS:
        gains = [row["fitness"] - rows_of(rows, "start", row["seed"])["fitness"] for row in rows if row["way"] == way]
        print(
            f"{way}: gains {np.median(gains):+.4f} body lengths/s in the median, {np.mean(np.array(gains) > 0):.0%} up"
        )
    print(f"wrote {settings.out}/")


def gone_on(
    way: str,
    problem: SearchProblem,
    level: FidelityLevel,
    begun: tuple[np.ndarray, SearchState, GAConfig],
    settings: Settings,
    seed: int,
) -> tuple[np.ndarray, dict[str, Any]]:
    """The genes at which one way ends, and what is said of it."""
    start = begun[0]
    if way == "search with overtones":
        return runs_on(problem, level, (start, wider_state(problem, begun[1]), begun[2]), settings.rollouts, seed), {}
    config = PolishConfig(settings.rollouts, way, final_robots=64 if not settings.quick else 8)
    found = polish(problem, start[None], config, options=level.options, final_options=level.options, seed=seed)
    facts = {"kept": found.improved, "steps": len(found.steps), "spent": found.rollouts, "reason": found.reason}
    return np.asarray(found.genes), facts


def wider_state(problem: SearchProblem, state: SearchState) -> SearchState:
    """The state of a search whose gaits had fewer overtones."""

    def wider(genes):
        narrow = dataclasses.replace(problem.genome, overtones=0)
        return np.asarray(narrow.with_overtones(genes, problem.genome.overtones)[1], np.asarray(genes).dtype)

    assert state.evaluated is not None, "it was saved after a generation"
    evaluated = state.evaluated._replace(genes=wider(state.evaluated.genes))
    return state._replace(genes=wider(state.genes), evaluated=evaluated)


def runs_on(
    problem: SearchProblem,
    level: FidelityLevel,
    begun: tuple[np.ndarray, SearchState, GAConfig],
    rollouts: int,
    seed: int,
) -> np.ndarray:
    """The best of the start and of more generations on the scene's own model, with mutations as narrow as the last."""
    (start, state, done), count = begun, FINALISTS - 1
    size = done.population
    generations = max(1, (rollouts - FINALISTS * COMPARED) // (size * problem.fitness.rollouts))
    more = GAConfig(size, generations, done.elites, 1, 1.0, (WIDTH, WIDTH), crossover=0.0, parents=done.parents)
    _, found = evolve_through((level, level), problem, (done, more), seed=seed + UNSEEN, states=(state,))
    better = distinct(found.last, problem.genome, count, apart=0.0)
    return compared(problem, level, np.concatenate([start[None], better]), seed + 1)


def compared(problem: SearchProblem, level: FidelityLevel, genes: np.ndarray, seed: int) -> np.ndarray:
    """The best of the finalists, by more robots."""
    more = problem._replace(fitness=with_robots(problem.fitness, COMPARED))
    found = judge_at(level, problem.genome.gaits(problem.scene.gait, genes), more, seed)
    return np.asarray(genes, float)[int(np.argmax(found.merit))]


def judgement(
    problem: SearchProblem, level: FidelityLevel, genes: list[np.ndarray], settings: Settings
) -> list[dict[str, Any]]:
    """Fitness and mean steady speed of every answer, body lengths/s, by the same robots."""
    more = problem._replace(fitness=with_robots(problem.fitness, settings.judges))
    found = judge_at(level, problem.genome.gaits(problem.scene.gait, np.stack(genes)), more, UNSEEN)
    return [
        {"genes": each.tolist(), "fitness": float(fit), "mean": float(mean), "spread": float(spread)}
        for each, fit, mean, spread in zip(genes, found.fitness, found.mean, found.spread)
    ]


def rows_of(rows: list[dict[str, Any]], way: str, seed: int) -> dict[str, Any]:
    """The row of one way on one seed."""
    return next(row for row in rows if (row["way"], row["seed"]) == (way, seed))


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """What every way gained over its start on each seed, and the medians."""
    chart = Figure(figsize=(6, 4.2), layout="constrained")
    axes = chart.subplots()
    seeds = list(dict.fromkeys(row["seed"] for row in rows))
    for k, way in enumerate(WAYS):
        gains = [rows_of(rows, way, s)["fitness"] - rows_of(rows, "start", s)["fitness"] for s in seeds]
        axes.plot(k + np.linspace(-0.2, 0.2, len(gains)), gains, "o", color=f"C{k}")
        axes.hlines(np.median(gains), k - 0.3, k + 0.3, color=f"C{k}")
    axes.axhline(0, color="0.7", linewidth=0.8, zorder=0)
    axes.set_xticks(
        range(len(WAYS)), ["search\nruns on", "search\nwith overtones", "polish,\nsmoothed", "polish\non the orbit"]
    )
    axes.set_ylabel("fitness gained over the start (body lengths/s)")
    return chart


if __name__ == "__main__":
    run(main, Settings)

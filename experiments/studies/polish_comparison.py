"""Polish by different gradients, at equal rollouts: what each gains over where it began, and over a longer search.

Short searches for steady speed, one for each seed, end with a gait. From there go on: polish by smoothed gradients,
polish by the derivative of the orbit's own speed, and the search itself with more generations, both as it was and with
the overtones that polishing shapes. Each may spend the same number of rollouts. All answers are judged by the same
robots, which nothing was chosen by.
"""

import dataclasses
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns, table

from jaxgrity import (
    GAConfig,
    PolishConfig,
    SearchConfig,
    SearchProblem,
    SolverOptions,
    load_scene,
    polish,
)
from jaxgrity.search import (
    EvolutionState,
    FidelityLevel,
    distinct,
    evolve_through,
    fidelity_levels,
    ga_configs,
    genome_to_polish,
    judge_at,
    search_levels,
    search_problem,
    with_robots,
    without_force_bounds,
)

WAYS = ("search runs on", "search with overtones", "smoothed", "orbit")
FINALISTS, COMPARED = 4, 32
"""of a search, and the robots by which they are compared"""
WIDTH = 0.004
"""of the last mutations, with which a search runs on: a turn of the circle, or the width of the bounds, is 1"""
UNSEEN = 10**6
"""seed of the draws by which answers are judged"""


class Begun(NamedTuple):
    """From where the ways go on."""

    genes: np.ndarray
    state: EvolutionState
    """of the search that found them"""
    config: GAConfig
    """of its last level"""


@measurement(
    page="search_records.md",
    quick={"seeds": 1, "population": 16, "generations": (2, 1), "judges": 8, "rollouts": 256, "final_robots": 8},
    drawn=("answers",),
)
def polish_comparison(
    seeds: int = 8,
    population: int = 48,
    generations: tuple[int, int] = (6, 2),
    rollouts: int = 9216,
    judges: int = 128,
    final_robots: int = 64,
) -> Iterator[Record]:
    """A row for each seed and way until all are done; then one for each way, over its start and a longer search.

    Args:
        seeds: searches, with seeds that nothing was tuned on
        population: gaits in a generation of the search
        generations: as in `jaxgrity search`
        rollouts: that each way may spend, as many as a default search polishes with
        judges: robots by which all answers are judged
        final_robots: by which polish decides what it keeps
    """
    scene, answers = load_scene("exact"), []
    config = SearchConfig(40.0, population, generations)
    problem = search_problem(scene, config)
    plain = problem._replace(fitness=without_force_bounds(problem.fitness))
    levels = fidelity_levels(scene, None, False, force_bounds=not config.wide)
    searched, configs = search_levels(levels), ga_configs(config, len(search_levels(levels)))
    for seed in range(100, 100 + seeds):
        states: dict[int, EvolutionState] = {}
        searches = evolve_through(searched, plain, configs, seed=seed, on_generation=states.__setitem__)
        start = compared(plain, levels.own, distinct(searches[-1].last, plain.genome, FINALISTS), seed)
        begun = Begun(start, states[max(states)], configs[-1])
        genome, wider = genome_to_polish(plain, start, PolishConfig())
        shaped = plain._replace(genome=genome)
        found = {"start": (wider, {})}
        for way in WAYS:
            if way == "search runs on":
                genes = genome_to_polish(plain, runs_on(plain, levels.own, begun, rollouts, seed), PolishConfig())[1]
                found[way] = genes, {}
            elif way == "search with overtones":
                shaping = begun._replace(genes=wider, state=wider_state(shaped, begun.state))
                found[way] = runs_on(shaped, levels.own, shaping, rollouts, seed), {}
            else:
                polishing = PolishConfig(rollouts, way, final_robots=final_robots)
                found[way] = polished(shaped, wider, polishing, (levels.screening.options, levels.own.options), seed)
        genes = np.stack([genes for genes, _ in found.values()])
        for (way, (_, more)), judged in zip(found.items(), judgement(shaped, levels.own, genes, judges)):
            answers.append({"seed": seed, "way": way, **more, **judged})
            yield answers[-1]
    fitness = by_seed(answers)["start"]
    starts = {"start": float(np.median(list(fitness.values()))), "seeds": len(fitness)}
    return {"rollouts": rollouts, **starts, "rows": compared_ways(answers, rollouts), "answers": answers}


def by_seed(answers: list[Record], what: str = "fitness") -> dict[str, dict[int, float]]:
    """The fitness or the mean speed of each way by seed."""
    ways = dict.fromkeys(row["way"] for row in answers)
    return {way: {row["seed"]: row[what] for row in answers if row["way"] == way} for way in ways}


def compared_ways(answers: list[Record], rollouts: int) -> list[Record]:
    """Of each way: what it gained over its start and over a longer search, seed by seed."""
    fitness, means, rows = by_seed(answers), by_seed(answers, "mean"), []
    for way in WAYS:
        gains = [fitness[way][seed] - fitness["start"][seed] for seed in fitness["start"]]
        of_means = [means[way][seed] - means["start"][seed] for seed in means["start"]]
        beyond = [fitness[way][seed] - fitness["search runs on"][seed] for seed in fitness["start"]]
        mine = [row for row in answers if row["way"] == way]
        rows.append(
            {
                "way": way,
                "gain": float(np.median(gains)),
                "quartiles": [float(x) for x in np.quantile(gains, (0.25, 0.75))],
                "gain_of_mean": float(np.median(of_means)),
                "better": sum(gain > 0 for gain in gains),
                "worse": sum(gain < 0 for gain in gains),
                "beats": sum(gain > 0 for gain in beyond),
                "kept": sum(row.get("kept", False) for row in mine) if "kept" in mine[0] else None,
                "spent": float(np.median([row["spent"] for row in mine])) if "spent" in mine[0] else rollouts,
            }
        )
    return rows


@polish_comparison.table
def words(record: Record) -> str:
    """What each way gained, and what it could spend."""
    seeds = record["seeds"]
    cells = {
        "continued by": "{way}",
        "fitness gained, body lengths/s": "{gain:+.3f} ({quartiles[0]:+.3f} to {quartiles[1]:+.3f})",
        "mean speed gained": "{gain_of_mean:+.3f}",
        "seeds better, worse": lambda row: f"{row['better']}, {row['worse']} of {seeds}",
        "beats more search": lambda row: "-" if row["way"] == "search runs on" else f"{row['beats']} of {seeds}",
        "kept": lambda row: "-" if row["kept"] is None else f"{row['kept']}",
        "rollouts": "{spent:.0f}",
    }
    about = [str(seeds), str(record["rollouts"]), f"{record['start']:.3f} body lengths/s"]
    settings = table(["seeds", "most rollouts", "fitness before, median"], [about])
    return f"{columns(record['rows'], cells)}\n\n{settings}"


def polished(
    problem: SearchProblem,
    genes: np.ndarray,
    config: PolishConfig,
    options: tuple[SolverOptions, SolverOptions],
    seed: int,
) -> tuple[np.ndarray, Record]:
    """The genes at which polish ends, and what is said of it; options of its climb, and of its comparison."""
    found = polish(problem, genes[None], config, options=options[0], final_options=options[1], seed=seed)
    return np.asarray(found.genes), {"kept": found.improved, "spent": found.rollouts}


def wider_state(problem: SearchProblem, state: EvolutionState) -> EvolutionState:
    """The state of a search whose gaits had fewer overtones."""

    def wider(genes):
        narrow = dataclasses.replace(problem.genome, overtones=0)
        return np.asarray(narrow.with_overtones(genes, problem.genome.overtones)[1], np.asarray(genes).dtype)

    assert state.evaluated is not None, "it was saved after a generation"
    evaluated = state.evaluated._replace(genes=wider(state.evaluated.genes))
    return state._replace(genes=wider(state.genes), evaluated=evaluated)


def runs_on(problem: SearchProblem, level: FidelityLevel, begun: Begun, rollouts: int, seed: int) -> np.ndarray:
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


def judgement(problem: SearchProblem, level: FidelityLevel, genes: np.ndarray, judges: int) -> list[Record]:
    """Fitness and mean steady speed of every answer, body lengths/s, by the same robots."""
    more = problem._replace(fitness=with_robots(problem.fitness, judges))
    found = judge_at(level, problem.genome.gaits(problem.scene.gait, genes), more, UNSEEN)
    return [{"fitness": float(fitness), "mean": float(mean)} for fitness, mean in zip(found.fitness, found.mean)]


@polish_comparison.figure(4.5)
def figure(record: Record, chart: Figure) -> None:
    """What every way gained over its start on each seed, and the medians."""
    axes, fitness = chart.subplots(), by_seed(record["answers"])
    for k, way in enumerate(WAYS):
        gains = [fitness[way][seed] - start for seed, start in fitness["start"].items()]
        axes.plot(k + np.linspace(-0.2, 0.2, len(gains)), gains, "o", color=f"C{k}")
        axes.hlines(np.median(gains), k - 0.3, k + 0.3, color=f"C{k}")
    axes.axhline(0, color="0.7", linewidth=0.8, zorder=0)
    axes.set_xticks(
        range(len(WAYS)), ["search\nruns on", "search\nwith overtones", "polish,\nsmoothed", "polish\non the orbit"]
    )
    axes.set_ylabel("fitness gained over the start (body lengths/s)")

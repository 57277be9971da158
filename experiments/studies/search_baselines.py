"""Gait searches at equal cost: random search, CMA-ES and differential evolution (DE) of evosax (the extra
`baselines`), this library's genetic algorithm (GA) alone, and with polish.

A search may spend so many rollouts of the scene's own model at its default step; cheaper ones count less. All answers
are then judged by one and the same ensemble in float64.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from itertools import product
from typing import Any, Literal, get_args

from shared import Figure, Record, measurement

import numpy as np
import searches
from pages import table
from searches import EVOSAX, GRADIENTS, OWN_ROBOTS, Task, robust

from jaxgrity import Fitness, Genome, SearchProblem, SolverOptions, load_scene, verify
from jaxgrity.model import gene_permutations, standing_symmetries
from jaxgrity.search import FidelityLevel, fidelity_levels, judge_at, search_levels
from jaxgrity.stepping import default_method, default_step

Method = Literal["random", "CMA-ES", "DE", "GA", "GA+more", "cautious GA", "GA+smoothed", "GA+pathwise", "GA+combined"]
WEIGHTS = {"exact": (1 / 2,), "reference": (1 / 12.9, 1 / 2)}
"""cost of a rollout on each level where gaits are searched, in rollouts of the own model at its default step: half the
steps; and 40.9 us against 527.5 us per simulated second, which benchmark.py measures for the contact twin at 10 ms and
for RK4 at 0.5 ms, both in float32"""
POLISHED = {"exact": 0.4, "reference": 0.55}
"""share of all rollouts for polish, chosen for each scene on other seeds than those that are compared"""
JUDGES = 256
"""robots by which the answers are judged"""
VERIFIED = 1 / 8
"""share of the default step that is the largest of the three steps by which a nominal gait is verified"""
QUARTILES = (0.25, 0.5, 0.75)
COLOURS = dict(zip(get_args(Method), [*(f"C{k}" for k in range(8)), "#8c564b"], strict=True))
"""of searches, the same on every figure; the style has eight"""


OTHERS = ("GA+more", "GA", "CMA-ES")
"""Searches that each search is compared with, seed by seed."""
SURE = 0.03
"""Share of the distance below which an error bar counts as small."""
COMPARED: dict[str, tuple[tuple[Method, ...], tuple[Method, ...]]] = {
    "exact": (get_args(Method), ("random",)),
    "reference": (("random", "CMA-ES", "GA", "GA+more", "GA+smoothed"), ()),
}
"""Searches that are compared on each scene; those of them that are compared in a plain form too."""


@measurement(
    page="search_records.md",
    quick={"scene": ("exact",), "seeds": 1, "rollouts": 1024, "duration": 2.0, "population": 16},
    raw=("rows",),
)
def search_baselines(
    scene: Literal["exact", "reference"],
    methods: tuple[Method, ...] = (),
    seeds: int = 8,
    rollouts: int = 4096,
    duration: float = 10.0,
    population: int = 64,
    plain: tuple[Literal["random", "CMA-ES", "DE"], ...] | None = None,
) -> Iterator[Record]:
    """A row for each search and seed; then one for each search, of its answers.

    Args:
        scene: on which to search
        methods: searches to compare; the scene's own, where not given
        seeds: searches by each method
        rollouts: that a search may spend, of the scene's own model at its default step
        duration: horizon over which distance counts, s
        population: gaits in a generation; of CMA-ES half as many
        plain: baselines to compare in their plain form too: one robot a gait, without noise
    """
    own, simple = COMPARED[scene]
    competing = contestants(methods or own, simple if plain is None else plain)
    task, runs = task_on(scene, duration, population), []
    for seed, method in product(range(seeds), competing):
        found = competing[method](task, rollouts, seed)
        trace = asdict(found.trace)
        spent = {"rollouts": trace["rollouts"][-1], "failed_gaits": trace["failed"][-1]}
        judged = judgement(task, found.genes)
        runs.append({"method": method, "seed": seed, **judged, **spent, "trace": trace, "polish": found.polish})
        yield runs[-1]
    about = {"scene": scene, "rollouts": rollouts, "duration": duration, "polished": POLISHED[scene]}
    return about | {"methods": told(runs)}


def contestants(methods: tuple[str, ...], plain: tuple[str, ...]) -> dict[str, Callable]:
    """Searches by their names. Raises `InputError` where evosax is missing, before the first of them."""
    if EVOSAX.keys() & {*methods, *plain}:
        searches.built("CMA-ES", 4, 1)
    baselines: dict[str, Callable] = {"random": searches.random_search}
    baselines |= {name: partial(searches.evosax_search, name) for name in EVOSAX}
    genetic = searches.genetic_search
    found: dict[str, Callable] = {"GA": genetic, "cautious GA": partial(genetic, caution=1.0)}
    found |= {f"GA+{then}": partial(genetic, then=then) for then in ("more", *GRADIENTS)}
    found |= {name: partial(search, fitness=robust(OWN_ROBOTS)) for name, search in baselines.items()}
    found |= {f"plain {name}": partial(baselines[name], fitness=Fitness()) for name in plain}
    return {name: found[name] for name in (*(f"plain {name}" for name in plain), *methods)}


@search_baselines.table
def words(record: Record) -> str:
    """What each search found, and what it could spend."""
    rows = []
    for row in record["methods"]:
        low, high = row["quartiles"]
        beats = [row["beats"].get(other) for other in OTHERS]
        rows.append(
            [
                row["method"],
                f"{row['median']:.3f} ({low:.3f} to {high:.3f})",
                f"{row['small_bars']} of {row['seeds']}",
                *("-" if count is None else f"{count[0]} of {count[1]}" for count in beats),
                f"{row['polish_kept']} of {row['polished']}" if row["polished"] else "-",
            ]
        )
    head = ["search", "robust distance, m: median (quartiles)", f"error bar < {SURE:.0%}"]
    head += [*(f"beats {other}" for other in OTHERS), "polish kept"]
    about = [str(record["rollouts"]), f"{record['duration']:g} s", f"{record['polished']:.0%}"]
    settings = table(["rollouts of each search", "duration of a rollout", "share for polish"], [about])
    return f"{table(head, rows)}\n\n{settings}"


def task_on(name: str, duration: float, population: int) -> Task:
    """What is searched for on a scene."""
    scene = load_scene(name)
    genome = Genome(6, images=gene_permutations(scene.gait.members, standing_symmetries(scene)))
    problem = SearchProblem(scene, genome, duration, Fitness())
    return Task(problem, population, search_levels(fidelity_levels(scene)), WEIGHTS[name], POLISHED[name])


def judgement(task: Task, genes: np.ndarray) -> dict[str, Any]:
    """Of an answer, the same for all searches and outside of what they may spend."""
    scene, duration = task.problem.scene, task.problem.duration
    gaits = task.problem.genome.gaits(scene.gait, genes[None])
    step = default_step(scene, default_method(scene))
    level = FidelityLevel("judgement", scene, step, "float64")
    scores = judge_at(level, gaits, task.judged_by(robust(JUDGES)), seed=0)
    verified = verify(scene, gaits, duration, options=SolverOptions(dt=step * VERIFIED))
    return {
        "robust": scores.mean[0],
        "spread": scores.spread[0],
        "failed_judges": int(np.isnan(scores.each).sum()),
        "distance": verified.distance[0],
        "error_bar": verified.error_bar[0],
        "genes": genes,
    }


def by_seed(runs: list[dict]) -> dict[str, dict[int, float]]:
    """Of each method, a distance for each seed, m; 0 where a robot failed, which is null in a file."""
    return {
        method: {r["seed"]: float(np.nan_to_num(np.asarray(r["robust"], float))) for r in runs if r["method"] == method}
        for method in dict.fromkeys(one["method"] for one in runs)
    }


def told(runs: list[Record]) -> list[Record]:
    """Of each search: its answers' distances, which error bars are small, and on how many seeds it beats others."""
    every, rows = by_seed(runs), []
    for method, answers in every.items():
        low, median, high = (float(x) for x in np.quantile([*answers.values()], QUARTILES))
        mine = [run for run in runs if run["method"] == method]
        known = [(run["error_bar"], run["distance"]) for run in mine if np.isfinite(run["error_bar"])]
        kept = [run["polish"]["improved"] for run in mine if run["polish"]]
        pairs = {
            other: [answers[seed] > theirs[seed] for seed in answers if seed in theirs]
            for other, theirs in every.items()
            if other in OTHERS and other != method
        }
        rows.append(
            {
                "method": method,
                "seeds": len(answers),
                "median": median,
                "quartiles": [low, high],
                "small_bars": sum(bool(bar / distance < SURE) for bar, distance in known),
                "beats": {other: [sum(pairs[other]), len(pairs[other])] for other in OTHERS if other in pairs},
                "polished": len(kept),
                "polish_kept": sum(kept),
            }
        )
    return rows


@search_baselines.figure(10.5, 5)
def figure(record: Record, chart: Figure) -> None:
    """How far the best of each search rolled, by its own ensemble, against what it had spent; and the answers."""
    name, runs = record["scene"], record["rows"]
    left, right = chart.subplots(1, 2, sharey=True)
    for k, (method, answers) in enumerate(by_seed(runs).items()):
        traces = [one["trace"] for one in runs if one["method"] == method]
        spent, style = traces[0]["rollouts"], "--" if method.startswith("plain") else "-"
        colour = COLOURS[method.removeprefix("plain ")]
        label = f"{method}, of one robot" if method.startswith("plain") else method
        low, median, high = np.quantile([np.interp(spent, x["rollouts"], x["best"]) for x in traces], QUARTILES, axis=0)
        left.plot(spent, median, style, color=colour, label=label)
        left.fill_between(spent, low, high, color=colour, alpha=0.15, lw=0)
        right.plot(k + np.linspace(-0.15, 0.15, len(answers)), [*answers.values()], "o", ms=4, color=colour)
        right.hlines(np.median([*answers.values()]), k - 0.3, k + 0.3, color=colour, label=method)
    left.set(xlabel="rollouts", ylabel="mean distance of an ensemble (m)", title=f"{name}: by its own ensemble")
    chart.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=5)
    right.set(title=f"{name}: answers, by {JUDGES} robots")
    right.set_xticks(range(k + 1), by_seed(runs), rotation=30, ha="right")


if __name__ == "__main__":
    search_baselines.run()

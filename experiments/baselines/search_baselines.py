"""Gait searches at equal cost: random search, CMA-ES and differential evolution (DE) of evosax (the extra
`baselines`), this library's genetic algorithm (GA) alone, and with polish.

A search may spend so many rollouts of the scene's own model at its default step; cheaper ones count less. All answers
are then judged by one and the same ensemble in float64.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any, Literal, get_args

from jaxgrity.cli.script import measured, run

import numpy as np
import searches
from matplotlib.figure import Figure
from searches import EVOSAX, GRADIENTS, UNCERTAIN, Task, robust
from tqdm import tqdm

from jaxgrity import (
    Fitness,
    Genome,
    InputError,
    PolishConfig,
    SearchProblem,
    SolverOptions,
    load_scene,
    scene_text,
    verify,
)
from jaxgrity.io.files import read_text, save_json
from jaxgrity.model import gene_permutations, standing_symmetries
from jaxgrity.report import plot
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
COLOURS = {name: f"C{k}" for k, name in enumerate(get_args(Method))}
"""the same on every figure"""


@dataclass
class Settings:
    scenes: tuple[Literal["exact", "reference"], ...] = ("exact", "reference")
    """scenes on which to search"""
    methods: tuple[Method, ...] = get_args(Method)
    """searches to compare"""
    seeds: int = 8
    """searches by each method"""
    rollouts: int = 4096
    """that a search may spend, of the scene's own model at its default step"""
    duration: float = 10.0
    """horizon over which distance counts, s"""
    population: int = 64
    """gaits in a generation; of CMA-ES half as many"""
    robots: int = 4
    """by which the baselines judge a gait in each generation"""
    plain: tuple[Literal["random", "CMA-ES", "DE"], ...] = ("random",)
    """baselines to compare in their plain form too: one robot a gait, without noise"""
    resume: bool = False
    """keep the searches that the files hold, which must have the same settings, and add what is missing"""
    out: Path = Path("results/search_baselines")
    """folder for a .json and a .png of each scene"""
    quick: bool = False
    """one scene, 1 seed, 1024 rollouts of 2 s, 16 gaits in a generation"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings = replace(settings, scenes=settings.scenes[:1], seeds=1, rollouts=1024, duration=2.0, population=16)
    searches = contestants(settings)
    for name in settings.scenes:
        runs = compete(name, searches, settings)
        plot.save(figure(name, runs), settings.out / f"{name}.png")
        report(name, runs)
    print(f"wrote a .json and a .png for each scene to {settings.out}")


def contestants(settings: Settings) -> dict[str, Callable]:
    """Searches by their names. Raises `InputError` where evosax is missing, before the first of them."""
    if EVOSAX.keys() & {*settings.methods, *settings.plain}:
        searches.built("CMA-ES", 4, 1)
    baselines: dict[str, Callable] = {"random": searches.random_search}
    baselines |= {name: partial(searches.evosax_search, name) for name in EVOSAX}
    genetic = searches.genetic_search
    found: dict[str, Callable] = {"GA": genetic, "cautious GA": partial(genetic, caution=1.0)}
    found |= {f"GA+{then}": partial(genetic, then=then) for then in ("more", *GRADIENTS)}
    found |= {name: partial(search, fitness=robust(settings.robots)) for name, search in baselines.items()}
    found |= {f"plain {name}": partial(baselines[name], fitness=Fitness()) for name in settings.plain}
    return {name: found[name] for name in (*(f"plain {name}" for name in settings.plain), *settings.methods)}


def compete(name: str, methods: dict[str, Callable], settings: Settings) -> list[dict]:
    """Every search for every seed; the file has each as soon as it is done."""
    path, runs, known = settings.out / f"{name}.json", [], decisive(name, settings)
    if settings.resume and path.exists():
        facts = json.loads(read_text(path))
        if facts["settings"] != known:
            raise InputError(f"{path}: has settings {facts['settings']}; expected {known}, or no --resume")
        runs = facts["runs"]
    task = task_on(name, settings)
    wanted, done = product(range(settings.seeds), methods), {(one["seed"], one["method"]) for one in runs}
    for seed, method in tqdm([one for one in wanted if one not in done], desc=name, unit="search"):
        found = methods[method](task, settings.rollouts, seed)
        trace = asdict(found.trace)
        spent = {"rollouts": trace["rollouts"][-1], "failed_gaits": trace["failed"][-1]}
        judged = judgement(task, found.genes)
        runs.append({"method": method, "seed": seed, **judged, **spent, "trace": trace, "polish": found.polish})
        facts = {**measured(), "scene": name, "settings": known}
        save_json(path, {**facts, "methods": summary(runs), "runs": runs})
    return runs


def task_on(name: str, settings: Settings) -> Task:
    """What is searched for on a scene."""
    scene = load_scene(name)
    genome = Genome(6, images=gene_permutations(scene.gait.members, standing_symmetries(scene)))
    problem = SearchProblem(scene, genome, settings.duration, Fitness())
    levels = search_levels(fidelity_levels(scene))
    return Task(problem, settings.population, levels, WEIGHTS[name], POLISHED[name])


def decisive(name: str, settings: Settings) -> dict[str, Any]:
    """All that the numbers of one search depend on, as a file holds it."""
    known = {key: asdict(settings)[key] for key in ("rollouts", "duration", "population", "robots")}
    sizes = ("FINALISTS", "POOL", "OWN_ROBOTS", "FINAL_ROBOTS", "PAIR_ROBOTS")
    known |= {size.lower(): getattr(searches, size) for size in sizes} | {"judges": JUDGES, "verified": VERIFIED}
    known |= {"weights": WEIGHTS[name], "screened": searches.SCREENED, "polished": POLISHED[name]}
    known |= {"uncertain": vars(UNCERTAIN), "polish": PolishConfig()._asdict(), "jaxgrity": version("jaxgrity")}
    return json.loads(json.dumps(known | {"scene": scene_text(name)}))


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


def by_seed(runs: list[dict], what: str = "robust") -> dict[str, dict[int, float]]:
    """Of each method, a distance for each seed, m; 0 where a robot failed, which is null in a file."""
    return {
        method: {r["seed"]: float(np.nan_to_num(np.asarray(r[what], float))) for r in runs if r["method"] == method}
        for method in dict.fromkeys(one["method"] for one in runs)
    }


def summary(runs: list[dict]) -> dict[str, dict]:
    """Of each method: quartiles, their ratio to random search, on how many seeds of how many it beats each other."""
    every, nominal, found = by_seed(runs), by_seed(runs, "distance"), {}
    for method, mine in every.items():
        low, median, high = np.quantile([*mine.values()], QUARTILES)
        facts = {"seeds": len(mine), "robust": {"median": median, "quartiles": [low, high]}}
        facts["distance"] = np.median([*nominal[method].values()])
        facts["ratio_to_random"] = median / np.median([*every.get("random", {0: np.nan}).values()])
        pairs = {other: [mine[s] > theirs[s] for s in mine if s in theirs] for other, theirs in every.items()}
        found[method] = facts | {"beats": {other: [sum(x), len(x)] for other, x in pairs.items() if other != method}}
    return found


def report(name: str, runs: list[dict]) -> None:
    print(f"{name}: robust distance of the answers, of random search's, nominal; better than others on so many seeds")
    for method, facts in summary(runs).items():
        median, (low, high) = facts["robust"]["median"], facts["robust"]["quartiles"]
        ratio, nominal = facts["ratio_to_random"], facts["distance"]
        beats = ", ".join(f"{other} {k}/{n}" for other, (k, n) in facts["beats"].items())
        print(f"  {method:12s} {median:.3f} m ({low:.3f} to {high:.3f}), x {ratio:.2f}, {nominal:.3f} m; {beats}")


@plot.styled
def figure(name: str, runs: list[dict]) -> Figure:
    """How far the best of each search rolled, by its own ensemble, against what it had spent; and the answers."""
    chart = Figure(figsize=(12, 4.5), layout="constrained")
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
    left.legend(fontsize=8)
    right.set(title=f"{name}: answers, by {JUDGES} robots")
    right.set_xticks(range(k + 1), by_seed(runs), rotation=30, ha="right")
    return chart


if __name__ == "__main__":
    run(main, Settings)

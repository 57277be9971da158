"""Gait searches at equal cost: random search, CMA-ES and differential evolution (DE) of evosax (the extra `rivals`),
this library's genetic algorithm (GA) alone, and with polish.

A search may spend so many rollouts of the scene's own model at its default step; cheaper ones count less. It looks for
phases by which an ensemble of robots rolls far in the mean. Of the best that it ends with, one is its answer, by more
robots at its own cost. All answers then meet one and the same ensemble in float64.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

from jaxgrity.cli.script import measured, run

import jax
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import Breeding, Fitness, Genome, InputError, Polishing, Scene, distinct, load_scene, plot, polish, verify
from jaxgrity.io.files import read_text, save_json
from jaxgrity.search.fidelity import Rung, evolve_up, judge_on, rungs, searched
from jaxgrity.search.polish import AVERAGED, Kind
from jaxgrity.stepping.stability import default_method, default_step
from jaxgrity.model.symmetry import gene_permutations, standing_symmetries
from jaxgrity.rollout.uncertainty import Uncertainty

Method = Literal["random", "CMA-ES", "DE", "GA", "GA+more", "cautious GA", "GA+smoothed", "GA+pathwise", "GA+combined"]
WEIGHTS = {"exact": (1 / 2,), "reference": (1 / 12.9, 1 / 2)}
"""of a rollout on each of the searched rungs: half the steps; and 40.9 us against 527.5 us per simulated second, which
experiments/benchmark.py measures for the exact twin at 10 ms and for RK4 at 0.5 ms, both in float32"""
FINALISTS, OWN_ROBOTS, FINAL_ROBOTS, PAIR_ROBOTS, JUDGES = 8, 4, 32, 64, 256
"""of each search; robots by which the GA searches, by which one finalist is chosen, by which a polished gait meets its
start, by which the answers are judged"""
VERIFIED = 1 / 8
"""of the default step is the largest of the three by which a nominal gait is verified"""
DRAWS = 10**6
"""seeds of draws for each search; as many before the first are left for the judgement, which takes 0"""
SCREENED, POLISHED = 0.25, {"exact": 0.4, "reference": 0.55}
"""shares of rollouts: of the GA's, on the exact twin where the scene has one; of all, for polish, chosen for each scene
on other seeds than those that are compared"""
QUARTILES = (0.25, 0.5, 0.75)
EVOSAX = {"CMA-ES": "CMA_ES", "DE": "DifferentialEvolution"}
POOL = 16
"""gaits of the GA's end that are judged by more robots; the best is the answer, or where polish starts"""
UNCERTAIN = Uncertainty(phase=0.03)
robust = partial(Fitness, uncertainty=UNCERTAIN)


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
    """by which the rivals judge a gait in each generation"""
    plain: tuple[Literal["random", "CMA-ES", "DE"], ...] = ("random",)
    """rivals to compare in their plain form too: one robot a gait, without noise"""
    resume: bool = False
    """keep the searches that the files hold, which must have the same settings, and add what is missing"""
    out: Path = Path("results/rivals")
    """folder for a .json and a .png of each scene"""
    quick: bool = False
    """one scene, 1 seed, 1024 rollouts of 2 s, 16 gaits in a generation"""


COLOURS = {name: f"C{k}" for k, name in enumerate(get_args(Method))}
"""the same on every figure"""
Trace = list[tuple[float, float, int]]
"""after each generation: rollouts so far, robust distance of the best by the search's own ensemble (m), failed gaits"""
Found = tuple[np.ndarray, Trace] | tuple[np.ndarray, Trace, dict[str, Any]]
"""the answer, and what polish did"""


class Task(NamedTuple):
    """What all searches on one scene have in common."""

    scene: Scene
    genome: Genome
    duration: float
    population: int
    ladder: tuple[Rung, ...]
    """where the GA searches; all others use the last rung, the cheapest of the own model"""
    weights: tuple[float, ...]
    polished: float
    """share of the rollouts for polish"""


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
        built("CMA-ES", 4, 1)
    rivals: dict[str, Callable] = {"random": random_search} | {name: partial(by_evosax, name) for name in EVOSAX}
    found: dict[str, Callable] = {"GA": ours, "cautious GA": partial(ours, caution=1.0)}
    found |= {f"GA+{then}": partial(ours, then=then) for then in ("more", *get_args(Kind))}
    found |= {name: partial(rival, fitness=robust(robots=settings.robots)) for name, rival in rivals.items()}
    found |= {f"plain {name}": partial(rivals[name], fitness=Fitness()) for name in settings.plain}
    return {name: found[name] for name in (*(f"plain {name}" for name in settings.plain), *settings.methods)}


def compete(name: str, searches: dict[str, Callable], settings: Settings) -> list[dict]:
    """Every search for every seed; the file has each as soon as it is done."""
    path, runs, known = settings.out / f"{name}.json", [], decisive(name, settings)
    if settings.resume and path.exists():
        facts = json.loads(read_text(path))
        if facts["settings"] != known:
            raise InputError(f"{path}: has settings {facts['settings']}; expected {known}, or no --resume")
        runs = facts["runs"]
    scene = load_scene(name)
    genome = Genome(6, images=gene_permutations(scene.gait.members, standing_symmetries(scene)))
    task = Task(
        scene, genome, settings.duration, settings.population, searched(rungs(scene)), WEIGHTS[name], POLISHED[name]
    )
    wanted, done = product(range(settings.seeds), searches), {(one["seed"], one["method"]) for one in runs}
    for seed, method in tqdm([one for one in wanted if one not in done], desc=name, unit="search"):
        answer, trace, *polished = searches[method](task, settings.rollouts, seed)
        spent = {"rollouts": trace[-1][0], "failed_gaits": trace[-1][2], "trace": trace, "polish": polished}
        runs.append({"method": method, "seed": seed, **judgement(task, answer), **spent})
        facts = {"settings": known, "weights": task.weights, "methods": summary(runs), "runs": runs}
        save_json(path, measured() | facts)
    return runs


def decisive(name: str, settings: Settings) -> dict[str, Any]:
    """All that the numbers of one search depend on, as a file holds it."""
    known = {key: asdict(settings)[key] for key in ("rollouts", "duration", "population", "robots")}
    known |= {"weights": WEIGHTS[name], "shares": [SCREENED, POLISHED[name]], "uncertain": vars(UNCERTAIN)}
    known |= {"pool": [POOL, FINALISTS, OWN_ROBOTS, FINAL_ROBOTS, PAIR_ROBOTS, JUDGES]}
    known |= {"polishing": Polishing()._asdict(), "averaged": AVERAGED, "verified": VERIFIED}
    return json.loads(json.dumps(known | {"scene": (SCENES / f"{name}.toml").read_text(encoding="utf-8")}))


def judgement(task: Task, genes: np.ndarray) -> dict[str, Any]:
    """Of an answer, the same for all searches and outside of what they may spend."""
    gaits, step = task.genome.gaits(task.scene.gait, genes[None]), default_step(task.scene, default_method(task.scene))
    scores = judge_on(Rung("", task.scene, step, "float64"), gaits, task.duration, robust(robots=JUDGES), seed=0)
    verified, failed = verify(task.scene, gaits, task.duration, step * VERIFIED), int(np.isnan(scores.each).sum())
    found = {"robust": scores.mean[0], "spread": scores.spread[0], "failed_judges": failed}
    return found | {"distance": verified.distance[0], "error_bar": verified.error_bar[0], "genes": genes}


def spend(trace: Trace, rollouts: float, best: float, failed: int = 0) -> None:
    spent, _, before = trace[-1] if trace else (0.0, 0.0, 0)
    trace.append((spent + rollouts, float(best), before + int(failed)))


def generations(task: Task, budget: float, rollouts: int, finalists: int = FINALISTS) -> int:
    """How many of so many rollouts can be paid, when the choice of the answer is paid too."""
    count = int((budget / task.weights[-1] - finalists * FINAL_ROBOTS) / rollouts)
    if count < 1:
        raise InputError(f"{budget:g} rollouts: expected more, for a generation and the choice of an answer")
    return count


def try_out(task: Task, genes, fitness: Fitness, seed: int, trace: Trace, keeps: bool = False) -> np.ndarray:
    """The fitness of each gait, by new draws; the best of all so far counts where the search `keeps` it."""
    gaits = task.genome.gaits(task.scene.gait, task.genome.within(np.asarray(genes, float)))
    scores = judge_on(task.ladder[-1], gaits, task.duration, fitness, DRAWS * (seed + 1) + len(trace))
    best = max(scores.fitness.max(), trace[-1][1] if keeps and trace else -np.inf)
    spend(trace, task.weights[-1] * scores.each.size, best, scores.failed.sum())
    return scores.fitness


def choose(task: Task, genes, seed: int, trace: Trace) -> Found:
    """The best of the finalists, by more robots."""
    genes = np.asarray(task.genome.within(np.asarray(genes, float)))
    return genes[np.argmax(try_out(task, genes, robust(robots=FINAL_ROBOTS), seed, trace))], trace


def random_search(task: Task, budget: int, seed: int, *, fitness: Fitness) -> Found:
    size = task.population * OWN_ROBOTS // fitness.robots
    trace, count = [], generations(task, budget, size * fitness.robots)
    genes = np.random.default_rng(seed).uniform(size=(count, size, task.genome.size))
    found = np.concatenate([try_out(task, some, fitness, seed, trace, keeps=True) for some in genes])
    return choose(task, np.concatenate(genes)[np.argsort(-found)[:FINALISTS]], seed, trace)


def by_evosax(name: str, task: Task, budget: int, seed: int, *, fitness: Fitness) -> Found:
    """CMA-ES from 1 rad around a random gait, or DE, which judges none twice; angles go on beyond a turn for both."""
    cma, trace, key = name == "CMA-ES", [], jax.random.key(seed)
    size, finalists = (task.population // 2, 2) if cma else (task.population, FINALISTS)
    algorithm, parameters = built(name, size, task.genome.size)
    genes = jax.random.uniform(key, (size, task.genome.size))
    first = [genes[0]] if cma else [genes, -try_out(task, genes, fitness, seed, trace, keeps=True)]
    state = algorithm.init(key, *first, parameters)
    while len(trace) < generations(task, budget, size * fitness.robots, finalists):
        asked, told = jax.random.split(jax.random.fold_in(key, len(trace)))
        genes, state = algorithm.ask(asked, state, parameters)
        found = try_out(task, genes, fitness, seed, trace, keeps=not cma)
        state, _ = algorithm.tell(told, genes, -found, state, parameters)
    last = [state.mean, genes[np.argmax(found)]] if cma else state.population[np.argsort(state.fitness)[:finalists]]
    return choose(task, last, seed, trace)


@cache
def built(name: str, population: int, size: int):
    """One of evosax's algorithms and its parameters, once for all seeds: a new object would be compiled anew."""
    try:
        from evosax import algorithms
    except ImportError as error:
        raise InputError("CMA-ES and DE need evosax: pip install -e '.[rivals]'") from error
    algorithm = getattr(algorithms, EVOSAX[name])(population, np.zeros(size))
    parameters = algorithm.default_params
    return algorithm, parameters.replace(std_init=1 / (2 * np.pi)) if name == "CMA-ES" else parameters


def ours(task: Task, budget: int, seed: int, then: Kind | Literal["more"] | None = None, caution: float = 0.0) -> Found:
    """The GA up the ladder. With `then` it has only a part of the budget, and after it the rest is spent on more
    generations with mutations that no longer shrink, or on polish by one kind of gradient."""
    trace, each, weight = [], task.population * OWN_ROBOTS, task.weights[-1]
    own, draws = Fitness(uncertainty=UNCERTAIN, robots=OWN_ROBOTS, caution=caution), DRAWS * (seed + 1)
    left = (1 - task.polished) * budget if then else budget
    counts = [max(1, int(SCREENED * left / (w * each))) for w in task.weights[:-1]]
    counts.append(generations(task, left - each * np.dot(counts, task.weights[:-1]), each, POOL))
    breedings = [Breeding(task.population, count, elites=task.population // 8) for count in counts]
    if then == "more":
        more = generations(task, budget - each * np.dot(counts[:-1], task.weights[:-1]), each, POOL)
        breedings[-1] = Breeding(task.population, more, task.population // 8, settled=counts[-1])
    searches = evolve_up(task.ladder, task.genome, task.duration, tuple(breedings), fitness=own, seed=draws)
    for w, search in zip(task.weights, searches):
        for best, failed in zip(search.best, search.failed):
            spend(trace, w * each, best, failed)
    genes = distinct(searches[-1].last, task.genome, POOL)
    found = try_out(task, genes, robust(robots=FINAL_ROBOTS), seed, trace)
    best = genes[np.argmax(found)]
    if then is None or then == "more":
        return best, trace
    last = 2 * weight * 2 * PAIR_ROBOTS  # float64 counts twice
    polishing = Polishing(int((task.polished * budget - last) / weight), then)
    options = {"fitness": own, "dt": task.ladder[-1].dt, "final_dt": task.ladder[-1].dt, "final_robots": PAIR_ROBOTS}
    polished = polish(task.scene, task.genome, best[None], task.duration, polishing, seed=draws + len(trace), **options)
    judged = polished.after if polished.improved else polished.before
    spend(trace, weight * polished.rollouts + last, judged.mean[0])
    share = np.mean([step.pathwise_share for step in polished.steps]) if polished.steps else None
    said = {"improved": polished.improved, "horizon": polished.horizon, "pathwise_share": share}
    return polished.genes, trace, {**said, "reason": polished.reason}


def by_seed(runs: list[dict], what: str = "robust") -> dict[str, dict[int, float]]:
    """Of each method, a distance for each seed, m; 0 where a robot failed, for which a file has null."""
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
        (median, (low, high)), ratio, nominal = facts["robust"].values(), facts["ratio_to_random"], facts["distance"]
        beats = ", ".join(f"{other} {k}/{n}" for other, (k, n) in facts["beats"].items())
        print(f"  {method:12s} {median:.3f} m ({low:.3f} to {high:.3f}), x {ratio:.2f}, {nominal:.3f} m; {beats}")


def figure(name: str, runs: list[dict]) -> Figure:
    """How far the best of each search rolled, by its own ensemble, against what it had spent; and the answers."""
    chart = Figure(figsize=(12, 4.5), layout="constrained")
    left, right = chart.subplots(1, 2, sharey=True)
    for k, (method, answers) in enumerate(by_seed(runs).items()):
        traces = [np.array(one["trace"], float).T for one in runs if one["method"] == method]
        spent, style = traces[0][0], "--" if method.startswith("plain") else "-"
        colour = COLOURS[method.removeprefix("plain ")]
        label = f"{method}, of one robot" if method.startswith("plain") else method
        low, median, high = np.quantile([np.interp(spent, x, best) for x, best, _ in traces], QUARTILES, axis=0)
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

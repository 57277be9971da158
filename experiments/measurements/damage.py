"""A broken cable, a stuck strut: how far does a gait still go, and how soon is a better one found?

Every cable breaks in turn, and every strut gets stuck at its rest length (`broken = [k]` under [cables] and
`stuck = [k]` under [struts] say the same in a scene file). Each gait of the library for this scene is tried as it is;
so are their images by the robot's symmetry, then the best of all is polished by gradients, and in the end a gait is
evolved from scratch.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import numpy as np
from damaged_robots import damaged, known_gaits, still, together
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import (
    FidelityLevel,
    Fitness,
    GAConfig,
    Gait,
    Genome,
    InputError,
    PolishConfig,
    Scene,
    SearchProblem,
    SolverOptions,
    Uncertainty,
    distinct,
    evolve,
    fidelity_levels,
    judge_at,
    load_scene,
    one_gait,
    plot,
    polish,
    verify,
    with_gait,
    with_robots,
)
from jaxgrity.io.files import save_json

NEW = ("library", "gradient", "scratch")
WAYS = ("as it was", *NEW)
TRIES, UNSEEN = 64, 10**6
"""robots by which candidates are compared; added to the seed of the last judgement, by whose draws none is chosen"""


@dataclass
class Settings:
    scene: str = "exact"
    """scene with a gait: a name in the library, or a file"""
    gait: str = "rolling_exact"
    """of the intact robot: a name in the library, or a file; its distance is what a recovery is measured against"""
    duration: float = 10.0
    """s"""
    amplitude: tuple[float, float] = (0.05, 0.5)
    """bounds within which a search from scratch may choose each member's"""
    frequency: tuple[float, float] = (0.2, 1.0)
    """bounds (Hz) within which it may choose the gait's; the same twice, as for amplitudes: it stays as it is"""
    rollouts: int = 8192
    """for each search from scratch; polishing takes a quarter of them"""
    enough: float = 0.7
    """share of the intact distance from which on a gait counts as recovered"""
    seed: int = 0
    """the same seed gives the same numbers"""
    out: Path = Path("results/damage")
    """folder for damage.json and damage.png"""
    quick: bool = False
    """a cable and a strut, 4 s, 256 rollouts"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.duration, settings.rollouts = 4.0, 256
    scene = load_scene(settings.scene)
    if scene.gait is None or scene.structure.cables is None:
        raise InputError(f"{settings.scene}: expected a scene with [cables] and a [gait]")
    families = known_gaits(scene, settings.scene, settings.gait)
    known = together([gait for images in families.values() for gait in images])
    first = together([images[0] for images in families.values()])
    intact = dict(zip(families, measure(problem_of(scene, settings), first, settings)))
    cases = damaged(scene)
    if settings.quick:
        cases = {name: cases[name] for name in ("cable 7", "strut 1")}
    found = {}
    with tqdm(cases.items(), unit="case") as bar:
        for number, (name, broken) in enumerate(bar):
            problem = problem_of(broken, settings)
            found[name] = recover(problem, list(families), first, known, settings, settings.seed + number)
            bar.set_postfix(case=name, best=f"{max(found[name][way]['robust'] for way in NEW):.2f} m")
    facts = summary(intact, known.phase.shape[0], found, settings)
    save_json(settings.out / "damage.json", facts)
    plot.save(figure(facts), settings.out / "damage.png")
    for name, kinds in facts["recovered"].items():
        for kind, counts in kinds.items():
            told = ", ".join(f"{way} {sure} ({mean})" for way, (sure, mean) in counts["reached"].items())
            goes = f"{settings.enough:.0%} of {name}'s {intact[name]['robust']:.2f} m"
            print(f"{kind}, {counts['cases']} cases: {goes} with the error bar (in the mean alone): {told}")
    print(f"wrote {settings.out}/")


def problem_of(scene: Scene, settings: Settings) -> SearchProblem:
    """How gaits of the scene are judged, with phases that may vary."""
    fitness = Fitness(uncertainty=Uncertainty(phase=0.03), robots=4)
    return SearchProblem(scene, Genome(len(scene.gait.members)), settings.duration, fitness)


def recover(
    problem: SearchProblem, names: list[str], first: Gait, known: Gait, settings: Settings, seed: int
) -> dict[str, Any]:
    """What `measure` says of each gait as it was, by its name, and of the best on each of the ways to another one.

    `first` has a gait for each name, `known` all their images too.
    """
    own, gaits = (still(problem.scene, some) for some in (first, known))
    library = one_gait(gaits, int(np.argmax(judged(problem, gaits, settings))))
    found = [
        *(one_gait(own, k) for k in range(len(names))),
        library,
        polished(problem, library, settings, seed),
        from_scratch(problem, settings, seed),
    ]
    facts = measure(problem, together(found), settings)
    return {"as it was": dict(zip(names, facts)), **dict(zip(NEW, facts[len(names) :]))}


def measure(problem: SearchProblem, gaits: Gait, settings: Settings) -> list[dict[str, float]]:
    """What gaits are worth by draws that none was chosen by, in float64, with the error bar of the gait itself."""
    level = fidelity_levels(problem.scene)[-1]
    robust = judge_at(level, gaits, tried(problem), settings.seed + UNSEEN)
    verified = verify(problem.scene, gaits, problem.duration, options=level.options)
    rows = zip(robust.mean, robust.spread, verified.distance, verified.error_bar)
    return [dict(zip(("robust", "spread", "distance", "error_bar"), map(float, row))) for row in rows]


def tried(problem: SearchProblem) -> SearchProblem:
    """The problem with the ensemble by which candidates are compared."""
    return problem._replace(fitness=with_robots(problem.fitness, TRIES))


def judged(problem: SearchProblem, gaits: Gait, settings: Settings) -> np.ndarray:
    """Robust distance of each gait, m, by one ensemble for all cases."""
    level: FidelityLevel = fidelity_levels(problem.scene)[1]
    return judge_at(level, gaits, tried(problem), settings.seed + 999).mean


def polished(problem: SearchProblem, gait: Gait, settings: Settings, seed: int) -> Gait:
    """The gait, its phases polished by gradients."""
    own = problem._replace(scene=with_gait(problem.scene, gait))
    rough, fine = (level.dt for level in fidelity_levels(own.scene)[:2])
    found = polish(
        own,
        np.asarray(gait.phase)[None] / (2 * np.pi) % 1,
        PolishConfig(polish_rollouts(settings), final_robots=TRIES),
        options=SolverOptions(dt=rough),
        final_options=SolverOptions(dt=fine),
        seed=seed,
    )
    return one_gait(own.genome.gaits(gait, found.genes[None]), 0)


def polish_rollouts(settings: Settings) -> int:
    """A quarter of what a search from scratch may spend."""
    return max(128, settings.rollouts // 4)


def from_scratch(problem: SearchProblem, settings: Settings, seed: int) -> Gait:
    """The best of a search whose last generation meets a larger ensemble."""
    scene = problem.scene
    # a stuck strut's amplitude is zero, and has to stay so
    varied = ("amplitude", "frequency") if np.all(np.asarray(scene.gait.amplitude) > 0) else ("frequency",)
    free = {name: bounds for name in varied if np.ptp(bounds := getattr(settings, name))}
    genome, level = Genome(len(scene.gait.members), **free), fidelity_levels(scene)[0]
    config = GAConfig(64, max(1, settings.rollouts // (64 * problem.fitness.robots)))
    search = evolve(problem._replace(scene=level.scene, genome=genome), config, options=level.options, seed=seed)
    gaits = genome.gaits(scene.gait, distinct(search.last, genome, 8))
    return one_gait(gaits, int(np.argmax(judged(problem, gaits, settings))))


def summary(intact: dict, known: int, found: dict[str, Any], settings: Settings) -> dict[str, Any]:
    """All cases, and for each known gait in how many its intact distance is recovered on each way, and by any."""
    recovered: dict[str, dict[str, Any]] = {}
    for name, own in intact.items():
        enough = settings.enough * own["robust"]
        recovered[name] = {}
        for kind in dict.fromkeys(label.split()[0] for label in found):
            cases = [
                {**case, "as it was": case["as it was"][name]}
                for label, case in found.items()
                if label.startswith(kind)
            ]
            far = {way: [reached(case[way], enough) for case in cases] for way in WAYS}
            far["any"] = [tuple(map(any, zip(*tests))) for tests in zip(*far.values())]
            counts = {way: [sum(column) for column in zip(*tests)] for way, tests in far.items()}
            recovered[name][kind] = {"cases": len(cases), "reached": counts}
    return {
        **measured(),
        "scene": Path(settings.scene).stem,
        "duration": settings.duration,
        "free": {"amplitude": settings.amplitude, "frequency": settings.frequency},
        "rollouts": {"scratch": settings.rollouts, "gradient": polish_rollouts(settings), "library": known * TRIES},
        "gait": settings.gait,
        "intact": intact,
        "enough": settings.enough,
        "cases": found,
        "recovered": recovered,
    }


def reached(facts: dict[str, float], enough: float) -> tuple[bool, bool]:
    """Whether the robust distance is enough and the gait's own less its error bar is too; whether the first is."""
    far = facts["robust"] >= enough
    return far and facts["distance"] - facts["error_bar"] >= enough, far


def figure(facts: dict[str, Any]) -> Figure:
    """Robust distance in each case on each of the ways, and what counts as recovered."""
    cases, gait = facts["cases"], facts["gait"]
    intact = facts["intact"][gait]["robust"]
    enough = facts["enough"] * intact
    chart = Figure(figsize=(14, 5), layout="constrained")
    axes = chart.subplots()
    x = np.arange(len(cases))
    for k, way in enumerate(WAYS):
        rows = [case[way][gait] if way == "as it was" else case[way] for case in cases.values()]
        place, label = x + 0.2 * (k - 1.5), f"{gait}, {way}" if way == "as it was" else way
        height, spread = ([row[what] for row in rows] for what in ("robust", "spread"))
        axes.bar(place, height, 0.2, label=label, yerr=spread, error_kw={"lw": 0.6})
        unsure = [h if reached(row, enough) == (False, True) else np.nan for h, row in zip(height, rows)]
        axes.plot(
            place,
            unsure,
            "x",
            color="black",
            ms=5,
            label=None if k else "nominal distance less its error bar: too little",
        )
    axes.axhline(intact, color="black", lw=1, label=f"{gait}, intact")
    axes.axhline(enough, color="black", lw=1, ls="--", label=f"{facts['enough']:.0%} of it")
    axes.set_xticks(x, list(cases), rotation=90)
    axes.set(
        xlim=(-0.6, len(cases) - 0.4),
        ylim=(0, None),
        ylabel=f"distance in {facts['duration']:g} s, mean and spread of the ensemble, m",
        title="a broken cable, or a stuck strut: the gait as it was, the library's best, that one polished, a new one "
        "(its amplitudes and frequency free too)",
    )
    axes.legend(ncols=7, fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.2))
    return chart


if __name__ == "__main__":
    run(main, Settings)

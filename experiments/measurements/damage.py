"""A broken cable, a stuck strut: how fast does a gait still roll, and how soon is a better one found?

Every cable breaks in turn, and every strut gets stuck at its rest length (`broken = [k]` under [cables] and
`stuck = [k]` under [struts] say the same in a scene file). What counts is steady speed, in the mean over robots that
differ, on both contact models. The intact robot's gait is tried as it is; so are all gaits of the library with their
images by the robot's symmetry; and two short searches look for new ones. One has the freedom that the intact robot's
gait was found with, a wave's phases, amplitudes and frequency; in the other each actuator moves as it likes.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import equinox as eqx
import jax
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import (
    Gait,
    InputError,
    Scene,
    SearchConfig,
    SearchProblem,
    contact_twin,
    distinct,
    evolve_through,
    fidelity_levels,
    ga_configs,
    gait_names,
    gait_record,
    image,
    judge_at,
    load_gait,
    load_scene,
    one_gait,
    plot,
    search_problem,
    standing_symmetries,
    with_robots,
)
from jaxgrity.io.files import save_json

WAYS = ("as it was", "library", "wave", "free")
FINALISTS, TRIES, ROBOTS, UNSEEN = 8, 16, 64, 10**6
"""gaits of a search that are compared, and the robots by which; those of the last judgement, and what is added to the
seed for it: by its draws no gait is chosen"""


@dataclass
class Settings:
    gait: str = "lasting"
    """of the intact robot, in the library: its speed is what a recovery is measured against"""
    cases: tuple[str, ...] = ()
    """which damages, as "cable 7" or "strut 1"; every one where not given"""
    duration: float = 40.0
    """s"""
    population: int = 64
    """gaits in a generation of a search"""
    generations: int = 8
    """of a search"""
    enough: float = 0.7
    """share of the intact speed from which on a gait counts as recovered"""
    seed: int = 0
    """the same seed gives the same numbers"""
    out: Path = Path("results/damage")
    """folder for damage.json and damage.png"""
    quick: bool = False
    """a cable and a strut, 10 s, small searches"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.duration, settings.population, settings.generations = 10.0, 16, 1
    if settings.gait not in gait_names():
        raise InputError(f"gait = {settings.gait!r}: unknown; expected one of {', '.join(gait_names())}")
    scene = load_scene(gait_record(settings.gait)["scene"])
    every = damaged(scene)
    chosen = ("cable 7", "strut 1") if settings.quick else settings.cases or tuple(every)
    if unknown := [name for name in chosen if name not in every]:
        raise InputError(f"cases = {unknown}: unknown; expected some of {', '.join(every)}")
    cases, found = {name: every[name] for name in chosen}, {}
    gaits = known_gaits(scene, settings.gait)
    intact = measure(problem_of(scene, "every", settings), together(gaits[:1]), settings.seed)[0]
    with tqdm(cases.items(), unit="case") as bar:
        for number, (name, broken) in enumerate(bar):
            found[name] = recover(scene, broken, gaits, settings, settings.seed + number)
            bar.set_postfix(case=name, best=f"{max(one['own']['mean'] for one in found[name].values()):.2f}")
            facts = facts_of(found, intact, settings)
            save_json(settings.out / "damage.json", facts)  # after each: it takes a while
    plot.save(figure(facts), settings.out / "damage.png")
    for kind, counts in facts["recovered"].items():
        print(f"{kind}: {settings.enough:.0%} of the intact speed is reached in", counts)
    print(f"wrote {settings.out}/")


def facts_of(found: dict[str, Any], intact: dict[str, Any], settings: Settings) -> dict[str, Any]:
    """What goes into the file, of the cases that are done."""
    kinds = {name.split()[0] for name in found}
    return {
        **measured(),
        "gait": settings.gait,
        "duration": settings.duration,
        "enough": settings.enough,
        "gaits": search_config("every", settings).population * (3 + settings.generations),
        "intact": intact,
        "cases": found,
        "recovered": {kind: recovered(found, intact, kind, settings.enough) for kind in sorted(kinds)},
    }


def damaged(scene: Scene) -> dict[str, Scene]:
    """The scene with each cable broken, and with each actuated strut stuck."""
    cables, found = scene.structure.cables, {}
    for k in range(len(cables.edges)):
        whole = np.arange(len(cables.edges)) != k
        parts = ("stiffness",) if cables.damping is None else ("stiffness", "damping")
        broken = replace(cables, **{name: getattr(cables, name) * whole for name in parts})
        found[f"cable {k}"] = eqx.tree_at(lambda s: s.structure.cables, scene, broken)
    for k in scene.gait.members:
        struts = replace(scene.structure.struts, stuck=(k,))
        found[f"strut {k}"] = eqx.tree_at(lambda s: s.structure.struts, scene, struts)
    return found


def known_gaits(scene: Scene, first: str) -> list[Gait]:
    """The library's gaits that fit the scene, the `first` one and then each with its images."""
    names = [name for name in gait_names() if tuple(gait_record(name)["members"]) == scene.gait.members]
    plain = [gait for gait in map(load_gait, names) if not gait.overtones]
    return [load_gait(first), *(image(gait, turned) for gait in plain for turned in standing_symmetries(scene))]


def together(gaits: list[Gait]) -> Gait:
    """Gaits as one population."""
    return jax.tree.map(lambda *rows: np.stack(rows) if np.ndim(rows[0]) else rows[0], *gaits)


def search_config(waves: str, settings: Settings) -> SearchConfig:
    """Screening of the default search alone."""
    return SearchConfig(settings.duration, settings.population, (settings.generations, 0), waves=waves)


def problem_of(scene: Scene, waves: str, settings: Settings) -> SearchProblem:
    """How gaits of the intact robot are judged, and what of them may vary."""
    return search_problem(scene, search_config(waves, settings))


def recover(intact: Scene, broken: Scene, gaits: list[Gait], settings: Settings, seed: int) -> dict[str, Any]:
    """What `measure` says of the gait as it was, and of the best on each of the ways to another one."""
    problem = problem_of(intact, "every", settings)._replace(scene=broken)
    chosen = [gaits[0], best(problem, together(gaits), settings.seed)]
    for waves in ("every", "none"):
        # waves follow from the intact robot's rotations, which damage leaves none of
        here = problem_of(intact, waves, settings)._replace(scene=broken)
        levels, configs = fidelity_levels(broken, wide=True), ga_configs(search_config(waves, settings), 1)
        (search,) = evolve_through(levels[:1], here, configs, seed=seed)
        found = here.genome.gaits(broken.gait, distinct(search.last, here.genome, FINALISTS))
        chosen.append(best(problem, found, settings.seed))
    return dict(zip(WAYS, measure(problem, together(chosen), settings.seed), strict=True))


def tried(problem: SearchProblem, robots: int) -> SearchProblem:
    """The problem with an ensemble of so many robots, and without bounds, which damage may exceed."""
    fitness = eqx.tree_at(lambda f: f.bounds, problem.fitness, type(problem.fitness.bounds)())
    return problem._replace(fitness=with_robots(fitness, robots))


def best(problem: SearchProblem, gaits: Gait, seed: int) -> Gait:
    """The gait that is fastest in the mean over robots, on the scene's own model."""
    level = fidelity_levels(problem.scene)[1]
    found = judge_at(level, gaits, tried(problem, TRIES), seed)
    return one_gait(gaits, int(np.argmax(np.nan_to_num(found.mean, nan=-np.inf))))


def measure(problem: SearchProblem, gaits: Gait, seed: int) -> list[dict[str, Any]]:
    """Steady speed of each gait, body lengths/s: mean and spread over robots on the own contact model and the other."""
    rows: list[dict[str, Any]] = [{} for _ in gaits.phase]
    for name, scene in (("own", problem.scene), ("other", contact_twin(problem.scene))):
        found = judge_at(fidelity_levels(scene)[1], gaits, tried(problem, ROBOTS), seed + UNSEEN)
        for row, mean, spread in zip(rows, found.mean, found.spread, strict=True):
            row[name] = {"mean": float(np.nan_to_num(mean)), "standard_deviation": float(np.nan_to_num(spread))}
    return rows


def recovered(found: dict[str, Any], intact: dict[str, Any], kind: str, enough: float) -> dict[str, int]:
    """In how many cases each way, and any of them, reaches enough of the intact speed on both contact models."""
    cases = [case for name, case in found.items() if name.startswith(kind)]
    reached = [
        {way: all(one[m]["mean"] >= enough * intact[m]["mean"] for m in intact) for way, one in case.items()}
        for case in cases
    ]
    counts = {way: sum(case[way] for case in reached) for way in WAYS}
    return {"cases": len(cases), **counts, "any": sum(any(case.values()) for case in reached)}


@plot.styled
def figure(facts: dict[str, Any]) -> Figure:
    """Steady speed in each case on each of the ways, and what counts as recovered."""
    cases, intact = facts["cases"], facts["intact"]["own"]["mean"]
    chart = Figure(figsize=(14, 5), layout="constrained")
    axes = chart.subplots()
    x = np.arange(len(cases))
    for k, way in enumerate(WAYS):
        rows = [case[way]["own"] for case in cases.values()]
        spread = [row["standard_deviation"] for row in rows]
        place = x + 0.2 * (k - 1.5)
        axes.bar(place, [row["mean"] for row in rows], 0.2, label=way, yerr=spread, error_kw={"lw": 0.6})
        others = [case[way]["other"]["mean"] for case in cases.values()]
        axes.plot(place, others, ".", color="black", ms=4, label=None if k else "on the other contact model")
    axes.axhline(intact, color="black", lw=1, label=f"{facts['gait']}, intact")
    axes.axhline(facts["enough"] * intact, color="black", lw=1, ls="--", label=f"{facts['enough']:.0%} of it")
    axes.set_xticks(x, list(cases), rotation=90)
    axes.set(
        xlim=(-0.6, len(cases) - 0.4),
        ylim=(0, None),
        ylabel="steady speed, body lengths/s",
        title="damage: the gait as it was, the best of the library, a new wave, a new gait of any kind",
    )
    axes.legend(ncols=7, fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.2))
    return chart


if __name__ == "__main__":
    run(main, Settings)

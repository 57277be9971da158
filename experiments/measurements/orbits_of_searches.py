"""How well speeds of orbits converge with the step, on gaits of short searches by seeds that nothing was tuned on.

The speed at the default step is compared with that at an eighth of it, and with the error bar that steps of 1, 1/2 and
1/4 give. Leaves orbits_of_searches.json and a figure.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import (
    Gait,
    Scene,
    SearchConfig,
    SolverOptions,
    contact_twin,
    default_method,
    default_step,
    distinct,
    evolve_through,
    fidelity_levels,
    find_orbit,
    ga_configs,
    load_scene,
    one_gait,
    plot,
    refined_orbit,
    search_problem,
    with_gait,
)
from jaxgrity.io.files import save_json

FIRST_SEED = 1000
"""well beyond those that defaults were chosen by"""
WATCHED_PERIODS = 80.5
"""of actuation, for every gait, so that all share a program"""
FINEST = 8
"""times smaller steps, which tell how far the default step is off"""
GROUPS = {"exact": "exact contact", "penalty": "penalty contact"}


@dataclass
class Settings:
    searches: int = 64
    """one gait each"""
    population: int = 64
    """gaits in a generation"""
    generations: int = 5
    """of each search"""
    out: Path = Path("results/orbits_of_searches")
    """folder for what is found"""
    quick: bool = False
    """two searches"""


def main(settings: Settings) -> None:
    scene = load_scene("exact")
    searches = 2 if settings.quick else settings.searches
    seeds = range(FIRST_SEED, FIRST_SEED + searches)
    gaits = [searched(scene, seed, settings) for seed in tqdm(seeds, desc="searching", unit="search")]
    rows = []
    for contact, model in (("exact", scene), ("penalty", contact_twin(scene))):
        for seed, gait in zip(seeds, tqdm(gaits, desc=f"orbits, {contact}", unit="gait"), strict=True):
            rows.append({"seed": seed, "contact": contact, **converged(with_gait(model, gait))})
    facts = {**measured(), "searches": searches, "rows": [summary(rows, contact) for contact in GROUPS]}
    save_json(settings.out / "orbits_of_searches.json", facts)
    save_json(settings.out / "each.json", rows)
    plot.save(figure(rows), settings.out / "orbits_of_searches.png")
    for row in facts["rows"]:
        print({key: value if isinstance(value, (str, int)) else round(value, 4) for key, value in row.items()})
    print(f"wrote {settings.out}/")


def searched(scene: Scene, seed: int, settings: Settings) -> Gait:
    """The best gait of a short search by rough rollouts alone, as the default search begins."""
    config = SearchConfig(population=settings.population, generations=(settings.generations, 0))
    problem, levels = search_problem(scene, config), fidelity_levels(scene, wide=True)
    (found,) = evolve_through(levels[:1], problem, ga_configs(config, 1), seed=seed)
    return one_gait(problem.genome.gaits(scene.gait, distinct(found.last, problem.genome, 1)), 0)


def converged(scene: Scene) -> dict[str, Any]:
    """Speeds of the orbit, m/s, at the default step and at the finest, and the error bar of the first."""
    watched = WATCHED_PERIODS / float(np.max(scene.gait.frequency))
    step = default_step(scene, default_method(scene))
    orbit, bar = refined_orbit(scene, watched, options=SolverOptions(dt=step))
    finest = find_orbit(scene, watched, options=SolverOptions(dt=step / FINEST))
    return {
        "settled": orbit.settled and finest.settled,
        "speed": orbit.speed,
        "finest": finest.speed,
        "speed_error_bar": bar,
        "residual": orbit.residual,
        "periods": orbit.periods,
    }


def summary(rows: list[dict[str, Any]], contact: str) -> dict[str, Any]:
    """Of the gaits on one contact model that settled on an orbit at both steps."""
    here = [row for row in rows if row["contact"] == contact]
    kept = [row for row in here if row["settled"]]
    speeds, finest, bars = (np.array([row[key] for row in kept]) for key in ("speed", "finest", "speed_error_bar"))
    off = np.abs(speeds - finest)
    return {
        "contact": contact,
        "gaits": len(here),
        "settled": len(kept),
        "within_a_hundredth": float((off <= 0.01 * finest).mean()) if kept else None,
        "covered": float((off <= bars).mean()) if kept else None,
        "median_off": float(np.median(off / finest)) if kept else None,
        "median_bar": float(np.median(bars / finest)) if kept else None,
    }


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """By how much each speed is off, against its error bar; points below the line are covered."""
    chart = Figure(figsize=(6, 5), layout="constrained")
    axes = chart.subplots()
    for contact, mark in zip(GROUPS, ("o", "x"), strict=True):
        kept = [row for row in rows if row["contact"] == contact and row["settled"]]
        off = [max(abs(row["speed"] - row["finest"]), 1e-7) for row in kept]
        axes.loglog([row["speed_error_bar"] for row in kept], off, mark, label=GROUPS[contact], fillstyle="none")
    ends = np.array([1e-7, 1.0])
    axes.loglog(ends, ends, "k--", lw=1, label="off by the error bar")
    axes.set(xlabel="error bar (m/s)", ylabel=f"difference from 1/{FINEST} of the step (m/s)")
    axes.set_title("Speeds of orbits and their error bars")
    axes.legend()
    return chart


if __name__ == "__main__":
    run(main, Settings)

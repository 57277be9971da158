"""How well speeds of orbits converge with the step, on gaits of short searches by seeds that nothing was tuned on.

The speed at the default step is compared with that at an eighth of it, and with the error bar that steps of 1, 1/2 and
1/4 give. The order p of the speed, |error| ~ step^p, is measured from steps of 1, 1/2 and 1/4.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns
from tqdm import tqdm

from jaxgrity import Gait, Scene, SearchConfig, SolverOptions, contact_twin, load_scene, one_gait, with_gait
from jaxgrity.orbits import find_orbit, refined_orbit
from jaxgrity.report import plot
from jaxgrity.search import distinct, evolve_through, fidelity_levels, ga_configs, search_problem
from jaxgrity.stepping import default_method, default_step

FIRST_SEED = 1000
"""well beyond those that defaults were chosen by"""
WATCHED_PERIODS = 80.5
"""of actuation, for every gait, so that all share a program"""
PARTS = 1, 2, 4, 8
"""into which the default step is divided; the finest tells how far the others are off"""
CLOSED = 1e-3
"""m: shapes of an orbit that is told to close return so closely"""


@measurement(page="gait_records.md", quick={"searches": 2}, drawn=("each",))
def orbits_of_searches(searches: int = 64) -> Iterator[Record]:
    """A row for each contact model.

    Args:
        searches: one gait each
    """
    scene = load_scene("exact")
    seeds = range(FIRST_SEED, FIRST_SEED + searches)
    gaits = [searched(scene, seed) for seed in tqdm(seeds, desc="searching", unit="search")]
    for contact, model in (("exact", scene), ("penalty", contact_twin(scene))):
        each = [{"seed": seed, **converged(with_gait(model, gait))} for seed, gait in zip(seeds, tqdm(gaits))]
        yield {"contact": contact, **summary(each), "each": shown([row for row in each if row["settled"]])}


def searched(scene: Scene, seed: int) -> Gait:
    """The best gait of a short search by rough rollouts alone, as the default search begins."""
    config = SearchConfig(population=64, generations=(5, 0))
    problem, levels = search_problem(scene, config), fidelity_levels(scene, force_bounds=False)
    (found,) = evolve_through((levels.screening,), problem, ga_configs(config, 1), seed=seed)
    return one_gait(problem.genome.gaits(scene.gait, distinct(found.last, problem.genome, 1)), 0)


def converged(scene: Scene) -> dict[str, Any]:
    """Speeds of the orbit, m/s, at every step, and the error bar of the first."""
    watched = WATCHED_PERIODS / float(np.max(scene.gait.frequency))
    step = default_step(scene, default_method(scene))
    orbit, bar = refined_orbit(scene, watched, options=SolverOptions(dt=step))
    finer = [find_orbit(scene, watched, options=SolverOptions(dt=step / parts)) for parts in PARTS[1:]]
    return {
        "settled": orbit.settled and all(each.settled for each in finer),
        "speeds": [orbit.speed, *(each.speed for each in finer)],
        "speed_error_bar": bar,
        "residual": orbit.residual,
        "periods": orbit.periods,
    }


def summary(here: list[Record]) -> dict[str, Any]:
    """Of the gaits on one contact model: how many settled at all steps, and how well their speeds converge."""
    kept = [row for row in here if row["settled"]]
    speeds, bars = (np.array([row[key] for row in kept]) for key in ("speeds", "speed_error_bar"))
    finest = speeds[:, -1]
    off = np.abs(speeds[:, 0] - finest)
    orders = order(speeds)
    return {
        "gaits": len(here),
        "settled": len(kept),
        "closed": sum(row["residual"] < CLOSED for row in kept),
        "within_a_hundredth": float((off <= 0.01 * finest).mean()) if kept else None,
        "covered": float((off <= bars).mean()) if kept else None,
        "median_off": float(np.median(off / finest)) if kept else None,
        "median_bar": float(np.median(bars / finest)) if kept else None,
        "order": np.quantile(orders, [0.25, 0.5, 0.75]).tolist() if kept else None,
    }


def shown(settled: list[Record]) -> Record:
    """What the figure shows of gaits that settled: how far coarser steps are off the finest, m/s, and the error bar."""
    speeds = np.array([row["speeds"] for row in settled]).reshape(len(settled), len(PARTS))
    return {"off": np.abs(speeds[:, :-1] - speeds[:, -1:]), "bar": [row["speed_error_bar"] for row in settled]}


def order(speeds: np.ndarray) -> np.ndarray:
    """p of speeds v(h), v(h/2), v(h/4), ..., (gaits, steps), by log2 |v(h) - v(h/2)| / |v(h/2) - v(h/4)|."""
    changes = np.maximum(np.abs(np.diff(speeds[:, :3])), np.finfo(float).tiny)
    return np.log2(changes[:, 0] / changes[:, 1])


@orbits_of_searches.table
def words(record: Record) -> str:
    """How many gaits settle, and how well the error bars of their speeds hold."""
    cells: dict[str, Any] = {
        "contact": "{contact}",
        "gaits on an orbit": "{settled} of {gaits}",
        "shape returns to 1 mm": "{closed} of {settled}",
        "error below 1 %": lambda row: f"{100 * row['within_a_hundredth']:.0f} %",
        "error within the bar": lambda row: f"{100 * row['covered']:.0f} %",
        "medians: error, bar": lambda row: f"{100 * row['median_off']:.2g} %, {100 * row['median_bar']:.2g} %",
        "order: median (quartiles)": lambda row: "{1:.1f} ({0:.1f} to {2:.1f})".format(*row["order"]),
    }
    return columns(record["rows"], cells)


@orbits_of_searches.figure(4.6)
def figure(record: Record, chart: Figure) -> None:
    """By how much each speed is off, against its error bar, those below the line covered; and against the step."""
    bars, steps = chart.subplots(1, 2, sharey=True)
    parts = 1 / np.array(PARTS[:-1])
    for k, (row, mark) in enumerate(zip(record["rows"], plot.MARKERS)):
        off = np.maximum(np.reshape(row["each"]["off"], (-1, len(parts))), 1e-10)
        bars.loglog(row["each"]["bar"], off[:, 0], mark, markersize=5, fillstyle="none")
        steps.loglog(parts, off.T, color=f"C{k}", lw=0.5, alpha=0.3)
        if len(off):
            steps.loglog(parts, np.median(off, axis=0), f"C{k}{mark}-", label=f"{row['contact']} contact (median bold)")
    ends = np.array([1e-7, 1.0])
    bars.loglog(ends, ends, color="black", lw=1, label="difference = error bar")
    bars.set(xlabel="error bar (m/s)", ylabel=f"difference of speed from 1/{PARTS[-1]} of the step (m/s)")
    bars.set_title("At the default step")
    steps.set(xlabel="step / default step", title="At smaller steps")
    steps.set_xticks(parts, ["1", "1/2", "1/4"])
    steps.xaxis.set_minor_formatter("")
    chart.legend(loc="outside lower center", ncols=3)

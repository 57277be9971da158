"""How often error bars cover the true error, on gaits and parameters that nothing was tuned on.

Random phases, frequencies of 0.3 to 0.8 Hz, friction of 0.3 to 0.8, on both models of the robot. The truth is a
rollout at a step 16 times smaller.
"""

from collections.abc import Iterator
from itertools import product

import equinox as eqx
import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns, short

from jaxgrity import Scene, SolverOptions, gaits_of, load_scene, random_phases, simulate_population, verify
from jaxgrity.report import plot
from jaxgrity.stepping import resolve


@measurement(page="accuracy.md", quick={"gaits": 8, "groups": 2, "durations": (2.0,)}, drawn=("bars", "errors"))
def error_bars(
    gaits: int = 64, groups: int = 8, durations: tuple[float, ...] = (4.0, 10.0), seed: int = 2028
) -> Iterator[Record]:
    """A row for each scene and duration.

    Args:
        gaits: random gaits on each model
        groups: values of the friction coefficient
        durations: of the rollouts, s
        seed: of gaits, frequencies and friction; the rule for the bars was chosen with seeds 11, 12 and 2027
    """
    for name, duration in product(("reference", "exact"), durations):
        bars, errors, dt = bars_and_errors(load_scene(name), duration, gaits, groups, seed)
        yield {
            "scene": name,
            "duration": duration,
            "dt": dt,
            "gaits": len(bars),
            "covered": float(np.mean(bars >= errors)),
            "median_error": float(np.median(errors)),
            "median_bar": float(np.median(bars)),
            "median_ratio": float(np.median(bars / errors)),
            "bars": bars,
            "errors": errors,
        }


def bars_and_errors(
    scene: Scene, duration: float, count: int, groups: int, seed: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Error bar and true error of each gait's centre of mass, m, and the step, s."""
    draw = np.random.default_rng(seed)
    phases = random_phases(count, len(scene.gait.members), seed)
    frequencies = draw.uniform(0.3, 0.8, (count, 1)) * np.ones_like(phases)
    dt = resolve(scene, duration, dtype="float64").dt
    bars, errors = [], []
    for rows in np.array_split(np.arange(count), groups):
        changed = eqx.tree_at(lambda s: s.friction.mu, scene, np.asarray(draw.uniform(0.3, 0.8)))
        gaits = gaits_of(scene.gait, phases[rows], frequency=frequencies[rows])
        verified = verify(changed, gaits, duration, options=SolverOptions(dt=dt))
        truth = simulate_population(changed, gaits, duration, options=SolverOptions(dt=dt / 16, dtype="float64"))
        bars.append(verified.error_bar)
        errors.append(np.linalg.norm(verified.com_end - np.asarray(truth.com_end), axis=1))
    return np.concatenate(bars), np.concatenate(errors), dt


@error_bars.table
def words(record: Record) -> str:
    """How many true errors the bars cover."""
    cells = {
        "scene": "{scene}",
        "duration, s": "{duration:g}",
        "step, ms": lambda row: f"{1e3 * row['dt']:g}",
        "covered": lambda row: f"{round(row['covered'] * row['gaits'])} of {row['gaits']}",
        "median error, mm": lambda row: short(1e3 * row["median_error"]),
        "median bar, mm": lambda row: short(1e3 * row["median_bar"]),
        "median bar/error": "{median_ratio:.1f}",
    }
    return columns(record["rows"], cells)


@error_bars.figure()
def figure(record: Record, chart: Figure) -> None:
    """Bar against true error, a panel for each case: below the line the bar is too short."""
    rows = record["rows"]
    chart.set_figheight(3.4 * -(-len(rows) // 2) + 0.6)
    for axes, row in zip(chart.subplots(-(-len(rows) // 2), 2, squeeze=False).flat, rows):
        errors, bars = np.asarray(row["errors"], float), np.asarray(row["bars"], float)
        lower = bars < errors
        axes.loglog(errors[~lower], bars[~lower], "o", ms=4, color=plot.PATH, label="bar covers the error")
        axes.loglog(errors[lower], bars[lower], "X", ms=6, color=plot.STRUT, label="bar is too short")
        ends = np.array([errors.min(), errors.max()])
        axes.loglog(ends, ends, color="black", label="bar = error")
        axes.loglog(ends, 5 * ends, color="C4", label="bar = 5 times the error")
        axes.set(xlabel="true error (m)", ylabel="error bar (m)")
        axes.set_title(f"{row['scene']} scene, {row['duration']:g} s: {row['covered']:.0%} covered")
    chart.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4)

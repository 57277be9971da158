"""How often error bars cover the true error, on gaits and parameters that nothing was tuned on.

Random phases, frequencies of 0.3 to 0.8 Hz, friction of 0.3 to 0.8, on both models of the robot. The truth is a
rollout at a step 16 times smaller.
"""

from dataclasses import dataclass
from pathlib import Path

from jaxgrity.cli.script import measured, run

import equinox as eqx
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import Scene, SolverOptions, gaits_of, load_scene, random_phases, simulate_population, verify
from jaxgrity.io.files import save_json
from jaxgrity.report import plot
from jaxgrity.stepping import resolve


@dataclass
class Settings:
    gaits: int = 64
    """random gaits on each model"""
    groups: int = 8
    """values of the friction coefficient"""
    durations: tuple[float, ...] = (4.0, 10.0)
    """horizons, s"""
    seed: int = 2028
    """of gaits, frequencies and friction; the rule for the bars was chosen with seeds 11, 12 and 2027"""
    out: Path = Path("results/error_bars")
    """folder for error_bars.json and its figure"""
    quick: bool = False
    """8 gaits, 2 s"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.gaits, settings.groups, settings.durations = 8, 2, (2.0,)
    cases = [(name, duration) for name in ("reference", "exact") for duration in settings.durations]
    rows = []
    for name, duration in tqdm(cases, desc="scenes", unit="scene"):
        bars, errors, dt = bars_and_errors(load_scene(name), duration, settings)
        rows.append(
            {
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
        )
    save_json(settings.out / "error_bars.json", {**measured(), "seed": settings.seed, "rows": rows})
    plot.save(figure(rows), settings.out / "error_bars.png")
    for row in rows:
        print(
            f"{row['scene']:9s} {row['duration']:4g} s, dt = {row['dt']:g} s: {row['covered']:.1%} covered; medians: "
            f"bar {row['median_bar']:.2g} m, true error {row['median_error']:.2g} m, ratio {row['median_ratio']:.2g}"
        )
    print(f"wrote {settings.out}/error_bars.json and error_bars.png")


def bars_and_errors(scene: Scene, duration: float, settings: Settings) -> tuple[np.ndarray, np.ndarray, float]:
    """Error bar and true error of each gait's centre of mass, m, and the step, s."""
    draw = np.random.default_rng(settings.seed)
    phases = random_phases(settings.gaits, len(scene.gait.members), settings.seed)
    frequencies = draw.uniform(0.3, 0.8, (settings.gaits, 1)) * np.ones_like(phases)
    dt = resolve(scene, duration, dtype="float64").dt
    bars, errors = [], []
    for rows in np.array_split(np.arange(settings.gaits), settings.groups):
        changed = eqx.tree_at(lambda s: s.friction.mu, scene, np.asarray(draw.uniform(0.3, 0.8)))
        gaits = gaits_of(scene.gait, phases[rows], frequency=frequencies[rows])
        verified = verify(changed, gaits, duration, options=SolverOptions(dt=dt))
        truth = simulate_population(changed, gaits, duration, options=SolverOptions(dt=dt / 16, dtype="float64"))
        bars.append(verified.error_bar)
        errors.append(np.linalg.norm(verified.com_end - np.asarray(truth.com_end), axis=1))
    return np.concatenate(bars), np.concatenate(errors), dt


@plot.styled
def figure(rows: list[dict]) -> Figure:
    """Bar against true error, a panel for each case: below the line the bar is too short."""
    chart = Figure(figsize=(4 * len(rows), 4), layout="constrained")
    for axes, row in zip(np.atleast_1d(chart.subplots(1, len(rows))), rows):
        errors, bars = np.asarray(row["errors"]), np.asarray(row["bars"])
        short = bars < errors
        axes.loglog(errors[~short], bars[~short], "o", ms=4, color=plot.PATH)
        axes.loglog(errors[short], bars[short], "o", ms=4, color=plot.STRUT)
        ends = np.array([errors.min(), errors.max()])
        axes.loglog(ends, ends, "k-", lw=0.8)
        axes.loglog(ends, 5 * ends, "k:", lw=0.8)
        axes.set(xlabel="true error, m", ylabel="error bar, m")
        axes.set_title(f"{row['scene']}, {row['duration']:g} s: {row['covered']:.0%} covered")
    return chart


if __name__ == "__main__":
    run(main, Settings)

"""How steep the gait `uphill` climbs: its speed up slopes, on robots whose friction differs, on both contact models.

The gait was searched for on 15 degrees alone. What counts is the displacement uphill over the second half of the time,
so that a robot that begins to slide, or turns round, is seen. With exact contact all is done at half the step too.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import Differences, SolverOptions, contact_twin, gaits_of, load_gait, load_scene, simulate_population
from jaxgrity.io.files import save_json
from jaxgrity.report import plot
from jaxgrity.stepping import default_method, default_step


@dataclass
class Settings:
    slopes: tuple[float, ...] = (0.0, 5.0, 10.0, 12.5, 15.0, 17.5, 20.0, 22.5, 25.0, 27.5, 30.0)
    """degrees"""
    friction: tuple[float, ...] = (0.8, 0.9, 1.0, 1.1, 1.2)
    """times the scene's"""
    duration: float = 120.0
    """s"""
    out: Path = Path("results/climbing")
    """folder for climbing.json and its figure"""
    quick: bool = False
    """one slope, 10 s"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.slopes, settings.duration = (15.0,), 10.0
    own = load_scene("uphill")
    rows: list[dict[str, Any]] = []
    gait, nominal = load_gait("uphill"), float(own.ground.incline)
    step, twin = default_step(own, default_method(own)), contact_twin(own)
    ways = {"own": (own, step), "finer": (own, step / 2), "other": (twin, None)}
    gaits = gaits_of(gait, np.repeat(np.asarray(gait.phase)[None], len(settings.friction), axis=0))
    for slope in tqdm(settings.slopes, unit="slope"):
        lean = np.radians(slope) - nominal  # uphill is -x
        up = np.tile([-np.sin(lean), 0.0, np.cos(lean)], (len(settings.friction), 1))
        differences = Differences(friction=np.array(settings.friction), up=up)
        row: dict[str, Any] = {"slope": slope}
        for name, (scene, step) in ways.items():
            options = SolverOptions(dt=step)
            found = simulate_population(
                scene, gaits, settings.duration, options=options, differences=differences, parts=2
            )
            path = np.asarray(found.com_path)[..., 0]
            speed = (path[:, 1] - path[:, 2]) / (settings.duration / 2)
            row[name] = np.where(np.asarray(found.failure) == 0, speed, 0.0).tolist()
        rows.append(row)
        facts = {"friction": [float(own.friction.sliding_mu) * x for x in settings.friction], "rows": rows}
        save_json(settings.out / "climbing.json", {**measured(), "duration": settings.duration, **facts})
    plot.save(figure(rows, facts["friction"]), settings.out / "climbing.png")
    for row in rows:
        print(f"{row['slope']:g} degrees: {min(row['own']):.2f} to {max(row['own']):.2f} m/s uphill")


@plot.styled
def figure(rows: list[dict[str, Any]], friction: list[float]) -> Figure:
    """Speed uphill against the slope, for each coefficient of friction."""
    chart = Figure(figsize=(7, 3.2), layout="constrained")
    panes = chart.subplots(1, 2, sharey=True)
    for axes, name, title in zip(panes, ("own", "other"), ("exact contact", "penalty contact")):
        speeds = np.array([row[name] for row in rows])
        for k, mu in enumerate(friction):
            axes.plot([row["slope"] for row in rows], speeds[:, k], "o-", label=f"friction {mu:.2g}")
        axes.axhline(0, color="black", linewidth=0.8)
        axes.set(title=title, xlabel="slope (degrees)")
    panes[0].set_ylabel("speed uphill (m/s)")
    panes[0].legend(loc="lower left", fontsize="small")
    return chart


if __name__ == "__main__":
    run(main, Settings)

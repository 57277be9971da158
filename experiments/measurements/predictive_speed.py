"""How fast predictive control is: choices of the controller beside the time that passes for the robot.

A robot is led to a goal behind it, at 10 choices a second, each from rollouts of 2 s. Compilation is left out: a first
journey compiles what the second, which is measured, runs again. The robot that is led is not counted as work of the
controller.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import SolverOptions, as_dtype, load_gait, load_scene
from jaxgrity.control import MotorLimits, PhaseLocked, Sampling, Steered, centre_offsets, lead_to, plant_of
from jaxgrity.io.files import save_json
from jaxgrity.report import plot

GOAL = np.array([-12.0, 2.0])
"""m"""


@dataclass
class Settings:
    samples: tuple[int, ...] = (16, 64, 256)
    """rollouts of the model for each choice"""
    rate: float = 10.0
    """choices a second"""
    horizon: float = 2.0
    """s, for which each sample is rolled out"""
    seconds: float = 8.0
    """s, of the journey"""
    out: Path = Path("results/predictive_speed")
    """folder for predictive_speed.json and its figure"""
    quick: bool = False
    """8 samples for 1 s"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.samples, settings.seconds = (8,), 1.0
    gait, scene = load_gait("lasting"), load_scene("exact")
    options = SolverOptions(dt=0.01, dtype="float32")
    plant = plant_of(scene, gait.members, motors=MotorLimits(rate=1.2), options=options)
    offsets = centre_offsets(scene.structure, gait.members)
    policy = as_dtype(Steered(PhaseLocked(gait), np.array(0.0), offsets), "float32")
    rows: list[dict[str, Any]] = []
    for samples in tqdm(settings.samples, unit="size"):
        sampling = Sampling(
            samples=samples, horizon=settings.horizon, interval=1 / settings.rate, patience=settings.seconds
        )
        lead_to(plant, plant, policy, GOAL, sampling=sampling._replace(patience=2 / settings.rate))
        found = lead_to(plant, plant, policy, GOAL, sampling=sampling)
        rows.append(
            {
                "samples": samples,
                "real_time": found.real_time,
                "milliseconds": 1000 / settings.rate / found.real_time,
                "slowest": 1000 * float(np.quantile(found.spent, 0.95)),
                "choices": len(found.bends),
            }
        )
        told = {"rate": settings.rate, "horizon": settings.horizon}
        save_json(settings.out / "predictive_speed.json", {**measured(), **told, "rows": rows})
    plot.save(figure(rows), settings.out / "predictive_speed.png")
    for row in rows:
        print(
            f"{row['samples']} samples: {row['milliseconds']:.0f} ms a choice, {row['real_time']:.2g} times real time"
        )


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """How much faster than the robot the controller is, against the samples of a choice."""
    chart = Figure(figsize=(5, 3), layout="constrained")
    axes = chart.subplots()
    axes.loglog([row["samples"] for row in rows], [row["real_time"] for row in rows], "o-", base=2)
    axes.axhline(1.0, color="black", linewidth=0.8, linestyle=":")
    axes.annotate("real time", (rows[0]["samples"], 1.0), textcoords="offset points", xytext=(0, 4))
    axes.set(xlabel="rollouts for each choice", ylabel="times real time")
    axes.set_xticks([row["samples"] for row in rows], [f"{row['samples']}" for row in rows])
    return chart


if __name__ == "__main__":
    run(main, Settings)

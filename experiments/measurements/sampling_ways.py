"""Which samples lead a robot to a goal soonest: drawn at random, or in rounds about the best; one bend, or several.

The trials are those of goals.py across a slope, where the robot is not the model. All ways cost as many rollouts.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import goals
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity.control import Sampling, lead_to
from jaxgrity.io.files import save_json
from jaxgrity.report import plot

WAYS = {"at random": {"rounds": 1}, "two rounds": {"rounds": 2}, "four rounds": {"rounds": 4}}
"""how samples are drawn"""


@dataclass
class Settings:
    trials: int = 20
    samples: int = 64
    """rollouts of the model for each choice"""
    knots: tuple[int, ...] = (1, 3)
    """bends over the horizon"""
    seed: int = 100
    """of starts, friction and samples"""
    out: Path = Path("results/sampling_ways")
    """folder for sampling_ways.json and its figure"""
    quick: bool = False
    """one trial of 2 s, on the exact model, without the slope"""


def main(settings: Settings) -> None:
    patience, count = (2.0, 1) if settings.quick else (goals.PATIENCE, settings.trials)
    field = goals.Settings(seed=settings.seed, quick=settings.quick)
    ways = [(name, knots) for name in WAYS for knots in settings.knots]
    rows: list[dict[str, Any]] = []
    for name, knots in tqdm(ways, unit="way"):
        sampling = Sampling(samples=settings.samples, knots=knots, patience=patience, **WAYS[name])
        led = [
            lead_to(t.robot, t.model, goals.feedback(), goals.GOAL, start=t.start, seed=number, sampling=sampling)
            for number, t in enumerate(goals.drawn_trials(field, count))
        ]
        rows.append(
            {
                "way": name,
                "knots": knots,
                "reached": sum(each.reached for each in led),
                "seconds": [each.seconds for each in led],
                "milliseconds": float(np.median([1000 * sampling.interval / each.real_time for each in led])),
            }
        )
        told = {"trials": count, "samples": settings.samples, "patience": patience}
        save_json(settings.out / "sampling_ways.json", {**measured(), **told, "rows": rows})
    plot.save(figure(rows), settings.out / "sampling_ways.png")
    for row in rows:
        print(f"{row['way']}, {row['knots']}: {row['reached']} reached, {np.mean(row['seconds']):.1f} s on average")


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """Times of all trials for each way."""
    chart = Figure(figsize=(6, 0.45 * len(rows) + 1.2), layout="constrained")
    axes = chart.subplots()
    for place, row in enumerate(rows):
        axes.plot(row["seconds"], place + 0 * np.array(row["seconds"]), "o", markersize=4, alpha=0.6)
        axes.plot(np.mean(row["seconds"]), place, "|", color="black", markersize=16)
    axes.set_yticks(range(len(rows)), [f"{row['way']}, {row['knots']}" for row in rows])
    axes.set(xlabel="time to the goal (s)", ylabel="way, bends")
    axes.invert_yaxis()
    return chart


if __name__ == "__main__":
    run(main, Settings)

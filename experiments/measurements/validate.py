"""A real robot and its simulation: statics of the measured spine through all of its commanded poses, nothing fitted."""

from dataclasses import dataclass
from pathlib import Path

from jaxgrity.cli.script import measured, run

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from spine_robot import FOLDER, POSE, Spine, load_spine, pose, resting_shapes, rms

from jaxgrity.io.files import save_json
from jaxgrity.report import plot

UNITS = np.array([1e3, 1e3, 180 / np.pi])
"""mm, mm and degrees, from m, m and rad"""


@dataclass
class Settings:
    tables: Path = FOLDER
    """folder with spine.toml and the tables of measurements"""
    out: Path = Path("results/validation")
    """folder for validation.json and the figure"""
    quick: bool = False
    """the first ten commands alone"""


def main(settings: Settings) -> None:
    spine = load_spine(settings.tables)
    if settings.quick:
        first = slice(10)
        spine = spine._replace(
            retraction=spine.retraction[first],
            expected=spine.expected[first],
            seen=spine.seen[:, first],
            middle=spine.middle[:, first],
        )
    simulated = np.asarray(jax.vmap(pose)(jnp.asarray(resting_shapes(spine))))
    found = compared(spine, simulated)
    save_json(settings.out / "validation.json", {**measured(), **found})
    plot.save(figure(spine, simulated), settings.out / "validation.png")
    for name in POSE:
        print(f"{name}: {found['camera'][name]['least']:.2f} to {found['camera'][name]['most']:.2f} rms over the runs")
    print(f"{settings.out}/validation.json, validation.png")


def compared(spine: Spine, simulated: np.ndarray) -> dict:
    """Differences from the authors' poses and from the camera's, in mm and degrees."""
    authors = np.abs(simulated - spine.expected).max(0) * UNITS
    late, middle = (UNITS * rms(frames - simulated, axis=1) for frames in (spine.seen, spine.middle))
    repeated = UNITS * rms(np.nanstd(spine.seen, axis=0, ddof=1), axis=0)
    mean = UNITS * np.nanmean(spine.seen - simulated, axis=(0, 1))
    return {
        "commands": len(simulated),
        "runs": len(spine.runs),
        "missing": int(np.isnan(spine.seen).any(2).sum()),
        "authors": dict(zip(POSE, authors)),
        "camera": {
            name: {
                "least": late[:, k].min(),
                "most": late[:, k].max(),
                "mean": mean[k],
                "repeatability": repeated[k],
                "middle_least": middle[:, k].min(),
                "middle_most": middle[:, k].max(),
            }
            for k, name in enumerate(POSE)
        },
    }


def figure(spine: Spine, simulated: np.ndarray) -> Figure:
    """The path of the vertebra, and how far the camera's poses are from the simulated ones, run by run."""
    chart = Figure(figsize=(9, 5.5), layout="constrained")
    grid = chart.add_gridspec(3, 2, width_ratios=[1, 1.4])
    path = chart.add_subplot(grid[:, 0])
    for k, seen in enumerate(spine.seen):
        label = f"camera, {len(spine.runs)} runs" if k == 0 else None
        path.plot(*(1e3 * seen[:, :2].T), color="0.7", linewidth=0.7, label=label)
    path.plot(*(1e3 * simulated[:, :2].T), color="C0", label="simulated")
    path.set(xlabel="x (mm)", ylabel="z (mm)", title="Origin of the vertebra's frame")
    path.legend()
    spread = UNITS * np.nanstd(spine.seen, axis=0, ddof=1)
    for k, (name, unit) in enumerate(zip(POSE, ("mm", "mm", "degrees"))):
        axes = chart.add_subplot(grid[k, 1])
        error = UNITS[k] * (spine.seen[:, :, k] - simulated[:, k])
        centre = np.nanmean(error, axis=0)
        steps = np.arange(len(simulated))
        axes.fill_between(steps, centre - spread[:, k], centre + spread[:, k], color="C0", alpha=0.3, linewidth=0)
        axes.plot(steps, error.T, color="0.6", linewidth=0.5)
        axes.plot(steps, centre, color="C0")
        axes.axhline(0, color="black", linewidth=0.8)
        axes.set_ylabel(f"{name} ({unit})")
        axes.tick_params(labelbottom=k == 2)
        if k == 0:
            axes.set_title("Camera less simulation, mean and deviation of the runs")
    axes.set_xlabel("command")
    return chart


if __name__ == "__main__":
    run(main, Settings)

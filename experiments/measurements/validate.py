"""A real robot and its simulation: statics of the measured spine through all of its commanded poses, nothing fitted."""

import jax
import jax.numpy as jnp
import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table
from measurements.spine_robot import POSE, Spine, load_spine, pose, resting_shapes, rms

UNITS = np.array([1e3, 1e3, 180 / np.pi])
"""mm, mm and degrees, from m, m and rad"""
UNIT = {"x": "mm", "z": "mm", "rotation": "°"}
"""Unit of each part of a pose."""


@measurement(page="validation.md", quick={"first": 10}, drawn=("path", "errors"))
def validation(first: int | None = None) -> Record:
    """How far the poses are from the authors' and the camera's.

    Args:
        first: number of commands, the first ones; all, where not given
    """
    spine = load_spine()
    some = slice(first)
    spine = spine._replace(
        retraction=spine.retraction[some],
        expected=spine.expected[some],
        seen=spine.seen[:, some],
        middle=spine.middle[:, some],
    )
    simulated = np.asarray(jax.vmap(pose)(jnp.asarray(resting_shapes(spine))))
    path = {"simulated": 1e3 * simulated[:, :2], "seen": 1e3 * np.nanmean(spine.seen[:, :, :2], axis=0)}
    return compared(spine, simulated) | {"path": path, "errors": UNITS * (spine.seen - simulated)}


def compared(spine: Spine, simulated: np.ndarray) -> dict:
    """Differences from the authors' poses and from the camera's, in mm and degrees."""
    authors = np.abs(simulated - spine.expected).max(0) * UNITS
    late, middle = (UNITS * rms(frames - simulated, axis=1) for frames in (spine.seen, spine.middle))
    repeated = UNITS * rms(np.nanstd(spine.seen, axis=0, ddof=1), axis=0)
    mean = UNITS * np.nanmean(spine.seen - simulated, axis=(0, 1))
    return {
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


@validation.figure(6)
def figure(record: Record, chart: Figure) -> None:
    """The path of the vertebra, and how far the camera's poses are from the simulated ones, run by run."""
    seen, simulated = (np.array(record["path"][name], float) for name in ("seen", "simulated"))
    errors = np.array(record["errors"], float)
    grid = chart.add_gridspec(3, 2, width_ratios=[1, 1.4])
    path = chart.add_subplot(grid[:, 0])
    path.plot(*seen.T, "o", color="0.6", markersize=4, label=f"camera, mean of {len(errors)} runs")
    path.plot(*simulated.T, color="C0", label="simulated")
    path.set(xlabel="x (mm)", ylabel="z (mm)", title="Origin of the vertebra's frame")
    for k, (name, unit) in enumerate(zip(POSE, ("mm", "mm", "degrees"))):
        axes = chart.add_subplot(grid[k, 1])
        error, steps = errors[:, :, k], np.arange(1, len(simulated) + 1)
        centre, spread = np.nanmean(error, axis=0), np.nanstd(error, axis=0, ddof=1)
        around = (centre - spread, centre + spread)
        axes.fill_between(steps, *around, color="C0", alpha=0.3, linewidth=0, label="standard deviation")
        axes.plot(steps, error.T, color="0.6", linewidth=0.5, label=["a run"] + [None] * (len(error) - 1))
        axes.plot(steps, centre, color="C0", label="mean of the runs")
        axes.axhline(0, color="black", linewidth=0.8)
        axes.set_ylabel(f"{name} ({unit})")
        axes.tick_params(labelbottom=k == 2)
        if k == 0:
            axes.set_title("Camera less simulation")
    axes.set_xlabel("command")
    both = [a + b for a, b in zip(path.get_legend_handles_labels(), axes.get_legend_handles_labels())]
    chart.legend(*both, loc="outside lower center", ncols=3)


@validation.table
def words(record: Record) -> str:
    """How far the poses are off, beside what the robot itself repeats."""
    rows = []
    for name, unit in UNIT.items():
        seen, authors = record["camera"][name], record["authors"][name]
        rows.append(
            [
                name,
                f"{1e3 * authors:.1f} µm" if unit == "mm" else f"{authors:.1e}{unit}",
                f"{seen['least']:.2f} to {seen['most']:.2f} {unit}",
                f"{seen['mean']:.2f} {unit}",
                f"{seen['repeatability']:.2f} {unit}",
                f"{seen['middle_least']:.2f} to {seen['middle_most']:.2f} {unit}",
            ]
        )
    head = ["coordinate", "from the laboratory's poses, at most", "from the camera, rms of a run"]
    head += ["from the camera, mean", "the robot from run to run", "from the camera at rest, rms of a run"]
    return table(head, rows)

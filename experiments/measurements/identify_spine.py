"""What the measured spine's parameters are, how sure that is, and how far the fitted robot is from runs held out.

They are fitted to the mean poses of every second run.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import equinox as eqx
import jax
import numpy as np
from matplotlib.figure import Figure
from numerics_tables import chosen
from pages import made_by, table
from spine_robot import (
    FOLDER,
    ORIGIN,
    POSE,
    TIP,
    Spine,
    commanded,
    load_spine,
    resting_shapes,
    rms,
)

from jaxgrity import Scene
from jaxgrity.identification import (
    Identified,
    Parameter,
    SeenAngles,
    SeenPositions,
    SeenTogether,
    identify,
    measured_poses,
    misfit_of,
    predicted,
)
from jaxgrity.io.files import save_json
from jaxgrity.report import plot

UNITS = np.array([1e3, 1e3, 180 / np.pi])
TURN = 39
"""the first command of the way up"""
UNKNOWN = (
    Parameter("scene.structure.cables.stiffness", 0.1, parts=(0, 1)),
    Parameter("scene.structure.cables.stiffness", 0.1, parts=(2, 3)),
    Parameter("scene.structure.struts.mass", 0.05),
    *(Parameter("scene.structure.cables.rest_length", 3e-3, "offset", (k,)) for k in range(4)),
    *(Parameter("backlash", 3e-3, "offset", (k,)) for k in range(4)),
)
"""springs as sold, mass as weighed, cables as cut and tied, motors with backlash: and how far these may be wrong"""


class Rig(eqx.Module):
    """The robot and its motors."""

    scene: Scene
    backlash: jax.Array
    """m, by which each cable is longer on the way up"""


@dataclass
class Settings:
    tables: Path = FOLDER
    """folder with spine.toml and the tables of measurements"""
    out: Path = Path("results/spine")
    """folder for spine.json and the figure"""
    quick: bool = False
    """every tenth command"""


def main(settings: Settings) -> None:
    spine = load_spine(settings.tables)
    shapes = resting_shapes(spine)
    every = slice(None, None, 10 if settings.quick else 1)
    found, before, after = fitted_statics(spine, shapes, every)
    facts = {
        "fitted_runs": len(spine.runs[::2]),
        "held_out_runs": len(spine.runs[1::2]),
        "held_out": {name: {"before": before[k], "after": after[k]} for k, name in enumerate(POSE)},
        "repeatability": dict(zip(POSE, UNITS * rms(np.nanstd(spine.seen, axis=0, ddof=1), axis=0))),
        "misfit": found.misfit,
        "statics": rows_of(found),
        "untold": len(found.untold),
    }
    save_json(settings.out / "spine.json", {**measured(), **facts})
    plot.save(figure(spine, shapes, found), settings.out / "spine.png")
    print(found.summary(), f"{settings.out}/spine.json, spine.png", sep="\n")


def rows_of(found: Identified) -> list[dict[str, Any]]:
    """The estimates as they go into a JSON file."""
    known = zip(found.estimates, found.parameters)
    return [estimate._asdict() | {"kind": of.kind, "spread": of.spread} for estimate, of in known]


def in_use(rig: Rig, command: tuple) -> Scene:
    """The scene after a command: retractions, m, less backlash on the way up (1, or 0 on the way down)."""
    retraction, up = command
    return commanded(rig.scene, retraction - up * rig.backlash)


def poses_of(spine: Spine, shapes: np.ndarray, every: slice, values: np.ndarray, noise: np.ndarray):
    """Measured poses, (commands, 3), of some of the commands."""
    rig = Rig(spine.scene, np.zeros(4))
    up = (np.arange(len(spine.retraction)) >= TURN).astype(float)
    observation = SeenTogether((SeenPositions((ORIGIN,), "xz"), SeenAngles(((ORIGIN, TIP),), "xz")))
    commands = (spine.retraction[every], up[every])
    return rig, measured_poses(
        rig, values[every], noise, observation, shapes=shapes[every], commands=commands, command=in_use
    )


def fitted_statics(spine: Spine, shapes: np.ndarray, every: slice) -> tuple[Identified, np.ndarray, np.ndarray]:
    """The fit to the mean of every second run, and rms errors in the other runs without and with it, mm and degrees."""
    noise = rms(np.nanstd(spine.seen, axis=0, ddof=1), axis=0) / np.sqrt(len(spine.runs[::2]))
    rig, poses = poses_of(spine, shapes, every, np.nanmean(spine.seen[::2], axis=0), noise)
    found = identify(rig, UNKNOWN, poses)
    errors = []
    for robot in (rig, found.scene):
        each = [misfit_of(robot, poses_of(spine, shapes, every, seen, noise)[1])["rms"] for seen in spine.seen[1::2]]
        errors.append(UNITS * rms(np.array(each), axis=0))
    return found, errors[0], errors[1]


def figure(spine: Spine, shapes: np.ndarray, found: Identified) -> Figure:
    """Errors in the runs held out, before and after."""
    chart = Figure(figsize=(9, 5.5), layout="constrained")
    rig, poses = poses_of(spine, shapes, slice(None), spine.seen[0], np.ones(3))
    before, after = (np.asarray(predicted(poses, robot, np.zeros(0))) for robot in (rig, found.scene))
    for k, (axes, name, unit) in enumerate(zip(chart.subplots(3, sharex=True), POSE, ("mm", "mm", "degrees"))):
        for simulated, colour, label in ((before, "C1", "as sold"), (after, "C0", "identified")):
            error = UNITS[k] * (spine.seen[1::2, :, k] - simulated[:, k])
            axes.plot(error.T, color=colour, linewidth=0.4, alpha=0.6)
            axes.plot(np.nanmean(error, axis=0), color=colour, label=label)
        axes.axhline(0, color="black", linewidth=0.8)
        axes.set_ylabel(f"{name} ({unit})")
    chart.axes[0].set_title("Camera less simulation, runs held out: each, and their mean")
    chart.axes[0].legend(fontsize=8)
    chart.axes[2].set_xlabel("command")
    return chart


UNIT = {"x": "mm", "z": "mm", "rotation": "°"}
"""of what the pose consists of, in the table"""


def spine_facts(raw: dict[str, Any]) -> dict[str, Any]:
    names = ("command", "cores", "fitted_runs", "held_out_runs", "held_out", "repeatability", "misfit")
    return chosen(raw, *names) | {
        "statics": [chosen(row, "name", "kind", "spread", "value", "standard_error") for row in raw["statics"]]
    }


def spine_table(facts: dict[str, Any]) -> str:
    rows = [
        [
            name,
            f"{seen['before']:.2f} {unit}",
            f"{seen['after']:.2f} {unit}",
            f"{facts['repeatability'][name]:.2f} {unit}",
        ]
        for (name, unit), seen in zip(UNIT.items(), facts["held_out"].values())
    ]
    held_out = f"rms error in {facts['held_out_runs']} runs held out"
    head = [held_out, "as sold", f"identified from {facts['fitted_runs']} other runs", "the robot from run to run"]
    return table(head, rows) + made_by(facts, "spine")


def spine_parameters_table(facts: dict[str, Any]) -> str:
    return estimates_table(facts["statics"]) + made_by(facts, "spine")


def estimates_table(rows: list[dict[str, Any]]) -> str:
    """Factors as they are, offsets of lengths in mm."""
    cells = []
    for row in rows:
        size, unit = (1.0, "") if row["kind"] == "factor" else (1e3, " mm")
        error = f"{2 * size * row['standard_error']:.2g}{unit}"
        value = "cannot be told" if row["value"] is None else f"{size * row['value']:.3g}{unit} ± {error}"
        plausible = f"1 ({row['spread']:g})" if row["kind"] == "factor" else f"0{unit} ({size * row['spread']:g}{unit})"
        cells.append([row["name"].removeprefix("scene."), row["kind"], plausible, value])
    return table(["parameter", "", "plausible before (standard deviation)", "identified"], cells)


if __name__ == "__main__":
    run(main, Settings)

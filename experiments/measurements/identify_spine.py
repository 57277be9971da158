"""What the measured spine's parameters are, how sure that is, and how far the fitted robot is from runs held out.

They are fitted to the mean poses of every second run.
"""

from functools import partial

import equinox as eqx
import jax
import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table
from measurements.spine_robot import ORIGIN, POSE, TIP, Spine, commanded, load_spine, resting_shapes, rms
from measurements.validate import UNIT, UNITS

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


@measurement(page="validation.md", quick={"every": 10}, drawn=("as_sold", "identified"))
def spine(every: int = 1) -> Record:
    """The estimates, and errors in the runs that they were not fitted to.

    Args:
        every: of how many commands one is fitted
    """
    robot = load_spine()
    shapes = resting_shapes(robot)
    found, before, after = fitted_statics(robot, shapes, slice(None, None, every))
    rig, poses = poses_of(robot, shapes, slice(None), robot.seen[0], np.ones(3))
    simulated = (np.asarray(predicted(poses, each, np.zeros(0))) for each in (rig, found.scene))
    return {
        "fitted_runs": len(robot.runs[::2]),
        "held_out_runs": len(robot.runs[1::2]),
        "held_out": {name: {"before": before[k], "after": after[k]} for k, name in enumerate(POSE)},
        "repeatability": dict(zip(POSE, UNITS * rms(np.nanstd(robot.seen, axis=0, ddof=1), axis=0))),
        "statics": [
            {name: getattr(each, name) for name in ("name", "value", "standard_error")}
            | {"kind": of.kind, "spread": of.spread}
            for each, of in zip(found.estimates, found.parameters)
        ],
    } | {name: UNITS * (robot.seen[1::2] - each) for name, each in zip(("as_sold", "identified"), simulated)}


@spine.table
def words(record: Record) -> str:
    """Errors in the runs held out, beside what the robot itself repeats."""
    rows = [
        [
            name,
            f"{seen['before']:.2f} {unit}",
            f"{seen['after']:.2f} {unit}",
            f"{record['repeatability'][name]:.2f} {unit}",
        ]
        for (name, unit), seen in zip(UNIT.items(), record["held_out"].values())
    ]
    held_out = f"rms error in {record['held_out_runs']} other runs"
    head = [held_out, "as sold", f"fitted to {record['fitted_runs']} runs", "the robot from run to run"]
    return table(head, rows)


@partial(spine.table, part="parameters")
def parameters(record: Record) -> str:
    """Factors as they are, offsets of lengths in mm."""
    cells = []
    for row in record["statics"]:
        size, unit = (1.0, "") if row["kind"] == "factor" else (1e3, " mm")
        error = f"{2 * size * row['standard_error']:.2g}{unit}"
        value = "not determined" if row["value"] is None else f"{size * row['value']:.3g}{unit} ± {error}"
        plausible = f"1 ({row['spread']:g})" if row["kind"] == "factor" else f"0{unit} ({size * row['spread']:g}{unit})"
        cells.append([row["name"].removeprefix("scene."), row["kind"], plausible, value])
    return table(["parameter", "kind", "before (plausible spread)", "identified"], cells)


def in_use(rig: Rig, command: tuple) -> Scene:
    """The scene after a command: retractions, m, less backlash on the way up (1, or 0 on the way down)."""
    retraction, up = command
    return commanded(rig.scene, retraction - up * rig.backlash)


def poses_of(robot: Spine, shapes: np.ndarray, every: slice, values: np.ndarray, noise: np.ndarray):
    """Measured poses, (commands, 3), of some of the commands."""
    rig = Rig(robot.scene, np.zeros(4))
    up = (np.arange(len(robot.retraction)) >= TURN).astype(float)
    observation = SeenTogether((SeenPositions((ORIGIN,), "xz"), SeenAngles(((ORIGIN, TIP),), "xz")))
    commands = (robot.retraction[every], up[every])
    return rig, measured_poses(
        rig, values[every], noise, observation, shapes=shapes[every], commands=commands, command=in_use
    )


def fitted_statics(robot: Spine, shapes: np.ndarray, every: slice) -> tuple[Identified, np.ndarray, np.ndarray]:
    """The fit to the mean of every second run, and rms errors in the other runs without and with it, mm and degrees."""
    noise = rms(np.nanstd(robot.seen, axis=0, ddof=1), axis=0) / np.sqrt(len(robot.runs[::2]))
    rig, poses = poses_of(robot, shapes, every, np.nanmean(robot.seen[::2], axis=0), noise)
    found = identify(rig, UNKNOWN, poses)
    errors = []
    for each in (rig, found.scene):
        off = [misfit_of(each, poses_of(robot, shapes, every, seen, noise)[1])["rms"] for seen in robot.seen[1::2]]
        errors.append(UNITS * rms(np.array(off), axis=0))
    return found, errors[0], errors[1]


@spine.figure(6.5)
def figure(record: Record, chart: Figure) -> None:
    """Errors in the runs held out, before and after."""
    panes = chart.subplots(3, sharex=True)
    looks = {"as_sold": ("C1", "^", "as sold"), "identified": ("C0", "o", "identified")}
    for k, (axes, name, unit) in enumerate(zip(panes, POSE, ("mm", "mm", "degrees"))):
        for kind, (colour, marker, label) in looks.items():
            error = np.array(record[kind], float)[:, :, k]
            at = np.arange(1, error.shape[1] + 1)
            axes.plot(at, error.T, color=colour, linewidth=0.4, alpha=0.6)
            mean = {"marker": marker, "markevery": 10, "markersize": 5, "label": f"{label}, mean of the runs"}
            axes.plot(at, np.nanmean(error, axis=0), color=colour, **mean)
        axes.axhline(0, color="black", linewidth=0.8)
        axes.set_ylabel(f"{name} ({unit})")
    panes[0].set_title("Camera less simulation in the runs held out (thin: each run)")
    panes[2].set_xlabel("command")
    chart.legend(*panes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)

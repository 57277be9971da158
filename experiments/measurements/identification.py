"""How well a rolling robot's parameters are identified from what a motion capture system would see of it.

The six-strut robot is thrown over the ground, with a stiffness, a damping, a mass and a friction that differ from the
scene's, and all nodes are seen 100 times a second with 2 mm of noise. Where it starts, and how fast, is not known.
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import (
    InputError,
    Parameter,
    Scene,
    SeenPositions,
    SolverOptions,
    Starts,
    changed,
    identify,
    load_scene,
    measured_motion,
    plot,
    simulate,
    with_gait,
)
from jaxgrity.io.files import save_json

UNKNOWN = (
    Parameter("structure.cables.stiffness", 0.3),
    Parameter("structure.cables.damping", 0.3),
    Parameter("structure.node_mass", 0.3),
    Parameter("friction.mu", 0.3),
)
WRONG_BY = 0.2
"""of each parameter, at most: uniform in the logarithm"""
FRAME_RATE, NOISE = 100.0, 2e-3
"""1/s; m"""
SETTLING = 3.0
"""s, in which the robot comes to rest before it is thrown"""


@dataclass
class Settings:
    trials: int = 20
    duration: float = 1.0
    """s, for which each throw is seen"""
    speed: float = 1.5
    """m/s, of the throw"""
    dt: float = 5e-4
    """s; the data are simulated at half of it"""
    seed: int = 0
    out: Path = Path("results/identification")
    """folder for identification.json and the figure"""
    quick: bool = False
    """one throw, seen for a fifth of a second"""


def main(settings: Settings) -> None:
    """Identify, trial by trial. Raises `InputError` where there is none."""
    if settings.quick:
        settings = replace(settings, trials=1, duration=0.2)
    if settings.trials < 1:
        raise InputError(f"trials = {settings.trials}: expected at least 1")
    scene = with_gait(load_scene("reference"), None)
    resting = np.asarray(simulate(scene, SETTLING, frame_rate=1.0).positions[-1])
    rows: list[dict[str, Any]] = []
    for trial in tqdm(range(settings.trials), desc="throws", unit="throw"):
        rows.append(one_throw(scene, resting, settings, np.random.default_rng([settings.seed, trial])))
        # what has been found so far is not lost where the rest takes too long
        save_json(settings.out / "identification.json", {**measured(), **facts_of(rows, settings.duration)})
    plot.save(figure(rows), settings.out / "identification.png")
    for each in facts_of(rows, settings.duration)["parameters"]:
        print(f"{each['name']}: off by at most {each['largest']:.2%}, {each['covered']} of {len(rows)} within 95 %")
    print(f"{settings.out}/identification.json, identification.png")


def facts_of(rows: list[dict[str, Any]], duration: float) -> dict[str, Any]:
    """What the trials say, and each of them."""
    return {
        "duration": duration,
        "trials": len(rows),
        "seconds": float(np.median([row["seconds"] for row in rows])),
        "parameters": [summary(rows, k) for k in range(len(UNKNOWN))],
        "rows": rows,
    }


def one_throw(scene: Scene, resting: np.ndarray, settings: Settings, random: np.random.Generator) -> dict[str, Any]:
    """Simulate a robot that differs, add noise, identify it."""
    true = np.exp(random.uniform(-1, 1, len(UNKNOWN)) * np.log(1 + WRONG_BY))
    robot = changed(scene, UNKNOWN, np.log(true) / [each.spread for each in UNKNOWN])
    heading, spin = random.uniform(0, 2 * np.pi), random.normal(0, 1, 3)
    throw = settings.speed * np.array([np.cos(heading), np.sin(heading), 0])
    start = throw + np.cross(spin, resting - resting.mean(0)) + random.normal(0, 0.2, resting.shape)
    fine = SolverOptions("rk4", dt=settings.dt / 2)
    moved = simulate(
        robot, settings.duration, options=fine, frame_rate=FRAME_RATE, positions=resting, velocities=start
    )  # fmt: skip
    seen = np.asarray(moved.positions) + random.normal(0, NOISE, moved.positions.shape)
    began = time.perf_counter()
    motion = measured_motion(
        scene,
        np.asarray(moved.times),
        seen.reshape(len(seen), -1),
        NOISE,
        SeenPositions(),
        Starts(seen, spread=(5e-3, 0.5)),
        options=SolverOptions("rk4", dt=settings.dt),
    )
    found = identify(scene, UNKNOWN, motion)
    return {
        "true": true,
        "identified": [each.value for each in found.estimates],
        "standard_error": [each.standard_error for each in found.estimates],
        "inside": [each.interval is not None and each.interval[0] < t < each.interval[1]
                   for each, t in zip(found.estimates, true)],
        "misfit": found.misfit,
        "steps": found.steps,
        "seconds": time.perf_counter() - began,
    }  # fmt: skip


def summary(rows: list[dict], k: int) -> dict[str, Any]:
    """Of one parameter over all trials."""
    told = [row for row in rows if row["identified"][k] is not None]
    errors = [abs(row["identified"][k] / row["true"][k] - 1) for row in told]
    return {
        "name": UNKNOWN[k].name,
        "told": len(told),
        "median": float(np.median(errors)) if errors else None,
        "largest": max(errors, default=np.nan),
        "within_2_percent": sum(error < 0.02 for error in errors),
        "covered": sum(row["inside"][k] for row in rows),
        "standard_error": float(np.median([row["standard_error"][k] for row in rows])),
    }


def figure(rows: list[dict]) -> Figure:
    """Identified less true, with 95 % intervals, trial by trial."""
    chart = Figure(figsize=(9, 3), layout="constrained")
    for k, axes in enumerate(chart.subplots(1, len(UNKNOWN), sharey=True)):
        for trial, row in enumerate(rows):
            if row["identified"][k] is not None:
                off = 100 * (row["identified"][k] / row["true"][k] - 1)
                half = 196 * row["standard_error"][k] / row["true"][k]
                axes.errorbar(off, trial, xerr=half, fmt=".", color="C0" if row["inside"][k] else "C1", linewidth=1)
        axes.axvline(0, color="black", linewidth=0.8)
        axes.set(title=UNKNOWN[k].path.removeprefix("structure.").replace(".", "\n", 1), xlabel="off by (%)")
    chart.axes[0].set_ylabel("throw")
    return chart


if __name__ == "__main__":
    run(main, Settings)

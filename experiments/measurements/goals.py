"""A goal 10 m away, across a slope of 5 degrees or on bumps, on a robot that the controller does not know exactly.

The robot is the contact twin, with springs for struts and ground, and its friction is off by up to 30 %. The controller
plans on the exact model with nominal friction, knows the slope but not the bumps, and sees the state of the nodes
without error. Beside it: the gait as it is, and the gait with feedback, neither of which knows of the goal.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from jaxgrity.cli.script import measured, run

import jax
import jax.numpy as jnp
import numpy as np
from basin import drops
from matplotlib.figure import Figure
from obstacles import bounded
from tqdm import tqdm

from jaxgrity import as_dtype, bumps, contact_twin, load_gait, load_scene
from jaxgrity.control import (
    REACHED,
    PhaseLocked,
    Plant,
    Sampling,
    Steered,
    Task,
    centre_offsets,
    drive,
    ground_of,
    lead_to,
    loop_start,
)
from jaxgrity.io.files import save_json
from jaxgrity.report import plot

SLOPE = np.radians(5.0)
GOAL = np.array([0.0, 10.0])
"""m; the slope falls towards +x"""
UNKNOWN = 0.3
"""share of the friction, within which it is drawn"""
PATIENCE = 60.0
"""s, after which a trial has failed"""
BUMPS, LENGTH = 0.02, 0.8
"""m, standard deviation and length of bumps; every trial has its own"""


@dataclass
class Settings:
    ground: Literal["slope", "bumps"] = "slope"
    trials: int = 20
    samples: int = 64
    """rollouts of the model for each choice"""
    seed: int = 0
    """of starts, friction and samples"""
    out: Path = Path("results/goals")
    """folder for goals_GROUND.json and its figure"""
    quick: bool = False
    """one trial of 2 s, on the exact model, without the slope"""


class Trial(NamedTuple):
    """One robot that the controller does not know exactly, and what it knows."""

    robot: Plant
    model: Plant
    start: tuple[np.ndarray, np.ndarray]
    """q, m, and v, m/s"""
    friction: float
    """times nominal"""


def main(settings: Settings) -> None:
    sampling = Sampling(samples=8 if settings.quick else settings.samples, patience=2.0 if settings.quick else PATIENCE)
    paths: list[np.ndarray] = []
    rows: list[dict[str, Any]] = []
    name, count = f"goals_{settings.ground}", 1 if settings.quick else settings.trials
    for number, trial in enumerate(tqdm(drawn_trials(settings, count), total=count, unit="trial")):
        found = lead_to(trial.robot, trial.model, feedback(), GOAL, start=trial.start, seed=number, sampling=sampling)
        paths.append(found.path[:, :2])
        row = {
            "friction": trial.friction,
            "reached": found.reached,
            "seconds": found.seconds,
            "real_time": found.real_time,
            "closest": float(np.linalg.norm(found.path[:, :2] - GOAL, axis=1).min()),
        }
        rows.append(row | _blind(trial, sampling.patience))
        told = {"goal": GOAL.tolist(), "ground": settings.ground, "patience": PATIENCE, "within": REACHED}
        save_json(settings.out / f"{name}.json", {**measured(), **told, "sampling": sampling._asdict(), "rows": rows})
    plot.save(figure(paths, settings.ground), settings.out / f"{name}.png")
    print(f"reached in {sum(row['reached'] for row in rows)} of {len(rows)} trials; wrote {settings.out}/")


def drawn_trials(settings: Settings, count: int) -> Iterator[Trial]:
    """Starts, friction and bumps, drawn by the seed."""
    scene = load_scene("exact")
    if settings.ground == "slope" and not settings.quick:
        scene = ground_of(Task("uphill", incline=SLOPE), scene, seed=0)
    model = bounded(scene)
    twin = model if settings.quick else bounded(contact_twin(scene))
    draw = np.random.default_rng(settings.seed)
    for number in range(count):
        factor = 1 + draw.uniform(-UNKNOWN, UNKNOWN)
        robot = _with_friction(twin, factor)
        (q,), (v,) = drops(scene, 1, settings.seed + number)
        above = np.tan(SLOPE) * np.abs(q[:, 0]).max() + 0.02
        if settings.ground == "bumps":
            robot, above = _on_bumps(robot, settings.seed + number), above + 4 * BUMPS
        yield Trial(robot, model, (q + np.array([0, 0, above]), v), factor)


def feedback() -> Steered:
    """The gait with feedback, going straight on."""
    scene, gait = load_scene("exact"), load_gait("lasting")
    return as_dtype(Steered(PhaseLocked(gait), np.array(0.0), centre_offsets(scene.structure, gait.members)), "float32")


def _with_friction(plant: Plant, factor: float) -> Plant:
    friction = jax.tree.map(lambda x: x, plant.scene.friction)
    friction = replace(friction, mu=friction.mu * factor)
    return replace(plant, scene=replace(plant.scene, friction=friction))


def _on_bumps(plant: Plant, seed: int) -> Plant:
    """The same robot on ground that no controller knows."""
    ground = replace(plant.scene.ground, incline=0.0, surface=as_dtype(bumps(BUMPS, LENGTH, seed), "float32"))
    return replace(plant, scene=replace(plant.scene, ground=ground))


def _blind(trial: Trial, duration: float) -> dict[str, bool]:
    """Whether the same robot passes the goal by chance, without and with feedback that does not know of it."""
    found = {}
    for name, gains in (("open_loop", 0.0), ("feedback", 1.0)):
        straight = feedback()
        locked = replace(straight.policy, gains=straight.policy.gains * jnp.float32(gains))
        policy = replace(straight, policy=locked)
        loop = loop_start(trial.robot, policy, jax.random.key(0), trial.start)
        path = np.asarray(drive(trial.robot, policy, loop, 10, round(10 * duration)).path)[:, :2]
        found[name] = bool((np.linalg.norm(path - GOAL, axis=1) < REACHED).any())
    return found


@plot.styled
def figure(paths: list[np.ndarray], ground: str) -> Figure:
    """The paths of all trials, from above."""
    chart = Figure(figsize=(6, 3.8), layout="constrained")
    axes = chart.subplots()
    for path in paths:
        axes.plot(path[:, 1], path[:, 0], linewidth=0.9, alpha=0.8)
    axes.plot(*GOAL[::-1], "o", markersize=9, markerfacecolor="none", color="black")
    axes.annotate("goal", GOAL[::-1], textcoords="offset points", xytext=(8, 8))
    across, downhill = ("y, across the slope (m)", "x, downhill (m)") if ground == "slope" else ("y (m)", "x (m)")
    axes.set(xlabel=across, ylabel=downhill, aspect="equal")
    axes.invert_yaxis()
    return chart


if __name__ == "__main__":
    run(main, Settings)

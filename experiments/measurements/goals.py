"""A goal 10 m away, across a slope of 5 degrees or on bumps, on a robot that the controller does not know exactly.

The robot is the contact twin, with springs for struts and ground, and its friction is off by up to 30 %. The controller
plans on the exact model with nominal friction, knows the slope but not the bumps, and sees the state of the nodes
without error. Beside it: the gait as it is, and the gait with feedback, neither of which knows of the goal.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from jaxgrity.cli.script import measured, run

import jax
import jax.numpy as jnp
import numpy as np
from basin import drops
from matplotlib.figure import Figure
from obstacles import bounded
from tqdm import tqdm

from jaxgrity import (
    REACHED,
    Journey,
    PhaseLocked,
    Plant,
    Sampling,
    Steered,
    Task,
    as_dtype,
    bumps,
    centre_offsets,
    contact_twin,
    drive,
    ground_of,
    lead_to,
    load_gait,
    load_scene,
    loop_start,
    plot,
)
from jaxgrity.io.files import save_json

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


def main(settings: Settings) -> None:
    model_scene = load_scene("exact")
    if settings.ground == "slope" and not settings.quick:
        model_scene = ground_of(Task("uphill", incline=SLOPE), model_scene, seed=0)
    gait = load_gait("lasting")
    model = bounded(model_scene)
    twin = model if settings.quick else bounded(contact_twin(model_scene))
    trials = 1 if settings.quick else settings.trials
    sampling = Sampling(samples=8 if settings.quick else settings.samples, patience=2.0 if settings.quick else PATIENCE)
    offsets = centre_offsets(model_scene.structure, gait.members)
    feedback = as_dtype(Steered(PhaseLocked(gait), np.array(0.0), offsets), "float32")
    draw = np.random.default_rng(settings.seed)
    paths: list[np.ndarray] = []
    rows: list[dict[str, Any]] = []
    name = f"goals_{settings.ground}"
    for trial in tqdm(range(trials), unit="trial"):
        factor = 1 + draw.uniform(-UNKNOWN, UNKNOWN)
        q, v = drops(model_scene, 1, settings.seed + trial)
        start = q[0] + np.array([0, 0, np.tan(SLOPE) * np.abs(q[0][:, 0]).max() + 0.02]), v[0]
        robot = _with_friction(twin, factor)
        if settings.ground == "bumps":
            robot, start = _on_bumps(robot, settings.seed + trial), (start[0] + np.array([0, 0, 4 * BUMPS]), start[1])
        found = lead_to(robot, model, feedback, GOAL, start=start, seed=trial, sampling=sampling)
        paths.append(found.path[:, :2])
        row = {"friction": factor, "reached": found.reached, "seconds": found.seconds, "real_time": found.real_time}
        rows.append(row | {"closest": _closest(found)} | _blind(robot, feedback, start, sampling.patience))
        told = {"goal": GOAL.tolist(), "ground": settings.ground, "patience": PATIENCE, "within": REACHED}
        save_json(settings.out / f"{name}.json", {**measured(), **told, "sampling": sampling._asdict(), "rows": rows})
    plot.save(figure(paths, settings.ground), settings.out / f"{name}.png")
    print(f"reached in {sum(row['reached'] for row in rows)} of {len(rows)} trials; wrote {settings.out}/")


def _with_friction(plant: Plant, factor: float) -> Plant:
    friction = jax.tree.map(lambda x: x, plant.scene.friction)
    friction = replace(friction, mu=friction.mu * factor)
    return replace(plant, scene=replace(plant.scene, friction=friction))


def _on_bumps(plant: Plant, seed: int) -> Plant:
    """The same robot on ground that no controller knows."""
    ground = replace(plant.scene.ground, incline=0.0, surface=as_dtype(bumps(BUMPS, LENGTH, seed), "float32"))
    return replace(plant, scene=replace(plant.scene, ground=ground))


def _closest(journey: Journey) -> float:
    return float(np.linalg.norm(journey.path[:, :2] - GOAL, axis=1).min())


def _blind(robot: Plant, feedback: Steered, start, duration: float) -> dict[str, bool]:
    """Whether the same robot passes the goal by chance, without and with feedback that does not know of it."""
    found = {}
    for name, gains in (("open_loop", 0.0), ("feedback", 1.0)):
        locked = replace(feedback.policy, gains=feedback.policy.gains * jnp.float32(gains))
        policy = replace(feedback, policy=locked)
        loop = loop_start(robot, policy, jax.random.key(0), start)
        path = np.asarray(drive(robot, policy, loop, 10, round(10 * duration)).path)[:, :2]
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

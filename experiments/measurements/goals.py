"""A goal 10 m away, across a slope of 5 degrees or on bumps, on a robot that the controller does not know exactly.

The robot is the contact twin, with springs for struts and ground, and its friction is off by up to 30 %. The controller
plans on the exact model with nominal friction, knows the slope but not the bumps, and sees the state of the nodes
without error. Beside it: the gait as it is, and the gait with feedback, neither of which knows of the goal.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from measurements.driven import bounded, drops, straight_on
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table

from jaxgrity import as_dtype, bumps, contact_twin, load_scene
from jaxgrity.control import REACHED, Plant, Sampling, Task, drive, ground_of, lead_to, loop_start

SLOPE = np.radians(5.0)
GOAL = np.array([0.0, 10.0])
"""m; the slope falls towards +x"""
UNKNOWN = 0.3
"""share of the friction, within which it is drawn"""
BUMPS, LENGTH = 0.02, 0.8
"""m, standard deviation and length of bumps; every trial has its own"""


class Trial(NamedTuple):
    """One robot that the controller does not know exactly, and what it knows."""

    robot: Plant
    model: Plant
    start: tuple[np.ndarray, np.ndarray]
    """q, m, and v, m/s"""


@measurement(
    page="control.md",
    quick={"trials": 1, "samples": 8, "patience": 2.0, "twin": False},
    drawn=("x", "y"),
    raw=("rows",),
)
def goals(
    ground: Literal["slope", "bumps"],
    trials: int = 20,
    samples: int = 64,
    patience: float = 60.0,
    twin: bool = True,
    seed: int = 0,
) -> Iterator[Record]:
    """A row for each trial; how many reached the goal, how soon, and how the controller looked ahead.

    Args:
        ground: under the robot
        trials: with starts, friction and bumps of their own
        samples: rollouts of the model for each choice
        patience: s, after which a trial has failed
        twin: whether the robot is the contact twin, and not the model itself
        seed: of starts, friction and samples
    """
    usual, rows = Sampling(samples=samples, patience=patience), []
    for number, trial in enumerate(drawn_trials(ground, trials, twin, seed)):
        sampling = usual._replace(seed=number)
        found = lead_to(trial.robot, trial.model, straight_on(), GOAL, start=trial.start, sampling=sampling)
        path = found.path[::10, :2]
        told = {name: getattr(found, name) for name in ("reached", "seconds", "real_time")}
        rows.append({"path": path} | told | blind(trial, patience))
        yield rows[-1]
    times = [row["seconds"] for row in rows if row["reached"]]
    return {
        "patience": patience,
        "within": REACHED,
        "sampling": {name: getattr(usual, name) for name in ("samples", "horizon", "interval")},
        "trials": len(rows),
        **{name: sum(row[name] for row in rows) for name in ("reached", "feedback", "open_loop")},
        "seconds": float(np.median(times)) if times else None,
        "real_time": float(np.median([row["real_time"] for row in rows])),
        # of all trials, with a gap after each
        **dict(zip("xy", np.concatenate([np.r_[row["path"], [[np.nan] * 2]] for row in rows]).T)),
        "ground": ground,
    }


@goals.table
def words(record: Record) -> str:
    """In how many trials the goal was reached, and how soon."""
    sampling = record["sampling"]
    looked, often = (
        f"{sampling['samples']} rollouts of {sampling['horizon']:g} s",
        sampling["interval"],
    )
    median = "" if record["seconds"] is None else f", in {record['seconds']:.0f} s (median)"
    rows = [
        [
            f"within {record['within']:g} m of the goal, in at most {record['patience']:.0f} s",
            f"{record['reached']} of {record['trials']} trials{median}",
        ],
        [
            f"time of a choice from {looked}",
            f"{1e3 * often / record['real_time']:.0f} ms of the {1e3 * often:.0f} ms available",
        ],
    ]
    return table(["led by a model with nominal friction", "measured"], rows)


def drawn_trials(ground: str, count: int, twin: bool, seed: int) -> Iterator[Trial]:
    """Starts, friction and bumps, drawn by the seed."""
    scene = load_scene("exact")
    if ground == "slope":
        scene = ground_of(Task("uphill", incline=SLOPE), scene, seed=0)
    model = bounded(scene)
    nominal = bounded(contact_twin(scene)) if twin else model
    draw = np.random.default_rng(seed)
    for number in range(count):
        robot = with_friction(nominal, 1 + draw.uniform(-UNKNOWN, UNKNOWN))
        (q,), (v,) = drops(scene, 1, seed + number)
        above = np.tan(SLOPE) * np.abs(q[:, 0]).max() + 0.02
        if ground == "bumps":
            robot, above = on_bumps(robot, seed + number), above + 4 * BUMPS
        yield Trial(robot, model, (q + np.array([0, 0, above]), v))


def with_friction(plant: Plant, factor: float) -> Plant:
    friction = jax.tree.map(lambda x: x, plant.scene.friction)
    friction = replace(friction, mu=friction.mu * factor)
    return replace(plant, scene=replace(plant.scene, friction=friction))


def on_bumps(plant: Plant, seed: int) -> Plant:
    """The same robot on ground that no controller knows."""
    ground = replace(plant.scene.ground, incline=0.0, surface=as_dtype(bumps(BUMPS, LENGTH, seed), "float32"))
    return replace(plant, scene=replace(plant.scene, ground=ground))


def blind(trial: Trial, duration: float) -> dict[str, bool]:
    """Whether the same robot passes the goal by chance, without and with feedback that does not know of it."""
    found = {}
    for name, gains in (("open_loop", 0.0), ("feedback", 1.0)):
        straight = straight_on()
        locked = replace(straight.policy, gains=straight.policy.gains * jnp.float32(gains))
        policy = replace(straight, policy=locked)
        loop = loop_start(trial.robot, policy, jax.random.key(0), trial.start)
        path = np.asarray(drive(trial.robot, policy, loop, 10, round(10 * duration)).path)[:, :2]
        found[name] = bool((np.linalg.norm(path - GOAL, axis=1) < REACHED).any())
    return found


@goals.figure(4.8)
def figure(record: Record, chart: Figure) -> None:
    """The paths of all trials, from above."""
    axes = chart.subplots()
    x, y = (np.array(record[axis], float) for axis in "xy")
    axes.plot(y, x, color="C0", linewidth=0.9, alpha=0.6, label="path of a trial")
    axes.plot(0, 0, "s", markersize=8, color="C1", label="start")
    axes.plot(*GOAL[::-1], "*", markersize=13, color="C2", label="goal")
    across, downhill = (
        ("y, across the slope (m)", "x, downhill (m)") if record["ground"] == "slope" else ("y (m)", "x (m)")
    )
    axes.set(xlabel=across, ylabel=downhill, aspect="equal")
    axes.invert_yaxis()
    width, height = (np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim()))
    chart.set_figheight(7.2 * height / width + 1.4)
    chart.legend(loc="outside lower center", ncols=3)

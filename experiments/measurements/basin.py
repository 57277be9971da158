"""From which drops robots get onto the orbit of a gait: random poses, heights and velocities, on both contact models.

Each robot is turned at random, dropped from up to one body length with a random velocity and spin, and actuated by the
gait as it is. The figure shows the share of robots that roll at the gait's speed, as time passes. In the end their
shapes are compared with those that the orbit goes through, with any symmetric node in the place of each.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from measurements.driven import ENOUGH, PART, drops
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns

from jaxgrity import Differences, Scene, contact_twin, gaits_of, load_gait, load_scene, simulate_population, with_gait
from jaxgrity.orbits import distance_from_orbit, find_orbit

NEAR = 0.05
"""body lengths, by which heights of nodes and distances between them may differ from the orbit's at most"""


@measurement(page="gait_records.md", quick={"robots": 8, "duration": 20.0, "contacts": ("own",)}, drawn=("shares",))
def basin(
    contacts: tuple[str, ...] = ("own", "other"),
    robots: int = 256,
    duration: float = 60.0,
    seed: int = 0,
) -> Iterator[Record]:
    """A row for each contact model.

    Args:
        contacts: contact models
        robots: dropped on each of them
        duration: s
        seed: of the drops
    """
    own = with_gait(load_scene("exact"), load_gait("straight"))
    for contact in contacts:
        scene = own if contact == "own" else contact_twin(own)
        where = "exact" if scene.constrained else "penalty"
        orbit = find_orbit(scene, max(120.0, 2 * duration))
        speeds, ends = dropped(scene, robots, duration, seed)
        rolling = speeds >= ENOUGH * orbit.speed
        row = {"gait": "straight", "contact": where, "own": contact == "own", "speed": orbit.speed, **told(rolling)}
        near = distance_from_orbit(scene, orbit, ends) <= NEAR * orbit.body_length
        yield {**row, "on_the_orbit": float(near.mean()), "shares": rolling.mean(0)}


def told(rolling: np.ndarray) -> dict[str, Any]:
    """Of (robots, parts), whether each rolls in each part of the time."""
    first = np.where(rolling.any(1), rolling.argmax(1), rolling.shape[1])
    return {
        "rolling": float(rolling[:, -1].mean()),
        "rolling_after_15_s": float(rolling[:, int(15.0 / PART) - 1].mean()),
        "median_seconds_until": float(np.median(first) * PART),
    }


def dropped(scene: Scene, robots: int, duration: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(robots, parts), m/s, the speed of each robot in each part of the time, 0 where its rollout failed; (robots,
    nodes, 3), m, where nodes are in the end."""
    assert scene.gait is not None, "a gait of the library"
    q, v = drops(scene, robots, seed)
    gaits = gaits_of(scene.gait, np.repeat(np.asarray(scene.gait.phase)[None], robots, axis=0))
    parts = round(duration / PART)
    outcomes = simulate_population(
        scene, gaits, duration, differences=Differences(positions=q, velocities=v), parts=parts
    )
    moved = np.linalg.norm(np.diff(np.asarray(outcomes.com_path)[:, :, :2], axis=1), axis=2)
    speeds = np.where((np.asarray(outcomes.failure) == 0)[:, None], moved / PART, 0.0)
    return speeds, np.asarray(outcomes.positions, float)


@basin.table
def words(record: Record) -> str:
    """How many robots roll, after a while and in the end."""
    cells = {
        "gait": "{gait}",
        "contact": lambda row: f"{row['contact']}, its own" if row["own"] else row["contact"],
        "robots that roll after 15 s": lambda row: f"{100 * row['rolling_after_15_s']:.0f} %",
        "after a minute": lambda row: f"{100 * row['rolling']:.0f} %",
        "on the orbit after a minute": lambda row: f"{100 * row['on_the_orbit']:.0f} %",
        "median time until they roll": "{median_seconds_until:.0f} s",
    }
    return columns(record["rows"], cells)


@basin.figure(4.2)
def figure(record: Record, chart: Figure) -> None:
    """The share of robots that roll, over time."""
    shares = {f"{row['gait']}, {row['contact']}": np.asarray(row["shares"]) for row in record["rows"]}
    axes = chart.subplots()
    for name, share in shares.items():
        times = PART * np.arange(len(share) + 1)
        axes.stairs(100 * share, times, label=name, baseline=None, linewidth=1.8)
    axes.set(xlabel="time since the drop (s)", ylabel="robots that roll (%)", ylim=(0, 103))
    chart.legend(loc="outside upper center", ncols=2)

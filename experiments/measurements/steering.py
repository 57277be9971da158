"""How a bend steers a robot that feedback keeps rolling, and whether it goes on rolling when the bend is reversed.

Robots that were dropped anyhow roll straight for 20 s, then for 20 s with a bend to the left, and 20 s to the right.
"""

from collections.abc import Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from measurements.driven import ENOUGH, bounded, dropped_loop, drops, straight_on
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns

from jaxgrity import load_scene
from jaxgrity.control import Loop, Plant, Steered, drive, side_by_side

STRETCH, PARTS = 20.0, 8
"""s, of each bend, and parts of equal length of it"""
MEASURED = 4
"""of these parts, the last ones, in which turning and speed are measured"""


@measurement(page="control.md", quick={"bends": (0.1,), "robots": 2})
def steering(
    bends: tuple[float, ...] = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5),
    robots: int = 32,
    seed: int = 0,
) -> Iterator[Record]:
    """A row for each bend.

    Args:
        bends: of the policy
        robots: for each bend
        seed: of the drops
    """
    scene, count, one = load_scene("exact"), len(bends) * robots, straight_on()
    many = side_by_side(bounded(scene), count)
    policy = jax.tree.map(lambda x: jnp.repeat(jnp.asarray(x)[..., None], count, axis=-1), one)
    loop = dropped_loop(many, policy, drops(scene, count, seed))
    each = np.repeat(bends, robots)
    paths = []
    for size in (0 * each, each, -each):
        loop, path = stretch(many, replace(policy, bend=jnp.asarray(size, jnp.float32)), loop)
        paths.append(path)
    speeds, turns = zip(*(told(path) for path in paths))
    straight = {"turning": float(np.median(turns[0])), "speed": float(np.median(speeds[0]))}
    yield {"bend": 0.0, **straight, "turning_spread": float(turns[0].std())}
    for k, bend in enumerate(bends):
        own = slice(k * robots, (k + 1) * robots)
        # what turns to the right counts as the image of what turns to the left
        both = np.concatenate([turns[1][own], -turns[2][own]])
        went_on = speeds[2][own] >= ENOUGH * np.median(speeds[1][own])
        found = {"turning": float(np.median(both)), "turning_spread": float(both.std()), "went_on": went_on.mean()}
        yield {"bend": bend, "speed": float(np.median(speeds[1][own])), **found}


def stretch(many: Plant, policy: Steered, loop: Loop) -> tuple[Loop, np.ndarray]:
    """Roll on; (parts + 1, 2, robots), m."""
    there = drive(many, policy, loop, round(STRETCH / PARTS / many.period), PARTS, each=True)
    return there.end, np.asarray(there.path, float)[:, :2]


def told(path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(robots,), speed, m/s, and turning, rad/s, to the left positive, in the last parts of a stretch."""
    moved = np.diff(path, axis=0)[-MEASURED:]
    heading = np.unwrap(np.arctan2(moved[:, 1], moved[:, 0]), axis=0)
    part = STRETCH / PARTS
    return np.linalg.norm(moved, axis=1).mean(0) / part, (heading[-1] - heading[0]) / part / (MEASURED - 1)


@steering.table
def words(record: Record) -> str:
    """How fast robots turn, and how many go on."""
    cells = {
        "bend": "{bend:g}",
        "turning, median (standard deviation)": lambda row: (
            f"{round(np.degrees(row['turning']), 1) + 0.0:.1f} ({np.degrees(row['turning_spread']):.1f}) °/s"
        ),
        "speed": "{speed:.2f} m/s",
        "nearly as fast to the right": lambda row: f"{100 * row['went_on']:.0f} %" if "went_on" in row else "-",
    }
    return columns(record["rows"], cells)


@steering.figure(3.4)
def figure(record: Record, chart: Figure) -> None:
    """Turning and speed against the bend."""
    rows = record["rows"]
    bends = [row["bend"] for row in rows]
    left, right = chart.subplots(1, 2)
    spread = [np.degrees(row["turning_spread"]) for row in rows]
    left.errorbar(bends, [np.degrees(row["turning"]) for row in rows], spread, fmt="o-", capsize=2)
    left.set(xlabel="bend (-1 to 1)", ylabel="turning (°/s): median\nand standard deviation")
    right.plot(bends, [row["speed"] for row in rows], "o-")
    right.set(xlabel="bend (-1 to 1)", ylabel="speed (m/s)", ylim=(0, None))

"""Whether robots go on rolling when their gait is exchanged for another, at once or little by little, and back again.

Robots that were dropped anyhow, and whose friction is off by up to 25 %, roll with `sure_footed` feedback. Then the
commands of another gait take the place of its own: one that is slower, smaller, faster, or that turns to the left or,
as its mirror image, to the right. Both gaits' clocks run on side by side, and for a while each member gets a mean of
what both ask for. Beside it: robots that use the other gait from the drop on.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from measurements.driven import ENOUGH, bounded, dropped_loop, drops
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table

from jaxgrity import Differences, load_gait, load_scene
from jaxgrity.control import Blend, Loop, PhaseLocked, Plant, drive, gait_choices, side_by_side, sure_footed
from jaxgrity.model import image, symmetries

SETTLING, STRETCH, LAST = 20.0, 40.0, 10.0
"""s, before the exchange, from its beginning on, and of that the last ones, in which speed is measured"""
PART = 0.5
"""s, in which the shares of both gaits stay"""
FACTORS = {
    "40 % of the frequency": (1.0, 0.4),
    "60 % of the frequency": (1.0, 0.6),
    "80 % of the frequency": (1.0, 0.8),
    "110 % of the frequency": (1.0, 1.1),
    "80 % of the amplitude": (0.8, 1.0),
}
"""of the frequency and the amplitude"""
LEFT, RIGHT = "left", "left, mirrored"
UNKNOWN = 0.25
"""share of the friction, within which it is drawn"""


@measurement(page="control.md", quick={"robots": 2, "over": (0.0,)})
def transitions(robots: int = 64, over: tuple[float, ...] = (0.0, 2.0, 5.0), seed: int = 0) -> Iterator[Record]:
    """A row for each gait and each way to exchange it.

    Args:
        robots: for each of them
        over: s, in which the gaits are exchanged; 0: at once
        seed: of the drops
    """
    scene, names = load_scene("exact"), (*FACTORS, LEFT, RIGHT)
    cases = [(name, seconds) for name in names for seconds in over]
    count = len(cases) * robots
    friction = 1 + np.random.default_rng(seed).uniform(-UNKNOWN, UNKNOWN, robots)
    many = side_by_side(bounded(scene), count, Differences(friction=np.tile(friction, len(cases))))
    policy = both(scene, [name for name, _ in cases for _ in range(robots)])
    loop = dropped_loop(many, policy, drops(scene, robots, seed), groups=len(cases))
    shares = exchanged(np.repeat([seconds for _, seconds in cases], robots))
    speeds = {}
    _, speeds["anew"] = stretch(many, policy, loop, np.ones_like(shares))
    loop, speeds["before"] = stretch(many, policy, loop, np.zeros((round(SETTLING / PART), count)))
    loop, speeds["after"] = stretch(many, policy, loop, shares)
    _, speeds["back"] = stretch(many, policy, loop, 1 - shares)
    yield from told(cases, {name: own.reshape(len(cases), -1) for name, own in speeds.items()})


def both(scene, names: list[str]) -> Blend:
    """Each robot's own pair of gaits."""
    gait = load_gait("lasting")
    gaits = {"lasting": sure_footed(gait)}
    for name, (larger, faster) in FACTORS.items():
        gaits[name] = sure_footed(replace(gait, amplitude=larger * gait.amplitude, frequency=faster * gait.frequency))
    mirror = next(one for one in symmetries(scene.structure) if np.linalg.det(one.matrix) < 0)
    gaits[LEFT] = PhaseLocked(load_gait("left"), np.zeros((2, 2)))
    gaits[RIGHT] = PhaseLocked(image(load_gait("left"), mirror), np.zeros((2, 2)))
    choices = gait_choices(scene.structure, gaits)
    one, other = (
        choices.chosen(np.array([choices.names.index(name) for name in own]), np.zeros(len(names))).policy
        for own in (["lasting"] * len(names), names)
    )
    return Blend(one, other, jnp.zeros(len(names), jnp.float32))


def exchanged(over: np.ndarray) -> np.ndarray:
    """(parts, robots): the other gait's share in each part of a stretch."""
    middle = PART * (np.arange(round(STRETCH / PART)) + 0.5)[:, None]
    return np.clip(middle / np.maximum(over, 1e-9), 0, 1)


def stretch(many: Plant, policy: Blend, loop: Loop, shares: np.ndarray) -> tuple[Loop, np.ndarray]:
    """Roll on with these shares, (parts, robots); (robots,), m/s, in the last seconds, 0 where a rollout failed."""
    ticks, path = round(PART / many.period), []
    for share in shares:
        there = drive(many, replace(policy, share=jnp.asarray(share, jnp.float32)), loop, ticks, each=True)
        loop = there.end
        path.append(np.asarray(there.path)[-1, :2])
    moved = np.diff(np.array(path)[-round(LAST / PART) - 1 :], axis=0)
    # in parts of 2.5 s, so that a path that bends counts
    whole = moved.reshape(-1, 5, *moved.shape[1:]).sum(1)
    speed = np.linalg.norm(whole, axis=1).sum(0) / LAST
    return loop, np.where(np.asarray(there.failure) == 0, speed, 0.0)


def told(cases: list[tuple[str, float]], speeds: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """Of (cases, robots): among those that rolled before, how many went on with the other gait, and then came back.

    A robot goes on if it is nearly as fast as those in the middle that have used the gait from the drop on.
    """
    rows, own = [], float(np.median(speeds["before"]))
    for k, (name, over) in enumerate(cases):
        rolled = speeds["before"][k] >= ENOUGH * own
        expected = float(np.median(speeds["anew"][k]))
        went_on = speeds["after"][k] >= ENOUGH * expected
        rows.append(
            {
                "gait": name,
                "over": over,
                "expected": expected,
                "anew": float(np.mean(speeds["anew"][k] >= ENOUGH * expected)),
                "went_on": float(went_on[rolled].mean()) if rolled.any() else 0.0,
                "came_back": float((speeds["back"][k] >= ENOUGH * own)[rolled].mean()) if rolled.any() else 0.0,
            }
        )
    return rows


@transitions.table
def words(record: Record) -> str:
    """How many robots go on, and come back."""
    over = list(dict.fromkeys(row["over"] for row in record["rows"]))
    found = {(row["gait"], row["over"]): row for row in record["rows"]}
    rows = []
    for name in dict.fromkeys(row["gait"] for row in record["rows"]):
        own = [found[name, seconds] for seconds in over]
        shares = [f"{100 * share:.0f}" for share in (own[0]["anew"], *(row["went_on"] for row in own))]
        back = min(row["came_back"] for row in own)
        rows.append([name, f"{own[0]['expected']:.2f}", *shares, f"{100 * back:.0f}"])
    switched = ["go on, switched " + ("at once, %" if seconds == 0 else f"over {seconds:g} s, %") for seconds in over]
    head = ["the other gait", "its speed, m/s", "fast enough after a drop, %", *switched, "come back, at least, %"]
    return table(head, rows)


@transitions.figure(4.4)
def figure(record: Record, chart: Figure) -> None:
    """The share of robots that go on after each exchange, and after that back."""
    rows = record["rows"]
    names, over = list(dict.fromkeys(row["gait"] for row in rows)), list(dict.fromkeys(row["over"] for row in rows))
    panes = chart.subplots(1, 2, sharey=True)
    shown = (
        ("went_on", "to the other gait", "robots that go on (%)"),
        ("came_back", "and back", "robots that come back (%)"),
    )
    for axes, (what, title, xlabel) in zip(panes, shown):
        for k, seconds in enumerate(over):
            own = [100 * row[what] for row in rows if row["over"] == seconds]
            places = np.arange(len(names)) + 0.27 * (k - (len(over) - 1) / 2)
            axes.barh(places, own, height=0.25, label="at once" if seconds == 0 else f"over {seconds:g} s")
        axes.set_yticks(range(len(names)), names)
        axes.set(title=title, xlabel=xlabel, xlim=(0, 103))
        axes.grid(axis="y", visible=False)
    panes[0].invert_yaxis()
    chart.legend(*panes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(over))

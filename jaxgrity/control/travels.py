"""Travel round obstacles: many robots at once, each led by a model's predictions of many ways.

A gait's effect depends on the robot's orientation. So several robots of the model, with different friction, try each
way from the measured pose. The way that clears all obstacles and leaves the shortest rest is taken.
"""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.choices import GaitChoices
from jaxgrity.control.closed_loop import Loop, drive, failures, loop_start, places, roll_on, taken_over
from jaxgrity.control.obstacles import SAME_REACH, WayMap, gap, reach_of, room
from jaxgrity.control.plant import Plant, check_model, check_one, side_by_side, whole_number
from jaxgrity.control.steering import clock_moved
from jaxgrity.control.tasks import REACHED, at_size
from jaxgrity.core.arguments import is_count
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, State
from jaxgrity.model.scene import Scene
from jaxgrity.populations.uncertainty import Differences
from jaxgrity.stepping.dynamics import centre_of_mass

TOUCHING = 100.0
"""Length added to a way for each metre by which the robot comes too close to an obstacle, m."""
ARRIVING = 1000.0
"""Number taken off the seconds of a way that reaches the goal and touches nothing: it beats all that do not."""
MARGIN = 0.1
"""Default distance to be kept from obstacles beyond the reach, m for a robot of one metre."""
LOOKS = 10
"""Number of times per second at which planned ways are compared with obstacles."""


class Foresight(NamedTuple):
    """Settings of the trials of ways."""

    samples: int = 24
    """ways to go on, for each robot; the first is as before, the second is rest"""
    friction: tuple[float, ...] = (0.75, 1.0, 1.25)
    """times nominal: the robots of the model that try each of them"""
    horizon: float = 3.0
    """s, for which they do"""
    interval: float = 0.75
    """s, from one choice to the next"""
    widest: float = 0.6
    """the largest bend, see `Steered`"""
    usual: float = 0.6
    """share of the samples that use the first gait; the others use any, the first and all images included"""
    reach: float | None = None
    """m, from the robot's centre of mass to its farthest node; None: that of the maps"""
    margin: float | None = None
    """m, to be kept from obstacles beside that; None: `MARGIN` at the size of the robot"""
    patience: float = 60.0
    """s, after which the goal is given up"""
    within: float | None = None
    """m, from the goal, where it counts as reached; None: `REACHED` at the size of the robot"""
    seed: int = 0
    """of the samples, and of the sensors' noise"""


FORESIGHT = Foresight()
"""Foresight that a planner uses by default."""


class Travels(NamedTuple):
    """The robots' paths and arrivals."""

    nodes: np.ndarray
    """(frames, nodes, 3, robots), m, once in a control period"""
    path: np.ndarray
    """(frames, 3, robots), m, the centre of mass"""
    reached: np.ndarray
    """(robots,): whether the goal was reached, in time, without touching anything and without a failure"""
    arrived: np.ndarray
    """(robots,), frames until the goal was reached, the rollout failed or the time was up"""
    gap: np.ndarray
    """(robots,), m, smallest distance from an obstacle until then, seen from above; negative: the robot touched one"""
    gaits: np.ndarray
    """(choices, robots), rows of the gaits to choose from"""
    spread: np.ndarray
    """(choices, robots), m, standard deviation of the place at the horizon, of the chosen way"""
    surprise: np.ndarray
    """(choices, robots), m, from the place at the next choice as predicted to the real one"""
    seconds: float
    """median time of a choice for all robots, without compilation where there were several choices"""


class _Fate(NamedTuple):
    path: np.ndarray
    """(looks, 2, robots, samples, copies), m"""
    failed: np.ndarray
    """(robots, samples, copies)"""


@typed
def travel(
    robots: Plant,
    model: Plant,
    gaits: GaitChoices,
    maps: Sequence[WayMap],
    *,
    start: State | None = None,
    foresight: Foresight = FORESIGHT,
    on_choice: Callable[[int], object] | None = None,
) -> Travels:
    """Lead many robots, each through its own field to its own goal, all in one population.

    Args:
        robots: the robots, as from `side_by_side`.
        model: the controller's model of each, as from `plant_of`, with the same members and period.
        gaits: the choices.
        maps: one for each robot, as from `way_map`: its goal, its obstacles, and the way round them.
        start: q and v with the robots last; by default the scene's.
        foresight: settings of the trials.
        on_choice: called with the number of each choice.

    Returns:
        Paths, and which robots reached their goals without a touch.

    Raises:
        InputError: robots, policy, model and maps that do not fit, times that are no multiples of each other, or
            invalid settings.
    """
    foresight = sized(foresight, model.scene)
    (ticks, looks, choices), count = _counts(robots, model, maps, foresight), len(maps)
    draw, copies = np.random.default_rng(foresight.seed), len(foresight.friction)
    lanes = count * foresight.samples * copies
    many = side_by_side(model, lanes, Differences(friction=np.tile(foresight.friction, count * foresight.samples)))
    rows, bends = np.zeros(count, int), np.zeros(count)
    loop = loop_start(robots, gaits.chosen(rows, bends), jax.random.key(foresight.seed), start, each=True)
    kept, path = [np.asarray(loop.plant.motion[0])[None]], [np.asarray(places(robots, loop))[None]]
    said: list[tuple[np.ndarray, ...]] = []
    spent, over = [], np.zeros(count, bool)
    for choice in range(choices):
        began = time.perf_counter()
        tried = _drawn(draw, gaits, rows, bends, foresight)
        fate = _foreseen(many, gaits, loop, tried, looks)
        costs = [way_costs(fate.path[:, :, k], fate.failed[k], way, foresight) for k, way in enumerate(maps)]
        best = np.array(costs).argmin(1)
        spent.append(time.perf_counter() - began)
        old = rows
        rows, bends, turns = (x[np.arange(count), best] for x in tried)
        expected, turned = _expected(fate, best, foresight), _with_clock(gaits, loop, old, rows, turns)
        loop, nodes, went = _moved(robots, gaits.chosen(rows, bends), turned, ticks)
        kept.append(np.asarray(nodes))
        path.append(np.asarray(went))
        said.append((rows, expected[1], np.linalg.norm(expected[0] - path[-1][-1, :2], axis=0)))
        over |= _near(path[-1], maps, cast(float, foresight.within)).any(0) | ~np.isfinite(kept[-1]).all((0, 1, 2))
        if on_choice is not None:
            on_choice(choice)
        if over.all():
            break
    chosen, seen = [np.array(x) for x in zip(*said)], (np.concatenate(kept), np.concatenate(path))
    return travels_of(model.scene, seen, maps, chosen, spent, foresight.within)


def sized(foresight: Foresight, scene: Scene) -> Foresight:
    """The foresight with distances for the scene's robot where it has none, m."""
    margin, within = (at_size(*each, scene) for each in ((foresight.margin, MARGIN), (foresight.within, REACHED)))
    return foresight._replace(margin=margin, within=within)


def _counts(robots: Plant, model: Plant, maps: Sequence[WayMap], foresight: Foresight) -> tuple[int, int, int]:
    """Control periods between choices, looks ahead, and choices. Raises `InputError` where they do not fit."""
    if robots.robots is None or robots.robots != len(maps):
        raise InputError(f"maps: {len(maps)} for {robots.robots} robots; expected one for each, of `side_by_side`")
    least, reach = min(way.reach for way in maps), foresight.reach
    needed = max(reach_of(model.scene), 0.0 if reach is None else reach)
    if least < needed * (1 - SAME_REACH):
        raise InputError(f"maps: made for a reach of {least:g} m; expected at least {needed:.3g} m, as the robot has")
    check_model(robots, model)
    check_one(model, "model")
    whole_number("a look", 1 / LOOKS, model.period)
    friction = np.array(foresight.friction, float)
    if not is_count(foresight.samples, 2) or not len(friction) or not (np.isfinite(friction) & (friction >= 0)).all():
        found = f"samples = {foresight.samples}, friction = {foresight.friction}"
        raise InputError(f"{found}: expected at least 2 samples, and factors that are not negative")
    if not (0 <= foresight.widest <= 1 and 0 <= foresight.usual <= 1):
        raise InputError(f"widest = {foresight.widest:g}, usual = {foresight.usual:g}: expected numbers from 0 to 1")
    lengths = np.array([least if reach is None else reach, foresight.margin, foresight.within], float)
    if not ((lengths >= 0).all() and lengths[0] > 0 and lengths[2] > 0):
        found = "reach, margin, within = {:g}, {:g}, {:g} m".format(*lengths)
        raise InputError(f"{found}: expected a positive reach, and a positive distance from the goal")
    ticks = whole_number("interval", foresight.interval, robots.period)
    looks = whole_number("horizon", foresight.horizon, 1 / LOOKS)
    if foresight.horizon < foresight.interval:
        raise InputError(f"horizon = {foresight.horizon:g} s: expected at least the interval, {foresight.interval:g} s")
    return ticks, looks, whole_number("patience", foresight.patience, foresight.interval)


def _drawn(draw: np.random.Generator, gaits: GaitChoices, rows: np.ndarray, bends: np.ndarray, foresight: Foresight):
    """Gaits, bends and jumps of the clock, in turns, (robots, samples) each."""
    shape = (len(rows), foresight.samples)
    usual = draw.uniform(size=shape) < foresight.usual
    chosen = np.where(usual, 0, draw.integers(0, len(gaits.names) - 1, shape))
    bent = draw.uniform(-foresight.widest, foresight.widest, shape) * (draw.uniform(size=shape) < 0.7)
    turns = draw.uniform(0, 1, shape) * (draw.uniform(size=shape) < 0.5)
    chosen[:, 0], bent[:, 0], turns[:, 0] = rows, bends, 0
    chosen[:, 1], bent[:, 1], turns[:, 1] = len(gaits.names) - 1, 0, 0
    return chosen, bent, turns


def _with_clock(gaits: GaitChoices, loop: Loop, old: AnyArray, new: AnyArray, turns: AnyArray) -> Loop:
    """The loop with clocks at the same angle in another gait, after a jump of some turns."""
    frequency = gaits.frequency
    return loop._replace(memory=clock_moved(loop.memory, frequency[old] / frequency[new], turns / frequency[new]))


def _foreseen(many: Plant, gaits: GaitChoices, loop: Loop, tried, looks: int) -> _Fate:
    """The paths of all samples, and which of them fail."""
    count, samples = tried[0].shape
    copies = cast(int, many.robots) // (count * samples)
    rows, bends, turns = (np.repeat(x.ravel(), copies) for x in tried)
    old = np.repeat(tried[0][:, 0], samples * copies)
    path, failed = _tried(many, gaits.chosen(rows, bends), gaits, loop, (old, rows, turns), looks)
    shape = (count, samples, copies)
    return _Fate(np.asarray(path, float).reshape(-1, 2, *shape), np.asarray(failed).reshape(shape))


@eqx.filter_jit
def _tried(many: Plant, policy, gaits: GaitChoices, loop: Loop, clocks, looks: int):
    """(looks, 2, lanes), m, and (lanes,): each lane's places, and whether it fails."""
    each = clocks[0].shape[0] // loop.plant.motion[0].shape[-1]
    ahead = _with_clock(gaits, taken_over(many, loop, each), *clocks)
    there = drive(many, policy, ahead, round(1 / LOOKS / many.period), looks, each=True)
    return there.path[1:, :2], there.failure != 0


@eqx.filter_jit
def _moved(robots: Plant, policy, loop: Loop, ticks: int):
    """The loop after some control periods, and nodes and centres of mass in each; NaN for failed robots."""
    centre = robots.lift(centre_of_mass, ("s", -1))
    kept = lambda state: (state.motion[0], centre(robots.scene, state.motion[0]))  # noqa: E731
    loop, seen = roll_on(robots, policy, loop, ticks, kept, each=True)
    return loop, *(jnp.where(failures(robots, loop) != 0, jnp.nan, x) for x in seen)


def way_costs(path: np.ndarray, failed: np.ndarray, way: WayMap, foresight: Foresight) -> np.ndarray:
    """(samples,), m: the distance to the goal at the horizon, the mean of the copies' mean and worst.

    A sample that arrives clear of obstacles costs its seconds until then, less `ARRIVING`. One too close to an obstacle
    costs `TOUCHING` times the missing distance, wherever it ends. `path` (looks, 2, samples, copies), m; one that
    `failed` (samples, copies) is worse than all others.
    """
    path = np.moveaxis(path, 1, -1)
    failed = failed | ~np.isfinite(path).all((0, -1))
    path = np.where(np.isfinite(path), path, 0.0)
    near = np.linalg.norm(path - way.goal, axis=-1) < cast(float, foresight.within) / 2
    there, first = near.any(0), near.argmax(0)
    reach = way.reach if foresight.reach is None else foresight.reach
    close = np.maximum(reach + cast(float, foresight.margin) - room(way.discs, path), 0)
    before = np.arange(len(path))[:, None, None] <= np.where(there, first, len(path))
    touching = (close * before).max(0)
    arrives = there & (touching == 0)
    worth = np.where(arrives, first / LOOKS - ARRIVING, way.to_go(path[-1]) + TOUCHING * touching)
    worth = np.where(failed, 1e6, worth)
    return np.asarray((worth.mean(-1) + worth.max(-1)) / 2)


def _expected(fate: _Fate, best: np.ndarray, foresight: Foresight) -> tuple[np.ndarray, np.ndarray]:
    """Of the chosen samples: the mean place at the next choice, (2, robots), and the spread at the horizon."""
    own = fate.path[:, :, np.arange(len(best)), best]
    # between two looks where a choice falls there
    when = foresight.interval * LOOKS - 1
    k = min(int(when + 1e-9), len(own) - 2)
    soon = (own[k] + (when - k) * (own[k + 1] - own[k])).mean(-1)
    return soon, np.sqrt(own[-1].var(-1).sum(0))


def _near(path: np.ndarray, maps: Sequence[WayMap], within: float) -> np.ndarray:
    """(frames, robots): whether the centre of mass is at the goal."""
    return np.linalg.norm(path[:, :2] - np.array([way.goal for way in maps]).T, axis=1) < within


def travels_of(
    scene: Scene,
    seen: tuple[np.ndarray, np.ndarray],
    maps: Sequence[WayMap],
    said: list[np.ndarray],
    spent: list[float],
    within: float | None = None,
) -> Travels:
    """The travels of robots from nodes and centres of mass `seen`, (frames, nodes, 3, robots) and (frames, 3, robots),
    NaN after a failure. A goal counts if it was reached before a failure, without a touch."""
    nodes, path = seen
    near, fine = _near(path, maps, at_size(within, REACHED, scene)), np.isfinite(nodes).all((1, 2))
    there = near & np.logical_and.accumulate(fine, axis=0)
    ended = np.where(there.any(0), there.argmax(0), np.where(fine.all(0), len(nodes) - 1, (~fine).argmax(0)))
    gaps = np.array(
        [np.nanmin(gap(way.discs, scene, nodes[: end + 1, ..., k])) for k, (way, end) in enumerate(zip(maps, ended))]
    )
    reached, seconds = there.any(0) & (gaps > 0), float(np.median(spent[1:] or spent))
    rows, spread, surprise = said
    return Travels(nodes, path, reached, ended, gaps, rows, spread, surprise, seconds)

"""Model-predictive control by sampling: a model of the robot tries many ways to go on; the best is taken.

At each choice, robots of a model start from the state of each robot, one or more for each sample (see `samples`). The
robot follows the sample that clears all obstacles and comes closest to the goal, until the next choice. There the rest
of this sample is tried first.
"""

import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import jax
import numpy as np

from jaxgrity.control.choices import Choices, GaitChoices, choices_of
from jaxgrity.control.closed_loop import Loop, loop_start
from jaxgrity.control.learned import Deployed
from jaxgrity.control.obstacles import SAME_REACH, StraightWay, Way, WayMap, gap, reach_of
from jaxgrity.control.plant import Plant, check_model, check_one, scenes_of, side_by_side, whole_number
from jaxgrity.control.samples import Sampled, Sampling, best, between, followed, shifted, sized
from jaxgrity.control.steering import Steered
from jaxgrity.core.arguments import check_index, is_count
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, State
from jaxgrity.model.scene import Scene
from jaxgrity.populations.uncertainty import Differences

USUAL = Sampling()
"""Sampling that a predictive controller uses by default."""


class Journey(NamedTuple):
    """The journeys of robots to their goals. All arrays but `spent` have the robots last; those of one robot, of
    `plant_of`, have no such axis."""

    nodes: np.ndarray
    """(frames, nodes, 3, robots), m, once in a control period, until the last robot has arrived or all time is up"""
    path: np.ndarray
    """(frames, 3, robots), m, the centre of mass"""
    reached: np.ndarray
    """(robots,): whether the goal was reached in time, without touching anything and without a failure"""
    arrived: np.ndarray
    """(robots,), frames until the goal was reached, the rollout failed or the time was up"""
    seconds: np.ndarray
    """(robots,), s, until then"""
    gap: np.ndarray
    """(robots,), m, smallest distance from an obstacle until then, seen from above; negative: the robot touched one"""
    gaits: np.ndarray
    """(choices, robots), rows of the gaits to choose from; 0 where there is one"""
    bends: np.ndarray
    """(choices, robots), the first of each choice"""
    spread: np.ndarray
    """(choices, robots), m, standard deviation of the place at the horizon, of the chosen sample"""
    surprise: np.ndarray
    """(choices, robots), m, from the place at the next choice as predicted to the real one"""
    spent: np.ndarray
    """(choices,), s, that each choice took, for all robots; the first of all compiles"""
    real_time: float
    """seconds between choices per second of a choice, median, without compilation"""


@typed
def lead_to(
    robot: Plant,
    model: Plant,
    policy: Steered | Deployed | GaitChoices,
    goal: AnyArray | WayMap | Sequence,
    *,
    start: State | None = None,
    sampling: Sampling = USUAL,
    on_choice: Callable[[int], object] | None = None,
) -> Journey:
    """Lead robots to their goals, also round obstacles, by the predictions of a model.

    Args:
        robot: one robot, as from `plant_of`, or many, as from `side_by_side`, each of which goes its own way.
        model: the controller's model of each, as from `plant_of`, with the same members and period.
        policy: a gait with feedback, steered; its own goal does not count. Or several gaits, as from `gait_choices`. Or
            a learned policy with a heading, which each bend turns to the left, by half a turn for a bend of 1.
        goal: (2,), m, on ground without obstacles; or the way round obstacles to it, as from `way_map`. For many
            robots one for each.
        start: q and v, for many robots with the robots last; by default the scene's.
        sampling: settings of the look ahead; `CAUTIOUS` suits ways round obstacles.
        on_choice: called with the number of each choice.

    Returns:
        Paths, which robots reached their goals without a touch, and the time per choice.

    Raises:
        InputError: invalid settings, or a goal that is no place. Maps for a smaller robot, or not one for each. A model
            or policy whose members or period differ from the robot's. A policy with neither a bend and a clock nor a
            heading. Times that are no multiples of each other.
    """
    choices = choices_of(policy)
    ways, sampling = _ways(robot, goal), sized(sampling, robot.scene)
    scenes = scenes_of(robot)
    count = _checked(robot, model, choices, ways, sampling, max(map(reach_of, scenes)))
    draw, many = np.random.default_rng(sampling.seed), _trying(model, len(ways), sampling)
    gaits, knots = np.zeros(len(ways), int), np.full((sampling.knots, len(ways)), choices.bend)
    first, key = choices.chosen(_own(robot, gaits), _own(robot, knots[0])), jax.random.key(sampling.seed)
    loop = loop_start(robot, first, key, start, each=robot.robots is not None)
    frames, said, spent, over = [], [], [], np.zeros(len(ways), bool)
    for choice in range(count):
        began = time.perf_counter()
        chosen = best(many, choices, loop, ways, draw, sampling, (gaits, knots))
        spent.append(time.perf_counter() - began)
        loop, (nodes, path) = _moved(robot, choices, loop, gaits, chosen, sampling)
        frames.append([x[bool(choice) :] for x in (nodes, path)])
        said.append((chosen.gaits, (between(sampling) @ chosen.knots)[0], *_told(chosen.path, path[-1], sampling)))
        gaits, knots = chosen.gaits, shifted(chosen.knots, sampling)
        over |= _near(frames[-1][1], ways, sampling).any(0) | ~np.isfinite(nodes).all((0, 1, 2))
        if on_choice is not None:
            on_choice(choice)
        if over.all():
            break
    nodes, path = (np.concatenate(part) for part in zip(*frames))
    reached, arrived, gaps = arrivals(scenes, nodes, path, ways, sampling)
    end, real_time = arrived.max() + 1, sampling.interval / float(np.median(spent[1:] or spent))
    found = nodes[:end], path[:end], reached, arrived, arrived * robot.period, gaps, *map(np.array, zip(*said))
    return Journey._make([*(_own(robot, x) for x in found), np.array(spent), real_time])


def _own(robot: Plant, x: Any) -> Any:
    """An array without the axis of robots where the plant has none."""
    return x[..., 0] if robot.robots is None else x


def _ways(robot: Plant, goal: Any) -> list[Way]:
    """The way of each robot. Raises `InputError` where there is not one for each, or a goal is no place."""
    several = robot.robots is not None and np.iterable(goal) and not isinstance(goal, WayMap)
    goals = list(goal) if several else [goal]
    if len(goals) != (robot.robots or 1):
        raise InputError(f"goal: {len(goals)} for {robot.robots or 1} robots; expected one for each, of `side_by_side`")
    ways: list[Way] = []
    for each in goals:
        if not isinstance(each, WayMap):
            place = np.array(each, float) if np.shape(each) == (2,) else np.full(2, np.nan)
            if not np.isfinite(place).all():
                raise InputError(f"goal = {each}: expected a place (x, y), m, or a `way_map`")
            each = StraightWay(place)
        ways.append(each)
    return ways


def _checked(robot: Plant, model: Plant, choices: Choices, ways: list[Way], sampling: Sampling, reach: float) -> int:
    """The number of choices. Raises `InputError` for another model than the robot's, and for settings that make no
    sense, or do not fit maps, times or the robots' `reach`, m."""
    check_model(robot, model)
    check_one(model, "model")
    check_index("seed", sampling.seed)
    counts = {name: getattr(sampling, name) for name in ("samples", "rounds", "knots", "per_second")}
    if not all(is_count(count, 1) for count in counts.values()) or sampling.samples % sampling.rounds:
        found = ", ".join(f"{name} = {count}" for name, count in counts.items())
        raise InputError(f"{found}: expected whole numbers, at least 1, and as many samples in each round")
    if sampling.drawn == 1 < len(choices.names):
        raise InputError(f"samples = {sampling.samples}: expected at least 2 in each round, to choose from gaits")
    shares = {name: getattr(sampling, name) for name in ("widest", "jumping", "usual")}
    if not all(0 <= share <= 1 for share in shares.values()):
        found = ", ".join(f"{name} = {share:g}" for name, share in shares.items())
        raise InputError(f"{found}: expected numbers from 0 to 1")
    friction = np.array(sampling.friction, float)
    if friction.ndim != 1 or not friction.size or not (np.isfinite(friction) & (friction >= 0)).all():
        raise InputError(f"friction = {sampling.friction}: expected factors that are not negative, at least one")
    within, margin = cast(float, sampling.within), cast(float, sampling.margin)
    if not (0 < within < np.inf and np.isfinite(margin)):
        raise InputError(f"within, margin = {within:g}, {margin:g} m: expected finite numbers, the first above 0")
    least = min((way.reach for way in ways if len(way.discs.radii)), default=np.inf)
    if least + min(margin, 0) < reach * (1 - SAME_REACH):
        found = f"maps: made for a reach of {least:g} m, margin = {margin:g} m"
        raise InputError(f"{found}; expected at least {reach:.3g} m in all, as the robot has")
    whole_number("1 / per_second", 1 / sampling.per_second, model.period)
    whole_number("interval", sampling.interval, model.period)
    whole_number("horizon", sampling.horizon, 1 / sampling.per_second)
    if sampling.horizon < sampling.interval:
        raise InputError(f"horizon = {sampling.horizon:g} s: expected at least the interval, {sampling.interval:g} s")
    return whole_number("patience", sampling.patience, sampling.interval)


def _trying(model: Plant, robots: int, sampling: Sampling) -> Plant:
    """The robots of the model that try all samples of a round."""
    tries = robots * sampling.drawn
    if set(sampling.friction) == {1.0}:
        return side_by_side(model, tries * len(sampling.friction))
    differences = Differences(friction=np.tile(sampling.friction, tries))
    return side_by_side(model, tries * len(sampling.friction), differences)


def _moved(robot: Plant, choices: Choices, loop: Loop, before: np.ndarray, chosen: Sampled, sampling: Sampling):
    """The loop at the next choice; nodes and centres of mass from this one on, (frames, ..., robots), NaN after it for
    robots that fail."""
    clocks = (_own(robot, x) for x in choices.clocks(before, chosen.gaits, chosen.turns))
    loop = loop._replace(memory=choices.moved(loop.memory, *clocks))
    ticks, look = (round(seconds / robot.period) for seconds in (sampling.interval, 1 / sampling.per_second))
    held = math.gcd(ticks, look)
    bends = (between(sampling) @ chosen.knots)[np.arange(0, ticks, held) // look]
    loop, *seen, failed = followed(robot, choices, _own(robot, chosen.gaits), loop, _own(robot, bends), held)
    lanes = [np.asarray(x) if robot.robots is not None else np.asarray(x)[..., None] for x in seen]
    return loop, [np.concatenate([x[:1], np.where(failed, np.nan, x[1:])]) for x in lanes]


def _told(path: np.ndarray, place: np.ndarray, sampling: Sampling) -> tuple[np.ndarray, np.ndarray]:
    """The spread of the chosen samples at the horizon, and the distance of each robot's `place` from that foreseen."""
    # between two looks where a choice falls there
    when = sampling.interval * sampling.per_second
    k = min(int(when + 1e-9), len(path) - 2)
    soon = (path[k] + (when - k) * (path[k + 1] - path[k])).mean(1)
    return np.sqrt(path[-1].var(1).sum(0)), np.linalg.norm(soon - place[:2], axis=0)


def _near(path: np.ndarray, ways: list[Way], sampling: Sampling) -> np.ndarray:
    """(frames, robots): whether the centre of mass is at the goal."""
    goals = np.array([way.goal for way in ways]).T
    return np.linalg.norm(path[:, :2] - goals, axis=1) < cast(float, sampling.within)


def arrivals(scenes: list[Scene], nodes: np.ndarray, path: np.ndarray, ways: list[Way], sampling: Sampling):
    """Whether each robot reached its goal, the frame in which its journey was over, and the smallest gap until then, m.

    `nodes` (frames, nodes, 3, robots) and `path` (frames, 3, robots), m, are NaN after a failure. A goal counts if it
    was reached before a failure, without a touch.
    """
    near, fine = _near(path, ways, sampling), np.isfinite(nodes).all((1, 2))
    there = near & np.logical_and.accumulate(fine, axis=0)
    ended = np.where(there.any(0), there.argmax(0), np.where(fine.all(0), len(nodes) - 1, (~fine).argmax(0)))
    each = enumerate(zip(ways, scenes, ended))
    gaps = [np.nanmin(gap(way.discs, scene, nodes[: end + 1, ..., k])) for k, (way, scene, end) in each]
    return there.any(0) & (np.array(gaps) > 0), ended, np.array(gaps)

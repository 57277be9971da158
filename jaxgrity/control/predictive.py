"""Model-predictive control by sampling: a model of the robot tries many ways of steering; the best is taken.

At each choice the robot's state is the start of one robot of a model for each sample, side by side. Each sample has its
own bends, on straight lines between knots, and its own place in the cycle of its gait. Later rounds draw about the best
of earlier ones. The way that comes closest to the goal is followed until the next choice; there its rest is tried
first.
"""

import time
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.closed_loop import Loop, failures, loop_start, places, roll_on, taken_over
from jaxgrity.control.feedback import PhaseLocked, one_frequency
from jaxgrity.control.plant import Plant, check_model, check_one, side_by_side, whole_number
from jaxgrity.control.steering import Steered, clock_moved
from jaxgrity.control.tasks import REACHED, at_size
from jaxgrity.core.arguments import is_count
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, State


class Sampling(NamedTuple):
    """Settings of the look ahead of a predictive controller."""

    samples: int = 64
    """for each choice, in all its rounds"""
    horizon: float = 3.0
    """s, for which each of them is rolled out"""
    interval: float = 0.5
    """s, from one choice to the next"""
    widest: float = 0.6
    """the largest bend, see `Steered`"""
    jumping: float = 0.5
    """share of the samples of the first round whose clocks jump to another place in the cycle"""
    knots: int = 3
    """bends over the horizon, between which it changes along straight lines; 1: it stays"""
    rounds: int = 2
    """in which samples are drawn, as many in each: the first at random, others about the best before"""
    per_second: int = 10
    """looks at the distance to the goal"""
    patience: float = 60.0
    """s, after which the goal is given up"""
    within: float | None = None
    """m, from the goal, where it counts as reached; None: `REACHED` at the size of the robot"""


ELITE = 8
"""Number of samples of all earlier rounds for each one that guides the next round: the best eighth does."""
NARROW, LATER = 0.3, 0.05
"""Standard deviations of later rounds: as a share of the largest bend, and in turns of the clock."""
USUAL = Sampling()
"""Sampling that a predictive policy uses by default."""


class Journey(NamedTuple):
    """A robot's journey to a goal."""

    path: np.ndarray
    """(looks, 3), m, the centre of mass"""
    reached: bool
    seconds: float
    """until the goal was reached, or the time was up"""
    bends: np.ndarray
    """the first of each choice"""
    real_time: float
    """seconds of the robot per second of a choice, median, without compilation"""
    spent: np.ndarray
    """s, that each choice took; the first of all compiles"""


@typed
def lead_to(
    robot: Plant,
    model: Plant,
    policy: Steered,
    goal: AnyArray,
    *,
    start: State | None = None,
    seed: int = 0,
    sampling: Sampling = USUAL,
) -> Journey:
    """Lead one robot to a goal by the predictions of a model.

    Args:
        robot: the robot, as from `plant_of`.
        model: the controller's model of it, likewise, with the same members and period.
        policy: its policy between choices; the policy's goal does not count.
        goal: (2,), m.
        start: q and v of the robot; by default its scene's.
        seed: of the samples, and of the sensors' noise.
        sampling: settings of the look ahead.

    Returns:
        Its path, whether and when it reached the goal, and the time per choice.

    Raises:
        InputError: invalid settings, or a goal that is no place; a plant of many robots; a model or policy with other
            members than the robot, or another period; a policy that is not `PhaseLocked` at one frequency and
            `Steered`; times that are no multiples of each other.
    """
    check_model(robot, model)
    for plant, name in ((robot, "robot"), (model, "model")):
        check_one(plant, name)
    _check_policy(policy, goal)
    look, looks, choices = _checked(sampling, robot.period)
    within = at_size(sampling.within, REACHED, robot.scene)
    draw, goal, policy = np.random.default_rng(seed), np.asarray(goal, float), replace(policy, goal=None)
    many = side_by_side(model, sampling.samples // sampling.rounds)
    loop = loop_start(robot, policy, jax.random.key(seed), start)
    knots = np.full(sampling.knots, float(policy.bend))
    paths: list[np.ndarray] = []
    bends: list[float] = []
    spent: list[float] = []
    for choice in range(choices):
        began = time.perf_counter()
        knots, turns = best(many, policy, loop, goal, draw, sampling, knots)
        spent.append(time.perf_counter() - began)
        loop = loop._replace(memory=clock_moved(loop.memory, 1.0, turns / _frequency(policy)))
        bend = between(sampling) @ knots
        loop, path, failed = followed(robot, policy, loop, bend[:looks], look)
        path = np.asarray(path)[bool(choice) :]
        bends.append(float(bend[0]))
        near = np.linalg.norm(path[:, :2] - goal, axis=1) < within
        paths.append(path[: near.argmax() + 1] if near.any() else path)
        if near.any() or failed:
            break
        knots = shifted(knots, sampling)
    path = np.concatenate(paths)
    typical = float(np.median(spent[1:] or spent))
    passed = (len(path) - 1) / sampling.per_second
    return Journey(path, bool(near.any()), passed, np.array(bends), sampling.interval / typical, np.array(spent))


def _check_policy(policy: Steered, goal: AnyArray) -> None:
    """Raise `InputError` for a policy without a bend or a clock, and for a goal that is no place."""
    if not (isinstance(policy, Steered) and isinstance(policy.policy, PhaseLocked)):
        found = f"Steered({type(policy.policy).__name__})" if isinstance(policy, Steered) else type(policy).__name__
        raise InputError(f"policy = {found}: expected a Steered(PhaseLocked), whose bend and clock are chosen")
    one_frequency(policy.policy.gait)
    if np.shape(goal) != (2,) or not np.isfinite(np.asarray(goal)).all():
        raise InputError(f"goal = {np.asarray(goal).tolist()}: expected a place (x, y), m")


def _checked(sampling: Sampling, period: float) -> tuple[int, int, int]:
    """Control periods of a look, looks from choice to choice, and choices. Raises `InputError` where times do not
    fit."""
    counts = sampling.samples, sampling.rounds, sampling.knots, sampling.per_second
    if not all(is_count(count, 1) for count in counts) or sampling.samples % sampling.rounds:
        found = f"samples = {counts[0]}, rounds = {counts[1]}, knots = {counts[2]}, per_second = {counts[3]}"
        raise InputError(f"{found}: expected whole numbers, at least 1, and as many samples in each round")
    if not (0 < sampling.widest <= 1 and 0 <= sampling.jumping <= 1):
        found = f"widest = {sampling.widest:g}, jumping = {sampling.jumping:g}"
        raise InputError(f"{found}: expected a bend above 0, and at most 1, and a share")
    if sampling.within is not None and not sampling.within > 0:
        raise InputError(f"within = {sampling.within:g} m: expected a positive distance")
    look = whole_number("1 / per_second", 1 / sampling.per_second, period)
    looks = whole_number("interval", sampling.interval, 1 / sampling.per_second)
    if whole_number("horizon", sampling.horizon, 1 / sampling.per_second) < looks:
        raise InputError(f"horizon = {sampling.horizon:g} s: expected at least the interval, {sampling.interval:g} s")
    return look, looks, whole_number("patience", sampling.patience, sampling.interval)


def between(sampling: Sampling) -> np.ndarray:
    """(looks, knots): the weight of each knot in the middle of each look, on straight lines between knots."""
    looks = round(sampling.horizon * sampling.per_second)
    place = (np.arange(looks) + 0.5) / looks * (sampling.knots - 1)
    return np.maximum(0, 1 - np.abs(place[:, None] - np.arange(sampling.knots)))


def shifted(knots: np.ndarray, sampling: Sampling) -> np.ndarray:
    """The knots one interval later; the last one stays."""
    if len(knots) == 1:
        return knots
    times = np.linspace(0, sampling.horizon, len(knots))
    return np.interp(times + sampling.interval, times, knots)


def _frequency(policy: Steered) -> float:
    return float(np.max(policy.policy.gait.frequency))  # type: ignore[attr-defined]


def best(
    many: Plant,
    policy: Steered,
    loop: Loop,
    goal: np.ndarray,
    draw: np.random.Generator,
    sampling: Sampling,
    before: np.ndarray,
) -> tuple[np.ndarray, float]:
    """The best knots, and the clock's jump in turns; the first sample continues as `before`."""
    count, dtype = sampling.samples // sampling.rounds, many.options.dtype
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for number in range(sampling.rounds):
        if number:
            knots, turns = _about_the_best(found, count, draw, sampling)
        else:
            knots = draw.uniform(-sampling.widest, sampling.widest, (len(before), count))
            turns = draw.uniform(0, 1, count) * (draw.uniform(size=count) < sampling.jumping)
            knots[:, 0], turns[0] = before, 0
        bends, shifts = between(sampling) @ knots, turns / _frequency(policy)
        look = round(1 / sampling.per_second / many.period)
        path, failure = _tried(many, policy, loop, jnp.asarray(bends, dtype), jnp.asarray(shifts, dtype), look)
        cost = costs(np.asarray(path)[:, :2], np.asarray(failure), goal, at_size(sampling.within, REACHED, many.scene))
        found.append((knots, turns, cost))
    knots, turns, cost = (np.concatenate(part, axis=-1) for part in zip(*found))
    first = int(np.argmin(cost))
    return knots[:, first], float(turns[first])


def _about_the_best(found: list, count: int, draw: np.random.Generator, sampling: Sampling):
    """Knots and turns, normally distributed about those of the best of earlier rounds, all with equal weights."""
    knots, turns, cost = (np.concatenate(part, axis=-1) for part in zip(*found))
    elite = np.argsort(cost, kind="stable")[: max(1, len(cost) // ELITE)]
    chosen = draw.choice(elite, count)
    moved = knots[:, chosen] + NARROW * sampling.widest * draw.normal(size=(len(knots), count))
    return np.clip(moved, -sampling.widest, sampling.widest), turns[chosen] + LATER * draw.normal(size=count)


@eqx.filter_jit
def _tried(many: Plant, policy: Steered, loop: Loop, bends: AnyArray, shifts: AnyArray, look: int):
    """(looks, 3, samples), m, and (samples,): each sample's places, and whether it fails.

    One compiled program from the robot's state on: uncompiled code takes longer than the rollouts.
    """
    count = bends.shape[-1]
    rows = lambda x: jnp.repeat(jnp.asarray(x, many.options.dtype)[..., None], count, axis=-1)  # noqa: E731
    ahead = taken_over(many, loop, count)
    ahead = ahead._replace(memory=clock_moved(ahead.memory, 1.0, shifts))
    return followed(many, jax.tree.map(rows, policy), ahead, bends, look, each=True)[1:]


@eqx.filter_jit
def followed(plant: Plant, policy: Steered, loop: Loop, bends: AnyArray, look: int, *, each: bool = False):
    """The loop after bends (looks,), or (looks, robots), the path with its start, (looks + 1, 3), and the failure."""

    def one(loop: Loop, bend):
        loop, _ = roll_on(plant, replace(policy, bend=bend), loop, look, lambda state: None, each=each)
        return loop, places(plant, loop)

    end, path = jax.lax.scan(one, loop, jnp.asarray(bends, plant.options.dtype))
    return end, jnp.concatenate([places(plant, loop)[None], path]), failures(plant, end)


def costs(path: np.ndarray, failure: np.ndarray, goal: np.ndarray, within: float = REACHED) -> np.ndarray:
    """The cost of each sample, m: its final distance from the goal; where it arrives, the looks until then, less 1000.

    `path` (looks, 2, samples), m. A sample arrives at half of `within`, m, since the robot is not the model; a failed
    one is worse than all others.
    """
    away = np.linalg.norm(path - goal[:, None], axis=1)
    arrives = np.where(away.min(0) < within / 2, (away < within / 2).argmax(0) - 1000.0, away[-1])
    return np.where((failure == 0) & np.isfinite(arrives), arrives, np.inf)

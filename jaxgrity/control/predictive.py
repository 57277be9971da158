"""Model-predictive control by sampling: a model of the robot tries out many ways of steering, and the best is taken.

Every so often the robot's state is given to as many robots of a model, side by side, as there are samples. Each is
steered in its own way for a horizon: another bend of its path, and another place in the cycle of its gait. Of the one
that comes closest to the goal the robot takes the bend and the clock, until it is asked again.
"""

import time
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.closed_loop import Loop, drive, loop_start, taken_over
from jaxgrity.control.feedback import PhaseLocked
from jaxgrity.control.plant import Plant, check_model, side_by_side, whole_number
from jaxgrity.control.steering import Steered
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, State

REACHED = 0.3
"""m, from the goal, within which it counts as reached"""


class Sampling(NamedTuple):
    """How a predictive controller looks ahead."""

    samples: int = 64
    horizon: float = 3.0
    """s, for which each of them is rolled out"""
    interval: float = 0.5
    """s, from one choice to the next"""
    widest: float = 0.6
    """the largest bend, see `Steered`"""
    jumping: float = 0.5
    """share of the samples whose clocks jump to another place in the cycle"""
    per_second: int = 10
    """looks at the distance to the goal"""
    patience: float = 60.0
    """s, after which the goal is given up"""


USUAL = Sampling()
"""if nothing else is asked for"""


class Journey(NamedTuple):
    """How a robot was led to a goal."""

    path: np.ndarray
    """(looks, 3), m, the centre of mass"""
    reached: bool
    seconds: float
    """until the goal was reached, or the time was up"""
    bends: np.ndarray
    """what was chosen"""
    real_time: float
    """seconds that pass for the robot, per second that choosing takes, compilation left out"""


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
    """Lead one robot to a goal by what a model of it says.

    Args:
        robot: what moves, as from `plant_of`.
        model: what the controller takes it for, likewise, with the same members and period.
        policy: how it rolls while it is not asked; its goal does not count.
        goal: (2,), m.
        start: q and v of the robot; as its scene stands where not given.
        seed: of the samples, and of the sensors' noise.
        sampling: how the controller looks ahead.

    Returns:
        Its path, whether and when the goal was reached, and how fast choosing was.

    Raises:
        InputError: a policy or a model that actuates other members than the robot, a model with another period, times
            that are no multiples of each other, a policy other than a steered `PhaseLocked` one, or a goal that is no
            place.
    """
    check_model(robot, model)
    _check_policy(policy, goal)
    look = whole_number("1 / per_second", 1 / sampling.per_second, robot.period)
    looks = whole_number("interval", sampling.interval, 1 / sampling.per_second)
    whole_number("horizon", sampling.horizon, 1 / sampling.per_second)
    if not sampling.patience > 0:
        raise InputError(f"patience = {sampling.patience:g} s: expected a positive time")
    draw, goal, policy = np.random.default_rng(seed), np.asarray(goal, float), replace(policy, goal=None)
    many = side_by_side(model, sampling.samples)
    loop = loop_start(robot, policy, jax.random.key(seed), start)
    paths: list[np.ndarray] = []
    bends: list[float] = []
    spent: list[float] = []
    passed = 0.0
    while passed < sampling.patience:
        began = time.perf_counter()
        policy, loop = _chosen(many, policy, loop, goal, draw, sampling)
        spent.append(time.perf_counter() - began)
        there = drive(robot, policy, loop, look, looks)
        near = np.linalg.norm(np.asarray(there.path)[:, :2] - goal, axis=1) < REACHED
        loop, passed = there.end, passed + (near.argmax() if near.any() else looks) / sampling.per_second
        paths.append(np.asarray(there.path)[bool(paths) :])
        bends.append(float(policy.bend))
        if near.any() or there.failure != 0:
            break
    path = np.concatenate(paths)
    typical = float(np.median(spent[1:] or spent))
    reached = bool(near.any())
    return Journey(path, reached, passed, np.array(bends), sampling.interval / typical)


def _check_policy(policy: Steered, goal: AnyArray) -> None:
    """Raise `InputError` for a policy without bend or clock to choose, and for a goal that is no place."""
    if not (isinstance(policy, Steered) and isinstance(policy.policy, PhaseLocked)):
        found = f"Steered({type(policy.policy).__name__})" if isinstance(policy, Steered) else type(policy).__name__
        raise InputError(f"policy = {found}: expected a Steered(PhaseLocked), whose bend and clock are chosen")
    if np.shape(goal) != (2,) or not np.isfinite(np.asarray(goal)).all():
        raise InputError(f"goal = {np.asarray(goal).tolist()}: expected a place (x, y), m")


def _chosen(
    many: Plant, policy: Steered, loop: Loop, goal: np.ndarray, draw: np.random.Generator, sampling: Sampling
) -> tuple[Steered, Loop]:
    """The policy with the best bend, and the loop with the best clock; the first sample goes on as before."""
    count, dtype = sampling.samples, many.options.dtype
    bends = draw.uniform(-sampling.widest, sampling.widest, count)
    bends[0] = policy.bend
    turns = draw.uniform(0, 1, count) * (draw.uniform(size=count) < sampling.jumping)
    turns[0] = 0
    shifts = turns / float(np.max(policy.policy.gait.frequency))  # type: ignore[attr-defined]
    path, failure = _tried(many, policy, loop, jnp.asarray(bends, dtype), jnp.asarray(shifts, dtype), sampling)
    best = int(np.argmin(costs(np.asarray(path)[:, :2], np.asarray(failure), goal)))
    (clock, until), *others = loop.memory
    chosen = Loop(loop.plant, ((clock + jnp.asarray(shifts[best], dtype), until), *others))
    return replace(policy, bend=jnp.asarray(bends[best], dtype)), chosen


@eqx.filter_jit
def _tried(many: Plant, policy: Steered, loop: Loop, bends: AnyArray, shifts: AnyArray, sampling: Sampling):
    """(looks, 3, samples), m, and (samples,): where each sample gets to, and whether it fails.

    One compiled program from the robot's state on: what is not compiled takes longer than the rollouts do.
    """
    rows = lambda x: jnp.repeat(jnp.asarray(x, many.options.dtype)[..., None], len(bends), axis=-1)  # noqa: E731
    candidates = replace(jax.tree.map(rows, policy), bend=bends)
    ahead = taken_over(many, loop, len(bends))
    (clock, until), *others = ahead.memory
    ahead = ahead._replace(memory=((clock + shifts, until), *others))
    ticks = round(1 / sampling.per_second / many.period)
    looks = round(sampling.horizon * sampling.per_second)
    there = drive(many, candidates, ahead, ticks, looks, each=True)
    return there.path, there.failure


def costs(path: np.ndarray, failure: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Of each sample, m: how far from the goal it ends, or where it gets there, how many looks that takes, less 1000.

    Of a `path` (looks, 2, samples), m. A sample gets there within half of `REACHED`, since the robot is not the model;
    one that fails is worse than all others.
    """
    away = np.linalg.norm(path - goal[:, None], axis=1)
    arrives = np.where(away.min(0) < REACHED / 2, (away < REACHED / 2).argmax(0) - 1000.0, away[-1])
    return np.where((failure == 0) & np.isfinite(arrives), arrives, np.inf)

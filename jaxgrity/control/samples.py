"""Samples of a predictive controller: ways to go on are drawn, rolled out by a model, and compared by their costs.

A sample is a gait, bends on straight lines between knots, and a jump of the gait's clock. All samples of all robots
start from the robots' present states, and are rolled out side by side. Several robots of the model try each sample if
their friction differs.
"""

import math
from typing import NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.choices import Choices
from jaxgrity.control.closed_loop import Loop, failures, roll_on, taken_over
from jaxgrity.control.obstacles import Way, room
from jaxgrity.control.plant import Plant
from jaxgrity.control.tasks import REACHED, at_size
from jaxgrity.core.types import AnyArray
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.dynamics import centre_of_mass

TOO_CLOSE = 100.0
"""Length added to a way for each metre by which the robot comes too close to an obstacle, m."""
ARRIVING = 1000.0
"""Number taken off the seconds of a way that reaches the goal and touches nothing: it beats all that do not."""
FAILING = 1e6
"""Cost of a way whose rollout fails: all others beat it."""
MARGIN = 0.1
"""Default distance to be kept from obstacles beyond the reach of a map, m for a robot of one metre."""
BENT = 0.7
"""Share of the samples with a bend, where there are gaits to choose from: those turn without one, too."""
ELITE = 8
"""Number of samples of all earlier rounds for each one that guides the next round: the best eighth does."""
NARROW, LATER = 0.3, 0.05
"""Standard deviations of later rounds: as a share of the largest bend, and in turns of the clock."""


class Sampling(NamedTuple):
    """Settings of `lead_to`: which samples it draws at each choice, and how it rolls them out. A sample is one way to
    go on: a gait, bends, and a jump of the gait's clock."""

    samples: int = 64
    """number of samples for each robot at each choice, all rounds together"""
    horizon: float = 3.0
    """simulated time of each sample, s"""
    interval: float = 0.5
    """time from one choice to the next, s"""
    widest: float = 0.6
    """largest bend, at most 1 (see `Steered`)"""
    jumping: float = 0.5
    """share of the samples of the first round whose clock jumps to another place in the cycle"""
    knots: int = 3
    """number of bends over the horizon, with linear changes in between; 1: a constant bend"""
    rounds: int = 2
    """number of rounds, with as many samples in each: the first at random, later ones near the best so far"""
    per_second: int = 10
    """rate at which a sample's distances from goal and obstacles are measured, and its bend changes, 1/s"""
    patience: float = 60.0
    """time after which a robot gives up, s"""
    within: float | None = None
    """distance from the goal that counts as reached, m; None: `REACHED` at the size of the robot"""
    friction: tuple[float, ...] = (1.0,)
    """factors of the model's friction: one model robot for each factor tries each sample"""
    usual: float = 0.6
    """share of the samples of the first round with the first of several gaits; others take any gait and image"""
    margin: float | None = None
    """distance from obstacles to keep beyond the reach of the map, m; None: `MARGIN` at the size of the robot"""
    seed: int = 0
    """seed of the samples and of the sensors' noise"""

    @property
    def drawn(self) -> int:
        """The number of samples of each robot in a round."""
        return self.samples // self.rounds


CAUTIOUS = Sampling(samples=24, interval=0.75, knots=1, rounds=1, friction=(0.75, 1.0, 1.25))
"""Sampling for ways round obstacles: each sample is tried with three frictions."""


def sized(sampling: Sampling, scene: Scene) -> Sampling:
    """The sampling with distances for the scene's robot where it has none, m."""
    within, margin = at_size(sampling.within, REACHED, scene), at_size(sampling.margin, MARGIN, scene)
    return sampling._replace(within=within, margin=margin)


class Sampled(NamedTuple):
    """Samples, and what became of them. Robots and samples are the last two axes of all arrays."""

    gaits: np.ndarray
    """(robots, samples), rows of the gaits to choose from"""
    knots: np.ndarray
    """(knots, robots, samples), bends"""
    turns: np.ndarray
    """(robots, samples), by which the clock jumps"""
    path: np.ndarray
    """(looks + 1, 2, copies, robots, samples), m, the centre of mass of each robot of the model"""
    cost: np.ndarray
    """(robots, samples), of `costs`"""


Drawn = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Gaits, knots and turns, as in `Sampled`."""


def best(
    many: Plant,
    choices: Choices,
    loop: Loop,
    ways: list[Way],
    draw: np.random.Generator,
    sampling: Sampling,
    before: tuple[np.ndarray, np.ndarray],
) -> Sampled:
    """The best sample of each robot, without the axis of samples; the first one continues with the gaits, (robots,),
    and the knots, (knots, robots), of `before`."""
    tried = None
    for _ in range(sampling.rounds):
        drawn = _first(draw, choices, before, sampling) if tried is None else _about_the_best(draw, tried, sampling)
        path, failed = _foreseen(many, choices, loop, before[0], drawn, sampling)
        cost = [costs(path[1:, :, :, k], failed[:, k], way, sampling) for k, way in enumerate(ways)]
        new = Sampled(*drawn, path, np.array(cost))
        tried = new if tried is None else Sampled(*(np.concatenate(both, axis=-1) for both in zip(tried, new)))
    assert tried is not None, "there is at least one round"
    first = tried.cost.argmin(1)
    return Sampled(*(x[..., np.arange(len(ways)), first] for x in tried))


def _first(draw: np.random.Generator, choices: Choices, before, sampling: Sampling) -> Drawn:
    """Samples at random; the first one goes on as `before`, and the second of several gaits is rest."""
    shape, several = (len(before[0]), sampling.drawn), len(choices.names) > 1
    gaits = np.zeros(shape, int)
    if several:
        usual = draw.uniform(size=shape) < sampling.usual
        gaits = np.where(usual, 0, draw.integers(0, len(choices.names) - 1, shape))
    knots = draw.uniform(-sampling.widest, sampling.widest, (sampling.knots, *shape))
    if several:
        knots = knots * (draw.uniform(size=shape) < BENT)
    turns = draw.uniform(0, 1, shape) * (draw.uniform(size=shape) < sampling.jumping)
    gaits[:, 0], knots[..., 0] = before
    turns[:, 0] = 0
    if several:
        gaits[:, 1], knots[..., 1], turns[:, 1] = len(choices.names) - 1, 0, 0
    return gaits, knots, turns


def _about_the_best(draw: np.random.Generator, tried: Sampled, sampling: Sampling) -> Drawn:
    """Samples with the gaits of the best of earlier rounds, all with equal weights, and knots and turns that are
    normally distributed about theirs."""
    robots, count = tried.cost.shape
    elite = np.argsort(tried.cost, axis=1, kind="stable")[:, : max(1, count // ELITE)]
    chosen = np.take_along_axis(elite, draw.integers(0, elite.shape[1], (robots, sampling.drawn)), axis=1)
    gaits, knots, turns = (x[..., np.arange(robots)[:, None], chosen] for x in tried[:3])
    moved = knots + NARROW * sampling.widest * draw.normal(size=knots.shape)
    return gaits, np.clip(moved, -sampling.widest, sampling.widest), turns + LATER * draw.normal(size=turns.shape)


def between(sampling: Sampling) -> np.ndarray:
    """(looks, knots): the weight of each knot in the middle of each look, on straight lines between knots."""
    looks = round(sampling.horizon * sampling.per_second)
    place = (np.arange(looks) + 0.5) / looks * (sampling.knots - 1)
    return np.maximum(0, 1 - np.abs(place[:, None] - np.arange(sampling.knots)))


def shifted(knots: np.ndarray, sampling: Sampling) -> np.ndarray:
    """The knots, (knots, robots), one interval later; the last one stays."""
    times = np.linspace(0, sampling.horizon, len(knots))
    return np.stack([np.interp(times + sampling.interval, times, each) for each in knots.T], axis=-1)


def _foreseen(many: Plant, choices: Choices, loop: Loop, before: np.ndarray, drawn: Drawn, sampling: Sampling):
    """The paths of all samples, as in `Sampled`, and which of them fail, (copies, robots, samples)."""
    gaits, knots, turns = drawn
    copies = len(sampling.friction)
    lanes = lambda x: np.repeat(x.reshape(*x.shape[:-2], -1), copies, axis=-1)  # noqa: E731
    bends = np.tensordot(between(sampling), knots, axes=1)
    clocks = (lanes(x) for x in choices.clocks(before[:, None], gaits, turns))
    look = round(1 / sampling.per_second / many.period)
    path, failed = _rolled_out(many, choices, lanes(gaits), loop, tuple(clocks), lanes(bends), look)
    shape = (*gaits.shape, copies)
    path = np.moveaxis(np.asarray(path, float).reshape(-1, 2, *shape), -1, 2)
    return path, np.moveaxis(np.asarray(failed).reshape(shape), -1, 0)


@eqx.filter_jit
def _rolled_out(many: Plant, choices: Choices, gaits, loop: Loop, clocks, bends, ticks: int):
    """(looks + 1, 2, lanes), m, and (lanes,): the places of each robot of the model, and whether it fails.

    One compiled program from the robots' states on: uncompiled code takes longer than the rollouts.
    """
    ahead = taken_over(many, loop, cast(int, many.robots) // math.prod(loop.plant.motion[0].shape[2:]))
    ahead = ahead._replace(memory=choices.moved(ahead.memory, *clocks))
    _, _, path, failed = followed(many, choices, gaits, ahead, bends, ticks)
    return path[::ticks, :2], failed


@eqx.filter_jit
def followed(plant: Plant, choices: Choices, gaits: AnyArray, loop: Loop, bends: AnyArray, ticks: int):
    """The loop after `bends`, (parts,) or (parts, robots), each held for some control periods; nodes and centres of
    mass at the start and after each period, and whether each robot failed."""
    centre, each = plant.lift(centre_of_mass, ("s", -1)), plant.robots is not None
    seen = lambda state: (state.motion[0], centre(plant.scene, state.motion[0]))  # noqa: E731
    part = lambda loop, bend: roll_on(plant, choices.chosen(gaits, bend), loop, ticks, seen, each=each)  # noqa: E731
    end, later = jax.lax.scan(part, loop, jnp.asarray(bends, plant.options.dtype))
    each_tick = (x.reshape(-1, *x.shape[2:]) for x in later)
    nodes, path = (jnp.concatenate([a[None], b]) for a, b in zip(seen(loop.plant), each_tick))
    return end, nodes, path, failures(plant, end) != 0


def costs(path: np.ndarray, failed: np.ndarray, way: Way, sampling: Sampling) -> np.ndarray:
    """(samples,), m: the way left at the horizon, the mean of the copies' mean and worst.

    A copy that arrives clear of obstacles costs its seconds until then, less `ARRIVING`. It arrives at half of
    `within`, m, since the robot is not the model. One too close to an obstacle costs `TOO_CLOSE` times the missing
    distance, wherever it ends. `path` (looks, 2, copies, samples), m; a copy that `failed`, (copies, samples), costs
    `FAILING`. `within` and `margin` are lengths here.
    """
    failed = failed | ~np.isfinite(path).all((0, 1))
    path = np.moveaxis(np.where(np.isfinite(path), path, 0.0), 1, -1)
    near = np.linalg.norm(path - way.goal, axis=-1) < cast(float, sampling.within) / 2
    there, first = near.any(0), near.argmax(0)
    close = np.maximum(way.reach + cast(float, sampling.margin) - room(way.discs, path), 0)
    before = np.arange(len(path))[:, None, None] <= np.where(there, first, len(path))
    # what a copy would touch after its arrival does not count: the journey ends there
    touching = (close * before).max(0)
    arrives = there & (touching == 0)
    worth = np.where(arrives, first / sampling.per_second - ARRIVING, way.to_go(path[-1]) + TOO_CLOSE * touching)
    worth = np.where(failed, FAILING, worth)
    return np.asarray((worth.mean(0) + worth.max(0)) / 2)

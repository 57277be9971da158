"""How a gait is judged: by an ensemble of robots that differ, rolled out on one model or on both."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxgrity.core.display import COVERING
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, PerGait, Scalar
from jaxgrity.model.actuation import Gait, actuated_lengths, peak_rates
from jaxgrity.model.scene import Scene
from jaxgrity.populations.lanes import most_lanes
from jaxgrity.populations.population import Outcomes, roll_out
from jaxgrity.populations.uncertainty import Uncertainty, ensemble
from jaxgrity.search.models import Model
from jaxgrity.search.objectives import ActuatorBounds, Distance, Objective

SMALLEST = 128
"""Fewest rollouts in one call."""
BEYOND_BOUNDS = 1e12
"""Loss of fitness of a gait beyond its bounds: larger than any fitness, in its own unit."""
FARTHEST = 1e6
"""Gaits beyond this many times the bounds all count alike."""
LEAST_SKEWED = 1e-6
"""Skewness of pairs of robots from which on it counts: below, its effect is rounding."""
ROUND = SMALLEST
"""Number of robots with which the last judgement begins, and which it adds each time: fewer would take as long."""


class Fitness(eqx.Module):
    """How a gait is judged: by the mean of an objective over an ensemble of robots, less some of its spread."""

    objective: Objective = eqx.field(default_factory=Distance)
    uncertainty: Uncertainty = eqx.field(default_factory=Uncertainty)
    robots: int = eqx.field(static=True, default=1)
    """in each gait's ensemble"""
    caution: float = eqx.field(static=True, default=0.0)
    """how many standard deviations of the ensemble are held against a gait: small perturbations that grow are spread"""
    bounds: ActuatorBounds = eqx.field(default_factory=ActuatorBounds)

    def __check_init__(self):
        if self.robots < 1:
            raise InputError(f"robots = {self.robots}: expected at least 1")
        if self.robots == 1 and self.caution:
            raise InputError(f"caution = {self.caution}: one robot has no spread; expected robots = 2 or more")
        if self.uncertainty.none and self.caution:
            raise InputError(
                f"caution = {self.caution}: nothing is uncertain, nothing spreads; expected an uncertainty"
            )

    @property
    def needs_metrics(self) -> bool:
        """Whether rollouts have to be measured step by step."""
        return self.objective.needs_metrics or self.bounds.needs_metrics

    @property
    def rollouts(self) -> int:
        """That judge one gait: where nothing is uncertain, one says it all."""
        return 1 if self.uncertainty.none else self.robots

    def worth(self, scene: Scene, gaits: Gait, outcomes: Outcomes, duration: Scalar) -> tuple[PerGait, PerGait]:
        """(population,): the objective, and by how much the bounds are exceeded (`ActuatorBounds.excess`)."""
        rate = peak_rates(gaits, actuated_lengths(scene.structure, gaits.members)).max(-1)
        return self.objective.worth(scene, outcomes, duration), self.bounds.excess(rate, outcomes.metrics)


@typed
def with_robots(fitness: Fitness, robots: int) -> Fitness:
    """The same fitness by an ensemble of another size."""
    return Fitness(fitness.objective, fitness.uncertainty, robots, fitness.caution, fitness.bounds)


@typed
def without_measuring(fitness: Fitness) -> Fitness:
    """The same fitness without bounds on force and power, for which rollouts are measured at several times the cost."""
    bounds = ActuatorBounds(rate=fitness.bounds.rate)
    return Fitness(fitness.objective, fitness.uncertainty, fitness.robots, fitness.caution, bounds)


class Scores(NamedTuple):
    """Of each gait."""

    fitness: PerGait
    """mean less caution times spread; -inf where a robot failed"""
    mean: PerGait
    spread: PerGait
    """standard deviation over the ensemble"""
    failed: Bool[AnyArray, " population"]
    """whether any robot of the ensemble failed"""
    each: Float[np.ndarray, "population robots"]
    """the objective of every robot"""
    excess: Float[np.ndarray, "population robots"]
    """by which share of them each exceeds the bounds on actuators, summed up; 0 within"""

    @property
    def beyond(self) -> PerGait:
        """Share of the robots that exceed a bound."""
        return (self.excess > 0).mean(1)

    @property
    def merit(self) -> PerGait:
        """By which gaits are compared, a number without a unit: the fitness of those within the bounds on all robots.

        All others come after these, the further the more their robots exceed the bounds (Deb 2000,
        doi:10.1016/S0045-7825(99)00389-8), and before those that failed.
        """
        over = self.excess.mean(1)
        merit = np.where(over > 0, -BEYOND_BOUNDS * (1 + over), self.fitness)
        return np.where(self.failed, -np.inf, merit)


class Judging(NamedTuple):
    """How gaits are judged: on which models, for how long, and by which fitness."""

    models: tuple[Model, ...]
    """on each of which every robot is rolled out; all of one precision"""
    duration: float
    """s"""
    fitness: Fitness

    @property
    def dtype(self) -> str:
        """The precision of its models."""
        return self.models[0].options.dtype

    def by(self, robots: int) -> "Judging":
        """The same with ensembles of another size."""
        return self._replace(fitness=with_robots(self.fitness, robots))


@typed
def judge(key, judging: Judging, gaits: Gait) -> Scores:
    """Score every gait by its ensemble; on several models a robot is worth the mean of what it is worth on each.

    All models meet the same draws. What is compiled is shared by all calls on a model whose rollouts are about as many.
    """
    _, duration, fitness = judging
    worth, excess = zip(*(_judged(key, model, gaits, duration, fitness) for model in judging.models))
    return scored(np.mean(worth, axis=0), fitness.caution, np.max(excess, axis=0))


def _judged(key, model: Model, gaits: Gait, duration: float, fitness: Fitness) -> tuple[np.ndarray, np.ndarray]:
    """(population, robots), what each robot's rollout is worth, and by how much it exceeds the bounds."""
    rows, parts = len(gaits.phase) * fitness.rollouts, fitness.objective.parts_of(model.scene, duration)
    gaits, outcomes = ensembles_rolled_out(key, model, gaits, duration, fitness, parts, fitness.needs_metrics)
    found = _worth(fitness, model.scene, gaits, outcomes, np.asarray(duration, float))
    worth, excess = (np.asarray(each)[:rows].reshape(-1, fitness.rollouts) for each in found)
    return worth, excess


def ensembles_rolled_out(
    key, model: Model, gaits: Gait, duration: float, fitness: Fitness, parts: int, with_metrics: bool
) -> tuple[Gait, Outcomes]:
    """The rollouts of every gait's robots, those of the first gait first, and the gait of each.

    There are a whole number of `call_size` of them: the last one is repeated. Every call has that size, so that one
    compiled program serves all stages of a search.
    """
    (scene, options), count = model, fitness.rollouts
    dtype, rows = options.dtype, len(gaits.phase) * count
    gaits, differences = jax.tree.map(lambda x: np.asarray(x, dtype), gaits), None
    if not fitness.uncertainty.none:
        gaits, differences = ensemble(key, scene, gaits, fitness.uncertainty, count)
    size, end = call_size(rows, model), np.asarray(duration, float)

    def some(numbers):
        return jax.tree.map(lambda x: np.asarray(x)[numbers] if np.ndim(x) else x, (gaits, differences))

    filled = np.minimum(np.arange(-(-rows // size) * size), rows - 1)
    calls = [
        roll_out(scene, robots, end, options, differ, with_metrics=with_metrics, parts=parts)
        for robots, differ in map(some, filled.reshape(-1, size))
    ]
    return some(filled)[0], jax.tree.map(lambda *found: np.concatenate(found), *calls)


@eqx.filter_jit
def _worth(
    fitness: Fitness, scene: Scene, gaits: Gait, outcomes: Outcomes, duration: Scalar
) -> tuple[PerGait, PerGait]:
    return fitness.worth(scene, gaits, outcomes, duration)


def call_size(rows: int, model: Model) -> int:
    """How many rollouts a call has, of so many that are asked for: as many as the cores integrate side by side, or a
    smaller power of two, at least `SMALLEST`, which take hardly longer than few."""
    most = jax.device_count() * most_lanes(model.scene, model.options)
    return max(SMALLEST, min(most, 1 << (rows - 1).bit_length()))


def scored(
    each: Float[np.ndarray, "population robots"],
    caution: float,
    excess: Float[np.ndarray, "population robots"] | None = None,
) -> Scores:
    """The scores of gaits of whose ensembles every robot was worth so much, and exceeded the bounds by so much."""
    failed = ~np.isfinite(each).all(1)
    mean, spread = each.mean(1), each.std(1)
    worth = np.where(failed, -np.inf, mean - caution * spread)
    over = np.zeros_like(each) if excess is None else np.where(np.isnan(excess), 0, np.minimum(excess, FARTHEST))
    return Scores(worth, mean, spread, failed, each, over)


def judge_until(
    judged: Callable[[int], Scores], robots: int, caution: float, enough: Callable[[np.ndarray], bool]
) -> Scores:
    """Scores over more and more robots: `judged(k)` for k = 0, 1, ..., until `enough(each)`, or there are so many.

    Every round has other draws. Of a round's robots the second half has the opposite draws of the first; it is so in
    what comes back too.
    """
    found = judged(0)
    count = found.each.shape[1]
    halves = (len(found.each), 2 - count % 2, -1)
    rounds = [(found.each.reshape(halves), found.excess.reshape(halves))]
    while found.each.shape[1] < robots and not enough(found.each):
        more = judged(len(rounds))
        rounds.append((more.each.reshape(halves), more.excess.reshape(halves)))
        each, excess = (np.concatenate(parts, axis=2).reshape(len(found.each), -1) for parts in zip(*rounds))
        found = scored(each, caution, excess)
    return found


def influences(each: Float[np.ndarray, "population robots"], caution: float) -> Float[np.ndarray, "population robots"]:
    """What each robot says of its gait's fitness: their mean is mean - caution * spread, their standard error its own.

    To first order in 1/robots, as the spread s changes by ((x - mean)^2 - s^2)/(2 s) for each robot x (its influence
    function: Hampel 1974, doi:10.1080/01621459.1974.10482962). Those of two gaits that met the same draws are
    subtracted robot by robot.
    """
    off = each - each.mean(1, keepdims=True)
    spread = each.std(1, keepdims=True)
    return each - caution * (
        spread + np.divide(off**2 - spread**2, 2 * spread, out=np.zeros_like(off), where=spread > 0)
    )


def standard_error(each: PerGait) -> float:
    """Of the mean over robots whose second half has the opposite draws of the first, so that pairs are independent.

    Where few robots fall far behind all others, an ensemble that has none of these scatters too little, and the usual
    error is too small. So this is the error times what skewness adds to a range of `COVERING` errors to both sides, in
    the mean of both (Hall 1992, On the removal of skewness by transformation, J. R. Stat. Soc. B 54, 221).
    """
    pairs = np.asarray(each.reshape(2, -1).mean(0) if each.size % 2 == 0 else each)
    if pairs.size < 2:
        return np.inf
    error, off = float(pairs.std(ddof=1) / np.sqrt(pairs.size)), pairs - pairs.mean()
    spread = pairs.std()
    skewness = float(np.mean(off**3) / spread**3) if spread > 0 else 0.0
    if not abs(skewness) > LEAST_SKEWED:
        return error
    # both ends of the range, by the inverse of the transformation
    of_mean = skewness / np.sqrt(pairs.size)
    low, high = (np.cbrt(1 + of_mean * (side * COVERING - of_mean / 6)) for side in (-1, 1))
    return error * float(3 / of_mean * (high - low) / (2 * COVERING))

"""Fitness of gaits, for every stage of a search: ensembles of perturbed robots, on one contact model or on both."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxgrity.core.arguments import check_count, check_number
from jaxgrity.core.display import COVERING
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, PerGait, Scalar
from jaxgrity.model.actuation import Gait, actuated_lengths, peak_rates
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.populations.lanes import most_lanes, parts_with_room
from jaxgrity.populations.population import Outcomes, at_start, roll_out
from jaxgrity.populations.uncertainty import Differences, Uncertainty, differing, ensemble
from jaxgrity.search.models import RolloutModel
from jaxgrity.search.objectives import ActuatorBounds, Distance, Objective

SMALLEST_CALL = 128
"""Smallest number of rollouts per call."""
BEYOND_BOUNDS = 1e12
"""Fitness that a gait beyond its bounds loses: more than any fitness, in the objective's unit."""
FARTHEST = 1e6
"""Excess, as a multiple of the bounds, beyond which all gaits rank the same."""
LEAST_SKEWED = 1e-6
"""Smallest skewness over pairs of robots that matters. Below it, the effect is rounding."""
ROBOTS_PER_ROUND = SMALLEST_CALL
"""Number of robots that the final evaluation adds per round. Fewer robots would take as long."""


class Fitness(eqx.Module):
    """Fitness of a gait: mean of an objective over perturbed robots, less `caution` standard deviations."""

    objective: Objective = eqx.field(default_factory=Distance)
    uncertainty: Uncertainty = eqx.field(default_factory=Uncertainty)
    robots: int = eqx.field(static=True, default=1)
    """number of robots in each gait's ensemble"""
    caution: float = eqx.field(static=True, default=0.0)
    """number of standard deviations over the ensemble that are subtracted from the mean"""
    bounds: ActuatorBounds = eqx.field(default_factory=ActuatorBounds)

    def __check_init__(self):
        check_count("robots", self.robots, 1)
        check_number("caution", self.caution, least=0.0)
        if self.robots == 1 and self.caution:
            raise InputError(f"caution = {self.caution}: one robot has no spread; expected robots = 2 or more")
        if self.uncertainty.none and self.caution:
            raise InputError(
                f"caution = {self.caution}: nothing is uncertain, nothing spreads; expected an uncertainty"
            )

    @property
    def needs_metrics(self) -> bool:
        """Whether rollouts must be measured step by step."""
        return self.objective.needs_metrics or self.bounds.needs_metrics

    @property
    def rollouts(self) -> int:
        """Number of rollouts per gait: 1 if nothing is uncertain."""
        return 1 if self.uncertainty.none else self.robots

    def worth(
        self, scene: Scene, gaits: Gait, outcomes: Outcomes, duration: Scalar, differences: Differences | None = None
    ) -> tuple[PerGait, PerGait]:
        """(population,): the objective, and the excess over the bounds (`ActuatorBounds.excess`).

        Of `differences`, those of masses and rest lengths count; None: all robots are that of the scene.
        """
        mass, lengths = masses_and_lengths(scene, gaits, differences)
        worth = self.objective.worth(scene, outcomes, duration)
        if self.objective.per_mass:
            worth = worth * (scene.structure.mass / mass)
        return worth, self.bounds.excess(peak_rates(gaits, lengths).max(-1), outcomes.metrics)


def masses_and_lengths(scene: Scene, gaits: Gait, differences: Differences | None) -> tuple[float | AnyArray, AnyArray]:
    """Mass, kg, and rest lengths of the actuated members, m, of the scene's robot, or of each that differs in them."""
    told = lambda robot: (robot.mass, actuated_lengths(robot, gaits.members))  # noqa: E731
    counts = ("node_mass", "body_mass", "cable_rest_length", "strut_rest_length")
    own = None if differences is None else Differences(**{name: getattr(differences, name) for name in counts})
    if not jax.tree.leaves(own):
        return told(scene.structure)
    return jax.vmap(lambda row: told(differing(scene, row).structure))(own)


@typed
def with_robots(fitness: Fitness, robots: int) -> Fitness:
    """The same fitness with another number of robots."""
    return Fitness(fitness.objective, fitness.uncertainty, robots, fitness.caution, fitness.bounds)


@typed
def without_force_bounds(fitness: Fitness) -> Fitness:
    """The same fitness without bounds on force and power, whose measurement multiplies the cost of rollouts."""
    bounds = ActuatorBounds(rate=fitness.bounds.rate)
    return Fitness(fitness.objective, fitness.uncertainty, fitness.robots, fitness.caution, bounds)


class Scores(NamedTuple):
    """Scores of a population, one row per gait."""

    fitness: PerGait
    """mean less caution times spread; -inf if a robot failed"""
    mean: PerGait
    spread: PerGait
    """standard deviation over the robots"""
    failed: Bool[AnyArray, " population"]
    """whether any robot of the ensemble failed"""
    each: Float[np.ndarray, "population robots"]
    """objective of each robot"""
    excess: Float[np.ndarray, "population robots"]
    """excess of each robot over the bounds on actuators, as a fraction summed over bounds; 0 within them"""

    @property
    def beyond(self) -> PerGait:
        """Fraction of robots that exceed a bound."""
        return (self.excess > 0).mean(1)

    @property
    def merit(self) -> PerGait:
        """Number by which gaits are ranked: the fitness if all robots keep the bounds.

        Gaits beyond the bounds rank after these, by their excess (Deb 2000, doi:10.1016/S0045-7825(99)00389-8). Failed
        gaits rank last.
        """
        over = self.excess.mean(1)
        merit = np.where(over > 0, -BEYOND_BOUNDS * (1 + over), self.fitness)
        return np.where(self.failed, -np.inf, merit)


class Judging(NamedTuple):
    """Settings of an evaluation: models, duration and fitness."""

    models: tuple[RolloutModel, ...]
    """models on which every robot is rolled out; all of the same precision"""
    duration: float
    """simulated time, s"""
    fitness: Fitness

    @property
    def dtype(self) -> str:
        """Precision of the models."""
        return self.models[0].options.dtype

    def with_robots(self, robots: int, duration: float | None = None) -> "Judging":
        """The same with another number of robots, and another duration (s) if one is given."""
        return Judging(self.models, self.duration if duration is None else duration, with_robots(self.fitness, robots))


@typed
def judge(key, judging: Judging, gaits: Gait) -> Scores:
    """Score every gait by its ensemble. On several models, the objective of a robot is its mean over the models.

    All models get the same draws. Calls with similar numbers of rollouts on a model share one compiled program.
    """
    _, duration, fitness = judging
    each, excess = zip(*(_judged(key, model, gaits, duration, fitness) for model in judging.models))
    return scored(np.mean(each, axis=0), fitness.caution, np.max(excess, axis=0))


def _judged(key, model: RolloutModel, gaits: Gait, duration: float, fitness: Fitness) -> tuple[np.ndarray, np.ndarray]:
    """(population, robots): objective of each robot, and its excess over the bounds."""
    rows, parts = len(gaits.phase) * fitness.rollouts, fitness.objective.parts_of(model.scene, duration)
    gaits, differences, outcomes = ensembles_rolled_out(
        key, model, gaits, duration, fitness, parts, fitness.needs_metrics
    )
    found = _worth(fitness, model.scene, gaits, outcomes, np.asarray(duration, float), differences)
    objective, excess = (np.asarray(each)[:rows].reshape(-1, fitness.rollouts) for each in found)
    return objective, excess


def ensembles_rolled_out(
    key, model: RolloutModel, gaits: Gait, duration: float, fitness: Fitness, parts: int, with_metrics: bool
) -> tuple[Gait, Differences | None, Outcomes]:
    """Rollouts of all robots of all gaits, in the order of the gaits, with the gait and the differences of each.

    The last rollout is repeated to fill a whole number of calls. Every call has `call_size` rollouts, so one compiled
    program serves all stages of a search.
    """
    (scene, options), rows = model, len(gaits.phase) * fitness.rollouts
    gaits, differences = jax.tree.map(lambda x: np.asarray(x, options.dtype), gaits), None
    common, shared = with_gait(scene, at_start(scene, gaits)), parts_with_room(parts, options)
    if not fitness.uncertainty.none:
        gaits, differences = ensemble(key, scene, gaits, fitness.uncertainty, fitness.rollouts)
    size, end = call_size(rows, model), np.asarray(duration, float)
    row = lambda x, numbers: np.asarray(x)[numbers] if np.ndim(x) else x  # noqa: E731
    some = lambda numbers: jax.tree.map(lambda x: row(x, numbers), (gaits, differences))  # noqa: E731
    filled = np.minimum(np.arange(-(-rows // size) * size), rows - 1)
    calls = [
        roll_out(common, robots, end, options, differ, with_metrics=with_metrics, parts=shared)
        for robots, differ in map(some, filled.reshape(-1, size))
    ]
    found = jax.tree.map(lambda *found: np.concatenate(found), *calls)
    return *some(filled), replace(found, com_path=found.com_path[:, : parts + 1])  # the rest repeats the end


@eqx.filter_jit
def _worth(
    fitness: Fitness,
    scene: Scene,
    gaits: Gait,
    outcomes: Outcomes,
    duration: Scalar,
    differences: Differences | None,
) -> tuple[PerGait, PerGait]:
    """`Fitness.worth`, compiled."""
    return fitness.worth(scene, gaits, outcomes, duration, differences)


def call_size(rows: int, model: RolloutModel) -> int:
    """Number of rollouts per call for `rows` requested ones: as many as all cores integrate side by side, or a smaller
    power of two, at least `SMALLEST_CALL`."""
    most = jax.device_count() * most_lanes(model.scene, model.options)
    return max(SMALLEST_CALL, min(most, 1 << (rows - 1).bit_length()))


def scored(
    each: Float[np.ndarray, "population robots"],
    caution: float,
    excess: Float[np.ndarray, "population robots"] | None = None,
) -> Scores:
    """Scores of gaits from the objective of each robot, and its excess over the bounds."""
    failed = ~np.isfinite(each).all(1)
    mean, spread = each.mean(1), each.std(1)
    fitness = np.where(failed, -np.inf, mean - caution * spread)
    over = np.zeros_like(each) if excess is None else np.where(np.isnan(excess), 0, np.minimum(excess, FARTHEST))
    return Scores(fitness, mean, spread, failed, each, over)


def judge_until(
    judged: Callable[[int], Scores], robots: int, caution: float, enough: Callable[[np.ndarray], bool]
) -> Scores:
    """Scores over a growing number of robots: rounds `judged(k)`, k = 0, 1, ..., until `enough(each)` or the limit.

    Every round has new draws. The second half of a round's robots has the opposite draws of the first half, and so it
    is in the returned scores.
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
    """Contribution of each robot to its gait's fitness. Their mean and standard error are those of the fitness.

    This holds to first order in 1/robots: a robot x changes the spread s by ((x - mean)^2 - s^2)/(2 s), its influence
    function (Hampel 1974, doi:10.1080/01621459.1974.10482962). To compare two gaits with the same draws, subtract the
    contributions robot by robot.
    """
    off = each - each.mean(1, keepdims=True)
    spread = each.std(1, keepdims=True)
    return each - caution * (
        spread + np.divide(off**2 - spread**2, 2 * spread, out=np.zeros_like(off), where=spread > 0)
    )


def over_robots(each: PerGait) -> dict[str, Any]:
    """Mean and standard deviation over the robots that did not fail, standard error of the mean, and counts.

    NaN if all failed. If some did, the pairs of draws are broken, and the standard error is None: not known.
    """
    known = each[np.isfinite(each)]
    mean, deviation = (float(known.mean()), float(known.std())) if known.size else (np.nan, np.nan)
    error = standard_error(each) if known.size == each.size > 1 else None
    told = {"mean": mean, "standard_deviation": deviation, "standard_error": error}
    return {**told, "robots": each.size, "failed": each.size - known.size}


def standard_error(each: PerGait) -> float:
    """Standard error of a mean over robots. The second half must have the opposite draws of the first half.

    If a few robots fall far behind all others, an ensemble without them scatters too little, and the usual error is too
    small. So the error is multiplied by a correction for skewness, the mean over both sides of a range of `COVERING`
    errors (Hall 1992, On the removal of skewness by transformation, J. R. Stat. Soc. B 54, 221).
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

"""Settings of polishing and their cost, checked before the search."""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

from jaxgrity.core.arguments import check_count, check_number, is_count
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.search.judging import Fitness
from jaxgrity.search.objectives import OBJECTIVES, SteadySpeed

GradientKind = Literal["smoothed", "pathwise", "combined", "orbit"]

COST = 6.0
"""Cost of a pathwise gradient, in rollouts of its horizon. We measured 4 to 6 (docs/performance.md)."""
ORBIT_COST = 24.0
"""Cost of an orbit and the gradient of its speed, in rollouts of 40 s. It is the largest measured cost for waves."""
STEADY_AHEAD = 0.5
"""Fraction of the duration that smoothed gradients of a steady objective simulate. Twice the robots for half the time
cost the same, and say more of the mean speed."""


class PolishConfig(NamedTuple):
    """Settings of polishing."""

    rollouts: int = 9216
    """budget of all steps from all starts, in rollouts of the whole duration"""
    kind: GradientKind = "smoothed"
    """gradient of the climbs: by perturbed gaits (smoothed), by derivatives of rollouts (pathwise), by both (combined),
    or that of an orbit's speed (`polish.py` says what each is good for)"""
    samples: int = 24
    """number of perturbed gaits per smoothed gradient, or of robots per pathwise gradient"""
    robots: int = 8
    """number of robots that evaluate each perturbed gait"""
    width: float = 0.006
    """standard deviation of the perturbations, in turns (angles) or fractions of the bounds: the distance that a
    polished gait keeps from gaits whose robots fall"""
    learning_rate: float = 0.015
    """length of the first step, in the same unit; the last step has a fifth of it"""
    momentum: float = 0.5
    """share of the last update that the next one keeps"""
    comparison_robots: int = 64
    """number of robots that compare the ends of all climbs"""
    final_robots: int = 128
    """largest number of robots that compare the best start with the best end; the verdict of a search takes more"""
    largest_sensitivity: float = 3.0
    """sensitivity beyond which pathwise gradients are not used, m/rad: they would hold for less than a step"""
    gaits: int = 1
    """number of the best gaits of a search that are polished"""
    overtones: int = 4
    """number of overtones that polishing shapes in waves; more if the search has more. Overtones of the scene's gait
    that the search does not vary are kept instead"""


class Budget(NamedTuple):
    """Use of the rollouts of a polish."""

    each: int
    """rollouts for each climb"""
    comparison: int
    """rollouts that compare the ends of the climbs"""


def cost_of_gradient(config: PolishConfig, fitness: Fitness, kind: GradientKind, share: float) -> float:
    """Cost of one gradient over a fraction of the duration, in rollouts of the whole duration."""
    robots = _robots(fitness, config.robots)
    if kind == "orbit":
        return ORBIT_COST + judges_of_a_step(config, fitness)
    each = {"smoothed": robots, "pathwise": COST, "combined": robots + COST}[kind]
    return share * config.samples * each


def share_simulated(kind: GradientKind, fitness: Fitness) -> float:
    """Fraction of the duration that a gradient simulates, if no sensitivity limits it."""
    return STEADY_AHEAD if kind == "smoothed" and fitness.objective.steady else 1.0


def judges_of_a_step(config: PolishConfig, fitness: Fitness) -> int:
    """Number of robots that evaluate each step on an orbit: a quarter of those of a smoothed gradient."""
    return _robots(fitness, config.samples * config.robots // 4)


def budget(config: PolishConfig, fitness: Fitness, costs: Sequence[float]) -> Budget:
    """The budget of climbs whose steps cost at most `costs` rollouts.

    Raises `InputError` if it does not pay for a step of each climb.
    """
    comparison = len(costs) * _robots(fitness, config.comparison_robots) if len(costs) > 1 else 0
    each = (config.rollouts - comparison) // len(costs)
    if each < max(costs):
        least = math.ceil(max(costs)) * len(costs) + comparison
        raise InputError(f"{config.rollouts} rollouts of polish: expected {least} or more (climbs: {len(costs)})")
    return Budget(each, comparison)


@typed
def check_polish(config: PolishConfig, fitness: Fitness, starts: int) -> None:
    """Raise `InputError` for settings that cannot work from so many starts.

    The cost of pathwise gradients depends on the sensitivity of the starts, which is unknown before the search.
    """
    if config.kind not in get_args(GradientKind):
        known = ", ".join(get_args(GradientKind))
        raise InputError(f"polishing by {config.kind!r}: unknown; expected one of {known}")
    _check_numbers(config)
    if config.kind == "orbit" and not isinstance(fitness.objective, SteadySpeed):
        said = f"the objective {type(fitness.objective).__name__} is not the speed of an orbit"
        raise InputError(f"polishing by 'orbit': {said}; expected SteadySpeed, or another gradient")
    if config.kind in ("pathwise", "combined"):
        _check_pathwise(config.kind, fitness)
    if config.kind in ("smoothed", "orbit"):
        cost = cost_of_gradient(config, fitness, config.kind, share_simulated(config.kind, fitness))
        budget(config, fitness, [cost] * starts)


def _check_pathwise(kind: GradientKind, fitness: Fitness) -> None:
    """Raise `InputError` for everything in the fitness that has no pathwise gradient, at once."""
    objective, received, expected = fitness.objective, [], []
    if fitness.caution:
        received.append(f"caution = {fitness.caution:g}")
        expected.append("caution = 0")
    for name in ("force", "power"):
        bound = getattr(fitness.bounds, name)
        if bound is not None:
            received.append(f"bounds.{name} = {bound:g}")
            expected.append(f"bounds.{name} = None (--objective.largest-{name} None)")
    if objective.steady or objective.needs_metrics:
        fit = [name for name, each in OBJECTIVES.items() if each.parts == 1 and not each.needs_metrics]
        received.append(f"objective = {type(objective).__name__}")
        expected.append(f"objective = {', '.join(fit[:-1])} or {fit[-1]}")
    if received:
        what, fitting = ", ".join(received), ", ".join(expected)
        raise InputError(f"polishing by {kind!r}: {what}; expected {fitting}, or another gradient")


def _check_numbers(config: PolishConfig) -> None:
    """Raise `InputError` for a number out of its range."""
    for name in ("rollouts", "robots", "comparison_robots", "final_robots", "gaits"):
        check_count(f"polish: {name}", getattr(config, name), 1)
    check_count("polish: overtones", config.overtones, 0)
    if not is_count(config.samples, 4) or config.samples % 2:
        raise InputError(f"polish: samples = {config.samples}: expected an even number, 4 or more")
    for name in ("width", "largest_sensitivity"):
        check_number(f"polish: {name}", getattr(config, name), above=0.0)
    check_number("polish: learning_rate", config.learning_rate, least=0.0)
    check_number("polish: momentum", config.momentum, least=0.0, most=1.0)


def _robots(fitness: Fitness, robots: int) -> int:
    """Number of robots of an ensemble: 1 if nothing is uncertain."""
    return 1 if fitness.uncertainty.none else robots

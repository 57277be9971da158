"""What polishing may do and what that costs, checked before a search that it is to follow."""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.search.judging import Fitness
from jaxgrity.search.objectives import SteadySpeed

GradientKind = Literal["smoothed", "pathwise", "combined", "orbit"]

COST = 6.0
"""Cost of a pathwise gradient, in rollouts of its horizon: 4 to 6 were measured (docs/performance.md)."""
ORBIT_COST = 24.0
"""Cost of an orbit and the gradient of its speed, in rollouts over 40 s: the most that was measured for waves."""


class PolishConfig(NamedTuple):
    """How to polish."""

    rollouts: int = 3072
    """that all steps from all starts may cost together, in rollouts over the whole duration"""
    kind: GradientKind = "smoothed"
    samples: int = 32
    """perturbed gaits for each smoothed gradient, robots for each pathwise one"""
    robots: int = 4
    """in the ensemble that judges each of those"""
    width: tuple[float, float] = (0.012, 0.006)
    """standard deviation of the smoothed gradient's perturbations in the first and in the last step, in turns of the
    circle or shares of the bounds"""
    learning_rate: float = 0.018
    """length of the first step, in the same unit; the last has a fifth of it"""
    momentum: float = 0.5
    comparison_robots: int = 64
    """in the ensemble by which the ends of all climbs are compared"""
    final_robots: int = 256
    """by which the best start and the best end are judged, at most"""
    largest_sensitivity: float = 3.0
    """m/rad: beyond it a pathwise gradient describes less than a step's length of the landscape"""
    gaits: int = 1
    """number of the best gaits of a search that are polished"""
    overtones: int = 4
    """number of overtones that are shaped of a search's gaits that are waves, or more where the search has more"""


class Budget(NamedTuple):
    """How the rollouts of a polish are spent."""

    each: int
    """rollouts for each climb"""
    comparison: int
    """rollouts that compare the ends of the climbs"""


def cost_of_gradient(config: PolishConfig, fitness: Fitness, kind: GradientKind, share: float) -> float:
    """Of one gradient that looks ahead for a share of the duration, in rollouts over the whole of it."""
    robots = _robots(fitness, config.robots)
    if kind == "orbit":
        return ORBIT_COST + judges_of_a_step(config, fitness)
    each = {"smoothed": robots, "pathwise": COST, "combined": robots + COST}[kind]
    return share * config.samples * each


def judges_of_a_step(config: PolishConfig, fitness: Fitness) -> int:
    """Robots by which each step on an orbit is judged: half of those that a smoothed gradient takes."""
    return _robots(fitness, config.samples * config.robots // 2)


def budget(config: PolishConfig, fitness: Fitness, costs: Sequence[float]) -> Budget:
    """The budget of climbs of whose steps none costs more than these, in rollouts.

    Raises `InputError` where it does not pay for a step of each climb.
    """
    comparison = len(costs) * _robots(fitness, config.comparison_robots) if len(costs) > 1 else 0
    each = (config.rollouts - comparison) // len(costs)
    if each < max(costs):
        least = math.ceil(max(costs)) * len(costs) + comparison
        raise InputError(f"{config.rollouts} rollouts of polish: expected {least} or more (climbs: {len(costs)})")
    return Budget(each, comparison)


@typed
def check_polish(config: PolishConfig, fitness: Fitness, starts: int) -> None:
    """Raise `InputError` for what no polish can do from so many starts.

    What pathwise gradients cost depends on the sensitivity of the starts, which is not known before the search.
    """
    if config.kind not in get_args(GradientKind):
        known = ", ".join(get_args(GradientKind))
        raise InputError(f"polishing by {config.kind!r}: unknown; expected one of {known}")
    if config.samples < 4 or config.samples % 2:
        raise InputError(f"samples = {config.samples}: expected an even number, 4 or more")
    if config.kind == "orbit" and not isinstance(fitness.objective, SteadySpeed):
        said = f"the objective {type(fitness.objective).__name__} is not the speed of an orbit"
        raise InputError(f"polishing by 'orbit': {said}; expected SteadySpeed, or another gradient")
    unfit = {
        "caution": fitness.caution,
        "a steady objective": fitness.objective.steady,
        "an objective or a bound that needs metrics": fitness.needs_metrics,
    }
    for what, asked in unfit.items():
        if config.kind in ("pathwise", "combined") and asked:
            raise InputError(f"{what} has no pathwise gradient; expected a smoothed one")
    if config.kind in ("smoothed", "orbit"):
        budget(config, fitness, [cost_of_gradient(config, fitness, config.kind, 1.0)] * starts)


def _robots(fitness: Fitness, robots: int) -> int:
    """In an ensemble that is asked to have so many: where nothing is uncertain one says it all."""
    return 1 if fitness.uncertainty.none else robots

"""Error bars of an orbit's numbers, by step refinement: orbits converge where trajectories do not."""

from typing import NamedTuple

import numpy as np

from jaxgrity.core.typed import typed
from jaxgrity.model.scene import Scene
from jaxgrity.orbits.finding import Orbit, check_periodic, find_orbit
from jaxgrity.orbits.one_cycle import OrbitCycle, orbit_cycle
from jaxgrity.orbits.orbit_stability import stability
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve
from jaxgrity.trust.error_bars import refinement_bar

DRAWS = 4
"""Number of sets of disturbed robots from which a multiplier's error is measured."""
EXTENSIVE = ("duration", "distance", "work", "effort")
"""Names of a cycle's numbers that grow with the number of periods in it."""


class OrbitErrorBars(NamedTuple):
    """The error bar of each number of an orbit at a step; infinite where a rollout failed."""

    speed: float
    """m/s"""
    turning: float
    """rad/s"""
    multiplier: float
    """the largest difference of `Stability.largest` from that of other draws of disturbed robots, and at finer steps"""
    cycle: dict[str, float]
    """of the numbers of `OrbitCycle`, by their names and in their units"""


@typed
def refined_orbit(scene: Scene, duration: float = 120.0, *, options: Options = None) -> tuple[Orbit, float]:
    """The orbit, and the error bar of its speed, m/s, from orbits at half and a quarter of the step.

    The bar is that of `refinement_bar`, plus two standard errors of the speed at the first step; infinite where a
    rollout failed. Arguments and errors are those of `find_orbit`.
    """
    found = [orbit for orbit, _ in _refined(scene, duration, options)]
    return found[0], _speed_bar(found)


@typed
def orbit_error_bars(
    scene: Scene, duration: float = 120.0, *, options: Options = None
) -> tuple[Orbit, OrbitCycle | None, OrbitErrorBars]:
    """The orbit, a cycle of it, and the error bars of all their numbers, from half and a quarter of the step.

    Each bar is that of `refinement_bar`, the speed's as in `refined_orbit`. The number of periods in a cycle may differ
    from step to step; work, effort, distance, duration and multipliers are compared over as many periods.

    Args:
        scene: a scene with a gait whose actuators share one frequency.
        duration: s, as for `find_orbit`.
        options: solver options; by default the scene's.

    Returns:
        Orbit, cycle and bars; no cycle and infinite bars where a rollout failed.

    Raises:
        InputError: as `find_orbit` does.
    """
    refined = _refined(scene, duration, options)
    found = [orbit for orbit, _ in refined]
    if not all(orbit.verified_for for orbit in found):
        return found[0], None, OrbitErrorBars(np.inf, np.inf, np.inf, {})
    cycles = [orbit_cycle(scene, orbit, options=each) for orbit, each in refined]
    coarse, *finer = (_by_the_period(cycle, orbit) for cycle, orbit in zip(cycles, found, strict=True))
    per_cycle = {name: found[0].periods if name in EXTENSIVE else 1 for name in coarse}
    bars = {name: per_cycle[name] * _bar(coarse[name], *(each[name] for each in finer)) for name in coarse}
    largest = [stability(scene, found[0], options=refined[0][1], seed=seed).largest for seed in range(DRAWS)]
    # of so many periods as the first one's cycle has
    largest += [
        stability(scene, orbit, options=each).largest ** (found[0].periods / orbit.periods)
        for orbit, each in refined[1:]
    ]
    multiplier = float(np.abs(np.array(largest[1:]) - largest[0]).max()) if np.isfinite(largest).all() else np.inf
    turning = _bar(*(orbit.turning for orbit in found))
    return found[0], cycles[0], OrbitErrorBars(_speed_bar(found), turning, multiplier, bars)


def _refined(scene: Scene, duration: float, options: Options) -> list[tuple[Orbit, ResolvedOptions]]:
    """Orbits at the step, its half and its quarter."""
    check_periodic(scene, duration)
    resolved = resolve(scene, duration, options, dtype="float64")
    return [(find_orbit(scene, duration, options=each), each) for each in resolved.refined()]


def _speed_bar(found: list[Orbit]) -> float:
    bar = _bar(*(orbit.speed for orbit in found)) + 2 * found[0].standard_error
    return bar if all(orbit.verified_for for orbit in found) else np.inf


def _by_the_period(cycle: OrbitCycle, orbit: Orbit) -> dict[str, float]:
    """The numbers of a cycle; those that grow with it, of one period of it."""
    numbers = {name: value for name, value in cycle._asdict().items() if name != "supports"}
    return {name: value / orbit.periods if name in EXTENSIVE else value for name, value in numbers.items()}


def _bar(*numbers: float) -> float:
    """`refinement_bar` of single numbers."""
    return float(refinement_bar(*(np.array([number]) for number in numbers)))

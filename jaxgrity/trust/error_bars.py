"""Error bars of distances and centres of mass, by step refinement."""

from typing import NamedTuple

import numpy as np

from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import PerGait, Vectors
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene
from jaxgrity.populations.population import simulate_population
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve

SAFETY = 2.5
"""Safety factor of error bars. With 2, bars covered the error of 94 % of the least predictable gaits that we tried.
With 3, bars would be five times the error."""


class Verified(NamedTuple):
    """Distances in float64, each with an error bar from rollouts at smaller steps."""

    distance: PerGait
    """(population,), horizontal displacement of the centre of mass at the first of `steps`, m; NaN for failed robots"""
    error_bar: PerGait
    """(population,), error bar of the centre of mass at the end, m; infinite if any of the simulations failed"""
    com_start: Vectors
    com_end: Vectors
    """(population, 3), centre of mass at the start and at the end, m, at the first of `steps`"""
    steps: tuple[float, float, float]
    """the steps used, s; of an adaptive method, the relative tolerances"""


@typed
def verify(scene: Scene, gaits: Gait, duration: float, *, options: Options = None) -> Verified:
    """Distance of each gait, with an error bar from rollouts at the step, its half and its quarter, all in float64.

    With the centre of mass c, let d1 = |c(dt) - c(dt/2)| and d2 = |c(dt/2) - c(dt/4)|. If every further halving at
    least halves the difference, the error is at most d1 + 2 d2. The error bar is `SAFETY` times that, since a single
    difference may be small by chance. It is an estimate. It covers the error of the time step, not errors of the model;
    docs/accuracy.md has its measured coverage. Adaptive methods are compared at 1, 1/10 and 1/100 of their tolerances.

    Args:
        scene: the scene to simulate.
        gaits: a population of gaits, as from `gaits_of`.
        duration: simulated time, s.
        options: solver options; by default the scene decides. The precision is float64 in any case.

    Returns:
        Distances, error bars and centres of mass, a row for each gait.

    Raises:
        InputError: bad options (see `resolve`), or gaits that do not fit the scene.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> gaits = jaxgrity.gaits_of(scene.gait, jaxgrity.random_phases(3, actuators=6, seed=0))
        >>> verified = jaxgrity.verify(scene, gaits, duration=0.2)
        >>> verified.distance.shape, bool((verified.error_bar < 1e-3).all())
        ((3,), True)
    """
    refuse_traced((scene, gaits, duration), "verify")
    resolved = resolve(scene, duration, options, dtype="float64").refined()
    runs = [simulate_population(scene, gaits, duration, options=each) for each in resolved]
    failed = np.any([np.asarray(run.failure) != 0 for run in runs], axis=0)
    bar = np.where(failed, np.inf, refinement_bar(*(np.asarray(run.com_end) for run in runs)))
    bar = bar + timing_bar(scene, resolved[0])
    first = runs[0]
    coarse, middle, fine = (float(each.rtol if each.dt is None else each.dt) for each in resolved)
    return Verified(
        distance=np.asarray(first.distance()),
        error_bar=bar,
        com_start=np.asarray(first.com_start),
        com_end=np.asarray(first.com_end),
        steps=(coarse, middle, fine),
    )


def timing_bar(scene: Scene, options: ResolvedOptions) -> float:
    """Error of the centre of mass from the timing of short pushes in complementarity stepping, m.

    A push P acts up to h/2 too late or too early, which gives an error of P/m h/2. Refinement does not show it until
    the step is shorter than the push.
    """
    if options.dt is None or not options.method.constrained:
        return 0.0
    late = [term.misplaced(float(options.dt)) for term in scene.terms]
    return sum(late) / float(scene.structure.mass)


def refinement_bar(coarse: np.ndarray, middle: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """Error bar SAFETY (|c1 - c2| + 2 |c2 - c3|), m, of points c1, c2, c3 from a step, its half and its quarter."""
    first, second = np.linalg.norm(coarse - middle, axis=-1), np.linalg.norm(middle - fine, axis=-1)
    return np.asarray(SAFETY * (first + 2 * second))

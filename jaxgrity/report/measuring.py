"""Measurements of a search's gait, for its report."""

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.model.actuation import actuated_lengths, peak_rates
from jaxgrity.model.scene import Scene
from jaxgrity.model.symmetry import gene_permutations, image, standing_symmetries
from jaxgrity.populations.metrics import cost_of_transport
from jaxgrity.populations.population import as_population, simulate_population
from jaxgrity.populations.uncertainty import Differences
from jaxgrity.report.steady import steady_facts
from jaxgrity.search.objectives import ActuatorBounds, SteadyDirection
from jaxgrity.search.paths import stays_within
from jaxgrity.search.pipeline import UNSEEN, SearchResult
from jaxgrity.stepping.methods import default_method
from jaxgrity.stepping.options import SolverOptions
from jaxgrity.stepping.step_limits import default_step
from jaxgrity.trust.error_bars import Verified, verify

WATCHED = 7.5
"""Time for which a gait that is to last is watched, as a multiple of the search's duration."""


def gait_measured(
    result: SearchResult, fine: SolverOptions, tick: Callable[[], None]
) -> tuple[dict[str, Any] | None, list[dict[str, float | None]], dict[str, Any]]:
    """Long-run behaviour of the gait and of perturbed robots; its directions; the loads of actuators,
    and the bound on their rate, m/s or None."""
    scene, problem, steady = result.scene, result.problem, None
    duration, bounds = float(problem.duration), problem.fitness.bounds
    if problem.seeks_orbits:
        # verification has half of the step that was asked for, which this gait may not allow
        step = min(2 * result.levels.verification.dt, default_step(scene, default_method(scene)))
        asked = problem.fitness.objective
        steady = steady_facts(
            scene,
            problem.fitness.uncertainty,
            duration=WATCHED * duration,
            dt=step,
            seed=UNSEEN,
            heading=asked.heading if isinstance(asked, SteadyDirection) else None,
            on_progress=tick,
        )
    found = directions(scene, fine, duration)
    tick()
    given = {**actuators(scene, fine, duration, bounds), "rate_bound": bounds.rate}
    tick()
    return steady, found, given


def verified_stays(scene: Scene, verified: Verified, duration: float) -> bool:
    """Whether the robot stays where it is (`stays_within`) in a verified rollout, by all that its error bar allows."""
    return stays_within(scene, max(float(verified.distance[0]), float(verified.error_bar[0])), duration)


def cost_of_way(scene: Scene, work: float, distance: float, duration: float) -> float | None:
    """`cost_of_transport` from J and m; None for a robot that stays where it is (`stays_within`) in this time, s."""
    return None if stays_within(scene, distance, duration) else float(cost_of_transport(scene, work, distance))


def directions(best: Scene, options: SolverOptions, duration: float) -> list[dict[str, float | None]]:
    """The directions of the gait's images under the robot's symmetry from the same pose, verified one by one.

    The heading (rad from +x) of a robot that stays where it is (`verified_stays`) is None.
    """
    gait = best.gait
    assert gait is not None, "a search finds a gait"
    try:
        turned = standing_symmetries(best)
    except InputError:  # positions do not decide them, as of a robot in a plane
        turned = ()
    images = [image(gait, symmetry) for symmetry in turned if gene_permutations(gait.members, (symmetry,))] or [gait]
    found = []
    for each in images:
        verified = verify(best, as_population(each), duration, options=options)
        x, y, _ = (verified.com_end - verified.com_start)[0]
        heading = None if verified_stays(best, verified, duration) else float(np.arctan2(y, x))
        bar = float(verified.error_bar[0])
        found.append({"heading": heading, "distance": float(verified.distance[0]), "error_bar": bar})
    return found


def actuators(best: Scene, options: SolverOptions, duration: float, bounds: ActuatorBounds) -> dict[str, Any]:
    """The loads of the gait's actuators, and their excess over the bounds (`ActuatorBounds.excess`).

    The cost of transport is that of `cost_of_way`.
    """
    assert best.gait is not None, "a search finds a gait"
    # from rest, and since when, said so that `orbit_cycle` shares the compiled program
    start = Differences(velocities=np.zeros((1, *best.structure.nodes.shape)))
    gaits, since = as_population(best.gait), float(best.gait.start)
    outcomes = simulate_population(best, gaits, duration, options=options, differences=start, with_metrics=since)
    metrics = outcomes.metrics
    assert metrics is not None, "they were asked for"
    distance = float(np.hypot(np.asarray(metrics.moved_x), np.asarray(metrics.moved_y))[0])
    peaks = {name: float(np.max(getattr(metrics, name))) for name in ("peak_rate", "peak_force", "peak_power")}
    works = {name: float(getattr(metrics, name)[0]) for name in ("work", "effort")}
    costs = {f"cost_of_transport_by_{name}": cost_of_way(best, x, distance, duration) for name, x in works.items()}
    rate = np.max(peak_rates(best.gait, actuated_lengths(best.structure, best.gait.members)), keepdims=True)
    return {**peaks, **works, **costs, "excess": float(bounds.excess(rate, metrics)[0])}

"""Long-run behaviour of a gait, as facts for the files of a search."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.model.contact_twin import contact_twin
from jaxgrity.model.scene import Scene
from jaxgrity.orbits.cycles import plane_of
from jaxgrity.orbits.error_bars import OrbitErrorBars, orbit_error_bars
from jaxgrity.orbits.finding import Orbit, period_of, shortest_watch
from jaxgrity.orbits.one_cycle import OrbitCycle
from jaxgrity.orbits.orbit_stability import stability
from jaxgrity.orbits.orbit_symmetry import repetition
from jaxgrity.populations.uncertainty import Uncertainty
from jaxgrity.search.judging import over_robots
from jaxgrity.search.motions import RobotMotions, robot_motions
from jaxgrity.search.paths import stays
from jaxgrity.stepping.methods import default_method
from jaxgrity.stepping.options import SolverOptions
from jaxgrity.stepping.step_limits import default_step

Facts = dict[str, Any]
MODELS = ("robust", "other_contact_model")
"""Names of the two judgements by perturbed robots: on the scene's own contact model, and on the other one."""
ENSEMBLE_TIME, ENSEMBLE_SHARE = 60.0, 0.2
"""Longest time for which perturbed robots roll, s, and its largest share of the time for which the gait is watched. A
quick search watches for a shorter time: on the contact twin, an ensemble of a minute would take as long as all the
rest."""
STAGES = 4
"""Number of parts of the work. Progress is shown after each."""


@typed
def steady_facts(
    scene: Scene,
    uncertainty: Uncertainty,
    *,
    duration: float = 300.0,
    dt: float | None = None,
    seed: int = 0,
    heading: float | None = None,
    on_progress: Callable[[], None] = lambda: None,
) -> Facts:
    """The orbit of a gait, its stability, and the motion of perturbed robots on both contact models.

    Args:
        scene: with a gait of one frequency.
        uncertainty: that of perturbed robots (`robot_motions`).
        duration: s, of the rollout of the gait, and the scale of that of perturbed robots (`ensemble_time`); longer
            where cycles of this gait need it, and a whole number of periods.
        dt: s; by default the scene's own step.
        seed: seed of the draws of robots.
        heading: rad from +x, of the requested direction, if any; the speed along it is then given too.
        on_progress: called `STAGES` times.

    Returns:
        Numbers by their names, in SI units: those of `Orbit`, `OrbitCycle` ("cycle"), their `OrbitErrorBars`,
        `Repetition` ("repetition"), `Stability` and `RobotMotions` ("robust" and "other_contact_model"; along a heading
        in "along_heading"). "stays" says whether the robot stays where it is, and "turns" whether it turns there. Such
        a robot has no cost of transport (None).

    Raises:
        InputError: as `find_orbit` and `robot_motions` do.
    """
    step = default_step(scene, default_method(scene)) if dt is None else dt
    options, least = SolverOptions(dt=step), shortest_watch(scene.gait)
    watched = float(np.ceil(max(duration, least) / period_of(scene.gait)) * period_of(scene.gait))
    orbit, cycle, bars = orbit_error_bars(scene, watched, options=options)
    on_progress()
    span = ensemble_time(duration)
    robots = _over_robots(scene, uncertainty, span, step, orbit.cycle if orbit.settled else None, seed, on_progress)
    held = stability(scene, orbit, options=options) if orbit.verified_for else None
    on_progress()
    return {
        **orbit.summary(),
        **_standing(scene, orbit, bars),
        "speed_error_bar": bars.speed,
        "turning_error_bar": bars.turning,
        "yaw_excluded": plane_of(scene).turns,
        "multiplier": None if held is None else held.largest,
        "multiplier_error_bar": bars.multiplier,
        "multipliers": None if held is None else np.abs(held.multipliers).tolist(),
        "cycle": None if cycle is None else _cycle_facts(scene, orbit, cycle, bars),
        "repetition": _repetition(scene, orbit, options) if orbit.verified_for else None,
        "spread": None if held is None else held.spread,
        "returned": None if held is None else held.returned,
        "other_contact_model": robots.other.summary(),
        "robust": _with_mean(robots),
        "along_heading": None if heading is None else _along(heading, orbit, robots),
    }


def _standing(scene: Scene, orbit: Orbit, bars: OrbitErrorBars) -> Facts:
    """Whether the robot stays where it is (`stays`), by all that the error bar allows, and whether it turns: by more
    than the error bar, and so far that a point at one body length from its centre would not stay where it is."""
    around = abs(orbit.turning) * orbit.body_length
    turns = not stays(scene, around) and not abs(orbit.turning) <= bars.turning < np.inf
    fastest = max(orbit.speed, bars.speed)  # an unknown bar is infinite or NaN, and such a robot is not known to stay
    return {"stays": bool(np.isfinite(fastest) and stays(scene, fastest)), "turns": bool(turns)}


def _cycle_facts(scene: Scene, orbit: Orbit, cycle: OrbitCycle, bars: OrbitErrorBars) -> Facts:
    """The cycle's numbers with their error bars; a robot that stays where it is transports nothing."""
    facts, errors = cycle.summary(), Facts(bars.cycle)
    if "cost_of_transport" in errors and stays(scene, orbit.speed):
        facts["cost_of_transport"] = errors["cost_of_transport"] = None
    return facts | {"error_bars": errors}


def ensemble_time(duration: float) -> float:
    """The time for which perturbed robots roll, s, for a gait that is watched for `duration`, s."""
    return min(ENSEMBLE_TIME, ENSEMBLE_SHARE * duration)


def _repetition(scene: Scene, orbit: Orbit, options: SolverOptions) -> Facts | None:
    """None where positions do not decide the symmetries, as of a robot in a plane."""
    try:
        return repetition(scene, orbit, options=options)._asdict()
    except InputError:
        return None


class _Robots(NamedTuple):
    """Perturbed robots on the own model and on its contact twin."""

    own: RobotMotions
    other: RobotMotions
    step_error: float
    """m/s, by which the mean speed on the own model changes with half of the step, of robots that failed at neither"""


def _over_robots(
    scene: Scene,
    uncertainty: Uncertainty,
    span: float,
    step: float,
    cycle: float | None,
    seed: int,
    on_progress: Callable[[], None],
) -> _Robots:
    """Perturbed robots on the own model and on its contact twin, for a time `span`, s."""
    same: Facts = {"duration": span, "cycle": cycle, "seed": seed}
    coarse, fine = (
        robot_motions(scene, uncertainty, **same, options=SolverOptions(dt=dt, dtype="float32"))
        for dt in (step, step / 2)
    )
    on_progress()
    twin = contact_twin(scene)
    options = SolverOptions(dt=default_step(twin, default_method(twin)), dtype="float32")
    other = robot_motions(twin, uncertainty, **same, options=options)
    on_progress()
    return _Robots(fine, other, abs(over_robots(fine.speed - coarse.speed)["mean"]))


def _with_mean(robots: _Robots) -> Facts:
    """Robots of the own model; the speed is the mean of a search's."""
    found = robots.own.summary()
    return {"mean": found.pop("speed"), **found, "step_error": robots.step_error}


def _along(heading: float, orbit: Orbit, robots: _Robots) -> Facts:
    """Horizontal speeds along a heading, m/s, of the orbit, and of robots on both contact models."""
    way = np.array([np.cos(heading), np.sin(heading)])
    told: Facts = {"heading": heading, "speed": float(np.array(orbit.velocity) @ way)}
    return told | {name: over_robots(each.velocity @ way) for name, each in zip(MODELS, (robots.own, robots.other))}


def on_orbit(steady: Facts, duration: float) -> bool:
    """Whether a rollout of this duration, s, ends with a whole cycle of the orbit."""
    return steady["settled"] and first_cycle(steady) <= duration


def first_cycle(steady: Facts) -> float:
    """When the first whole cycle of the orbit ends, s."""
    return steady["settled_after"] + steady["period"] * steady["periods"]


def moves(steady: Facts) -> bool:
    """Whether the robot goes somewhere on its orbit: faster than one that stays, and than the error bar of its speed.

    An error bar that is not known counts as none.
    """
    bar = steady["speed_error_bar"]
    lost = bar is not None and np.isfinite(bar) and steady["speed"] <= bar
    return not steady.get("stays", False) and not lost

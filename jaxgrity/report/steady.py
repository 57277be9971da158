"""Long-run behaviour of a gait: facts for the files of a search, and rows of a report."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxgrity.core.display import counted_robots, in_digits, mean_of_robots, significant, with_error
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.model.contact_twin import contact_twin
from jaxgrity.model.scene import Scene
from jaxgrity.orbits.cycles import plane_of
from jaxgrity.orbits.error_bars import orbit_error_bars
from jaxgrity.orbits.finding import SETTLED, WINDOW, Orbit, period_of, shortest_watch
from jaxgrity.orbits.orbit_stability import stability
from jaxgrity.orbits.orbit_symmetry import repetition
from jaxgrity.populations.uncertainty import Uncertainty
from jaxgrity.search.judging import over_robots
from jaxgrity.search.motions import RobotMotions, robot_motions
from jaxgrity.stepping.methods import default_method
from jaxgrity.stepping.options import SolverOptions
from jaxgrity.stepping.step_limits import default_step

Facts = dict[str, Any]
MODELS = ("robust", "other_contact_model")
"""Names of the two judgements by perturbed robots: on the scene's own contact model, and on the other one."""
NOT_LASTING = "this gait does not last; try another seed, or a longer search"
"""What a report says of a gait without an orbit."""
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
        in "along_heading").

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
        "speed_error_bar": bars.speed,
        "turning_error_bar": bars.turning,
        "yaw_excluded": plane_of(scene).turns,
        "multiplier": None if held is None else held.largest,
        "multiplier_error_bar": bars.multiplier,
        "multipliers": None if held is None else np.abs(held.multipliers).tolist(),
        "cycle": None if cycle is None else cycle.summary() | {"error_bars": bars.cycle},
        "repetition": _repetition(scene, orbit, options) if orbit.verified_for else None,
        "spread": None if held is None else held.spread,
        "returned": None if held is None else held.returned,
        "other_contact_model": robots.other.summary(),
        "robust": _with_mean(robots),
        "along_heading": None if heading is None else _along(heading, orbit, robots),
    }


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


def steady_rows(steady: Facts) -> dict[str, str]:
    """The orbit in words, by row headings of the report."""
    if not steady["settled"]:
        return {"orbit": f"none: {_restless(steady)}; {NOT_LASTING}"}
    own, other, cycle = steady["robust"], steady["other_contact_model"], steady["period"] * steady["periods"]
    slowest, since = steady["slowest_window"], steady["settled_after"]
    lengths = steady["body_lengths_per_second"]
    multiplier = with_error(steady["multiplier"], steady["multiplier_error_bar"])
    turned, off = (float(np.degrees(steady[name])) for name in ("turning", "turning_error_bar"))
    turning = with_error(turned, off, " °/s")
    slow = f"; slowest {steady.get('window', WINDOW):.3g} s after that: "
    slow = "" if slowest is None else f"{slow}{significant(slowest)} m/s"
    neutral = "translation and yaw" if steady.get("yaw_excluded", True) else "translation"
    # robots of a gait that settles late count while they settle
    counted = own.get("counted_from", np.inf)
    begun, late = significant(counted, 0, 2), counted < since and significant(counted, 0, 2) != significant(since, 0, 2)
    early = f" from {begun} s on, before the gait settles" if late else ""
    held = f"largest Floquet multiplier {multiplier} per cycle ({neutral} excluded; measured over two cycles); "
    back = f"{100 * steady['returned']:.0f} % of disturbed robots return"
    return {
        "speed": with_error(steady["speed"], steady["speed_error_bar"], " m/s")
        + f" ({significant(lengths)} body lengths/s)",
        "lasts": f"watched for {significant(steady['verified_for'], 0, 2)} s; settles after "
        f"{significant(since, 0, 2)} s{slow}",
        "turning": f"{turning}; half of the perturbed robots bend by {_bends(own)} per body length, on the other "
        f"contact model by {_bends(other)}",
        **_headed(steady["along_heading"]),
        "stability": (held if np.isfinite(steady["multiplier"]) else "") + back,
        "cycle": f"{significant(cycle, 2)} s, {steady['periods']} period{'s' * (steady['periods'] != 1)} of actuation; "
        "shapes one cycle apart differ by "
        f"{in_digits(1000 * steady['residual'], 2)} mm"
        + _repeats(steady["repetition"], cycle)
        + (f"; stands on the faces {_faces(steady['cycle'])} in turn" if steady["cycle"] else ""),
        "both contact models": f"{mean_of_robots(own, 'm/s')} over {counted_robots(own['robots'])}{early}; "
        f"{mean_of_robots(other, 'm/s', 'speed')} on the other contact model",
    }


def on_orbit(steady: Facts, duration: float) -> bool:
    """Whether a rollout of this duration, s, ends with a whole cycle of the orbit."""
    return steady["settled"] and first_cycle(steady) <= duration


def first_cycle(steady: Facts) -> float:
    """When the first whole cycle of the orbit ends, s."""
    return steady["settled_after"] + steady["period"] * steady["periods"]


def _restless(steady: Facts) -> str:
    """Why there is no orbit, in words."""
    if not steady["verified_for"]:
        return "the rollout failed"
    if steady["residual"] <= SETTLED * steady["body_length"]:
        turning = in_digits(np.degrees(steady["turning"]), 2)
        return f"the robot turns by {turning} °/s; on a slope or in wind no orbit turns"
    change, watched = in_digits(steady["residual"], 2), significant(steady["verified_for"], 0, 2)
    return f"in the later half of {watched} s the shape changes by up to {change} m over a cycle"


def _headed(along: Facts | None) -> dict[str, str]:
    """Horizontal speed of a gait along the requested heading, in words; empty if no heading was requested."""
    if along is None:
        return {}
    own, other = (mean_of_robots(along[k], "m/s") for k in MODELS)
    return {
        "along its heading": f"{significant(along['speed'])} m/s, horizontally; perturbed robots {own}, "
        f"on the other contact model {other}"
    }


def _repeats(found: Facts | None, cycle: float) -> str:
    """Number of symmetry-equivalent segments per cycle, in words; empty if the cycle is one segment."""
    times = 1 if found is None else round(cycle / found["time"])
    if found is None or times == 1:
        return ""
    apart = in_digits(1000 * found["residual"], 2)
    return f"; {times} symmetry-equivalent segments per cycle, which differ by {apart} mm"


def _faces(cycle: Facts) -> str:
    return ", ".join("-".join(map(str, face)) for face in cycle["supports"]) or "no face that lasts"


def _bends(robots: Facts) -> str:
    """Lower and upper quartile of the bends, in words."""
    if robots["bend"] is None:
        return "no known angle"
    low, high = (round(np.degrees(each)) + 0.0 for each in robots["bend_quartiles"])
    return f"{low:.0f}° to {high:.0f}°"

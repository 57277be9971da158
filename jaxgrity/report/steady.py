"""What becomes of a gait in the long run: facts for a search's files, and a line for people."""

from typing import Any

import numpy as np

from jaxgrity.search.fidelity import Verdict, final_verdict
from jaxgrity.search.judging import Fitness
from jaxgrity.search.objectives import SteadySpeed
from jaxgrity.search.pipeline import UNSEEN, SearchResult
from jaxgrity.stepping.options import SolverOptions
from jaxgrity.stepping.stability import default_method, default_step
from jaxgrity.trust.orbit_cycle import orbit_cycle
from jaxgrity.trust.orbits import WINDOW, find_orbit, period_of, refined_orbit, shortest_watch, stability

WATCHED = 7.5
"""times the search's duration, for which a gait that is to last is watched"""


def steady_facts(result: SearchResult) -> dict[str, Any]:
    """The orbit that the gait settles on, how stable it is, and what remains of its speed on the other contact model.

    SI units; the speeds of ensembles are displacements over the settled part of the search's duration, whatever the
    objective was.
    """
    scene = result.scene
    # the last level has half of the step that was asked for, which this gait may not allow
    step = min(2 * result.levels[-1].dt, default_step(scene, default_method(scene)))
    options = SolverOptions(dt=step)
    least = shortest_watch(scene.gait)
    watched = max(WATCHED * float(result.problem.duration), least)
    watched = float(np.ceil(watched / period_of(scene.gait)) * period_of(scene.gait))
    orbit = find_orbit(scene, watched, options=options)
    _, bar = refined_orbit(scene, max(watched / 3, least), options=options)
    held = stability(scene, orbit, options=options) if orbit.verified_for else None
    size, found = orbit.body_length, _speeds(result, step).summary()

    def in_metres(facts: dict[str, Any], *names: str) -> dict[str, Any]:
        return {name: None if facts[name] is None else size * facts[name] for name in names}

    return {
        **orbit.summary(),
        "speed_error_bar": bar,
        "multiplier": None if held is None else held.largest,
        "cycle": orbit_cycle(scene, orbit, options=options).summary() if orbit.verified_for else None,
        "spread": None if held is None else held.spread,
        "returned": None if held is None else held.returned,
        "other_contact_model": {
            "speed": size * found["other_contact_model"]["mean"],
            **in_metres(found["other_contact_model"], "standard_deviation"),
        },
        "robust": in_metres(found["robust"], "mean", "standard_deviation", "standard_error", "step_error"),
    }


def _speeds(result: SearchResult, step: float) -> Verdict:
    """The verdict on the gait's steady speed; that of the search where speed was its objective."""
    if type(result.problem.fitness.objective) is SteadySpeed:
        return result.verdict
    problem, uncertain = result.problem, result.problem.fitness.uncertainty
    speed = Fitness(SteadySpeed(), uncertain, problem.fitness.robots)
    return final_verdict(problem._replace(fitness=speed), result.gait, dt=step / 2, seed=UNSEEN)


def steady_rows(steady: dict[str, Any]) -> dict[str, str]:
    """The orbit in words for people, by their headings."""
    if not steady["settled"]:
        return {"orbit": f"none: shapes still change by {steady['residual']:.2g} m over a cycle"}
    own, other, cycle = steady["robust"], steady["other_contact_model"], steady["period"] * steady["periods"]
    slowest, since = steady["slowest_window"], steady["settled_after"]
    lengths = steady["body_lengths_per_second"]
    held = f"a disturbance is multiplied by {steady['multiplier']:.2g} in a cycle; "
    back = f"{100 * steady['returned']:.0f} % of the robots that are disturbed return"
    return {
        "speed": f"{steady['speed']:.3f} ± {steady['speed_error_bar']:.1g} m/s ({lengths:.3f} body lengths a second)",
        "lasts": f"watched for {steady['verified_for']:.0f} s; settled after {since:.0f} s, "
        f"and then in no {WINDOW:g} s slower than {slowest:.3f} m/s",
        "turning": f"{round(np.degrees(steady['turning']), 2) + 0.0:.2f}°/s",
        "stability": (held if np.isfinite(steady["multiplier"]) else "") + back,
        "cycle": f"{cycle:.2f} s, {steady['periods']} periods of actuation; its shape returns to "
        f"{1000 * steady['residual']:.2g} mm",
        "both contact models": f"{own['mean']:.3f} ± {own['standard_deviation']:.2g} m/s over robots that differ; "
        f"{other['speed']:.3f} ± {other['standard_deviation']:.2g} m/s on the other model",
    }

"""What a search found, and how far that can be trusted, in words by their headings."""

from typing import Any

import numpy as np

from jaxgrity.core.display import mean_of_robots, significant, with_error
from jaxgrity.populations.rolling import Rolling
from jaxgrity.report import plot
from jaxgrity.report.steady import steady_rows


def outcome_rows(summary: dict[str, Any]) -> dict[str, str]:
    """What the gait does and what it needs, in words, by headings."""
    steady, asked = summary["steady"], summary["actuators"]
    return {
        **({"verified distance": distance_words(summary)} if steady is None else steady_rows(steady)),
        "actuators must give": f"up to {asked['peak_force']:.3g} N, {asked['peak_rate']:.2g} m/s, "
        f"{asked['peak_power']:.3g} W; cost of transport {_cost_of_transport(summary)}" + _beyond(summary),
    }


def _cost_of_transport(summary: dict[str, Any]) -> str:
    """Along the path of the orbit, where there is one."""
    steady = summary["steady"]
    if steady is not None and steady["cycle"] is not None:
        return f"{steady['cycle']['cost_of_transport']:.2g} (own work of every actuator / (m g d), d along its path)"
    by_distance = summary["actuators"]["cost_of_transport_by_effort"]
    return f"{by_distance:.2g} (own work of every actuator / (m g d), d from where it began)"


def _beyond(summary: dict[str, Any]) -> str:
    """What is said of bounds on actuators that the gait exceeds."""
    if not summary["within_bounds"]:
        return "; no gait was found that stays within the bounds on actuators"
    share = summary["beyond_bounds"]
    told = "under 1" if share < 0.005 else f"{100 * share:.0f}"
    return f"; {told} % of the robots that differ exceed a bound on actuators" if share else ""


def search_rows(summary: dict[str, Any], motion: Rolling | None, unit: str) -> dict[str, str]:
    """How the gait was found and how far that can be trusted, in words; `unit` is the objective's."""
    robust, other = summary["robust"], summary["other_contact_model"]
    ranks = summary["fidelity"]["rank_correlation"][0][-1]
    among = summary["fidelity"]["rank_correlation_of_the_evolved"][0][-1]
    last = summary["fidelity"]["levels"][-1]["name"]
    rollouts = sum(search["rollouts"] for search in summary["searches"])
    verified = {} if summary["steady"] is None else {"verified distance": distance_words(summary)}
    return {
        **verified,
        "motion": "no ground, or no motion" if motion is None else motion.sentence(),
        "directions": ", ".join(
            f"{significant(d['distance'], 2)} m towards {np.degrees(d['heading']):.0f}°" for d in summary["directions"]
        ),
        "objective": f"{mean_of_robots(robust, unit)} over {robust['robots']} robots that differ, step error "
        f"{robust['step_error']:.1g}; {mean_of_robots(other, unit)} on the other contact model",
        "search": f"{rollouts} rollouts; screening ranks gaits as {last} does with {plot.ranked(ranks)} (Spearman; "
        f"{plot.ranked(among)} among the evolved)",
        **_chosen(**summary["finalists"]),
        "polish": "none" if summary["polish"] is None else summary["polish"]["reason"],
        "sensitivity at the end": f"{summary['diagnosis'].get('sensitivity', np.nan):.3g} m/rad",
    }


def _chosen(fitness: list[float], multipliers: list[float] | None) -> dict[str, str]:
    """By how much the finalists' orbits multiply disturbances, the chosen one's first; whether it is worth most."""
    if multipliers is None:
        return {}
    known = [f"{each:.2g}" for each in multipliers if np.isfinite(each)]
    lost, most = len(multipliers) - len(known), max(fitness)
    first = (
        "is worth most"
        if fitness[0] == most
        else f"is worth {significant(fitness[0])}, the best of them {significant(most)}"
    )
    if known and not np.isfinite(multipliers[0]):
        first = f"is none of these, and {first}"
    if not known:
        told = "none settles on an orbit to which disturbed robots return"
    else:
        rest = f"; {lost} of {len(multipliers)} settle on no orbit to which disturbed robots return" if lost else ""
        told = f"their orbits multiply a disturbance in one cycle by {', '.join(known)}{rest}"
    return {"finalists": f"{told}; the first {first}"}


def distance_words(summary: dict[str, Any]) -> str:
    """The distance with its error bar, where that says anything."""
    known, told = summary["error_bar"] <= summary["distance"], f"in {summary['duration']:g} s"
    if known:
        return f"{with_error(summary['distance'], summary['error_bar'], ' m')} {told}"
    moved = significant(summary["distance"], 2, 2)
    return f"{moved} m {told} at this time step; where the robot gets to depends on the step"

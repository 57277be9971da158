"""The result of a search, and how far to trust it, in words, by row headings of the report."""

import math
from typing import Any

import numpy as np

from jaxgrity.core.display import (
    counted_robots,
    finite_or,
    in_digits,
    known_words,
    mean_of_robots,
    significant,
    with_error,
)
from jaxgrity.orbits.finding import IN_TIME
from jaxgrity.populations.motion_kinds import Rolling
from jaxgrity.report import plot
from jaxgrity.report.steady import first_cycle, moves, on_orbit
from jaxgrity.report.steady_words import NOT_LASTING, TURNING_DIGITS, steady_rows
from jaxgrity.search.objectives import Objective
from jaxgrity.search.paths import SETTLING_SHARE
from jaxgrity.search.promotion import multiplier_words, orbit_words


def leading_sentences(summary: dict[str, Any]) -> tuple[str, ...]:
    """How fast and how straight, how sure, and what it asks of actuators: what a reader should know first."""
    steady, asked = summary["steady"], summary["actuators"]
    needs = "An actuator needs up to {}, {} and {}, the start included.".format(*peaks(asked))
    if steady is None:
        return _way_sentence(summary), needs
    if not steady["settled"]:
        return f"The robot settles on no orbit: {NOT_LASTING}.", needs
    size, own, other = steady["body_length"], steady["robust"], steady["other_contact_model"]
    return (
        _moves_sentence(steady),
        f"The speed of {counted_robots(own['robots'])} is {_in_lengths(own, size, 'mean')}, and on the other contact "
        f"model {_in_lengths(other, size, 'speed')}.",
        needs,
    )


def _moves_sentence(steady: dict[str, Any]) -> str:
    """How fast and how straight a robot moves on its orbit; that it stays where it is, or that its speed is lost."""
    lengths, error = steady["body_lengths_per_second"], steady["speed_error_bar"] / steady["body_length"]
    unit, moving = " body lengths per second", moves(steady)
    if not moving and not steady.get("stays", False):
        found = with_error(lengths, error, unit)
        return f"Whether the robot moves is not known: its speed is {found}; take a smaller step."
    told = f"The robot moves at {with_error(lengths, error, unit)}" if moving else "The robot stays where it is"
    if not moving and not steady.get("turns", False):
        return f"{told}."
    turning, off = (float(np.degrees(steady[name])) for name in ("turning", "turning_error_bar"))
    # of a circle narrower than two body lengths, as about the spot, the time says more than the way
    travels = moving and abs(steady["turning"]) < lengths
    way = lengths if travels else 1.0
    turn = with_error(abs(turning) / way, off / way, "°", decimals=TURNING_DIGITS)
    side = "" if abs(turning) <= off or not np.isfinite(off) else f" to the {'left' if turning > 0 else 'right'}"
    return f"{told} and turns by {turn} per {'body length' if travels else 'second'}{side}."


def _way_sentence(summary: dict[str, Any]) -> str:
    """How far a robot goes for which no orbit is sought."""
    if summary.get("stays", False):
        return "The robot stays where it is."
    if summary["error_bar"] > summary["distance"]:
        return f"How far the robot goes is {distance_words(summary)}."
    return f"The robot goes {distance_words(summary)}."


def _in_lengths(robots: dict[str, Any], size: float, mean: str) -> str:
    """A mean speed of perturbed robots, m/s, in body lengths of `size`, m."""
    known = (mean, "standard_error", "standard_deviation")
    scaled = {name: None if robots[name] is None else robots[name] / size for name in known}
    return mean_of_robots({**robots, **scaled}, "body lengths per second", mean)


def peaks(asked: dict[str, Any]) -> tuple[str, str, str]:
    """Largest force, rate and power of the actuators, in words."""
    force, rate, power = (asked[f"peak_{name}"] for name in ("force", "rate", "power"))
    return f"{in_digits(force)} N", f"{in_digits(rate, 2)} m/s", f"{in_digits(power)} W"


def outcome_rows(summary: dict[str, Any]) -> dict[str, str]:
    """What the gait does and needs, in words, by row headings."""
    steady, asked = summary["steady"], summary["actuators"]
    late = steady is not None and steady["settled"] and not on_orbit(steady, summary["duration"])
    early = f" in the first {summary['duration']:g} s, before a whole cycle of the orbit" if late else ""
    unseen = {}
    if steady is not None and late:
        ends, whole = f"{summary['duration']:g} s", in_digits(first_cycle(steady))
        unseen["picture of the orbit"] = f"none: the motion ends after {ends}, the first whole cycle after {whole} s"
    return {
        **({"verified distance": distance_words(summary)} if steady is None else steady_rows(steady)),
        "actuators need": f"up to {', '.join(peaks(asked))}{early}{_cost_of_transport(summary)}"
        + _in_the_ramp(summary)
        + _beyond(summary),
        **unseen,
    }


def _cost_of_transport(summary: dict[str, Any]) -> str:
    """Along the path of the orbit, where there is one; empty for a robot that stays where it is."""
    steady, cost, way = summary["steady"], summary["actuators"]["cost_of_transport_by_effort"], "from the start"
    if steady is not None and steady["settled"] and steady["cycle"] is not None:
        cost, way = steady["cycle"]["cost_of_transport"], "along the path"
        cost = cost if moves(steady) else None
    return (
        "" if cost is None else f"; cost of transport {in_digits(cost, 2)} (work of every actuator / (m g d), d {way})"
    )


def _in_the_ramp(summary: dict[str, Any]) -> str:
    """Whether a gait within the bounds, which count after the ramp, exceeds that on the rate before, in words."""
    peak, bound = (summary["actuators"][name] for name in ("peak_rate", "rate_bound"))
    if bound is None or peak <= bound or not summary["within_bounds"]:
        return ""
    return f"; the rate exceeds its bound of {bound:g} m/s, but only in the gait's ramp"


def _beyond(summary: dict[str, Any]) -> str:
    """By how much the gait, and which share of its perturbed robots, exceed the bounds on actuators, in words."""
    told, share = "", summary["beyond_bounds"]
    if not summary["within_bounds"]:
        over = in_digits(100 * summary["actuators"]["excess"], 2)
        told = f"; this exceeds its bounds by {over} %, added up over them"
    if not share or summary["robust"]["robots"] == 1:
        return told
    some = "under 1" if share < 0.005 else f"{100 * share:.0f}"
    return f"{told}; {some} % of perturbed robots exceed a bound on actuators"


def search_rows(summary: dict[str, Any], motion: Rolling | None, objective: Objective) -> dict[str, str]:
    """How the gait was found, and how far to trust it, in words."""
    unit = objective.unit
    ranks = summary["fidelity"]["rank_correlation"][0][-1]
    among = summary["fidelity"]["rank_correlation_of_the_evolved"][0][-1]
    last = summary["fidelity"]["levels"][-1]["name"]
    rollouts = sum(search["rollouts"] for search in summary["searches"])
    verified = {} if summary["steady"] is None else {"verified distance": distance_words(summary)}
    late = late_words(summary["start"] + summary["ramp"], summary["duration"])
    return {
        **verified,
        "motion": "no ground, or no motion" if motion is None else motion.sentence(),
        **_directions(summary["directions"]),
        "objective": objective_words(summary, unit) + (f"; it {late}" if objective.steady and late else ""),
        "search": f"{rollouts} rollouts of the evolution; rank correlation (Spearman) of screening with {last}: "
        f"{plot.ranked(ranks)}; among evolved gaits {plot.ranked(among)}",
        **_curse(summary, last, unit),
        **_chosen(**summary["finalists"]),
        "polish": "none" if summary["polish"] is None else summary["polish"]["reason"],
        "sensitivity at the end": finite_or(summary["diagnosis"].get("sensitivity", np.nan), "m/rad", "not known"),
    }


def objective_words(summary: dict[str, Any], unit: str) -> str:
    """The objective's mean over perturbed robots on both contact models, and how it depends on the time step.

    That of a step and its half differ by half of the first one's error, where errors are of first order.
    """
    robust, other = summary["robust"], summary["other_contact_model"]
    count = other.get("robots", robust["robots"])
    others = "" if count == robust["robots"] else f" over {counted_robots(count)}"
    return (
        f"{mean_of_robots(robust, unit)} over {counted_robots(robust['robots'])}, differs by "
        f"{finite_or(robust['step_error'], unit, 'an unknown amount')} between two time steps, one half of the other; "
        f"{mean_of_robots(other, unit)}{others} on the other contact model"
    )


def _curse(summary: dict[str, Any], level: str, unit: str) -> dict[str, str]:
    """The best fitness by the draws that chose it, beside that of the finalist that goes on, by fresh ones; each with
    its fidelity level."""
    evolved, fresh = summary["searches"][-1], summary["finalists"]["fitness"][0]
    best, chosen = (f"{significant(each)} {unit}".rstrip() for each in (evolved["best"][-1], fresh))
    beyond = "" if evolved["within"][-1] else ", of gaits beyond their bounds"
    own = summary["fidelity"]["levels"][len(summary["searches"]) - 1]["name"]  # gaits evolve on the first of the levels
    return {
        "fitness": f"{best}, best of the last generation ({own}){beyond}, by the draws that chose it; {chosen}, the "
        f"chosen finalist, by fresh ones that compare finalists ({level})"
    }


def _directions(found: list[dict[str, Any]]) -> dict[str, str]:
    """The way of the gait, and of its images under the robot's symmetry; none of a robot that stays where it is."""
    if not found or any(each["heading"] is None for each in found):
        return {}
    own, *images = map(_direction, found)
    known = " (0° is along x, 90° along y)" if "towards" in own else ""
    symmetric = ". The robot is symmetric: with its actuators relabelled by that symmetry, the same gait goes "
    return {"directions": f"{own}{known}" + (symmetric + ", or ".join(images) if images else "")}


def _direction(verified: dict[str, Any]) -> str:
    """A distance with its error bar, and the heading where the bar leaves one, in words."""
    distance, bar = verified["distance"], verified["error_bar"]
    known = with_error(distance, bar, " m")
    if not bar < distance:
        return f"a way that is not known ({known})"
    return f"{known} towards {round(np.degrees(verified['heading']))}°"


def late_words(swing: float, duration: float) -> str:
    """What a steady objective counts for a gait that is in full swing too late, in words; times are in s."""
    settled = SETTLING_SHARE * duration
    if swing <= settled:
        return ""
    told = f"counts the time from {in_digits(settled)} s on, but the gait is in full swing from {in_digits(swing)} s on"
    enough = swing / SETTLING_SHARE
    last = 10.0 ** (math.floor(math.log10(enough)) - 2)  # of three digits, rounded up: with less it would be late again
    return f"{told}: search with a duration of {math.ceil(enough / last - 1e-9) * last:g} s or more"


def _chosen(fitness: list[float], multipliers: list[float] | None) -> dict[str, str]:
    """Floquet multipliers of the finalists, the chosen one first; whether it has the best fitness."""
    if multipliers is None:
        return {}
    known = [multiplier_words(each) for each in multipliers if np.isfinite(each)]
    lost, most = len(multipliers) - len(known), max(fitness)
    first = (
        "has the best fitness"
        if fitness[0] == most
        else f"has fitness {significant(fitness[0])}, the best of them {significant(most)}"
    )
    if known and not np.isfinite(multipliers[0]):
        first = f"is none of these, and {first}"
    if not known:
        told = f"none settles on an orbit that attracts disturbed robots, {IN_TIME}"
    else:
        rest = f"; {lost} of {len(multipliers)} settle on {orbit_words(np.inf)}" if lost else ""
        told = f"largest Floquet multipliers per cycle {', '.join(known)}{rest}"
    return {"finalists": f"{told}; the chosen one {first}"}


def distance_words(summary: dict[str, Any]) -> str:
    """The distance with its error bar; that it is not known if the error bar exceeds it, or that the robot stays."""
    if summary.get("stays", False):
        return "less than a hundredth of a body length: the robot stays where it is"
    told = known_words(summary["distance"], summary["error_bar"], " m")
    return told if summary["error_bar"] > summary["distance"] else f"{told} in {summary['duration']:g} s"

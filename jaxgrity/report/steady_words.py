"""Long-run behaviour of a gait in words, as rows of a report."""

import numpy as np

from jaxgrity.core.display import counted_robots, in_digits, known_words, mean_of_robots, significant, with_error
from jaxgrity.orbits.finding import SETTLED, WINDOW
from jaxgrity.report.steady import MODELS, Facts, moves

NOT_LASTING = "this gait does not last; try another seed, or a longer search"
"""What a report says of a gait without an orbit."""
TURNING_DIGITS, MOST_FACES = 3, 8
"""Most decimals of a turning, °/s, and most faces of a cycle that a report lists."""


def steady_rows(steady: Facts) -> dict[str, str]:
    """The orbit in words, by row headings of the report."""
    if not steady["settled"]:
        return {"orbit": f"none: {_restless(steady)}; {NOT_LASTING}"}
    own, other, cycle = steady["robust"], steady["other_contact_model"], steady["period"] * steady["periods"]
    slowest, since, still = steady["slowest_window"], steady["settled_after"], not moves(steady)
    multiplier = with_error(steady["multiplier"], steady["multiplier_error_bar"])
    slow = f"; slowest {steady.get('window', WINDOW):.3g} s after that: "
    slow = "" if slowest is None or still else f"{slow}{significant(slowest)} m/s"
    neutral = "translation and yaw" if steady.get("yaw_excluded", True) else "translation"
    # robots of a gait that settles late count while they settle
    counted = own.get("counted_from", np.inf)
    begun, late = significant(counted, 0, 2), counted < since and significant(counted, 0, 2) != significant(since, 0, 2)
    early = f" from {begun} s on, before the gait settles" if late else ""
    held = f"largest Floquet multiplier {multiplier} per cycle ({neutral} excluded; measured over two cycles); "
    back = f"{100 * steady['returned']:.0f} % of disturbed robots return"
    return {
        "speed": _speed(steady),
        "lasts": f"watched for {significant(steady['verified_for'], 0, 2)} s; settles after "
        f"{significant(since, 0, 2)} s{slow}",
        **_turning(steady),
        **({} if still else _headed(steady["along_heading"])),
        "stability": (held if np.isfinite(steady["multiplier"]) else "") + back,
        "cycle": f"{significant(cycle, 2)} s, {steady['periods']} period{'s' * (steady['periods'] != 1)} of actuation; "
        "shapes one cycle apart differ by "
        f"{in_digits(1000 * steady['residual'], 2)} mm"
        + _repeats(steady["repetition"], cycle)
        + (f"; stands on the faces {_faces(steady['cycle'])} in turn" if steady["cycle"] else ""),
        "both contact models": f"{mean_of_robots(own, 'm/s')} over {counted_robots(own['robots'])}{early}; "
        f"{mean_of_robots(other, 'm/s', 'speed')} on the other contact model",
    }


def _speed(steady: Facts) -> str:
    """Speed of the orbit; that the robot stays where it is, or that its speed is not known."""
    if steady.get("stays", False):
        return "0: the robot stays where it is"
    told = known_words(steady["speed"], steady["speed_error_bar"], " m/s")
    return told + (f" ({significant(steady['body_lengths_per_second'])} body lengths/s)" if moves(steady) else "")


def _turning(steady: Facts) -> dict[str, str]:
    """Turning of the gait and bends of the perturbed robots; of a robot that stays where it is only whether it turns
    there."""
    turned, off = (float(np.degrees(steady[name])) for name in ("turning", "turning_error_bar"))
    turning = with_error(turned, off, " °/s", decimals=TURNING_DIGITS)
    if not moves(steady):
        return {"turning": f"{turning}, on the spot"} if steady.get("turns", False) else {}
    own, other = (steady[name] for name in MODELS)
    some = " that move" if own.get("stay", 0) or other.get("stay", 0) else ""
    return {
        "turning": f"{turning}; half of the perturbed robots{some} bend by {_bends(own)} per body length, on the other "
        f"contact model by {_bends(other)}"
    }


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
    names = ["-".join(map(str, face)) for face in cycle["supports"]]
    more = f" and {len(names) - MOST_FACES} more" if len(names) > MOST_FACES else ""
    return (", ".join(names[:MOST_FACES]) or "no face that lasts") + more


def _bends(robots: Facts) -> str:
    """Lower and upper quartile of the bends, in words."""
    if robots["bend"] is None:
        return "no known angle"
    low, high = (round(np.degrees(each)) + 0.0 for each in robots["bend_quartiles"])
    return f"{low:.0f}° to {high:.0f}°"

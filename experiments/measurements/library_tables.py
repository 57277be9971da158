"""The tables of README and docs/search.md about the default search's gait and the library's."""

import numpy as np
from pages import made_by, table, whole_zero

from jaxgrity import gait_names, gait_record, with_error

Facts = dict

PEAKS = (("peak_force", 0, " N"), ("peak_rate", 2, " m/s"), ("peak_power", 0, " W"))
"""of an actuator in a cycle: name, decimals at most, and unit"""


def gait_search_facts(raw: Facts) -> Facts:
    """The gait, what it is worth, and how it was found."""
    return {
        **{name: raw[name] for name in ("command", "wall_seconds", "stage_seconds", "reporting_seconds")},
        "steady": raw["steady"],
        "rollouts": sum(search["rollouts"] for search in raw["searches"]),
        "polish": raw["polish"]["reason"],
        "actuators": {name: raw["actuators"][name] for name in ("peak_force", "peak_rate", "peak_power")},
        "slip_share": raw["motion"]["slip_share"],
    }


def gait_search_table(facts: Facts) -> str:
    steady = facts["steady"]
    robust, other = steady["robust"], steady["other_contact_model"]
    seconds, reporting = facts["stage_seconds"], facts["reporting_seconds"]
    stages, parts = (", ".join(f"{name} {s:.0f} s" for name, s in found.items()) for found in (seconds, reporting))
    cycle = (
        f"{steady['periods']} periods of {steady['period']:.2f} s; shapes return to {1000 * steady['residual']:.1g} mm"
    )
    rows = [
        ["steady speed", f"**{_speed(steady)} body lengths/s**"],
        ["watched for", f"{steady['verified_for']:.0f} s"],
        [
            "settled after",
            f"{steady['settled_after']:.0f} s, and then in no 10 s slower than {steady['slowest_window']:.3f} m/s",
        ],
        [
            "turning",
            with_error(np.degrees(steady["turning"]), np.degrees(steady["turning_error_bar"]), " °/s", decimals=2),
        ],
        ["a cycle", cycle],
        ["with other nodes in the places of these it repeats itself in a cycle", f"{_repeats(steady)} times"],
        [
            "a disturbance is multiplied in a cycle by (shifts along the ground and turns about the vertical apart)",
            _multiplier(steady),
        ],
        [
            f"over {robust['robots']} robots that differ, for a minute",
            _of_robots(robust["mean"], robust, steady),
        ],
        [
            "the same on the other contact model",
            _of_robots(other["speed"], other, steady),
        ],
        ["faces that it stands on in a cycle", f"{len(steady['cycle']['supports'])}"],
        [
            "asked of an actuator, at most",
            f"{_peaks(steady['cycle'])} in a cycle; {_peaks(facts['actuators'])} with the start",
        ],
        ["cost of transport", _with_bar(steady["cycle"], "cost_of_transport", 2)],
        ["nodes slip that touch", f"{100 * facts['slip_share']:.0f} % of the time"],
        ["rollouts of the search", f"{facts['rollouts']}"],
        ["polish", facts["polish"]],
        ["wall time of the search", f"{facts['wall_seconds']:.0f} s: {stages}"],
        ["of the report, side by side", parts],
    ]
    return table(["the gait that `make gait` finds", "measured"], rows) + made_by(facts, "gait_search", "README.md")


def _of_robots(speed: float, robots: Facts, steady: Facts) -> str:
    """Their mean speed along paths with two standard errors, the standard deviation, and the shares of the orbit's."""
    mean, spread = speed / steady["speed"], robots["standard_deviation"] / steady["speed"]
    size = steady["body_length"]
    lengths = with_error(speed / size, 2 * robots["standard_error"] / size, " body lengths/s", decimals=3)
    scatter = f"standard deviation {robots['standard_deviation'] / size:.2g}"
    return f"{lengths}, {scatter}: {100 * mean:.0f} % of it, {100 * spread:.0f} %"


def _repeats(steady: Facts) -> int:
    return round(steady["period"] * steady["periods"] / steady["repetition"]["time"])


def _with_bar(cycle: Facts, name: str, decimals: int) -> str:
    """A number of a cycle and its error bar."""
    return with_error(cycle[name], cycle["error_bars"][name], decimals=decimals)


def _speed(steady: Facts) -> str:
    """Of the orbit, body lengths/s."""
    size = steady["body_length"]
    return with_error(steady["speed"] / size, steady["speed_error_bar"] / size, decimals=3)


def _multiplier(steady: Facts) -> str:
    return with_error(steady["multiplier"], steady["multiplier_error_bar"])


def gaits_table() -> str:
    """The gaits that come with the library, from their records in the package."""
    head = [
        "gait", "scene", "steady speed, body lengths/s", "for", "slowest 10 s", "turning, °/body length",
        "a disturbance is multiplied in a cycle by", "robots that differ: mean (standard deviation)",
        "on the other contact model", "their bends, °/body length", "faces that it stands on in a cycle",
        "times that it repeats itself in it", "peaks of an actuator in a cycle", "cost of transport", "nodes slip",
    ]  # fmt: skip
    return table(head, [_gait_row(name) for name in gait_names()])


def _gait_row(name: str) -> list[str]:
    record = gait_record(name)
    steady, size = record["steady"], record["steady"]["body_length"]
    robust, other, cycle = steady["robust"], steady["other_contact_model"], steady["cycle"]
    each_length = np.degrees(size / steady["speed"])
    bend, bar = each_length * steady["turning"], each_length * steady["turning_error_bar"]
    along = steady.get("along_heading")
    own, twin = (robust["mean"], robust), (other["speed"], other)
    if along is not None:
        own, twin = ((along[name]["mean"], along[name]) for name in ("robust", "other_contact_model"))
    bends = (f"{whole_zero(round(np.degrees(each['bend']))):.0f}" for each in (robust, other))
    return [
        f"`{name}`",
        record["scene"],
        _speed(steady) + ("" if along is None else f"; {along['speed'] / size:.3f} uphill"),
        f"{steady['verified_for']:.0f} s",
        f"{100 * steady['slowest_window'] / steady['speed']:.0f} %",
        with_error(bend, bar, decimals=1) if along is None else "not defined on a slope",
        _multiplier(steady),
        *(f"{mean / size:.3f} ({robots['standard_deviation'] / size:.2g})" for mean, robots in (own, twin)),
        ", ".join(bends),
        f"{len(cycle['supports'])}",
        f"{_repeats(steady)}",
        ", ".join(_with_bar(cycle, name, decimals) + unit for name, decimals, unit in PEAKS),
        _with_bar(cycle, "cost_of_transport", 1),
        f"{100 * record['motion']['slip_share']:.0f} %",
    ]


def gait_commands() -> str:
    """The commands that found the library's gaits."""
    return "\n".join(f"    # {name}\n    {gait_record(name)['command']}" for name in gait_names())


def _peaks(asked: Facts) -> str:
    return f"{asked['peak_force']:.0f} N, {asked['peak_rate']:.2f} m/s, {asked['peak_power']:.0f} W"

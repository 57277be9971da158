"""The tables about gaits, of README and docs/gaits.md: what they quote, and how they say it."""

import numpy as np
from pages import made_by, table

from jaxgrity import gait_names, gait_record

Facts = dict

CLIMBS = 0.1
"""m/s uphill, from which on a robot counts as climbing"""
MOST = 0.9
"""share of robots that have to roll"""


def gait_search_facts(raw: Facts) -> Facts:
    """The gait, what it is worth, and how it was found."""
    return {
        **{name: raw[name] for name in ("command", "wall_seconds", "stage_seconds")},
        "steady": raw["steady"],
        "rollouts": sum(search["rollouts"] for search in raw["searches"]),
        "polish": raw["polish"]["reason"],
        "actuators": {name: raw["actuators"][name] for name in ("peak_force", "peak_rate", "peak_power")},
        "slip_share": raw["motion"]["slip_share"],
    }


def gait_search_table(facts: Facts) -> str:
    steady, size = facts["steady"], facts["steady"]["body_length"]
    robust, other = steady["robust"], steady["other_contact_model"]
    seconds = facts["stage_seconds"]
    stages = ", ".join(f"{name} {spent:.0f} s" for name, spent in seconds.items())
    cycle = (
        f"{steady['periods']} periods of {steady['period']:.2f} s; shapes return to {1000 * steady['residual']:.1g} mm"
    )
    rows = [
        ["steady speed", f"**{steady['speed'] / size:.3f} ± {steady['speed_error_bar'] / size:.1g} body lengths/s**"],
        ["watched for", f"{steady['verified_for']:.0f} s"],
        [
            "settled after",
            f"{steady['settled_after']:.0f} s, and then in no 10 s slower than {steady['slowest_window']:.3f} m/s",
        ],
        [
            "turning",
            f"{_whole_zero(np.degrees(steady['turning'])):.2f} ± {np.degrees(steady['turning_error_bar']):.1g} °/s",
        ],
        ["a cycle", cycle],
        ["with other nodes in the places of these it repeats itself in a cycle", f"{_repeats(steady)} times"],
        [
            "a disturbance is multiplied in a cycle by (shifts along the ground and turns about the vertical apart)",
            f"{steady['multiplier']:.2g} ± {steady['multiplier_error_bar']:.1g}",
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
        ["cost of transport", _with_bar(steady["cycle"], "cost_of_transport", ".2f")],
        ["nodes slip that touch", f"{100 * facts['slip_share']:.0f} % of the time"],
        ["rollouts of the search", f"{facts['rollouts']}"],
        ["polish", facts["polish"]],
        ["wall time of the search", f"{facts['wall_seconds']:.0f} s: {stages}"],
    ]
    return table(["the gait that `make gait` finds", "measured"], rows) + made_by(facts, "gait_search", "docs/measured")


def _of_robots(speed: float, robots: Facts, steady: Facts) -> str:
    """Their mean speed along paths with its standard error, the standard deviation, and the shares of the orbit's."""
    mean, spread = speed / steady["speed"], robots["standard_deviation"] / steady["speed"]
    size = steady["body_length"]
    lengths = f"{speed / size:.3f} ± {robots['standard_error'] / size:.1g} body lengths/s"
    scatter = f"standard deviation {robots['standard_deviation'] / size:.2g}"
    return f"{lengths}, {scatter}: {100 * mean:.0f} % of it, {100 * spread:.0f} %"


def _repeats(steady: Facts) -> int:
    return round(steady["period"] * steady["periods"] / steady["repetition"]["time"])


def _with_bar(cycle: Facts, name: str, how: str) -> str:
    """A number of a cycle and its error bar."""
    bar = cycle["error_bars"][name]
    return f"{cycle[name]:{how}} ± {bar:{'.0f' if bar >= 1 else '.1g'}}"


def orbits_facts(raw: Facts) -> Facts:
    """Of each gait on each contact model: its orbit."""
    names = (
        "gait", "contact", "own", "settled", "speed", "speed_error_bar", "slowest_window", "turning", "periods",
        "residual", "multiplier", "returned", "settled_after", "verified_for", "body_length", "body_lengths_per_second",
    )  # fmt: skip
    return {"command": raw["command"], "rows": [{name: row[name] for name in names} for row in raw["rows"]]}


def orbits_table(facts: Facts) -> str:
    head = [
        "gait", "contact", "speed, body lengths/s", "slowest 10 s, m/s", "turning, °/s", "cycle, periods",
        "shape returns to", "a disturbance is multiplied in a cycle by", "robots that return",
        "settled after", "watched for",
    ]  # fmt: skip
    return table(head, [_orbit_row(row) for row in facts["rows"]]) + made_by(facts, "orbits")


def _orbit_row(row: Facts) -> list[str]:
    contact = f"{row['contact']}, its own" if row["own"] else row["contact"]
    if not row["settled"] or row["slowest_window"] is None:
        return [row["gait"], contact, f"{row['body_lengths_per_second']:.2f}, no orbit", *["-"] * 7, _seconds(row)]
    bar = row["speed_error_bar"] / row["body_length"] if row["speed_error_bar"] is not None else np.inf
    grows = "-" if row["multiplier"] is None or not np.isfinite(row["multiplier"]) else f"{row['multiplier']:.2g}"
    returned = "-" if row["returned"] is None else f"{100 * row['returned']:.0f} %"
    return [
        row["gait"],
        contact,
        f"{row['body_lengths_per_second']:.3f} ± {bar:.1g}",
        f"{row['slowest_window']:.2f}",
        f"{_whole_zero(np.degrees(row['turning'])):.1f}",
        f"{row['periods']}",
        f"{1000 * row['residual']:.2g} mm",
        grows,
        returned,
        f"{row['settled_after']:.0f} s",
        _seconds(row),
    ]


def basin_facts(raw: Facts) -> Facts:
    """What becomes of robots that are dropped anyhow."""
    return {name: raw[name] for name in ("command", "robots", "rows")}


def basin_table(facts: Facts) -> str:
    head = ["gait", "contact", "robots that roll after 15 s", "in the end", "median time until they roll"]
    rows = [
        [
            row["gait"],
            f"{row['contact']}, its own" if row["own"] else row["contact"],
            f"{100 * row['rolling_after_15_s']:.0f} %",
            f"{100 * row['rolling']:.0f} %",
            f"{row['median_seconds_until']:.0f} s",
        ]
        for row in facts["rows"]
    ]
    return table(head, rows) + made_by(facts, "basin")


def third_opinions_facts(raw: Facts) -> Facts:
    """Speeds by program."""
    return {name: raw[name] for name in ("command", "robots", "rows")}


def third_opinions_table(facts: Facts) -> str:
    numbers = ((row["engine"], row["mean"], row["standard_deviation"], row["slowest"]) for row in facts["rows"])
    rows = [[engine, f"{mean:.3f}", f"{scatter:.2g}", f"{slowest:.3f}"] for engine, mean, scatter, slowest in numbers]
    head = ["program", f"steady speed of {facts['robots']} robots, body lengths/s", "standard deviation", "slowest"]
    return table(head, rows) + made_by(facts, "third_opinions")


def ranges_facts(raw: Facts) -> Facts:
    """Of each quantity, the values that are next to each other about the gait's own where nine robots of ten roll."""
    rows = []
    for contact, quantity in dict.fromkeys((row["contact"], row["quantity"]) for row in raw["rows"]):
        scan = [row for row in raw["rows"] if (row["contact"], row["quantity"]) == (contact, quantity)]
        rolls = [row["rolling"] >= MOST for row in scan]
        middle = min(range(len(scan)), key=lambda k: abs(np.log(scan[k]["factor"])))
        low = high = middle
        while low > 0 and rolls[low - 1]:
            low -= 1
        while high < len(scan) - 1 and rolls[high + 1]:
            high += 1
        means = [row["mean"] for row in scan[low : high + 1] if row["mean"] is not None]
        ends = {"from": scan[low]["factor"], "to": scan[high]["factor"], "whole": low == 0 and high == len(scan) - 1}
        speeds = {"slowest": min(means, default=None), "fastest": max(means, default=None)}
        rows.append({"contact": contact, "quantity": quantity, "at_the_gait": rolls[middle], **ends, **speeds})
    return {"command": raw["command"], "robots": raw["robots"], "rows": rows}


def ranges_table(facts: Facts) -> str:
    rows = [
        [
            row["quantity"],
            row["contact"],
            f"{row['from']:.2f} to {row['to']:.2f} times" if row["at_the_gait"] else "-",
            f"{row['slowest']:.2f} to {row['fastest']:.2f}" if row["slowest"] is not None else "-",
        ]
        for row in facts["rows"]
    ]
    head = ["quantity", "contact", f"90 % of {facts['robots']} robots roll at", "speed there, body lengths/s"]
    return table(head, rows) + made_by(facts, "ranges")


def robots_that_differ_facts(raw: Facts) -> Facts:
    """Speeds over robots that differ."""
    return {name: raw[name] for name in ("command", "robots", "rows")}


def robots_that_differ_table(facts: Facts) -> str:
    head = [
        "gait", "contact", "its orbit's speed, own contact, body lengths/s",
        f"{facts['robots']} robots that differ, along their paths", "share of it", "robots above 85 %",
        "displacement over time", "bend, ° per body length: median", "quartiles",
    ]  # fmt: skip
    return table(head, [_robots_row(row) for row in facts["rows"]]) + made_by(facts, "robots_that_differ")


def _robots_row(row: Facts) -> list[str]:
    mean, spread = (row[name] / row["nominal"] for name in ("mean", "standard_deviation"))
    bend, low, high = (_whole_zero(round(np.degrees(each))) for each in (row["bend"], *row["bend_quartiles"]))
    return [
        row["gait"],
        f"{row['contact']}, its own" if row["own"] else row["contact"],
        f"{row['nominal']:.3f}",
        f"{row['mean']:.3f} ± {row['standard_deviation']:.2g}",
        f"{100 * mean:.0f} % ± {100 * spread:.0f} %",
        f"{100 * row['rolling']:.0f} %",
        f"{row['displacement']:.3f} ± {row['displacement_standard_deviation']:.2g}",
        f"{bend:.0f}",
        f"{low:.0f} to {high:.0f}",
    ]


def orbits_of_searches_facts(raw: Facts) -> Facts:
    """How many of the gaits that short searches found settle, and how well the error bars of their speeds hold."""
    return {name: raw[name] for name in ("command", "searches", "rows")}


def orbits_of_searches_table(facts: Facts) -> str:
    head = ["contact", "gaits on an orbit", "shape returns to 1 mm", "speed within 1 % of that at 1/8 of the step"]
    head += ["within the error bar", "off by, in the median", "error bar, in the median", "order: median (quartiles)"]
    rows = [
        [
            row["contact"],
            f"{row['settled']} of {row['gaits']}",
            f"{row['closed']} of {row['settled']}",
            *(f"{100 * row[name]:.0f} %" for name in ("within_a_hundredth", "covered")),
            *(f"{100 * row[name]:.2g} %" for name in ("median_off", "median_bar")),
            "{1:.1f} ({0:.1f} to {2:.1f})".format(*row["order"]),
        ]
        for row in facts["rows"]
    ]
    return table(head, rows) + made_by(facts, "orbits_of_searches")


def climbing_facts(raw: Facts) -> Facts:
    """How fast the gait climbs each slope, by friction."""
    return {name: raw[name] for name in ("command", "friction", "duration", "rows")}


def climbing_table(facts: Facts) -> str:
    ways = ("own", "finer", "other")
    rows = [
        [f"{row['slope']:g}°", *(", ".join(f"{speed + 0:.2f}" for speed in row[name]) for name in ways)]
        for row in facts["rows"]
    ]
    friction = ", ".join(f"{mu:.2g}" for mu in facts["friction"])
    steepest = [", ".join(f"{_steepest(facts, name, k):g}°" for k in range(len(facts["friction"]))) for name in ways]
    rows.append([f"steepest with {CLIMBS} m/s", *steepest])
    head = ["slope", f"m/s uphill, exact contact, friction {friction}", "at half the step", "penalty contact"]
    return table(head, rows) + made_by(facts, "climbing")


def _steepest(facts: Facts, way: str, k: int) -> float:
    """The steepest slope, degrees, that robots of the k-th friction climb, and all from the scene's own up to it."""
    climbed = [row["slope"] for row in facts["rows"] if row[way][k] >= CLIMBS]
    missed = [row["slope"] for row in facts["rows"] if row[way][k] < CLIMBS and row["slope"] > min(climbed, default=0)]
    return max((slope for slope in climbed if slope < min(missed, default=np.inf)), default=np.nan)


PEAKS = (("peak_force", ".0f", " N"), ("peak_rate", ".2f", " m/s"), ("peak_power", ".0f", " W"))
"""of an actuator in a cycle: name, format and unit"""


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
    bends = (f"{_whole_zero(round(np.degrees(each['bend']))):.0f}" for each in (robust, other))
    return [
        f"`{name}`",
        record["scene"],
        f"{steady['speed'] / size:.3f} ± {steady['speed_error_bar'] / size:.1g}",
        f"{steady['verified_for']:.0f} s",
        f"{100 * steady['slowest_window'] / steady['speed']:.0f} %",
        f"{_whole_zero(bend):.1f} ± {bar:.1g}",
        f"{steady['multiplier']:.2g} ± {steady['multiplier_error_bar']:.1g}",
        f"{robust['mean'] / size:.3f} ({robust['standard_deviation'] / size:.2g})",
        f"{other['speed'] / size:.3f} ({other['standard_deviation'] / size:.2g})",
        ", ".join(bends),
        f"{len(cycle['supports'])}",
        f"{_repeats(steady)}",
        ", ".join(_with_bar(cycle, name, how) + unit for name, how, unit in PEAKS),
        _with_bar(cycle, "cost_of_transport", ".1f"),
        f"{100 * record['motion']['slip_share']:.0f} %",
    ]


def gait_commands() -> str:
    """The commands that found the library's gaits."""
    return "\n".join(f"    # {name}\n    {gait_record(name)['command']}" for name in gait_names())


def _peaks(asked: Facts) -> str:
    return f"{asked['peak_force']:.0f} N, {asked['peak_rate']:.2f} m/s, {asked['peak_power']:.0f} W"


def _whole_zero(value: float) -> float:
    """Without a sign where it is rounding alone."""
    return 0.0 if abs(value) < 1e-6 else value


def _seconds(row: Facts) -> str:
    return f"{row['verified_for']:.0f} s"

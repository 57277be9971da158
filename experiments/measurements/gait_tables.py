"""The tables of docs/gaits.md about gaits that last: what they quote, and how they say it."""

import numpy as np
from pages import made_by, table, whole_zero

from jaxgrity import with_error

Facts = dict

MOST = 7 / 8
"""share of robots that have to roll: all but one of eight, which may need longer from where it started"""


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
        with_error(f"{row['body_lengths_per_second']:.3f}", bar),
        f"{row['slowest_window']:.2f}",
        f"{round(np.degrees(row['turning']), 1) + 0.0:.1f}",
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
    head = [
        "gait", "contact", "robots that roll after 15 s", "in the end", "in the end on the orbit, by their shapes",
        "median time until they roll",
    ]  # fmt: skip
    rows = [
        [
            row["gait"],
            f"{row['contact']}, its own" if row["own"] else row["contact"],
            f"{100 * row['rolling_after_15_s']:.0f} %",
            f"{100 * row['rolling']:.0f} %",
            f"{100 * row['on_the_orbit']:.0f} %",
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
    """Of each quantity, the values next to each other about the gait's own where all robots roll but one of eight."""
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
    head = [
        "quantity",
        "contact",
        f"{np.ceil(MOST * facts['robots']):.0f} of {facts['robots']} robots roll at",
        "speed there, body lengths/s",
    ]
    return table(head, rows) + made_by(facts, "ranges")


def robots_that_differ_facts(raw: Facts) -> Facts:
    """Speeds over robots that differ."""
    return {name: raw[name] for name in ("command", "robots", "rows")}


def robots_that_differ_table(facts: Facts) -> str:
    head = [
        "gait", "contact", "its orbit's speed, own contact, body lengths/s",
        f"{facts['robots']} robots that differ, along their paths: mean (standard deviation)",
        "share of it", "robots above 85 %", "displacement over time", "bend, ° per body length: median", "quartiles",
    ]  # fmt: skip
    return table(head, [_robots_row(row) for row in facts["rows"]]) + made_by(facts, "robots_that_differ")


def _robots_row(row: Facts) -> list[str]:
    mean, spread = (row[name] / row["nominal"] for name in ("mean", "standard_deviation"))
    bend, low, high = (whole_zero(round(np.degrees(each))) for each in (row["bend"], *row["bend_quartiles"]))
    return [
        row["gait"],
        f"{row['contact']}, its own" if row["own"] else row["contact"],
        f"{row['nominal']:.3f}",
        f"{row['mean']:.3f} ({row['standard_deviation']:.2g})",
        f"{100 * mean:.0f} % ({100 * spread:.0f} %)",
        f"{100 * row['rolling']:.0f} %",
        f"{row['displacement']:.3f} ({row['displacement_standard_deviation']:.2g})",
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


def _seconds(row: Facts) -> str:
    return f"{row['verified_for']:.0f} s"

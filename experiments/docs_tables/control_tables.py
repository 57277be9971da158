"""The tables of docs/control.md: what they quote, and how they say it."""

import numpy as np
from pages import made_by, table

Facts = dict


def feedback_facts(raw: Facts) -> Facts:
    """Of each case: how many robots roll, and how fast."""
    return {name: raw[name] for name in ("command", "robots", "orbit_speed", "rows")}


def feedback_table(name: str, facts: Facts) -> str:
    found = {(row["case"], row["policy"]): row for row in facts["rows"]}
    rows = []
    for case in dict.fromkeys(row["case"] for row in facts["rows"]):
        both = (found[case, policy] for policy in ("open loop", "feedback"))
        rows.append([case, *(f"{100 * row['rolling']:.0f} %, {row['speed']:.2f} m/s" for row in both)])
    head = ["case", "open loop: robots that roll, mean speed", "with feedback"]
    return table(head, rows) + made_by(facts, name, "measured")


def steering_facts(raw: Facts) -> Facts:
    """How a bend steers."""
    return {name: raw[name] for name in ("command", "robots", "rows")}


def steering_table(facts: Facts) -> str:
    rows = [
        [
            f"{row['bend']:g}",
            f"{np.degrees(row['turning']) + 0:.1f} ± {np.degrees(row['turning_spread']):.1f} °/s",
            f"{row['speed']:.2f} m/s",
            f"{100 * row['went_on']:.0f} %" if "went_on" in row else "-",
        ]
        for row in facts["rows"]
    ]
    head = ["bend", "turning, median and standard deviation", "speed", "robots as fast after the bend was reversed"]
    return table(head, rows) + made_by(facts, "steering", "measured")


def goals_facts(raw: Facts) -> Facts:
    """In how many trials the goal was reached, how soon, and how the controller looked ahead."""
    rows = raw["rows"]
    times = [row["seconds"] for row in rows if row["reached"]]
    return {
        **{name: raw[name] for name in ("command", "cores", "patience", "within", "sampling")},
        "trials": len(rows),
        **{name: sum(row[name] for row in rows) for name in ("reached", "feedback", "open_loop")},
        "seconds": float(np.median(times)) if times else None,
        "real_time": float(np.median([row["real_time"] for row in rows])),
    }


def goals_table(facts: Facts) -> str:
    sampling = facts["sampling"]
    looked = f"{sampling['samples']} rollouts of {sampling['horizon']:g} s, once in {sampling['interval']:g} s"
    share = {name: f"{facts[name]} of {facts['trials']}" for name in ("reached", "feedback", "open_loop")}
    median = "" if facts["seconds"] is None else f", in {facts['seconds']:.0f} s (median)"
    rows = [
        ["led by a model with nominal friction", share["reached"] + median],
        ["the gait with feedback, which does not know of the goal", share["feedback"]],
        ["the gait as it is", share["open_loop"]],
        [f"choosing from {looked}", f"{facts['real_time']:.2g} times as fast as the robot moves"],
    ]
    head = [f"within {facts['within']:g} m of the goal, in at most {facts['patience']:.0f} s", "trials"]
    return table(head, rows) + made_by(facts, "goals", "measured")


def environments_facts(raw: Facts) -> Facts:
    """How fast each environment was."""
    return {name: raw[name] for name in ("command", "cores", "robots", "rows")}


def environments_table(facts: Facts) -> str:
    rows = [
        [
            row["task"],
            f"{row['steps']}",
            f"{row['seconds']:.1f} s",
            f"{row['processor_seconds']:.1f} s",
            f"{row['episodes']}",
            f"{row['not_finite']}",
        ]
        for row in facts["rows"]
    ]
    head = ["task", "steps", "wall time", "processor time", "episodes", "numbers that are not finite"]
    return table(head, rows) + made_by(facts, "environments", "measured")

"""The tables of docs/control.md: what they quote, and how they say it."""

import numpy as np
from pages import made_by, table

Facts = dict


def feedback_facts(raw: Facts) -> Facts:
    """Of each case: how many robots roll, and how fast."""
    return {name: raw[name] for name in ("command", "robots", "orbit_speed", "rate", "rows")}


def feedback_table(name: str, facts: Facts) -> str:
    found = {(row["case"], row["policy"]): row for row in facts["rows"]}
    policies = list(dict.fromkeys(row["policy"] for row in facts["rows"]))
    rows = []
    for case in dict.fromkeys(row["case"] for row in facts["rows"]):
        own = (found[case, policy] for policy in policies)
        rows.append([case, *(f"{row['rolled']} of {row['counted']}, {row['speed']:.2f} m/s" for row in own)])
    cases = list(dict.fromkeys(case for case, _ in found))
    levels, roughs = ([case for case in cases if case.startswith(word)] for word in ("dropped", "bumps"))
    for level, rough in zip(levels, roughs):
        shares = (found[rough, policy]["speed"] / found[level, policy]["speed"] for policy in policies)
        _, _, motors = rough.partition(", ")
        label = "speed on bumps, of that on level ground" + (f", {motors}" if motors else "")
        rows.append([label, *(f"{100 * share:.0f} %" for share in shares)])
    first, *others = policies
    head = ["case", f"{first}: robots that roll, mean speed", *others]
    return table(head, rows) + made_by(facts, name)


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


def goals_table(name: str, facts: Facts) -> str:
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
    return table(head, rows) + made_by(facts, name)


def obstacles_facts(raw: Facts) -> Facts:
    """How many robots got round their obstacles, and how."""
    rows = raw["rows"]
    names = ("command", "cores", "patience", "samples", "copies", "interval", "horizon", "gaits", "spread", "surprise")
    arrived = [row for row in rows if row["reached"]]
    return {
        **{name: raw[name] for name in (*names, "seconds_a_choice")},
        "fields": len(rows),
        "planned": {name: sum(row[name] for row in rows) for name in ("reached", "arrived", "touched")},
        "blind": {name: sum(row["blind"][name] for row in rows) for name in ("reached", "arrived", "touched")},
        "seconds": float(np.median([row["seconds"] for row in arrived])) if arrived else None,
        "gap": min((row["gap"] for row in arrived), default=None),
        "length": float(np.median([row["length"] for row in arrived])) if arrived else None,
    }


def obstacles_table(facts: Facts) -> str:
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in facts["gaits"].items())
    count = facts["fields"]
    rows = []
    for label, name in (("round obstacles, by the plan", "planned"), ("straight to the goal, blind", "blind")):
        own = facts[name]
        rows.append([label, f"{own['reached']} of {count}", f"{own['touched']}", f"{count - own['arrived']}"])
    head = [f"goal within {facts['patience']:g} s", "reached, nothing touched", "touched something", "did not arrive"]
    words = table(head, rows)
    if facts["seconds"] is not None:
        apart, off = (f"{100 * facts[name]:.0f} cm" for name in ("spread", "surprise"))
        more = [
            ["a way round obstacles, median", f"{facts['seconds']:.0f} s, {facts['length']:.0f} m"],
            ["nearest to an obstacle, of robots that arrived", f"{100 * facts['gap']:.0f} cm"],
            ["gaits that were chosen", shares],
            [f"spread of the model's robots on a chosen way after {facts['horizon']:g} s, median", apart],
            [f"from there to the robot after {facts['interval']:g} s, median", off],
            [f"a choice for all {count} robots", f"{facts['seconds_a_choice']:.1f} s"],
        ]
        words += "\n\n" + table(["of these ways", "measured"], more)
    return words + made_by(facts, "obstacles")


def task_baselines_facts(raw: Facts) -> Facts:
    """What each controller reaches in each task."""
    return {name: raw[name] for name in ("command", "cores", "episodes", "led", "generations", "rows")}


def task_baselines_table(facts: Facts) -> str:
    names = list(dict.fromkeys(name for row in facts["rows"] for name in row["progress"]))
    rows = [
        [
            row["task"],
            *(
                f"{row['progress'][name]:.2f} ± {2 * row['error'][name]:.2f}" if name in row["progress"] else "-"
                for name in names
            ),
            f"{row['seconds'] / 60:.1f} minutes",
        ]
        for row in facts["rows"]
    ]
    rows.append(["in all", *[""] * len(names), f"{sum(row['seconds'] for row in facts['rows']) / 60:.1f} minutes"])
    return table(["progress, m/s", *names, "time for all of these"], rows) + made_by(facts, "task_baselines")

"""The tables of docs/gaits.md about polish and the repertoire."""

import numpy as np
from pages import made_by, table

Facts = dict


def polish_comparison_facts(raw: Facts) -> Facts:
    """Of each way: what it gained over its start and over a longer search, seed by seed."""
    ways = list(dict.fromkeys(row["way"] for row in raw["rows"]))
    fitness = {way: {row["seed"]: row["fitness"] for row in raw["rows"] if row["way"] == way} for way in ways}
    mean = {way: {row["seed"]: row["mean"] for row in raw["rows"] if row["way"] == way} for way in ways}
    rows = []
    for way in ways[1:]:
        gains = [fitness[way][seed] - fitness["start"][seed] for seed in fitness["start"]]
        beyond = [fitness[way][seed] - fitness["search runs on"][seed] for seed in fitness["start"]]
        mine = [row for row in raw["rows"] if row["way"] == way]
        rows.append(
            {
                "way": way,
                "gain": float(np.median(gains)),
                "quartiles": [float(x) for x in np.quantile(gains, (0.25, 0.75))],
                "gain_of_mean": float(np.median([mean[way][s] - mean["start"][s] for s in mean["start"]])),
                "better": sum(gain > 0 for gain in gains),
                "worse": sum(gain < 0 for gain in gains),
                "beyond": float(np.median(beyond)),
                "beats": sum(gain > 0 for gain in beyond),
                "kept": sum(row.get("kept", False) for row in mine) if "kept" in mine[0] else None,
                "spent": float(np.median([row["spent"] for row in mine])) if "spent" in mine[0] else raw["rollouts"],
            }
        )
    starts = {"start": float(np.median(list(fitness["start"].values()))), "seeds": len(fitness["start"])}
    return {"command": raw["command"], "rollouts": raw["rollouts"], **starts, "rows": rows}


def polish_comparison_table(facts: Facts) -> str:
    head = [
        "goes on by", "fitness gained, body lengths/s: median", "quartiles", "better than its start", "worse",
        "over the longer search", "beats it", "kept", "rollouts",
    ]  # fmt: skip
    rows = [
        [
            row["way"],
            f"{row['gain']:+.3f}",
            f"{row['quartiles'][0]:+.3f} to {row['quartiles'][1]:+.3f}",
            f"{row['better']} of {facts['seeds']}",
            f"{row['worse']}",
            *(["-", "-"] if row["way"] == "search runs on" else [f"{row['beyond']:+.3f}", f"{row['beats']}"]),
            "-" if row["kept"] is None else f"{row['kept']}",
            f"{row['spent']:.0f}",
        ]
        for row in facts["rows"]
    ]
    about = [str(facts["seeds"]), str(facts["rollouts"]), f"{facts['start']:.3f} body lengths/s"]
    settings = table(["seeds", "rollouts that each may spend", "fitness of the starts, median"], [about])
    return f"{table(head, rows)}\n\n{settings}" + made_by(facts, "polish_comparison")


def repertoire_facts(raw: Facts) -> Facts:
    """How many cells were filled, and the orbits of the elites that were looked at."""
    counts = {"filled": raw["filled"][-1], "cells": raw["cells"][0] * raw["cells"][1], "rollouts": raw["rollouts"]}
    return {"command": raw["command"], **counts, "rows": raw["rows"]}


def repertoire_table(facts: Facts) -> str:
    rows = [
        [
            row["gait"] + (", a mirror image" if row["mirrored"] else ""),
            f"{row['watched']}",
            f"{row['attracting']}",
            f"{row['elite_speed']:.2f}",
            f"{row['elite_bend']:+.2f}",
            *([f"{row['speed']:.3f}", f"{row['bend']:+.3f}"] if row["settled"] else ["no orbit", "-"]),
            "-" if row["multiplier"] is None else f"{row['multiplier']:.2g}",
            "-" if row["returned"] is None else f"{row['returned']:.0%}",
            f"{row['verified_for']:.0f} s",
        ]
        for row in facts["rows"]
    ]
    head = [
        "asked for",
        "watched",
        "on orbits that attract",
        "speed over its robots, body lengths/s",
        "bend, rad per body length",
        "speed of its orbit",
    ]
    head += ["bend of its orbit", "largest multiplier", "robots that return", "watched for"]
    about = [f"{facts['filled']} of {facts['cells']}", str(facts["rollouts"])]
    return f"{table(head, rows)}\n\n{table(['cells with a gait', 'rollouts'], [about])}" + made_by(facts, "repertoire")

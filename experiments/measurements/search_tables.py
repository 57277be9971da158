"""The tables about searches for gaits, of docs/search.md: what they quote, and how they say it."""

import numpy as np
from pages import made_by, table

Facts = dict

OTHERS = ("GA+more", "GA", "CMA-ES")
"""searches that each search is compared with, seed by seed"""
SURE = 0.03
"""share of the distance below which an error bar is small"""


def search_baselines_facts(raw: Facts) -> Facts:
    """Of each search: its answers' distances, which error bars are small, and on how many seeds it beats others."""
    rows = []
    for method, found in raw["methods"].items():
        mine = [run for run in raw["runs"] if run["method"] == method]
        bars = [run["error_bar"] / run["distance"] for run in mine if run["error_bar"] is not None]
        kept = [run["polish"]["improved"] for run in mine if run["polish"]]
        rows.append(
            {
                "method": method,
                "seeds": len(mine),
                "median": found["robust"]["median"],
                "quartiles": found["robust"]["quartiles"],
                "nominal": found["distance"],
                "small_bars": sum(bar < SURE for bar in bars),
                "ratio_to_random": found["ratio_to_random"],
                "beats": {other: found["beats"][other] for other in OTHERS if other in found["beats"]},
                "polished": len(kept),
                "polish_kept": sum(kept),
            }
        )
    settings = raw["settings"]
    about = {name: settings[name] for name in ("rollouts", "duration", "polished")}
    return {"command": raw["command"], "cores": raw["cores"], "scene": raw["scene"], **about, "methods": rows}


def search_baselines_table(facts: Facts) -> str:
    rows = []
    for row in facts["methods"]:
        low, high = row["quartiles"]
        ratio, beats = row["ratio_to_random"], [row["beats"].get(other) for other in OTHERS]
        rows.append(
            [
                row["method"],
                f"{row['median']:.3f}",
                f"{low:.3f} to {high:.3f}",
                f"{row['nominal']:.3f}",
                f"{row['small_bars']} of {row['seeds']}",
                "-" if ratio is None else f"{ratio:.2f}",
                *("-" if count is None else f"{count[0]} of {count[1]}" for count in beats),
                f"{row['polish_kept']} of {row['polished']}" if row["polished"] else "-",
            ]
        )
    head = ["search", "robust distance, m: median", "quartiles", "nominal, m", f"error bar < {SURE:.0%}"]
    head += ["times random search's", *(f"beats {other}" for other in OTHERS), "polish kept"]
    about = [str(facts["rollouts"]), f"{facts['duration']:g} s", f"{facts['polished']:.0%}"]
    settings = table(["rollouts of each search", "duration of a rollout", "share for polish"], [about])
    return f"{table(head, rows)}\n\n{settings}" + made_by(facts, f"search_baselines_{facts['scene']}")


def lasting_baselines_facts(raw: Facts) -> Facts:
    """Of each search: its answers' steady speeds on both contact models."""
    rows = []
    for freedom, method in dict.fromkeys((row["freedom"], row["method"]) for row in raw["rows"]):
        mine = [row for row in raw["rows"] if (row["freedom"], row["method"]) == (freedom, method)]
        # none where a robot failed
        own, other = ([row[name] for row in mine if row[name] is not None] for name in ("own", "other"))
        kept = [row["kept"] for row in mine if row["kept"] is not None]
        about = {"freedom": freedom, "method": method, "seeds": len(mine), "stood": len(own)}
        low, median, high = (float(x) for x in np.quantile(own, (0.25, 0.5, 0.75)))
        found = {"median": median, "quartiles": [low, high], "other": float(np.median(other))}
        rows.append({**about, **found, "kept": sum(kept) if kept else None})
    return {name: raw[name] for name in ("command", "cores", "gaits", "duration", "polish")} | {"rows": rows}


def lasting_baselines_table(facts: Facts) -> str:
    rows = [
        [
            row["method"],
            {"waves": "waves", "free": "any"}[row["freedom"]],
            f"{row['stood']} of {row['seeds']}",
            f"{row['median']:.3f}",
            f"{row['quartiles'][0]:.3f} to {row['quartiles'][1]:.3f}",
            f"{row['other']:.3f}",
            "" if row["kept"] is None else f"{row['kept']} of {row['seeds']}",
        ]
        for row in facts["rows"]
    ]
    head = [
        "search",
        "gaits",
        "seeds, no robot failed",
        "steady speed, body lengths/s: median",
        "quartiles",
        "on the other model: median",
        "polish kept",
    ]
    about = [str(facts["gaits"]), f"{facts['duration']:g} s", str(facts["polish"])]
    settings = table(["gaits that each search tries", "duration", "rollouts for polish"], [about])
    return f"{table(head, rows)}\n\n{settings}" + made_by(facts, "lasting_baselines")

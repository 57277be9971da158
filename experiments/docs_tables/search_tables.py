"""The tables about gaits and their search, of README and docs/search.md: what they quote, and how they say it."""

import numpy as np
from pages import made_by, table

from jaxgrity import find_objective, gait_names, gait_record

Facts = dict

OTHERS = ("GA+more", "GA", "CMA-ES")
"""searches that each search is compared with, seed by seed"""
SURE = 0.03
"""share of the distance below which an error bar is small"""


def gait_search_facts(raw: Facts) -> Facts:
    """The gait, what it is worth, and how it was found."""
    polish, ranks, among = raw["polish"], raw["fidelity"]["rank_correlation"], "rank_correlation_of_the_evolved"
    return {
        **{name: raw[name] for name in ("command", "wall_seconds", "duration", "distance", "error_bar")},
        "robust": {name: raw["robust"][name] for name in ("mean", "standard_deviation")},
        "other_contact_model": raw["other_contact_model"],
        "phase_uncertainty": raw["settings"]["uncertainty"]["phase"],
        "rollouts": sum(search["rollouts"] for search in raw["searches"]),
        "polish": {name: polish[name] for name in ("rollouts", "improved", "before", "after")},
        "rank_correlation": [row[-1] for row in ranks],
        among: [row[-1] for row in raw["fidelity"][among]],
        "actuators": {name: raw["actuators"][name] for name in ("peak_force", "peak_rate", "peak_power")},
    }


def gait_search_table(facts: Facts) -> str:
    robust, other, polish, asked = (facts[n] for n in ("robust", "other_contact_model", "polish", "actuators"))
    ranks = zip(facts["rank_correlation"], facts["rank_correlation_of_the_evolved"])
    rough, own = (f"{every:.2f} ({among:.2f} among the evolved)" for every, among in list(ranks)[:2])
    gain = f"{polish['before']:.3f} to {polish['after']:.3f} m" if polish["improved"] else "nothing better was found"
    rows = [
        ["verified distance", f"**{facts['distance']:.3f} ± {facts['error_bar']:.1g} m** in {facts['duration']:g} s"],
        [
            f"robots whose phases are off by up to {facts['phase_uncertainty']:g} rad",
            f"{robust['mean']:.3f} ± {robust['standard_deviation']:.2g} m",
        ],
        ["the same on the other contact model", f"{other['mean']:.2f} ± {other['standard_deviation']:.2g} m"],
        ["asked of an actuator, at most", _peaks(asked)],
        ["rollouts of the search, and of polish", f"{facts['rollouts']} and {polish['rollouts']}"],
        ["mean distance before and after polish", gain],
        ["rank correlation of screening with verification", rough],
        ["rank correlation of the scene's own model with verification", own],
        ["wall time of the search", f"{facts['wall_seconds']:.0f} s"],
    ]
    return table(["the gait that `make gait` finds", "measured"], rows) + made_by(facts, "gait_search", "docs/measured")


def _peaks(asked: Facts) -> str:
    return f"{asked['peak_force']:.0f} N, {asked['peak_rate']:.2f} m/s, {asked['peak_power']:.0f} W"


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


def damage_facts(raw: Facts) -> Facts:
    """How far each gait still goes as it was, and in how many cases its distance is reached on each of the ways."""
    still, recovered = [], []
    for gait, kinds in raw["recovered"].items():
        goes = raw["intact"][gait]["robust"]
        for kind, counts in kinds.items():
            cases = [case["as it was"][gait]["robust"] for label, case in raw["cases"].items() if kind in label]
            left = [0.0 if far is None else far for far in cases]
            ends = {"median": float(np.median(left)), "least": min(left), "most": max(left)}
            still.append({"gait": gait, "kind": kind, "intact": goes, **ends})
            recovered.append({"gait": gait, "kind": kind, "cases": counts["cases"], "reached": counts["reached"]})
    kept = ("command", "cores", "enough", "free", "rollouts")
    return {name: raw[name] for name in kept} | {"still": still, "recovered": recovered}


def damage_table(facts: Facts) -> str:
    still = [
        [row["gait"], row["kind"], *(f"{row[name]:.2f} m" for name in ("intact", "median", "least", "most"))]
        for row in facts["still"]
    ]
    found = [table(["gait", "broken or stuck", "intact", "median", "least", "most"], still)]
    rows, intact = [], {row["gait"]: row["intact"] for row in facts["still"]}
    for row in facts["recovered"]:
        goal = f"{facts['enough']:.0%} of {row['gait']}'s {intact[row['gait']]:.2f} m"
        counts = [
            f"{sure} of {row['cases']}" + (f" ({far})" if far > sure else "") for sure, far in row["reached"].values()
        ]
        rows.append([goal, row["kind"], *counts])
    ways = list(facts["recovered"][0]["reached"])
    found.append(table(["to be reached", "broken or stuck", *ways], rows))
    cost, free = facts["rollouts"], facts["free"]
    bounds = [" to ".join(f"{x:g}" for x in free[name]) for name in ("amplitude", "frequency")]
    search = [[way, str(cost[way]), *(bounds if way == "scratch" else ["-", "-"])] for way in cost]
    found.append(table(["way", "rollouts for a case", "amplitudes", "frequency, Hz"], search))
    return "\n\n".join(found) + made_by(facts, "damage")


def crash_recovery_facts(raw: Facts) -> Facts:
    every = raw["kills"]
    return {
        "command": raw["command"],
        "cores": raw["cores"],
        "killed": len(every),
        "undisturbed_seconds": raw["undisturbed_seconds"],
        "between_generations": sum(0 < sum(kill["generations_saved"]) < 20 for kill in every),
        "same_population": sum(kill["same_population"] for kill in every),
        "broken_files": sum(len(kill["broken_files"]) for kill in every),
    }


def crash_recovery_table(facts: Facts) -> str:
    rows = [
        ["searches killed at random moments", str(facts["killed"])],
        ["of these between their first and their last generation", str(facts["between_generations"])],
        ["that ended, resumed, with the very same population", str(facts["same_population"])],
        ["broken files", str(facts["broken_files"])],
        ["duration of a search that nobody killed", f"{facts['undisturbed_seconds']:.0f} s"],
    ]
    return table(["crash recovery", "measured"], rows) + made_by(facts, "crash_recovery")


def gaits_table() -> str:
    """The gaits that come with the library, from their records in the package."""
    rows = []
    for name in gait_names():
        record = gait_record(name)
        robust, other = record["robust"], record["other_contact_model"]
        # a search maximises, so a cost counts below zero there
        cost = record["objective"] == "cost of transport"
        sign, unit = (-1, "W/(m g d)") if cost else (1, find_objective(record["objective"]).unit)
        rows.append(
            [
                f"`{name}`",
                record["scene"],
                f"{record['distance']:.3f} ± {record['error_bar']:.1g} m in {record['duration']:g} s",
                f"{sign * robust['mean']:.3f} ± {robust['standard_deviation']:.2g} {unit}".strip(),
                f"{sign * other['mean']:.3f} ± {other['standard_deviation']:.2g}",
                f"{record['motion']['kind']}, {record['motion']['rolls']} changes of support",
                _peaks(record["actuators"]),
            ]
        )
    head = ["gait", "scene", "verified", "robust", "other contact model", "motion", "peak of an actuator"]
    return table(head, rows)


def gait_commands() -> str:
    """The commands that found the library's gaits."""
    return "\n".join(f"    # {name}\n    {gait_record(name)['command']}" for name in gait_names())

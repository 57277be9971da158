"""The table of docs/scaling.md about populations on two machines, a GPU and cores."""

import numpy as np
from pages import made_by, table

Facts = dict


def populations_facts(raw: Facts) -> Facts:
    """Of two machines: this one, and the one beside it."""
    kept = ("device", "jax", "command", "rows")
    ends = [raw["ends"], raw["beside"]["ends"]]
    apart = {name: float(np.abs(np.subtract(*(each[name] for each in ends))).max()) for name in raw["ends"]}
    both = [{key: each[key] for key in kept} for each in (raw, raw["beside"])]
    return {
        "command": raw["command"],
        "machines": both,
        "gaits_compared": len(next(iter(ends[0].values()))),
        "apart": apart,
    }


def populations_table(facts: Facts) -> str:
    here, there = facts["machines"]
    sizes = list(dict.fromkeys(row["gaits"] for row in there["rows"]))
    cost = [
        {(row["method"], row["dtype"], row["gaits"]): row["per_gait_and_simulated_second"] for row in each["rows"]}
        for each in (here, there)
    ]
    rows = []
    for method, dtype in dict.fromkeys((row["method"], row["dtype"]) for row in there["rows"]):
        for machine, costs in zip((here, there), cost):
            found = [costs.get((method, dtype, size)) for size in sizes]
            rows.append(
                [f"{method}, {dtype}", machine["device"], *("-" if x is None else f"{1e6 * x:.3g}" for x in found)]
            )
    apart = [f"{1e3 * distance:.1g} mm ({name})" for name, distance in facts["apart"].items()]
    said = (
        f"Both machines roll out the same first {facts['gaits_compared']} gaits; their centres of mass end apart by "
        f"up to {', '.join(apart[:-1])} and {apart[-1]}. JAX {here['jax']} here, {there['jax']} there."
    )
    head = ["microseconds a gait and simulated second", "device", *(f"{size:,}" for size in sizes)]
    return table(head, rows) + f"\n\n{said}" + made_by(facts, "populations")

"""Tables about devices and threads: populations on a GPU and on cores, and what threads of LAPACK cost."""

import numpy as np
from pages import made_by, table

Facts = dict


def populations_facts(raw: Facts) -> Facts:
    """Of two machines: this one, and the one beside it."""
    ends = [raw["ends"], raw["beside"]["ends"]]
    apart = {name: float(np.abs(np.subtract(*(each[name] for each in ends))).max()) for name in ends[0]}
    both = [{key: each[key] for key in ("device", "jax", "command", "rows")} for each in (raw, raw["beside"])]
    return {"command": raw["command"], "machines": both, "apart": apart}


def populations_table(facts: Facts) -> str:
    here, there = facts["machines"]
    sizes = list(dict.fromkeys(row["gaits"] for row in there["rows"]))
    rows = []
    for method, dtype in dict.fromkeys((row["method"], row["dtype"]) for row in there["rows"]):
        for machine in (here, there):
            cost = {
                row["gaits"]: row["per_gait_and_simulated_second"]
                for row in machine["rows"]
                if (row["method"], row["dtype"]) == (method, dtype)
            }
            device = f"{machine['device']}, JAX {machine['jax']}"
            costs = (f"{1e6 * cost[size]:.3g}" if size in cost else "-" for size in sizes)
            apart = f"{1e3 * facts['apart'][f'{method} {dtype}']:.1g} mm" if machine is there else "-"
            rows.append([f"{method}, {dtype}", device, *costs, apart])
    head = ["us a gait and simulated second", "device", *(f"{size:,} gaits" for size in sizes), "ends apart by"]
    return table(head, rows) + made_by(facts, "populations")

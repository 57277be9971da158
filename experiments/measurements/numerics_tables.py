"""The tables of docs/numerics.md: what they quote of the raw results, and how they say it."""

from pages import made_by, table

Facts = dict


def equivalence_facts(raw: Facts) -> Facts:
    """Of each law the first and the last stiffness, and how deep the robot stands in the ground at the end."""
    rows = []
    for symbol in ("K", "K, no friction", "k_n"):
        law = raw[symbol]
        ends = {name: [law[name][0], law[name][-1]] for name in ("values", "distance")}
        rows.append({"grows": symbol, **ends, "slope": law["slope"]})
    contact = raw["k_n"]
    expected = contact["weight_over_n_k"][-1]
    depth = None if expected is None else contact["penetration_at_end"][-1] / expected
    return chosen(raw, "command", "cores", "motion") | {"rows": rows, "depth_over_expected": depth}


def equivalence_table(facts: Facts) -> str:
    rows = [
        [
            row["grows"],
            f"{row['values'][0]:g} to {row['values'][1]:g} N/m",
            f"{row['distance'][0]:.1e} to {row['distance'][1]:.1e} m",
            f"{row['slope']:.2f}",
        ]
        for row in facts["rows"]
    ]
    said = table(["grows", "from, to", "distance between the models, rms", "slope"], rows)
    if facts["motion"] == "settle":
        depth = f"{facts['depth_over_expected']:.3f} m g/(n k_n)"
        said += "\n\n" + table(["how deep the robot stands in the ground at the highest k_n"], [[depth]])
    return said + made_by(facts, f"equivalence_{facts['motion']}")


def hard_cases_facts(raw: Facts) -> Facts:
    """A row for each case and precision; why a method refuses some cases stands once."""
    rows, refused = [], set()
    for case, precisions in raw["table"].items():
        for dtype, cells in precisions.items():
            rows.append({"case": case, "dtype": dtype} | {method: _cell_facts(cell) for method, cell in cells.items()})
            refused |= {(m, cell["reason"]) for m, cell in cells.items() if cell["verdict"] == "refused"}
    reasons = [{"method": method, "reason": reason} for method, reason in sorted(refused)]
    known = chosen(raw, "command", "cores", "most_implicit_steps", "counts")
    return known | {"refused": reasons, "rows": rows}


def _cell_facts(cell: Facts) -> Facts | str:
    """Error and error bar, m, with the verdict where it is not "right"; or what became of the rollout."""
    if cell["verdict"] == "refused":
        return "refused"
    if cell["error"] is None:
        return f"{cell['verdict']}: {cell['reason']}"
    found = chosen(cell, "error", "bar")
    return found if cell["verdict"] == "right" else found | {"verdict": cell["verdict"]}


def hard_cases_table(facts: Facts) -> str:
    counts = facts["counts"] | {"steps allowed to implicit methods": facts["most_implicit_steps"]}
    counts = table(list(counts), [[str(count) for count in counts.values()]])
    methods = [name for name in facts["rows"][0] if name not in ("case", "dtype")]
    found = [counts]
    for dtype in ("float64", "float32"):
        rows = [row for row in facts["rows"] if row["dtype"] == dtype]
        cells = [[row["case"], *(_cell_text(row[method]) for method in methods)] for row in rows]
        found.append(f"**{dtype}**, error in m\n\n{table(['case', *methods], cells)}")
    reasons = [[row["method"], row["reason"]] for row in facts["refused"]]
    found.append(table(["refuses", "reason"], reasons))
    return "\n\n".join(found) + made_by(facts, "hard_cases")


def _cell_text(cell: Facts | str) -> str:
    if isinstance(cell, str):
        return cell
    verdict = f"{cell['verdict']}: " if "verdict" in cell else ""
    return f"{verdict}{cell['error']:.0e} (bar {cell['bar']:.0e})"


def work_precision_facts(raw: Facts) -> Facts:
    kept = ("command", "cores", "scene", "error_of", "models_apart", "target", "cost_at_target")
    return chosen(raw, *kept)


def work_precision_table(facts: Facts) -> str:
    costs = facts["cost_at_target"]
    cheapest = min(costs.values())
    head = ["error of", "allowed, in the median", "distance of the two models' converged answers"]
    about = [facts["error_of"], f"{1e3 * facts['target']:g} mm", f"{facts['models_apart']:.1e} m"]
    rows = [[name, f"{1e3 * cost:.3f}", f"{cost / cheapest:.1f}"] for name, cost in costs.items()]
    costs_head = ["cheapest setting", "ms per gait and simulated second", "times the cheapest"]
    name = f"work_precision_{facts['scene'].replace(' ', '_')}"
    return f"{table(head, [about])}\n\n{table(costs_head, rows)}" + made_by(facts, name)


def chosen(raw: Facts, *names: str) -> Facts:
    """Some of the entries."""
    return {name: raw[name] for name in names}

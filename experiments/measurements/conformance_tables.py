"""The tables of docs/conformance.md, and that of NTRT's structures in docs/files.md."""

from numerics_tables import chosen
from pages import made_by, table

Facts = dict


def conformance_facts(raw: Facts) -> Facts:
    names = ("case", "source", "theirs", "ours", "unit", "difference")
    return chosen(raw, "command", "cores") | {"rows": [chosen(row, *names) for row in raw["rows"]]}


def conformance_table(facts: Facts) -> str:
    rows = [
        [
            row["case"],
            row["source"],
            f"{row['theirs']:.6g} {row['unit']}".strip(),
            f"{row['ours']:.6g} {row['unit']}".strip(),
            "0" if row["difference"] == 0 else f"{row['difference']:.0e}",
        ]
        for row in facts["rows"]
    ]
    return table(["case", "source", "theirs", "ours", "difference"], rows) + made_by(facts, "conformance")


def ntrt_facts(raw: Facts) -> Facts:
    return chosen(raw, "command", "cores", "duration", "rows")


def ntrt_table(facts: Facts) -> str:
    rows = []
    for row in facts["rows"]:
        ends = [row[model] for model in ("exact", "penalty")]
        rows.append(
            [
                f"{row['file']}.yaml",
                f"{row['nodes']}, {row['rods']}, {row['strings']}",
                f"{row['mass']:.3f} kg",
                f"{row['size']:.2f} m",
                f"{1e3 * row['moved']:.0f} mm",
                f"{ends[0]['start']:.2f} m",
                *(f"{end['end']:.2f} m" if end["outcome"] == "succeeded" else end["outcome"] for end in ends),
            ]
        )
    head = ["file", "nodes, rods, strings", "mass", "size", "moved as it settled", "height then"]
    after = [f"after {facts['duration']:g} s, {model} contact" for model in ("exact", "penalty")]
    return table([*head, *after], rows) + made_by(facts, "ntrt")

"""The tables of docs/validation.md."""

from numerics_tables import chosen
from pages import made_by, table

Facts = dict
UNIT = {"x": "mm", "z": "mm", "rotation": "°"}


def spine_facts(raw: Facts) -> Facts:
    names = ("command", "cores", "fitted_runs", "held_out_runs", "held_out", "repeatability", "misfit")
    return chosen(raw, *names) | {
        "statics": [chosen(row, "name", "kind", "spread", "value", "standard_error") for row in raw["statics"]]
    }


def spine_table(facts: Facts) -> str:
    rows = [
        [
            name,
            f"{seen['before']:.2f} {unit}",
            f"{seen['after']:.2f} {unit}",
            f"{facts['repeatability'][name]:.2f} {unit}",
        ]
        for (name, unit), seen in zip(UNIT.items(), facts["held_out"].values())
    ]
    held_out = f"rms error in {facts['held_out_runs']} runs held out"
    head = [held_out, "as sold", f"identified from {facts['fitted_runs']} other runs", "the robot from run to run"]
    return table(head, rows) + made_by(facts, "spine")


def spine_parameters_table(facts: Facts) -> str:
    return estimates_table(facts["statics"]) + made_by(facts, "spine")


def estimates_table(rows: list[Facts]) -> str:
    """Factors as they are, offsets of lengths in mm."""
    cells = []
    for row in rows:
        size, unit = (1.0, "") if row["kind"] == "factor" else (1e3, " mm")
        error = f"{2 * size * row['standard_error']:.2g}{unit}"
        value = "cannot be told" if row["value"] is None else f"{size * row['value']:.3g}{unit} ± {error}"
        plausible = f"1 ({row['spread']:g})" if row["kind"] == "factor" else f"0{unit} ({size * row['spread']:g}{unit})"
        cells.append([row["name"].removeprefix("scene."), row["kind"], plausible, value])
    return table(["parameter", "", "plausible before (standard deviation)", "identified"], cells)

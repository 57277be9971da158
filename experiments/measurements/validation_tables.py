"""The tables of docs/validation.md."""

from numerics_tables import chosen
from pages import made_by, table

Facts = dict
UNIT = {"x": "mm", "z": "mm", "rotation": "°"}


def validation_facts(raw: Facts) -> Facts:
    return chosen(raw, "command", "cores", "commands", "runs", "missing", "authors", "camera")


def validation_table(facts: Facts) -> str:
    rows = []
    for name, unit in UNIT.items():
        seen = facts["camera"][name]
        authors = facts["authors"][name]
        rows.append(
            [
                name,
                f"{1e3 * authors:.1f} µm" if unit == "mm" else f"{authors:.1e}{unit}",
                f"{seen['least']:.2f} to {seen['most']:.2f} {unit}",
                f"{seen['mean']:.2f} {unit}",
                f"{seen['repeatability']:.2f} {unit}",
                f"{seen['middle_least']:.2f} to {seen['middle_most']:.2f} {unit}",
            ]
        )
    head = ["", "from the authors' poses, at most", "from the camera's, rms of a run", "in the mean"]
    head += ["the robot from run to run", "from frames 0.5 to 1.4 s after a command"]
    return table(head, rows) + made_by(facts, "validation")


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

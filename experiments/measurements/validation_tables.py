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


def spine_dynamics_facts(raw: Facts) -> Facts:
    names = ("command", "cores", "lowest", "highest", "frequency", "misfit", "ratios", "tried")
    return chosen(raw, *names) | {"fits": [chosen(fit, "ratio", "squares", "shape") for fit in raw["fits"]]}


def spine_dynamics_table(facts: Facts) -> str:
    begin, duration, scatter = min(facts["fits"], key=lambda fit: fit["squares"])["shape"]
    squares = [fit["squares"] for fit in facts["fits"]]
    bands = (f"{low:.1f} to {high:.1f}" for low, high in zip(facts["lowest"], facts["highest"]))
    rows = [
        ["simulated: the vertebra's three slowest modes over the commands", f"{', '.join(bands)} Hz"],
        ["motors move", f"from {begin:.2f} s after the command is logged, for {duration:.2f} s"],
        ["scatter of the clocks", f"{abs(scatter):.3f} s"],
        ["damping ratios tried", f"{facts['tried'][0]:g} to {facts['tried'][1]:g}"],
        ["sum of squares over them", f"{min(squares):.2f} to {max(squares):.2f}"],
        ["damping ratios that cannot be told apart", f"{facts['ratios'][0]:g} to {facts['ratios'][1]:g}"],
    ]
    return table(["mean response to a command", "measured"], rows) + made_by(facts, "spine_dynamics")

"""The library's gaits on robots that differ in all that a search takes as uncertain, for a minute, on both contact
models. Leaves robots_that_differ.json and a figure of every robot's speed.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns, whole_zero

from jaxgrity import SolverOptions, contact_twin, gait_names, gait_record, load_gait, load_scene, with_gait
from jaxgrity.model import body_length
from jaxgrity.report import plot
from jaxgrity.search import EvaluationConfig, RobotMotions, robot_motions

GAITS = tuple(name for name in gait_names() if name not in ("steep", "uphill"))
"""Those on level ground: speeds of the gait that climbs are in its record."""
SEED = 20_000_000
"""far from those of searches: by these draws no gait was chosen"""
OPTIONS = SolverOptions(dtype="float32")
ENOUGH = 0.85
"""share of the speed of the gait's orbit, on its own contact model, from which on a robot counts as rolling"""


@measurement(page="gait_records.md", quick={"gaits": ("straight",), "robots": 8, "duration": 20.0}, drawn=("speeds",))
def robots_that_differ(
    gaits: tuple[str, ...] = GAITS,
    robots: int = 64,
    duration: float = 60.0,
) -> Iterator[Record]:
    """A row for each gait on each contact model.

    Args:
        gaits: names of the library's gaits
        robots: that each gait is tried on
        duration: s; the first quarter is left to settling
    """
    scenes = [with_gait(load_scene(gait_record(name)["scene"]), load_gait(name)) for name in gaits]
    for name, own in zip(gaits, scenes):
        orbit = gait_record(name)["steady"]["speed"]
        for scene in (own, contact_twin(own)):
            contact = "exact" if scene.constrained else "penalty"
            uncertain = EvaluationConfig().uncertainty
            found = robot_motions(scene, uncertain, robots=robots, duration=duration, seed=SEED, options=OPTIONS)
            size = float(body_length(scene))
            known = {"gait": name, "contact": contact, "own": scene is own}
            yield known | told(found, orbit, size) | {"speeds": found.speed / size}


def told(found: RobotMotions, orbit: float, size: float) -> dict[str, Any]:
    """Of all robots on one contact model, in body lengths; `orbit` is the gait's speed, m/s."""
    facts = found.summary()
    return {
        "nominal": orbit / size,
        "mean": facts["speed"] / size,
        "standard_deviation": facts["standard_deviation"] / size,
        "displacement": facts["displacement"] / size,
        "displacement_standard_deviation": facts["displacement_standard_deviation"] / size,
        "bend": facts["bend"],
        "bend_quartiles": facts["bend_quartiles"],
        "rolling": float((found.speed >= ENOUGH * orbit).mean()),
    }


@robots_that_differ.table
def words(record: Record) -> str:
    """Speeds of all robots, beside that of the gait's orbit."""
    cells = {
        "gait": "{gait}",
        "contact": lambda row: f"{row['contact']}, its own" if row["own"] else row["contact"],
        "speed along the path, body lengths/s": "{mean:.3f} ({standard_deviation:.2g})",
        "share of the orbit's": lambda row: "{:.0f} % ({:.0f} %)".format(
            *(100 * (row[name] / row["nominal"]) for name in ("mean", "standard_deviation"))
        ),
        "robots above 85 % of it": lambda row: f"{100 * row['rolling']:.0f} %",
        "displacement over time, body lengths/s": "{displacement:.3f} ({displacement_standard_deviation:.2g})",
        "bend, ° per body length": lambda row: (
            f"{degrees(row['bend'])} ({' to '.join(map(degrees, row['bend_quartiles']))})"
        ),
    }
    return columns(record["rows"], cells)


def degrees(angle: float) -> str:
    """Of an angle in rad, whole."""
    return f"{whole_zero(round(np.degrees(angle))):.0f}"


@robots_that_differ.figure(5.4)
def figure(record: Record, chart: Figure) -> None:
    """The speed of every robot, sorted."""
    names = list(dict.fromkeys(row["gait"] for row in record["rows"]))
    fastest = {name: max(row["nominal"] for row in record["rows"] if row["gait"] == name) for name in names}
    names.sort(key=fastest.get)
    halves = names[: len(names) // 2], names[len(names) // 2 :]
    for pane, gaits, title in zip(chart.subfigures(1, 2), halves, ("the slower gaits", "the faster gaits")):
        axes = pane.subplots()
        for row in (each for each in record["rows"] if each["gait"] in gaits):
            speeds, k = np.sort(np.nan_to_num(np.asarray(row["speeds"], float))), gaits.index(row["gait"])  # failed: 0
            look = {"color": f"C{k}", "label": f"{row['gait']}, {row['contact']}"}
            if row["contact"] == "penalty":
                look |= {"marker": plot.MARKERS[k], "markersize": 5, "markevery": 0.1, "linestyle": "--"}
            axes.plot(np.linspace(0, 100, len(speeds)), speeds, **look)
        axes.set(xlabel="robots (%), slowest first", ylabel="speed along the path (body lengths/s)", title=title)
        axes.set_ylim(0, None)
        pane.legend(loc="outside lower center", ncols=2)

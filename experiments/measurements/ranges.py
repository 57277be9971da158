"""How far a gait's orbit reaches: its steady speed as friction, stiffness, mass, amplitude or frequency change.

One quantity at a time is scaled, on both contact models, and robots that start anyhow are rolled out for each of its
values. Where all of them roll at one speed there is one orbit that attracts them; where the share falls, it ends.
"""

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from measurements.driven import drops
from measurements.measurement import Figure, Record, measurement
from measurements.pages import by_name, columns

from jaxgrity import (
    Differences,
    Gait,
    Scene,
    SolverOptions,
    SteadySpeed,
    contact_twin,
    gaits_of,
    load_gait,
    load_scene,
    simulate_population,
    with_gait,
)
from jaxgrity.report import plot
from jaxgrity.stepping import default_method, default_step

SPANS = {
    "friction": (0.2, 2.0),
    "cable stiffness": (0.6, 1.6),
    "node mass": (0.6, 1.6),
    "amplitude": (0.7, 1.3),
    "frequency": (0.5, 1.5),
}
"""smallest and largest factor of each quantity"""
ROLLING = 0.3
"""body lengths/s, from which on a robot counts as rolling"""
MOST = 7 / 8
"""Share of robots that have to roll: all but one of eight, which may need longer from where it started."""


@measurement(
    page="gait_records.md", quick={"values": 3, "robots": 2, "duration": 20.0, "contacts": ("exact",)}, drawn=("scan",)
)
def ranges(
    values: int = 27,
    robots: int = 8,
    duration: float = 60.0,
    contacts: tuple[str, ...] = ("exact", "penalty"),
) -> Iterator[Record]:
    """A row for each quantity on each contact model.

    Args:
        values: of each quantity
        robots: for each value
        duration: s, of which the last three quarters count
        contacts: contact models
    """
    own = with_gait(load_scene("exact"), load_gait("straight"))
    for contact, name in product(contacts, SPANS):
        scene = own if contact == "exact" else contact_twin(own)
        factors = np.unique([*np.geomspace(*SPANS[name], values - 1), 1.0])
        speeds = scanned(scene, name, factors, robots, duration)
        scan = [{"factor": x, **told(each)} for x, each in zip(factors, speeds)]
        yield {"contact": contact, "quantity": name, **reach(scan), "scan": by_name(scan)}
    return {"robots": robots}


def reach(scan: list[Record]) -> Record:
    """The values next to each other about the gait's own where all robots roll but one of eight, and speeds there."""
    rolls = [row["rolling"] >= MOST for row in scan]
    low = high = middle = min(range(len(scan)), key=lambda k: abs(np.log(scan[k]["factor"])))
    while low > 0 and rolls[low - 1]:
        low -= 1
    while high < len(scan) - 1 and rolls[high + 1]:
        high += 1
    means = [row["mean"] for row in scan[low : high + 1] if row["mean"] is not None]
    ends = {"from": scan[low]["factor"], "to": scan[high]["factor"]}
    speeds = {"slowest": min(means, default=None), "fastest": max(means, default=None)}
    return {"at_the_gait": rolls[middle], **ends, **speeds}


def scanned(scene: Scene, name: str, factors: np.ndarray, robots: int, duration: float) -> np.ndarray:
    """(factors, robots), steady speed, body lengths/s; NaN where a rollout failed."""
    factor = np.repeat(factors, robots)
    nodes, cables = len(scene.structure.nodes), len(scene.structure.cables.edges)
    starts = [np.tile(x, (len(factors), 1, 1)) for x in drops(scene, robots, seed=0)]
    differences = Differences(
        positions=starts[0],
        velocities=starts[1],
        friction=factor if name == "friction" else None,
        cable_stiffness=np.tile(factor[:, None], cables) if name == "cable stiffness" else None,
        node_mass=np.tile(factor[:, None], nodes) if name == "node mass" else None,
    )
    gaits = scaled(scene, name, factor)
    # half of the scene's own step, since stiffer and lighter robots, and stronger gaits, need smaller ones
    options = SolverOptions(dt=default_step(scene, default_method(scene)) / 2, dtype="float32")
    objective = SteadySpeed()
    outcomes = simulate_population(
        scene, gaits, duration, options=options, differences=differences, parts=objective.parts
    )
    return np.asarray(objective.worth(scene, outcomes, duration)).reshape(len(factors), -1)


def scaled(scene: Scene, name: str, factor: np.ndarray) -> Gait:
    """The scene's gait for each robot, its amplitudes or frequency scaled."""
    gait = scene.gait
    assert gait is not None, "a gait of the library"
    rows = {
        part: np.repeat(np.asarray(getattr(gait, part))[None], len(factor), 0) for part in ("amplitude", "frequency")
    }
    if name in rows:
        rows[name] = rows[name] * factor[:, None]
    return gaits_of(gait, np.repeat(np.asarray(gait.phase)[None], len(factor), 0), rows["amplitude"], rows["frequency"])


def told(speeds: np.ndarray) -> dict[str, Any]:
    """Of the robots of one value: how many roll, and how fast those that do, in the mean and in the extremes."""
    rolling = speeds[speeds > ROLLING]
    names = ("mean", "slowest", "fastest")
    found = (rolling.mean(), rolling.min(), rolling.max()) if rolling.size else (None,) * 3
    return {"rolling": float((speeds > ROLLING).mean()), **dict(zip(names, found))}


@ranges.table
def words(record: Record) -> str:
    """From where to where robots roll, and how fast."""
    rolling = f"{np.ceil(MOST * record['robots']):.0f} of {record['robots']} robots roll at"
    cells = {
        "quantity": "{quantity}",
        "contact": "{contact}",
        rolling: lambda row: f"{row['from']:.2f} to {row['to']:.2f} times" if row["at_the_gait"] else "-",
        "speed there, body lengths/s": lambda row: (
            f"{row['slowest']:.2f} to {row['fastest']:.2f}" if row["slowest"] is not None else "-"
        ),
    }
    return columns(record["rows"], cells)


@ranges.figure(5)
def figure(record: Record, chart: Figure) -> None:
    """Speed of those that roll, and the share of robots that do, for each quantity."""
    grid = chart.subplots(2, len(SPANS), sharex="col", sharey="row")
    contacts = list(dict.fromkeys(row["contact"] for row in record["rows"]))
    for row in record["rows"]:
        k, column = contacts.index(row["contact"]), list(SPANS).index(row["quantity"])
        x, slowest, mean, fastest, rolling = (
            np.array(row["scan"][key], float) for key in ("factor", "slowest", "mean", "fastest", "rolling")
        )
        look = {"color": f"C{k}", "marker": plot.MARKERS[k], "markersize": 3}
        above, below = grid[:, column]
        above.plot(x, mean, **look, label=f"{row['contact']} contact, mean")
        above.fill_between(x, slowest, fastest, color=f"C{k}", alpha=0.25, lw=0, label="slowest to fastest")
        below.plot(x, 100 * rolling, **look)
        above.set(title=row["quantity"].replace(" ", "\n", 1))
        below.set(xlabel="factor", ylim=(-3, 103))
    for axes in grid.flat:
        axes.axvline(1, color="0.6", linewidth=0.8, zorder=0)
    grid[0, 0].set(ylabel="speed of those that roll\n(body lengths/s)", ylim=(0, None))
    grid[1, 0].set(ylabel="robots that roll (%)")
    chart.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)

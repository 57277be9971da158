"""How steep the gait `uphill` climbs: its speed up slopes, on robots whose friction differs, on both contact models.

The gait was searched for on 15 degrees alone. What counts is the displacement uphill over the second half of the time,
so that a robot that begins to slide, or turns round, is seen. With exact contact all is done at half the step too.
"""

import itertools
from collections.abc import Iterator

import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table

from jaxgrity import Differences, SolverOptions, contact_twin, gaits_of, load_gait, load_scene, simulate_population
from jaxgrity.report import plot
from jaxgrity.stepping import default_method, default_step

CLIMBS = 0.1
"""Speed uphill from which on a robot counts as climbing, m/s."""
OWN_SLOPE = 15.0
"""Slope of the scene `uphill`, degrees."""


@measurement(page="gait_records.md", quick={"slopes": (15.0,), "duration": 10.0})
def climbing(
    slopes: tuple[float, ...] = (0.0, 5.0, 10.0, 12.5, 15.0, 17.5, 20.0, 22.5, 25.0, 27.5, 30.0),
    friction: tuple[float, ...] = (0.8, 0.9, 1.0, 1.1, 1.2),
    duration: float = 120.0,
) -> Iterator[Record]:
    """A row for each slope: speeds uphill, m/s, for each friction.

    Args:
        slopes: degrees
        friction: times the scene's
        duration: s
    """
    own = load_scene("uphill")
    gait, nominal = load_gait("uphill"), float(own.ground.incline)
    step, twin = default_step(own, default_method(own)), contact_twin(own)
    ways = {"own": (own, step), "finer": (own, step / 2), "other": (twin, None)}
    gaits = gaits_of(gait, np.repeat(np.asarray(gait.phase)[None], len(friction), axis=0))
    for slope in slopes:
        lean = np.radians(slope) - nominal  # uphill is -x
        up = np.tile([-np.sin(lean), 0.0, np.cos(lean)], (len(friction), 1))
        differences = Differences(friction=np.array(friction), up=up)
        row: Record = {"slope": slope}
        for name, (scene, step) in ways.items():
            options = SolverOptions(dt=step)
            found = simulate_population(scene, gaits, duration, options=options, differences=differences, parts=2)
            path = np.asarray(found.com_path)[..., 0]
            speed = (path[:, 1] - path[:, 2]) / (duration / 2)
            row[name] = np.where(np.asarray(found.failure) == 0, speed, 0.0).tolist()
        yield row
    return {"friction": [float(own.friction.sliding_mu) * x for x in friction]}


@climbing.table
def words(record: Record) -> str:
    """Speeds by slope and friction on each contact model, and the steepest slope that is climbed."""
    rows, frictions = record["rows"], [f"friction {mu:.2g}" for mu in record["friction"]]
    ways = {"own": "exact contact", "finer": "exact contact, half the step", "other": "penalty contact"}
    steepest = [
        [title, *(steepest_climbed(rows, name, k) for k in range(len(frictions)))] for name, title in ways.items()
    ]
    tables = [table([f"steepest slope climbed at {CLIMBS} m/s", *frictions], steepest)]
    for name in ("own", "other"):
        speeds = [[f"{row['slope']:g}°", *(f"{round(speed, 2) + 0:.2f}" for speed in row[name])] for row in rows]
        tables.append(table([f"{ways[name]}, m/s uphill", *frictions], speeds))
    return "\n\n".join(tables)


def steepest_climbed(rows: list[Record], way: str, k: int) -> str:
    """The steepest slope that robots of the k-th friction climb, and all from the gait's own up to it."""
    from_own = [row for row in rows if row["slope"] >= OWN_SLOPE]
    climbed = list(itertools.takewhile(lambda row: row[way][k] >= CLIMBS, from_own))
    return f"{climbed[-1]['slope']:g}°" if climbed else "none"


@climbing.figure(3.6)
def figure(record: Record, chart: Figure) -> None:
    """Speed uphill against the slope, for each coefficient of friction."""
    rows, friction = record["rows"], record["friction"]
    panes = chart.subplots(1, 2, sharey=True)
    for axes, name, title in zip(panes, ("own", "other"), ("exact contact", "penalty contact")):
        speeds = np.array([row[name] for row in rows])
        for k, (mu, marker) in enumerate(zip(friction, plot.MARKERS)):
            axes.plot([row["slope"] for row in rows], speeds[:, k], f"{marker}-", label=f"friction {mu:.2g}")
        axes.axhline(0, color="black", linewidth=0.8)
        axes.set(title=title, xlabel="slope (degrees)")
    panes[0].set_ylabel("speed uphill (m/s)")
    chart.legend(*panes[0].get_legend_handles_labels(), loc="outside right upper")

"""The orbits of gaits of the library: how fast each goes once it has settled, how it turns, and whether it comes back.

Every gait is rolled out on its own scene and on the contact twin, each at three steps. The figure shows the path of the
centre of mass on both.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table

from jaxgrity import (
    Scene,
    centre_path,
    contact_twin,
    gait_names,
    gait_record,
    load_gait,
    load_scene,
    simulate,
    with_error,
    with_gait,
)
from jaxgrity.orbits import find_orbit, refined_orbit, stability
from jaxgrity.report import plot

NEAR = 20.0
"""m, which the path of a gait that turns does not leave, on one contact model at least"""


@measurement(page="gait_records.md", quick={"gaits": ("straight",), "roughly": True}, drawn=("path",))
def orbits(
    gaits: tuple[str, ...] = gait_names(),
    duration: float = 120.0,
    roughly: bool = False,
) -> Iterator[Record]:
    """A row for each gait on each contact model.

    Args:
        gaits: names of the library's gaits
        duration: s, for which each gait is watched
        roughly: on the gait's own scene alone, at one step
    """
    scenes = [with_gait(load_scene(gait_record(name)["scene"]), load_gait(name)) for name in gaits]
    for name, own in zip(gaits, scenes):
        for scene in (own,) if roughly else (own, contact_twin(own)):
            known = {"gait": name, "contact": "exact" if scene.constrained else "penalty", "own": scene is own}
            path = np.asarray(centre_path(scene, simulate(scene, duration, frame_rate=1)))[:, :2]
            yield known | settled_orbit(scene, duration, roughly) | {"path": path}


def settled_orbit(scene: Scene, duration: float, roughly: bool) -> dict[str, Any]:
    """The orbit of one gait on one scene."""
    orbit, bar = (find_orbit(scene, duration), None) if roughly else refined_orbit(scene, duration)
    multiplier = stability(scene, orbit).largest if orbit.verified_for else None
    return {**orbit.summary(), "speed_error_bar": bar, "multiplier": multiplier}


@orbits.table
def words(record: Record) -> str:
    """The orbit of each gait, or that there is none."""
    head = [
        "gait", "contact", "speed, body lengths/s", "turning, °/s", "periods per cycle", "Floquet multiplier",
        "settles after",
    ]  # fmt: skip
    return table(head, [cells_of(row) for row in record["rows"]])


def cells_of(row: Record) -> list[str]:
    """A line of the table."""
    contact = f"{row['contact']}, its own" if row["own"] else row["contact"]
    if not row["settled"] or row["slowest_window"] is None:
        return [row["gait"], contact, f"{row['body_lengths_per_second']:.2f}, no orbit", *["-"] * 4]
    bar = row["speed_error_bar"] / row["body_length"] if row["speed_error_bar"] is not None else np.inf
    grows = "-" if row["multiplier"] is None or not np.isfinite(row["multiplier"]) else f"{row['multiplier']:.2g}"
    return [
        row["gait"],
        contact,
        with_error(row["body_lengths_per_second"], bar, decimals=3),
        f"{round(np.degrees(row['turning']), 1) + 0.0:.1f}",
        f"{row['periods']}",
        grows,
        f"{row['settled_after']:.0f} s",
    ]


@orbits.figure(6)
def figure(record: Record, chart: Figure) -> None:
    """The paths of the centre of mass, seen from above; those that stay near, and those on slopes, apart."""
    rows = [{**row, "path": np.asarray(row["path"]) - row["path"][0]} for row in record["rows"]]
    turning = {row["gait"] for row in rows if np.abs(row["path"]).max() < NEAR}
    leaning = {row["gait"] for row in rows if load_scene(gait_record(row["gait"])["scene"]).ground.incline}
    level = {row["gait"] for row in rows} - turning - leaning
    left, right = chart.subfigures(1, 2)
    titles = {"centre of mass, from above": level, "gaits that turn": turning, "gaits on slopes": leaning}
    for pane, (title, shown) in zip((left, *right.subfigures(2, 1)), titles.items()):
        here = [row for row in rows if row["gait"] in shown]
        if not here:
            continue
        axes = pane.subplots()
        gaits = list(dict.fromkeys(row["gait"] for row in here))
        for row in here:
            k = gaits.index(row["gait"])
            look = {"color": f"C{k}", "linewidth": 1.2, "label": f"{row['gait']}, {row['contact']}"}
            if row["contact"] == "penalty":
                look |= {"marker": plot.MARKERS[k], "markersize": 5, "markevery": 0.1, "linestyle": "--"}
            axes.plot(*row["path"].T, **look)
        axes.set(xlabel="x (m)", ylabel="y (m)", title=title)
        axes.set_aspect("equal", adjustable="datalim")
        pane.legend(loc="outside lower center", ncols=2)

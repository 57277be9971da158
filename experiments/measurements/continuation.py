"""The orbit of a gait, followed: from exact contact to penalty contact, and along friction, cable stiffness and slope.

Each orbit begins in the state of the one before, at a value a little further from the gait's own, until the robot rolls
on no orbit any more. Where one attracts, the largest multiplier says how soon it will cease to.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import equinox as eqx
import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import by_name, columns
from tqdm import tqdm

from jaxgrity import Scene, centre_path, load_gait, load_scene, simulate, with_gait
from jaxgrity.model import body_length, penalty_twin
from jaxgrity.orbits import Orbit, find_orbit, restarted, stability

VALUES = {
    "friction": (np.geomspace(1, 0.2, 17), np.geomspace(1, 1.95, 7)),
    "cable stiffness": (np.geomspace(1, 0.6, 15), np.geomspace(1, 1.8, 14)),
    "slope": (np.arange(0, -6.1, -0.5), np.arange(0, 6.1, 0.5)),
    "stiffness of ground and struts": (np.geomspace(4, 0.25, 9),),
}
"""from the gait's own value outwards: factors, degrees downwards in the heading, and factors of the penalty twin's"""
SCALED = {"friction": lambda s: s.friction.mu, "cable stiffness": lambda s: s.structure.cables.stiffness}
STIFF = (lambda s: s.ground.stiffness, lambda s: s.structure.struts.stiffness, lambda s: s.structure.struts.damping)
"""where a scene has the numbers of each quantity"""
UNITS = {"slope": "downhill (°)"}
LOST, TURNED = 0.5, 45.0
"""of the speed on the gait's own scene, below which the orbit is another one; degrees, by which its heading is, on a
slope"""
WATCHED = 52.01
"""periods at each value"""
SETTLING, SHOWN = 8, 24
"""periods at the end, after some that are left to settling, whose speeds the figure shows"""

DRAWN = "value", "on_orbit", "multiplier", "each"
"""what the figure shows of each value"""


@measurement(page="gait_records.md", quick={"quick_values": True}, drawn=("each",))
def continuation(gait: str = "straight", quick_values: bool = False) -> Iterator[Record]:
    """A row for each quantity.

    Args:
        gait: of the library, for the scene "exact"
        quick_values: friction alone, two values
    """
    scene = with_gait(load_scene("exact"), load_gait(gait))
    own = find_orbit(scene, 2 * WATCHED / float(scene.gait.frequency[0]))
    for name, ways in ({"friction": (np.array([1.0, 0.9]),)} if quick_values else VALUES).items():
        each = [row for values in ways for row in followed(scene, own, name, tqdm(values, desc=name))]
        yield {"quantity": name, **span(each), "each": by_name(each, *DRAWN)}


def span(every: list[Record]) -> Record:
    """From where to where the orbit was followed, its speeds and multipliers there."""
    held = [row for row in every if row["on_orbit"]]
    values, speeds = [row["value"] for row in held], [row["speed"] for row in held]
    known = [(row["multiplier"], row["value"]) for row in held if row["multiplier"] is not None]
    return {
        "from": min(values),
        "to": max(values),
        "lost_below": any(row["value"] < min(values) for row in every),
        "lost_above": any(row["value"] > max(values) for row in every),
        "slowest": min(speeds),
        "fastest": max(speeds),
        "multiplier": max(known)[0] if known else None,
        "multiplier_at": max(known)[1] if known else None,
        "periods": sorted({row["periods"] for row in held}),
    }


def followed(scene: Scene, own: Orbit, name: str, values: np.ndarray) -> Iterator[dict[str, Any]]:
    """What becomes of the orbit at each of the values, up to the first at which it is lost."""
    last, watch = own, WATCHED * own.period
    for value in values:
        there = changed(scene, own, name, float(value))
        last = find_orbit(there, watch, beginning=last)
        row = told(there, last, own)
        # where the ground is level an orbit has no heading of its own
        turned = name == "slope" and abs(row["heading"]) > TURNED
        row["on_orbit"] = row["settled"] and row["speed"] > LOST * own.speed / own.body_length and not turned
        yield {"quantity": name, "value": float(value), **row}
        if not row["on_orbit"]:
            return


def changed(scene: Scene, own: Orbit, name: str, value: float) -> Scene:
    """The scene at one value of a quantity."""
    if name in SCALED:
        return eqx.tree_at(SCALED[name], scene, np.asarray(SCALED[name](scene)) * value)
    if name == "slope":
        # the ground stays as it is and gravity leans, so that states carry over
        heading, lean = heading_of(scene, own), np.radians(value)
        up = np.array([-np.sin(lean) * heading[0], -np.sin(lean) * heading[1], np.cos(lean)])
        return replace(scene, up=up)
    twin = penalty_twin(scene)
    for where in STIFF:
        twin = eqx.tree_at(where, twin, np.asarray(where(twin)) * value)
    return twin


def heading_of(scene: Scene, orbit: Orbit) -> np.ndarray:
    """(2,), the direction in which the robot goes in the cycle after the orbit's state."""
    moved = np.diff(path_after(scene, orbit, orbit.periods)[[0, -1]], axis=0)[0]
    return moved / np.linalg.norm(moved)


def path_after(scene: Scene, orbit: Orbit, periods: int) -> np.ndarray:
    """(periods + 1, 2), where the centre of mass is after each of the periods that follow the orbit's state, m."""
    here = restarted(scene, orbit)
    trajectory = simulate(here, periods * orbit.period, frame_rate=1 / orbit.period, velocities=orbit.state[1])
    return centre_path(scene, trajectory)[:, :2]


def told(scene: Scene, orbit: Orbit, own: Orbit) -> dict[str, Any]:
    """What the robot does on a scene: speeds in body lengths/s, its heading in degrees from that of its own orbit."""
    if not orbit.verified_for:
        nothing = dict.fromkeys(("periods", "multiplier"))
        return {"settled": False, "speed": 0.0, "heading": 0.0, **nothing, "each": []}
    size = float(body_length(scene))
    path = path_after(scene, orbit, SETTLING + SHOWN)[SETTLING:]
    each = np.linalg.norm(np.diff(path, axis=0), axis=1) / orbit.period / size
    (x, y), (a, b) = path[-1] - path[0], heading_of(scene, own)
    held = stability(scene, orbit, robots=32) if orbit.settled else None
    return {
        "settled": orbit.settled,
        "speed": orbit.speed / size,
        "heading": float(np.degrees(np.arctan2(a * y - b * x, a * x + b * y))),
        "periods": orbit.periods,
        "multiplier": None if held is None or not np.isfinite(held.largest) else held.largest,
        "each": each.tolist(),
    }


@continuation.table
def words(record: Record) -> str:
    """How far the orbit was followed, and what it is like there."""

    def value(row: Record, x: float) -> str:
        return f"{x:+.1f}°" if row["quantity"] == "slope" else f"{x:.2f} times"

    def end(row: Record, x: str, lost: str) -> str:
        return f"{value(row, row[x])}, {'lost beyond' if row[lost] else 'no further tried'}"

    cells = {
        "quantity": "{quantity}",
        "from": lambda row: end(row, "from", "lost_below"),
        "to": lambda row: end(row, "to", "lost_above"),
        "speed, body lengths/s": "{slowest:.2f} to {fastest:.2f}",
        "largest multiplier": lambda row: (
            "-" if row["multiplier"] is None else f"{row['multiplier']:.2g} at {value(row, row['multiplier_at'])}"
        ),
        "periods in a cycle": lambda row: " or ".join(str(count) for count in row["periods"]),
    }
    return columns(record["rows"], cells)


@continuation.figure(5)
def figure(record: Record, chart: Figure) -> None:
    """Of each quantity the speed in every one of the last periods, and the largest multiplier."""
    grid = chart.subplots(2, len(record["rows"]), sharex="col", sharey="row", squeeze=False)
    for (above, below), quantity in zip(grid.T, record["rows"]):
        each = [dict(zip(DRAWN, values)) for values in zip(*(quantity["each"][name] for name in DRAWN))]
        for row in each:
            look = {"color": "C0", "marker": "."} if row["on_orbit"] else {"color": "0.6", "marker": "x"}
            label = "a period on the orbit" if row["on_orbit"] else "a period after the orbit is lost"
            above.plot([row["value"]] * len(row["each"]), row["each"], linestyle="", markersize=4, label=label, **look)
        known = [row for row in each if row["on_orbit"] and row["multiplier"] is not None]
        held = np.array(sorted((row["value"], row["multiplier"]) for row in known)).reshape(-1, 2)
        below.semilogy(*held.T, "s-", color="C2", markersize=3, label="largest multiplier")
        below.axhline(1, color="0.6", linewidth=0.8, zorder=0)
        name = quantity["quantity"]
        above.set_title(name.replace(" of ", "\nof "))
        below.set(xlabel=UNITS.get(name, "factor"))
        if name.startswith("stiffness of"):
            below.set_xscale("log", base=2)
    grid[0, 0].set(ylabel="speed in each period\n(body lengths/s)", ylim=(0, None))
    grid[1, 0].set(ylabel="largest Floquet multiplier")
    named = {label: line for axes in grid.flat for line, label in zip(*axes.get_legend_handles_labels())}
    chart.legend(named.values(), named, loc="outside lower center", ncols=3)

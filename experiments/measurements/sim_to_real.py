"""How fast a gait will roll on a robot that has been measured: before and after it is identified from one throw.

A robot differs from the scene in four numbers. Seen falling and sliding once, it is identified; the steady speed of the
gait is then foretold for robots that are plausible before and after, with the share of each number in what is not sure.
"""

from functools import partial
from typing import Any

import jax
import numpy as np
from measurements.measurement import Figure, Record, check_names, measurement
from measurements.pages import table

from jaxgrity import Scene, SolverOptions, gait_names, load_gait, load_scene, simulate, with_gait
from jaxgrity.identification import (
    Identified,
    Parameter,
    SeenPositions,
    SpeedForecast,
    Starts,
    changed,
    identify,
    measured_motion,
    speed_forecast,
)
from jaxgrity.orbits import find_orbit
from jaxgrity.report import plot

PARAMETERS = (
    Parameter("structure.cables.stiffness", 0.1),
    Parameter("structure.cables.damping", 0.3),
    Parameter("structure.node_mass", 0.1),
    Parameter("friction.mu", 0.3),
)
FRAME_RATE, NOISE = 50.0, 5e-3
"""1/s; m"""
HEIGHT, SPEED = 0.1, 1.0
"""m and m/s, of the throw"""


@measurement(page="identification.md", quick={"robots": 8, "seen": 0.2}, drawn=("speeds",))
def sim_to_real(gait: str = "lasting", robots: int = 128, seen: float = 0.6, seed: int = 0) -> Record:
    """Throw, identify, foretell. Raises `InputError` for a gait that the library does not have.

    Args:
        gait: of the library
        robots: that are drawn, before and after
        seen: s, for which the throw is seen
        seed: of all draws
    """
    check_names("gait", (gait,), gait_names())
    random = np.random.default_rng(seed)
    scene, moves = with_gait(load_scene("reference"), None), load_gait(gait)
    truth = changed(scene, PARAMETERS, random.uniform(-1, 1, len(PARAMETERS)))
    after = throw_and_identify(scene, truth, seen, random)
    before = after._replace(scene=scene, z=np.zeros(len(PARAMETERS)), covariance=np.eye(len(PARAMETERS)))
    found = {
        name: speed_forecast(jax.random.key(seed), known, moves, robots=robots)
        for name, known in (("before", before), ("after", after))
    }
    true = find_orbit(with_gait(truth, moves), 80.0)
    forecasts = {name: facts_of(each, after if name == "after" else None) for name, each in found.items()}
    about = {"gait": gait, "robots": robots, "seen": seen, "true": true.speed}
    return {**about, "forecasts": forecasts, "speeds": {name: each.speeds for name, each in found.items()}}


@sim_to_real.table
def words(record: Record) -> str:
    """What was foretold, before and after, and what the robot does."""
    rows = [
        [
            f"{name} identification",
            f"{each['mean']:.4f}",
            f"{each['standard_deviation']:.2g}",
            f"{each['speed']:.4f}",
            f"{each['by_gradient']:.2g}",
            f"{each['rolling']:.0%}",
            f"{each['explained']:.0%}",
        ]
        for name, each in record["forecasts"].items()
    ]
    rows.append(["the robot itself", "", "", f"{record['true']:.4f}", "", "", ""])
    speed = ["mean speed, m/s", "standard deviation, m/s", "most probable robot, m/s"]
    others = ["standard deviation by the gradient, m/s", "robots near full speed", "variance explained"]
    return table([f"{record['robots']} plausible robots", *speed, *others], rows)


@partial(sim_to_real.table, part="shares")
def shares(record: Record) -> str:
    """What each parameter is worth knowing."""
    rows = []
    for name, forecast in record["forecasts"].items():
        about = name
        for each in forecast["parameters"]:
            parts = [f"{each[key]:.0%}" for key in ("gradient_share", "share")]
            rows.append([about, f"`{each['name']}`", f"{each['spread']:.1%}", f"{each['slope']:+.4f}", *parts])
            about = ""
    head = ["identification", "parameter", "spread that is left", "change of speed per first spread, m/s"]
    return table([*head, "variance removed, by the gradient", "variance removed, by the robots"], rows)


def throw_and_identify(scene: Scene, truth: Scene, duration: float, random: np.random.Generator) -> Identified:
    """From positions of all nodes in one throw, its start unknown."""
    nodes = np.asarray(simulate(scene, 3.0, frame_rate=1.0).positions[-1]) + np.array([0, 0, HEIGHT])
    spin = np.cross(random.normal(0, 1, 3), nodes - nodes.mean(0))
    options = SolverOptions("rk4", dt=5e-4)
    how: dict[str, Any] = {"options": options, "frame_rate": FRAME_RATE, "positions": nodes}
    moved = simulate(truth, duration, velocities=spin + np.array([SPEED, 0, 0]), **how)
    seen = np.asarray(moved.positions) + random.normal(0, NOISE, moved.positions.shape)
    rows, starts = seen.reshape(len(seen), -1), Starts(seen, spread=(0.02, 1.0))
    motion = measured_motion(scene, np.asarray(moved.times), rows, NOISE, SeenPositions(), starts, options=options)
    return identify(scene, PARAMETERS, motion)


def facts_of(each: SpeedForecast, identified: Identified | None) -> dict[str, Any]:
    """Of one forecast, parameter by parameter."""
    errors = np.ones(len(each.names)) if identified is None else np.sqrt(np.diag(identified.covariance))
    return {
        "speed": each.orbit.speed,
        "mean": each.mean,
        "standard_deviation": each.standard_deviation,
        "by_gradient": each.gradient_deviation,
        "rolling": each.rolling,
        "explained": each.explained,
        "parameters": [
            {
                "name": name,
                "spread": PARAMETERS[k].spread * errors[k],
                "slope": each.slopes[k],
                "gradient_share": each.gradient_shares[k],
                "share": each.shares[k],
            }
            for k, name in enumerate(each.names)
            if each.slopes is not None and each.gradient_shares is not None
        ],
    }


@sim_to_real.figure(6)
def figure(record: Record, chart: Figure) -> None:
    """Speeds of all robots, sorted, and what each parameter is worth knowing, before and after."""
    forecasts = record["forecasts"]
    above, *bars = chart.subplot_mosaic([["speeds"] * len(forecasts), list(forecasts)]).values()
    for (name, speeds), marker in zip(record["speeds"].items(), plot.MARKERS):
        percent, look = np.linspace(0, 100, len(speeds)), {"marker": marker, "markevery": 0.1, "markersize": 5}
        above.plot(percent, np.sort(np.asarray(speeds, float)), **look, label=f"forecast {name} identification")
    above.axhline(record["true"], color="black", linewidth=1, label="the robot itself")
    above.set(xlabel="plausible robots (%), slowest first", ylabel="steady speed (m/s)", ylim=(0, None))
    above.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    kinds = {"gradient_share": "by the orbit's gradient", "share": "over the robots"}
    for k, (axes, (name, each)) in enumerate(zip(bars, forecasts.items())):
        places = np.arange(len(each["parameters"]))
        for colour, offset, (kind, label) in zip(("C2", "C3"), (0.2, -0.2), kinds.items()):
            shares = [100 * row[kind] for row in each["parameters"]]
            axes.barh(places + offset, shares, 0.38, color=colour, label=label)
        paths = [row["name"].removeprefix("structure.") for row in each["parameters"]]
        names = [path.replace(".", " ").replace("_", " ") for path in paths]
        axes.set_yticks(places, [""] * len(names) if k else names)
        axes.grid(axis="y", visible=False)
        axes.set(xlabel="variance removed (%)", title=f"worth of each parameter\n{name} identification")
    chart.legend(*bars[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)

"""How fast a gait will roll on a robot that has been measured: before and after it is identified from one throw.

A robot differs from the scene in four numbers. Seen falling and sliding once, it is identified; the steady speed of the
gait is then foretold for robots that are plausible before and after, with the share of each number in what is not sure.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import jax
import numpy as np
from matplotlib.figure import Figure

from jaxgrity import Gait, InputError, Scene, SolverOptions, gait_names, load_gait, load_scene, simulate, with_gait
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
from jaxgrity.io.files import save_json
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


@dataclass
class Settings:
    gait: str = "lasting"
    """of the library"""
    robots: int = 128
    """that are drawn, before and after"""
    seen: float = 0.6
    """s, for which the throw is seen"""
    seed: int = 0
    out: Path = Path("results/sim_to_real")
    """folder for sim_to_real.json and the figure"""
    quick: bool = False
    """8 robots, and a throw seen for a fifth of a second"""


def main(settings: Settings) -> None:
    """Throw, identify, foretell. Raises `InputError` for a gait that the library does not have."""
    if settings.gait not in gait_names():
        raise InputError(f"gait = {settings.gait!r}: unknown; expected one of {', '.join(gait_names())}")
    if settings.quick:
        settings.robots, settings.seen = 8, 0.2
    random = np.random.default_rng(settings.seed)
    scene, gait = with_gait(load_scene("reference"), None), load_gait(settings.gait)
    truth = changed(scene, PARAMETERS, random.uniform(-1, 1, len(PARAMETERS)))
    after = throw_and_identify(scene, truth, settings, random)
    before = after._replace(scene=scene, z=np.zeros(len(PARAMETERS)), covariance=np.eye(len(PARAMETERS)))
    found = {name: forecast(known, gait, settings) for name, known in (("before", before), ("after", after))}
    true = find_orbit(with_gait(truth, gait), 80.0)
    facts = {name: facts_of(each, after if name == "after" else None) for name, each in found.items()}
    about = {"gait": settings.gait, "robots": settings.robots, "seen": settings.seen, "true": true.speed}
    save_json(settings.out / "sim_to_real.json", {**measured(), **about, "forecasts": facts})
    plot.save(figure(facts, true.speed), settings.out / "sim_to_real.png")
    print(f"the robot itself rolls at {true.speed:.4g} m/s")
    for name, each in found.items():
        print(f"{name} identification: {each.summary()}")
    print(f"{settings.out}/sim_to_real.json, sim_to_real.png")


def throw_and_identify(scene: Scene, truth: Scene, settings: Settings, random: np.random.Generator) -> Identified:
    """From positions of all nodes in one throw, its start unknown."""
    nodes = np.asarray(simulate(scene, 3.0, frame_rate=1.0).positions[-1]) + np.array([0, 0, HEIGHT])
    spin = np.cross(random.normal(0, 1, 3), nodes - nodes.mean(0))
    options = SolverOptions("rk4", dt=5e-4)
    how: dict[str, Any] = {"options": options, "frame_rate": FRAME_RATE, "positions": nodes}
    moved = simulate(truth, settings.seen, velocities=spin + np.array([SPEED, 0, 0]), **how)
    seen = np.asarray(moved.positions) + random.normal(0, NOISE, moved.positions.shape)
    rows, starts = seen.reshape(len(seen), -1), Starts(seen, spread=(0.02, 1.0))
    motion = measured_motion(scene, np.asarray(moved.times), rows, NOISE, SeenPositions(), starts, options=options)
    return identify(scene, PARAMETERS, motion)


def forecast(known: Identified, gait: Gait, settings: Settings) -> SpeedForecast:
    return speed_forecast(jax.random.key(settings.seed), known, gait, robots=settings.robots)


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
        "speeds": each.speeds,
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


@plot.styled
def figure(forecasts: dict[str, dict[str, Any]], true: float) -> Figure:
    """Speeds of all robots, sorted, and what each parameter is worth knowing, before and after."""
    chart = Figure(figsize=(10, 3.4), layout="constrained")
    sorted_speeds, *bars = chart.subplots(1, 1 + len(forecasts))
    kinds = {"gradient_share": "by the orbit's gradient", "share": "over the robots"}
    for axes, (name, each) in zip(bars, forecasts.items()):
        percent = np.linspace(0, 100, len(each["speeds"]))
        sorted_speeds.plot(percent, np.sort(each["speeds"]), label=f"{name} identification")
        places = np.arange(len(each["parameters"]))
        for offset, (kind, label) in zip((0.2, -0.2), kinds.items()):
            axes.barh(places + offset, [100 * row[kind] for row in each["parameters"]], 0.38, label=label)
        paths = [row["name"].removeprefix("structure.") for row in each["parameters"]]
        names = [path.replace(".", "\n").replace("_", " ") for path in paths]
        axes.set(yticks=places, yticklabels=names, xlabel="variance gone once known (%)")
        axes.set_title(f"{name.capitalize()} identification")
    bars[0].legend()
    sorted_speeds.axhline(true, color="black", linewidth=1, linestyle=":", label="the robot itself")
    sorted_speeds.set(xlabel="plausible robots (%), slowest first", ylabel="steady speed (m/s)", ylim=(0, None))
    sorted_speeds.set_title("Forecast")
    sorted_speeds.legend()
    return chart


if __name__ == "__main__":
    run(main, Settings)

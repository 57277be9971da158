"""How far a gait's orbit reaches: its steady speed as friction, stiffness, mass, amplitude or frequency change.

One quantity at a time is scaled, on both contact models, and robots that start anyhow are rolled out for each of its
values. Where all of them roll at one speed there is one orbit that attracts them; where the share falls, it ends.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import numpy as np
from basin import drops
from matplotlib.figure import Figure
from tqdm import tqdm

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
from jaxgrity.io.files import save_json
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


@dataclass
class Settings:
    gait: str = "straight"
    """of the library"""
    values: int = 27
    """of each quantity"""
    robots: int = 8
    """for each value"""
    duration: float = 60.0
    """s, of which the last three quarters count"""
    out: Path = Path("results/ranges")
    """folder for ranges.json and its figure"""
    quick: bool = False
    """three values, two robots, on exact contact alone"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.values, settings.robots, settings.duration = 3, 2, 20.0
    own = with_gait(load_scene("exact"), load_gait(settings.gait))
    scenes = {"exact": own} if settings.quick else {"exact": own, "penalty": contact_twin(own)}
    rows: list[dict[str, Any]] = []
    for contact, name in tqdm([(c, n) for c in scenes for n in SPANS], unit="scan"):
        factors = np.unique([*np.geomspace(*SPANS[name], settings.values - 1), 1.0])
        speeds = scanned(scenes[contact], name, factors, settings)
        rows += [{"contact": contact, "quantity": name, "factor": x, **told(each)} for x, each in zip(factors, speeds)]
    save_json(settings.out / "ranges.json", {**measured(), "robots": settings.robots, "rows": rows})
    plot.save(figure(rows), settings.out / "ranges.png")
    print(f"wrote {settings.out}/")


def scanned(scene: Scene, name: str, factors: np.ndarray, settings: Settings) -> np.ndarray:
    """(factors, robots), steady speed, body lengths/s; NaN where a rollout failed."""
    factor = np.repeat(factors, settings.robots)
    nodes, cables = len(scene.structure.nodes), len(scene.structure.cables.edges)
    starts = [np.tile(x, (len(factors), 1, 1)) for x in drops(scene, settings.robots, seed=0)]
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
        scene, gaits, settings.duration, options=options, differences=differences, parts=objective.parts
    )
    return np.asarray(objective.worth(scene, outcomes, settings.duration)).reshape(len(factors), -1)


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


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """Speed of those that roll, and the share of robots that do, for each quantity."""
    chart = Figure(figsize=(11, 4.6), layout="constrained")
    grid = chart.subplots(2, len(SPANS), sharex="col", sharey="row")
    for column, name in enumerate(SPANS):
        for contact in dict.fromkeys(row["contact"] for row in rows):
            mine = [row for row in rows if (row["contact"], row["quantity"]) == (contact, name)]
            x = [row["factor"] for row in mine]
            low, mid, high = (
                np.array([np.nan if row[k] is None else row[k] for row in mine]) for k in ("slowest", "mean", "fastest")
            )
            grid[0, column].plot(x, mid, marker="o", markersize=3, label=contact)
            grid[0, column].fill_between(x, low, high, alpha=0.25)
            grid[1, column].plot(x, [100 * row["rolling"] for row in mine], marker="o", markersize=3)
        grid[0, column].set(title=name)
        grid[1, column].set(xlabel="factor", ylim=(-3, 103))
        grid[0, column].axvline(1, color="0.7", linewidth=0.8, zorder=0)
    grid[0, 0].set(ylabel="speed of those that roll\n(body lengths/s)", ylim=(0, None))
    grid[1, 0].set(ylabel="robots that roll (%)")
    grid[0, 0].legend()
    return chart


if __name__ == "__main__":
    run(main, Settings)

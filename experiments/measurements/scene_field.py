"""Robots that are led through the obstacles of a scene file, which they can run into, on its uneven ground.

The obstacles are boxes, balls and cylinders of the file's `[ground]`: the planner keeps clear of the discs about them,
and the physics of both the robots and the model has them. The robots are not the model: they have springs for struts
and ground, friction that is off by up to 25 %, and start from drops.
"""

from dataclasses import dataclass
from pathlib import Path

from jaxgrity.cli.script import measured, run

import numpy as np
from basin import drops
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from obstacles import ARENA, GAITS, GOAL, NEAR, REACH, UNKNOWN, bounded, told
from tqdm import tqdm

from jaxgrity import Differences, Scene, contact_twin, load_gait, load_scene
from jaxgrity.control import (
    Foresight,
    PhaseLocked,
    Travels,
    WayMap,
    discs_of,
    gait_choices,
    room,
    side_by_side,
    sure_footed,
    travel,
    way_map,
)
from jaxgrity.io.files import save_json
from jaxgrity.report import plot

FIELD = Path(__file__).with_name("obstacle_field.toml")


@dataclass
class Settings:
    scene: Path = FIELD
    """its `[ground]` has obstacles"""
    robots: int = 10
    samples: int = 24
    """ways to go on that are tried for each robot, each by three robots of the model"""
    patience: float = 60.0
    """s"""
    seed: int = 0
    """of starts, friction and samples"""
    out: Path = Path("results/scene_field")
    """folder for scene_field.json and its figure"""
    quick: bool = False
    """two robots, 4 samples, two choices, on the model itself"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.robots, settings.samples, settings.patience = 2, 4, 1.5
    scene = load_scene(settings.scene)
    field = discs_of(scene.ground)
    way = way_map(field, GOAL, ARENA, reach=REACH + NEAR)
    found = led(scene, settings, way)
    rows = [told(found, field, k) for k in range(settings.robots)]
    facts = {"patience": settings.patience, "obstacles": len(field.radii), "seconds_a_choice": found.seconds}
    save_json(settings.out / "scene_field.json", {**measured(), **facts, "rows": rows})
    plot.save(figure(scene, way, found), settings.out / "scene_field.png")
    print(f"{sum(row['reached'] for row in rows)} of {len(rows)} reached without touching")


def led(scene: Scene, settings: Settings, way: WayMap) -> Travels:
    """All robots through the same field, from drops anyhow about the origin."""
    count = settings.robots
    draw = np.random.default_rng(settings.seed + 1)
    friction = 1 + draw.uniform(-UNKNOWN, UNKNOWN, count)
    q, v = drops(scene, count, settings.seed)
    above = scene.ground.height(q[..., 0], q[..., 1]).max(1)[:, None, None] * np.array([0, 0, 1])
    start = np.moveaxis(q + above, 0, -1), np.moveaxis(v, 0, -1)
    foresight = Foresight(samples=settings.samples, patience=settings.patience, reach=REACH, seed=settings.seed)
    gaits = {name: PhaseLocked(load_gait(name), np.zeros((2, 2))) for name in GAITS}
    gaits["lasting"] = sure_footed(load_gait("lasting"))
    robot = bounded(scene if settings.quick else contact_twin(scene))
    with tqdm(total=round(foresight.patience / foresight.interval), unit="choice") as bar:
        return travel(
            side_by_side(robot, count, Differences(friction=friction)),
            bounded(scene),
            gait_choices(scene.structure, gaits),
            [way] * count,
            start=start,
            foresight=foresight,
            on_choice=lambda _: bar.update(),
        )


@plot.styled
def figure(scene: Scene, way: WayMap, found: Travels) -> Figure:
    """The height of the ground between obstacles, the plan from the start of the first robot, and all paths."""
    chart = Figure(figsize=(6.5, 3.8), layout="constrained")
    axes = chart.subplots()
    x, y = np.meshgrid(np.linspace(-2, 12, 281), np.linspace(-5, 5, 201))
    height = np.where(room(way.discs, np.stack([x, y], -1)) > 0.1, scene.ground.height(x, y), np.nan)
    shown = axes.pcolormesh(x, y, 100 * height, cmap="Greys", alpha=0.5, shading="auto", rasterized=True)
    for centre, radius in zip(way.discs.centres, way.discs.radii):
        axes.add_patch(Circle(centre, radius, color="#b9b2a3"))
    for k, end in enumerate(found.arrived):
        axes.plot(*found.path[: end + 1, :2, k].T, lw=1)
    axes.plot(*way.way(found.path[0, :2, 0]).T, ":", color="black", lw=1, label="first plan")
    axes.plot(*way.goal, "o", markersize=6, markerfacecolor="none", color="black")
    axes.set(aspect="equal", xlim=(-2, 12), ylim=(-5, 5), xlabel="x (m)", ylabel="y (m)")
    chart.colorbar(shown, label="ground (cm)", shrink=0.7)
    axes.legend(loc="upper left")
    return chart


if __name__ == "__main__":
    run(main, Settings)

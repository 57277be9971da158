"""Robots that are led through the obstacles of a scene file, which they can run into, on its uneven ground.

The obstacles are boxes, balls and cylinders of the file's `[ground]`: the planner keeps clear of the discs about them,
and the physics of both the robots and the model has them. The robots are not the model: they have springs for struts
and ground, friction that is off by up to 25 %, and start from drops.
"""

import itertools
from pathlib import Path

import numpy as np
from matplotlib.colors import to_hex
from matplotlib.patches import Circle
from measurements.measurement import Figure, Record, measurement
from measurements.obstacles import ARENA, GAITS, GOAL, MARGIN, NEAR, REACH, led, told
from measurements.pages import table

from jaxgrity import contact_twin, load_gait, load_scene
from jaxgrity.control import CAUTIOUS, PhaseLocked, discs_of, gait_choices, room, sure_footed, way_map

FIELD = Path(__file__).with_name("obstacle_field.toml")


@measurement(page="control.md", quick={"robots": 2, "samples": 4, "patience": 1.5, "itself": True}, drawn=("shown",))
def scene_field(
    scene: Path = FIELD,
    robots: int = 10,
    samples: int = 24,
    patience: float = 60.0,
    seed: int = 0,
    itself: bool = False,
) -> Record:
    """How many robots get through.

    Args:
        scene: its `[ground]` has obstacles
        robots: led through the field
        samples: ways to go on that are tried for each robot, each by three robots of the model
        patience: s
        seed: of starts, friction and samples
        itself: the robots are the model
    """
    model = load_scene(scene)
    field = discs_of(model.ground)
    way = way_map(field, GOAL, ARENA, reach=REACH + NEAR)
    sampling = CAUTIOUS._replace(samples=samples, patience=patience, margin=MARGIN, seed=seed)
    gaits = {name: PhaseLocked(load_gait(name), np.zeros((2, 2))) for name in GAITS}
    gaits["lasting"] = sure_footed(load_gait("lasting"))
    robot, choices = model if itself else contact_twin(model), gait_choices(model.structure, gaits)
    found = led(model, robot, choices, [way] * robots, sampling)
    rows = [told(found, field, k) for k in range(robots)]
    arrived = [row for row in rows if row["reached"]]
    return {
        "patience": patience,
        "obstacles": len(field.radii),
        "robots": robots,
        **{name: sum(row[name] for row in rows) for name in ("reached", "arrived", "touched")},
        "seconds": float(np.median([row["seconds"] for row in arrived])) if arrived else None,
        "gap": min(row["gap"] for row in rows),
        "shown": {
            "scene": FIELD.name if scene == FIELD else str(scene.absolute()),
            "paths": [row["path"] for row in rows],
        },
    }


@scene_field.table
def words(record: Record) -> str:
    """How many robots got through, and how."""
    count, seconds = record["robots"], record["seconds"]
    rows = [
        ["goal reached, nothing touched", f"{record['reached']} of {count}"],
        ["touched something", f"{record['touched']}"],
        [f"did not arrive in {record['patience']:g} s", f"{count - record['arrived']}"],
        ["time to the goal, of robots that arrived, median", "-" if seconds is None else f"{seconds:.0f} s"],
        ["smallest distance from an obstacle", f"{100 * record['gap']:.0f} cm"],
    ]
    return table([f"robots among the {record['obstacles']} obstacles of a scene file", "measured"], rows)


@scene_field.figure(4.5)
def figure(record: Record, chart: Figure) -> None:
    """The height of the ground between obstacles, the plan from the start of the first robot, and all paths."""
    scene = load_scene(FIELD.parent / record["shown"]["scene"])
    paths = [np.array(path, float) for path in record["shown"]["paths"]]
    way = way_map(discs_of(scene.ground), GOAL, ARENA, reach=REACH + NEAR)
    axes = chart.subplots()
    (left, low), (right, high) = (end(np.concatenate(paths), axis=0) for end in (np.min, np.max))
    sides = (min(-2, left - 0.3), max(12, right + 0.3)), (min(-5, low - 0.3), max(5, high + 0.3))
    x, y = np.meshgrid(np.linspace(*sides[0], 281), np.linspace(*sides[1], 221))
    height = np.where(room(way.discs, np.stack([x, y], -1)) > 0.1, scene.ground.height(x, y), np.nan)
    shown = axes.pcolormesh(x, y, 100 * height, cmap="Greys", alpha=0.5, shading="auto", rasterized=True)
    for centre, radius in zip(way.discs.centres, way.discs.radii):
        axes.add_patch(Circle(centre, radius, color="#b9b2a3"))
    colours = [f"C{k}" for k in range(10) if to_hex(f"C{k}") != to_hex("black")]
    for path, colour in zip(paths, itertools.cycle(colours)):
        axes.plot(*path.T, lw=1, color=colour)
    axes.plot(*way.way(paths[0][0]).T, color="black", lw=1.6, ls="--", label="first plan of the first robot")
    axes.plot(*way.goal, "*", markersize=10, color="C2", label="goal")
    axes.set(aspect="equal", xlim=sides[0], ylim=sides[1], xlabel="x (m)", ylabel="y (m)")
    chart.colorbar(shown, label="ground (cm)", shrink=0.7)
    chart.legend(loc="outside lower center", ncols=2)

"""Robots that are led round obstacles by a choice of gaits, to goals 10 m away; each in a field of its own.

A field is drawn by its seed, and counts where the straight way is blocked and another is free. The robots are not the
model: they have springs for struts and ground, and their friction is off by up to 25 %. Beside it: the same controller
that does not know of the obstacles. Touching is judged by all struts and cables, once in a control period.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import numpy as np
from basin import drops
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from tqdm import tqdm

from jaxgrity import Cylinder, Differences, Scene, SolverOptions, Trajectory, contact_twin, load_gait, load_scene
from jaxgrity.control import (
    REACHED,
    Discs,
    Foresight,
    MotorLimits,
    PhaseLocked,
    Plant,
    Travels,
    WayMap,
    gait_choices,
    gap,
    plant_of,
    room,
    side_by_side,
    travel,
    way_map,
)
from jaxgrity.io.files import save_json
from jaxgrity.report import plot, view

PERIOD = 0.01
"""s, in which robots get a command"""
GOAL = np.array([10.0, 0.0])
ARENA = (-3.0, -5.0, 13.0, 5.0)
"""m, the least and the largest x and y"""
DISCS, RADII, ACROSS = 9, (0.25, 0.6), 3.0
"""obstacles of a field, between which radii, m, and how far from the straight way, m"""
REACH, SPARE, NEAR = 0.6, 0.3, 0.05
"""m, how far a robot sticks out from its centre of mass, how much wider than that a free way of a field is on both
sides, and how near to obstacles plans may lead on top of it"""
UNKNOWN = 0.25
"""share of the friction, within which it is drawn"""
GAITS = ("lasting", "fast", "left", "right")


@dataclass
class Settings:
    fields: int = 20
    samples: int = 24
    """ways to go on that are tried for each robot, each by three robots of the model"""
    patience: float = 60.0
    """s"""
    seed: int = 1
    """of fields, starts, friction and samples; the controller was made on those of 0"""
    out: Path = Path("results/obstacles")
    """folder for obstacles.json, its figure and a replay"""
    quick: bool = False
    """two fields, 4 samples, two choices, on the model itself"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.fields, settings.samples, settings.patience = 2, 4, 1.5
    scene = load_scene("exact")
    fields = drawn_fields(settings)
    maps = [way_map(field, GOAL, ARENA, reach=REACH + NEAR) for field in fields]
    found = led(scene, settings, maps)
    nothing = Discs(np.zeros((0, 2)), np.zeros(0))
    blind = led(scene, settings, [way_map(nothing, GOAL, ARENA)] * len(fields))
    rows = [{"seed": k, **told(found, field, k), "blind": told(blind, field, k)} for k, field in enumerate(fields)]
    names, frames = names_of(scene), round(Foresight().interval / PERIOD)
    going = np.arange(len(found.gaits))[:, None] * frames < found.arrived
    chosen = found.gaits[going]
    shares = {name: float(np.mean(np.isin(chosen, _rows_of(names, name)))) for name in dict.fromkeys(names)}
    save_json(
        settings.out / "obstacles.json",
        {
            **measured(),
            "patience": settings.patience,
            "samples": settings.samples,
            "copies": len(Foresight().friction),
            "interval": Foresight().interval,
            "horizon": Foresight().horizon,
            "gaits": shares,
            "spread": float(np.nanmedian(found.spread[going])),
            "surprise": float(np.nanmedian(found.surprise[going])),
            "seconds_a_choice": found.seconds,
            "rows": rows,
        },
    )
    plot.save(figure(fields, maps, found, blind), settings.out / "obstacles.png")
    shown = int(np.argmax([row["reached"] for row in rows]))
    keep_replay(scene, fields[shown], maps[shown], found, shown, settings.out / "replay.html")
    for name, each in (("planned", rows), ("blind", [row["blind"] for row in rows])):
        print(f"{name}: {sum(row['reached'] for row in each)} of {len(each)} reached without touching")


def drawn_fields(settings: Settings) -> list[Discs]:
    """Fields whose straight way is blocked, and that have another."""
    draw, found = np.random.default_rng(settings.seed), []
    straight = np.linspace(0, 1, 101)[:, None] * GOAL
    while len(found) < settings.fields:
        centres = draw.uniform([1.5, -ACROSS], [GOAL[0] - 1.5, ACROSS], (DISCS, 2))
        field = Discs(centres, draw.uniform(*RADII, DISCS))
        ends = room(field, np.stack([np.zeros(2), GOAL]))
        if room(field, straight).min() > 0.5 * REACH or ends.min() < REACH + SPARE + 0.2:
            continue
        if np.isfinite(way_map(field, GOAL, ARENA, reach=REACH + SPARE).to_go(np.zeros((1, 2)))).all():
            found.append(field)
    return found


def names_of(scene: Scene) -> tuple[str, ...]:
    return _gaits(scene).names


def _gaits(scene: Scene):
    """The library's gaits, of which the gains of feedback are known for the first alone."""
    locked = {name: PhaseLocked(load_gait(name)) for name in GAITS}
    locked = {name: each if name == "lasting" else replace(each, gains=0 * each.gains) for name, each in locked.items()}
    return gait_choices(scene.structure, locked)


def _rows_of(names: tuple[str, ...], name: str) -> list[int]:
    return [k for k, each in enumerate(names) if each == name]


def led(scene: Scene, settings: Settings, maps: list[WayMap]) -> Travels:
    """All robots, from drops anyhow."""
    count = len(maps)
    model = bounded(scene)
    robot = model if settings.quick else bounded(contact_twin(scene))
    draw = np.random.default_rng(settings.seed + 1)
    friction = 1 + draw.uniform(-UNKNOWN, UNKNOWN, count)
    start = tuple(np.moveaxis(x, 0, -1) for x in drops(scene, count, settings.seed))
    foresight = Foresight(samples=settings.samples, patience=settings.patience, reach=REACH, seed=settings.seed)
    bar = tqdm(total=round(foresight.patience / foresight.interval), unit="choice")
    with bar:
        return travel(
            side_by_side(robot, count, Differences(friction=friction)),
            model,
            _gaits(scene),
            maps,
            start=start,
            foresight=foresight,
            on_choice=lambda _: bar.update(),
        )


def bounded(scene: Scene) -> Plant:
    """A plant in single precision, at a coarse step where struts are rigid, with motors of 1.2 m/s."""
    options = SolverOptions(dt=0.01 if scene.constrained else None, dtype="float32")
    return plant_of(scene, load_gait("lasting").members, motors=MotorLimits(rate=1.2), options=options)


def told(found: Travels, field: Discs, robot: int) -> dict[str, Any]:
    """Of one robot, judged by the field that is there."""
    end = int(found.arrived[robot])
    here = np.linalg.norm(found.path[end, :2, robot] - GOAL) < REACHED
    nodes = found.nodes[: end + 1, :, :, robot]
    least = float(gap(field, load_scene("exact").structure, nodes).min())
    path = found.path[: end + 1, :2, robot]
    return {
        "arrived": bool(here),
        "touched": least < 0,
        "reached": bool(here and least >= 0),
        "seconds": PERIOD * end,
        "gap": least,
        "length": float(np.linalg.norm(np.diff(path[::10], axis=0), axis=1).sum()),
    }


def keep_replay(scene: Scene, field: Discs, way: WayMap, found: Travels, robot: int, path: Path) -> None:
    """A page with the robot, its obstacles as posts, and the way that was planned from the start."""
    posts = tuple(Cylinder([*c, 0.0], [*c, 1.0], r) for c, r in zip(field.centres, field.radii))
    twin = contact_twin(scene) if scene.constrained else scene  # whose forces follow from where the nodes are
    q = found.nodes[: found.arrived[robot] + 1 : 2, :, :, robot]
    shown_every = 2 * PERIOD
    v = np.gradient(q, shown_every, axis=0)
    times = shown_every * np.arange(len(q))
    motion = Trajectory(times, q, v, np.array(0), np.array(len(q)), np.array(0), "rk4", None, twin)
    planned = way.way(found.path[0, :2, robot])
    lines = {"planned way": np.column_stack([planned, np.full(len(planned), 0.01)])}
    props = view.Props(posts, lines)
    view.keep_html(twin, motion, path, frame_rate=25.0, title="round obstacles", props=props)


def _outcome(row: dict[str, Any]) -> str:
    return "reached" if row["reached"] else "touched" if row["touched"] else "not reached"


@plot.styled
def figure(fields: list[Discs], maps: list[WayMap], found: Travels, blind: Travels) -> Figure:
    """Obstacles, the way that was planned from the start, and the paths of all robots, from above."""
    columns = min(4, len(fields))
    rows = -(-len(fields) // columns)
    chart = Figure(figsize=(2.4 * columns, 1.75 * rows + 0.6), layout="constrained")
    panes = chart.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for k, (axes, field, way) in enumerate(zip(panes, fields, maps)):
        for centre, radius in zip(field.centres, field.radii):
            axes.add_patch(Circle(centre, radius, color="#b9b2a3"))
        for travels, style, label in ((blind, {"color": "#c5522f", "lw": 0.7}, "blind"), (found, {"lw": 1.4}, "led")):
            path = travels.path[: travels.arrived[k] + 1, :2, k]
            axes.plot(*path.T, label=label, **style)
        axes.plot(*way.way(found.path[0, :2, k]).T, ":", color="black", lw=0.8, label="first plan")
        axes.plot(*GOAL, "o", markersize=5, markerfacecolor="none", color="black")
        axes.set(aspect="equal", xlim=(-2, 12), ylim=(-5, 5))
        axes.set_title(_outcome(told(found, field, k)), size=8)
    for axes in panes[len(fields) :]:
        axes.set_visible(False)
    chart.legend(*panes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    chart.supxlabel("x (m)", size=9)
    chart.supylabel("y (m)", size=9)
    return chart


if __name__ == "__main__":
    run(main, Settings)

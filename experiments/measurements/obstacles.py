"""Robots that are led round obstacles by a choice of gaits, to goals 10 m away; each in a field of its own.

A field is drawn by its seed, and counts where the straight way is blocked and another is free. The robots are not the
model: they have springs for struts and ground, and their friction is off by up to 25 %. Beside it: the same controller
that does not know of the obstacles. Touching is judged by all struts and cables, once in a control period.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.patches import Circle
from measurements.driven import bounded, drops
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table
from tqdm import tqdm

from jaxgrity import Cylinder, Differences, Scene, Trajectory, contact_twin, load_gait, load_scene
from jaxgrity.control import (
    CAUTIOUS,
    REACHED,
    Discs,
    GaitChoices,
    Journey,
    PhaseLocked,
    Sampling,
    WayMap,
    gait_choices,
    gap,
    lead_to,
    room,
    side_by_side,
    way_map,
)
from jaxgrity.report import view

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
MARGIN = 0.05
"""m, that robots keep from obstacles beyond the reach of these plans"""
UNKNOWN = 0.25
"""share of the friction, within which it is drawn"""
GAITS = ("lasting", "brisk", "left", "right")


KINDS = ("reached", "arrived", "touched")
"""What becomes of a robot."""


@measurement(
    page="control.md",
    quick={"fields": 2, "samples": 4, "patience": 1.5, "twin": False},
    drawn=("rows",),
)
def obstacles(
    out: Path, fields: int = 20, samples: int = 24, patience: float = 60.0, twin: bool = True, seed: int = 1
) -> Record:
    """How many robots got round their obstacles, and how; a replay of one of them in the folder.

    Args:
        fields: of obstacles, each with a robot
        samples: ways to go on that are tried for each robot, each by three robots of the model
        patience: s
        twin: whether the robots are the contact twin, and not the model itself
        seed: of fields, starts, friction and samples; the controller was made on those of 0
    """
    scene, drawn = load_scene("exact"), drawn_fields(fields, seed)
    maps = [way_map(field, GOAL, ARENA, reach=REACH + NEAR) for field in drawn]
    sampling = CAUTIOUS._replace(samples=samples, patience=patience, margin=MARGIN, seed=seed)
    robot, choices = contact_twin(scene) if twin else scene, gaits_of(scene)
    found = led(scene, robot, choices, maps, sampling)
    nothing = Discs(np.zeros((0, 2)), np.zeros(0))
    blind = led(scene, robot, choices, [way_map(nothing, GOAL, ARENA)] * fields, sampling)
    rows = [
        {"centres": field.centres, "radii": field.radii, "plan": way.way(found.path[0, :2, k])}
        | {"planned": told(found, field, k), "blind": told(blind, field, k)}
        for k, (field, way) in enumerate(zip(drawn, maps))
    ]
    arrived = [row["planned"] for row in rows if row["planned"]["reached"]]
    going = np.arange(len(found.gaits))[:, None] * round(sampling.interval / PERIOD) < found.arrived
    names = np.array(choices.names)
    shown = int(np.argmax([row["planned"]["reached"] for row in rows]))
    keep_replay(scene, drawn[shown], maps[shown], found, shown, out / "replay.html")
    return {
        "patience": patience,
        "interval": sampling.interval,
        "horizon": sampling.horizon,
        "gaits": {name: float(np.mean(names[found.gaits[going]] == name)) for name in dict.fromkeys(names)},
        "spread": float(np.nanmedian(found.spread[going])),
        "surprise": float(np.nanmedian(found.surprise[going])),
        "seconds_a_choice": sampling.interval / found.real_time,
        "fields": fields,
        **{way: {kind: sum(row[way][kind] for row in rows) for kind in KINDS} for way in ("planned", "blind")},
        "seconds": float(np.median([row["seconds"] for row in arrived])) if arrived else None,
        "gap": min((row["gap"] for row in arrived), default=None),
        "length": float(np.median([row["length"] for row in arrived])) if arrived else None,
        "rows": rows,
    }


@obstacles.table
def words(record: Record) -> str:
    """How many robots got round their obstacles, and what their ways were like."""
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in record["gaits"].items())
    count = record["fields"]
    own = record["planned"]
    rows = [
        ["goal reached, nothing touched", f"{own['reached']} of {count}"],
        ["touched something", f"{own['touched']}"],
        [f"did not arrive in {record['patience']:g} s", f"{count - own['arrived']}"],
    ]
    head = ["robots led round obstacles", "measured"]
    if record["seconds"] is None:
        return table(head, rows)
    apart, off = (f"{100 * record[name]:.0f} cm" for name in ("spread", "surprise"))
    more = [
        ["time and length of the way, median", f"{record['seconds']:.0f} s, {record['length']:.0f} m"],
        ["smallest distance from an obstacle, of robots that arrived", f"{100 * record['gap']:.0f} cm"],
        ["gaits on the way", shares],
        [f"spread of the model robots after {record['horizon']:g} s of the chosen sample, median", apart],
        [f"error of the predicted place after {record['interval']:g} s, median", off],
        [f"time of a choice for all {count} robots", f"{record['seconds_a_choice']:.1f} s"],
    ]
    return table(head, rows + more)


def drawn_fields(count: int, seed: int) -> list[Discs]:
    """Fields whose straight way is blocked, and that have another."""
    draw, found = np.random.default_rng(seed), []
    straight = np.linspace(0, 1, 101)[:, None] * GOAL
    while len(found) < count:
        centres = draw.uniform([1.5, -ACROSS], [GOAL[0] - 1.5, ACROSS], (DISCS, 2))
        field = Discs(centres, draw.uniform(*RADII, DISCS))
        ends = room(field, np.stack([np.zeros(2), GOAL]))
        if room(field, straight).min() > 0.5 * REACH or ends.min() < REACH + SPARE + 0.2:
            continue
        if np.isfinite(way_map(field, GOAL, ARENA, reach=REACH + SPARE).to_go(np.zeros((1, 2)))).all():
            found.append(field)
    return found


def gaits_of(scene: Scene) -> GaitChoices:
    """The library's gaits, of which the gains of feedback are known for the first alone."""
    locked = {name: PhaseLocked(load_gait(name)) for name in GAITS}
    locked = {name: each if name == "lasting" else replace(each, gains=0 * each.gains) for name, each in locked.items()}
    return gait_choices(scene.structure, locked)


def led(scene: Scene, robot: Scene, choices: GaitChoices, maps: list[WayMap], sampling: Sampling) -> Journey:
    """All robots, from drops anyhow about the origin, by a model of the scene."""
    count, seed = len(maps), sampling.seed
    friction = 1 + np.random.default_rng(seed + 1).uniform(-UNKNOWN, UNKNOWN, count)
    q, v = drops(scene, count, seed)
    above = scene.ground.height(q[..., 0], q[..., 1]).max(1)[:, None, None] * np.array([0, 0, 1])
    with tqdm(total=round(sampling.patience / sampling.interval), unit="choice") as bar:
        return lead_to(
            side_by_side(bounded(robot), count, Differences(friction=friction)),
            bounded(scene),
            choices,
            maps,
            start=(np.moveaxis(q + above, 0, -1), np.moveaxis(v, 0, -1)),
            sampling=sampling,
            on_choice=lambda _: bar.update(),
        )


def told(found: Journey, field: Discs, robot: int) -> Record:
    """Of one robot, judged by the field that is there; its path ten times a second."""
    end = int(found.arrived[robot])
    here = np.linalg.norm(found.path[end, :2, robot] - GOAL) < REACHED
    nodes = found.nodes[: end + 1, :, :, robot]
    least = float(gap(field, load_scene("exact"), nodes).min())
    path = found.path[: end + 1 : 10, :2, robot]
    return {
        "arrived": bool(here),
        "touched": least < 0,
        "reached": bool(here and least >= 0),
        "seconds": PERIOD * end,
        "gap": least,
        "length": float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()),
        "path": path,
    }


def keep_replay(scene: Scene, field: Discs, way: WayMap, found: Journey, robot: int, path: Path) -> None:
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


@obstacles.figure()
def figure(record: Record, chart: Figure) -> None:
    """Obstacles, the way that was planned from the start, and the paths of all robots, from above."""
    every = record["rows"]
    columns = min(4, len(every))
    rows = -(-len(every) // columns)
    chart.set_figheight(1.75 * rows + 0.8)
    panes = chart.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, row in zip(panes, every):
        for centre, radius in zip(row["centres"], row["radii"]):
            axes.add_patch(Circle(centre, radius, color="#b9b2a3"))
        for way, look in (("blind", {"color": "#c5522f", "lw": 0.9}), ("planned", {"color": "C0", "lw": 1.6})):
            label = {"blind": "straight to the goal, blind", "planned": "by the plan"}[way]
            axes.plot(*np.transpose(row[way]["path"]), label=label, **look)
        axes.plot(*np.transpose(row["plan"]), color="black", lw=0.8, label="first plan")
        axes.plot(*GOAL, "*", markersize=9, color="C2", label="goal")
        axes.set(aspect="equal", xlim=(-2, 12), ylim=(-5.8, 5.8))
        own = row["planned"]
        axes.set_title("reached" if own["reached"] else "touched" if own["touched"] else "not reached")
    for axes in panes[len(every) :]:
        axes.set_visible(False)
    chart.legend(*panes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    chart.supxlabel("x (m)")
    chart.supylabel("y (m)")

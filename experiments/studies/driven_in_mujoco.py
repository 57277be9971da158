"""Robots that a gait drives on the ground, here and in MuJoCo: how far apart they end, and the steps' errors.

Those with end caps also fly, and settle on the ground.
"""

import dataclasses
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from measurements.conformance_statics import DATA
from measurements.measurement import Record, measurement
from measurements.pages import columns

from jaxgrity import Gait, Scene, SolverOptions, load_scene, parse_scene, simulate, with_gait
from jaxgrity.formats import read_engine, read_mjcf
from jaxgrity.model import penalty_twin

RODS = """
[structure]
kind = "icosahedron"
mass = 3.0
pose = "face"
height = 0.02
[struts]
rigid = true
mass = 0.4
[cables]
stiffness = 600.0
damping = 8.0
prestrain = 0.3
[gravity]
[damping]
node = 0.5
[ground]
contact = "penalty"
stiffness = 1e4
dissipation = 2.0
[friction]
kind = "smooth"
mu = 0.5
slip_speed = 0.01
[gait]
members = [6, 9, 14, 21]
amplitude = 0.3
frequency = 1.0
phase = [0.0, 1.0, 2.0, 3.0]
start = 0.0
ramp = 1.0
"""
SIX = """
[structure]
kind = "superball"
pose = "face"
prestress = 200.0
[cables]
stiffness = 2000.0
damping = 40.0
[gravity]
[damping]
node = 5.0
[ground]
contact = "complementarity"
[friction]
kind = "cone"
mu = 0.6
"""
FILES = {"prism": DATA / "engine" / "prism.json", "caps": DATA / "mjcf" / "three_rods.xml"}
ROBOTS = {
    "springs": "the scene `reference`",
    "rods": "rigid rods, four cables driven",
    "prism": "three rods, `prism.json`",
    "caps": "three rods, `three_rods.xml`",
    "superball": "six rods, `superball`",
}
CAPPED = {"prism": (0, 1, 2, 3, 4, 5), "caps": (0, 1, 2, 3, 4, 5), "superball": (0, 5, 10, 15)}
"""Robots with end caps, and the cables that drive them."""
DRAG = 10.0
"""N s/m, at the nodes of the prism, which is far from its resting shape and would swing for long"""
SHORTER = 0.01
"""Largest share by which we shorten cables of the robot with six rods. Its symmetry would keep its shape in the air."""
STEPS = {"springs": 1e-4, "rods": 2e-4, "prism": 2e-4, "caps": 1e-4, "superball": 1e-4}
"""s, of both programs; their errors follow from twice these steps"""
FLIGHT, SETTLED = (0.5, 1e-4), (15.0, 5e-4)
"""s, durations of a flight and until rest, and MuJoCo's steps"""
CONTACTS = {"their own": "own, with friction", "the same": "our spring, without friction"}


@measurement(page="conformance.md", quick={"robots": ("springs",), "duration": 0.05})
def driven_in_mujoco(robots: tuple[str, ...] = tuple(ROBOTS), duration: float = 2.0) -> Iterator[Record]:
    """A row for each robot and contact of MuJoCo.

    Args:
        robots: names in `ROBOTS`
        duration: s
    """
    for robot in robots:
        for contact in CONTACTS:
            yield {"robot": robot, "contact": contact} | compared(robot, contact, duration)
        if robot in CAPPED:
            yield {"robot": robot} | in_the_air(robot) | at_rest(robot)
    return {"duration": duration}


def compared(robot: str, contact: str, duration: float) -> dict[str, float]:
    """Both errors, m, how far apart nodes end, m, how far they moved, m, and the share of time with contact."""
    from measurements.mujoco_peer import run_once, with_spring_contact

    scene = driven(robot)
    change: Callable[[Any], None] | None = None
    if contact == "the same":
        assert scene.ground is not None, "both have penalty contact"
        ground = dataclasses.replace(scene.ground, dissipation=None)
        scene = dataclasses.replace(scene, ground=ground, friction=None)
        change = with_spring_contact(float(np.max(ground.stiffness)))
    ours, theirs, file = [], [], theirs_of(robot)
    for dt in (2 * STEPS[robot], STEPS[robot]):
        options = SolverOptions(dt=dt)
        ours.append(np.asarray(simulate(scene, duration, options=options, frame_rate=1 / duration).positions[-1]))
        theirs.append(run_once(scene, duration, dt, change, file)[0])
    return {
        "ours": float(np.abs(ours[0] - ours[1]).max()),
        "theirs": float(np.abs(theirs[0] - theirs[1]).max()),
        "apart": float(np.abs(ours[1] - theirs[1]).max()),
        "centres_apart": float(np.abs((ours[1] - theirs[1]).mean(0)).max()),
        "moved": float(np.abs(ours[1] - np.asarray(scene.structure.nodes)).max()),
    }


def in_the_air(robot: str) -> dict[str, float]:
    """How far apart nodes are after a flight, m, and how far they moved beside their middle, m."""
    from measurements.mujoco_peer import run_once, without_contact

    duration, dt = FLIGHT
    scene = dataclasses.replace(capped(robot), ground=None, friction=None)
    options = SolverOptions(method="rk4", dt=dt)
    ours = np.asarray(simulate(scene, duration, options=options, frame_rate=1 / duration).positions[-1])
    theirs, _ = run_once(scene, duration, dt, without_contact, theirs_of(robot))
    moved = ours - np.asarray(scene.structure.nodes)
    return {"flight": float(np.abs(ours - theirs).max()), "changed": float(np.abs(moved - moved.mean(0)).max())}


def at_rest(robot: str) -> dict[str, float]:
    """Mean heights of the nodes at rest, m, here and in MuJoCo, and how deep in the ground its deepest ball is, m.

    There is no friction: with it, where a robot comes to rest depends on how it got there.
    """
    from measurements.mujoco_peer import run_once, without_friction

    duration, dt = SETTLED
    scene = dataclasses.replace(capped(robot), friction=None)
    ours = np.asarray(simulate(scene, duration, frame_rate=1 / duration).positions[-1])
    theirs, depth = run_once(scene, duration, dt, without_friction, theirs_of(robot))
    return {"height": float(ours[:, 2].mean()), "their_height": float(theirs[:, 2].mean()), "depth": depth}


def capped(robot: str) -> Scene:
    """A robot with end caps on exact contact, without a gait."""
    if robot == "caps":
        return read_mjcf(FILES[robot]).scene
    if robot == "prism":
        scene = read_engine(FILES[robot]).scene
        return dataclasses.replace(scene, node_damping=np.full(len(scene.structure.nodes), DRAG))
    scene = parse_scene(SIX)
    cables = scene.structure.cables
    rest = cables.rest_length * (1 - SHORTER * np.random.default_rng(0).random(len(cables.edges)))
    structure = dataclasses.replace(scene.structure, cables=dataclasses.replace(cables, rest_length=rest))
    return dataclasses.replace(scene, structure=structure)


def theirs_of(robot: str) -> Path | None:
    """The model that MuJoCo takes as it is; None for robots that we write."""
    return FILES[robot] if robot == "caps" else None


def driven(robot: str) -> Scene:
    """A robot on penalty ground, or just above it, whose gait begins at once."""
    if robot == "rods":
        return parse_scene(RODS)
    if robot == "springs":
        scene = load_scene("reference")
        return with_gait(scene, dataclasses.replace(scene.gait, start=0.0))
    members = CAPPED[robot]
    each = np.ones(len(members))
    gait = Gait(members, np.arange(len(members)) * 1.0, amplitude=0.15 * each, frequency=each, start=0.0, ramp=1.0)
    return with_gait(penalty_twin(capped(robot)), gait)


@driven_in_mujoco.table
def words(record: Record) -> str:
    """How far apart both programs end, beside their errors."""
    length = lambda name: lambda row: f"{float(f'{1e3 * row[name]:.2g}'):g}"  # noqa: E731
    cells = {
        "robot": lambda row: ROBOTS[row["robot"]],
        "contact in MuJoCo": lambda row: CONTACTS[row["contact"]],
        "our error, mm": length("ours"),
        "MuJoCo's error, mm": length("theirs"),
        "difference, mm": length("apart"),
        "largest motion of a node, mm": length("moved"),
    }
    return columns([row for row in record["rows"] if "contact" in row], cells)


@partial(driven_in_mujoco.table, part="caps")
def words_of_caps(record: Record) -> str:
    """Differences in the air and at rest of robots with end caps."""
    cells = {
        "robot with end caps": lambda row: ROBOTS[row["robot"]],
        "in the air: change of shape, mm": lambda row: f"{1e3 * row['changed']:.1f}",
        "difference, m": lambda row: f"{row['flight']:.0e}",
        "at rest: our mean height, mm": lambda row: f"{1e3 * row['height']:.2f}",
        "MuJoCo's, mm": lambda row: f"{1e3 * row['their_height']:.2f}",
        "MuJoCo's penetration, mm": lambda row: f"{1e3 * row['depth']:.2f}",
    }
    return columns([row for row in record["rows"] if "flight" in row], cells)

"""Robots that a gait drives on the ground, here and in MuJoCo: how far apart they end, and the steps' errors."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from measurements.measurement import Record, measurement
from measurements.pages import columns

from jaxgrity import Scene, SolverOptions, load_scene, parse_scene, simulate, with_gait

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
ROBOTS = {"springs": "the scene `reference`", "rods": "rigid rods, four cables driven"}
STEPS = {"springs": 1e-4, "rods": 2e-4}
"""s, of both programs; their errors follow from twice these steps"""
CONTACTS = {"their own": "own, with friction", "the same": "our spring, without friction"}


@measurement(page="conformance.md", quick={"robots": ("springs",), "duration": 0.05})
def driven_in_mujoco(robots: tuple[str, ...] = tuple(ROBOTS), duration: float = 2.0) -> Iterator[Record]:
    """A row for each robot and contact of MuJoCo.

    Args:
        robots: "springs" and "rods"
        duration: s
    """
    for robot in robots:
        for contact in CONTACTS:
            yield {"robot": robot, "contact": contact} | compared(robot, contact, duration)
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
    ours, theirs = [], []
    for dt in (2 * STEPS[robot], STEPS[robot]):
        options = SolverOptions(dt=dt)
        ours.append(np.asarray(simulate(scene, duration, options=options, frame_rate=1 / duration).positions[-1]))
        theirs.append(run_once(scene, duration, dt, change)[0])
    return {
        "ours": float(np.abs(ours[0] - ours[1]).max()),
        "theirs": float(np.abs(theirs[0] - theirs[1]).max()),
        "apart": float(np.abs(ours[1] - theirs[1]).max()),
        "centres_apart": float(np.abs((ours[1] - theirs[1]).mean(0)).max()),
        "moved": float(np.abs(ours[1] - np.asarray(scene.structure.nodes)).max()),
    }


def driven(robot: str) -> Scene:
    """A robot just above the ground, whose gait begins at once."""
    if robot == "rods":
        return parse_scene(RODS)
    scene = load_scene("reference")
    return with_gait(scene, dataclasses.replace(scene.gait, start=0.0))


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
    return columns(record["rows"], cells)

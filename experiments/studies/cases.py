"""Scenes on which simulators break, each as the penalty model and, where that makes sense, with exact constraints."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import numpy as np
from studies.random_structures import random_scene

from jaxgrity import (
    ConeFriction,
    ExactGround,
    Members,
    PenaltyGround,
    Scene,
    SmoothFriction,
    Structure,
    load_scene,
    with_gait,
)
from jaxgrity.model import penalty_twin

G = 9.81


class Case(NamedTuple):
    """One hard case."""

    scene: Scene
    """penalty contact, spring struts"""
    exact: Scene | None
    """exact contact, rigid struts; None: complementarity stepping gets `scene`"""
    duration: float
    """s"""
    velocities: np.ndarray | None = None
    """(nodes, 3), m/s, at the start"""
    short: float | None = None
    """s, for implicit methods, whose steps cost much more"""


def robots() -> tuple[Scene, Scene]:
    """The robot of the scenes "reference" and "exact", both without its gait."""
    scenes = [load_scene(name) for name in ("reference", "exact")]
    return with_gait(scenes[0], None), with_gait(scenes[1], None)


def both(change, duration: float, with_gaits: bool = False, **rest) -> Case:
    """A case that changes both robots alike."""
    scenes = [load_scene(name) for name in ("reference", "exact")] if with_gaits else list(robots())
    return Case(change(scenes[0]), change(scenes[1]), duration, **rest)


def moved(scene: Scene, nodes: np.ndarray) -> Scene:
    """The structure with its nodes elsewhere."""
    return eqx.tree_at(lambda s: s.structure.nodes, scene, nodes)


def raised(height: float):
    """The robot with its lowest node this high."""

    def change(scene: Scene) -> Scene:
        nodes = scene.structure.nodes
        return moved(scene, nodes + np.array([0.0, 0.0, height - nodes[:, 2].min()]))

    return change


def flattened(axis: int):
    """All nodes in one plane, undeformed there: struts at rest, cables prestressed by 30 %."""

    def change(scene: Scene) -> Scene:
        nodes = scene.structure.nodes.copy()
        nodes[:, axis] = 0.0
        if axis != 2:
            nodes[:, 2] += 0.02 - nodes[:, 2].min()
        parts = []
        for members, share in ((scene.structure.struts, 1.0), (scene.structure.cables, 0.7)):
            lengths = np.linalg.norm(np.subtract(*(nodes[list(ends)] for ends in zip(*members.edges))), axis=1)
            parts.append(Members(members.edges, members.stiffness, share * np.maximum(lengths, 1e-3), members.damping))
        return eqx.tree_at(lambda s: s.structure, scene, Structure(nodes, scene.structure.node_mass, *parts))

    return change


def slack(scene: Scene) -> Scene:
    """Cables a fifth longer than the gaps that they span."""
    return eqx.tree_at(lambda s: s.structure.cables.rest_length, scene, scene.structure.cables.rest_length / 0.7 * 1.2)


def gait(**changes):
    """The gait with other numbers."""

    def change(scene: Scene) -> Scene:
        count = len(scene.gait.members)
        for name, value in changes.items():
            value = np.asarray(value, float) if name in ("start", "ramp") else np.full(count, value)
            scene = eqx.tree_at(lambda s, name=name: getattr(s.gait, name), scene, value)
        return scene

    return change


def incline(share: float) -> Case:
    """A block on a slope of `share` times the friction angle."""
    angle = float(np.arctan(0.5)) * share
    block = Structure(np.zeros((1, 3)), np.array([2.0]))
    depth = 2.0 * G * np.cos(angle) / 1e4
    normal = np.array([np.sin(angle), 0.0, np.cos(angle)])
    lowered = Structure(-depth * normal[None], np.array([2.0]))
    soft = Scene(lowered, gravity=G, ground=PenaltyGround(1e4, 2.0, angle), friction=SmoothFriction(0.5, 0.01))
    hard = Scene(block, gravity=G, ground=ExactGround(angle), friction=ConeFriction(0.5))
    return Case(soft, hard, 2.0)


def stiff_struts() -> Case:
    """Struts a million times as stiff as the cables."""
    robot, exact = robots()
    return Case(eqx.tree_at(lambda s: s.structure.struts.stiffness, robot, np.full(6, 600e6)), exact, 0.1)


def unequal_masses() -> Case:
    """One node ten thousand times as light as the others."""

    def change(scene: Scene) -> Scene:
        mass = scene.structure.node_mass.copy()
        mass[0] *= 1e-4
        return eqx.tree_at(lambda s: s.structure.node_mass, scene, mass)

    return both(change, 0.05)


def spinning() -> Case:
    """In free flight, about a tilted axis through the centre."""
    robot, exact = robots()
    free = Scene(robot.structure), Scene(exact.structure)
    nodes = robot.structure.nodes - robot.structure.nodes.mean(0)
    axis = 50.0 * np.array([0.6, 0.0, 0.8])
    return Case(*free, 0.5, velocities=np.cross(axis, nodes))


def oscillator() -> Case:
    """Two nodes on an undamped strut, for a million steps of the Verlet method."""
    strut = Members(((0, 1),), np.array([100.0]), np.array([0.9]))
    scene = Scene(Structure(np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.ones(2), strut))
    return Case(scene, None, 5000.0, short=50.0)


def ground_stiffness(stiffness: float) -> Case:
    """The robot dropped on penalty ground from where it stands."""
    return Case(eqx.tree_at(lambda s: s.ground.stiffness, robots()[0], np.asarray(stiffness)), None, 0.3)


def chattering() -> Case:
    """At rest for a minute, on ground that dissipates nothing."""
    robot, exact = robots()
    springy = eqx.tree_at(lambda s: s.ground, robot, PenaltyGround(1e4))
    return Case(springy, exact, 60.0)


def random_structure(seed: int) -> Case:
    """One of the structures of random_structures.py, dropped and actuated: loops, shared nodes, supports and all."""
    exact = random_scene(seed)
    return Case(penalty_twin(exact), exact, 0.5, short=0.05)


RANDOM = (11, 14, 21, 23, 24, 27, 30, 34, 35, 36)
"""seeds of random structures: the first ten with at most 12 struts"""

CASES: dict[str, Callable[[], Case]] = {
    "stiffness ratio 1e6": stiff_struts,
    "mass ratio 1e4": unequal_masses,
    "drop from 10 m": lambda: both(raised(10.0), 1.8),
    "incline 0.1 % below": lambda: incline(0.999),
    "incline 0.1 % above": lambda: incline(1.001),
    "all cables slack": lambda: both(slack, 0.6),
    "collapsed flat, upright": lambda: both(flattened(1), 0.3),
    "start 5 cm below ground": lambda: both(raised(-0.05), 0.5),
    "all nodes touching": lambda: both(flattened(2), 0.5),
    "20 Hz actuation": lambda: both(gait(frequency=20.0, start=0.0, ramp=0.2), 0.5, with_gaits=True),
    "strut halved in 10 ms": lambda: both(
        gait(amplitude=0.5, frequency=0.01, phase=np.pi / 2, start=0.1, ramp=0.01), 0.4, with_gaits=True
    ),
    "spinning at 50 rad/s": spinning,
    "1e6 Verlet steps": oscillator,
    "chattering at rest, 60 s": chattering,
    "k_n = 1e3": partial(ground_stiffness, 1e3),
    "k_n = 1e5": partial(ground_stiffness, 1e5),
    "k_n = 1e8": partial(ground_stiffness, 1e8),
    **{f"random structure {seed}": partial(random_structure, seed) for seed in RANDOM},
}
"""each is made when it is asked for: making one computes, which comes after JAX has been told how"""

"""The scenes on which methods are compared: free flight, a drop, and two rolls."""

from typing import NamedTuple

import equinox as eqx
import numpy as np

from jaxgrity import Gait, Scene, gaits_of, load_scene, random_phases


class Task(NamedTuple):
    """One scene, as both models see it."""

    name: str
    penalty: Scene
    exact: Scene
    gaits: Gait
    duration: float
    undamped: bool = False
    nodes: bool = False
    """the error is that of all nodes: in the air a centre of mass falls as it must, however wrong the robot's shape"""


def tasks(count: int, seed: int) -> list[Task]:
    """The four scenes, with so many random gaits."""
    reference, exact = (load_scene(name) for name in ("reference", "exact"))
    phases = random_phases(count, len(reference.gait.members), seed)

    def gaits(frequency: float, amplitude: float) -> Gait:
        ones = np.ones_like(phases)
        return gaits_of(reference.gait, phases, amplitude * ones, frequency * ones)

    flying = [undamped(scene) for scene in (reference, exact)]
    all_tasks = [
        Task("free flight", *flying, gaits(0.5, 0.1), 2.0, undamped=True, nodes=True),
        Task("drop and settle", reference, exact, gaits(0.5, 0.0), 2.0),
        Task("0.5 Hz roll", reference, exact, gaits(0.5, 0.3), 4.0),
        Task("1 Hz roll", reference, exact, gaits(1.0, 0.3), 4.0),
    ]
    return all_tasks


def undamped(scene: Scene) -> Scene:
    """The robot in the air, with nothing that dissipates, its gait from the start."""
    struts, cables = scene.structure.struts, scene.structure.cables
    members = [eqx.tree_at(lambda m: m.damping, m, None, is_leaf=lambda x: x is None) for m in (struts, cables)]
    structure = eqx.tree_at(lambda s: (s.struts, s.cables), scene.structure, tuple(members))
    gait = eqx.tree_at(lambda g: g.start, scene.gait, np.asarray(0.0))
    return Scene(structure, gravity=scene.gravity, gait=gait)

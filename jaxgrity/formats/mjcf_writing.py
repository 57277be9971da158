"""Scenes as MuJoCo models (MJCF), and the controls by which a gait moves one."""

from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from jaxgrity.core.typed import typed
from jaxgrity.core.types import PerMember
from jaxgrity.formats.foreign import add_element, refuse_bodies
from jaxgrity.formats.mjcf_plan import THICKNESS, Plan, amplitudes, inertia_of, plan_of, safe_step
from jaxgrity.io.files import write_whole
from jaxgrity.model.clusters import cables_of, nodes_along
from jaxgrity.model.scene import Scene

STRONGEST = 1e9
"""Limit of a cable's force in an MJCF file, N: no cable of a robot reaches it."""


class MuJoCoModel(NamedTuple):
    """A scene as MuJoCo has it."""

    xml: str
    """MJCF: the text of the file"""
    notes: tuple[str, ...]
    """sentences: what is modelled otherwise there, or not at all"""
    actuated: tuple[int, ...]
    """members in the order of the model's first actuators: struts from 0, then cables; of a cluster the first one"""


@typed
def save_mjcf(scene: Scene, path: str | Path, timestep: float | None = None, integrator: str = "RK4") -> MuJoCoModel:
    """Write a scene as a MuJoCo model.

    Struts that are rigid, or have mass, are free bodies with their thin rods' moments of inertia; other nodes are point
    masses on three slides. Cables, and struts that are springs, are spatial tendons between sites: a cable's spring
    range is [0, L0], so that it only pulls. A cluster is one tendon over several sites. Members that the gait moves
    have actuators on their tendons in place of springs. Their force is K (L0 + u - l) - c l', and cables only pull.
    The control u is the change of rest length, m (`mjcf_controls`). Contact is MuJoCo's own, between nodes and the
    plane.

    Args:
        scene: the scene to write.
        path: the file (.xml), which appears whole or not at all.
        timestep: s; by default one that suits the stiffest spring.
        integrator: Euler, RK4, implicit or implicitfast.

    Returns:
        The model, with what MuJoCo has otherwise or not at all.

    Raises:
        InputError: a rigid strut has to become a spring, and no gravity says how stiff one may be; or the scene has
            motors.

    Example:
        >>> model = jaxgrity.formats.save_mjcf(jaxgrity.load_scene("reference"), "my_robot.xml")
        >>> model.actuated  # the gait moves the six struts
        (0, 1, 2, 3, 4, 5)
    """
    model = mujoco_model(scene, timestep, integrator)
    write_whole(path, lambda file: file.write(model.xml.encode()))
    return model


@typed
def mujoco_model(scene: Scene, timestep: float | None = None, integrator: str = "RK4") -> MuJoCoModel:
    """What `save_mjcf` writes. Raises as it does."""
    refuse_bodies(scene.structure, "MuJoCo models that are written")
    plan, notes = plan_of(scene)
    root = ElementTree.Element("mujoco", model="jaxgrity")
    g = 0.0 if scene.gravity is None else float(scene.gravity)
    step = safe_step(plan) if timestep is None else timestep
    up = np.array([0.0, 0.0, 1.0]) if scene.up is None else np.asarray(scene.up, float)
    add_element(root, "option", timestep=step, integrator=integrator, gravity=(-g * up + 0.0).tolist(), cone="elliptic")
    world = add_element(root, "worldbody")
    notes += _ground(world, scene, plan.radius)
    drag = np.zeros(len(plan.node_mass)) if scene.node_damping is None else np.asarray(scene.node_damping, float)
    in_bodies = {int(node) for nodes in plan.bodies for node in nodes}
    for number, nodes in enumerate(plan.bodies):
        _body(world, plan, nodes, number)
    for node in range(len(drag)):
        if node not in in_bodies:
            _point(world, plan, node, drag[node])
    notes += _members(root, scene, plan)
    _drag_on_bodies(root, {node: drag[node] for node in sorted(in_bodies) if drag[node]})
    ElementTree.indent(root)
    notes += ["laws that have no counterpart in MuJoCo are left out"] if scene.terms else []
    notes += ["load cases are left out"] if scene.loads else []
    notes += ["supports do not move there"] if scene.shaking is not None else []
    return MuJoCoModel(ElementTree.tostring(root, encoding="unicode") + "\n", tuple(notes), plan.actuated)


def _ground(world: ElementTree.Element, scene: Scene, radius: float) -> list[str]:
    if scene.ground is None:
        return []
    if scene.ground.surface is not None:
        return ["the ground is no plane, and is left out"]
    mu = 0.0 if scene.friction is None else float(np.max(scene.friction.sliding_mu))
    n = scene.ground.normal
    at = [-radius * axis for axis in n]
    flags = {"contype": 0, "conaffinity": 1, "priority": 1, "friction": [mu, 0.0, 0.0]}
    add_element(world, "geom", name="ground", type="plane", size=[0, 0, 1], zaxis=list(n), pos=at, **flags)
    differ = scene.friction is not None and np.ptp(scene.friction.sliding_mu) > 0
    which = "the largest of the nodes' friction coefficients" if differ else "the friction coefficient of the scene"
    return [f"contact is MuJoCo's own: soft, with its default stiffness, and with {which}"]


def _body(world: ElementTree.Element, plan: Plan, nodes: np.ndarray, number: int) -> None:
    """A free body at its centre of mass."""
    struts, x = plan.structure.struts, np.asarray(plan.structure.nodes, float)
    assert struts is not None, "a body is made of struts"
    own = [k for k in sorted(plan.rigid) if struts.edges[k][0] in nodes]
    rods = [(struts.edges[k], 0.0 if struts.mass is None else float(struts.mass[k])) for k in own]
    mass, centre, inertia = inertia_of(x, {int(n): plan.node_mass[n] for n in nodes}, rods)
    body = add_element(world, "body", name=f"body{number}", pos=centre)
    add_element(body, "freejoint")
    entries = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    add_element(body, "inertial", pos=[0.0, 0.0, 0.0], mass=mass, fullinertia=entries)
    for k in own:
        ends = x[list(struts.edges[k])] - centre
        size = [THICKNESS * np.linalg.norm(ends[1] - ends[0])]
        add_element(body, "geom", type="capsule", fromto=ends.ravel(), size=size, contype=0, conaffinity=0, mass=0)
    for node in nodes:
        _node(body, plan, int(node), x[node] - centre, 0.0)


def _point(world: ElementTree.Element, plan: Plan, node: int, drag: float) -> None:
    """A point mass on slides along the axes that no support holds, or a site of the world."""
    x, free = np.asarray(plan.structure.nodes, float)[node], plan.structure.free[node]
    if not free.any():
        add_element(world, "site", name=f"n{node}", pos=x)
        return
    body = add_element(world, "body", name=f"node{node}", pos=x)
    for axis in np.flatnonzero(free):
        add_element(body, "joint", type="slide", axis=np.eye(3)[axis], damping=drag)
    _node(body, plan, node, np.zeros(3), plan.node_mass[node])


def _node(body: ElementTree.Element, plan: Plan, node: int, at: np.ndarray, mass: float) -> None:
    size, touches = plan.radius + plan.balls.get(node, 0.0), int(node in plan.balls)
    add_element(body, "geom", size=[size], pos=at, mass=mass, contype=touches, conaffinity=0)
    add_element(body, "site", name=f"n{node}", pos=at)


def _members(root: ElementTree.Element, scene: Scene, plan: Plan) -> list[str]:
    """Tendons with springs, and with actuators where a gait moves them."""
    tendons, actuators = add_element(root, "tendon"), add_element(root, "actuator")
    structure, damped = plan.structure, False
    size = amplitudes(scene.gait)
    for kind, members, first in (("strut", structure.struts, 0), ("cable", structure.cables, structure.first_cable)):
        for cord in () if members is None else cables_of(members.clusters, len(members.edges)):
            k = min(cord)
            if kind == "strut" and k in plan.rigid:
                continue
            assert members is not None, "it has edges"
            assert members.stiffness is not None, "springs, by the plan"
            K, L = _in_series(members.stiffness, cord), float(np.sum(members.rest_length[list(cord)]))
            c = 0.0 if members.damping is None else _in_series(members.damping, cord)
            spring: dict[str, Any] = {"stiffness": K, "damping": c, "springlength": [0.0, L] if kind == "cable" else L}
            if first + k in plan.actuated:
                spring = {}
                limits = {"forcelimited": "true", "forcerange": [-STRONGEST, 0.0]} if kind == "cable" else {}
                most = sum(size.get(first + part, 0.0) * float(members.rest_length[part]) for part in cord)
                reach = {"ctrllimited": "true", "ctrlrange": [-most, 0.0]} if most else {}
                law = {"gainprm": K, "biastype": "affine", "biasprm": [K * L, -K, -c]}
                add_element(actuators, "general", name=f"{kind}{k}", tendon=f"{kind}{k}", **law, **limits, **reach)
            damped = damped or bool(spring and kind == "cable" and c)
            tendon = add_element(tendons, "spatial", name=f"{kind}{k}", **spring)
            for node in nodes_along(tuple(members.edges[part] for part in cord)):
                add_element(tendon, "site", site=f"n{node}")
    notes = ["cables are damped there while they are slack, too"] if damped else []
    moved = (
        f"{len(plan.actuated)} actuators change rest lengths by their controls (m); the gait itself is no part of it"
    )
    return [*notes, *([moved] if plan.actuated else [])]


def _in_series(values: PerMember, cord: tuple[int, ...]) -> float:
    """Of springs or dampers one after the other: 0 where one of them is."""
    own = np.asarray(values, float)[list(cord)]
    if len(own) == 1 or not np.all(own):
        return float(np.min(own))
    return float(1 / np.sum(1 / own))


def _drag_on_bodies(root: ElementTree.Element, drag: dict[int, float]) -> None:
    """Damping of nodes that are parts of bodies: forces against the velocities of their sites, along three axes."""
    actuators = root.find("actuator")
    assert actuators is not None, "it is there"
    for node, c in drag.items():
        for axis in range(3):
            gear = [*np.eye(3)[axis], 0.0, 0.0, 0.0]
            bias = {"biastype": "affine", "biasprm": [0.0, 0.0, -c], "gainprm": 0.0}
            add_element(actuators, "general", name=f"drag{node}{'xyz'[axis]}", site=f"n{node}", gear=gear, **bias)

"""Scenes as MuJoCo models (MJCF), and the controls by which a gait moves one."""

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.formats.foreign import add_element, has_strength
from jaxgrity.formats.links import THICKNESS, WORLD, Link, LinkJoint, axis_of, joints_between, links_of, safe_step
from jaxgrity.formats.mjcf_ground import add_ground, largest_friction
from jaxgrity.formats.mjcf_hinges import WINDING, joint_attributes
from jaxgrity.formats.mjcf_losses import CONTACT_TIME
from jaxgrity.formats.mjcf_members import add_members, written_limit
from jaxgrity.formats.mjcf_plan import Plan, geom_friction, plan_of
from jaxgrity.formats.mjcf_rods import WrittenRods, add_pairs, add_rod, written_rods
from jaxgrity.io.files import write_whole
from jaxgrity.model.balls import turning_bodies
from jaxgrity.model.force_laws import CableDampers, DeadBand
from jaxgrity.model.hinges import HingeDampers, HingeSprings
from jaxgrity.model.pulls import CommandedPull
from jaxgrity.model.rod_contact import ALONG_STRUTS
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.stiffening import PolynomialStiffness
from jaxgrity.model.strut_contact import BETWEEN_STRUTS

ADDED_INERTIA = 1e-13
"""Share of a body's inertia that is added: MuJoCo refuses flat bodies of which rounding leaves less than flat."""
THINNEST = 1e-13
"""Radius, m, of the thinnest bars that are drawn: MuJoCo refuses a radius of zero."""
WRITTEN = (DeadBand, CableDampers, CommandedPull, PolynomialStiffness, HingeSprings, HingeDampers)
"""Laws beyond the usual ones that MuJoCo models hold."""
LARGEST_STEP = 2e-3
"""Largest time step, s for a body of one metre."""
CLOSED = [0.9999, 0.9999, 1e-3, 0.5, 2.0]
"""`solimp` of what closes loops of joints, nearly rigid. Its time constant is two steps, the shortest in MuJoCo."""


NEEDS_VERSION_4 = "it needs MuJoCo 4 or newer, since the stiffness of some tendons grows with their stretch"
"""Note on files that older versions of MuJoCo refuse."""


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

    Rigid bodies keep their mass, centre and inertia. Struts that are rigid or have mass are bodies with the inertia of
    thin rods. One node of two bodies is a ball joint, and two nodes are a hinge. A support of a body is a joint on the
    world. Springs and dampers of hinges are those of the joints. A loop of joints is closed by `connect`. Other nodes
    are point masses on three slides. Cables and springs are spatial tendons between sites. A cable's spring range is
    [0, L0], so that it only pulls. A cluster is one tendon over several sites. Members that the gait moves have
    actuators on their tendons in place of springs. Their force is K (L0 + u - l) - c l', and cables only pull. The
    control u is the change of rest length, m (`mjcf_controls`). A commanded pull is one that pulls with P - s u.
    Contact is MuJoCo's own, between the plane and nodes, or rods that touch along their length, and between such rods.

    Args:
        scene: the scene to write.
        path: the file (.xml), which appears whole or not at all.
        timestep: s; by default one that suits the stiffest spring.
        integrator: Euler, RK4, implicit or implicitfast.

    Returns:
        The model, with what MuJoCo has otherwise or not at all.

    Raises:
        InputError: a rigid strut has to become a spring, and no gravity says how stiff one may be; the scene has
            motors; or a support holds a node of a rigid body along some axes only.

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
    plan, notes = plan_of(scene)
    links = links_of(plan, scene.structure.bodies)
    root = ElementTree.Element("mujoco", model="jaxgrity")
    g = 0.0 if scene.gravity is None else float(scene.gravity)
    scale = float(time_scale(scene)) if g else 1.0
    step = safe_step(plan, links, LARGEST_STEP * scale) if timestep is None else timestep
    up = np.array([0.0, 0.0, 1.0]) if scene.up is None else np.asarray(scene.up, float)
    add_element(root, "option", timestep=step, integrator=integrator, gravity=(-g * up + 0.0).tolist(), cone="elliptic")
    world = add_element(root, "worldbody")
    notes += add_ground(world, scene, plan, CONTACT_TIME * scale)
    drag = np.zeros(len(plan.node_mass)) if scene.node_damping is None else np.asarray(scene.node_damping, float)
    in_bodies = {node for link in links for node in link.nodes}
    capsules = written_rods(scene, plan, links)
    notes += _bodies(root, world, plan, links, step, scene, capsules)
    add_pairs(root, plan, capsules, largest_friction(scene), [CONTACT_TIME * scale, 1.0])
    notes += [f"{capsules.left} rods that touch are springs there, and touch at their ends"] if capsules.left else []
    if any(len({plan.friction.get(node) for node in rod.ends}) > 1 for rod in capsules.each):
        which = "the larger coefficient of their two ends, and each other with the mean of their ends"
        notes += [f"friction: rods touch the ground with {which} there"]
    for node in range(len(drag)):
        if node not in in_bodies:
            _point(world, plan, node, drag[node])
    notes += add_members(root, scene, plan)
    notes += _version_needed(root)
    _drag_on_bodies(root, {node: drag[node] for node in sorted(in_bodies) if drag[node]})
    ElementTree.indent(root)
    limit = written_limit(scene)
    touching = ALONG_STRUTS + BETWEEN_STRUTS
    others = [term for term in scene.terms if not isinstance(term, WRITTEN + touching) and term is not limit]
    names = ", ".join(term.name for term in others)
    notes += [f"laws that have no counterpart in MuJoCo are left out: {names}"] if others else []
    notes += ["load cases are left out"] if scene.loads else []
    notes += ["strength of members is left out"] if has_strength(scene.structure) else []
    notes += ["supports do not move there"] if scene.shaking is not None else []
    return MuJoCoModel(ElementTree.tostring(root, encoding="unicode") + "\n", tuple(notes), plan.actuated)


def _held(scene: Scene, links: list[Link]) -> set[int]:
    """The nodes that supports hold. Raises `InputError` where one holds a node of a link along some axes only."""
    free = scene.structure.free
    for link in links:
        for node in link.nodes:
            if free[node].any() and not free[node].all():
                axes = dict(scene.structure.fixed)[node]
                raise InputError(
                    f"node {node} belongs to a rigid body, and a support holds it along {axes} alone; expected a "
                    "support in all directions, which becomes a joint of the MuJoCo model"
                )
    return set(np.flatnonzero(~free.any(1)).tolist())


def _bodies(
    root: ElementTree.Element,
    world: ElementTree.Element,
    plan: Plan,
    links: list[Link],
    step: float,
    scene: Scene,
    capsules: WrittenRods,
) -> list[str]:
    """Bodies in bodies, with a joint at the nodes that they share; loops of joints are closed by `connect`."""
    x, parts = np.asarray(plan.structure.nodes, float), {WORLD: world}
    drawn, written = set[int](), set[tuple[int, ...]]()
    joints, loops = joints_between(links, _held(scene, links))
    turning = {node: body.points for node, body in turning_bodies(scene.structure.bodies).items()}
    for joint in joints:
        link = links[joint.link]
        origin = np.zeros(3) if joint.parent == WORLD else links[joint.parent].centre
        body = parts[joint.link] = add_element(parts[joint.parent], "body", name=link.name, pos=link.centre - origin)
        written |= _joint(body, joint, links, scene)
        inertia = link.inertia + ADDED_INERTIA * np.trace(link.inertia) * np.eye(3)
        entries = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        add_element(body, "inertial", pos=[0.0, 0.0, 0.0], mass=link.mass, fullinertia=entries)
        for start, end in link.bars:
            ends, size = np.r_[start, end] - np.r_[link.centre, link.centre], THICKNESS * np.linalg.norm(end - start)
            if size > THINNEST:
                add_element(body, "geom", type="capsule", fromto=ends, size=[size], contype=0, conaffinity=0, mass=0)
        for capsule in capsules.each:
            if capsule.link == joint.link:
                add_rod(body, plan, capsule, x - link.centre)
        for node in link.nodes:
            if node not in drawn and turning.get(node, link.nodes) == link.nodes:
                _node(body, plan, node, x[node] - link.centre, 0.0, node not in capsules.instead)
                drawn.add(node)
    closed = add_element(root, "equality") if loops else root
    stiff = {"solref": [2 * step, 1.0], "solimp": CLOSED}
    for node, one, other in loops:
        second = {} if other == WORLD else {"body2": links[other].name}
        add_element(closed, "connect", body1=links[one].name, **second, anchor=x[node] - links[one].centre, **stiff)
    notes = [f"{len(loops)} points of joints close loops, and give way there a little"] if loops else []
    hinges = {nodes for term in scene.terms if isinstance(term, HingeSprings | HingeDampers) for nodes in term.nodes}
    if left := sorted(hinges - written):
        notes.append(f"springs and dampers of nodes {left} are on no hinge there, and are left out")
    if any(isinstance(term, HingeSprings) for term in scene.terms):
        notes.append(WINDING)
    return notes


def _joint(body: ElementTree.Element, joint: LinkJoint, links: list[Link], scene: Scene) -> set[tuple[int, ...]]:
    """Writes the joint of a body, and returns the hinges whose spring or damper it has."""
    x = np.asarray(scene.structure.nodes, float)
    if not joint.nodes:
        add_element(body, "freejoint")
        return set()
    axis, at = axis_of(joint, links, x), x[joint.nodes[0]] - links[joint.link].centre
    if axis is not None:
        laws, hinges = joint_attributes(scene, joint, links, axis) if axis.any() else ({}, set())
        turns = {"type": "hinge", "axis": axis, **laws} if axis.any() else {"type": "ball"}
        add_element(body, "joint", **turns, pos=at)
        return hinges
    return set()


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


def _node(body: ElementTree.Element, plan: Plan, node: int, at: np.ndarray, mass: float, touches: bool = True) -> None:
    size = plan.larger + plan.balls[node] if node in plan.balls else plan.radius
    touches = touches and node in plan.balls
    law = geom_friction(plan, [node]) if touches else {}
    add_element(body, "geom", size=[size], pos=at, mass=mass, contype=int(touches), conaffinity=0, **law)
    add_element(body, "site", name=f"n{node}", pos=at)


def _version_needed(root: ElementTree.Element) -> list[str]:
    """Says, also in the file itself, that some stiffness has several numbers, which older versions do not read."""
    if not any(" " in tendon.get("stiffness", "") for tendon in root.iter("spatial")):
        return []
    root.insert(0, ElementTree.Comment(f" {NEEDS_VERSION_4} "))
    return [NEEDS_VERSION_4]


def _drag_on_bodies(root: ElementTree.Element, drag: dict[int, float]) -> None:
    """Damping of nodes that are parts of bodies: forces against the velocities of their sites, along three axes."""
    actuators = root.find("actuator")
    assert actuators is not None, "it is there"
    for node, c in drag.items():
        for axis in range(3):
            gear = [*np.eye(3)[axis], 0.0, 0.0, 0.0]
            bias = {"biastype": "affine", "biasprm": [0.0, 0.0, -c], "gainprm": 0.0}
            add_element(actuators, "general", name=f"drag{node}{'xyz'[axis]}", site=f"n{node}", gear=gear, **bias)

"""Scenes as URDF: rigid bodies as links. URDF has no cables and springs, so these are in a table beside it."""

import dataclasses
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.formats.foreign import add_element
from jaxgrity.formats.matlab import beside_the_structure
from jaxgrity.formats.mjcf_plan import THICKNESS, Plan, inertia_of, plan_of
from jaxgrity.formats.spreadsheets import KINDS, cell, save_rows
from jaxgrity.io.files import write_whole
from jaxgrity.model.bodies import Body, body_moments
from jaxgrity.model.scene import Scene

ENDS = tuple(f"{end}_{what}" for end in ("first", "second") for what in ("link", "x_m", "y_m", "z_m"))
SPRINGS = ("kind", *ENDS, "rest_length_m", "stiffness_N_per_m", "damping_N_s_per_m")
WORLD = "world"


class Link(NamedTuple):
    """One free body."""

    name: str
    nodes: tuple[int, ...]
    mass: float
    """kg"""
    centre: np.ndarray
    """m: centre of mass, and origin of the link's frame"""
    inertia: np.ndarray
    """kg m^2, (3, 3), about the centre"""
    bars: tuple[tuple[np.ndarray, np.ndarray], ...]
    """ends, m, of bars that show the body"""


@typed
def save_urdf(scene: Scene, path: str | Path) -> tuple[str, ...]:
    """Write the rigid bodies of a scene as URDF, and beside it cables and spring struts as a table.

    Rigid bodies, struts that are rigid or have mass, and other nodes are links, each with a `floating` joint to the
    link `world`. A link's frame has its origin at the centre of mass, and axes along x, y and z at the start. A row of
    `robot.springs.csv` is a cable or a spring strut: two links, a point in each one's frame (m), rest length L,
    stiffness K and damping c. It pulls both points together with K (l - L) + c l', a cable only while l > L.

    Returns sentences on what these files do not hold. Raises `InputError` where URDF has no joint: for nodes of two
    bodies, for supports of bodies, and for supports that leave an axis free. Motors are refused, too.
    """
    path, structure = Path(path), scene.structure
    if structure.driven:
        raise InputError(f"{path}: members {list(structure.driven)} have motors, which URDF lacks; expected a gait")
    plan, notes = plan_of(dataclasses.replace(scene, gait=None))
    x = np.asarray(structure.nodes, float)
    links = _links(plan, structure.bodies, x)
    places = {node: (WORLD, np.zeros(3)) for node in range(len(x)) if not structure.free[node].any()}
    for link in links:
        for node in link.nodes:
            if node in places or not structure.free[node].all():
                other = places[node][0] if node in places else f"a support along {dict(structure.fixed)[node]}"
                raise InputError(
                    f"{path}: node {node} belongs to {link.name} and to {other}; URDF has no joint for this: expected "
                    "links apart, and supports of single nodes in all directions"
                )
            places[node] = link.name, link.centre
    root = ElementTree.Element("robot", name=path.stem)
    add_element(root, "link", name=WORLD)
    for link in links:
        _write(root, link, plan, x)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode") + "\n"
    write_whole(path, lambda file: file.write(text.encode()))
    table = path.with_suffix(".springs.csv")
    save_rows(table, SPRINGS, _springs(plan, places, x))
    moved = scene.gait is not None and any(k in plan.rigid for k in scene.gait.members)
    return (
        f"cables and spring struts are in {table.name}: URDF has none, and your program applies their forces",
        f"nodes that touch the ground are spheres there, {plan.radius * 1e3:.3g} mm larger than here",
        *notes,
        *(["rigid struts that the gait moves keep their lengths there"] if moved else []),
        *beside_the_structure(scene),
    )


def _links(plan: Plan, bodies: tuple[Body, ...], x: np.ndarray) -> list[Link]:
    found: list[Link] = []
    for body in bodies:
        mass, centre, inertia = (np.asarray(part, float) for part in body_moments(body, x))
        if len(body.basic) == 2:
            d = x[body.basic[1]] - x[body.basic[0]]
            inertia = inertia + float(mass) / 2 * THICKNESS**2 * np.outer(d, d)
        bars = tuple((centre, x[node]) for node in body.points)
        found.append(Link(f"body{len(found)}", body.points, float(mass), centre, inertia, bars))
    struts = plan.structure.struts
    for nodes in plan.bodies:
        assert struts is not None, "such a body is made of struts"
        own = [k for k in sorted(plan.rigid) if struts.edges[k][0] in nodes]
        rods = [(struts.edges[k], 0.0 if struts.mass is None else float(struts.mass[k])) for k in own]
        moments = inertia_of(x, {int(node): plan.node_mass[node] for node in nodes}, rods)
        bars = tuple((x[i], x[j]) for (i, j), _ in rods)
        found.append(Link(f"body{len(found)}", tuple(int(node) for node in nodes), *moments, bars))
    inside = {node for link in found for node in link.nodes}
    for node in np.flatnonzero(plan.structure.free.any(1)).tolist():
        if node not in inside:
            point = float(plan.node_mass[node])
            ball = 0.4 * point * (plan.radius + plan.balls.get(node, 0.0)) ** 2 * np.eye(3)
            found.append(Link(f"node{node}", (node,), point, x[node], ball, ()))
    return found


def _write(root: ElementTree.Element, link: Link, plan: Plan, x: np.ndarray) -> None:
    part = add_element(root, "link", name=link.name)
    inertial = add_element(part, "inertial")
    add_element(inertial, "mass", value=link.mass)
    entries = {f"i{'xyz'[a]}{'xyz'[b]}": link.inertia[a, b] for a in range(3) for b in range(a, 3)}
    add_element(inertial, "inertia", **entries)
    for start, end in link.bars:
        d = end - start
        length = float(np.linalg.norm(d))
        if length:
            visual = add_element(part, "visual")
            turn = [0.0, np.arccos(np.clip(d[2] / length, -1, 1)), np.arctan2(d[1], d[0])]
            add_element(visual, "origin", xyz=(start + end) / 2 - link.centre, rpy=turn)
            add_element(add_element(visual, "geometry"), "cylinder", radius=THICKNESS * length, length=length)
    for node in sorted({*link.nodes} & {*plan.balls}):
        collision = add_element(part, "collision")
        add_element(collision, "origin", xyz=x[node] - link.centre)
        add_element(add_element(collision, "geometry"), "sphere", radius=plan.radius + plan.balls[node])
    joint = add_element(root, "joint", name=f"{link.name}_free", type="floating")
    add_element(joint, "origin", xyz=link.centre)
    add_element(joint, "parent", link=WORLD)
    add_element(joint, "child", link=link.name)


def _springs(plan: Plan, places: dict[int, tuple[str, np.ndarray]], x: np.ndarray) -> list[list[str]]:
    rows = []
    for kind, members in zip(KINDS, (plan.structure.struts, plan.structure.cables)):
        for k, edge in enumerate(members.edges if members is not None else ()):
            assert members is not None, "it has edges"
            if kind == "cable" or k not in plan.rigid:
                ends = [(places[node][0], *map(repr, (x[node] - places[node][1]).tolist())) for node in edge]
                law = (members.rest_length, members.stiffness, members.damping)
                rows.append([kind, *ends[0], *ends[1], *(cell(column, k) for column in law)])
    return rows

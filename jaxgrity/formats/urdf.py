"""Scenes as URDF: rigid bodies as links. URDF has no cables and springs, so these are in a table beside it."""

import dataclasses
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.formats.foreign import add_element
from jaxgrity.formats.links import THICKNESS, Link, links_of
from jaxgrity.formats.matlab import beside_the_structure
from jaxgrity.formats.mjcf_plan import Plan, plan_of
from jaxgrity.formats.spreadsheets import KINDS, cell, save_rows
from jaxgrity.io.files import write_whole
from jaxgrity.model.scene import Scene

ENDS = tuple(f"{end}_{what}" for end in ("first", "second") for what in ("link", "x_m", "y_m", "z_m"))
"""Columns of the places between which a spring acts: a link each, and a point in its axes."""
SPRINGS = ("kind", *ENDS, "rest_length_m", "stiffness_N_per_m", "damping_N_s_per_m")
"""Columns of the table of springs, which URDF has no words for."""
WORLD = "world"
"""Name of the link that does not move."""


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
    links = links_of(plan, structure.bodies)
    links += _points(plan, x, {node for link in links for node in link.nodes})
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
        f"nodes that touch the ground are spheres there, {plan.larger * 1e3:.3g} mm larger than here",
        *notes,
        *(["rigid struts that the gait moves keep their lengths there"] if moved else []),
        *beside_the_structure(scene),
    )


def _points(plan: Plan, x: np.ndarray, inside: set[int]) -> list[Link]:
    """The nodes that are not `inside` a body, nor held."""
    found = []
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
        add_element(add_element(collision, "geometry"), "sphere", radius=plan.larger + plan.balls[node])
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

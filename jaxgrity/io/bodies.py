"""The rigid bodies, sliding nodes, and springs and dampers of hinges of a scene file, read and written."""

from typing import Annotated

import numpy as np
from msgspec import Meta

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import NodeVectors, Supports
from jaxgrity.io.table_types import NotNegative, Number, Pair, Positive, Table
from jaxgrity.model.bodies import Bodies, Body, Joints, body_moments, rigid_body
from jaxgrity.model.hinges import OFF_AXIS, HingeDampers, HingeSprings, hinge_angles
from jaxgrity.model.joints import joined_bodies
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import Slides, slides_of

PRODUCTS = ((0, 1), (0, 2), (1, 2))
"""The rows and columns of the fourth number of an inertia and of those after it."""


class BodyTable(Table, kw_only=True):
    """A rigid body: its nodes, its mass, its centre, and its inertia about the centre, in the pose of the file's
    nodes."""

    nodes: Annotated[list[Number], Meta(min_length=2)]
    mass: Positive
    inertia: Annotated[list[float], Meta(min_length=3, max_length=6)]
    """xx, yy, zz, and where they are not 0 xy, xz, yz"""
    centre: tuple[float, float, float] | None = None
    basic: list[Number] = []
    rods: list[Pair] = []
    """lines between two of its nodes along which it may touch"""


class SlideTable(Table, kw_only=True):
    """A node that slides along the line through two others."""

    node: Number
    along: Pair


class HingeTable(Table, kw_only=True):
    """A spring, a damper, or both, on the angle between two parts."""

    nodes: tuple[Number, Number, Number, Number]
    """one of the first part, two on the axis, one of the second part"""
    stiffness: NotNegative | None = None
    rest_angle: float | None = None
    damping: NotNegative | None = None


def build_hinges(tables: list[HingeTable], nodes: np.ndarray) -> tuple[HingeSprings | HingeDampers, ...]:
    """The laws of hinges, for `nodes` as built. A spring without a rest angle has no torque there.

    Raises `InputError` for nodes that are no hinge, and a hinge without any law.
    """
    for k, table in enumerate(tables):
        if table.stiffness is None and (table.damping is None or table.rest_angle is not None):
            raise InputError(f"hinges[{k}]: expected stiffness (N m/rad), damping (N m s/rad), or both")
        if max(table.nodes) >= len(nodes):
            raise InputError(f"hinges[{k}].nodes = {list(table.nodes)}: expected nodes from 0 to {len(nodes) - 1}")
        a, p, q, b = np.asarray(nodes, float)[list(table.nodes)]
        beside = min(np.linalg.norm(np.cross(x - p, q - p)) for x in (a, b))
        if len({*table.nodes}) == len(table.nodes) and beside <= OFF_AXIS * (q - p) @ (q - p):
            raise InputError(
                f"hinges[{k}].nodes = {list(table.nodes)}: the first or the last lies on the axis through the middle "
                "two; expected both beside it"
            )
    found: list[HingeSprings | HingeDampers] = []
    if sprung := [table for table in tables if table.stiffness is not None]:
        rows = tuple(table.nodes for table in sprung)
        built = np.asarray(hinge_angles(np.asarray(nodes, float), rows))
        rest = [angle if table.rest_angle is None else table.rest_angle for table, angle in zip(sprung, built)]
        found.append(HingeSprings(rows, np.array([table.stiffness for table in sprung]), np.array(rest, float)))
    if damped := [table for table in tables if table.damping is not None]:
        rows = tuple(table.nodes for table in damped)
        found.append(HingeDampers(rows, np.array([table.damping for table in damped])))
    return tuple(found)


def hinges_tables(scene: Scene) -> list[HingeTable]:
    """The tables of springs and dampers of hinges of a scene file."""
    found: list[HingeTable] = []
    for term in scene.terms:
        if type(term) is HingeSprings:
            each = zip(term.nodes, np.asarray(term.stiffness).tolist(), np.asarray(term.rest_angle).tolist())
            found += [HingeTable(nodes=rows, stiffness=K, rest_angle=angle) for rows, K, angle in each]
        elif type(term) is HingeDampers:
            each_damping = np.asarray(term.damping).tolist()
            if [table.nodes for table in found] == list(term.nodes):
                for table, c in zip(found, each_damping):
                    table.damping = c
            else:
                found += [HingeTable(nodes=rows, damping=c) for rows, c in zip(term.nodes, each_damping)]
    return found


def build_slides(tables: list[SlideTable]) -> tuple[Slides, ...]:
    """The law of all sliding nodes; none where there are none. Raises `InputError` for slides that are none."""
    return (Slides(tuple(t.node for t in tables), tuple(t.along for t in tables)),) if tables else ()


def slides_tables(scene: Scene) -> list[SlideTable]:
    """The sliding nodes' tables of a scene file."""
    slides = slides_of(scene)
    return [] if slides is None else [SlideTable(node=k, along=pair) for k, pair in zip(slides.nodes, slides.along)]


def build_bodies(tables: list[BodyTable], nodes: np.ndarray, fixed: Supports) -> Bodies:
    """The bodies, for the file's `nodes`. Nodes of several bodies, and supports, are basic points, or pinned.

    Raises `InputError` with the number of the table.
    """
    points = [[*dict.fromkeys([*table.basic, *table.nodes])] for table in tables]
    make = lambda number, basic: _body(number, tables[number], nodes, basic)  # noqa: E731
    return joined_bodies(points, fixed, make)


def _body(number: int, table: BodyTable, nodes: np.ndarray, joints: Joints) -> Body:
    if len(table.inertia) not in (3, 6):
        raise InputError(
            f"bodies[{number}].inertia has {len(table.inertia)} numbers; expected xx, yy, zz, or also xy, xz, yz"
        )
    inertia = np.diag(table.inertia[:3])
    for (i, j), product in zip(PRODUCTS, table.inertia[3:]):
        inertia[i, j] = inertia[j, i] = product
    basic = list(dict.fromkeys([*joints, *table.basic]))
    try:
        return rigid_body(nodes, table.nodes, table.mass, inertia, table.centre, basic, tuple(table.rods))
    except InputError as error:
        said = str(error).removeprefix("rigid_body: ").removeprefix("body.")
        raise InputError(f"bodies[{number}]: {said}") from error


def bodies_tables(bodies: Bodies, nodes: NodeVectors) -> list[BodyTable]:
    """The bodies' tables of a scene file with these nodes: the same bodies, to rounding."""
    return [_table(body, np.asarray(nodes, float)) for body in bodies]


def _table(body: Body, nodes: np.ndarray) -> BodyTable:
    mass, centre, inertia = (np.asarray(x, float) for x in body_moments(body, nodes))
    x, y, z = centre.tolist()
    products = [*np.diag(inertia).tolist(), *(float(inertia[i, j]) for i, j in PRODUCTS)]
    points, basic, rods = list(body.points), list(body.basic), list(body.rods)
    return BodyTable(nodes=points, mass=float(mass), inertia=products, centre=(x, y, z), basic=basic, rods=rods)

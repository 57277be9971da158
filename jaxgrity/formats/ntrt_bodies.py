"""Rods, boxes and spheres of NTRT's files as rigid bodies: masses, inertias and strings' ends as its builder has them.

Shapes that share a node are one body. Its inertia is that of Bullet's compound shapes: of a box, with the mass of all
and as large as what encloses them along x, y and z.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrity.formats.compounds import bodies as connected
from jaxgrity.formats.ntrt_builders import Builder
from jaxgrity.formats.ntrt_tree import shortest_rotation

ALONG = 1e-9
"""Share of a string's length across a rod below which it runs along the rod, where NTRT chooses a side by a formula."""


class Shape(NamedTuple):
    """A rod, a box or a sphere."""

    builder: Builder
    nodes: tuple[int, ...]
    """from one to the other, or the centre of a sphere"""
    mass: float
    """kg; 0: it does not move, unless another shape of its body has mass"""
    centre: np.ndarray
    """(3,), m"""
    turn: np.ndarray
    """(3, 3): its own axes as columns, the last one from node to node"""
    half: np.ndarray
    """(3,), m, half of its size along them"""


class Group(NamedTuple):
    """Shapes that are one rigid body."""

    shapes: list[Shape]
    nodes: list[int]

    @property
    def mass(self) -> float:
        return sum(shape.mass for shape in self.shapes)


def shape_of(builder: Builder, nodes: tuple[int, ...], x: np.ndarray, unit: float) -> Shape:
    """What a builder makes of one node or two; x: (nodes, 3), m."""
    given, ends = builder.given, x[list(nodes)]
    if builder.kind == "tgSphereInfo":
        r = given["radius"]
        mass = given["density"] * 4 / 3 * math.pi * r**3
        return Shape(builder, nodes, mass, ends[0], np.eye(3), np.full(3, r * unit))
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    box = builder.kind == "tgBoxInfo"
    a, b = (given["width"], given["height"]) if box else (given["radius"], given["radius"])
    section = 4 * a * b if box else math.pi * a**2
    turn = shortest_rotation(np.array([0.0, 0.0, 1.0]), along, np.array([1.0, 0.0, 0.0])).as_matrix()
    half = np.array([a * unit, b * unit, length / 2])
    return Shape(builder, nodes, given["density"] * section * length / unit, ends.mean(0), turn, half)


def groups_of(shapes: list[Shape], nodes: int) -> list[Group]:
    """The rigid bodies."""
    edges = tuple((shape.nodes[0], shape.nodes[-1]) for shape in shapes)
    place = {node: k for k, own in enumerate(connected(edges, nodes)) for node in own.tolist()}
    found: dict[int, Group] = {}
    for shape in shapes:
        group = found.setdefault(place[shape.nodes[0]], Group([], []))
        group.shapes.append(shape)
        group.nodes.extend(node for node in dict.fromkeys(shape.nodes) if node not in group.nodes)
    return list(found.values())


def moments_of(group: Group) -> tuple[np.ndarray, np.ndarray]:
    """Centre of mass, m, and the inertia about it, (3, 3), kg m^2."""
    mass = group.mass
    if len(group.shapes) == 1:
        shape = group.shapes[0]
        return shape.centre, shape.turn @ np.diag(mass * _own_moments(shape)) @ shape.turn.T
    centre = np.sum([shape.mass * shape.centre for shape in group.shapes], axis=0) / mass
    # Bullet takes a compound of shapes for the upright box around them: so do the robots of NTRT
    reach = np.array([np.abs(shape.turn) @ shape.half for shape in group.shapes])
    at = np.array([shape.centre for shape in group.shapes])
    sides = (at + reach).max(0) - (at - reach).min(0)
    return centre, np.diag(mass / 12 * (np.sum(sides**2) - sides**2))


def _own_moments(shape: Shape) -> np.ndarray:
    """m^2, about its own axes, for each kg."""
    a, b, c = shape.half**2
    if shape.builder.kind == "tgSphereInfo":
        return np.full(3, 0.4 * a)
    if shape.builder.kind == "tgBoxInfo":
        return np.array([b + c, a + c, a + b]) / 3
    return np.array([a / 4 + c / 3, a / 4 + c / 3, a / 2])


def on_surface(shape: Shape, node: np.ndarray, other: np.ndarray, angle: float) -> np.ndarray:
    """Where NTRT fixes a string that runs from a shape's `node` to an`other`, m: on the side that faces it.

    `angle` turns that about a rod's axis, rad. A box is as wide there as its width on all sides.
    """
    to = other - node
    if shape.builder.kind == "tgSphereInfo":
        return node + shape.half[0] * to / np.linalg.norm(to)
    axis = shape.turn[:, 2]
    across = to - (to @ axis) * axis
    if np.linalg.norm(across) <= ALONG * np.linalg.norm(to):
        x, y, z = axis  # NTRT's formula, whose y is z here, and z is -y
        across = np.cross(axis, [z + y, -x, -x])
    return node + shape.half[0] * Rotation.from_rotvec(angle * axis).apply(across / np.linalg.norm(across))

"""Named structures by geometry: nodes, struts and cables."""

from itertools import combinations

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.model.structure import edge_lengths
from jaxgrity.structures.geometry import Geometry, check_positive, ring

PRISM_RADIUS, PRISM_HEIGHT = 0.3, 0.6
"""Radius and height of the prisms of a tower, m."""
PRISM_TWIST = 5 * np.pi / 6
"""Angle between a prism's two triangles at which it can be prestressed, rad."""
PRISM_GAP = 0.05
"""Gap between two prisms of a tower, m."""


def icosahedron(strut_length: float = 1.0) -> Geometry:
    """The six-strut tensegrity of 12 nodes, 6 struts in three parallel pairs, and 24 cables.

    Nodes are the cyclic permutations of (±2, ±1, 0) S/4, S the strut length; cables join the pairs sqrt(6)/4 S apart.
    Nodes 4a to 4a + 3 belong to the pattern whose struts lie along axis a. Returns nodes (12, 3) in m, struts, cables.
    """
    check_positive(strut_length=strut_length)
    pattern = [(2, 1, 0), (-2, 1, 0), (2, -1, 0), (-2, -1, 0)]
    nodes = np.array([np.roll(corner, axis) for axis in range(3) for corner in pattern]) * strut_length / 4
    struts = tuple((4 * axis + end, 4 * axis + end + 1) for axis in range(3) for end in (0, 2))
    pairs = tuple(combinations(range(12), 2))
    is_cable = np.isclose(edge_lengths(nodes, pairs), np.sqrt(6) / 4 * strut_length, rtol=1e-9, atol=0)
    return Geometry(nodes, struts, tuple(pair for pair, chosen in zip(pairs, is_cable) if chosen))


def prism_tower_geometry(struts: int) -> Geometry:
    """Three-strut prisms on top of each other, each tied to the next by six cables: a structure of any size.

    Prism k has the nodes 6k to 6k + 5, the lower triangle first; nine cables hold it together. Returns nodes
    (2 struts, 3) in m, the lowest at z = 0, struts, cables. Raises `InputError` where `struts` is no multiple of 3.
    """
    if struts < 3 or struts % 3:
        raise InputError(f"struts = {struts}: expected a multiple of 3, three for each prism of the tower")
    prisms = struts // 3
    nodes, rods, cables = [], [], []
    for k in range(prisms):
        low, high = 6 * k, 6 * k + 3
        for turn, level in ((0.0, 0.0), (PRISM_TWIST, PRISM_HEIGHT)):
            nodes.append(ring(3, PRISM_RADIUS, turn, k * (PRISM_HEIGHT + PRISM_GAP) + level))
        for a in range(3):
            b = (a + 1) % 3
            rods.append((low + a, high + a))
            cables += [(low + a, low + b), (high + a, high + b), (low + a, high + (a + 2) % 3)]
            if k + 1 < prisms:
                cables += [(high + a, low + 6 + a), (high + a, low + 6 + b)]
    return Geometry(np.concatenate(nodes), tuple(rods), tuple(cables))


def rest_on_face(nodes: np.ndarray) -> np.ndarray:
    """Turn direction (1, 1, 1), the normal of an icosahedron's closed face, to point down, by the shortest rotation."""
    start, down = np.ones(3) / np.sqrt(3), np.array([0.0, 0.0, -1.0])
    axis, cosine = np.cross(start, down), start @ down
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return nodes @ (np.eye(3) + cross + cross @ cross / (1 + cosine)).T

"""Structures with a name, by their geometry alone: nodes, struts and cables."""

from itertools import combinations

import numpy as np

from jaxgrity.model.structure import edge_lengths
from jaxgrity.core.types import Edges


def icosahedron(strut_length: float = 1.0) -> tuple[np.ndarray, Edges, Edges]:
    """The six-strut tensegrity of 12 nodes, 6 struts in three parallel pairs, and 24 cables.

    Nodes are the cyclic permutations of (±2, ±1, 0) S/4, S the strut length; cables join the pairs sqrt(6)/4 S apart.
    Nodes 4a to 4a + 3 belong to the pattern whose struts lie along axis a. Returns nodes (12, 3) in m, struts, cables.
    """
    pattern = [(2, 1, 0), (-2, 1, 0), (2, -1, 0), (-2, -1, 0)]
    nodes = np.array([np.roll(corner, axis) for axis in range(3) for corner in pattern]) * strut_length / 4
    struts = tuple((4 * axis + end, 4 * axis + end + 1) for axis in range(3) for end in (0, 2))
    pairs = tuple(combinations(range(12), 2))
    is_cable = np.isclose(edge_lengths(nodes, pairs), np.sqrt(6) / 4 * strut_length, rtol=1e-9, atol=0)
    return nodes, struts, tuple(pair for pair, chosen in zip(pairs, is_cable) if chosen)


def rest_on_face(nodes: np.ndarray) -> np.ndarray:
    """Turn direction (1, 1, 1), the normal of an icosahedron's closed face, to point down, by the shortest rotation."""
    start, down = np.ones(3) / np.sqrt(3), np.array([0.0, 0.0, -1.0])
    axis, cosine = np.cross(start, down), start @ down
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return nodes @ (np.eye(3) + cross + cross @ cross / (1 + cosine)).T

"""Spherical structures: all nodes are images of one under a rotation group; so are the members of each kind."""

from typing import NamedTuple

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import Edges
from jaxgrity.structures.geometry import Geometry, check_positive

GOLDEN = (1 + 5**0.5) / 2
"""The golden ratio, which coordinates of the ball of 30 struts contain."""

Axis = tuple[float, float, float]


class Ball(NamedTuple):
    """One symmetric form: the rotations from a node to its neighbours."""

    face: tuple[Axis, int]
    """axis and order of the rotation around a face, along whose rim the cables of the first kind run"""
    edge: Axis
    """of the half turn to the node of the next face, at the other end of a cable of the second kind"""
    strut: Axis
    """of the half turn to the other end of the node's strut"""


FORMS = {
    6: Ball(((1.0, 1.0, 1.0), 3), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
    12: Ball(((0.0, 0.0, 1.0), 4), (0.0, 1.0, 1.0), (1.0, 0.0, 1.0)),
    30: Ball(((0.0, 1.0, GOLDEN), 5), (GOLDEN - 1, 2 - GOLDEN, 1.0), (1.0, GOLDEN - 1, 2 - GOLDEN)),
}
"""The balls by their number of struts, with rotations of the tetrahedron, the octahedron and the icosahedron."""


def ball(struts: int = 30, strut_length: float = 1.0) -> Geometry:
    """A super-stable ball of 6, 12 or 30 struts that do not touch, and three times as many cables.

    Nodes are the images g x of one node under a rotation group; cables join g x with g c x and g e x, struts with g s
    x. Both kinds of cables have the force density 1, and struts w. A node is in equilibrium where ((c + c' - 2) + (e -
    1) + w (s - 1)) x = 0. The determinant of this matrix is a polynomial in w, and x is its null vector (Connelly and
    Back 1998, "Mathematics and tensegrity", American Scientist 86). We take the root nearest to 0, where Omega has no
    negative eigenvalue. Raises `InputError` for another number of struts.
    """
    if struts not in FORMS:
        raise InputError(f"struts = {struts}: expected 6, 12 or 30, the balls of which the form is known")
    check_positive(strut_length=strut_length)
    (axis, order), edge, strut = FORMS[struts]
    turn, flip, across = rotation(axis, 2 * np.pi / order), rotation(edge, np.pi), rotation(strut, np.pi)
    node = _stressed_node(turn + turn.T + flip - 3 * np.eye(3), across - np.eye(3))
    group = _generated(turn, flip)
    nodes = np.array([g @ node for g in group]) * strut_length / np.linalg.norm(across @ node - node)

    def orbit(element: np.ndarray) -> Edges:
        images = [_place(group, g @ element) for g in group]
        return tuple(sorted({(min(i, j), max(i, j)) for i, j in enumerate(images)}))

    return Geometry(nodes, orbit(across), orbit(turn) + orbit(flip))


def rotation(axis: Axis, angle: float) -> np.ndarray:
    """The matrix (3, 3) of a turn by `angle`, rad, about `axis` (Rodrigues)."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _stressed_node(cables: np.ndarray, strut: np.ndarray) -> np.ndarray:
    """x with (cables + w strut) x = 0, for the w < 0 nearest to 0 with a solution."""
    # det(cables + w strut) = 0: strut has eigenvalues 0, -2, -2, so this is a polynomial of degree 2, through 3 points
    at = np.array([-1.0, -0.5, 0.0])
    roots = np.roots(np.polyfit(at, [np.linalg.det(cables + w * strut) for w in at], 2))
    density = max(w.real for w in roots if abs(w.imag) < 1e-9 and w.real < -1e-9)
    return np.linalg.svd(cables + density * strut)[2][-1]


def _generated(*generators: np.ndarray) -> list[np.ndarray]:
    """All products of the generators, the identity first."""
    group = [np.eye(3)]
    for element in group:
        group += [new for g in generators if _place(group, new := element @ g) == len(group)]
    return group


def _place(group: list[np.ndarray], element: np.ndarray) -> int:
    """The number of an element, or of a new one."""
    gaps = np.abs(np.array(group) - element).max((1, 2))
    return int(np.argmin(gaps)) if gaps.min() < 1e-9 else len(group)

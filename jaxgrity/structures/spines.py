"""Spines: stiff vertebrae in a row, without contact, held by cables."""

import numpy as np

from jaxgrity.core.types import Edges
from jaxgrity.model.bodies import rigid_body
from jaxgrity.structures.geometry import Geometry, RobotGeometry, at_least, check_positive

TETRAHEDRON = ((0, 1), (2, 3), (0, 2), (0, 3), (1, 2), (1, 3))
"""Struts of a vertebra: the six edges of a tetrahedron, by its nodes."""


def tetrahedral_spine(vertebrae: int = 3, width: float = 0.3, height: float = 0.3, spacing: float = 0.2) -> Geometry:
    """A stack of tetrahedra of six struts, each pair joined by four vertical and four saddle cables.

    Nodes 4k to 4k + 3 are vertebra k's: two low ones along x, two high ones along y, `width` apart, `height` m higher.
    If `spacing` is less than `height`, the next vertebra's low nodes hang in saddle cables from this one's high nodes.
    These cables pull it up against the vertical cables. Sources: Mirletz, Park, Flemons, Agogino, Quinn and SunSpiral
    2014, "Design and control of modular spine-like tensegrity structures"; Sabelhaus et al. 2017.
    """
    at_least("vertebrae", vertebrae, 2)
    check_positive(width=width, height=height, spacing=spacing)
    half = width / 2
    one = np.array([[-half, 0, 0], [half, 0, 0], [0, -half, height], [0, half, height]])
    nodes = np.concatenate([one + np.array([0, 0, k * spacing]) for k in range(vertebrae)])
    struts = _chain(TETRAHEDRON, 4, range(vertebrae))
    vertical = tuple((i, 4 + i) for i in range(4))
    saddle = tuple((high, 4 + low) for high in (2, 3) for low in (0, 1))
    return Geometry(nodes, struts, _chain(vertical + saddle, 4, range(vertebrae - 1)))


def planar_spine(vertebrae: int = 3, length: float = 0.3, height: float = 0.3, spacing: float = 0.2) -> Geometry:
    """Triangles of three struts along x in the plane y = 0, each pair joined by two horizontal and two saddle cables.

    Nodes 3k to 3k + 2 are vertebra k's: low and high end of its back, `height` apart, and its tip, `length` ahead. With
    `spacing` less than `length` the tip reaches over the next vertebra's back, to whose ends the saddle cables run (the
    two-dimensional spine of Sabelhaus et al. 2017, its vertebrae as triangles, which pass through each other in the
    plane: hardware puts them side by side). The stress makes it stable in its plane; out of it, only supports do.
    """
    at_least("vertebrae", vertebrae, 2)
    check_positive(length=length, height=height, spacing=spacing)
    one = np.array([[0, 0, -height / 2], [0, 0, height / 2], [length, 0, 0]])
    nodes = np.concatenate([one + np.array([k * spacing, 0, 0]) for k in range(vertebrae)])
    struts = _chain(((0, 1), (0, 2), (1, 2)), 3, range(vertebrae))
    cables = ((0, 3), (1, 4), (2, 3), (2, 4))
    return Geometry(nodes, struts, _chain(cables, 3, range(vertebrae - 1)))


def hinged_spine(vertebrae: int = 3, height: float = 0.1, mass: float = 0.1) -> RobotGeometry:
    """A column of rigid vertebrae with a hinge and two cables between neighbours. It stands on its lowest four nodes.

    Hinges turn about x and about y in turn, like the joints of a snake robot (Hirose 1993, "Biologically inspired
    robots"). Their two ends are nodes of both vertebrae. A cable on either side of each hinge holds it, as muscles hold
    the joints of a backbone (Levin 2002, "The tensegrity-truss as a model for spine mechanics", J. Mech. Med. Biol. 2).
    Vertebrae are `height` m apart, and have `mass` kg and the inertia of a solid cylinder as wide as it is high. Nodes
    6k and 6k + 1 are the lower hinge of vertebra k, 6k + 2 and 6k + 3 the lower ends of the cables beside it, 6k + 4
    and 6k + 5 the lower ends of cables to the next vertebra. Raises `InputError` for fewer than two vertebrae, and
    for a height or a mass that is not positive.
    """
    at_least("vertebrae", vertebrae, 2)
    check_positive(height=height, mass=mass)
    inertia = mass * height**2 * np.array([7, 7, 6]) / 48
    x, y, z = np.eye(3) * height
    ends, rows, middles = np.array([[-1.0], [1.0]]), [], []
    for k in range(vertebrae + 1):
        hinge, arm = (x, y) if k % 2 == 0 else (y, x)
        rows += [k * z + ends * hinge / 4]
        if k < vertebrae:
            rows += [k * z + ends * arm / 2, (k + 2 / 3) * z + ends * hinge / 2]
            middles += [(k + 1 / 2) * z]
    nodes = np.concatenate(rows)
    bodies = tuple(
        rigid_body(nodes, range(6 * k, 6 * k + 8), mass, inertia, middle, (6 * k, 6 * k + 1, 6 * k + 6, 6 * k + 7))
        for k, middle in enumerate(middles)
    )
    return RobotGeometry(nodes, (), _chain(((4, 8), (5, 9)), 6, range(vertebrae - 1)), bodies)


def _chain(edges: Edges, step: int, links: range) -> Edges:
    """The same edges for each link, with all numbers `step` higher."""
    return tuple((i + step * k, j + step * k) for k in links for i, j in edges)

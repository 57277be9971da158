"""Members made of members: D-bars and T-bars in place of a strut, and grids of prisms as plates."""

import numpy as np

from jaxgrity.structures.geometry import Geometry, at_least, at_most, check_positive, joined, ring

MOST_PRISMS = 10_000
"""Most prisms of a grid."""


def d_bar(sides: int = 3, length: float = 1.0, radius: float = 0.15) -> Geometry:
    """A strut of `length` m, replaced by 2n struts from its ends to a ring of n nodes, its polygon and a long cable.

    Two nodes make a diamond in a plane with one cable across; supports have to keep it flat. The ring holds the struts
    together under compression: the "D-bar" of Skelton and de Oliveira (2009), Tensegrity Systems.
    """
    at_least("sides", sides, 2)
    check_positive(length=length, radius=radius)
    nodes = np.concatenate([[[0, 0, 0], [0, 0, length]], ring(sides, radius, 0.0, length / 2)])
    struts = tuple((end, 2 + k) for k in range(sides) for end in (0, 1))
    around = joined(2, 2, sides, 1) if sides > 2 else ((2, 3),)
    return Geometry(nodes, struts, (*around, (0, 1)))


def t_bar(sides: int = 3, length: float = 1.0, radius: float = 0.15) -> Geometry:
    """A strut of `length` m, cut in two at its middle, with n spokes there and 2n cables from their tips to its ends.

    The "T-bar" of Skelton and de Oliveira (2009), Tensegrity Systems. Struts meet at the middle. With free joints
    there, the stress does not stiffen two mechanisms: the middle moves aside, or the spokes do.
    """
    at_least("sides", sides, 2)
    check_positive(length=length, radius=radius)
    nodes = np.concatenate([[[0, 0, 0], [0, 0, length], [0, 0, length / 2]], ring(sides, radius, 0.0, length / 2)])
    struts = ((0, 2), (1, 2), *((2, 3 + k) for k in range(sides)))
    return Geometry(nodes, struts, tuple((end, 3 + k) for k in range(sides) for end in (0, 1)))


def grid(rows: int = 2, columns: int = 2, side: float = 1.0, height: float = 0.6) -> Geometry:
    """A double-layer plate of four-strut prisms: squares of cables below, smaller ones turned by 45 degrees above.

    The lower squares, `side` m wide, tile the plane; the corners of the upper ones lie above the middles of their
    sides, where neighbours meet. Each prism carries a stress by itself, and so does the grid (the quadruplex grids of
    Motro 2003, Tensegrity: Structural Systems for the Future). Struts meet where prisms do.
    """
    at_least("rows", rows, 1)
    at_least("columns", columns, 1)
    check_positive(side=side, height=height)
    at_most("columns", columns, MOST_PRISMS // rows)
    number: dict[tuple[int, int, int], int] = {}
    struts: dict[tuple[int, int], None] = {}
    cables: dict[tuple[int, int], None] = {}

    def node(x: int, y: int, layer: int) -> int:
        """The node at a place, in half sides; neighbouring prisms share it."""
        return number.setdefault((x, y, layer), len(number))

    for i in range(rows):
        for j in range(columns):
            x, y = 2 * j + 1, 2 * i + 1
            low = [node(x + a, y + b, 0) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
            high = [node(x + a, y + b, 1) for a, b in ((-1, 0), (0, -1), (1, 0), (0, 1))]
            for k in range(4):
                struts[low[k], high[k]] = None
                for pair in ((low[k], low[k - 1]), (high[k], high[k - 1]), (low[k], high[k - 1])):
                    cables[min(pair), max(pair)] = None
    nodes = np.array(list(number), float) * [side / 2, side / 2, height]
    return Geometry(nodes, tuple(struts), tuple(cables))

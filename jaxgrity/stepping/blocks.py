"""Nodes in blocks, and vectors by their components: how a step lays out exact contact and rigid struts in memory.

Where no two struts share a node, their first ends are one block and their second ends another. All that a sweep does
is then elementwise: neither gathers nor sums over nodes, and no loop over xyz.
"""

from functools import lru_cache, reduce
from operator import add
from typing import NamedTuple

import equinox as eqx

from jaxgrity.core.primitives import along, component, place_rows, take_rows
from jaxgrity.core.types import AnyArray, AnyRows, Edges, PerMember, PerRow
from jaxgrity.model.ground import Ground

WITHOUT_GROUND = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
"""The axes z, x and y, which stand for a normal and two tangents where there is no plane."""


class Vector(eqx.Module):
    """A vector for each node of a block, or for each strut, by its components."""

    normal: PerRow
    """along the normal of the plane; along z where there is none"""
    first: PerRow
    """along the first of its tangents; x"""
    second: PerRow
    """along the second; y"""

    @property
    def parts(self) -> tuple[PerRow, PerRow, PerRow]:
        """Its three components."""
        return self.normal, self.first, self.second

    def __add__(self, other: "Vector") -> "Vector":
        return Vector(self.normal + other.normal, self.first + other.first, self.second + other.second)

    def __sub__(self, other: "Vector") -> "Vector":
        return Vector(self.normal - other.normal, self.first - other.first, self.second - other.second)

    def __mul__(self, s) -> "Vector":
        return Vector(self.normal * s, self.first * s, self.second * s)

    def dot(self, other: "Vector") -> PerRow:
        return self.normal * other.normal + self.first * other.first + self.second * other.second


class Blocks(NamedTuple):
    """Which nodes are side by side in each block, and which struts a sweep meets at once."""

    nodes: tuple[tuple[int, ...], ...]
    """of each block"""
    groups: tuple[tuple[int, ...], ...]
    """of struts, none of which shares a node with another of its group"""
    edges: Edges
    """of the struts"""

    @property
    def by_struts(self) -> bool:
        """Whether the first block holds every strut's first end, the second every strut's second end."""
        return len(self.nodes) > 1

    def ends(self, values: tuple, group: tuple[int, ...]) -> tuple:
        """Of vectors or numbers for each block, those at the first and at the second ends of the struts of a group."""
        if self.by_struts:
            return values[0], values[1]
        return tuple(rows_of(values[0], tuple(self.edges[k][end] for k in group)) for end in (0, 1))

    def at_nodes(self, value: PerMember, group: tuple[int, ...]) -> tuple[PerRow, ...]:
        """For the blocks that struts reach, the number of each node's strut; any number where it has none."""
        if self.by_struts:
            return value, value
        strut_of = {node: row for row, strut in enumerate(group) for node in self.edges[strut]}
        return (take_rows(value, tuple(strut_of.get(node, 0) for node in self.nodes[0])),)

    def split(self, x: AnyRows, ground: Ground | None) -> tuple[Vector, ...]:
        """Vectors (nodes, 3) as one `Vector` for each block."""
        return tuple(rows_of(vector(x, ground), rows) for rows in self.nodes)

    def numbers(self, x: AnyArray) -> tuple[AnyArray, ...]:
        """A number for each node, one array for each block; a number that all nodes have in common, for each block."""
        return tuple(take_rows(x, rows) if x.ndim else x for rows in self.nodes)

    def joined(self, vectors: tuple[Vector, ...]) -> Vector:
        """Of one `Vector` for each block, that for all nodes in their order."""
        if len(self.nodes) == 1:
            return vectors[0]
        count = sum(map(len, self.nodes))
        placed = (Vector(*(place_rows(part, rows, count) for part in x.parts)) for x, rows in zip(vectors, self.nodes))
        return reduce(add, placed)


def rows_of(x, rows: tuple[int, ...]):
    """The chosen rows of a `Vector` or of an array."""
    if isinstance(x, Vector):
        return Vector(*(rows_of(part, rows) for part in x.parts))
    return x if rows == tuple(range(x.shape[0])) else take_rows(x, rows)


def axes_of(ground: Ground | None) -> tuple:
    """The unit vectors along which `Vector` has its components: a plane's normal and tangents, or z, x and y."""
    return WITHOUT_GROUND if ground is None or ground.surface is not None else (ground.normal, *ground.tangents)


def vector(x: AnyRows, ground: Ground | None) -> Vector:
    """Rows of xyz as a `Vector`."""
    return Vector(*(component(x, axis) for axis in axes_of(ground)))


def xyz(x: Vector, ground: Ground | None) -> AnyRows:
    """The inverse of `vector`."""
    normal, first, second = axes_of(ground)
    return along(x.normal, normal) + along(x.first, first) + along(x.second, second)


# kept, since nearly every function of a step asks for it when it is traced
@lru_cache
def blocks(edges: Edges, nodes: int) -> Blocks:
    """How these struts, and so many nodes, are laid out."""
    groups = disjoint_groups(edges)
    # more groups mean shared nodes: ends as arrays of their own would hold a shared node twice
    if len(groups) != 1:
        return Blocks((tuple(range(nodes)),), groups, edges)
    first, second = zip(*edges)
    rest = tuple(sorted(set(range(nodes)) - {*first, *second}))
    return Blocks((first, second, rest) if rest else (first, second), groups, edges)


def disjoint_groups(edges: Edges) -> tuple[tuple[int, ...], ...]:
    """The rows of `edges` in groups whose members share no node, so that each group is met all at once."""
    # in the order of `edges`, first come first served: sweeps, and so answers, are the same in every process
    rest, found = list(range(len(edges))), []
    while rest:
        used: set[int] = set()
        group = []
        for k in rest:
            if not used & set(edges[k]):
                group.append(k)
                used |= set(edges[k])
        rest = [k for k in rest if k not in group]
        found.append(tuple(group))
    return tuple(found)

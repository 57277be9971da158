"""Nodes in blocks, and vectors by components: the memory layout of exact contact and rigid struts in a step.

Where no two struts share a node, their first ends are one block and their second ends another. A sweep is then
elementwise: no gathers or sums over nodes, and no loop over xyz. Nodes without a strut follow the first ends in their
block: with a block of their own, programs would compile for half as long again.
"""

from functools import lru_cache, reduce
from operator import add
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jaxgrity.core.primitives import along, component, place_rows, take_rows
from jaxgrity.core.types import AnyArray, AnyRows, Edges, PerMember, PerRow, Scalar
from jaxgrity.model.ground import Ground

WITHOUT_GROUND = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
"""The axes z, x and y, which stand for a normal and two tangents where there is no plane."""


class Components(eqx.Module):
    """The components of a vector for each node of a block, or for each strut."""

    normal: PerRow
    """along the normal of the plane; along z where there is none"""
    first: PerRow
    """along the first of its tangents; x"""
    second: PerRow
    """along the second; y"""

    @property
    def each(self) -> tuple[PerRow, PerRow, PerRow]:
        """All three."""
        return self.normal, self.first, self.second

    def __add__(self, other: "Components") -> "Components":
        return Components(self.normal + other.normal, self.first + other.first, self.second + other.second)

    def __sub__(self, other: "Components") -> "Components":
        return Components(self.normal - other.normal, self.first - other.first, self.second - other.second)

    def __mul__(self, s) -> "Components":
        return Components(self.normal * s, self.first * s, self.second * s)

    def dot(self, other: "Components") -> PerRow:
        return self.normal * other.normal + self.first * other.first + self.second * other.second


class Blocks(NamedTuple):
    """The nodes of each block, and the struts that a sweep treats at once."""

    nodes: tuple[tuple[int, ...], ...]
    """of each block"""
    groups: tuple[tuple[int, ...], ...]
    """of struts, none of which shares a node with another of its group"""
    edges: Edges
    """of the struts"""

    @property
    def by_struts(self) -> bool:
        """Whether the first block begins with all first ends of struts, and the second holds all second ends."""
        return len(self.nodes) > 1

    def ends(self, values: tuple, group: tuple[int, ...]) -> tuple:
        """Vectors or numbers at the first and at the second ends of a group's struts, from those of each block."""
        if self.by_struts:
            return rows_of(values[0], tuple(range(len(self.edges)))), values[1]
        return tuple(rows_of(values[0], tuple(self.edges[k][end] for k in group)) for end in (0, 1))

    def at_nodes(self, value: PerMember, group: tuple[int, ...]) -> tuple[PerRow, ...]:
        """The number of each node's strut, for each block; any number for a node without one."""
        if self.by_struts:
            return self.padded(value), value
        strut_of = {node: row for row, strut in enumerate(group) for node in self.edges[strut]}
        return (take_rows(value, tuple(strut_of.get(node, 0) for node in self.nodes[0])),)

    def padded(self, value: PerMember) -> PerRow:
        """The number of each strut, for the first of the blocks by struts: 0 for nodes without a strut."""
        struts, rows = len(self.edges), len(self.nodes[0])
        return value if rows == struts else place_rows(value, tuple(range(struts)), rows)

    def split(self, x: AnyRows, ground: Ground | None) -> tuple[Components, ...]:
        """Vectors (nodes, 3) as `Components` for each block."""
        return tuple(rows_of(components_of(x, ground), rows) for rows in self.nodes)

    def numbers(self, x: AnyArray) -> tuple[AnyArray, ...]:
        """A number for each node as one array for each block; a common number for each block."""
        return tuple(take_rows(x, rows) if x.ndim else x for rows in self.nodes)

    def joined(self, vectors: tuple[Components, ...]) -> Components:
        """The `Components` of all nodes in their order, from those of each block."""
        if len(self.nodes) == 1:
            return vectors[0]
        count = sum(map(len, self.nodes))
        placed = (
            Components(*(place_rows(part, rows, count) for part in x.each)) for x, rows in zip(vectors, self.nodes)
        )
        return reduce(add, placed)


def rows_of(x, rows: tuple[int, ...]):
    """The chosen rows of `Components` or of an array."""
    if isinstance(x, Components):
        return Components(*(rows_of(part, rows) for part in x.each))
    return x if rows == tuple(range(x.shape[0])) else take_rows(x, rows)


def axes_of(ground: Ground | None) -> tuple:
    """The unit vectors of `Components`: a plane's normal and tangents, or z, x and y."""
    return WITHOUT_GROUND if ground is None or ground.surface is not None else (ground.normal, *ground.tangents)


def components_of(x: AnyRows, ground: Ground | None) -> Components:
    """Rows of xyz as `Components`."""
    return Components(*(component(x, axis) for axis in axes_of(ground)))


def xyz(x: Components, ground: Ground | None) -> AnyRows:
    """The inverse of `components_of`."""
    normal, first, second = axes_of(ground)
    return along(x.normal, normal) + along(x.first, first) + along(x.second, second)


# kept, since nearly every function of a step asks for it when it is traced
@lru_cache
def blocks(edges: Edges, nodes: int) -> Blocks:
    """The layout of these struts and this number of nodes."""
    groups = disjoint_groups(edges)
    # more groups mean shared nodes: ends as arrays of their own would hold a shared node twice
    if len(groups) != 1:
        return Blocks((tuple(range(nodes)),), groups, edges)
    first, second = zip(*edges)
    rest = tuple(sorted(set(range(nodes)) - {*first, *second}))
    return Blocks(((*first, *rest), second), groups, edges)


def disjoint_groups(edges: Edges) -> tuple[tuple[int, ...], ...]:
    """The rows of `edges` in groups without common nodes, so that each group is treated at once."""
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


def largest(x: PerMember) -> Scalar:
    """The largest entry, by halving: XLA's own reduction over the first of two axes is not vectorised."""
    while x.shape[0] > 1:
        half = x.shape[0] // 2
        rest = take_rows(x, tuple(range(half, x.shape[0])))
        pairs = jnp.maximum(take_rows(x, tuple(range(half))), take_rows(rest, tuple(range(half))))
        x = pairs if 2 * half == x.shape[0] else jnp.maximum(pairs, take_rows(rest, (half,) * half))
    return take_rows(x, (0,))[0]

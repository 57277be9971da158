"""Points of all rigid bodies as arrays over these points, so that no program grows with the number of bodies.

Bodies with equally many basic points are one stack: there are at most three.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrity.core.primitives import dot, inner, place_rows, scale, take_rows
from jaxgrity.core.types import (
    AnyArray,
    AnyPerNode,
    Edges,
    NodeVectors,
    PerMember,
    Rows,
    Scalar,
    Supports,
    namespace_of,
)
from jaxgrity.model.bodies import Bodies, Body


class Stack(NamedTuple):
    """The bodies with the same number of basic points."""

    bodies: Bodies
    basic: np.ndarray
    """(bodies, basic), nodes"""
    carried: tuple[int, ...]
    """the other points of all bodies, nodes"""
    carriers: np.ndarray
    """(carried, basic): the nodes that each of them follows"""

    @property
    def matrix(self) -> AnyArray:
        """(bodies, basic, basic), kg"""
        return _joined(self.bodies, lambda body: body.matrix[None])

    @property
    def weights(self) -> AnyArray:
        """(carried, basic)"""
        return _joined(self.bodies, lambda body: body.weights)


def stacks_of(bodies: Bodies) -> list[Stack]:
    """The bodies by their number of basic points."""
    stacks = []
    for count in sorted({len(body.basic) for body in bodies}):
        alike = tuple(body for body in bodies if len(body.basic) == count)
        carried = tuple(k for body in alike for k in body.carried)
        carriers = [body.basic for body in alike for _ in body.carried]
        basic = np.array([body.basic for body in alike])
        stacks.append(Stack(alike, basic, carried, np.array(carriers, int).reshape(-1, count)))
    return stacks


def lumped(bodies: Bodies, nodes: int) -> AnyPerNode | float:
    """kg at each node, some maybe negative: the bodies' part in weight, momentum and centre of mass."""
    shares = [(stack.matrix.sum(2).ravel(), stack.basic) for stack in stacks_of(bodies)]
    return sum((place_rows(share, _numbers(basic), nodes) for share, basic in shares), 0.0)


def shared_evenly(bodies: Bodies, nodes: int) -> AnyPerNode | float:
    """kg at each node: each body's mass in equal shares at its points."""
    if not bodies:
        return 0.0
    counts = np.array([len(body.points) for body in bodies])
    masses = _joined(bodies, lambda body: body.matrix.sum().reshape(1))
    shares = namespace_of(masses).repeat(masses / counts.astype(masses.dtype), counts)
    return place_rows(shares, tuple(k for body in bodies for k in body.points), nodes)


def independent_nodes(bodies: Bodies, nodes: int) -> tuple[int, ...]:
    """The independent nodes: those that follow no others."""
    following = {k for body in bodies for k in body.carried}
    return tuple(k for k in range(nodes) if k not in following)


def carrying(bodies: Bodies, nodes: int) -> AnyArray:
    """N, (nodes, independent nodes): the weights of independent nodes in every node's position."""
    free, stacks = np.array(independent_nodes(bodies, nodes)), stacks_of(bodies)
    dtype = bodies[0].weights.dtype if bodies else float  # float64 would spread from here
    rows: AnyArray = np.eye(nodes, dtype=dtype)[:, free]
    column = np.cumsum(np.isin(np.arange(nodes), free)) - 1
    for stack in stacks:
        place = np.array(stack.carried, int)[:, None], column[stack.carriers]
        if namespace_of(weights := stack.weights) is np and namespace_of(rows) is np:
            rows[place] = weights
        else:
            rows = jnp.asarray(rows).at[place].set(weights)
    return rows


def following(bodies: Bodies, x: NodeVectors) -> NodeVectors:
    """Positions, or velocities, with the bodies' other points from the basic ones."""
    for stack in stacks_of(bodies):
        if stack.carried:
            columns = zip(stack.carriers.T, jnp.asarray(stack.weights, x.dtype).T)
            there = sum(scale(take_rows(x, _numbers(nodes)), weights) for nodes, weights in columns)
            x = x + place_rows(there - take_rows(x, stack.carried), stack.carried, len(x))
    return x


def onto_basic(bodies: Bodies, forces: NodeVectors) -> NodeVectors:
    """The transpose of `following`: equivalent forces at basic points alone."""
    for stack in stacks_of(bodies):
        if stack.carried:
            there = take_rows(forces, stack.carried)
            forces = forces - place_rows(there, stack.carried, len(forces))
            parts = scale(take_rows(there, _owners(stack)), _flat(stack.weights, there))
            forces = forces + place_rows(parts, _numbers(stack.carriers), len(forces))
    return forces


def energy_of_bodies(bodies: Bodies, v: NodeVectors) -> Scalar | float:
    """T = 1/2 sum_ab m_ab v_a·v_b over all bodies, J."""
    total: Scalar | float = 0.0
    for stack in stacks_of(bodies):
        count = stack.basic.shape[1]
        first, second = np.repeat(stack.basic, count, axis=1), np.tile(stack.basic, (1, count))
        products = dot(take_rows(v, _numbers(first)), take_rows(v, _numbers(second)))
        total = total + inner(_flat(stack.matrix, v), products) / 2
    return total


def body_pairs(bodies: Bodies, fixed: Supports = ()) -> tuple[Edges, PerMember]:
    """The pairs of points at constant distances (`Body.edges`) but for pairs of `fixed` ones; these distances, m."""
    still = {node for node, axes in fixed if set(axes) == set("xyz")}
    first: dict[frozenset, tuple[tuple[int, int], int]] = {}
    for row, edge in enumerate(edge for body in bodies for edge in body.edges):
        if not set(edge) <= still:
            first.setdefault(frozenset(edge), (edge, row))
    rows = np.array([row for _, row in first.values()], int)
    return tuple(edge for edge, _ in first.values()), _joined(bodies, lambda body: body.lengths)[rows]


def _joined(bodies: Bodies, part: Callable[[Body], AnyArray]) -> AnyArray:
    """A part of each body, one after the other in an array; in NumPy where all numbers are known."""
    parts: Sequence[AnyArray] = [part(body) for body in bodies]
    return (jnp if any(namespace_of(x) is jnp for x in parts) else np).concatenate(parts)


def _numbers(nodes: np.ndarray) -> tuple[int, ...]:
    return tuple(nodes.ravel().tolist())


def _owners(stack: Stack) -> tuple[int, ...]:
    """The number of the carried point, once for each node that it follows."""
    return _numbers(np.repeat(np.arange(len(stack.carried)), stack.carriers.shape[1]))


def _flat(numbers: AnyArray, like: Rows) -> AnyArray:
    return jnp.asarray(numbers, like.dtype).ravel()

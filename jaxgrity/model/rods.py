"""Rods, which may touch between their ends: struts, and lines between two points of a rigid body.

Rods have numbers: struts first, then the rods of all bodies in order. A rod of a body with four basic points turns with
it: what touches is a point at its surface, which moves as that point of the body, so that it can roll. Any other rod
slides.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrity.core.types import AnyArray, Edges, NodeVectors
from jaxgrity.model.structure import Structure


class Carriers(NamedTuple):
    """What turns with a body, a row for each."""

    basic: AnyArray
    """(rows, 4), the basic points of its body; the first node for what turns with none"""
    turns: AnyArray
    """(rows,), whether it turns with a body"""


def rods_of(structure: Structure) -> Edges:
    """The nodes at both ends of each rod."""
    struts = () if structure.struts is None else structure.struts.edges
    return (*struts, *(rod for body in structure.bodies for rod in body.rods))


def free_pairs(structure: Structure) -> Edges:
    """The pairs of rods that no node joins: two without a common node or body, and not of bodies with a common node."""
    struts = [] if structure.struts is None else [set(edge) for edge in structure.struts.edges]
    joined = [*struts, *(set(body.points) for body in structure.bodies for _ in body.rods)]
    return tuple(
        pair for pair in itertools.combinations(range(len(joined)), 2) if not joined[pair[0]] & joined[pair[1]]
    )


def carriers_of(structure: Structure, rods: Sequence[int]) -> Carriers:
    """The bodies with which the `rods` of these numbers turn."""
    basic = [()] * structure.first_cable + [body.basic for body in structure.bodies for _ in body.rods]
    turns = np.array([len(basic[k]) == 4 for k in rods], bool)
    return Carriers(np.array([basic[k] if len(basic[k]) == 4 else (0,) * 4 for k in rods], int).reshape(-1, 4), turns)


def turned(structure: Structure, rods: Sequence[int], arms: AnyArray, q: NodeVectors) -> AnyArray | None:
    """`moved_beside` of points of these `rods`, one for each, by `arms` from their axes; None if none turns."""
    carriers = carriers_of(structure, rods)
    return moved_beside(carriers, arms, q) if carriers.turns.any() else None


def moved_beside(carriers: Carriers, arms: AnyArray, q: NodeVectors) -> AnyArray:
    """(rows, nodes): the weights of nodes in the motion of a point of a body against another one of the body.

    The `arms`, (rows, 3), m, lead from the second to the first, where nodes are at q. What turns with no body has 0.
    """
    basic, turns = carriers
    first = q[basic[:, 0]]
    a, b, c = (q[basic[:, k]] - first for k in (1, 2, 3))
    across = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], axis=1)
    volume = jnp.where(turns, jnp.sum(a * across[:, 0], axis=1), 1)
    shares = jnp.where(turns[:, None], jnp.sum(arms[:, None] * across, axis=2) / volume[:, None], 0)
    rows = jnp.concatenate([-shares.sum(1, keepdims=True), shares], axis=1)
    return jnp.zeros((len(arms), len(q)), q.dtype).at[np.arange(len(arms))[:, None], basic].add(rows)

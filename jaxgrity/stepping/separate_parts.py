"""Parts of a structure that only cables and springs join: each is a small problem of its own in a step.

A part is what bodies, rigid struts, and members with mass join. Forces between parts are known before the impulses of a
step, so no impulse on one part moves another. Alike parts, with as many nodes, struts and contacts, are solved side by
side.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from jaxgrity.core.primitives import take_rows
from jaxgrity.core.types import AnyArray, PerNode
from jaxgrity.model.rigidity import rigid_pairs
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import slides_of
from jaxgrity.stepping.capsules import capsules_of, ends_of
from jaxgrity.stepping.constraints import exact_ground
from jaxgrity.stepping.coupled_constraints import Constraints, contact_nodes, moving_nodes
from jaxgrity.stepping.strut_contacts import points_between

MOST_KINDS = 4
"""Most kinds of parts. Each kind is a program of its own, which takes a second or more to compile."""


class Alike(NamedTuple):
    """Parts with as many nodes, struts and contacts; a row for each part."""

    nodes: np.ndarray
    """(parts, nodes), numbers among the independent nodes"""
    struts: np.ndarray
    """(parts, struts), numbers among the rigid pairs"""
    contacts: np.ndarray
    """(parts, contacts), numbers among the contacts"""


def separate_parts(scene: Scene) -> tuple[Alike, ...] | None:
    """The parts that move, alike ones together; None where all has to be solved together.

    That is so with fewer than two parts or more than `MOST_KINDS` kinds, where struts touch each other, and where nodes
    slide. It is so
    where a strut that touches the ground is a spring between two parts, or what keeps its length joins two supports.
    """
    if points_between(scene) or slides_of(scene) is not None:
        return None
    label, nodes = _labels(scene), moving_nodes(scene)
    pairs = np.array(rigid_pairs(scene), int).reshape(-1, 2)
    contacts = label[contact_nodes(scene)]
    if exact_ground(scene) is not None and (capsules := capsules_of(scene)) is not None:
        first, second = (label[ends] for ends in ends_of(capsules))
        if np.any(first != second):
            return None
        contacts = np.concatenate([contacts, first])
    kinds: dict[tuple[int, ...], list[tuple[np.ndarray, ...]]] = {}
    free = scene.structure.free[nodes].any(1)
    for part in np.unique(label[nodes]):
        of = tuple(np.flatnonzero(labels == part) for labels in (label[nodes], label[pairs[:, 0]], contacts))
        if free[of[0]].any():
            kinds.setdefault(tuple(map(len, of)), []).append(of)
        elif len(of[1]):
            return None
    if len(kinds) > MOST_KINDS or sum(map(len, kinds.values())) < 2:
        return None
    return tuple(Alike(*(np.stack(rows) for rows in zip(*parts))) for parts in kinds.values())


def hit_by_landings(scene: Scene, landed: PerNode) -> PerNode:
    """1 for nodes of parts of which a node `landed` (a number above 0 for each such node), else 0."""
    label = _labels(scene)
    together = label[:, None] == label
    if together.sum(1).max() <= 2:
        # rows are cheaper than a product of matrices, and keep the population last
        sums = landed + take_rows(landed, tuple(_other(row, own) for own, row in enumerate(together)))
    else:
        sums = jnp.asarray(together, landed.dtype) @ landed
    return (sums > 0).astype(landed.dtype)


def _other(row: np.ndarray, own: int) -> int:
    """The number of the other node of a part of two, or the node's `own`."""
    return next((int(k) for k in np.flatnonzero(row) if k != own), own)


def _labels(scene: Scene) -> np.ndarray:
    """(all nodes,), the number of the part of each."""
    structure = scene.structure
    joins = [*rigid_pairs(scene), *(edge for _, edges in structure.rod_masses for edge in edges)]
    if (slides := slides_of(scene)) is not None:
        joins += [(node, end) for node, pair in zip(slides.nodes, slides.along) for end in pair]
    joins += [(body.points[0], node) for body in structure.bodies for node in body.points]
    i, j = np.array(joins, int).reshape(-1, 2).T
    size = len(structure.nodes)
    return connected_components(sp.coo_array((np.ones(len(i)), (i, j)), shape=(size, size)), directed=False)[1]


def of_parts(constraints: Constraints, alike: Alike) -> Constraints:
    """The constraints of alike parts, each array with a row for each part."""
    count, struts, contacts = len(alike.nodes), alike.struts, alike.contacts
    inside = alike.nodes[:, :, None], alike.nodes[:, None]
    pick = lambda x, rows: x[rows] if jnp.ndim(x) else jnp.broadcast_to(x, (count,))  # noqa: E731
    keeps = constraints.apart is not None and struts.shape[1] > 0
    contact, weights = constraints.contact, constraints.weights
    if not contacts.shape[1]:
        contact = None
    elif contact is not None:
        mu = None if contact.mu is None else pick(contact.mu, contacts)
        timing = jax.tree.map(lambda x: x[contacts], contact.timing)
        least = pick(contact.least, contacts)
        contact = contact._replace(closing=contact.closing[contacts], mu=mu, least=least, timing=timing)
    if weights is not None:
        weights = jnp.moveaxis(weights[contacts[:, :, None], :, alike.nodes[:, None]], 2, 3)
    return Constraints(
        constraints.mobility[inside],
        constraints.start[alike.nodes],
        constraints.ends[struts[:, :, None], alike.nodes[:, None]],
        constraints.apart[struts] if keeps else None,
        constraints.goal[struts] if keeps else None,
        None,
        contact,
        constraints.frame[contacts],
        weights,
        pick(constraints.speed, contacts),
    )


def put_together(rest: AnyArray, rows: list[np.ndarray], values: list[AnyArray]) -> AnyArray:
    """`rest`, with rows in place of its own: those with the numbers `rows`, (parts, rows), of each kind of parts."""
    place = np.arange(len(rest))
    place[np.concatenate([row.ravel() for row in rows])] = len(rest) + np.arange(sum(row.size for row in rows))
    flat = jax.tree.map(lambda x: x.reshape(-1, *rest.shape[1:]), values)
    return jnp.concatenate([rest, *flat])[place]

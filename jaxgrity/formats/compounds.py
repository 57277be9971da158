"""Rods that share nodes as one rigid body, and rigid bodies as rods: what jaxgrity's struts, joined by pins, need."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import Edges
from jaxgrity.statics.form_finding import equilibrium_matrix

INDEPENDENT = 1e-6
"""A member resists another motion if others leave over this share of its column of A, at unit length."""
MOST_NODES_OF_A_BODY = 60
"""Most nodes of one rigid body: to brace it, each pair of them is tried."""


def bodies(edges: Edges, nodes: int) -> list[np.ndarray]:
    """The nodes of each connected set of `edges`, in ascending order; nodes without an edge are not among them."""
    if not edges:
        return []
    i, j = np.asarray(edges, int).T
    _, label = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(nodes, nodes)), directed=False)
    return [np.flatnonzero(label == k) for k in np.unique(label[np.r_[i, j]])]


def bracing(nodes: np.ndarray, edges: Edges) -> Edges:
    """The struts that are missing for each connected set of `edges` to keep its shape, as few as will do.

    Struts are added while they raise the rank of the equilibrium matrix, up to 3n - 6 for n nodes. Raises `InputError`
    where no struts do it: the nodes of a set of three or more lie on a line, or of four or more in a plane.
    """
    added: list[tuple[int, int]] = []
    for body in bodies(edges, len(nodes)):
        if len(body) < 3:
            continue
        if len(body) > MOST_NODES_OF_A_BODY:
            raise InputError(f"{len(body)} nodes belong to one rigid body; expected at most {MOST_NODES_OF_A_BODY}")
        place = {int(node): k for k, node in enumerate(body)}
        own = tuple((place[i], place[j]) for i, j in edges if i in place)
        extra, rank = _independent(nodes[body], own)
        if rank < 3 * len(body) - 6:
            raise InputError(
                f"rods that share nodes are one rigid body, but its {len(body)} nodes lie in a plane or on a line: "
                "struts with pins between these nodes cannot hold it; expected nodes that span space"
            )
        added += [(int(body[i]), int(body[j])) for i, j in extra]
    return tuple(added)


def is_rigid(nodes: np.ndarray, edges: Edges) -> bool:
    """Whether these struts alone keep all distances of these nodes, to first order."""
    return len(nodes) == 2 or _rank(nodes, edges) == 3 * len(nodes) - 6


def _rank(nodes: np.ndarray, edges: Edges) -> int:
    return len(_basis(_directions(nodes, edges)))


def _directions(nodes: np.ndarray, edges: Edges) -> np.ndarray:
    """(members, 3 nodes): rows of the rigidity matrix, of unit length."""
    rows = equilibrium_matrix(nodes, edges).toarray().T
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def _basis(rows: np.ndarray) -> list[np.ndarray]:
    found: list[np.ndarray] = []
    for row in rows:
        _extend(found, row)
    return found


def _extend(basis: list[np.ndarray], row: np.ndarray) -> bool:
    """Whether a row is independent of an orthonormal basis, which it then joins."""
    if basis:
        known = np.array(basis)
        for _ in range(2):
            row = row - known.T @ (known @ row)
    size = np.linalg.norm(row)
    if size > INDEPENDENT:
        basis.append(row / size)
    return bool(size > INDEPENDENT)


def _independent(nodes: np.ndarray, edges: Edges) -> tuple[Edges, int]:
    """Which further pairs of nodes resist a motion that `edges` allow, and the rank with them."""
    basis = _basis(_directions(nodes, edges))
    joined = {frozenset(edge) for edge in edges}
    pairs = [(i, j) for i in range(len(nodes)) for j in range(i) if frozenset((i, j)) not in joined]
    extra = [pair for pair, row in zip(pairs, _directions(nodes, tuple(pairs))) if _extend(basis, row)] if pairs else []
    return tuple(extra), len(basis)

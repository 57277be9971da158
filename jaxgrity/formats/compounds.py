"""Which nodes belong to one rigid body, whether struts hold it, and the points that say where it is."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jaxgrity.core.types import Edges
from jaxgrity.statics.form_finding import equilibrium_matrix

INDEPENDENT = 1e-6
"""A member resists another motion if others leave over this share of its column of A, at unit length."""
FLAT_WITHIN = 0.05
"""Share of a body's extent below which its nodes count as flat, so that further ones say where it is."""


def bodies(edges: Edges, nodes: int) -> list[np.ndarray]:
    """The nodes of each connected set of `edges`, in ascending order; nodes without an edge are not among them."""
    if not edges:
        return []
    i, j = np.asarray(edges, int).T
    _, label = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(nodes, nodes)), directed=False)
    return [np.flatnonzero(label == k) for k in np.unique(label[np.r_[i, j]])]


def spanning_points(x: np.ndarray) -> np.ndarray:
    """Further points, (k, 3), m, with which these of one body do not lie in a plane, or on a line."""
    middle = x.mean(0)
    _, size, axes = np.linalg.svd(x - middle, full_matrices=True)
    size = np.r_[size, np.zeros(3)][:3]
    return middle + size[0] / np.sqrt(len(x)) * axes[size < FLAT_WITHIN * size[0]]


def is_rigid(nodes: np.ndarray, edges: Edges) -> bool:
    """Whether these struts alone keep all distances of these nodes, to first order."""
    return len(nodes) == 2 or len(_basis(_directions(nodes, edges))) == 3 * len(nodes) - 6


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

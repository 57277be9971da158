"""Struts that do not stretch: a constraint on the distance of their ends."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from jaxgrity.core.primitives import edge_vectors, length
from jaxgrity.core.tracing import evaluated
from jaxgrity.core.types import Edges
from jaxgrity.model.actuation import Actuation, rest_length, rest_lengths_along
from jaxgrity.model.laws import Constraint, SceneParts, moved_members, rows_on_nodes, same_roles, unchanged
from jaxgrity.model.structure import Members, edge_lengths

LARGEST_GAP = 1e-6
"""Largest violation of a constraint at the start, m for a body of one metre."""


def directions_between(q: np.ndarray, edges: Edges) -> sp.csr_array:
    """(edges, 3 nodes): the unit vector from the second node of each edge to the first, and its opposite."""
    units = np.array([(q[i] - q[j]) / np.linalg.norm(q[i] - q[j]) for i, j in edges]).reshape(-1, 3)
    return rows_on_nodes(np.stack([units, -units], axis=1), np.array(edges, int).reshape(-1, 2), q.size)


class RigidStruts(Constraint):
    """|x_i - x_j| = L(t), a constraint that changes with time where a gait actuates the strut."""

    struts: Members
    gait: Actuation | None
    name: ClassVar[str] = "rigid struts"

    @classmethod
    def of(cls, scene: SceneParts) -> "RigidStruts | None":
        struts = scene.structure.struts
        return cls(struts, scene.gait) if struts is not None and struts.rigid else None

    def keeps(self, symmetry):
        moved = moved_members(self.struts, 0, symmetry)
        return unchanged(self.struts.rest_length, moved) and same_roles(self.struts, moved)

    def directions(self, q, size):
        return directions_between(q, self.struts.edges)

    def gaps(self, q, t):
        if isinstance(q, np.ndarray):
            return np.abs(edge_lengths(q, self.struts.edges) - self._known_lengths(t))
        return jnp.abs(length(edge_vectors(q, self.struts.edges)) - rest_length(self.struts, self.gait, t, 0))

    def _known_lengths(self, t):
        # without it, JAX mixes up the precisions of NumPy's numbers where something else had x64 on for a while
        with jax.enable_x64(True), evaluated():
            return np.asarray(rest_lengths_along(self.struts, self.gait, np.full(1, float(t)), 0))[0]

    def complaint(self, q, t, part):
        found, wanted = edge_lengths(q, self.struts.edges)[part], self._known_lengths(t)[part]
        return (
            f"strut {part} starts {found:.6g} m long; expected {wanted:.6g} m, its rest length at t = {t:g}, "
            "since it is rigid"
        )

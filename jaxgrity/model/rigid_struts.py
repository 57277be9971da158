"""Struts that do not stretch: a constraint on the distance of their ends."""

from typing import ClassVar

import jax
import numpy as np

from jaxgrity.model.actuation import Actuation, rest_length
from jaxgrity.model.laws import Constraint, SceneParts, moved_members, same_roles, unchanged
from jaxgrity.model.structure import Members, edge_lengths

LARGEST_GAP = 1e-6
"""m, by which a start may violate a constraint, of a body of one metre"""


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
        rows = np.zeros((len(self.struts.edges), *q.shape))
        for row, (i, j) in zip(rows, self.struts.edges):
            row[i] = (q[i] - q[j]) / np.linalg.norm(q[i] - q[j])
            row[j] = -row[i]
        return rows

    def violation(self, q, size):
        # without it, JAX mixes up the precisions of NumPy's numbers where something else had x64 on for a while
        with jax.enable_x64(True):
            wanted = np.asarray(rest_length(self.struts, self.gait, 0.0, 0))
        lengths = edge_lengths(q, self.struts.edges)
        strut = int(np.argmax(np.abs(lengths - wanted)))
        if abs(lengths[strut] - wanted[strut]) <= LARGEST_GAP * size:
            return ""
        return (
            f"strut {strut} starts {lengths[strut]:.6g} m long; expected {wanted[strut]:.6g} m, its rest length at "
            "t = 0, since it is rigid"
        )

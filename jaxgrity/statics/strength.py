"""What members bear: yield in tension and compression, Euler's load of struts, and the margins to both."""

from typing import NamedTuple

import numpy as np

from jaxgrity.core.types import NodeVectors, PerMember
from jaxgrity.model.structure import Structure, edge_lengths


class Strength(NamedTuple):
    """The largest forces of all members, struts first; infinite where nothing is known."""

    tension: PerMember
    """N"""
    compression: PerMember
    """N, of cables too, which go slack before"""
    buckles: np.ndarray
    """(members,), whether it buckles before it yields"""

    def margins(self, forces: PerMember) -> PerMember:
        """The largest force over the force of each member, N; infinite without either."""
        with np.errstate(divide="ignore", invalid="ignore"):
            above, below = self.tension / forces, self.compression / -forces
        return np.where(forces > 0, above, np.where(forces < 0, below, np.inf))


def strength_of(structure: Structure, q: NodeVectors) -> Strength:
    """Yield forces, and for struts pi^2 EI/l^2 with their lengths at `q`, m."""
    kinds = [members for members in (structure.struts, structure.cables) if members is not None]
    none = [np.full(len(members.edges), np.inf) for members in kinds]
    yields = np.concatenate([x if m.yield_force is None else np.asarray(m.yield_force) for m, x in zip(kinds, none)])
    euler, struts = np.full(len(yields), np.inf), structure.struts
    if struts is not None and struts.bending_stiffness is not None:
        euler[: len(struts.edges)] = (
            np.pi**2 * np.asarray(struts.bending_stiffness) / edge_lengths(q, struts.edges) ** 2
        )
    return Strength(yields, np.minimum(yields, euler), euler < yields)

"""What members bear: yield in tension and compression, Euler's load of struts, and the margins to both."""

from typing import NamedTuple

import numpy as np

from jaxgrity.core.display import in_digits
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


def force_words(structure: Structure, forces: PerMember) -> str:
    """The least and the largest force of struts and of cables, N, in words."""
    first = structure.first_cable
    kinds = {"struts": forces[:first], "cables": forces[first:]}
    words = [f"{kind} {in_digits(f.min(), 4)} to {in_digits(f.max(), 4)} N" for kind, f in kinds.items() if f.size]
    return f"{', '.join(words)} (tension positive)"


def strength_of(structure: Structure, q: NodeVectors) -> Strength:
    """Yield forces, and for struts pi^2 EI/l^2 with their lengths at `q`, m."""
    known = [(len(m.edges), np.inf if m.yield_force is None else np.asarray(m.yield_force)) for m in structure.members]
    yields = np.concatenate([np.broadcast_to(force, count) for count, force in known])
    euler, struts = np.full(len(yields), np.inf), structure.struts
    if struts is not None and struts.bending_stiffness is not None:
        euler[: len(struts.edges)] = (
            np.pi**2 * np.asarray(struts.bending_stiffness) / edge_lengths(q, struts.edges) ** 2
        )
    return Strength(yields, np.minimum(yields, euler), euler < yields)

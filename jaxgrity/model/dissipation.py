"""The terms of R(v; q, t), Rayleigh's dissipation function, of nodes and members.

Every dissipative force is `-jax.grad` of the sum of R's terms with respect to v.
"""

from typing import ClassVar

import equinox as eqx

from jaxgrity.core.primitives import dot, half_squares, inner, length, norm_squared, over
from jaxgrity.core.types import AnyPerNode, MemberVectors, PerMember, Scalar
from jaxgrity.model.actuation import Actuation, rest_length
from jaxgrity.model.clusters import added_up, in_series, to_segments
from jaxgrity.model.laws import (
    DissipationTerm,
    Motion,
    SceneParts,
    member_names,
    moved_members,
    node_names,
    unchanged,
    unchanged_per_node,
)
from jaxgrity.model.structure import Members


class NodeDamping(DissipationTerm):
    """R = sum c/2 |v|^2."""

    damping: AnyPerNode
    name: ClassVar[str] = "node damping"
    cause: ClassVar[str] = "nodes"

    @classmethod
    def of(cls, scene: SceneParts) -> "NodeDamping | None":
        return None if scene.node_damping is None else cls(scene.node_damping)

    def dissipation(self, motion: Motion) -> Scalar:
        return inner(self.damping, norm_squared(motion.v)) / 2

    def keeps(self, symmetry):
        return unchanged_per_node(self.damping, symmetry)

    def parts(self, scene):
        return node_names("damping of", scene)


class StrutDamping(DissipationTerm):
    """R = sum c/2 l'^2, l' = d·d'/|d|."""

    struts: Members
    name: ClassVar[str] = "strut damping"
    cause: ClassVar[str] = "struts"

    @classmethod
    def of(cls, scene: SceneParts) -> "StrutDamping | None":
        struts = scene.structure.struts
        return None if struts is None or struts.damping is None else cls(struts)

    def dissipation(self, motion: Motion) -> Scalar:
        rate, _ = _rate_of_length(motion, "struts")
        return half_squares(self.struts.damping, rate)

    def keeps(self, symmetry):
        return unchanged(self.struts.damping, moved_members(self.struts, 0, symmetry))

    def parts(self, scene):
        return tuple(f"damping of {name}" for name in member_names("strut", self.struts))

    def scaled(self, factors):
        return eqx.tree_at(lambda s: s.struts.damping, self, self.struts.damping * factors)


class CableDamping(DissipationTerm):
    """R = sum c/2 l'^2 over the cables that are longer than their rest length L(t); shortening is resisted too.

    Of a cable through several nodes, l and l' are the sums over its segments.
    """

    cables: Members
    gait: Actuation | None
    first: int = eqx.field(static=True)
    """the number that gaits give to the first cable"""
    name: ClassVar[str] = "cable damping"
    cause: ClassVar[str] = "cables"

    @classmethod
    def of(cls, scene: SceneParts) -> "CableDamping | None":
        cables = scene.structure.cables
        return (
            None if cables is None or cables.damping is None else cls(cables, scene.gait, scene.structure.first_cable)
        )

    def dissipation(self, motion: Motion) -> Scalar:
        damping, taut_above = self.cables.damping, rest_length(self.cables, self.gait, motion.at.t, self.first)
        assert damping is not None, "`of` makes no law for cables without dampers"
        rate, lengths = _rate_of_length(motion, "cables")
        clusters = self.cables.clusters
        if not clusters:
            return half_squares(damping * (lengths > taut_above).astype(rate.dtype), rate)
        taut = added_up(lengths - taut_above, clusters) > 0
        return half_squares(in_series(damping, clusters) * taut.astype(rate.dtype), added_up(rate, clusters))

    def keeps(self, symmetry):
        return unchanged(self.cables.damping, moved_members(self.cables, self.first, symmetry))

    def parts(self, scene):
        return tuple(f"damping of {name}" for name in member_names("cable", self.cables))

    def scaled(self, factors):
        each = to_segments(factors, self.cables.clusters, len(self.cables.edges))
        return eqx.tree_at(lambda s: s.cables.damping, self, self.cables.damping * each)


def _rate_of_length(motion: Motion, kind: str) -> tuple[PerMember, PerMember]:
    """l' = d·d'/|d|, m/s, and l = |d|, m."""
    d: MemberVectors = motion.at.vector(kind)
    lengths = length(d)
    return over(dot(d, motion.rate(kind)), lengths), lengths

"""The terms of U(q, t) that act along members and by weight. Every conservative force is `-jax.grad` of their sum."""

from typing import ClassVar

import equinox as eqx

from jaxgrity.core.primitives import along, component, dot, half_squares, inner, length, ones, positive_part
from jaxgrity.core.types import AnyPerNode, Scalar, Vector
from jaxgrity.model.actuation import Actuation, rest_length
from jaxgrity.model.clusters import added_up, in_series, to_segments
from jaxgrity.model.laws import (
    Configuration,
    EnergyTerm,
    SceneParts,
    Symmetry,
    member_names,
    moved_members,
    same_roles,
    unchanged,
)
from jaxgrity.model.pulleys import path_lengths
from jaxgrity.model.structure import Members

UP = (0.0, 0.0, 1.0)
"""Unit vector against gravity."""


class StrutSprings(EnergyTerm):
    """U = sum K/2 (l - L(t))^2, l = |d|: springs that push and pull."""

    struts: Members
    gait: Actuation | None
    name: ClassVar[str] = "strut springs"

    @classmethod
    def of(cls, scene: SceneParts) -> "StrutSprings | None":
        struts = scene.structure.struts
        return None if struts is None or struts.rigid else cls(struts, scene.gait)

    def energy(self, at: Configuration) -> Scalar:
        stretch = length(at.vector("struts")) - rest_length(self.struts, self.gait, at.t, 0)
        return half_squares(self.struts.stiffness, stretch)

    def keeps(self, symmetry):
        return _springs_alike(self.struts, 0, symmetry)

    def parts(self, scene):
        return member_names("strut", self.struts)

    def scaled(self, factors):
        return eqx.tree_at(lambda s: s.struts.stiffness, self, self.struts.stiffness * factors)


class CableSprings(EnergyTerm):
    """U = sum K/2 max(0, l - L(t))^2, l = |d|, or their sum in a cluster: a slack cable stores nothing."""

    cables: Members
    gait: Actuation | None
    first: int = eqx.field(static=True)
    """the number that gaits give to the first cable"""
    name: ClassVar[str] = "cables (tension only)"

    @classmethod
    def of(cls, scene: SceneParts) -> "CableSprings | None":
        cables = scene.structure.cables
        return None if cables is None else cls(cables, scene.gait, scene.structure.first_cable)

    def energy(self, at: Configuration) -> Scalar:
        cables = self.cables
        longer = path_lengths(cables, at.vector("cables"), at.q) - rest_length(cables, self.gait, at.t, self.first)
        stretch = positive_part(added_up(longer, cables.clusters))
        assert cables.stiffness is not None, "cables are springs"
        return half_squares(in_series(cables.stiffness, cables.clusters), stretch)

    def keeps(self, symmetry):
        return _springs_alike(self.cables, self.first, symmetry)

    def parts(self, scene):
        return member_names("cable", self.cables)

    def scaled(self, factors):
        each = to_segments(factors, self.cables.clusters, len(self.cables.edges))
        return eqx.tree_at(lambda s: s.cables.stiffness, self, self.cables.stiffness * each)


class Gravity(EnergyTerm):
    """U = sum m g z, members' mass half at each end.

    z is along `up` where the ground leans more than its file says.
    """

    g: Scalar
    node_mass: AnyPerNode
    up: Vector | None
    name: ClassVar[str] = "gravity"

    @classmethod
    def of(cls, scene: SceneParts) -> "Gravity | None":
        return None if scene.gravity is None else cls(scene.gravity, scene.structure.lumped_mass, scene.up)

    def energy(self, at: Configuration) -> Scalar:
        height = component(at.q, UP) if self.up is None else dot(at.q, along(ones(self.node_mass), self.up))
        return self.g * inner(self.node_mass, height)

    def keeps(self, symmetry):
        return symmetry.leaves(UP if self.up is None else self.up)

    def parts(self, scene):
        return ("gravity",)


def _springs_alike(members: Members, first: int, symmetry: Symmetry) -> bool:
    """Whether a symmetry maps springs on springs of the same stiffness and rest length, stuck ones on stuck ones."""
    moved = moved_members(members, first, symmetry)
    alike = all(unchanged(x, moved) for x in (members.stiffness, members.rest_length) if x is not None)
    same = not members.pulleys or symmetry.is_identity  # of sides no rule knows
    return alike and same and same_roles(members, moved)

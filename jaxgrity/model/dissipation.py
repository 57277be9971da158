"""The terms of R(v; q, t), Rayleigh's dissipation function, of nodes and members, and friction on pulleys.

Every dissipative force is `-jax.grad` of the sum of R's terms with respect to v.
"""

from functools import partial
from itertools import pairwise
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxgrity.core.primitives import dot, half_squares, inner, norm_squared
from jaxgrity.core.types import AnyPerNode, Scalar
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
from jaxgrity.model.pulleys import on_drums, path_lengths
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
        return half_squares(self.struts.damping, motion.rate_of_length("struts"))

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
        rate, lengths = motion.rate_of_length("cables"), motion.at.length("cables")
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


class CapstanFriction(DissipationTerm):
    """R = sum (T_after - T_before) s' over pulleys with friction; dR/dv is taken at fixed tensions.

    The cable slides over the drum at the speed s'. That is half of the rate by which the side after it grows and the
    side before it shrinks, less the drum's own. Euler and Eytelwein's law is smoothed by the slip speed eps,
    T_after/T_before = exp(mu angle s'/sqrt(s'^2 + eps^2)). The mean of the tensions at both ends is that of U.
    """

    cables: Members
    name: ClassVar[str] = "friction on pulleys"
    cause: ClassVar[str] = "pulleys"

    @classmethod
    def of(cls, scene: SceneParts) -> "CapstanFriction | None":
        cables = scene.structure.cables
        return cls(cables) if cables is not None and any(p.mu is not None for p in cables.pulleys) else None

    def dissipation(self, motion: Motion) -> Scalar:
        at, cables, lost = motion.at, self.cables, jnp.zeros((), motion.v.dtype)
        rough = {
            p.between: (p.mu, p.slip_speed) for p in cables.pulleys if p.mu is not None and p.slip_speed is not None
        }
        d = at.vector("cables")
        along = jax.grad(lambda d: path_lengths(cables, d, at.q).sum())(d)
        mean = dot(along, jax.grad(at.scene.potential_energy, argnums=2)(at.q, at.t, at.known)["cables"])
        (angles, _), (_, speeds) = jax.jvp(partial(on_drums, cables), (d, at.q), (motion.rate("cables"), motion.v))
        for cluster in cables.clusters:
            tensions, slides = [jnp.ones_like(lost)], [pair for pair in pairwise(cluster) if pair in speeds]
            for pair in slides:
                mu, slip_speed = rough[pair]
                share = speeds[pair] / jnp.sqrt(speeds[pair] ** 2 + slip_speed**2)
                tensions.append(tensions[-1] * jnp.exp(mu * angles[pair] * share))
            unit = 2 * mean[cluster[0]] / (tensions[0] + tensions[-1])
            for pair, (before, after) in zip(slides, pairwise(tensions)):
                lost = lost + _at_fixed_force(unit * (after - before), speeds[pair])
        return lost

    def keeps(self, symmetry):
        return symmetry.is_identity  # of sides no rule knows


@jax.custom_jvp
def _at_fixed_force(force: Scalar, speed: Scalar) -> Scalar:
    """Their product. Its derivative is that at a fixed force; derivatives of that have the force's."""
    return force * speed


@_at_fixed_force.defjvp
def _at_fixed_force_jvp(primals, tangents):
    (force, speed), (_, change) = primals, tangents
    return _at_fixed_force(force, speed), force * change


LOSSES = NodeDamping, StrutDamping, CableDamping, CapstanFriction
"""The terms of R that follow from a scene's structure."""

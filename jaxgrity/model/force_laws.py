"""Cables that are no linear springs: tables of force and stretch, motors that yield, dead bands, dampers beside cables.

Tables and motors change the stiffness beyond some stretch. A force that is linear between the entries of a table is a
sum of springs that begin to act one after the other. Dampers of the cables themselves do not change.
"""

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_each
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import half_squares, inverse, positive_part
from jaxgrity.core.tracing import evaluated, traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, AnyRows, Scalar, as_float, as_float_or_none
from jaxgrity.model.clusters import added_up, cables_of, in_series
from jaxgrity.model.laws import Configuration, DissipationTerm, EnergyTerm, Motion, member_names
from jaxgrity.model.pulleys import built_lengths
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.model.structure import Members, per_member


class ForceTable(EnergyTerm):
    """A measured force: U = sum a_j/2 max(0, l - L(t) - s_j)^2, where a_j is the change of the table's slope at s_j.

    The first slope is the cables' stiffness. If a cable's stiffness changes, a_j changes by the same factor, so a
    broken cable has no force. Made by `force_table`.
    """

    stretch: AnyArray = eqx.field(converter=as_float)
    """(entries,), stretch s_j, m"""
    force: AnyArray = eqx.field(converter=as_float)
    """(entries,), force, N"""
    factors: AnyRows | None = eqx.field(converter=as_float_or_none, default=None)
    """factor of each cable's force, for reports; None: 1"""
    name: ClassVar[str] = "table of cables' forces"

    def __check_init__(self):
        if isinstance(self.stretch, np.ndarray) and isinstance(self.force, np.ndarray):
            first_slope(self.stretch, self.force)
        check_each("force_table.factors", self.factors, least=0.0)

    def energy(self, at: Configuration) -> Scalar:
        cables = at.scene.structure.cables
        longer = at.stretch("cables")
        cords = added_up(jnp.ones_like(cables.stiffness), cables.clusters)  # one after the other
        stiffness = in_series(cables.stiffness, cables.clusters)
        factors = 1 if self.factors is None else self.factors
        slopes = jnp.diff(self.force) / jnp.diff(self.stretch)
        shares = jnp.diff(slopes) / slopes[0]
        parts = [
            half_squares(factors * shares[j] * stiffness, positive_part(longer - cords * self.stretch[j + 1]))
            for j in range(len(shares))
        ]
        return sum(parts, jnp.zeros((), longer.dtype))  # of a straight line there are none

    def parts(self, scene):
        return member_names("table of cable", scene.structure.cables)

    def scaled(self, factors):
        return dataclasses.replace(self, factors=factors)


class ForceLimit(EnergyTerm):
    """A largest force F of each cable: U = -sum K/2 max(0, l - L(t) - F/K)^2. Made by `force_limit`."""

    largest: AnyRows = eqx.field(converter=as_float)
    """largest force F of each cable, N"""
    factors: AnyRows | None = eqx.field(converter=as_float_or_none, default=None)
    """factor of each cable's force, for reports; None: 1"""
    name: ClassVar[str] = "largest force of cables"

    def __check_init__(self):
        check_each("largest_force", self.largest, above=0.0, unit="N")
        check_each("force_limit.factors", self.factors, least=0.0)

    def energy(self, at: Configuration) -> Scalar:
        cables = at.scene.structure.cables
        stiffness = in_series(cables.stiffness, cables.clusters)
        factors = 1 if self.factors is None else self.factors
        return -half_squares(
            factors * stiffness, positive_part(at.stretch("cables") - self.largest * inverse(stiffness))
        )

    def parts(self, scene):
        return member_names("largest force of cable", scene.structure.cables)

    def scaled(self, factors):
        return dataclasses.replace(self, factors=factors)


class DeadBand(EnergyTerm):
    """Cables that push when they are shorter than L(t) by more than w: U = sum K/2 max(0, L(t) - w - l)^2.

    Within the dead band, of width w, they are slack. A width of L never pushes. Made by `dead_band`.
    """

    width: AnyRows = eqx.field(converter=as_float)
    """width w of the dead band of each cable, m"""
    factors: AnyRows | None = eqx.field(converter=as_float_or_none, default=None)
    """factor of each cable's push, for reports; None: 1"""
    name: ClassVar[str] = "push of cables beyond a dead band"

    def __check_init__(self):
        check_each("dead_band", self.width, least=0.0, unit="m")
        check_each("dead_band.factors", self.factors, least=0.0)

    def energy(self, at: Configuration) -> Scalar:
        cables = at.scene.structure.cables
        stiffness = in_series(cables.stiffness, cables.clusters)
        factors = 1 if self.factors is None else self.factors
        return half_squares(factors * stiffness, positive_part(-at.stretch("cables") - self.width))

    def parts(self, scene):
        return member_names("push of cable", scene.structure.cables)

    def scaled(self, factors):
        return dataclasses.replace(self, factors=factors)


class CableDampers(DissipationTerm):
    """A damper beside each cable, which also acts while it is slack: R = sum c/2 l'^2. Made by `cable_dampers`."""

    damping: AnyRows = eqx.field(converter=as_float)
    """damping c of the damper beside each cable, N s/m"""
    name: ClassVar[str] = "dampers beside cables"
    cause: ClassVar[str] = "dampers"

    def __check_init__(self):
        check_each("damper", self.damping, least=0.0, unit="N s/m")

    def dissipation(self, motion: Motion) -> Scalar:
        clusters = motion.at.scene.structure.cables.clusters
        return half_squares(self.damping, added_up(motion.rate_of_length("cables"), clusters))

    def parts(self, scene):
        return member_names("damper beside cable", scene.structure.cables)

    def scaled(self, factors):
        return dataclasses.replace(self, damping=self.damping * factors)


@typed
def force_table(cables: Members, stretch: Sequence[float], force: Sequence[float]) -> ForceTable:
    """A measured force for all cables, linear between the entries of a table, with the last slope beyond it.

    If a cable runs through several nodes, each segment follows the table, so all have the same force.

    Args:
        cables: the cables; their stiffness must be the table's first slope.
        stretch: stretch l - L, m, ascending from 0.
        force: force, N, starting at 0 and not falling.

    Returns:
        The term, for `with_terms`.

    Raises:
        InputError: a bad table, or a stiffness of the cables that is not its first slope.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> table = jaxgrity.force_table(scene.structure.cables, [0.0, 0.1, 0.2], [0.0, 60.0, 180.0])  # from 600 N/m
        >>> stiffening = jaxgrity.with_terms(scene, table)
    """
    first = first_slope(stretch, force)
    stiffness = np.asarray(cables.stiffness, float)
    if not np.allclose(stiffness, first, rtol=1e-9, atol=0):
        given = sorted(set(stiffness.tolist()))
        raise InputError(f"the cables' stiffness is {given}; expected {first:g} N/m, the table's first slope")
    return ForceTable(np.asarray(stretch, float), np.asarray(force, float))


def first_slope(stretch: Sequence[float] | AnyArray, force: Sequence[float] | AnyArray) -> float:
    """First slope of a table of forces, N/m. Raises `InputError` for a bad table."""
    s, f = np.asarray(stretch, float), np.asarray(force, float)
    check_each("stretch", s)
    check_each("force", f)
    shown = f"stretch = {s.tolist()}, force = {f.tolist()}"
    if s.shape != f.shape or s.ndim != 1 or len(s) < 2 or s[0] != 0 or f[0] != 0:
        raise InputError(f"{shown}: expected as many numbers in each, two at least, and both from 0 on")
    if np.any(np.diff(s) <= 0) or np.any(np.diff(f) < 0) or f[1] == 0:
        raise InputError(f"{shown}: expected an ascending stretch, and a force that rises at first and never falls")
    return float(f[1] / s[1])


def check_linear(scene: Scene, farther: float, what: str) -> None:
    """Raises `InputError` if a law bends the force of a cable stretched `farther` times as far as as built.

    That is a law, one of the user's too, whose energy depends on the cables' rest lengths there, such as a table or
    limit within reach. Gaits do not count. The numbers of a scene that is traced are not looked at.
    """
    cables, terms = scene.structure.cables, [term for term in scene.terms if isinstance(term, EnergyTerm)]
    if cables is None or not terms or traced(scene):
        return
    nodes, still = jnp.asarray(scene.structure.nodes, float), with_gait(scene, None)

    def added(rest: AnyArray, term: EnergyTerm) -> Scalar:
        there = eqx.tree_at(lambda s: s.structure.cables.rest_length, still, rest)
        return term.energy(there.configuration(nodes, 0.0))

    with evaluated():
        built = built_lengths(cables, scene.structure.nodes)
        tight = jnp.asarray(built - farther * (built - np.asarray(cables.rest_length)))
        for term in terms:
            if bool(jnp.any(jax.grad(added)(tight, term) != 0)):
                raise InputError(
                    f"{what}: stretched {farther:g} times as far as built, cables do not pull in proportion, because "
                    f"of {term.name!r}; expected less, or linear cables"
                )


@typed
def force_limit(cables: Members, largest: float | Sequence[float]) -> ForceLimit:
    """Cables with motors that yield: at the largest force they pay out, and wind in again at the same force.

    This models a motor with limited torque, without inertia and friction. The length determines how far it has paid
    out, L = l - F/K, so the force has a potential. The energy that it stores counts as potential energy, since it is
    given back. The rate is not limited. Dampers pull in addition, also at the limit.

    Args:
        cables: the cables with such motors.
        largest: largest force F, N; one number for all cables, or one per cable (segments of one cable count as one).

    Returns:
        The term, for `with_terms`.

    Raises:
        InputError: a force that is not positive, or a wrong number of forces.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> yielding = jaxgrity.with_terms(scene, jaxgrity.force_limit(scene.structure.cables, 150.0))
    """
    return ForceLimit(per_cable(cables, largest, "largest_force"))


@typed
def dead_band(cables: Members, width: float | Sequence[float]) -> DeadBand:
    """Cables that push again, with their stiffness, when they are shorter than their rest length by a width.

    Args:
        cables: the cables that push.
        width: width of the dead band, m; one number for all cables, or one per cable (segments of one cable count as
            one). With 0 a cable is a spring that pushes and pulls, with its rest length it never pushes.

    Returns:
        The term, for `with_terms`.

    Raises:
        InputError: a negative width, or a wrong number of widths.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> pushing = jaxgrity.with_terms(scene, jaxgrity.model.dead_band(scene.structure.cables, 0.05))
    """
    return DeadBand(per_cable(cables, width, "dead_band"))


@typed
def cable_dampers(cables: Members, damping: float | Sequence[float]) -> CableDampers:
    """A damper beside each cable, which resists changes of its length also while it is slack.

    Args:
        cables: the cables with dampers.
        damping: damping c, N s/m; one number for all cables, or one per cable (segments of one cable count as one).

    Returns:
        The term, for `with_terms`.

    Raises:
        InputError: a negative damping, or a wrong number of dampings.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> damped = jaxgrity.with_terms(scene, jaxgrity.model.cable_dampers(scene.structure.cables, 2.0))
    """
    return CableDampers(per_cable(cables, damping, "damper"))


def per_cable(cables: Members, values: float | Sequence[float], where: str) -> np.ndarray:
    """`per_member` for cables, of which those that run through several segments count once."""
    return per_member(values, len(cables_of(cables.clusters, len(cables.edges))), where)

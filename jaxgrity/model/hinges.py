"""Springs and dampers that act on the angle between two parts of a robot, such as those of a hinge."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxgrity.core.arguments import check_each
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import component, dot, edge_vectors, half_squares, length, over
from jaxgrity.core.types import AnyRows, NodeVectors, PerMember, Scalar, as_float
from jaxgrity.model.laws import Configuration, DissipationTerm, EnergyTerm, Motion

Hinges = tuple[tuple[int, int, int, int], ...]
"""Four nodes of each hinge: one of the first part, two on the axis, and one of the second part."""
OFF_AXIS = 1e-6
"""Least distance of a hinge's first and last node from its axis, in lengths of the axis; nearer, there is no angle."""
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class HingeSprings(EnergyTerm):
    """U = sum K/2 (angle - rest)^2, with the angle of `hinge_angles`; the difference is taken from -pi to pi.

    Raises `InputError` for nodes that are not four different ones.
    """

    nodes: Hinges = eqx.field(static=True, converter=lambda rows: tuple(map(tuple, rows)))
    """four nodes of each hinge"""
    stiffness: AnyRows = eqx.field(converter=as_float)
    """stiffness K of each hinge, N m/rad"""
    rest_angle: AnyRows = eqx.field(converter=as_float)
    """angle of each hinge at which its spring has no torque, rad"""
    name: ClassVar[str] = "springs of hinges"

    def __check_init__(self):
        check_each("hinges.stiffness", self.stiffness, shape=(_count(self.nodes),), least=0.0, unit="N m/rad")
        check_each("hinges.rest_angle", self.rest_angle, shape=(len(self.nodes),))

    def check(self, nodes):
        _check_known(self.nodes, nodes)

    def energy(self, at: Configuration) -> Scalar:
        away = hinge_angles(at.q, self.nodes) - self.rest_angle
        return half_squares(self.stiffness, jnp.arctan2(jnp.sin(away), jnp.cos(away)))

    def parts(self, scene):
        return _names("spring of hinge", self.nodes)

    def scaled(self, factors):
        return dataclasses.replace(self, stiffness=self.stiffness * factors)


class HingeDampers(DissipationTerm):
    """R = sum c/2 (rate of the angle of `hinge_angles`)^2.

    Raises `InputError` for nodes that are not four different ones.
    """

    nodes: Hinges = eqx.field(static=True, converter=lambda rows: tuple(map(tuple, rows)))
    """four nodes of each hinge"""
    damping: AnyRows = eqx.field(converter=as_float)
    """damping c of each hinge, N m s/rad"""
    name: ClassVar[str] = "dampers of hinges"
    cause: ClassVar[str] = "hinges"

    def __check_init__(self):
        check_each("hinges.damping", self.damping, shape=(_count(self.nodes),), least=0.0, unit="N m s/rad")

    def check(self, nodes):
        _check_known(self.nodes, nodes)

    def dissipation(self, motion: Motion) -> Scalar:
        rate = jax.jvp(lambda q: hinge_angles(q, self.nodes), (motion.at.q,), (motion.v,))[1]
        return half_squares(self.damping, rate)

    def parts(self, scene):
        return _names("damper of hinge", self.nodes)

    def scaled(self, factors):
        return dataclasses.replace(self, damping=self.damping * factors)


def hinge_angles(q: NodeVectors, hinges: Hinges) -> PerMember:
    """(hinges,), rad: the angle about the axis by which the second part is turned from the first one.

    The nodes a, p, q, b of a hinge span half planes that end at the axis from p to q: one through a, one through b.
    The angle leads from the first half plane to the second one, counterclockwise about the axis, from -pi to pi.
    """
    one, start, end, other = zip(*hinges)
    axis, first, second = (edge_vectors(q, tuple(zip(ends, start))) for ends in (end, one, other))
    size = length(axis)
    (a, b, c), (u, v, w), (x, y, z) = (tuple(component(d, way) for way in AXES) for d in (axis, first, second))
    triple = a * (v * z - w * y) + b * (w * x - u * z) + c * (u * y - v * x)
    across = dot(first, second) - over(over(dot(first, axis), size) * dot(second, axis), size)
    return jnp.arctan2(over(triple, size), across)


def _count(hinges: Hinges) -> int:
    for nodes in hinges:
        if len(set(nodes)) != 4:
            raise InputError(
                f"hinges: nodes = {list(nodes)}: expected four different nodes, the middle two on the axis"
            )
    return len(hinges)


def _check_known(hinges: Hinges, nodes: int) -> None:
    for k in sorted({k for each in hinges for k in each}):
        if not 0 <= k < nodes:
            raise InputError(f"hinges name node {k}; expected 0 to {nodes - 1}")


def _names(what: str, hinges: Hinges) -> tuple[str, ...]:
    return tuple(f"{what} {k} (nodes {', '.join(map(str, nodes))})" for k, nodes in enumerate(hinges))

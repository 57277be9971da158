"""Supports that move by a prescribed function of time, such as a shaking table."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_each
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import place_rows
from jaxgrity.core.tracing import evaluated, traced
from jaxgrity.core.types import AnyArray, NodeVectors, Scalar, Vector, as_float
from jaxgrity.model.body_points import following
from jaxgrity.model.inertia import accelerations, along_fixed, momenta
from jaxgrity.model.structure import Structure


class SupportMotion(eqx.Module):
    """Common displacement of all supports, along the axes in which they are fixed.

    It begins at rest: displacement and velocity are 0 at t = 0. Methods integrate the acceleration, which JAX derives.
    Complementarity stepping moves supports to their positions at the end of each step.
    """

    @abstractmethod
    def displacement(self, t: Scalar) -> Vector:
        """(3,), displacement, m."""

    def velocity(self, t: Scalar) -> Vector:
        """(3,), velocity, m/s."""
        return jax.jvp(self.displacement, (t,), (jnp.ones_like(t),))[1]

    def bends(self) -> AnyArray:
        """(times,), times at which the motion is not smooth, s; adaptive steps end there."""
        return np.zeros(0)

    def check(self, structure: Structure) -> None:
        """Raises `InputError` if the structure has no supports, or the motion does not begin at rest."""
        if not structure.fixed:
            raise InputError("shaking moves supports, and nothing is fixed; expected a structure with supports")
        if traced(self):
            return
        with jax.enable_x64(True), evaluated():
            start, speed = jax.jvp(self.displacement, (jnp.zeros(()),), (jnp.ones(()),))
        if np.any(np.abs(start) > 1e-12) or np.any(np.abs(speed) > 1e-12):
            raise InputError(f"shaking: {start} m and {speed} m/s at t = 0; expected supports that begin at rest")


class Shaking(SupportMotion):
    """Sinusoidal shaking s(t) = r(t) A sin(2 pi f (t - start)); r rises smoothly from 0 at `start` to 1 after `ramp`.

    Raises `InputError` if it does not begin at rest.
    """

    amplitude: Vector = eqx.field(converter=as_float)
    """(3,), amplitude A, m"""
    frequency: Scalar = eqx.field(converter=as_float)
    """frequency f, Hz"""
    start: Scalar = eqx.field(converter=as_float, default=0.0)
    """start, s, not negative"""
    ramp: Scalar = eqx.field(converter=as_float, default=1.0)
    """time in which the amplitude rises, s"""

    def bends(self):
        return jnp.stack([self.start, self.start + self.ramp])

    def __check_init__(self):
        check_each("shaking.amplitude", self.amplitude, shape=(3,))
        # supports begin at rest
        check_each("shaking.start", self.start, shape=(), least=0.0, unit="s")
        check_each("shaking.frequency", self.frequency, shape=(), above=0.0, unit="Hz")
        check_each("shaking.ramp", self.ramp, shape=(), above=0.0, unit="s")

    def check(self, structure):
        super().check(structure)
        if traced(self.amplitude):
            return
        held = {axis for _, axes in structure.fixed for axis in axes}
        free = [axis for axis, size in zip("xyz", np.abs(self.amplitude)) if size > 0 and axis not in held]
        if free:
            raise InputError(f"shaking.amplitude along {free[0]}: no support is fixed so; expected 0, or one that is")

    def displacement(self, t):
        since = t - self.start
        x = jnp.clip(since / self.ramp, 0, 1)
        return self.amplitude * (x * x * (3 - 2 * x) * jnp.sin(2 * jnp.pi * self.frequency * since))


def support_acceleration(motion: SupportMotion, structure: Structure, t: Scalar) -> NodeVectors:
    """(nodes, 3), m/s^2, of the fixed coordinates; 0 of the others."""
    now = jnp.asarray(t, structure.nodes.dtype)
    return _of_supports(structure, jax.jvp(motion.velocity, (now,), (jnp.ones_like(now),))[1])


def support_velocity(motion: SupportMotion, structure: Structure, t: Scalar) -> NodeVectors:
    """(nodes, 3), m/s, of the fixed coordinates; 0 of the others."""
    return _of_supports(structure, motion.velocity(jnp.asarray(t, structure.nodes.dtype)))


def with_supports(motion: SupportMotion | None, structure: Structure, t: Scalar, v: NodeVectors) -> NodeVectors:
    """Velocities v with those of the supports at time t in the fixed coordinates, m/s."""
    if motion is None:
        return v
    return following(structure.bodies, v - along_fixed(structure, v) + support_velocity(motion, structure, t))


def moved_along(motion: SupportMotion, structure: Structure, begin: Scalar, end: Scalar, v: NodeVectors) -> NodeVectors:
    """Velocities v with the mean velocity of the supports from `begin` to `end` (s) in the fixed coordinates, m/s.

    Members with mass pass the change on to the free coordinates.
    """
    begin, end = (jnp.asarray(t, v.dtype) for t in (begin, end))
    mean = (motion.displacement(end) - motion.displacement(begin)) / (end - begin)
    change = _of_supports(structure, mean) - along_fixed(structure, v)
    return following(structure.bodies, v + change - accelerations(structure, momenta(structure, change)))


def left_by_step(
    motion: SupportMotion | None, structure: Structure, t: Scalar, h: Scalar, v: NodeVectors
) -> NodeVectors:
    """Velocities v at t (s) with those of the supports as a step of h (s) before it leaves them, m/s.

    That is their mean in the step, and half a step of their acceleration. It differs from their velocity at t in second
    order.
    """
    if motion is None:
        return v
    mean = (motion.displacement(t) - motion.displacement(t - h)) / h
    change = _of_supports(structure, mean) - along_fixed(structure, v)
    return following(structure.bodies, v + change + h / 2 * support_acceleration(motion, structure, t))


def slips(motion: SupportMotion | None, structure: Structure, t: Scalar, v: AnyArray, allowed: Scalar) -> AnyArray:
    """Fixed coordinates whose velocities (..., nodes, 3), m/s, differ from those of the supports at time t, s.

    For moving supports, differences up to `allowed`, m/s, are accepted.
    """
    if motion is None:
        return (v != 0) & ~structure.free
    return (jnp.abs(v - support_velocity(motion, structure, t)) > allowed) & ~structure.free


def _of_supports(structure: Structure, x: Vector) -> NodeVectors:
    moving = tuple(node for node, _ in structure.fixed)
    return along_fixed(structure, place_rows(jnp.broadcast_to(x, (len(moving), 3)), moving, len(structure.nodes)))

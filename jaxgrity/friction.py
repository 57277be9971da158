"""Friction on the ground: smoothed Coulomb friction, the static/kinetic switch, and the exact cone."""

import equinox as eqx
import jax.numpy as jnp

from jaxgrity.ground import Ground
from jaxgrity.primitives import along, component, inner, inverse, root
from jaxgrity.types import NodeVectors, PerNode, Scalar, as_float


class SmoothFriction(eqx.Module):
    """F_t = -mu F_n v_t / sqrt(|v_t|^2 + eps^2): Coulomb's law but for slips slower than about eps."""

    mu: PerNode | Scalar = eqx.field(converter=as_float)
    slip_speed: Scalar = eqx.field(converter=as_float)
    """eps, m/s"""


class SwitchFriction(eqx.Module):
    """Static or kinetic friction by a test of speed and force: Appendix B of the paper the project began from."""

    mu_static: PerNode | Scalar = eqx.field(converter=as_float)
    mu_kinetic: PerNode | Scalar = eqx.field(converter=as_float)
    slip_speed: Scalar = eqx.field(converter=as_float)
    """eps, m/s: below it a node may stick"""


class ConeFriction(eqx.Module):
    """|p_t| <= mu p_n, sticking where it can: Coulomb's cone on the impulses of exact contact."""

    mu: PerNode | Scalar = eqx.field(converter=as_float)


Friction = SmoothFriction | SwitchFriction | ConeFriction


def slip_dissipation(friction: SmoothFriction, ground: Ground, v: NodeVectors, normal_force: PerNode) -> Scalar:
    """R = sum mu F_n sqrt(|v_t|^2 + eps^2), W, with F_n held fixed."""
    slip, sideways = (jnp.square(component(v, tangent)) for tangent in ground.tangents)
    speed = root(slip + sideways + jnp.square(friction.slip_speed))
    return inner(friction.mu * normal_force, speed)


def switch_force(
    friction: SwitchFriction, ground: Ground, v: NodeVectors, normal_force: PerNode, other_forces: NodeVectors
) -> NodeVectors:
    """F_switch, N. A node sticks while |v_t| < eps and the force that would hold it is within mu_s F_n.

    A sticking node gets that force, the opposite of the tangential part of all `other_forces`: it goes on at the speed,
    below eps, with which it came. Any other node gets
    mu_k F_n against its slip, or, while it is slower than eps, against the slip that `other_forces` are about to start.
    """
    slip = [component(v, tangent) for tangent in ground.tangents]
    push = [component(other_forces, tangent) for tangent in ground.tangents]
    speed, needed = (_hypot(*pair) for pair in (slip, push))
    slow = (speed < friction.slip_speed).astype(speed.dtype)
    stick = slow * (needed <= friction.mu_static * normal_force).astype(speed.dtype)
    against_slip = (1 - slow) * friction.mu_kinetic * normal_force * inverse(speed)
    against_push = stick + (slow - stick) * friction.mu_kinetic * normal_force * inverse(needed)
    parts = [along(-against_slip * s - against_push * p, tangent) for s, p, tangent in zip(slip, push, ground.tangents)]
    return parts[0] + parts[1]


def _hypot(a: PerNode, b: PerNode) -> PerNode:
    """sqrt(a^2 + b^2), with derivative 0 where both are 0."""
    square = a * a + b * b
    positive = (square > 0).astype(square.dtype)
    return positive * jnp.sqrt(square + (1 - positive))

"""The ground: a signed distance, and the normal force of penalty contact."""

import math

import equinox as eqx
import jax

from jaxgrity.primitives import component, half_squares, inner, positive_part
from jaxgrity.types import NodeVectors, PerNode, Scalar, as_float_or_none

Direction = tuple[float, float, float]


class Ground(eqx.Module):
    """A plane through the origin, level or falling towards +x: phi(x) = n·x, n = (sin theta, 0, cos theta).

    With a stiffness it pushes back as a spring (penalty contact); without one, phi >= 0 is a constraint (Signorini's
    law: phi >= 0, p_n >= 0, p_n phi = 0).
    """

    stiffness: Scalar | None = eqx.field(converter=as_float_or_none)
    """k_n, N/m, per node; None: exact contact"""
    dissipation: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """alpha of Hunt and Crossley's law, s/m, with penalty contact; None: not modelled"""
    incline: float = eqx.field(static=True, converter=float, default=0.0)
    """theta, rad"""
    restitution: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """e: a node that hits the ground at speed v leaves it at e v, with exact contact; None: it stays"""

    @property
    def exact(self) -> bool:
        """Whether contact is a constraint, not a spring."""
        return self.stiffness is None

    @property
    def normal(self) -> Direction:
        """Outward unit normal n."""
        return (math.sin(self.incline), 0.0, math.cos(self.incline))

    @property
    def tangents(self) -> tuple[Direction, Direction]:
        """Two unit vectors in the plane: down the slope, and level."""
        return (math.cos(self.incline), 0.0, -math.sin(self.incline)), (0.0, 1.0, 0.0)


def signed_distance(ground: Ground, q: NodeVectors) -> PerNode:
    """phi, m: height of each node above the ground along its normal, negative inside."""
    return component(q, ground.normal)


def contact_energy(ground: Ground, phi: PerNode) -> Scalar:
    """U = sum k_n/2 min(0, phi)^2, J."""
    assert ground.stiffness is not None, "exact contact stores nothing"
    penetration = positive_part(-phi)
    return half_squares(ground.stiffness, penetration)


def contact_dissipation(ground: Ground, v_n: PerNode, phi: PerNode) -> Scalar:
    """R whose gradient turns k_n pen into Hunt and Crossley's k_n pen max(0, 1 - alpha v_n), W.

    R = sum k_n pen (alpha/2 c^2 + v_n - c) with c = min(v_n, 1/alpha): past 1/alpha the contact lets go, it never
    pulls. Hunt and Crossley 1975, doi:10.1115/1.3423596.
    """
    alpha = ground.dissipation
    assert alpha is not None, "a ground without dissipation has no R"
    assert ground.stiffness is not None, "exact contact has no R"
    released = positive_part(v_n - 1 / alpha)
    closing = v_n - released
    elastic = ground.stiffness * positive_part(-phi)
    return half_squares(alpha * elastic, closing) + inner(elastic, released)


def normal_force(ground: Ground, phi: PerNode, v_n: PerNode | None) -> PerNode:
    """F_n = -dU/dphi - dR/dv_n >= 0, N: what friction is proportional to. `v_n` counts where the ground dissipates."""
    elastic = jax.grad(contact_energy, argnums=1)(ground, phi)
    if ground.dissipation is None:
        return -elastic
    return -elastic - jax.grad(contact_dissipation, argnums=1)(ground, v_n, phi)

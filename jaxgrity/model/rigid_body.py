"""Rigid struts in coordinates of their own: centre p in R^3 and orientation R in SO(3), instead of two node positions.

The simulator never uses them: it moves nodes, and keeps lengths by springs or impulses. They are here to show that both
descriptions have the same kinetic energy, and what a strut of two point masses leaves out: spinning about its own axis
moves neither node, so the inertia J has rank 2, and the strut five degrees of freedom, not six.
"""

import jax.numpy as jnp
from jaxtyping import Float

from jaxgrity.core.types import AnyArray, Scalar

Vector = Float[AnyArray, "3"]
Matrix = Float[AnyArray, "3 3"]
Ends = Float[AnyArray, "ends 3"]
Masses = Float[AnyArray, " ends"]


def end_positions(p: Vector, R: Matrix, arms: Ends) -> Ends:
    """f(p, R) = p + R l, m: where a strut's ends are, for arms l (m) from its centre, in the strut's own axes."""
    return p + arms @ R.T


def end_velocities(v: Vector, spin: Vector, R: Matrix, arms: Ends) -> Ends:
    """The push-forward f_*(v, Omega) = v + Omega × (R l), m/s, with the spin Omega (rad/s) in the axes of space.

    dR/dt = [Omega]× R then. With dR/dt = R [Omega]×, the spin in the strut's own axes, it is v + R (Omega × l).
    """
    return v + jnp.cross(spin, arms @ R.T)


def inertia(R: Matrix, arms: Ends, end_mass: Masses) -> Matrix:
    """J = sum m (|r|^2 1 - r r^T), kg m^2, about the centre, with r = R l; singular along the strut."""
    r = arms @ R.T
    return jnp.einsum("e,ek,ek->", end_mass, r, r) * jnp.eye(3) - jnp.einsum("e,ei,ej->ij", end_mass, r, r)


def rigid_kinetic_energy(v: Vector, spin: Vector, R: Matrix, arms: Ends, end_mass: Masses) -> Scalar:
    """T = m/2 |v|^2 + v·(Omega × sum m r) + Omega·J Omega/2, J. The middle term vanishes about the centre of mass."""
    first_moment = end_mass @ (arms @ R.T)
    about = spin @ inertia(R, arms, end_mass) @ spin
    return (end_mass.sum() * (v @ v) + about) / 2 + v @ jnp.cross(spin, first_moment)

"""The equations of motion, M a = -dU/dq - dR/dv (+ F_switch), and the quantities that they conserve."""

import jax
import jax.numpy as jnp

from jaxgrity.core.primitives import dot, inner, scale
from jaxgrity.core.types import NodeVectors, PerNode, Scalar, State, VectorsByKind
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import member_vectors, onto_nodes


def acceleration(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors) -> NodeVectors:
    """a = M^-1 (-dU/dq - dR/dv + F_switch), (nodes, 3), m/s^2."""
    normal_force = scene.normal_force(q, v)
    force = smooth_force(scene, t, q, v, normal_force)
    laws = scene.force_laws
    if laws:
        motion = scene.motion(v, q, t, normal_force)
        force = sum((law.force(motion, force) for law in laws), force)
    return scale(force, 1 / scene.structure.node_mass)


def smooth_acceleration(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors) -> NodeVectors:
    """M^-1 (-dU/dq - dR/dv), m/s^2: what of the acceleration has derivatives."""
    return scale(smooth_force(scene, t, q, v, scene.normal_force(q, v)), 1 / scene.structure.node_mass)


def smooth_force(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors, normal_force: PerNode | None) -> NodeVectors:
    """-dU/dq - dR/dv, N: all forces but F_switch.

    Springs and dampers act along the same members: what pulls on a member is put on its nodes once.
    """
    kinds = scene.structure.kinds
    force, pull = _gradients(scene, t, q, v, normal_force)
    return -(force + onto_nodes(pull, kinds, q.shape[0]) if kinds else force)


def outside_force(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors, normal_force: PerNode | None) -> NodeVectors:
    """The part of `smooth_force`, N, that does not act along members: gravity, contact, damping of nodes and so on."""
    return -_gradients(scene, t, q, v, normal_force)[0]


def _gradients(
    scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors, normal_force: PerNode | None
) -> tuple[NodeVectors, VectorsByKind]:
    """dU/dq + dR/dv with the members' vectors held fixed, and the derivatives in these."""
    kinds, damped = scene.structure.kinds, scene.structure.damped
    d = member_vectors(q, kinds)
    force, pull = jax.grad(scene.potential_energy, argnums=(0, 2))(q, t, d)
    if scene.dissipation_terms:

        def loss(v, rates):
            return scene.dissipation(v, q, t, normal_force, (d, rates))

        drag, resistance = jax.grad(loss, argnums=(0, 1))(v, member_vectors(v, damped))
        force, pull = force + drag, pull | {name: pull[name] + resistance[name] for name in damped}
    return force, pull


def vector_field(t: Scalar, state: State, scene: Scene) -> State:
    """d/dt (q, v) = (v, a): the right-hand side that every method integrates."""
    q, v = state
    return v, acceleration(scene, t, q, v)


def kinetic_energy(scene: Scene, v: NodeVectors) -> Scalar:
    """T = sum m/2 |v|^2, J."""
    return inner(scene.structure.node_mass, dot(v, v)) / 2


def mechanical_energy(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors) -> Scalar:
    """T + U, J."""
    return kinetic_energy(scene, v) + scene.potential_energy(q, t)


def centre_of_mass(scene: Scene, q: NodeVectors):
    """sum m x / sum m, (3,), m; of velocities: its velocity."""
    mass = scene.structure.node_mass
    return jnp.einsum("n,nk->k", mass, q) / mass.sum()


def momentum(scene: Scene, v: NodeVectors):
    """p = sum m v, (3,), kg m/s."""
    return jnp.einsum("n,nk->k", scene.structure.node_mass, v)


def angular_momentum(scene: Scene, q: NodeVectors, v: NodeVectors):
    """L = sum m x × v about the origin, (3,), kg m^2/s."""
    return jnp.einsum("n,nk->k", scene.structure.node_mass, jnp.cross(q, v))

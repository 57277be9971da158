"""The equations of motion, M a = -dU/dq - dR/dv (+ F_switch), and the quantities that they conserve."""

import jax
import jax.numpy as jnp

from jaxgrity.friction import SwitchFriction, switch_force
from jaxgrity.ground import normal_force, signed_distance
from jaxgrity.primitives import component, dot, inner, scale
from jaxgrity.scene import Scene
from jaxgrity.structure import member_vectors, onto_nodes
from jaxgrity.types import AnyArray, NodeVectors, PerNode, Scalar

State = tuple[AnyArray, AnyArray]


def acceleration(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors) -> NodeVectors:
    """a = M^-1 (-dU/dq - dR/dv + F_switch), (nodes, 3), m/s^2."""
    pressed = pressing_force(scene, q, v)
    force = smooth_force(scene, t, q, v, pressed)
    if isinstance(scene.friction, SwitchFriction):
        force += switched_friction(scene, v, pressed, force)
    return scale(force, 1 / scene.structure.node_mass)


def pressing_force(scene: Scene, q: NodeVectors, v: NodeVectors) -> PerNode | None:
    """F_n of penalty contact, N, where friction needs it."""
    ground = scene.ground
    if ground is None or ground.exact or scene.friction is None:
        return None
    v_n = None if ground.dissipation is None else component(v, ground.normal)
    return normal_force(ground, signed_distance(ground, q), v_n)


def smooth_force(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors, pressed: PerNode | None) -> NodeVectors:
    """-dU/dq - dR/dv, N: all forces but F_switch.

    Springs and dampers act along the same members: U and R are differentiated in the members' vectors too, and what
    pulls on a member is put on its nodes once.
    """
    structure = scene.structure
    kinds, damped = structure.kinds, structure.damped
    d = member_vectors(q, kinds)
    force, pull = jax.grad(scene.potential_energy, argnums=(0, 2))(q, t, d)
    if scene.dissipates:

        def loss(v, rates):
            return scene.dissipation(v, q, t, pressed, (d, rates))

        drag, resistance = jax.grad(loss, argnums=(0, 1))(v, member_vectors(v, damped))
        force, pull = force + drag, pull | {name: pull[name] + resistance[name] for name in damped}
    return -(force + onto_nodes(pull, kinds, q.shape[0]) if kinds else force)


def switched_friction(scene: Scene, v: NodeVectors, pressed: PerNode | None, force: NodeVectors) -> NodeVectors:
    """F_switch, N, from the normal and all other forces."""
    assert isinstance(scene.friction, SwitchFriction), "only the Coulomb switch is a force law of its own"
    assert scene.ground is not None, "a scene with friction has a ground"
    assert pressed is not None, "the switch goes with penalty contact"
    return switch_force(scene.friction, scene.ground, v, pressed, force)


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

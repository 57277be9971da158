"""The equations of motion, M a = -dU/dq - dR/dv (+ F_laws), and their conserved quantities.

F_laws is the sum of `Scene.force_laws`, which have no potential: the Coulomb switch, friction of rods, users' own.
"""

import jax
import jax.numpy as jnp

from jaxgrity.core.primitives import store_cotangent
from jaxgrity.core.typed import typed
from jaxgrity.core.types import NodeVectors, PerMember, PerNode, Scalar, State, VectorsByKind
from jaxgrity.model import inertia
from jaxgrity.model.body_points import following
from jaxgrity.model.scene import Scene
from jaxgrity.model.shaking import support_acceleration, with_supports
from jaxgrity.model.springs import along_members, elastic_tensions
from jaxgrity.model.structure import Members, member_vectors, onto_nodes


@typed
def acceleration(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors) -> NodeVectors:
    """a = M^-1 (-dU/dq - dR/dv + F_laws), (nodes, 3), m/s^2; along fixed coordinates that of the supports."""
    return _accelerated(scene, t, total_force(scene, t, q, v))


def total_force(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors) -> NodeVectors:
    """-dU/dq - dR/dv + F_laws, (nodes, 3), N: all forces but those of supports."""
    normal_force = scene.normal_force(q, v)
    force = smooth_force(scene, t, q, v, normal_force)
    laws = scene.force_laws
    if laws:
        motion = scene.motion(v, q, t, normal_force)
        force = sum((law.force(motion, force) for law in laws), force)
    return force


def _accelerated(scene: Scene, t: Scalar, force: NodeVectors) -> NodeVectors:
    """M^-1 F of the free coordinates, for given motions of the others, m/s^2."""
    if scene.shaking is None:
        return inertia.accelerations(scene.structure, force)
    carried = support_acceleration(scene.shaking, scene.structure, t)
    # a node that follows basic points also follows those that are moved
    a = carried + inertia.accelerations(scene.structure, force - inertia.momenta(scene.structure, carried))
    return following(scene.structure.bodies, a)


def support_forces(
    scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors, rigid: NodeVectors | float = 0.0
) -> NodeVectors:
    """M a - F along the fixed coordinates, (nodes, 3), N: the supports' forces on the nodes, from forces alone.

    Of rigid struts and bodies it has the forces `rigid` (`rigid_forces`). The impulses of these and of exact
    contact are not in it: `reactions` has both.
    """
    force = total_force(scene, t, q, v) + rigid
    moved = inertia.momenta(scene.structure, _accelerated(scene, t, force))
    return inertia.borne_by_supports(scene.structure, moved - force)


def smooth_acceleration(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors) -> NodeVectors:
    """M^-1 (-dU/dq - dR/dv), m/s^2: the differentiable part of the acceleration."""
    return _accelerated(scene, t, smooth_force(scene, t, q, v, scene.normal_force(q, v)))


@typed
def smooth_force(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors, normal_force: PerNode | None) -> NodeVectors:
    """-dU/dq - dR/dv, N: all forces but those of force laws.

    Springs and dampers act along the same members: the sum of a member's forces is put on its nodes once.
    """
    kinds = scene.structure.kinds
    force, pull = _gradients(scene, t, q, v, normal_force)
    return -(force + onto_nodes(pull, kinds, q.shape[0]) if kinds else force)


def outside_force(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors, normal_force: PerNode | None) -> NodeVectors:
    """The part of `smooth_force`, N, that does not act along members: gravity, contact, damping of nodes and so on."""
    return -_gradients(scene, t, q, v, normal_force)[0]


def member_pull(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors) -> VectorsByKind:
    """The part of dU/dq + dR/dv, N, that acts along members: the pull of each first node towards the second."""
    return _gradients(scene, t, q, v, scene.normal_force(q, v))[1]


def member_tensions(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors | None = None) -> dict[str, PerMember]:
    """The tension of each member, N, by kind: from all of U, and with `v` from R too.

    Limits, tables, clusters and users' terms are in it. Rigid members without dampers have no entry; the constraint
    forces of rigid struts are not in it.
    """
    if v is None:
        return elastic_tensions(scene, t, q)
    pull, vectors = member_pull(scene, t, q, v), member_vectors(q, scene.structure.kinds)
    return along_members(scene.structure, pull, vectors)


def _gradients(
    scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors, normal_force: PerNode | None
) -> tuple[NodeVectors, VectorsByKind]:
    """dU/dq + dR/dv with the members' vectors held fixed, and the derivatives in these."""
    kinds, damped = scene.structure.kinds, scene.structure.damped
    d = _member_vectors(q, kinds)
    force, pull = jax.grad(scene.potential_energy, argnums=(0, 2))(q, t, d)
    if scene.dissipation_terms:

        def loss(v, rates):
            return scene.dissipation(v, q, t, normal_force, (d, rates))

        drag, resistance = jax.grad(loss, argnums=(0, 1))(v, _member_vectors(v, damped))
        force, pull = force + drag, pull | {name: pull[name] + resistance[name] for name in damped}
    return force, pull


def _member_vectors(x: NodeVectors, kinds: dict[str, Members]) -> VectorsByKind:
    """`member_vectors`; every node gathers its cotangents from several members."""
    return jax.tree.map(store_cotangent, member_vectors(x, kinds))


@typed
def vector_field(t: Scalar, state: State, scene: Scene) -> State:
    """d/dt (q, v) = (v, a): the right-hand side of every method; the motion of supports is known."""
    q, v = state
    return with_supports(scene.shaking, scene.structure, t, v), acceleration(scene, t, q, v)


@typed
def centre_of_mass(scene: Scene, q: NodeVectors):
    """sum m x / sum m, (3,), m; of velocities: its velocity."""
    mass = scene.structure.lumped_mass
    return jnp.einsum("n,nk->k", mass, q) / mass.sum()


def momentum(scene: Scene, v: NodeVectors):
    """p = sum m v, (3,), kg m/s."""
    return jnp.einsum("n,nk->k", scene.structure.lumped_mass, v)


def angular_momentum(scene: Scene, q: NodeVectors, v: NodeVectors):
    """L = sum x_i × (M v)_i about the origin, (3,), kg m^2/s."""
    if not scene.structure.of_points:
        return jnp.cross(q, inertia.momenta(scene.structure, v)).sum(0)
    return jnp.einsum("n,nk->k", scene.structure.node_mass, jnp.cross(q, v))

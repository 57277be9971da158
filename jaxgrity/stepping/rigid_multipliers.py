"""Rigid bodies and struts by multipliers: the equations of motion for methods without impulses.

With g = (|d|^2 - L^2)/2 of every pair of nodes at a constant distance, and J its derivative,

    a = M^-1 (F - J^T lambda),    J a + |d'|^2 = -2 rate g' - rate^2 g:

the constraint is differentiated twice, and the steps' errors in g decay at the rate (Baumgarte 1972,
doi:10.1016/0045-7825(72)90018-7). A method keeps its order, and the distances are as exact as the motion.
"""

import jax.numpy as jnp

from jaxgrity.core.primitives import accumulate, dot, edge_vectors, scale
from jaxgrity.core.types import AnyArray, NodeVectors, PerMember, Scalar, State
from jaxgrity.model.inertia import accelerations, independent_mobility
from jaxgrity.model.rigidity import rigid_lengths, rigid_pairs
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.shaking import with_supports
from jaxgrity.stepping.coupled_constraints import signs_of_ends
from jaxgrity.stepping.coupled_problem import inverse_of_responses
from jaxgrity.stepping.dynamics import vector_field

RETURNS = 10.0
"""Rate, 1/s of a body of one metre on Earth, at which distances return: slower than steps, faster than errors grow."""


def vector_field_with_multipliers(t: Scalar, state: State, scene: Scene) -> State:
    """`vector_field` of a scene with rigid bodies and struts, for methods without impulses.

    Forces see the supports' own velocity: the integrated one keeps the steps' errors where their acceleration jumps.
    """
    q, v = state
    state = q, with_supports(scene.shaking, scene.structure, t, v)
    if not rigid_pairs(scene):
        return vector_field(t, state, scene)
    velocity, a = vector_field(t, state, scene)
    return velocity, a + accelerations(scene.structure, _forces(scene, state, rigid_pulls(scene, t, state, a)))


def rigid_forces(scene: Scene, t: Scalar, state: State) -> NodeVectors | float:
    """(nodes, 3), N: the forces that keep rigid bodies and struts, on the nodes; 0.0 where there are none."""
    if not rigid_pairs(scene):
        return 0.0
    return _forces(scene, state, rigid_pulls(scene, t, state, vector_field(t, state, scene)[1]))


def rigid_pulls(scene: Scene, t: Scalar, state: State, a: NodeVectors) -> PerMember:
    """lambda, N/m, of `rigid_pairs`: tension over length of each, where other forces accelerate nodes by `a`."""
    (q, v), edges = state, rigid_pairs(scene)
    d, rates = edge_vectors(q, edges), edge_vectors(v, edges)
    rate = RETURNS / time_scale(scene)
    off, growing = (dot(d, d) - rigid_lengths(scene, t) ** 2) / 2, dot(d, rates)
    wanted = dot(d, edge_vectors(a, edges)) + dot(rates, rates) + 2 * rate * growing + rate**2 * off
    return _multipliers(scene, d, wanted)


def _forces(scene: Scene, state: State, pulls: PerMember) -> NodeVectors:
    (q, _), edges = state, rigid_pairs(scene)
    return -accumulate(scale(edge_vectors(q, edges), pulls), edges, len(q))


def _multipliers(scene: Scene, d: NodeVectors, wanted: PerMember) -> PerMember:
    """lambda, N/m, with J M^-1 J^T lambda = `wanted`; one of several solutions for dependent constraints."""
    structure, signs = scene.structure, signs_of_ends(scene).astype(d.dtype)
    if structure.needs_mobility:
        own: AnyArray = independent_mobility(structure) if structure.mobility is None else structure.mobility
        response: AnyArray = jnp.einsum("ei,ijk,fj,ek,fk->ef", signs, own, signs, d, d)
    else:
        response = (signs / structure.node_mass) @ signs.T * (d @ d.T)
    inverse = inverse_of_responses(response)
    pulls = inverse @ wanted
    return pulls + inverse @ (wanted - response @ pulls)  # what the ridge left

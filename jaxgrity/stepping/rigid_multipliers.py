"""Rigid bodies and struts, and sliding nodes, by multipliers: the equations of motion for methods without impulses.

With g = (|d|^2 - L^2)/2 of every pair of nodes at a constant distance, and J its derivative,

    a = M^-1 (F - J^T lambda),    J a + |d'|^2 = -2 rate g' - rate^2 g:

the constraint is differentiated twice, and the steps' errors in g decay at the rate (Baumgarte 1972,
doi:10.1016/0045-7825(72)90018-7). A method keeps its order, and the distances are as exact as the motion.

For a sliding node g = n·e (`slides.py`). In its second derivative, n·e'' - 2 (n·b')(u·e')/|b| with b from one end of
the line to the other, the last term is Coriolis's acceleration.
"""

import jax.numpy as jnp

from jaxgrity.core.primitives import accumulate, dot, edge_vectors, scale
from jaxgrity.core.types import AnyArray, NodeVectors, PerMember, Scalar, State
from jaxgrity.model.inertia import accelerations, independent_mobility
from jaxgrity.model.rigidity import linked, rigid_lengths, rigid_pairs
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.shaking import with_supports
from jaxgrity.model.slides import Lines, lines_at, slides_of
from jaxgrity.stepping.coupled_constraints import on_independent, signs_of_ends
from jaxgrity.stepping.coupled_problem import inverse_of_responses
from jaxgrity.stepping.dynamics import vector_field

RETURNS = 10.0
"""Rate, 1/s of a body of one metre on Earth, at which distances return: slower than steps, faster than errors grow."""


def vector_field_with_multipliers(t: Scalar, state: State, scene: Scene) -> State:
    """`vector_field` of a scene with rigid bodies and struts, or sliding nodes, for methods without impulses.

    Forces see the supports' own velocity: the integrated one keeps the steps' errors where their acceleration jumps.
    """
    q, v = state
    state = q, with_supports(scene.shaking, scene.structure, t, v)
    if not linked(scene):
        return vector_field(t, state, scene)
    velocity, a = vector_field(t, state, scene)
    return velocity, a + accelerations(scene.structure, _forces(scene, state, rigid_pulls(scene, t, state, a)))


def rigid_forces(scene: Scene, t: Scalar, state: State) -> NodeVectors | float:
    """(nodes, 3), N: the forces that keep rigid bodies, struts and slides, on the nodes; 0.0 where there are none."""
    if not linked(scene):
        return 0.0
    return _forces(scene, state, rigid_pulls(scene, t, state, vector_field(t, state, scene)[1]))


def rigid_pulls(scene: Scene, t: Scalar, state: State, a: NodeVectors) -> PerMember:
    """lambda where other forces accelerate nodes by `a`: of `rigid_pairs` tension over length, N/m, then of slides, two
    for each sliding node, the opposite of its force along `Lines.across`, N."""
    (q, v), edges, slides = state, rigid_pairs(scene), slides_of(scene)
    rate = RETURNS / time_scale(scene)
    signs: AnyArray = signs_of_ends(scene).astype(q.dtype)
    d: AnyArray = jnp.zeros((0, 3), q.dtype)
    wanted: AnyArray = jnp.zeros(0, q.dtype)
    if edges:
        d, rates = edge_vectors(q, edges), edge_vectors(v, edges)
        off, growing = (dot(d, d) - rigid_lengths(scene, t) ** 2) / 2, dot(d, rates)
        wanted = dot(d, edge_vectors(a, edges)) + dot(rates, rates) + 2 * rate * growing + rate**2 * off
    if slides is not None:
        lines = lines_at(slides, q)
        signs, d = jnp.concatenate([signs, on_independent(scene, lines.weights)]), jnp.concatenate([d, lines.across])
        wanted = jnp.concatenate([wanted, _wanted_of_slides(lines, (q, v), a, rate)])
    return _multipliers(scene, signs, d, wanted)


def _wanted_of_slides(lines: Lines, state: State, a: NodeVectors, rate: Scalar) -> PerMember:
    """J a, and what it has to balance, of each row, m/s^2."""
    off, growing, wanted = (jnp.sum(lines.across * (lines.weights @ x), axis=1) for x in (*state, a))
    sliding = jnp.sum(lines.along * (lines.weights @ state[1]), axis=1)
    sideways = jnp.sum(lines.across * (lines.ends @ state[1]), axis=1)
    turning = sideways / jnp.sum(lines.along * lines.line, axis=1)
    return wanted - 2 * turning * sliding + 2 * rate * growing + rate**2 * off


def _forces(scene: Scene, state: State, pulls: PerMember) -> NodeVectors:
    (q, _), edges, slides = state, rigid_pairs(scene), slides_of(scene)
    count = len(edges)
    found = -accumulate(scale(edge_vectors(q, edges), pulls[:count]), edges, len(q)) if edges else jnp.zeros_like(q)
    if slides is None:
        return found
    lines = lines_at(slides, q)
    return found - lines.weights.T @ (lines.across * pulls[count:, None])


def _multipliers(scene: Scene, signs: AnyArray, d: NodeVectors, wanted: PerMember) -> PerMember:
    """lambda, with J M^-1 J^T lambda = `wanted` and J of rows `signs` times `d`; one of several solutions for dependent
    constraints."""
    structure = scene.structure
    if structure.needs_mobility:
        own: AnyArray = independent_mobility(structure) if structure.mobility is None else structure.mobility
        response: AnyArray = jnp.einsum("ei,ijk,fj,ek,fk->ef", signs, own, signs, d, d)
    else:
        response = (signs / structure.node_mass) @ signs.T * (d @ d.T)
    inverse = inverse_of_responses(response)
    pulls = inverse @ wanted
    return pulls + inverse @ (wanted - response @ pulls)  # what the ridge left

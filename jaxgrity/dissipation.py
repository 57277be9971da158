"""R(v; q, t), Rayleigh's dissipation function. Every dissipative force of the library is `-jax.grad` of it in v."""

import jax.numpy as jnp

from jaxgrity.actuation import Gait, rest_lengths
from jaxgrity.friction import SmoothFriction, slip_dissipation
from jaxgrity.ground import Ground, contact_dissipation, signed_distance
from jaxgrity.primitives import component, dot, edge_vectors, inner, inverse, length
from jaxgrity.structure import Members, Structure
from jaxgrity.types import NodeVectors, PerMember, PerNode, Scalar


def dissipation_function(
    v: NodeVectors,
    q: NodeVectors,
    t: Scalar,
    structure: Structure,
    gait: Gait | None,
    node_damping: PerNode | None,
    ground: Ground | None,
    friction: SmoothFriction | None,
    normal_force: PerNode | None,
) -> Scalar:
    """R = R_nodes + R_struts + R_cables + R_contact + R_friction, W, of the terms that the scene has.

    `normal_force` (N, per node) is an argument of its own because friction's R holds it fixed: it depends on v too,
    and only the derivative at fixed F_n is the friction force.
    """
    strut_rest, cable_rest = rest_lengths(structure, gait, t)
    R = jnp.zeros((), v.dtype)
    if node_damping is not None:
        R += inner(node_damping, dot(v, v)) / 2
    if structure.struts is not None and structure.struts.damping is not None:
        R += member_dissipation(v, q, structure.struts, None)
    if structure.cables is not None and structure.cables.damping is not None:
        R += member_dissipation(v, q, structure.cables, cable_rest)
    if ground is not None and ground.dissipation is not None:
        R += contact_dissipation(ground, component(v, ground.normal), signed_distance(ground, q))
    if ground is not None and friction is not None:
        R += slip_dissipation(friction, ground, v, normal_force)
    return R


def member_dissipation(v: NodeVectors, q: NodeVectors, members: Members, slack_below: PerMember | None) -> Scalar:
    """R = sum c/2 l'^2, W, with l' = d·(v_i - v_j), d the member's direction; cables only while l > `slack_below`."""
    vectors = edge_vectors(q, members.edges)
    lengths = length(vectors)
    rate = dot(vectors, edge_vectors(v, members.edges)) * inverse(lengths)
    damping = members.damping
    if slack_below is not None:
        damping = damping * (lengths > slack_below).astype(rate.dtype)
    return inner(damping * rate, rate) / 2

"""R(v; q, t), Rayleigh's dissipation function. Every dissipative force of the library is `-jax.grad` of it in v."""

from jaxgrity.actuation import Gait, rest_length
from jaxgrity.friction import SmoothFriction, slip_dissipation
from jaxgrity.ground import Ground, contact_dissipation, signed_distance
from jaxgrity.primitives import component, dot, half_squares, inner, length, norm_squared, over
from jaxgrity.structure import Structure, member_vectors
from jaxgrity.types import ByKind, MemberVectors, NodeVectors, PerMember, PerNode, Scalar


def dissipation_terms(
    v: NodeVectors,
    q: NodeVectors,
    t: Scalar,
    structure: Structure,
    gait: Gait | None,
    node_damping: PerNode | None,
    ground: Ground | None,
    friction: SmoothFriction | None,
    normal_force: PerNode | None,
    vectors: tuple[ByKind, ByKind] | None = None,
) -> dict[str, Scalar]:
    """R_nodes, R_struts, R_cables, R_contact and R_friction, W, those of them that the scene has; R is their sum.

    `normal_force` (N, per node) is an argument of its own because friction's R holds it fixed: it depends on v too,
    and only the derivative at fixed F_n is the friction force. Given `vectors`, d and d' of the
    members, R is a function of d' too, as U is of d.
    """
    struts, cables = structure.struts, structure.cables
    d, rates = (member_vectors(x, structure.damped) for x in (q, v)) if vectors is None else vectors
    R = {}
    if node_damping is not None:
        R["nodes"] = inner(node_damping, norm_squared(v)) / 2
    if struts is not None and struts.damping is not None:
        R["struts"] = member_dissipation(rates["struts"], d["struts"], struts.damping)
    if cables is not None and cables.damping is not None:
        taut_above = rest_length(cables, gait, t, structure.first_cable)
        R["cables"] = member_dissipation(rates["cables"], d["cables"], cables.damping, taut_above)
    if ground is not None and ground.dissipation is not None:
        R["contact"] = contact_dissipation(ground, component(v, ground.normal), signed_distance(ground, q))
    if ground is not None and friction is not None and normal_force is not None:
        R["friction"] = slip_dissipation(friction, ground, v, normal_force)
    return R


def member_dissipation(
    rates: MemberVectors, d: MemberVectors, damping: PerMember, taut_above: PerMember | None = None
) -> Scalar:
    """R = sum c/2 l'^2, W, with l' = d·d'/|d|, d' = v_i - v_j; a cable's only while l > `taut_above`."""
    lengths = length(d)
    rate = over(dot(d, rates), lengths)
    if taut_above is not None:
        damping = damping * (lengths > taut_above).astype(rate.dtype)
    return half_squares(damping, rate)

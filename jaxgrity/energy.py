"""U(q, t), the potential energy. Every conservative force of the library is `-jax.grad` of this one function."""

import jax.numpy as jnp

from jaxgrity.actuation import Gait, rest_length
from jaxgrity.ground import Ground, contact_energy, signed_distance
from jaxgrity.primitives import component, dot, half_squares, inner, length, positive_part
from jaxgrity.structure import Members, Structure, member_vectors
from jaxgrity.types import ByKind, MemberVectors, NodeVectors, PerMember, PerNode, Scalar

UP = (0.0, 0.0, 1.0)


def potential_energy(
    q: NodeVectors,
    t: Scalar,
    structure: Structure,
    gait: Gait | None,
    gravity: Scalar | None,
    ground: Ground | None,
    vectors: ByKind | None = None,
    up: NodeVectors | None = None,
) -> Scalar:
    """U = U_struts + U_cables + U_gravity + U_contact, J, of the terms that the scene has. q: (nodes, 3), m.

    Given `vectors`, the members' d at q, U is a function of them too: dU/dq then lacks what acts along the members,
    which is dU/d(vectors). `up` is against gravity, (nodes, 3), all rows alike; z where not given.
    """
    struts, cables = structure.struts, structure.cables
    d = member_vectors(q, structure.kinds) if vectors is None else vectors
    U = jnp.zeros((), q.dtype)
    if struts is not None and not struts.rigid:
        U += strut_energy(d["struts"], struts, rest_length(struts, gait, t, 0))
    if cables is not None:
        U += cable_energy(d["cables"], cables, rest_length(cables, gait, t, structure.first_cable))
    if gravity is not None:
        U += gravity_energy(q, structure.node_mass, gravity, up)
    if ground is not None and not ground.exact:
        U += contact_energy(ground, signed_distance(ground, q))
    return U


def strut_energy(d: MemberVectors, struts: Members, rest: PerMember) -> Scalar:
    """U = sum K/2 (l - L)^2, J, l = |d|."""
    assert struts.stiffness is not None, "rigid struts store nothing"
    stretch = length(d) - rest
    return half_squares(struts.stiffness, stretch)


def cable_energy(d: MemberVectors, cables: Members, rest: PerMember) -> Scalar:
    """U = sum K/2 max(0, l - L)^2, J: a slack cable stores nothing."""
    assert cables.stiffness is not None, "a cable is a spring"
    stretch = positive_part(length(d) - rest)
    return half_squares(cables.stiffness, stretch)


def gravity_energy(q: NodeVectors, node_mass: PerNode, gravity: Scalar, up: NodeVectors | None = None) -> Scalar:
    """U = sum m g z, J, with z along `up` where it is given."""
    return gravity * inner(node_mass, component(q, UP) if up is None else dot(q, up))

"""The linear algebra of one step with coupled nodes: what impulses of struts and contacts do to velocities."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrity.core.dense import inverse_of
from jaxgrity.core.primitives import length
from jaxgrity.core.side_by_side import applied, contracted, for_many
from jaxgrity.core.types import AnyArray, AnyMemberVectors, AnyNodeVectors, AnyPerMember, AnyPerNode
from jaxgrity.stepping.coupled_constraints import Constraints, Sliding
from jaxgrity.stepping.coupled_contacts import Factors, as_impulses, begins_with_nearest
from jaxgrity.stepping.ground_response import Contact, Timing

REDUNDANT = 1e-11
"""Share of each strut's own response that is added to the diagonal of J A J^T. Structures with more struts than
rigidity needs make that matrix singular."""


class Coupled(NamedTuple):
    """The constraints of one step as matrices; fields of the same name are those of `Constraints`."""

    A: AnyArray
    """(3 nodes, 3 nodes), 1/kg, along x, y and z"""
    start: AnyNodeVectors
    ends: AnyArray
    apart: Any
    goal: Any
    sliding: Sliding | None
    contact: Contact | None
    frame: AnyArray
    reach: AnyArray | None
    """(contacts, 3, nodes, 3): of where balls and struts touch the ground, the velocity along normal and tangents by
    those of nodes; None: all nodes themselves touch, and nothing else does"""
    speed: AnyArray


class Elimination(NamedTuple):
    """The struts' part of the problem, for one choice of their directions."""

    units: AnyMemberVectors
    """u, (struts, 3), these directions"""
    J: AnyArray
    """(struts, 3 nodes)"""
    inverse: AnyArray
    """(struts, struts), kg, (J A J^T)^-1"""
    G: AnyArray | Factors
    """(3 contacts, 3 contacts): B along normals and tangents, scaled by masses"""


def problem_of(constraints: Constraints) -> Coupled:
    """The matrices of a step."""
    mobility, start, ends, apart, goal, sliding, contact, frame, weights, speed = constraints
    A = jnp.einsum("ijk,kl->ikjl", mobility, jnp.eye(3, dtype=start.dtype)).reshape(start.size, start.size)
    reach = None if weights is None else frame[:, :, None, :] * weights[..., None]
    return Coupled(A, start, ends, apart, goal, sliding, contact, frame, reach, speed)


def in_frames(problem: Coupled, x: AnyNodeVectors) -> AnyMemberVectors:
    """Components along normals and tangents of vectors along x, y and z."""
    if problem.reach is not None:
        return contracted("bakj,kj->ba", problem.reach, x)
    return contracted("nak,nk->na", problem.frame, x)


def from_frames(problem: Coupled, x: AnyMemberVectors) -> AnyNodeVectors:
    """Vectors along x, y and z of components along normals and tangents: impulses on nodes of those of contacts."""
    if problem.reach is not None:
        return contracted("bakj,ba->kj", problem.reach, x)
    return contracted("nak,na->nk", problem.frame, x)


def vectors_after(problem: Coupled | Constraints, w: AnyNodeVectors) -> AnyMemberVectors:
    """d, (struts, 3), from the second end of each strut to the first at the end of the step, over h, m/s.

    Of a sliding node it is the way from its place on the line at the start.
    """
    return problem.apart + contracted("sn,nk->sk", problem.ends, w)


def rate_to_length(problem: Coupled, u: AnyMemberVectors, w: AnyNodeVectors) -> AnyPerMember:
    """The change of the struts' rates, m/s, along their directions u, to right lengths."""
    d = vectors_after(problem, w)
    towards = jnp.sum(d * u, axis=1)
    under = towards * towards - (jnp.sum(d * d, axis=1) - problem.goal**2)
    # the root of |d + s u| = L/h: a rate that is right to first order would lengthen a strut that turns
    exact = jnp.sqrt(jnp.maximum(under, jnp.finfo(w.dtype).tiny)) - towards
    rates = jnp.where(under > 0, exact, problem.goal - length(d))
    if problem.sliding is None:
        return rates
    struts = len(rates) - len(problem.sliding.across)
    return jnp.concatenate([rates[:struts], -lengths_after(problem, w)[struts:]])


def eliminated(problem: Coupled, root_mass: AnyPerNode, u: AnyMemberVectors) -> Elimination:
    """The parts of struts and contacts for the directions u, scaled by the roots of the masses."""
    contacts, nodes, many = len(root_mass), len(problem.start), root_mass.shape[1:]
    weight = jnp.repeat(root_mass, 3, axis=0)
    J, inverse, B = response(problem, u)
    if problem.reach is not None:
        D = problem.reach.reshape(3 * contacts, 3 * nodes, *many)  # -1 fails without contacts
        if begins_with_nearest(contacts, *many):
            return Elimination(u, J, inverse, Factors(weight[:, None] * D, B))
        G = contracted("il,jl->ij", contracted("ik,kl->il", D, B), D)
    else:
        of_nodes = contracted("iak,ikjl->iajl", problem.frame, B.reshape(nodes, 3, nodes, 3, *many))
        G = contracted("iajl,jbl->iajb", of_nodes, problem.frame).reshape(B.shape)
    return Elimination(u, J, inverse, weight[:, None] * G * weight)


def response(problem: Coupled, u: AnyMemberVectors) -> tuple[AnyArray, AnyArray, AnyArray]:
    """J, (J A J^T)^-1, kg, and B, 1/kg: the nodes' motion by impulses at constant lengths of struts."""
    J = (problem.ends[:, :, None] * u[:, None]).reshape(len(u), *problem.A.shape[1:])
    if not len(J):
        return J, jnp.zeros((0, 0, *J.shape[2:]), J.dtype), problem.A
    AJ = contracted("kl,sl->ks", problem.A, J)
    inverse = inverse_of_responses(contracted("sk,kt->st", J, AJ))
    return J, inverse, problem.A - contracted("kt,lt->kl", contracted("ks,st->kt", AJ, inverse), AJ)


def inverse_of_responses(own: AnyArray) -> AnyArray:
    """The inverse of J A J^T, (struts, struts); where struts are redundant, that of a matrix near it."""
    # to a diagonal of 1, so that the ridge is the same share of the response of every strut, light or heavy;
    # in float32 rounding is more than `REDUNDANT`
    every = np.arange(len(own))
    answer = own[every, every]
    # a strut between supports answers nothing, and has no impulse
    scale = jnp.where(answer > 0, 1 / jnp.sqrt(jnp.maximum(answer, jnp.finfo(own.dtype).tiny)), 0)
    ridge = max(REDUNDANT, 10 * float(jnp.finfo(own.dtype).eps)) * np.eye(len(own))
    return inverse_of(own * scale[:, None] * scale + for_many(ridge, own[0, 0])) * scale[:, None] * scale


def strut_directions(problem: Coupled, w: AnyNodeVectors | None = None) -> AnyMemberVectors:
    """u, (struts, 3): the directions of the struts at the start of the step, or at its end with velocities w."""
    if problem.apart is None:
        return jnp.zeros((0, *problem.start.shape[1:]), problem.start.dtype)
    d = problem.apart if w is None else vectors_after(problem, w)
    d, sliding = _of_struts(problem, d), problem.sliding
    u = d / length(d)[:, None]
    if sliding is None:
        return u
    return jnp.concatenate([u, sliding.across if w is None else _across(sliding, w)])


def lengths_after(problem: Coupled | Constraints, w: AnyNodeVectors) -> AnyPerMember:
    """|d| at the end of the step, over h, m/s; of sliding nodes how far they are beside their line."""
    d = vectors_after(problem, w)
    found = length(_of_struts(problem, d))
    if problem.sliding is None:
        return found
    return jnp.concatenate([found, jnp.sum(d[len(found) :] * _across(problem.sliding, w), axis=1)])


def stretch_after(problem: Coupled, w: AnyNodeVectors) -> AnyArray:
    """The largest share of its length, or that of its line, by which a strut, or a sliding node, is off."""
    lengths = _of_struts(problem, problem.goal)
    if problem.sliding is not None:
        lengths = jnp.concatenate([lengths, length(problem.sliding.line)])
    return jnp.max(jnp.abs(lengths_after(problem, w) - problem.goal) / lengths, axis=0)


def _of_struts(problem: Coupled | Constraints, rows: AnyArray) -> AnyArray:
    """The rows of struts, without those of sliding nodes."""
    return rows if problem.sliding is None else rows[: len(rows) - len(problem.sliding.across)]


def _across(sliding: Sliding, w: AnyNodeVectors) -> AnyMemberVectors:
    """The directions across each line at the end of the step with velocities w, each in the plane of u and its n."""
    line = sliding.line + sliding.ends @ w
    turned = jnp.sum(line * sliding.across, axis=1) / jnp.sum(line * sliding.along, axis=1)
    m = sliding.across - turned[:, None] * sliding.along
    return m / length(m)[:, None]


def contact_of(
    problem: Coupled, root_mass: AnyPerNode, z: AnyMemberVectors
) -> tuple[AnyMemberVectors, AnyMemberVectors]:
    """w, m/s, along x, y and z, and p, N s, along normal and tangents, of trial impulses z.

    Where not all nodes touch, w is that of the points of contact, along normal and tangents.
    """
    scale = root_mass[:, None]
    if problem.contact is None:
        return -z / scale if problem.reach is not None else from_frames(problem, -z / scale), jnp.zeros_like(z)
    contact = scaled(problem.contact, root_mass)
    p = as_impulses(contact, z)
    # a node that is pressed on moves at c to the last bit, so that none ends the step below the ground
    pressed = z[:, 0] + contact.closing > 0
    normal = jnp.where(pressed, problem.contact.closing, -z[:, 0] / root_mass)
    w = jnp.concatenate([normal[:, None], (p - z)[:, 1:] / scale], axis=1)
    return w if problem.reach is not None else from_frames(problem, w), p * scale


def scaled(contact: Contact, root_mass: AnyPerNode) -> Contact:
    """The contacts of velocities times the roots of the masses."""
    timing = contact.timing
    if timing is not None:
        (first, second), s = timing.offset, timing.sliding
        # |p_t| = mu p_n + m (1 - s)/s |w_t| where a node of mass m slides: the same law whatever velocities are scaled
        # by. The foot of a body may answer more than m says: there its own answer counts
        ratio = jnp.minimum(timing.mass / root_mass**2, 1)
        timing = Timing((first * root_mass, second * root_mass), s / (s + ratio * (1 - s)), timing.mass)
    return contact._replace(closing=contact.closing * root_mass, timing=timing)


def acted_on(problem: Coupled, pulls: AnyMemberVectors, p: AnyArray) -> AnyNodeVectors:
    """w0 + A (f + p), m/s, with f of the impulses of struts, (struts, 3), N s, on their first ends."""
    return problem.start + applied(problem.A, contracted("sn,sk->nk", problem.ends, pulls) + from_frames(problem, p))

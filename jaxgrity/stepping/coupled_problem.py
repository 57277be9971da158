"""The constraints of one step with coupled nodes, and the linear algebra of struts and nodes."""

from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.dense import inverse_of
from jaxgrity.core.primitives import edge_vectors, length
from jaxgrity.core.types import AnyArray, Edges, MemberVectors, NodeVectors, PerMember, PerNode, Scalar, State
from jaxgrity.model.body_points import following
from jaxgrity.model.capsules import Capsules
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.inertia import mobility
from jaxgrity.model.rigidity import rigid_lengths, rigid_pairs
from jaxgrity.model.scales import length_scale, mass_scale, speed_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.surface import Frame, frame_axes
from jaxgrity.stepping.blocks import WITHOUT_GROUND
from jaxgrity.stepping.capsules import TouchingPoints, capsules_of, ends_of, of_points, weights_of
from jaxgrity.stepping.constraints import exact_ground
from jaxgrity.stepping.coupled_contacts import as_impulses
from jaxgrity.stepping.entering import Met, closing_speed, where_met
from jaxgrity.stepping.ground_response import SLOWEST, Contact
from jaxgrity.stepping.strut_contacts import StrutContacts, TouchingStruts, points_between

NEVER = 1e6
"""Speed, m/s for a body of one metre. A node that is fixed in all directions touches the ground only if it moves down
at this speed. It never does, so the ground does not act on it."""
SLOW = 1e-2
"""Speed, m/s for a body of one metre. The tolerance of contacts is a share of the robot's largest speed plus this one,
since a robot at rest needs a tolerance too."""
REDUNDANT = 1e-11
"""Share of each strut's own response that is added to the diagonal of J A J^T. Structures with more struts than
rigidity needs make that matrix singular."""


class Coupled(eqx.Module):
    """The constraints of one step, and the means of their solution."""

    A: AnyArray
    """(3 nodes, 3 nodes), 1/kg, along x, y and z"""
    start: NodeVectors
    """w0, m/s: velocities without impulses"""
    apart: Any
    """(struts, 3), (x_i - x_j)/h of the rigid struts, m/s; None: there are none"""
    goal: Any
    """(struts,), L/h, m/s; likewise"""
    contact: Contact | None
    """c, m/s, and mu"""
    frame: AnyArray
    """(contacts, 3, 3): the ground's normal and tangents at each node, or ball"""
    slow: Scalar
    """m/s, `SLOW` of this body"""
    reach: AnyArray | None
    """(contacts, 3, nodes, 3): of where balls and struts touch the ground, the velocity along normal and tangents by
    those of nodes; None: all nodes themselves touch, and nothing else does"""
    edges: Edges = eqx.field(static=True)
    """of the rigid struts"""


class Elimination(NamedTuple):
    """The struts' part of the problem, for one choice of their directions."""

    J: AnyArray
    """(struts, 3 nodes)"""
    inverse: AnyArray
    """(struts, struts), kg, (J A J^T)^-1"""
    G: AnyArray
    """(3 contacts, 3 contacts): B along normals and tangents, scaled by masses"""


def problem_of(
    scene: Scene,
    times: tuple[Scalar, Scalar],
    state: State,
    start: NodeVectors,
    touching: TouchingStruts,
) -> Coupled:
    """The constraints of a step of size h that ends at t1 (`times`, s), from `state`, q (m) and v (m/s); `start` is w0
    (m/s).

    `touching`: the points of struts that may touch the ground, or each other.
    """
    (h, t1), (q, v) = times, state
    edges, ground, structure = rigid_pairs(scene), exact_ground(scene), scene.structure
    own = mobility(structure) if structure.mobility is None else structure.mobility
    A = jnp.einsum("ijk,kl->ikjl", own, jnp.eye(3, dtype=q.dtype)).reshape(q.size, q.size)
    apart = goal = contact = None
    speed = speed_scale(scene)
    axes = Frame(WITHOUT_GROUND[0], WITHOUT_GROUND[1:])
    if edges:
        apart, goal = edge_vectors(q, edges) / h, rigid_lengths(scene, t1) / h
    if structure.bodies:
        # what follows the basic points of a body is led back to its place, so that roundings do not add up
        start = following(structure.bodies, start) + (following(structure.bodies, q) - q) / h
    rows, reach = touching_nodes(scene), cast(AnyArray | None, None)
    at: NodeVectors = q if rows is None else q[rows]
    # velocities are compared with it that are multiplied by roots of masses
    least = jnp.asarray(jnp.square(SLOWEST * speed) * mass_scale(scene), q.dtype)
    if ground is not None:
        never = np.where(structure.free.any(1), 0.0, NEVER).astype(q.dtype) * speed
        mu = None if scene.friction is None else jnp.asarray(scene.friction.sliding_mu)
        size = length_scale(scene)
        met = _met(ground, size, h, (q, v))
        axes = met.frame
        if rows is not None:
            never, mu = never[rows], mu if mu is None or mu.ndim == 0 else mu[rows]
        closing = closing_speed(ground, size, h, v if rows is None else v[rows], met)
        contact = Contact(closing - never, mu, None, least)
    columns = [jnp.broadcast_to(jnp.asarray(axis, q.dtype), at.shape) for axis in (axes.normal, *axes.tangents)]
    frame: AnyArray = jnp.stack(columns, axis=1)
    if ground is not None and ground.balls is not None:
        own = jnp.eye(len(q), dtype=q.dtype)[rows]
        moved_with = own + ground.balls.turning(structure.bodies, q, frame[:, 0])
        reach = frame[:, :, None, :] * jnp.stack([own, moved_with, moved_with], axis=1)[..., None]
    if contact is not None and touching.ground is not None:
        contact, frame, reach = _and_struts(scene, h, v, touching.ground, contact, frame, reach)
    if touching.each_other is not None:
        contact = Contact(jnp.zeros(0, q.dtype), None, None, least) if contact is None else contact
        contact, frame, reach = _and_between(scene, h, touching.each_other, contact, frame, reach)
    slow = jnp.asarray(SLOW * speed, q.dtype)
    return Coupled(A, start, apart, goal, contact, frame, slow, reach, edges)


def touching_nodes(scene: Scene) -> np.ndarray | None:
    """The nodes of the balls that can touch exact ground; None: all nodes can, or nothing can touch anything."""
    ground = exact_ground(scene)
    if ground is None and points_between(scene):
        return np.zeros(0, int)
    return None if ground is None or ground.balls is None else np.array(ground.balls.nodes)


def _met(ground: ExactGround, size: Scalar, h: Scalar, start: State) -> Met:
    """The places where the nodes, or the balls, meet the ground."""
    met = where_met(ground, size, h, *start)
    if ground.balls is None:
        return met
    rows = np.array(ground.balls.nodes)
    if ground.surface is None:
        return met._replace(distance=met.distance[rows])
    return jax.tree.map(lambda x: x[rows], met)


def _and_struts(
    scene: Scene,
    h: Scalar,
    v: NodeVectors,
    touching: TouchingPoints,
    contact: Contact,
    frame: AnyArray,
    reach: AnyArray | None,
) -> tuple[Contact, AnyArray, AnyArray]:
    """The contacts of nodes, or balls, and after them those of struts between their ends."""
    ground, capsules, size = cast(ExactGround, scene.ground), cast(Capsules, capsules_of(scene)), length_scale(scene)
    nodes, (i, j) = len(v), ends_of(capsules)
    closing = closing_speed(ground, size, h, of_points(touching, capsules, v), touching.met)
    moves = touching.found & np.asarray(scene.structure.free.any(1))[[i, j]].any(0)
    closing = jnp.where(moves, closing, -NEVER * speed_scale(scene))
    mu, each = contact.mu, None if scene.friction is None else jnp.asarray(scene.friction.sliding_mu)
    if each is not None and each.ndim:
        mu = jnp.concatenate([jnp.asarray(mu), each[i] + touching.share * (each[j] - each[i])])
    contact = contact._replace(closing=jnp.concatenate([contact.closing, closing]), mu=mu)
    return contact, *_reaching(frame, reach, frame_axes(touching.met.frame), weights_of(touching, capsules, nodes))


def _and_between(
    scene: Scene, h: Scalar, between: StrutContacts, contact: Contact, frame: AnyArray, reach: AnyArray | None
) -> tuple[Contact, AnyArray, AnyArray]:
    """The contacts with the ground, and after them those of struts with each other."""
    closing = jnp.where(between.found, -between.gap / h, -NEVER * speed_scale(scene))
    mu = contact.mu
    if scene.friction is not None and jnp.ndim(each := jnp.asarray(scene.friction.sliding_mu)):
        mu = jnp.concatenate([jnp.asarray(mu), jnp.abs(between.weights) @ each / 2])
    contact = contact._replace(closing=jnp.concatenate([contact.closing, closing.astype(frame.dtype)]), mu=mu)
    return contact, *_reaching(frame, reach, between.axes, between.weights)


def _reaching(frame: AnyArray, reach: AnyArray | None, axes: AnyArray, weights: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Frames and reaches, with those of points that move by `weights` of the nodes."""
    if reach is None:
        reach = frame[:, :, None, :] * jnp.eye(weights.shape[1], dtype=frame.dtype)[: len(frame), None, :, None]
    along = axes[:, :, None, :] * weights[:, None, :, None]
    return jnp.concatenate([frame, axes]), jnp.concatenate([reach, along])


def in_frames(problem: Coupled, x: NodeVectors) -> MemberVectors:
    """Components along normals and tangents of vectors along x, y and z."""
    if problem.reach is not None:
        return jnp.einsum("bakj,kj->ba", problem.reach, x)
    return jnp.einsum("nak,nk->na", problem.frame, x)


def from_frames(problem: Coupled, x: MemberVectors) -> NodeVectors:
    """Vectors along x, y and z of components along normals and tangents: impulses on nodes of those of contacts."""
    if problem.reach is not None:
        return jnp.einsum("bakj,ba->kj", problem.reach, x)
    return jnp.einsum("nak,na->nk", problem.frame, x)


def rate_to_length(problem: Coupled, J: AnyArray, w: NodeVectors) -> PerMember:
    """The change of the struts' rates, m/s, along their directions in J, to right lengths."""
    d = problem.apart + edge_vectors(w, problem.edges)
    u = units(J, problem.edges)
    towards = jnp.sum(d * u, axis=1)
    under = towards * towards - (jnp.sum(d * d, axis=1) - problem.goal**2)
    # the root of |d + s u| = L/h: a rate that is right to first order would lengthen a strut that turns
    exact = jnp.sqrt(jnp.maximum(under, jnp.finfo(w.dtype).tiny)) - towards
    return jnp.where(under > 0, exact, problem.goal - length(d))


def eliminated(problem: Coupled, root_mass: PerNode, J: AnyArray) -> Elimination:
    """The parts of struts and contacts for the directions J, scaled by the roots of the masses."""
    nodes, weight = len(root_mass), jnp.repeat(root_mass, 3)
    J, inverse, B = response(problem, J)
    if problem.reach is not None:
        D = problem.reach.reshape(3 * nodes, -1)
        return Elimination(J, inverse, weight[:, None] * (D @ B @ D.T) * weight)
    in_frame = jnp.einsum("iak,ikjl,jbl->iajb", problem.frame, B.reshape(nodes, 3, nodes, 3), problem.frame)
    return Elimination(J, inverse, weight[:, None] * in_frame.reshape(B.shape) * weight)


def response(problem: Coupled, J: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
    """J, (J A J^T)^-1, kg, and B, 1/kg: the nodes' motion by impulses at constant lengths of struts."""
    if not len(J):
        return J, jnp.zeros((0, 0), J.dtype), problem.A
    AJ = problem.A @ J.T
    own = J @ AJ
    # to a diagonal of 1, so that the ridge is the same share of the response of every strut, light or heavy;
    # in float32 rounding is more than `REDUNDANT`
    answer = jnp.diagonal(own)
    # a strut between supports answers nothing, and has no impulse
    scale = jnp.where(answer > 0, 1 / jnp.sqrt(jnp.maximum(answer, jnp.finfo(J.dtype).tiny)), 0)
    ridge = max(REDUNDANT, 10 * float(jnp.finfo(J.dtype).eps)) * jnp.eye(len(J), dtype=J.dtype)
    inverse = inverse_of(own * scale[:, None] * scale + ridge) * scale[:, None] * scale
    return J, inverse, problem.A - AJ @ inverse @ AJ.T


def rows_of_struts(problem: Coupled, w: NodeVectors | None = None) -> AnyArray:
    """J, (struts, 3 nodes): the directions of the struts at the start of the step, or at its end with velocities w."""
    nodes = len(problem.start)
    if problem.apart is None:
        return jnp.zeros((0, 3 * nodes), problem.start.dtype)
    d = problem.apart if w is None else problem.apart + edge_vectors(w, problem.edges)
    signs = np.zeros((len(problem.edges), nodes))
    for row, (i, j) in zip(signs, problem.edges):
        row[i], row[j] = 1, -1
    return (signs[:, :, None].astype(d.dtype) * (d / length(d)[:, None])[:, None]).reshape(len(signs), -1)


def units(J: AnyArray, edges: Edges) -> MemberVectors:
    """The directions themselves, (struts, 3)."""
    rows = np.arange(len(edges))
    return J.reshape(len(edges), -1, 3)[rows, np.array([i for i, _ in edges])]


def lengths_after(problem: Coupled, w: NodeVectors) -> PerMember:
    """|d| at the end of the step, over h, m/s."""
    return length(problem.apart + edge_vectors(w, problem.edges))


def contact_of(problem: Coupled, root_mass: PerNode, z: MemberVectors) -> tuple[MemberVectors, MemberVectors]:
    """w, m/s, along x, y and z, and p, N s, along normal and tangents, of trial impulses z.

    For balls w is that of the point of contact, along normal and tangents.
    """
    scale = root_mass[:, None]
    if problem.contact is None:
        return from_frames(problem, -z / scale), jnp.zeros_like(z)
    contact = scaled(problem.contact, root_mass)
    p = as_impulses(contact, z)
    # a node that is pressed on moves at c to the last bit, so that none ends the step below the ground
    pressed = z[:, 0] + contact.closing > 0
    normal = jnp.where(pressed, problem.contact.closing, -z[:, 0] / root_mass)
    w = jnp.concatenate([normal[:, None], (p - z)[:, 1:] / scale], axis=1)
    return w if problem.reach is not None else from_frames(problem, w), p * scale


def scaled(contact: Contact, root_mass: PerNode) -> Contact:
    """The contacts of velocities times the roots of the masses."""
    return contact._replace(closing=contact.closing * root_mass)


def acted_on(problem: Coupled, f: NodeVectors, p: MemberVectors) -> NodeVectors:
    """w0 + A (f + p), m/s."""
    return problem.start + moved(problem.A, f + from_frames(problem, p))


def along_struts(J: AnyArray, pulls: PerMember) -> NodeVectors:
    """J^T lambda, (nodes, 3)."""
    return (J.T @ pulls).reshape(-1, 3)


def moved(A: AnyArray, impulse: NodeVectors) -> NodeVectors:
    """A f, m/s."""
    return (A @ impulse.ravel()).reshape(impulse.shape)

"""The constraints of one step with coupled nodes: rigid struts and bodies, slides, ground, and struts that touch.

Unknown are the velocities of the independent nodes; points of bodies follow them.
"""

from typing import Any, NamedTuple, cast

import jax.numpy as jnp
import numpy as np

from jaxgrity.core.primitives import accumulate, edge_vectors, place_rows
from jaxgrity.core.types import AnyArray, MemberVectors, NodeVectors, Scalar, State
from jaxgrity.model.body_points import carrying, following, independent_nodes
from jaxgrity.model.capsules import Capsules
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.inertia import independent_mobility
from jaxgrity.model.rigidity import rigid_lengths, rigid_pairs
from jaxgrity.model.scales import length_scale, mass_scale, speed_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import lines_at, slides_of
from jaxgrity.model.surface import Frame, frame_axes
from jaxgrity.stepping.blocks import WITHOUT_GROUND
from jaxgrity.stepping.capsules import TouchingPoints, capsules_of, ends_of, of_points, weights_of
from jaxgrity.stepping.constraints import exact_ground
from jaxgrity.stepping.entering import closing_speed, contacts_met
from jaxgrity.stepping.ground_response import SLOWEST, Contact
from jaxgrity.stepping.strut_contacts import StrutContacts, TouchingStruts, points_between

NEVER = 1e6
"""Speed, m/s for a body of one metre. A node that is fixed in all directions touches the ground only if it moves down
at this speed. It never does, so the ground does not act on it."""
SLOW = 1e-2
"""Speed, m/s for a body of one metre. The tolerance of contacts is a share of the robot's largest speed plus this one,
since a robot at rest needs a tolerance too."""


class Sliding(NamedTuple):
    """The frames of lines along which nodes slide at the start of a step, two rows for each node."""

    across: MemberVectors
    """(rows, 3), n"""
    along: MemberVectors
    """(rows, 3), u"""
    ends: AnyArray
    """(rows, nodes), by how much each node moves b - a, from one node of the line to the other"""
    line: MemberVectors
    """(rows, 3), (b - a)/h, m/s"""


class Constraints(NamedTuple):
    """The constraints of one step on the independent nodes, here called nodes.

    Sliding nodes have two rows each after those of the struts.
    """

    mobility: AnyArray
    """(nodes, nodes, 3), 1/kg"""
    start: NodeVectors
    """w0, m/s: velocities without impulses"""
    ends: AnyArray
    """(struts, nodes): by how much each node moves the first end of a rigid strut against the second, or a sliding node
    against its place on the line at the start"""
    apart: Any
    """(struts, 3), (x_i - x_j)/h of the rigid struts, e/h of sliding nodes, m/s; None: there are none"""
    goal: Any
    """(struts,), L/h, or 0, m/s; likewise"""
    sliding: Sliding | None
    """None: no node slides"""
    contact: Contact | None
    """c, m/s, and mu"""
    frame: AnyArray
    """(contacts, 3, 3): the ground's normal and tangents at each node, or ball"""
    weights: AnyArray | None
    """(contacts, 3, nodes): the share of each node in the motion of a contact along its three axes; None: all nodes
    themselves touch, and nothing else does"""
    speed: AnyArray
    """m/s, of which tolerances are a share"""


class Known(NamedTuple):
    """What the state at the start of a step says of it; fields of the same name are those of `Constraints`."""

    placed: NodeVectors
    """q, m, with the points that follow others at their places"""
    contact: Contact | None
    frame: AnyArray
    weights: AnyArray | None
    between: AnyArray | None = None
    """numbers of the contacts between struts, among those of all pairs; None: there are none"""


def constraints_of(scene: Scene, times: tuple[Scalar, Scalar], known: Known, start: NodeVectors) -> Constraints:
    """The constraints of a step of size h that ends at t1 (`times`, s); `start` is w0 of all nodes, m/s."""
    (h, t1), dtype = times, start.dtype
    structure, nodes = scene.structure, moving_nodes(scene)
    own = independent_mobility(structure) if structure.mobility is None else structure.mobility
    ends, apart, goal, sliding = _links(scene, h, t1, known.placed)
    slow = jnp.asarray(SLOW * speed_scale(scene), dtype)
    return Constraints(
        own,
        start[nodes],
        ends,
        apart,
        goal,
        sliding,
        known.contact,
        known.frame,
        known.weights,
        jnp.max(jnp.abs(start)) + slow,
    )


def _links(
    scene: Scene, h: Scalar, t1: Scalar, q: NodeVectors
) -> tuple[AnyArray, AnyArray | None, AnyArray | None, Sliding | None]:
    """`ends`, `apart`, `goal` and `sliding` of the `Constraints`."""
    edges, slides = rigid_pairs(scene), slides_of(scene)
    ends = jnp.asarray(signs_of_ends(scene), q.dtype)
    if slides is None and not edges:
        return ends, None, None, None
    apart: AnyArray = jnp.zeros((0, 3), q.dtype)
    goal: AnyArray = jnp.zeros(0, q.dtype)
    if edges:
        apart, goal = edge_vectors(q, edges) / h, rigid_lengths(scene, t1) / h
    if slides is None:
        return ends, apart, goal, None
    lines = lines_at(slides, q)
    ends = jnp.concatenate([ends, on_independent(scene, lines.weights)])
    apart = jnp.concatenate([apart, lines.weights @ q / h])
    goal = jnp.concatenate([goal, jnp.zeros(len(lines.across), q.dtype)])
    moved = jnp.asarray(on_independent(scene, lines.ends), q.dtype)
    return ends, apart, goal, Sliding(lines.across, lines.along, moved, lines.line / h)


def links_on_nodes(scene: Scene, placed: NodeVectors, pulls: MemberVectors) -> NodeVectors:
    """N s, of all nodes (`Known.placed`), from impulses on rigid struts' first ends and on sliding nodes, as in
    `Impulses`."""
    edges, slides = rigid_pairs(scene), slides_of(scene)
    found = accumulate(pulls[: len(edges)], edges, len(placed)) if edges else jnp.zeros_like(placed)
    if slides is None:
        return found
    return found + lines_at(slides, placed).weights.T @ pulls[len(edges) :]


def moving_nodes(scene: Scene) -> np.ndarray:
    """The independent nodes."""
    return np.array(independent_nodes(scene.structure.bodies, len(scene.structure.nodes)))


def contact_nodes(scene: Scene) -> np.ndarray:
    """The nodes that can touch exact ground: all, or those of balls. Without ground the independent nodes are taken for
    contacts, since these are the unknowns of a solve."""
    ground = exact_ground(scene)
    if ground is None:
        return np.zeros(0, int) if points_between(scene) else moving_nodes(scene)
    return np.arange(len(scene.structure.nodes)) if ground.balls is None else np.array(ground.balls.nodes)


def velocities_of_all(scene: Scene, h: Scalar, q: NodeVectors, placed: NodeVectors, w: MemberVectors) -> NodeVectors:
    """m/s, in a step of h (s) from q (m), of all nodes, from those of the independent ones.

    What follows the basic points of a body is led back to its place (`Known.placed`), so that roundings do not add up.
    """
    nodes = moving_nodes(scene)
    if len(nodes) == len(q):
        return w
    return following(scene.structure.bodies, place_rows(w, tuple(nodes.tolist()), len(q))) + (placed - q) / h


def signs_of_ends(scene: Scene) -> AnyArray:
    """(struts, nodes): by how much each independent node moves the first end of what keeps its length against the
    second: 1 and -1 at the ends."""
    edges = np.array(rigid_pairs(scene), int).reshape(-1, 2)
    signs, rows = np.zeros((len(edges), len(scene.structure.nodes))), np.arange(len(edges))
    signs[rows, edges[:, 0]], signs[rows, edges[:, 1]] = 1, -1
    kept = signs[:, moving_nodes(scene)]
    # most join independent nodes alone, and then need no product of matrices in every step
    return kept if np.count_nonzero(kept) == 2 * len(edges) else on_independent(scene, signs)


def on_independent(scene: Scene, weights: AnyArray) -> AnyArray:
    """Weights of all nodes, (..., nodes), as weights of the independent ones."""
    if len(moving_nodes(scene)) == weights.shape[-1]:
        return weights
    return weights @ carrying(scene.structure.bodies, weights.shape[-1])


def known_at(scene: Scene, h: Scalar, state: State, touching: TouchingStruts) -> Known:
    """What is known of a step of h (s) from `state`, q (m) and v (m/s).

    `touching`: the points of struts that may touch the ground, or each other.
    """
    q, v = state
    placed = following(scene.structure.bodies, q) if scene.structure.bodies else q
    ground, structure, rows = exact_ground(scene), scene.structure, contact_nodes(scene)
    speed, size = speed_scale(scene), length_scale(scene)
    # velocities are compared with it that are multiplied by roots of masses
    least = jnp.asarray(jnp.square(SLOWEST * speed) * mass_scale(scene), q.dtype)
    axes, contact = Frame(WITHOUT_GROUND[0], WITHOUT_GROUND[1:]), None
    if ground is not None:
        never = np.where(structure.free.any(1), 0.0, NEVER).astype(q.dtype) * speed
        mu = None if scene.friction is None else jnp.asarray(scene.friction.sliding_mu)
        met, arriving = contacts_met(ground, size, h, (q, v))
        axes = met.frame
        if ground.balls is not None:
            never, mu = never[rows], mu if mu is None or mu.ndim == 0 else mu[rows]
        closing = closing_speed(ground, size, h, arriving, met)
        contact = Contact(closing - never, mu, None, least)
    columns = [jnp.broadcast_to(jnp.asarray(axis, q.dtype), (len(rows), 3)) for axis in (axes.normal, *axes.tangents)]
    frame: AnyArray = jnp.stack(columns, axis=1)
    if contact is not None and len(moving_nodes(scene)) < len(q):
        back = ((placed - q) / h)[rows]
        contact = contact._replace(closing=contact.closing - jnp.sum(frame[:, 0] * back, axis=1))
    weights = _weights_of_nodes(scene, q, frame)
    if contact is not None and touching.ground is not None:
        contact, frame, weights = _and_struts(scene, h, (q, v), touching.ground, contact, frame, weights)
    if touching.each_other is not None:
        contact = Contact(jnp.zeros(0, q.dtype), None, None, least) if contact is None else contact
        contact, frame, weights = _and_between(scene, h, touching.each_other, contact, frame, weights)
    between = None if touching.each_other is None else touching.each_other.rows
    return Known(placed, contact, frame, weights, between)


def _weights_of_nodes(scene: Scene, q: NodeVectors, frame: AnyArray) -> AnyArray | None:
    """`Constraints.weights` of nodes and balls."""
    ground, rows, nodes = exact_ground(scene), contact_nodes(scene), moving_nodes(scene)
    balls = None if ground is None else ground.balls
    if balls is None and np.array_equal(rows, nodes):
        return None
    own = jnp.asarray(carrying(scene.structure.bodies, len(q)), q.dtype)[rows]
    if balls is None:
        return jnp.stack([own] * 3, axis=1)
    # basic points are independent
    moved_with = own + balls.turning(scene.structure.bodies, q, frame[:, 0])[:, nodes]
    return jnp.stack([own, moved_with, moved_with], axis=1)


def _and_struts(
    scene: Scene,
    h: Scalar,
    start: State,
    touching: TouchingPoints,
    contact: Contact,
    frame: AnyArray,
    weights: AnyArray | None,
) -> tuple[Contact, AnyArray, AnyArray]:
    """The contacts of nodes, or balls, and after them those of struts between their ends."""
    ground, capsules, size = cast(ExactGround, scene.ground), cast(Capsules, capsules_of(scene)), length_scale(scene)
    (q, v), (i, j) = start, ends_of(capsules)
    closing = closing_speed(ground, size, h, of_points(touching, capsules, v), touching.met)
    moves = touching.found & np.asarray(scene.structure.free.any(1))[[i, j]].any(0)
    # arrays keep their shapes: a point that is not there, or cannot move, is so far away that no step closes its gap
    closing = jnp.where(moves, closing, -NEVER * speed_scale(scene))
    mu, each = contact.mu, None if scene.friction is None else jnp.asarray(scene.friction.sliding_mu)
    if each is not None and each.ndim:
        mu = jnp.concatenate([jnp.asarray(mu), each[i] + touching.share * (each[j] - each[i])])
    contact = contact._replace(closing=jnp.concatenate([contact.closing, closing]), mu=mu)
    more = weights_of(scene, touching, q)
    return contact, *_with_points(scene, frame, weights, frame_axes(touching.met.frame), more)


def _and_between(
    scene: Scene, h: Scalar, between: StrutContacts, contact: Contact, frame: AnyArray, weights: AnyArray | None
) -> tuple[Contact, AnyArray, AnyArray]:
    """The contacts with the ground, and after them those of struts with each other."""
    closing = jnp.where(between.found, -between.gap / h, -NEVER * speed_scale(scene))
    mu = contact.mu
    if scene.friction is not None and jnp.ndim(each := jnp.asarray(scene.friction.sliding_mu)):
        mu = jnp.concatenate([jnp.asarray(mu), jnp.abs(between.weights) @ each / 2])
    contact = contact._replace(closing=jnp.concatenate([contact.closing, closing.astype(frame.dtype)]), mu=mu)
    return contact, *_with_points(scene, frame, weights, between.axes, (between.weights, between.surface))


def _with_points(
    scene: Scene, frame: AnyArray, weights: AnyArray | None, axes: AnyArray, more: tuple[AnyArray, AnyArray]
) -> tuple[AnyArray, AnyArray]:
    """Frames and weights, with those of points that move by `more` of the nodes: along the normal, and tangents."""
    axis, surface = (on_independent(scene, each) for each in more)
    if weights is None:
        weights = jnp.stack([jnp.eye(axis.shape[1], dtype=frame.dtype)[: len(frame)]] * 3, axis=1)
    return jnp.concatenate([frame, axes]), jnp.concatenate([weights, jnp.stack([axis, surface, surface], axis=1)])

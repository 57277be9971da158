"""Strut lengths, Signorini's law and Coulomb's cone as constraints on the velocities of one step, met in closed form.

Sweeps over all of them (projected Gauss-Seidel) couple them. A strut's impulse reckons with what the ground will answer
at both its ends, which makes sweeps Newton steps where each node belongs to one strut.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxgrity.actuation import rest_length
from jaxgrity.friction import ConeFriction, Friction
from jaxgrity.ground import Ground, signed_distance
from jaxgrity.primitives import (
    accumulate,
    along,
    component,
    dot,
    edge_vectors,
    inverse,
    length,
    positive_part,
    scale,
    take_rows,
)
from jaxgrity.scene import Scene
from jaxgrity.types import AnyRows, Edges, MemberVectors, NodeVectors, PerNode, Rows, Scalar

SLOWEST = 1e-10
"""m/s, keeps the derivative of |v_t| finite at rest"""

HELD = 1e-2
"""of its free motion: a strut that the ground lets move by less is held at both ends"""

Impulses = tuple[PerNode, PerNode, PerNode]
"""change of a node's velocity along the ground's normal and its two tangents, m/s"""


class Grip(NamedTuple):
    """What friction lets pass of a small push on each node, along the plane: all (1), nothing (0), or part of it.

    A node that sticks does not move. One that slides moves on in its plane, its friction growing by mu times what
    presses it in; a push across its slip turns friction with it, and passes as |v_t|/(|v_t| + mu p_n).
    """

    passes: PerNode
    """along the slip"""
    turning: PerNode
    """across the slip"""
    growth: PerNode
    """mu where the node slides, else 0"""
    heading: tuple[PerNode, PerNode]
    """unit vector of the slip, in the ground's tangents"""


class Hold(NamedTuple):
    """What exact ground lets pass of a small push on each node."""

    ground: Ground
    free: PerNode
    """along the normal: 1, and 0 where the node is pressed on"""
    grip: Grip | None
    """along the plane; None without friction"""


def groups(edges: Edges) -> tuple[tuple[int, ...], ...]:
    """The rows of `edges` in groups whose members share no node, so that each group is met all at once."""
    rest, found = list(range(len(edges))), []
    while rest:
        used: set[int] = set()
        group = []
        for k in rest:
            if not used & set(edges[k]):
                group.append(k)
                used |= set(edges[k])
        rest = [k for k in rest if k not in group]
        found.append(tuple(group))
    return tuple(found)


def usual_sweeps(scene: Scene) -> int:
    """4 where each node belongs to one strut: sweeps are Newton steps then, and four leave rounding alone. 16 where
    struts share nodes, and each sweep leaves about half of the error."""
    struts = scene.structure.struts
    return 4 if struts is None or len(groups(struts.edges)) == 1 else 16


def prepare(scene: Scene, h: Scalar, t1: Scalar, q: NodeVectors, v: NodeVectors) -> dict[str, Any]:
    """What stays the same through a step's sweeps: directions, lengths L(t1), the velocity that closes each gap."""
    problem: dict[str, Any] = {"inverse_mass": 1 / scene.structure.node_mass}
    struts, ground = scene.structure.struts, scene.ground
    if struts is not None and struts.rigid:
        vectors = problem["vectors"] = edge_vectors(q, struts.edges)
        directions = scale(vectors, inverse(length(vectors)))
        problem["pushes"] = [
            _push(struts.edges, rows, directions, problem["inverse_mass"]) for rows in groups(struts.edges)
        ]
        problem["lengths"] = rest_length(struts, scene.gait, t1, 0)
    if ground is not None and ground.exact:
        phi = signed_distance(ground, q)
        closing = -phi / h
        if ground.restitution is not None:
            approach = component(v, ground.normal)
            hits = ((phi + h * approach < 0) & (approach < 0)).astype(phi.dtype)
            closing = jnp.maximum(closing, -ground.restitution * approach * hits + closing * (1 - hits))
        problem["closing"] = closing
    return problem


def sweep(
    scene: Scene, h: Scalar, problem: dict[str, Any], w: NodeVectors, impulses: Impulses
) -> tuple[NodeVectors, Impulses]:
    """One pass over all constraints: each group of struts to its length, and after each every node onto the ground."""
    struts = scene.structure.struts
    ground = scene.ground if scene.ground is not None and scene.ground.exact else None
    if struts is None or not struts.rigid:
        return (w, impulses) if ground is None else _onto_ground(ground, scene.friction, problem, w, impulses)
    for rows, push in zip(groups(struts.edges), problem["pushes"]):
        hold = None if ground is None else _hold(ground, scene.friction, w, impulses)
        w = _to_length(struts.edges, h, problem, w, rows, push, hold)
        if ground is not None:
            w, impulses = _onto_ground(ground, scene.friction, problem, w, impulses)
    return w, impulses


def length_error(scene: Scene, h: Scalar, problem: dict[str, Any], w: NodeVectors) -> Scalar:
    """How far the rigid struts will be from their lengths at the end of the step, at most, m."""
    struts = scene.structure.struts
    if struts is None or not struts.rigid:
        return jnp.zeros_like(w[0, 0])
    return jnp.max(jnp.abs(length(problem["vectors"] + h * edge_vectors(w, struts.edges)) - problem["lengths"]))


def _push(edges: Edges, rows: tuple[int, ...], directions: MemberVectors, inverse_mass: PerNode) -> NodeVectors:
    """How an impulse of 1 along each strut in `rows` moves its nodes, where nothing answers."""
    along_struts = accumulate(_some(directions, rows), tuple(edges[k] for k in rows), len(inverse_mass))
    return scale(along_struts, inverse_mass)


def _some(x: AnyRows, rows: tuple[int, ...]) -> Rows:
    """The chosen rows of `x`; `x` itself where these are all."""
    return x if rows == tuple(range(len(x))) else take_rows(x, rows)


def _to_length(
    every: Edges,
    h: Scalar,
    problem: dict[str, Any],
    w: NodeVectors,
    rows: tuple[int, ...],
    push: NodeVectors,
    hold: Hold | None,
) -> NodeVectors:
    """Impulses along the struts in `rows` after which |d| = L at the end of the step, exactly.

    With d = x_i - x_j at the end, and an impulse of 1 along the strut moving it by m (with what the ground answers),
    |d + s m| = L has the root s = (sqrt((d·m)^2 - m·m (d·d - L^2)) - d·m)/(m·m), also where forces alone would have
    turned the strut around.
    """
    edges = tuple(every[k] for k in rows)
    vectors, lengths = _some(problem["vectors"], rows), _some(problem["lengths"], rows)
    d = vectors + h * edge_vectors(w, edges)
    m = edge_vectors(push, edges)
    if hold is not None:
        m = _unless_held(edge_vectors(_response(hold, push), edges), m)
    d_m, m_m, excess = dot(d, m), dot(m, m), dot(d, d) - lengths * lengths
    under = d_m * d_m - m_m * excess
    root = jnp.sqrt(jnp.maximum(under, jnp.finfo(under.dtype).tiny))
    # the same root in the form that does not cancel
    s = jnp.where(d_m > 0, -excess / (jnp.abs(d_m) + root), (root - d_m) / m_m)
    strut_of = {node: k for k, edge in enumerate(edges) for node in edge}
    return w + scale(push, take_rows(s / h, tuple(strut_of.get(node, 0) for node in range(len(w)))))


def _unless_held(answered: MemberVectors, free: MemberVectors) -> MemberVectors:
    """How struts move, and as if they were free where the ground holds both their ends."""
    moves = (dot(answered, answered) > HELD * HELD * dot(free, free)).astype(free.dtype)
    return scale(answered, moves) + scale(free, 1 - moves)


def _hold(ground: Ground, friction: Friction | None, w: NodeVectors, impulses: Impulses) -> Hold:
    """How the ground holds each node now: what it lets pass of a small push."""
    pressed, *kept = impulses
    free = 1 - (pressed > 0).astype(pressed.dtype)
    if not isinstance(friction, ConeFriction):
        return Hold(ground, free, None)
    most = friction.mu * pressed
    size, speed = _size(kept), _size([component(w, tangent) for tangent in ground.tangents])
    sliding = (1 - free) * (size > (1 - 1e-6) * most).astype(size.dtype)
    turning = free + sliding * speed / (speed + most)
    back = -1 / size
    return Hold(ground, free, Grip(free + sliding, turning, sliding * friction.mu, (kept[0] * back, kept[1] * back)))


def _response(hold: Hold, push: NodeVectors) -> NodeVectors:
    """How the ground lets nodes move that would move by `push` without it."""
    ground = hold.ground
    into = component(push, ground.normal)
    sideways = [component(push, tangent) for tangent in ground.tangents]
    if hold.grip is not None:
        passes, turning, growth, heading = hold.grip
        forward = heading[0] * sideways[0] + heading[1] * sideways[1]
        change = (passes - turning) * forward + growth * into
        sideways = [turning * s + change * e for s, e in zip(sideways, heading)]
    moves = along(into * hold.free, ground.normal)
    return moves + along(sideways[0], ground.tangents[0]) + along(sideways[1], ground.tangents[1])


def _size(pair: list[PerNode]) -> PerNode:
    """Of a vector in the plane, with a finite derivative at 0."""
    return jnp.sqrt(pair[0] * pair[0] + pair[1] * pair[1] + SLOWEST * SLOWEST)


def _onto_ground(
    ground: Ground, friction: Friction | None, problem: dict[str, Any], w: NodeVectors, impulses: Impulses
) -> tuple[NodeVectors, Impulses]:
    """Signorini: p_n >= 0 and w_n >= -phi/h, one of them an equality. Coulomb: |p_t| <= mu p_n, sticking if it can."""
    normal, *tangential = impulses
    pressed = positive_part(normal + problem["closing"] - component(w, ground.normal))
    w = w + along(pressed - normal, ground.normal)
    if not isinstance(friction, ConeFriction):
        return w, (pressed, impulses[1], impulses[2])
    held = [p - component(w, tangent) for p, tangent in zip(tangential, ground.tangents)]
    share = jnp.minimum(1, friction.mu * pressed / _size(held))
    kept = [share * p for p in held]
    for new, old, tangent in zip(kept, tangential, ground.tangents):
        w = w + along(new - old, tangent)
    return w, (pressed, kept[0], kept[1])

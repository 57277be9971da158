"""Strut lengths, Signorini's law and Coulomb's cone as constraints on the velocities of one step, met in closed form.

Sweeps over all of them (projected Gauss-Seidel) couple them. A strut's impulse allows for what the ground will answer
at both its ends, which makes sweeps Newton steps where each node belongs to one strut.
"""

from typing import NamedTuple, cast

import jax.numpy as jnp

from jaxgrity.core.primitives import (
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
from jaxgrity.core.types import (
    AnyRows,
    Edges,
    MemberVectors,
    NodeVectors,
    PerMember,
    PerNode,
    Rows,
    Scalar,
)
from jaxgrity.model.actuation import rest_length
from jaxgrity.model.friction import Friction
from jaxgrity.model.ground import ExactGround, Ground
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members
from jaxgrity.stepping.ground_response import (
    GroundImpulses,
    GroundResponse,
    answered,
    ground_response,
    size_in_plane,
)

HELD = 1e-2
"""fraction of its free motion below which a strut counts as held by the ground at both ends"""


class StepProblem(NamedTuple):
    """What stays the same through a step's sweeps; None where the scene has no such constraint."""

    inverse_mass: PerNode
    """1/kg"""
    vectors: MemberVectors | None
    """x_i - x_j of the rigid struts at the start of the step, m"""
    pushes: tuple[NodeVectors, ...]
    """for each group of struts, how an impulse of 1 along each of them moves its nodes, 1/kg"""
    lengths: PerMember | None
    """L(t1) of the rigid struts, m"""
    closing: PerNode | None
    """the normal velocity at which a node reaches the ground in this step, or leaves it by restitution, m/s"""


class LengthError(NamedTuple):
    """How far the rigid struts will be from their lengths at the end of the step, at most."""

    largest: Scalar
    """m"""
    relative: Scalar
    """of the length of the strut that it is largest for, in proportion"""


def disjoint_groups(edges: Edges) -> tuple[tuple[int, ...], ...]:
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


def rigid_struts(scene: Scene) -> Members | None:
    """The scene's struts where they are constraints."""
    struts = scene.structure.struts
    return struts if struts is not None and struts.rigid else None


def exact_ground(scene: Scene) -> ExactGround | None:
    """The scene's ground where it is a constraint."""
    return cast(ExactGround, scene.ground) if scene.ground is not None and scene.ground.impulsive else None


def usual_sweeps(scene: Scene) -> int:
    """4 where each node belongs to one strut, so that sweeps are Newton steps; 16 where struts share nodes.

    What four sweeps leave of the constraints is rounding on the robots of this library at their default steps. Struts
    that slide flat over rough ground, very unequal masses and chains of struts need more: see `docs/numerics.md`.
    """
    struts = scene.structure.struts
    return 4 if struts is None or len(disjoint_groups(struts.edges)) == 1 else 16


def prepare(scene: Scene, h: Scalar, t1: Scalar, q: NodeVectors, v: NodeVectors) -> StepProblem:
    """The problem of a step of size h (s) that ends at t1, from positions `q` (m) and velocities `v` (m/s)."""
    inverse_mass = 1 / scene.structure.node_mass
    struts, ground = rigid_struts(scene), exact_ground(scene)
    vectors = lengths = closing = None
    pushes: tuple[NodeVectors, ...] = ()
    if struts is not None:
        vectors = edge_vectors(q, struts.edges)
        directions = scale(vectors, inverse(length(vectors)))
        pushes = tuple(_push(struts.edges, rows, directions, inverse_mass) for rows in disjoint_groups(struts.edges))
        lengths = rest_length(struts, scene.gait, t1, 0)
    if ground is not None:
        closing = _closing(ground, h, q, v)
    return StepProblem(inverse_mass, vectors, pushes, lengths, closing)


def _closing(ground: ExactGround, h: Scalar, q: NodeVectors, v: NodeVectors) -> PerNode:
    phi = ground.signed_distance(q)
    closing = -phi / h
    if ground.restitution is None:
        return closing
    approach = component(v, ground.normal)
    hits = ((phi + h * approach < 0) & (approach < 0)).astype(phi.dtype)
    return jnp.maximum(closing, -ground.restitution * approach * hits + closing * (1 - hits))


def sweep(
    scene: Scene, h: Scalar, problem: StepProblem, w: NodeVectors, impulses: GroundImpulses
) -> tuple[NodeVectors, GroundImpulses]:
    """One pass over all constraints: each group of struts to its length, and after each every node onto the ground."""
    struts, ground = rigid_struts(scene), exact_ground(scene)
    if struts is None:
        return (w, impulses) if ground is None else _onto_ground(ground, scene.friction, problem, w, impulses)
    for rows, push in zip(disjoint_groups(struts.edges), problem.pushes):
        response = None if ground is None else ground_response(ground, scene.friction, w, impulses)
        w = _to_length(struts.edges, h, problem, w, rows, push, response)
        if ground is not None:
            w, impulses = _onto_ground(ground, scene.friction, problem, w, impulses)
    return w, impulses


def length_error(scene: Scene, h: Scalar, problem: StepProblem, w: NodeVectors) -> LengthError:
    """Of rigid struts, at the end of a step of size h (s) with velocities `w` (m/s)."""
    struts = rigid_struts(scene)
    if struts is None:
        none = jnp.zeros_like(w[0, 0])
        return LengthError(none, none)
    assert problem.vectors is not None, "`prepare` sets it where struts are rigid"
    assert problem.lengths is not None, "`prepare` sets it where struts are rigid"
    off = jnp.abs(length(problem.vectors + h * edge_vectors(w, struts.edges)) - problem.lengths)
    return LengthError(jnp.max(off), jnp.max(off / problem.lengths))


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
    problem: StepProblem,
    w: NodeVectors,
    rows: tuple[int, ...],
    push: NodeVectors,
    response: GroundResponse | None,
) -> NodeVectors:
    """Impulses along the struts in `rows` after which |d| = L at the end of the step, exactly.

    With d = x_i - x_j at the end, and an impulse of 1 along the strut moving it by m (with what the ground answers),
    |d + s m| = L has the root s = (sqrt((d·m)^2 - m·m (d·d - L^2)) - d·m)/(m·m), also where forces alone would have
    turned the strut around.
    """
    edges = tuple(every[k] for k in rows)
    assert problem.vectors is not None, "`prepare` sets it where struts are rigid"
    assert problem.lengths is not None, "`prepare` sets it where struts are rigid"
    vectors, lengths = _some(problem.vectors, rows), _some(problem.lengths, rows)
    d = vectors + h * edge_vectors(w, edges)
    m = edge_vectors(push, edges)
    if response is not None:
        m = _unless_held(edge_vectors(answered(response, push), edges), m)
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


def _onto_ground(
    ground: Ground, friction: Friction | None, problem: StepProblem, w: NodeVectors, impulses: GroundImpulses
) -> tuple[NodeVectors, GroundImpulses]:
    """Signorini: p_n >= 0 and w_n >= -phi/h, one of them an equality. Coulomb: |p_t| <= mu p_n, sticking if it can."""
    normal, tangential = impulses
    assert problem.closing is not None, "`prepare` sets it where the ground is exact"
    pressed = positive_part(normal + problem.closing - component(w, ground.normal))
    w = w + along(pressed - normal, ground.normal)
    if friction is None:
        return w, GroundImpulses(pressed, tangential)
    down, level = ground.tangents
    held = (tangential[0] - component(w, down), tangential[1] - component(w, level))
    share = jnp.minimum(1, friction.sliding_mu * pressed / size_in_plane(held))
    kept = (share * held[0], share * held[1])
    for new, old, tangent in zip(kept, tangential, ground.tangents):
        w = w + along(new - old, tangent)
    return w, GroundImpulses(pressed, kept)

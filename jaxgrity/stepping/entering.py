"""Where exact ground is linearised in a step: at the face that a node enters first, or where it is about to be."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxgrity.core.primitives import component
from jaxgrity.core.types import AnyArray, NodeVectors, PerNode, Scalar, State
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.surface import Frame, Surface, coordinates, rows_of_xyz

INSIDE = 1e-9
"""m, of a body of one metre: from which depth on a node is in the ground, and where the nearest face is the one that it
came through"""
ROUNDINGS = 16
"""the same in roundings of its length, where these are more"""
TRIALS = 16
"""places within a node's way at which the ground is looked at, at most, to find where it enters; most need two"""
FOUND = 4
"""times as deep as where the inside begins, a place is where the node enters"""


class Met(NamedTuple):
    """Where exact ground is linearised in a step, of each node."""

    at: NodeVectors
    """m"""
    share: PerNode | float
    """of the node's way in the step, from its start"""


def where_met(ground: ExactGround, size: Scalar, h: Scalar, q: NodeVectors, v: NodeVectors) -> Met:
    """Where exact ground is linearised in a step of h (s) from q (m) with v (m/s).

    `size` is that of the body (`length_scale`). On the plane at the nodes. On uneven ground where they would be after
    the step: there the gap's error is of the second order in what the step changes of their ways, and a node that
    stands meets the wall that it runs into. A node whose way leads into ground with edges meets it where it enters:
    farther on another face may be nearer.
    """
    if ground.surface is None:
        return Met(q, 0.0)
    if ground.surface.smooth:
        return Met(q + h * v, 1.0)
    start, way = coordinates(q if ground.offset is None else q - ground.offset), coordinates(h * v)
    share = _share(ground.surface, size, start, way)
    return Met(q + rows_of_xyz(*(share * a for a in way)), share)


def frame_met(ground: ExactGround, size: Scalar, h: Scalar, start: State) -> Frame:
    """Normal and tangents where each node meets the ground in that step."""
    return ground.frame(where_met(ground, size, h, *start).at)


def closing_speed(ground: ExactGround, frame: Frame, h: Scalar, v: NodeVectors, met: Met) -> PerNode:
    """The normal velocity (m/s) at which each node reaches the ground in a step of size h (s), or leaves it.

    The ground is the plane with this `frame` where it is `met`.
    """
    phi = ground.signed_distance(met.at)
    if ground.surface is not None:
        phi = phi - h * component(v, frame.normal) * met.share
    closing = -phi / h
    if ground.restitution is None:
        return closing
    approach = component(v, frame.normal)
    hits = ((phi + h * approach < 0) & (approach < 0)).astype(phi.dtype)
    return jnp.maximum(closing, -ground.restitution * approach * hits + closing * (1 - hits))


class _Place(NamedTuple):
    """Of each node a place along its way."""

    s: PerNode
    """share of the way"""
    f: PerNode
    """m, the level there, and the depth from which on a node is inside: negative in the ground"""


class _Bracket(NamedTuple):
    """What is known of each node's way."""

    before: _Place
    """outside, before the next"""
    out: _Place
    """the last place that is known outside"""
    inside: _Place
    """the first inside, or the end of the way"""
    trials: Any
    """how many places between were looked at"""


@jax.custom_jvp
def _share(surface: Surface, size: Scalar, start: tuple[PerNode, ...], way: tuple[PerNode, ...]) -> PerNode:
    """The share of each node's way at which it is just inside; 1 where it does not enter, or was inside before.

    From two places outside a secant leads on. It never passes the first root in a convex body, whose distance is convex
    along a line; the first secant falls as fast as any distance can. Where one leads nowhere, along a face, the bracket
    about the root is halved.
    """
    deep = _depth(size, start[0].dtype)
    at = lambda s: _Place(s, surface.level(*(x + s * a for x, a in zip(start, way))) + deep)  # noqa: E731
    first, last = at(0 * start[0]), at(1 + 0 * start[0])
    fastest = _Place(first.s - 1, first.f + jnp.sqrt(sum(a * a for a in way)))

    def goes_on(known: _Bracket) -> AnyArray:
        return jnp.any(_next(known, deep)[1]) & (known.trials < TRIALS)

    def tried(known: _Bracket) -> _Bracket:
        s, searched = _next(known, deep)
        new = at(s)
        enters, stays = searched & (new.f < 0), searched & (new.f >= 0)
        before, out = _where(stays, known.out, known.before), _where(stays, new, known.out)
        return _Bracket(before, out, _where(enters, new, known.inside), known.trials + 1)

    inside = jax.lax.while_loop(goes_on, tried, _Bracket(fastest, first, last, 0)).inside
    return jnp.where((first.f >= 0) & (inside.f < 0), inside.s, 1)


def _depth(size: Scalar, dtype: Any) -> Scalar:
    return jnp.asarray(size * max(INSIDE, ROUNDINGS * float(jnp.finfo(dtype).eps)), dtype)


def _next(known: _Bracket, deep: Scalar) -> tuple[PerNode, AnyArray]:
    """The share at which to look next, and of which nodes anything is left to find."""
    before, out, inside, _ = known
    falls = before.f - out.f
    ahead = out.s + (out.f + deep) * (out.s - before.s) / jnp.where(falls > 0, falls, 1)
    leads = (falls > 0) & (ahead > out.s) & (ahead < inside.s)
    found = (inside.f < 0) & (inside.f > -FOUND * deep)
    s = jnp.where(leads, ahead, (out.s + inside.s) / 2)
    return s, (out.f >= 0) & (leads | (inside.f < 0)) & ~found


def _where(condition: AnyArray, one: _Place, other: _Place) -> _Place:
    return _Place(*(jnp.where(condition, a, b) for a, b in zip(one, other)))


@_share.defjvp
def _share_jvp(primals, tangents):
    """The root's: what the level gains where the share is held, over how fast it falls along the way."""
    s = _share(*primals)
    level = lambda surface, _size, start, way, s: surface.level(*(x + s * a for x, a in zip(start, way)))  # noqa: E731
    _, gains = jax.jvp(lambda *held: level(*held, s), primals, tangents)
    _, slope = jax.jvp(lambda s: level(*primals, s), (s,), (jnp.ones_like(s),))
    found = (s < 1) & (slope < 0)
    return s, jnp.where(found, gains, 0) / jnp.where(found, -slope, 1)

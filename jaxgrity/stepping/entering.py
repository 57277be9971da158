"""Where exact ground is linearised in a step: at the face that a node enters first, or where it is about to be."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxgrity.core.primitives import component
from jaxgrity.core.types import AnyArray, NodeVectors, PerNode, Scalar
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.surface import Frame, Surface, coordinates, rows_of_xyz

INSIDE = 1e-9
"""m, from which depth on a node is in the ground: at it the nearest face is the one that the node came through"""
ROUNDINGS = 16
"""the same in roundings of 1 m, where these are more"""
TRIALS = 6
"""places along a node's way at which the ground is looked at, to find where it enters: faces need two or three"""


def linearised_at(ground: ExactGround, h: Scalar, q: NodeVectors, v: NodeVectors) -> NodeVectors:
    """Where exact ground is linearised in a step of size h (s) from q with v, m.

    On the plane at the nodes. On uneven ground where they would be after the step: there the gap's error is of the
    second order in what the step changes of their ways, and a node that stands meets the wall that it runs into. A node
    whose way leads into ground with edges meets it where it enters: farther on another face may be nearer.
    """
    if ground.surface is None:
        return q
    way = h * v
    return q + way if ground.surface.smooth else _entries(ground, q, way)


def closing_speed(
    ground: ExactGround, frame: Frame, h: Scalar, q: NodeVectors, v: NodeVectors, at: NodeVectors
) -> PerNode:
    """The normal velocity (m/s) at which each node reaches the ground in a step of size h (s), or leaves it.

    The ground is the plane with this `frame` that touches the surface's level at `at`, as `linearised_at` has it.
    """
    phi = ground.signed_distance(at)
    if ground.surface is not None:
        phi = phi - component(at - q, frame.normal)
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
    """m, the level there, and `INSIDE` more: negative in the ground"""
    slope: PerNode
    """m, df/ds"""


def _entries(ground: ExactGround, q: NodeVectors, way: NodeVectors) -> NodeVectors:
    """Where each node enters the ground on its way; its end, where the node does not enter, or was inside before."""
    assert ground.surface is not None, "the plane needs no search"
    start, along = coordinates(q if ground.offset is None else q - ground.offset), coordinates(way)
    s = _first(*jax.lax.stop_gradient((ground.surface, start, along)))
    # Newton's step from a root changes nothing but the derivative, which is the root's
    here = _at(ground.surface, start, along, s)
    before = jax.lax.stop_gradient(here)
    s = s + jnp.where(s < 1, _ahead(before._replace(s=0 * s), here.f - before.f), 0)
    return q + rows_of_xyz(*(s * a for a in along))


def _first(surface: Surface, start: tuple[PerNode, ...], way: tuple[PerNode, ...]) -> PerNode:
    """The share of the way at which a node is just inside; 1 where it does not enter.

    Newton's method from outside never passes the first root in a convex body, whose distance is convex along a line.
    Where it does, between bodies, or leads nowhere, along a face, it starts from inside, or halves the bracket.
    """
    out, inside = (_at(surface, start, way, share + 0 * start[0]) for share in (0.0, 1.0))
    began_outside, deep = out.f >= 0, _inside(start[0])
    for _ in range(TRIALS):
        entered = inside.f < 0
        ahead, back = _ahead(out, out.f + deep), _ahead(inside, inside.f + deep)
        otherwise = jnp.where(_between(out, back, inside), back, (out.s + inside.s) / 2)
        s = jnp.where(_between(out, ahead, inside), ahead, jnp.where(entered, otherwise, inside.s))
        tried = _at(surface, start, way, s)
        is_in = tried.f < 0
        out = _Place(*(jnp.where(is_in, old, new) for old, new in zip(out, tried)))
        inside = _Place(*(jnp.where(is_in, new, old) for old, new in zip(inside, tried)))
    return jnp.where(began_outside & (inside.f < 0), inside.s, 1)


def _at(surface: Surface, start: tuple[PerNode, ...], way: tuple[PerNode, ...], s: PerNode) -> _Place:
    f, slope = jax.jvp(surface.level, tuple(x + s * a for x, a in zip(start, way)), way)
    return _Place(s, f + _inside(s), slope)


def _inside(like: PerNode) -> float:
    return max(INSIDE, ROUNDINGS * float(jnp.finfo(like.dtype).eps))


def _ahead(place: _Place, f: PerNode) -> PerNode:
    """The share at which the level is lower by `f`, m, by its slope; where it does not fall, none that counts."""
    falls = place.slope < 0
    return place.s - jnp.where(falls, f, 0) / jnp.where(falls, place.slope, -1)


def _between(out: _Place, s: PerNode, inside: _Place) -> AnyArray:
    return (s > out.s) & (s < inside.s)

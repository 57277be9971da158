"""What the ground lets pass of a small push on each node: the answer that the impulses of rigid struts allow for."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxgrity.core.primitives import along, component
from jaxgrity.core.types import AnyNodeVectors, NodeVectors, PerNode
from jaxgrity.model.friction import Friction
from jaxgrity.model.ground import Ground

SLOWEST = 1e-10
"""m/s, keeps the derivative of |v_t| finite at rest"""


class GroundImpulses(NamedTuple):
    """Change of each node's velocity by the ground, m/s."""

    normal: PerNode
    """p_n >= 0, along the ground's normal"""
    tangential: tuple[PerNode, PerNode]
    """p_t, along its two tangents"""


class FrictionResponse(NamedTuple):
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


class GroundResponse(NamedTuple):
    """What exact ground lets pass of a small push on each node."""

    ground: Ground
    free: PerNode
    """along the normal: 1, and 0 where the node is pressed on"""
    friction: FrictionResponse | None
    """along the plane; None without friction"""


def no_impulses(v: AnyNodeVectors) -> GroundImpulses:
    """Those of a ground that nothing touches, for velocities (nodes, 3), or (nodes, 3, population)."""
    none = jnp.zeros_like(v[:, 0])
    return GroundImpulses(none, (none, none))


def ground_response(
    ground: Ground, friction: Friction | None, w: NodeVectors, impulses: GroundImpulses
) -> GroundResponse:
    """What the ground lets pass now of a small push on each node."""
    pressed, kept = impulses
    free = 1 - (pressed > 0).astype(pressed.dtype)
    if friction is None:
        return GroundResponse(ground, free, None)
    mu, (down, level) = friction.sliding_mu, ground.tangents
    most = mu * pressed
    size, speed = size_in_plane(kept), size_in_plane((component(w, down), component(w, level)))
    sliding = (1 - free) * (size > (1 - 1e-6) * most).astype(size.dtype)
    turning = free + sliding * speed / (speed + most)
    back = -1 / size
    heading = (kept[0] * back, kept[1] * back)
    return GroundResponse(ground, free, FrictionResponse(free + sliding, turning, sliding * mu, heading))


def answered(response: GroundResponse, push: NodeVectors) -> NodeVectors:
    """How the ground lets nodes move that would move by `push` without it."""
    ground = response.ground
    into = component(push, ground.normal)
    sideways = [component(push, tangent) for tangent in ground.tangents]
    if response.friction is not None:
        passes, turning, growth, heading = response.friction
        forward = heading[0] * sideways[0] + heading[1] * sideways[1]
        change = (passes - turning) * forward + growth * into
        sideways = [turning * s + change * e for s, e in zip(sideways, heading)]
    moves = along(into * response.free, ground.normal)
    return moves + along(sideways[0], ground.tangents[0]) + along(sideways[1], ground.tangents[1])


def size_in_plane(pair: tuple[PerNode, PerNode]) -> PerNode:
    """Of a vector in the plane, with a finite derivative at 0."""
    return jnp.sqrt(pair[0] * pair[0] + pair[1] * pair[1] + SLOWEST * SLOWEST)

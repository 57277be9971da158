"""Derivatives through the times of impacts with restitution (saltation).

A step gives the whole impulse of a bounce, whenever in the step it is. So a derivative through such a step has no trace
of the impact's time, while the motion in continuous time has one. An impact that comes later by dt leaves (v - w) dt in
the positions, with v the velocities before it and w those after it, and likewise a difference in the velocities. M. A.
Aizerman and F. R. Gantmakher 1958, doi:10.1093/qjmam/11.4.525.

Here such a step gets the derivative of the motion in continuous time. It leads along the motion before the impact to
its time, through the step, and back along the motion after it. Values do not change.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.dense import least_solution
from jaxgrity.core.elementwise import derived_as
from jaxgrity.core.primitives import dot, edge_vectors, inverse, length, scale
from jaxgrity.core.types import AnyArray, Edges, NodeVectors, PerNode, Scalar, State
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.rigidity import rigid_lengths, rigid_pairs
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import lines_at, slides_of
from jaxgrity.stepping.constraints import exact_ground
from jaxgrity.stepping.entering import HARD, landings, where_met

PASSING = -1e3
"""Restitution with which nodes pass through the ground: one that arrives may get a thousand times as fast in a step."""


def impact_times(scene: Scene, h: Scalar, start: State, accelerations: NodeVectors) -> PerNode:
    """s since the start of a step of h (s): the time of the hard impact that sets each node in motion; 0 without one.

    `accelerations` (m/s^2) are those before the impacts.
    """
    (q, v), ground, size = start, cast(ExactGround, exact_ground(scene)), length_scale(scene)
    gap, approach, arrives = landings(ground, size, h, v, where_met(ground, size, h, q, v))
    gained = h * length(accelerations)
    speed = jnp.where(arrives & _may_touch(scene, ground) & (-approach > HARD * gained), -approach, 0)
    # two ends of a rod share one time, the mean by speed: of impacts in one step the order is not known
    together = _moving_together(scene)
    speeds = together @ speed
    return together @ jnp.where(speed > 0, gap, 0) / jnp.where(speeds > 0, speeds, 1)


def moved_on(
    scene: Scene, ends: tuple[Scalar, Scalar], times: PerNode, state: State, accelerations: NodeVectors
) -> State:
    """The state, with its derivative along the motion for `times` (s), node by node.

    It is that at the first of `ends` (s), of a step that leads to the second.
    """
    q, v = state
    along = jax.lax.stop_gradient(_turning(scene, ends, q, v))
    return derived_as(q, q + scale(along, times)), derived_as(v, v + scale(accelerations, times))


def without_bounces(scene: Scene) -> Scene:
    """The scene whose nodes pass through the ground where they would bounce. No derivative leads through it."""
    held = jax.tree.map(lambda x: jax.lax.stop_gradient(x) if eqx.is_inexact_array(x) else x, scene)
    return eqx.tree_at(lambda s: s.ground.restitution, held, 0 * held.ground.restitution + PASSING)  # type: ignore[union-attr]


def _may_touch(scene: Scene, ground: ExactGround) -> AnyArray:
    """(nodes,): whether the ground can act on it."""
    touching = np.asarray(scene.structure.free).any(axis=1)
    if ground.balls is None:
        return cast(np.ndarray, touching)
    return touching & np.isin(np.arange(len(scene.structure.free)), ground.balls.nodes)


def _moving_together(scene: Scene) -> AnyArray:
    """(nodes, nodes): 1 where an impulse on one node changes the velocity of the other at once, else 0."""
    joined = tuple(edge for _, edges in scene.structure.rod_masses for edge in edges)
    nodes, slides = scene.structure.nodes, slides_of(scene)
    if slides is not None:
        joined += tuple((node, end) for node, pair in zip(slides.nodes, slides.along) for end in pair)
    return jnp.asarray(_connected(rigid_pairs(scene) + joined, nodes.shape[0]), nodes.dtype)


@lru_cache
def _connected(edges: Edges, nodes: int) -> np.ndarray:
    found = np.eye(nodes, dtype=bool)
    for edge in edges:
        found[np.ix_(edge, edge)] = True
    while (more := found @ found).sum() > found.sum():
        found = more
    return found


def _turning(scene: Scene, ends: tuple[Scalar, Scalar], q: NodeVectors, v: NodeVectors) -> NodeVectors:
    """Velocities (m/s) without the part that changes the lengths of rigid struts, or leads sliding nodes off lines.

    A step sets these at its end, whenever the impact is. The rates by which actuated struts change them in the step are
    those of the impact's time all the same: lengths at the start differ by so much.
    """
    edges, slides = rigid_pairs(scene), slides_of(scene)
    parts: list[Callable[[NodeVectors], AnyArray]] = []
    wanted: AnyArray = jnp.zeros(0, q.dtype)
    if edges:
        d = edge_vectors(q, edges)
        units = scale(d, inverse(length(d)))
        parts.append(lambda v: dot(units, edge_vectors(v, edges)))
        first, last = (jax.jvp(lambda t: rigid_lengths(scene, t), (t,), (jnp.ones_like(t),))[1] for t in ends)
        wanted = last - first
    if slides is not None:
        lines = lines_at(slides, q)
        parts.append(lambda v: jnp.sum(lines.across * (lines.weights @ v), axis=1))
        wanted = jnp.concatenate([wanted, jnp.zeros(len(lines.across), q.dtype)])
    if not parts:
        return v
    rates = lambda v: jnp.concatenate([part(v) for part in parts])  # noqa: E731
    matrix = jax.jacfwd(rates)(jnp.zeros_like(v)).reshape(len(wanted), -1)
    return v - least_solution(matrix, rates(v) + wanted).reshape(v.shape)

"""The impulses of exact ground on nodes in a step, and their work."""

from typing import Any, cast

import jax.numpy as jnp

from jaxgrity.core.primitives import along, dot, inner, scale
from jaxgrity.core.types import NodeVectors, Scalar, State
from jaxgrity.model.balls import acting_on_nodes
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.capsules import on_ends
from jaxgrity.stepping.constraints import GroundImpulses, exact_ground
from jaxgrity.stepping.entering import frame_met

ROUNDINGS = 100
"""Work of the ground's impulses counts as none up to this many roundings of twice the kinetic energy."""


def on_nodes(scene: Scene, h: Scalar, start: State, found: GroundImpulses) -> list[NodeVectors]:
    """The impulses of exact ground on each node, N s, in a step of size h (s): along the normal and both tangents."""
    ground = cast(ExactGround, exact_ground(scene))
    frame = frame_met(ground, length_scale(scene), h, start)
    speeds, directions = (found.normal, *found.tangential), (frame.normal, *frame.tangents)
    forces = [scale(along(p, n), scene.structure.borne_mass) for p, n in zip(speeds, directions)]
    forces = acting_on_nodes(ground.balls, scene.structure.bodies, start[0], frame.normal, forces)
    if found.along_struts is None:
        return forces
    return [x + y for x, y in zip(forces, on_ends(scene, h, start, found.along_struts))]


def bounce_gains(scene: Scene, h: Scalar, start: State, w: NodeVectors, found: GroundImpulses) -> Any:
    """Whether the ground did work on a robot that had v before and has w after its impulses: p·(v + w)/2 > 0.

    Newton's law prescribes normal velocities, and friction acts against w. Where sliding is reversed, both can create
    energy (Kane and Levinson 1985).
    """
    work = sum(inner(jnp.ones_like(w[:, 0]), dot(p, (start[1] + w) / 2)) for p in on_nodes(scene, h, start, found))
    turned_over = inner(scene.structure.borne_mass, dot(start[1], start[1]))
    return work > ROUNDINGS * jnp.finfo(w.dtype).eps * turned_over

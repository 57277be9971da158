"""Which nodes touch the ground, and the radius of the ball about each: feet, end caps, wheels.

A ball that belongs to a body with four basic points turns with it. It touches the ground at x - r n, which moves as
that point of the body, so that the ball can roll. Any other ball slides: rods and single nodes do not turn it.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_each, is_count
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, NodeVectors, PerNode, PerRow, as_float, namespace_of
from jaxgrity.model.bodies import Bodies, Body
from jaxgrity.model.rods import Carriers, moved_beside
from jaxgrity.model.surface import Direction, Surface


class Balls(eqx.Module):
    """The nodes that can touch the ground, and how far from it they then are. Others pass through it.

    Raises `InputError` where numbers and radii do not fit each other.
    """

    nodes: tuple[int, ...] = eqx.field(static=True)
    radius: PerRow = eqx.field(converter=as_float)
    """r, m, of each of them; 0: the node itself touches"""

    def __check_init__(self):
        if not self.nodes or not all(is_count(k, 0) for k in self.nodes) or len(set(self.nodes)) < len(self.nodes):
            raise InputError(f"balls.nodes = {list(self.nodes)}: expected at least one node, and none twice")
        if np.shape(self.radius)[:1] != (len(self.nodes),):
            raise InputError(f"balls.radius has shape {np.shape(self.radius)}; expected ({len(self.nodes)},)")
        check_each("balls.radius", self.radius, least=0.0, unit="m")

    def check(self, nodes: int) -> None:
        """Raises `InputError` where a node is not there."""
        if max(self.nodes) >= nodes:
            raise InputError(f"balls.nodes has {max(self.nodes)}; expected nodes from 0 to {nodes - 1}")

    def gaps(self, phi: AnyArray) -> AnyArray:
        """m, (..., nodes), of nodes at these distances from the ground: infinite where a node does not touch it."""
        rows = np.array(self.nodes)
        if namespace_of(phi) is np:
            gaps = np.full_like(phi, np.inf)
            gaps[..., rows] = phi[..., rows] - np.asarray(self.radius)
            return gaps
        return jnp.full(phi.shape, jnp.inf, phi.dtype).at[rows].set(phi[rows] - self.radius)

    def radii(self, q: NodeVectors) -> PerNode:
        """m, of the balls about nodes at q; 0 for nodes without one."""
        return jnp.zeros_like(q[:, 0]).at[np.array(self.nodes)].set(self.radius)

    def around(self, surface: Surface, q: NodeVectors) -> Surface:
        """The surface on which centres of balls are when the balls touch this one."""
        return Thickened(surface, self.radii(q))

    def keep(self, nodes: Sequence[int]) -> bool:
        """Whether each ball takes the place of one as large, where node i goes where nodes[i] was."""
        radius = dict(zip(self.nodes, np.asarray(self.radius).tolist()))
        return all(np.isclose(radius.get(nodes[k], np.inf), r, rtol=1e-9, atol=0) for k, r in radius.items())

    def turn_alike(self, bodies: Bodies, nodes: Sequence[int]) -> bool:
        """Whether each ball turns with the body that takes the place of the one with which its image turns."""
        body_of = {node: body.points for node, body in turning_bodies(bodies).items() if node in self.nodes}
        images = {nodes[k]: {nodes[i] for i in points} for k, points in body_of.items()}
        return all({*body_of.get(k, ())} == points for k, points in images.items())

    def turning(self, bodies: Bodies, q: NodeVectors, normal: AnyArray) -> AnyArray:
        """(balls, nodes): the weights with which x - r n moves as nodes do, beside the weight 1 of the ball's own.

        `normal` is n at each ball, (balls, 3).
        """
        own, carriers = self._turned(bodies)
        weights = jnp.zeros((len(self.nodes), len(q)), q.dtype)
        if not own.size:
            return weights
        arms = -jnp.asarray(self.radius)[own, None] * normal[own]
        return weights.at[own].set(moved_beside(Carriers(carriers, np.ones(len(own), bool)), arms, q))

    def _turned(self, bodies: Bodies) -> tuple[np.ndarray, np.ndarray]:
        """The numbers of the balls that turn with a body, and its basic points, (balls, 4)."""
        body_of = turning_bodies(bodies)
        own = [k for k, node in enumerate(self.nodes) if node in body_of]
        return np.array(own, int), np.array([body_of[self.nodes[k]].basic for k in own], int).reshape(-1, 4)


def turning_bodies(bodies: Bodies) -> dict[int, Body]:
    """The body with which a ball at a node turns: at a joint the first one with a rod that ends there, or the first."""
    found: dict[int, Body] = {}
    whole = [body for body in bodies if len(body.basic) == 4]
    ends = [(node, body) for body in whole for rod in body.rods for node in rod]
    for node, owner in (*ends, *((node, body) for body in whole for node in body.points)):
        found.setdefault(node, owner)
    return found


class Thickened(Surface):
    """A surface whose distance from each node is less by a radius."""

    surface: Surface
    radius: PerNode
    """m"""
    smooth = property(lambda self: self.surface.smooth)
    curved = property(lambda self: self.surface.curved)
    solids = property(lambda self: tuple(Thickened(solid, self.radius) for solid in self.surface.solids))

    def level(self, x, y, z):
        return self.surface.distance(x, y, z) - self.radius

    def normal(self, x, y, z):
        return self.surface.normal(x, y, z)

    def height(self, x, y):
        return self.surface.height(x, y) + self.radius


def touching_velocities(ground: Any, bodies: Bodies, q: NodeVectors, v: NodeVectors) -> NodeVectors:
    """Velocities at q of what touches the `ground` at each node, m/s: of the points at which balls touch it."""
    return v if ground.balls is None else v + _spun(ground, bodies, q, v)


def acting_on_nodes(
    balls: Balls | None, bodies: Bodies, q: NodeVectors, normal: Direction, forces: list[NodeVectors]
) -> list[NodeVectors]:
    """Of forces along the `normal` and both tangents: those at nodes that do what the ground does where balls touch it.

    Along tangents it is the transpose of `touching_velocities` with that normal: of a step's impulses it is the normal
    where balls meet the ground in the step.
    """
    if balls is None:
        return forces
    rows, weights = np.array(balls.nodes), _weights(balls, bodies, q, normal)
    return [forces[0], *(force + weights.T @ force[rows] for force in forces[1:])]


def _spun(ground: Any, bodies: Bodies, q: NodeVectors, v: NodeVectors) -> NodeVectors:
    rows = np.array(ground.balls.nodes)
    return jnp.zeros_like(v).at[rows].set(_weights(ground.balls, bodies, q, ground.frame(q).normal) @ v)


def _weights(balls: Balls, bodies: Bodies, q: NodeVectors, normal: Direction) -> AnyArray:
    each = jnp.broadcast_to(jnp.asarray(normal, q.dtype), q.shape)[np.array(balls.nodes)]
    return balls.turning(bodies, q, each)

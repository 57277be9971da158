"""How a body is set on a ground of any shape: moved until it is as far above it, or as deep in it, as it should be.

And the directions in which it then holds nodes."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, NodeVectors, Scalar
from jaxgrity.model.laws import rows_on_nodes
from jaxgrity.model.rigid_struts import LARGEST_GAP
from jaxgrity.model.surface import DistanceAndAxes, Slope, coordinates

SETTLED_WITHIN = 100
"""Most moves along the normal that set a structure down on uneven ground."""
TOUCHING = 1e-6
"""Largest gap at which exact ground holds a node at rest, m for a body of one metre."""
DOUBLINGS, HALVINGS = 24, 60
"""Number of doublings that find a height far enough up, and of halvings that then narrow the range of heights."""


def down(
    q: np.ndarray, depth: float, within: float, measured: Callable[[np.ndarray], DistanceAndAxes], plane: bool
) -> tuple[np.ndarray, bool]:
    """The nodes moved along the lowest one's normal until that is so deep (m) in the ground, and whether that ended."""
    for _ in range(SETTLED_WITHIN):
        distance, axes = measured(q)
        node = int(distance.argmin())
        beyond = distance[node] + depth
        q = q - beyond * axes[node, 0]
        if plane or abs(beyond) < within:
            return q, bool(np.isfinite(q).all())
    return q, False


@eqx.filter_jit
def above(
    q: NodeVectors, distance: Scalar, ground: Any, beside: Callable[[NodeVectors], AnyArray] | None
) -> NodeVectors:
    """The nodes moved up or down until the nearest one is at a `distance` (m) from the ground.

    With balls, their distances count, and no node's. The distances of `beside`, m, count too. No node is below the
    highest point of the ground under it, so that none starts inside a solid or below a roof; of a negative distance
    they are as deep in it. Where there is no ground below any node, they keep their height.
    """
    surface = Slope(ground.incline) if ground.surface is None else ground.surface
    x, y, z = coordinates(ground.relative(q))
    over = z - surface.height(x, y)
    lowest = -jnp.min(over if ground.balls is None else ground.balls.gaps(over))
    below = jnp.isfinite(lowest)
    lowest = jnp.where(below, lowest, 0).astype(q.dtype)
    distance = jnp.asarray(distance, q.dtype)
    up = jnp.array([0.0, 0.0, 1.0], q.dtype)

    def nearest(lift: Scalar) -> Scalar:
        there = q + lift * up
        found = jnp.min(ground.signed_distance(there))
        return found if beside is None else jnp.minimum(found, jnp.min(beside(there)))

    def near(lift: Scalar) -> AnyArray:
        return nearest(lift) < distance

    def apart(_, ends: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
        low, high = ends
        return jnp.where(near(low), low, 2 * low - lowest), jnp.where(near(high), 2 * high - lowest, high)

    def halved(_, ends: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
        low, high = ends
        middle = (low + high) / 2
        below = near(middle)
        return jnp.where(below, middle, low), jnp.where(below, high, middle)

    low, high = lowest + jnp.minimum(distance, 0), lowest + jnp.maximum(distance, 0)
    # on a slope a ball that touches the ground below it is in the ground beside it, and so is a rod with a radius
    first = low, high + jnp.maximum(distance - nearest(high), 0)
    ends = jax.lax.fori_loop(0, DOUBLINGS, apart, first)
    lift = jax.lax.fori_loop(0, HALVINGS, halved, ends)[1]
    # beside all ground there is no height at which a node is in it
    return q + jnp.where(below | near(lift), lift, 0) * up


def check_placed(distance: np.ndarray, depth: float, size: float) -> None:
    """Refuse nodes at these distances (m), of a body of `size`, of which the lowest is not so deep in the ground."""
    missed = float(distance.min()) + depth
    if not abs(missed) <= LARGEST_GAP * size:
        raise InputError(
            f"ground: the lowest node cannot be set down {depth:.3g} m deep in it, but for {missed:.3g} m; "
            "expected finite nodes, and ground below them"
        )


def held_directions(ground: Any, axes: slice, q: np.ndarray, size: float) -> sp.csr_array:
    """(constraints, 3 nodes): the chosen axes (normal, tangents) of each node that touches the ground."""
    distance, frames = ground.measured(q)
    touching = np.flatnonzero(distance <= TOUCHING * size)
    nodes = np.repeat(touching, len(range(3)[axes]))[:, None]
    return rows_on_nodes(frames[touching, axes], nodes, q.size)

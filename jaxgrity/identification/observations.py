"""Observations of a robot: positions, distances, angles, forces in members."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.arguments import check_index
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import length
from jaxgrity.core.types import AnyArray, Edges, NodeVectors, Scalar
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.dynamics import member_tensions

Seen = Float[AnyArray, " columns"]


class SeenQuantity(eqx.Module):
    """A function of a configuration, one number for each column of the measurements."""

    @abstractmethod
    def columns(self, scene: Scene) -> int:
        """The number of columns. Raises `InputError` where the scene lacks an observed part."""

    @abstractmethod
    def seen(self, scene: Scene, q: NodeVectors, t: Scalar) -> Seen:
        """The numbers, at positions q (m) and time t (s)."""

    def near(self, scene: Scene, seen: AnyArray, measured: AnyArray) -> AnyArray:
        """Of the equal values of (..., columns) numbers, those nearest to measured ones: angles differ by turns."""
        return seen


class SeenPositions(SeenQuantity):
    """Coordinates of nodes, m: of the first node along each of `axes`, then of the next."""

    nodes: tuple[int, ...] | None = eqx.field(static=True, default=None)
    """None: all"""
    axes: str = eqx.field(static=True, default="xyz")

    def columns(self, scene):
        count = len(scene.structure.nodes)
        _check_nodes("SeenPositions", self.nodes or (), count)
        if not self.axes or set(self.axes) - set("xyz"):
            raise InputError(f"SeenPositions: axes = {self.axes!r}; expected some of x, y and z")
        return (count if self.nodes is None else len(self.nodes)) * len(self.axes)

    def seen(self, scene, q, t):
        rows = q if self.nodes is None else q[np.array(self.nodes)]
        return rows[:, np.array(["xyz".index(axis) for axis in self.axes])].ravel()


class SeenDistances(SeenQuantity):
    """|x_i - x_j|, m, of pairs of nodes."""

    pairs: Edges = eqx.field(static=True)

    def columns(self, scene):
        _check_nodes("SeenDistances", [node for pair in self.pairs for node in pair], len(scene.structure.nodes))
        return len(self.pairs)

    def seen(self, scene, q, t):
        i, j = np.array(self.pairs).T
        return length(q[i] - q[j])


class SeenAngles(SeenQuantity):
    """The angle of x_j - x_i in a plane, rad, of pairs (i, j) of nodes: atan2 of its second axis over its first.

    Measured ones may have any number of whole turns more or less.
    """

    pairs: Edges = eqx.field(static=True)
    plane: str = eqx.field(static=True, default="xz")

    def columns(self, scene):
        _check_nodes("SeenAngles", [node for pair in self.pairs for node in pair], len(scene.structure.nodes))
        if len(self.plane) != 2 or set(self.plane) - set("xyz"):
            raise InputError(f"SeenAngles: plane = {self.plane!r}; expected two of x, y and z")
        return len(self.pairs)

    def seen(self, scene, q, t):
        i, j = np.array(self.pairs).T
        first, second = (q[j, axis] - q[i, axis] for axis in map("xyz".index, self.plane))
        return jnp.arctan2(second, first)

    def near(self, scene, seen, measured):
        return seen + 2 * jnp.pi * jnp.round(jnp.nan_to_num((measured - seen) / (2 * jnp.pi)))


class SeenTensions(SeenQuantity):
    """The force in springs, N, positive in tension: K (l - L) of struts, K max(0, l - L) of cables, from U itself."""

    kind: str = eqx.field(static=True, default="cables")
    """"struts" or "cables" """
    members: tuple[int, ...] | None = eqx.field(static=True, default=None)
    """numbers within their kind; None: all"""

    def columns(self, scene):
        members = scene.structure.kinds.get(self.kind)
        if members is None or members.rigid:
            raise InputError(f"SeenTensions: the scene has no springs called {self.kind!r}; expected struts or cables")
        _check_nodes("SeenTensions", self.members or (), len(members.edges), "member")
        return len(members.edges if self.members is None else self.members)

    def seen(self, scene, q, t):
        force = member_tensions(scene, t, q)[self.kind]
        return force if self.members is None else force[np.array(self.members)]


class SeenTogether(SeenQuantity):
    """Several observations, one after the other."""

    all: tuple[SeenQuantity, ...]

    def columns(self, scene):
        return sum(each.columns(scene) for each in self.all)

    def seen(self, scene, q, t):
        return jnp.concatenate([each.seen(scene, q, t) for each in self.all])

    def near(self, scene, seen, measured):
        ends = np.cumsum([each.columns(scene) for each in self.all])[:-1]
        parts = zip(self.all, jnp.split(seen, ends, -1), jnp.split(jnp.asarray(measured), ends, -1))
        return jnp.concatenate([each.near(scene, *part) for each, *part in parts], -1)


def _check_nodes(where: str, numbers, count: int, what: str = "node") -> None:
    for number in numbers:
        check_index(f"{where}: {what}", number, count)

"""External forces: wind, and pushes at nodes."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_count, check_each, check_indices
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import along, dot, inner, length, norm_squared, ones, take_rows
from jaxgrity.core.types import AnyArray, AnyNodeVectors, AnyPerNode, Scalar, Vector, as_float
from jaxgrity.model.laws import SAME, DissipationTerm, Motion, unchanged_per_node


class Wind(DissipationTerm):
    """R = sum c/3 |v - w|^3: drag on each node against its velocity past a uniform wind, F = -c |v - w| (v - w).

    Made by `wind`. The energy audit lists the energy that wind takes, which is negative if it drives the robot.
    """

    velocity: Vector = eqx.field(converter=as_float)
    """(3,), velocity w of the wind, m/s"""
    drag: AnyPerNode = eqx.field(converter=as_float)
    """(nodes,), drag c, kg/m: half of density times drag coefficient times area"""
    name: ClassVar[str] = "wind"
    cause: ClassVar[str] = "wind"

    def __check_init__(self):
        check_each("wind.drag", self.drag, least=0.0, unit="kg/m")
        check_each("wind.velocity", self.velocity, shape=(3,))

    def check(self, nodes: int):
        if len(self.drag) != nodes:
            raise InputError(f"wind: it is that on {len(self.drag)} nodes; expected nodes = {nodes}, as there are")

    def dissipation(self, motion: Motion) -> Scalar:
        past = motion.v - along(ones(self.drag), self.velocity)
        return inner(self.drag * length(past), norm_squared(past)) / 3

    def keeps(self, symmetry):
        w = tuple(np.asarray(self.velocity))
        speed = float(np.linalg.norm(w))
        alike = speed == 0 or symmetry.leaves(tuple(x / speed for x in w))
        return alike and unchanged_per_node(self.drag, symmetry)


class Push(DissipationTerm):
    """A force F on some nodes from `start` to `start + duration`: R = -s(t) F·v, so that -dR/dv = s F.

    s rises from 0 to 1 within `ramp`, and falls within `ramp`. The impulse is F (duration - ramp). Complementarity
    stepping gives the exact impulse at any step. Runge-Kutta methods take steps short enough to resolve it. The push is
    a term of R, so the energy audit lists its work separately.
    """

    nodes: tuple[int, ...] = eqx.field(static=True)
    """numbers of the pushed nodes"""
    force: AnyNodeVectors = eqx.field(converter=as_float)
    """force F on each of these nodes, N, one row per node"""
    start: Scalar = eqx.field(converter=as_float)
    """start of the push, s"""
    duration: Scalar = eqx.field(converter=as_float)
    """duration of the push, s"""
    ramp: Scalar = eqx.field(converter=as_float, default=0.01)
    """time in which the force rises, and falls, s; at most half of the duration"""
    name: ClassVar[str] = "push"
    cause: ClassVar[str] = "push"

    def __check_init__(self):
        check_indices("push.nodes", self.nodes)
        check_each("push.force", self.force, shape=(len(self.nodes), 3))
        check_each("push.start", self.start, shape=())
        check_each("push.duration", self.duration, shape=(), above=0.0, unit="s")
        check_each("push.ramp", self.ramp, shape=(), above=0.0, unit="s")
        if isinstance(self.ramp, np.ndarray) and not 0 < self.ramp <= self.duration / 2:
            raise InputError(f"push.ramp = {self.ramp}: expected more than 0 and at most half of the duration")

    def check(self, nodes: int):
        check_indices("push.nodes", self.nodes, nodes)

    def dissipation(self, motion: Motion) -> Scalar:
        t = motion.at.t - self.start
        share = jnp.clip(jnp.minimum(t, self.duration - t) / self.ramp, 0, 1)
        power = dot(take_rows(motion.v, self.nodes), self.force)
        return -share * inner(power, jnp.ones_like(power))

    def during(self, begin, end):
        seconds = end - begin
        none = seconds <= 0
        mean = (self._integral(end) - self._integral(begin)) / jnp.where(none, 1, seconds)
        # at its full force, with ramps of 1 s before and after; times are common to robots side by side
        longest = jnp.max(seconds)
        instead = (self.force * mean, end - longest - 1, longest + 2, jnp.ones_like(longest))
        return eqx.tree_at(lambda push: (push.force, push.start, push.duration, push.ramp), self, instead)

    def later(self, seconds):
        return eqx.tree_at(lambda push: push.start, self, self.start - seconds)

    def _integral(self, t: Scalar | AnyArray) -> AnyArray:
        """Integral of s up to time t, s: rise, constant part and fall."""
        since = t - self.start
        rising = jnp.clip(since, 0, self.ramp)
        falling = jnp.clip(since - self.duration + self.ramp, 0, self.ramp)
        between = jnp.clip(since - self.ramp, 0, self.duration - 2 * self.ramp)
        return rising * rising / (2 * self.ramp) + between + falling - falling * falling / (2 * self.ramp)

    def bends(self):
        return self.start + jnp.stack([0 * self.ramp, self.ramp, self.duration - self.ramp, self.duration])

    def longest_step(self):
        return float(self.ramp) / 2

    def misplaced(self, h):
        total = float(np.linalg.norm(np.asarray(self.force).sum(0)) * (self.duration - self.ramp))
        return total * h / 2 if self.duration < 4 * h else 0.0

    def keeps(self, symmetry):
        pushed = dict(zip(self.nodes, np.asarray(self.force)))
        moved = {symmetry.nodes[i]: symmetry.matrix @ force for i, force in pushed.items()}
        off = SAME * np.abs(np.asarray(self.force)).max(initial=0)
        return moved.keys() == pushed.keys() and all(np.allclose(moved[i], pushed[i], rtol=0, atol=off) for i in pushed)


def wind(velocity, drag, nodes: int) -> Wind:
    """A uniform wind on all nodes of a structure.

    Args:
        velocity: (3,), velocity of the wind, m/s.
        drag: drag of each node, kg/m; one number for all nodes, or one per node.
        nodes: number of nodes.

    Returns:
        The term, for `with_terms`.

    Raises:
        InputError: negative drag, numbers that are not finite, or a wrong number of drags.

    Example:
        >>> calm = jaxgrity.load_scene("exact")
        >>> windy = jaxgrity.with_terms(calm, jaxgrity.wind([4.0, 0.0, 0.0], 0.05, nodes=12))
        >>> [term.name for term in windy.terms]
        ['wind']
    """
    nodes = check_count("wind.nodes", nodes, 1)
    check_each("wind.velocity", velocity, shape=(3,))
    if np.shape(drag) not in ((), (nodes,)):
        raise InputError(f"wind.drag has shape {np.shape(drag)}; expected one number, or ({nodes},), one a node")
    return Wind(np.asarray(velocity, float), np.broadcast_to(np.asarray(drag, float), (nodes,)))

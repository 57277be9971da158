"""Struts that touch exact ground between their ends, with a radius: where each of them is nearest to it.

Along a strut x(s) = (1 - s) a + s b the distance phi(x(s)) has a smallest value. At the edge of a solid it has a kink
there: on one side it falls towards one face, on the other towards another. Of the normals on both sides, the mean that
is perpendicular to the strut is the normal of a rod on that edge. Divided by its length, the phi where the tangents of
both sides meet is the distance of the rod from the edge. Where phi is smooth, both sides have the same normal.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.primitives import inverse, length
from jaxgrity.core.tracing import evaluated
from jaxgrity.core.types import AnyArray, NodeVectors, PerMember, PerNode, as_float
from jaxgrity.model.surface import Surface, as_double

SAMPLES = 16
"""Number of intervals of each part of a strut. A minimum of phi is seen where its slope changes sign within one."""
NARROWEST = 0.45
"""Power of the precision, the share of a strut to which such an interval is narrowed (9e-8 in float64). At a smooth
minimum the normals at its ends must differ by more than rounding, since derivatives are in their difference."""
LEVEL = 8
"""Largest change of the slope of phi, in roundings, at which a strut counts as parallel to what is below it."""
KINK = 0.1
"""Smallest change of the slope of phi within the narrowed interval that is the kink of an edge."""


class Capsules(eqx.Module):
    """The struts, and rods of bodies, that touch exact ground with their whole length, and their radius."""

    struts: tuple[int, ...] = eqx.field(static=True)
    """numbers, as in `rods.py`"""
    ends: tuple[tuple[int, ...], tuple[int, ...]] = eqx.field(static=True)
    """nodes i and j of each strut"""
    parts: int = eqx.field(static=True)
    """number of equal parts of a strut, each of which touches edges by itself"""
    radius: AnyArray = eqx.field(converter=as_float)
    """(struts,), m"""

    def keep(self, nodes: Sequence[int]) -> bool:
        """Whether each strut takes the place of one as thick, where node i goes where nodes[i] was."""
        radius = {frozenset(pair): r for pair, r in zip(zip(*self.ends), np.asarray(self.radius).tolist())}
        images = {frozenset(nodes[k] for k in pair): r for pair, r in radius.items()}
        return all(np.isclose(radius.get(pair, np.inf), r, rtol=1e-9, atol=0) for pair, r in images.items())


class Nearest(NamedTuple):
    """The point of each strut that is nearest to the ground, or deepest in it."""

    share: PerMember
    """s, its position along the strut, from 0 to 1"""
    normal: NodeVectors
    """(struts, 3), normal n of the ground there"""
    distance: PerMember
    """m, from the strut's axis along n, negative inside"""
    found: AnyArray
    """whether the distance has a minimum between the ends; else an end is nearest"""


def nearest(surface: Surface, a: NodeVectors, b: NodeVectors, part: AnyArray, leaning: AnyArray) -> Nearest:
    """The nearest points of struts from `a` to `b`, (struts, 3), m, within a `part` (2, struts) of each: s from, s to.

    `leaning`, (struts,), is a slope that is added to that of phi. If a rod lies on a face, a small slope of either sign
    finds one end of the part that lies there.
    """
    d = b - a
    size = length(d)
    leaning = leaning * size
    held = lambda x: jax.lax.stop_gradient(x) if eqx.is_inexact_array(x) else x  # noqa: E731
    *ends, found = _interval(*jax.tree.map(held, (surface, a, d, part, leaning)))
    s = jnp.stack(ends)
    f, slope, normal = _look(surface, a, d, s)
    level = slope[1] - slope[0] <= LEVEL * jnp.finfo(s.dtype).eps * size
    weight = jnp.where(level, 0.5, jnp.clip(slope[1] / jnp.where(level, 1, slope[1] - slope[0]), 0, 1))
    weights = jnp.stack([weight, 1 - weight])
    meet, root = _meet(s, f + leaning * s, slope + leaning)
    share = jnp.where(slope[1] - slope[0] > KINK * size, meet, root)
    n = jnp.sum(weights[..., None] * normal, axis=0)
    shorter = inverse(length(n))
    n, distance = n * shorter[:, None], jnp.sum(weights * (f + slope * (share - s)), axis=0) * shorter
    # with a `leaning` the normal at that point leans, too. A strut touches along the perpendicular to its axis: the one
    # from the same point of the ground. A capsule that lies flat would else begin to tip with a push along its axis
    off = jnp.sum(n * d, axis=1) * inverse(size * size)
    n = n - off[:, None] * d
    return Nearest(share - off * distance, n * inverse(length(n))[:, None], distance * length(n), found)


def and_of_struts(gaps: PerNode, ground: Any, q: NodeVectors) -> AnyArray:
    """m: `gaps` by which nodes at q are in the `ground`, and after them those of its capsules between their ends."""
    if ground.capsules is None or ground.surface is None:
        return gaps
    if not isinstance(q, np.ndarray):
        return jnp.concatenate([gaps, depths(ground, q)])
    with jax.enable_x64(True), evaluated():
        return np.concatenate([gaps, np.asarray(depths(as_double(ground), np.asarray(q, float)))])


@eqx.filter_jit
def depths(ground: Any, q: NodeVectors) -> PerMember:
    """m, (struts,), of the capsules of a `ground` in it, where nodes are at q; -inf where an end is nearest."""
    capsules, q = ground.capsules, ground.relative(q)
    strut, part = (x.ravel() for x in np.indices((len(capsules.struts), capsules.parts)))
    i, j = (np.array(nodes)[strut] for nodes in capsules.ends)
    bounds = jnp.asarray(np.stack([part, part + 1]) / capsules.parts, q.dtype)
    found = nearest(ground.surface, q[i], q[j], bounds, 0 * bounds[0])
    deep = jnp.where(found.found, capsules.radius[strut] - found.distance, -jnp.inf)
    return deep.reshape(-1, capsules.parts).max(1)


def _look(surface: Surface, a: NodeVectors, d: NodeVectors, s: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
    """phi, m, its slope along the strut, m, and the normals, at a + s d of (places, struts) s."""
    x = (a + s[..., None] * d).reshape(-1, 3).T
    normal = jnp.stack(surface.normal(*x), axis=1).reshape(*s.shape, 3)
    return surface.distance(*x).reshape(s.shape), jnp.sum(normal * d, axis=-1), normal


def _meet(s: AnyArray, f: AnyArray, slope: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Where the tangents at both ends s (2, ...) meet, and where a slope that changes evenly between them is 0."""
    change = slope[1] - slope[0]
    rises = change > 0
    change = jnp.where(rises, change, 1)
    middle = (s[0] + s[1]) / 2
    both = (f[0] - f[1] + slope[1] * s[1] - slope[0] * s[0]) / change, (slope[1] * s[0] - slope[0] * s[1]) / change
    meet, root = (jnp.where(rises, jnp.clip(x, s[0], s[1]), middle) for x in both)
    return meet, root


def _interval(
    surface: Surface, a: NodeVectors, d: NodeVectors, part: AnyArray, leaning: AnyArray
) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Two shares of each strut about its lowest minimum within its part, and whether there is one."""
    s = part[0] + (part[1] - part[0]) * jnp.linspace(0, 1, SAMPLES + 1, dtype=a.dtype)[:, None]
    f, slope, _ = _look(surface, a, d, s)
    f, slope = f + leaning * s, slope + leaning
    ends, values, slopes = (jnp.stack([x[:-1], x[1:]]) for x in (s, f, slope))
    meet, _ = _meet(ends, values, slopes)
    there = (slopes[0] <= 0) & (slopes[1] >= 0)
    lowest = jnp.argmin(jnp.where(there, values[0] + slopes[0] * (meet - ends[0]), jnp.inf), axis=0)[None]
    low, high = (jnp.take_along_axis(x, lowest, 0)[0] for x in ends)

    inner = jnp.arange(1, SAMPLES + 1, dtype=a.dtype)[:, None] / (SAMPLES + 1)

    def narrowed(_, ends):
        low, high = ends
        tries = low + inner * (high - low)
        rises = _look(surface, a, d, tries)[1] + leaning >= 0
        every = jnp.concatenate([low[None], tries, high[None]])
        first = 1 + jnp.argmax(jnp.concatenate([rises, jnp.ones_like(rises[:1])]), axis=0)[None]
        below, above = (jnp.take_along_axis(every, k, 0)[0] for k in (first - 1, first))
        return below, above

    narrowest = float(jnp.finfo(a.dtype).eps) ** NARROWEST
    times = math.ceil(-math.log(SAMPLES * narrowest) / math.log(SAMPLES + 1))
    low, high = jax.lax.fori_loop(0, times, narrowed, (low, high))
    return low, high, jnp.any(there, axis=0)

"""Stiff springs that hold sliding nodes on their lines, for statics, which knows forces alone."""

import dataclasses
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from jaxgrity.core.quick import compiled_quickly
from jaxgrity.core.types import AnyArray, NodeVectors, Scalar
from jaxgrity.model.laws import Configuration, EnergyTerm
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import Slides, known_lines, off_line


class SlideSprings(EnergyTerm):
    """U = K/2 sum |c - c0|^2, with c from its line to each sliding node, across the line (`Slides.offsets`)."""

    slides: Slides
    stiffness: Scalar
    """K, N/m"""
    offset: AnyArray
    """c0 of each (slides, 3), m: on its line a node is pulled by K c0, which does not turn with the line"""
    name: ClassVar[str] = "springs for sliding nodes"

    @property
    def triples(self) -> np.ndarray:
        """(slides, 3): each node, and both of its line."""
        return np.array([(node, *pair) for node, pair in zip(self.slides.nodes, self.slides.along)])

    def energy(self, at: Configuration) -> Scalar:
        return jnp.sum(jax.vmap(self.of_one)(at.q[self.triples], self.offset))

    def of_one(self, x: NodeVectors, offset: AnyArray) -> Scalar:
        """U, J, of a node at x[0] with the nodes of its line at x[1] and x[2], m."""
        return self.stiffness * jnp.sum((off_line(*x) - offset) ** 2) / 2


def springs_for(slides: Slides, stiffness: float) -> SlideSprings:
    """Springs of this stiffness, N/m, at rest on the lines."""
    return SlideSprings(slides, stiffness, np.zeros((len(slides.nodes), 3)))


def apart(scene: Scene) -> tuple[Scene, SlideSprings | None]:
    """The scene without such springs, and these."""
    springs = next((term for term in scene.terms if isinstance(term, SlideSprings)), None)
    if springs is None:
        return scene, None
    return dataclasses.replace(scene, terms=tuple(term for term in scene.terms if term is not springs)), springs


class Tangent(NamedTuple):
    """U about one shape. It is here, since `statics.stiffness` adds these springs to what it computes of members."""

    energy: float
    """U, J"""
    gradient: np.ndarray
    """(nodes, 3), dU/dq, N"""
    stiffness: Callable[[], sp.csc_array]
    """gives K = d2U/dq2, N/m, (3 nodes, 3 nodes)"""


def sum_of_both(first: Tangent, second: Tangent) -> Tangent:
    """The sum of two terms of U."""
    K = lambda: sp.csc_array(first.stiffness() + second.stiffness())  # noqa: E731
    return Tangent(first.energy + second.energy, first.gradient + second.gradient, K)


def about(springs: SlideSprings, q: NodeVectors) -> Tangent:
    """Their U at `q`. Each joins three nodes, so that the blocks of single members and nodes do not have them."""
    triples, slope = springs.triples, np.zeros(np.shape(q))
    with jax.enable_x64(True):
        known = jax.tree.map(lambda x: jnp.asarray(x, float), springs)
        energy, slopes, blocks = jax.tree.map(np.asarray, _each(known, jnp.asarray(q, float)[triples]))
    np.add.at(slope, triples, slopes)
    place = (3 * triples[:, :, None] + np.arange(3)).reshape(-1, 9)
    rows, columns = np.repeat(place, 9, axis=1).ravel(), np.tile(place, 9).ravel()
    K = sp.csc_array((blocks.ravel(), (rows, columns)), shape=(slope.size, slope.size))
    return Tangent(float(energy.sum()), slope, lambda: K)


def across_lines(slides: Slides, q: NodeVectors) -> tuple[sp.csc_array, np.ndarray]:
    """What holds nodes on their lines at `q`: the slopes of U (3 nodes, 2 slides), m, and c0 K (2 slides, 3), m.

    Each is for a force density of 1 N/m along the line's length, as `equilibrium_matrix` has it for members.
    """
    lines = known_lines(slides, np.asarray(q, float))
    size = np.linalg.norm(lines.line, axis=1)
    columns = slides.directions(np.asarray(q, float), 1.0).T @ sp.diags_array(size)
    return sp.csc_array(columns), -size[:, None] * lines.across


@compiled_quickly
def _each(springs: SlideSprings, x: AnyArray) -> tuple:
    energy, slope = jax.vmap(jax.value_and_grad(springs.of_one))(x, springs.offset)
    return energy, slope, jax.vmap(jax.hessian(springs.of_one))(x, springs.offset)

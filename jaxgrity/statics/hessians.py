"""The Hessian of U at one shape: whole, or the blocks of members and nodes that it is made of."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from jaxgrity.core.quick import compiled_quickly
from jaxgrity.core.types import AnyArray, NodeVectors
from jaxgrity.model.laws import EnergyTerm
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Structure, member_vectors, onto_nodes

SEPARABLE = 1e-6
"""Largest relative difference between the whole Hessian of a term and one made of blocks."""
NEARBY = 1e-3
"""Distance from the given shape at which terms are judged, as a share of the robot's length: at the shape itself they
may be at rest."""


class BlockPattern(NamedTuple):
    """Where the entries of a Hessian's blocks are in a sparse matrix: the same for every shape of a structure."""

    place: np.ndarray
    """(entries,), number of each entry of each block among the matrix's; several entries may have the same"""
    indices: np.ndarray
    indptr: np.ndarray

    def matrix(self, blocks: AnyArray) -> sp.csc_array:
        """The matrix with these blocks (blocks, 3, 3), of members first, then of nodes."""
        by_member, by_node = np.split(blocks, [len(blocks) - (len(self.indptr) - 1) // 3])
        entries = np.concatenate([by_member, by_member, -by_member, -by_member, by_node]).ravel()
        data, size = np.bincount(self.place, entries, len(self.indices)), len(self.indptr) - 1
        return sp.csc_array((data, self.indices, self.indptr), shape=(size, size))


def block_pattern(structure: Structure) -> BlockPattern:
    """That of a structure's members and nodes."""
    edges = [edge for members in structure.kinds.values() for edge in members.edges]
    (i, j), each = np.asarray(edges, int).reshape(-1, 2).T, np.arange(len(structure.nodes))
    rows, columns = np.concatenate([i, j, i, j, each]), np.concatenate([i, j, j, i, each])
    axes, size = np.indices((3, 3)), 3 * len(each)
    keys = (3 * columns[:, None, None] + axes[1]) * size + 3 * rows[:, None, None] + axes[0]
    found, place = np.unique(keys.ravel(), return_inverse=True)
    return BlockPattern(place.ravel(), found % size, np.searchsorted(found, size * np.arange(size + 1)))


@compiled_quickly
def whole_hessian(scene: Scene, q: NodeVectors) -> tuple:
    """U, J, its gradient, N, and its Hessian, N/m, (3 nodes, 3 nodes), at t = 0."""
    U, slope = jax.value_and_grad(scene.potential_energy)(q, 0.0)
    return U, slope, jax.hessian(scene.potential_energy)(q, 0.0).reshape(q.size, q.size)


@compiled_quickly
def hessian_blocks(scene: Scene, q: NodeVectors, probe: NodeVectors) -> tuple:
    """U, its gradient, the blocks of its Hessian, of members first, and the Hessian's product with `probe`."""
    return _by_blocks(lambda x, d: scene.potential_energy(x, 0.0, d), scene, q, probe)


def joining_terms(scene: Scene) -> list[str]:
    """Names of the scene's own terms of U that join nodes otherwise than by members.

    Each is judged by itself: beside the springs that stand for rigid struts, a soft one would not be seen. One random
    product with its Hessian, near the shape as it is given, tells it from one that is made of blocks.
    """
    terms = [term for term in scene.terms if isinstance(term, EnergyTerm)]
    if not terms:
        return []
    draws, nodes = np.random.default_rng(0), np.asarray(scene.structure.nodes, float)
    near = nodes + NEARBY * float(length_scale(scene)) * draws.normal(size=nodes.shape)
    probe, pattern, found = draws.normal(size=nodes.shape), block_pattern(scene.structure), []
    for term in terms:
        _, _, blocks, product = jax.tree.map(np.asarray, _blocks_of_term(term, scene, jnp.asarray(near), probe))
        if not made_of_blocks(pattern.matrix(blocks), probe, product):
            found.append(term.name)
    return found


def made_of_blocks(K: sp.csc_array, probe: NodeVectors, product: NodeVectors) -> bool:
    """Whether K times `probe` is the whole Hessian's `product` with it."""
    error = np.abs(K @ probe.ravel() - product.ravel()).max()
    return bool(error <= SEPARABLE * max(np.abs(product).max(), np.finfo(float).tiny))


@compiled_quickly
def _blocks_of_term(term: EnergyTerm, scene: Scene, q: NodeVectors, probe: NodeVectors) -> tuple:
    return _by_blocks(lambda x, d: term.energy(scene.configuration(x, 0.0, d)), scene, q, probe)


def _by_blocks(energy: Callable, scene: Scene, q: NodeVectors, probe: NodeVectors) -> tuple:
    kinds = scene.structure.kinds
    vectors = member_vectors(q, kinds)
    (U, slope), push = jax.linearize(jax.value_and_grad(energy, argnums=(0, 1)), q, vectors)
    # side by side: unit displacements of all members, then of all nodes, then the probe
    members, nodes = _side_by_side(member_vectors(probe, kinds), 0), _side_by_side(probe, 3)
    _, (at_nodes, along) = jax.vmap(push, in_axes=-1, out_axes=-1)(nodes, members)
    blocks = jnp.concatenate([*(along[kind][..., :3] for kind in kinds), at_nodes[..., 3:6]])
    changes = [(slope[0], slope[1]), (at_nodes[..., 6], {kind: along[kind][..., 6] for kind in kinds})]
    whole = [x + (onto_nodes(d, kinds, len(q)) if kinds else 0) for x, d in changes]
    return U, whole[0], blocks, whole[1]


def _side_by_side(probe: AnyArray | dict, first: int) -> AnyArray | dict:
    """Seven displacements (..., 3, 7): from `first` on the three unit ones, `probe` at the end, 0 elsewhere."""

    def each(x):
        units = jnp.broadcast_to(jnp.eye(3, dtype=x.dtype), (*x.shape, 3))
        return jnp.concatenate([*(units if k == first else 0 * units for k in (0, 3)), x[..., None]], axis=-1)

    return jax.tree.map(each, probe)

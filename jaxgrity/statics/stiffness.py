"""Sparse matrices of a scene at one shape: tangent stiffness d2U/dq2, from its own U, and consistent mass."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from jaxtyping import Bool
from scipy.linalg import null_space
from scipy.sparse.csgraph import connected_components

from jaxgrity.core.arguments import known_ends
from jaxgrity.core.errors import InputError
from jaxgrity.core.quick import compiled_quickly
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, Edges, NodeVectors
from jaxgrity.model.bodies import Bodies
from jaxgrity.model.body_points import carrying, independent_nodes
from jaxgrity.model.laws import EnergyTerm
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.model.structure import Structure, member_vectors, onto_nodes
from jaxgrity.statics.slide_springs import Tangent, about, apart, sum_of_both
from jaxgrity.statics.spectrum import unpivoted

Fixed = Bool[AnyArray, "nodes 3"]
"""Whether supports hold each coordinate of each node."""
UNRESISTED = 1e-11
"""Stiffness of a rigid motion, as a share of the largest, that is an error of the shape and of arithmetic."""
BENT = 1e-6
"""Singular values below which a displacement leaves bodies rigid: shapes at rest are not exact."""
SEPARABLE = 1e-6
"""Largest relative difference between the whole Hessian and one made of blocks."""


def all_edges(structure: Structure) -> Edges:
    """The members' nodes in the order of their numbers: struts first, then cables."""
    return tuple(edge for m in structure.members for edge in m.edges)


def incidence(edges: Edges, nodes: int) -> sp.csr_array:
    """C (members, nodes): +1 at the first node of each member, -1 at the second; C q are the members' d."""
    ends = known_ends(edges, nodes)
    rows = np.repeat(np.arange(len(ends)), 2)
    return sp.csr_array((np.tile([1.0, -1.0], len(ends)), (rows, ends.ravel())), shape=(len(ends), nodes))


@typed
def stiffness_matrix(scene: Scene, q: NodeVectors) -> sp.csc_array:
    """K = d2U/dq2 at `q` and t = 0, N/m, (3 nodes, 3 nodes), from the scene's own potential energy.

    U is a sum of functions of one member's d = x_i - x_j and of one node's x. So its Hessian is one 3 x 3 block for
    each member and each node, and three products with the Hessian give all blocks, whatever the size. Raises
    `InputError` where a term of U couples nodes in another way; one random product with the whole Hessian shows it.
    With cables through several nodes the Hessian is computed whole: some hundred nodes at most.
    """
    return tangent_of(scene)(q).stiffness()


def tangent_of(scene: Scene) -> Callable[[NodeVectors], Tangent]:
    """U, its gradient and its Hessian at t = 0 as a function of shapes: one compiled program (`stiffness_matrix`)."""
    others, slides = apart(scene)
    tangent = _tangent_of(others)
    return tangent if slides is None else lambda q: sum_of_both(tangent(q), about(slides, q))


def _tangent_of(scene: Scene) -> Callable[[NodeVectors], Tangent]:
    cables, nodes = scene.structure.cables, len(scene.structure.nodes)
    with jax.enable_x64(True):
        known = as_dtype(scene, "float64")
    if cables is not None and cables.clusters:

        def whole(q: NodeVectors) -> Tangent:
            with jax.enable_x64(True):
                U, slope, K = jax.tree.map(np.asarray, _whole(known, jnp.asarray(q, float)))
            return Tangent(float(U), slope, lambda: sp.csc_array(K))

        return whole
    pattern, probe = _pattern(scene.structure), np.random.default_rng(0).normal(size=(nodes, 3))

    def parted(q: NodeVectors) -> Tangent:
        with jax.enable_x64(True):
            U, slope, blocks, product = jax.tree.map(np.asarray, _blocks(known, jnp.asarray(q, float), probe))

        def stiffness() -> sp.csc_array:
            K = pattern.matrix(blocks)
            error = np.abs(K @ probe.ravel() - product.ravel()).max()
            if error > SEPARABLE * max(np.abs(product).max(), np.finfo(float).tiny):
                raise InputError(
                    "a term of U joins nodes otherwise than by members; expected terms of single members or nodes"
                )
            return K

        return Tangent(float(U), slope, stiffness)

    return parted


@typed
def sparse_mass_matrix(structure: Structure) -> sp.csc_array:
    """M, kg, (3 nodes, 3 nodes): the same as `inertia.mass_matrix`, for structures of any size.

    Nodes are points; a member's mass m is spread along it, T = m/6 (v_p·v_p + v_p·v_q + v_q·v_q). A rigid body's is at
    its basic points.
    """
    nodes = len(structure.nodes)
    M = sp.diags_array(np.asarray(structure.node_mass, float))
    for mass, edges in structure.rod_masses:
        joins = abs(incidence(edges, nodes))
        sixth = sp.diags_array(np.asarray(mass, float) / 6)
        # [[2, 1], [1, 2]] is what the sum of both ends has, and the identity once more
        M = M + joins.T @ sixth @ joins + sp.diags_array(joins.T @ sixth.diagonal())
    for body in structure.bodies:
        rows, columns = np.meshgrid(body.basic, body.basic, indexing="ij")
        own = (np.asarray(body.matrix, float).ravel(), (rows.ravel(), columns.ravel()))
        M = M + sp.csr_array(own, shape=(nodes, nodes))
    return sp.csc_array(sp.kron(M, sp.eye_array(3)))


def free_coordinates(nodes: int, fixed: Fixed | None) -> np.ndarray:
    """The indices of the unsupported ones of the 3 nodes coordinates. Raises `InputError` on another shape."""
    if fixed is None:
        return np.arange(3 * nodes)
    if np.shape(fixed) != (nodes, 3):
        raise InputError(f"fixed has shape {np.shape(fixed)}; expected ({nodes}, 3), whether each coordinate is held")
    return np.flatnonzero(~np.asarray(fixed, bool).ravel())


def coordinate_map(structure: Structure) -> tuple[sp.csc_array, np.ndarray]:
    """The map from the coordinates of independent nodes to all coordinates, and which of these no support holds."""
    nodes, bodies = len(structure.nodes), structure.bodies
    place = sp.eye_array(nodes, format="csc")
    carried: np.ndarray = np.zeros(0, int)
    if bodies:
        independent = list(independent_nodes(bodies, nodes))
        columns = np.zeros((nodes, nodes))
        columns[:, independent] = np.asarray(carrying(bodies, nodes), float)
        place = sp.csc_array(columns)
        carried = np.flatnonzero(~np.isin(np.arange(3 * nodes) // 3, independent))
    free = np.setdiff1d(free_coordinates(nodes, structure.supported), carried)
    return sp.kron(place, sp.eye_array(3), format="csc"), free


def rigid_motions(q: NodeVectors, fixed: Fixed | None = None) -> np.ndarray:
    """Displacements without a change of any distance or support: orthonormal columns, of the free coordinates.

    Six where nothing is held (five where all nodes lie on a line), fewer with supports.
    """
    q = np.asarray(q, float)
    axes, away = np.eye(3), q - q.mean(0)
    motions = [np.tile(axis, (len(q), 1)) for axis in axes] + [np.cross(axis, away) for axis in axes]
    # turns as large as moves, so that one tolerance fits both
    columns = np.stack([motion.ravel() / (np.linalg.norm(motion) or 1.0) for motion in motions], axis=1)
    free = free_coordinates(len(q), fixed)
    held = np.setdiff1d(np.arange(q.size), free)
    if held.size:
        _, size, rows = np.linalg.svd(columns[held])
        columns = columns @ rows[int(np.sum(size > 1e-9)) :].T
    basis, size, _ = np.linalg.svd(columns[free], full_matrices=False)
    return basis[:, size > 1e-9]


def free_motions(q: NodeVectors, fixed: Fixed | None, bodies: Bodies) -> sp.csc_array:
    """(3 nodes, motions), orthonormal columns: the displacements at `q` that supports and rigid bodies allow.

    To first order: each body moves and turns. Bodies that share nodes move together. Unit vectors where no body is.
    """
    x, free = np.asarray(q, float), np.zeros(np.size(q), bool)
    free[free_coordinates(len(x), fixed)] = True
    ends = tuple((body.points[0], node) for body in bodies for node in body.points)
    joins = abs(incidence(ends, len(x)))
    _, group = connected_components(joins.T @ joins, directed=False)
    inside = np.zeros(len(x), bool)
    inside[[node for _, node in ends]] = True
    alone = np.flatnonzero(free & ~np.repeat(inside, 3))
    blocks = [(alone, sp.eye_array(len(alone)))]
    for number in np.unique(group[inside]):
        own = np.flatnonzero((np.repeat(group, 3) == number) & free)
        bent: list[np.ndarray] = []
        for body in bodies:
            if group[body.points[0]] == number:
                rigid = rigid_motions(x[list(body.points)])
                points = (3 * np.array(body.points)[:, None] + np.arange(3)).ravel()
                # what of a displacement of its points is no rigid motion
                bent.append((np.eye(len(points)) - rigid @ rigid.T) @ (points[:, None] == own))
        if len(own):
            blocks.append((own, null_space(np.concatenate(bent), rcond=BENT)))
    rows = np.concatenate([own for own, _ in blocks])
    motions = sp.coo_array(sp.block_diag([columns for _, columns in blocks]))
    return sp.csc_array((motions.data, (rows[motions.row], motions.col)), shape=(x.size, motions.shape[1]))


def unresisted_motions(scene: Scene, q: NodeVectors, K: sp.csc_array) -> np.ndarray:
    """Those of the rigid motions that nothing in the scene resists, likewise; `K` is that of the free coordinates.

    Members resist none. Gravity resists the swinging of what hangs, and soft ground what sinks in or tilts.
    """
    rigid = rigid_motions(q, scene.structure.supported)
    hangs = scene.gravity is not None and bool(scene.structure.fixed)
    stands = scene.ground is not None and bool((scene.ground.measured(np.asarray(q)).distance < 0).any())
    if not (hangs or stands or any(isinstance(term, EnergyTerm) for term in apart(scene)[0].terms)):
        return rigid
    resistance, turned = np.linalg.eigh(rigid.T @ (K @ rigid))
    return rigid @ turned[:, np.abs(resistance) <= UNRESISTED * abs(K).max()]


def motions_of(scene: Scene, q: NodeVectors, K: sp.csc_array) -> tuple[sp.csc_array, np.ndarray]:
    """`free_motions`, and in these `unresisted_motions`; `K` is that of all coordinates."""
    structure = scene.structure
    place, free = free_motions(q, structure.supported, structure.bodies), free_coordinates(len(q), structure.supported)
    return place, place[free].T @ unresisted_motions(scene, q, K[free][:, free])


def factor_if_definite(A: sp.csc_array) -> spla.SuperLU | None:
    """A sparse factorisation of the symmetric `A` where all its eigenvalues are positive, else None.

    Without pivoting, A = L D L', and by Sylvester's law of inertia the signs of D are those of the eigenvalues.
    """
    try:
        found = unpivoted(A)
    except RuntimeError:  # exactly singular
        return None
    pivoted = not np.array_equal(found.perm_r, found.perm_c)
    return None if pivoted or not np.all(found.U.diagonal() > 0) else found


class _Pattern(NamedTuple):
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


def _pattern(structure: Structure) -> _Pattern:
    edges = [edge for members in structure.kinds.values() for edge in members.edges]
    (i, j), each = np.asarray(edges, int).reshape(-1, 2).T, np.arange(len(structure.nodes))
    rows, columns = np.concatenate([i, j, i, j, each]), np.concatenate([i, j, j, i, each])
    axes, size = np.indices((3, 3)), 3 * len(each)
    keys = (3 * columns[:, None, None] + axes[1]) * size + 3 * rows[:, None, None] + axes[0]
    found, place = np.unique(keys.ravel(), return_inverse=True)
    return _Pattern(place.ravel(), found % size, np.searchsorted(found, size * np.arange(size + 1)))


@compiled_quickly
def _whole(scene: Scene, q: NodeVectors) -> tuple:
    U, slope = jax.value_and_grad(scene.potential_energy)(q, 0.0)
    return U, slope, jax.hessian(scene.potential_energy)(q, 0.0).reshape(q.size, q.size)


@compiled_quickly
def _blocks(scene: Scene, q: NodeVectors, probe: NodeVectors) -> tuple:
    """U, its gradient, the blocks of its Hessian, of members first, and the Hessian's product with `probe`."""
    kinds = scene.structure.kinds
    vectors = member_vectors(q, kinds)

    def energy(x, d):
        return scene.potential_energy(x, 0.0, d)

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

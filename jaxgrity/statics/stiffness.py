"""Sparse matrices of a scene at one shape: tangent stiffness d2U/dq2, from its own U, and consistent mass."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from jaxtyping import Bool, Float

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, Edges, MassMatrix, NodeVectors
from jaxgrity.model.laws import EnergyTerm
from jaxgrity.model.scene import Scene
from jaxgrity.model.springs import as_springs, check_no_bodies
from jaxgrity.model.structure import Structure, member_vectors, onto_nodes

Fixed = Bool[AnyArray, "nodes 3"]
"""Whether supports hold each coordinate of each node."""
UNRESISTED = 1e-11
"""Stiffness of a rigid motion, as a share of the largest, that is an error of the shape and of arithmetic."""
SEPARABLE = 1e-6
"""Largest relative difference between the whole Hessian and one made of blocks."""


def all_edges(structure: Structure) -> Edges:
    """The members' nodes in the order of their numbers: struts first, then cables."""
    return tuple(edge for m in (structure.struts, structure.cables) if m is not None for edge in m.edges)


def incidence(edges: Edges, nodes: int) -> sp.csr_array:
    """C (members, nodes): +1 at the first node of each member, -1 at the second; C q are the members' d."""
    ends = np.asarray(edges, int).reshape(-1, 2)
    rows = np.repeat(np.arange(len(ends)), 2)
    return sp.csr_array((np.tile([1.0, -1.0], len(ends)), (rows, ends.ravel())), shape=(len(ends), nodes))


def with_spring_struts(scene: Scene, stiff: float | None = None) -> Scene:
    """The scene with stiff springs for rigid struts, as `as_springs` has them.

    Raises `InputError` where its ground is exact contact.
    """
    if scene.ground is not None and scene.ground.impulsive:
        raise InputError("statics needs forces, and exact contact has none; expected penalty contact, or no ground")
    return dataclasses.replace(scene, structure=as_springs(scene.structure, stiff)[0])


@typed
def stiffness_matrix(scene: Scene, q: NodeVectors) -> sp.csc_array:
    """K = d2U/dq2 at `q` and t = 0, N/m, (3 nodes, 3 nodes), from the scene's own potential energy.

    U is a sum of functions of one member's d = x_i - x_j and of one node's x. So its Hessian is one 3 x 3 block for
    each member and each node, and three products with the Hessian give all blocks, whatever the size. Raises
    `InputError` where a term of U couples nodes in another way; one random product with the whole Hessian shows it.
    With cables through several nodes the Hessian is computed whole: some hundred nodes at most.
    """
    cables = scene.structure.cables
    if cables is not None and cables.clusters:
        with jax.enable_x64(True):
            return sp.csc_array(np.asarray(_whole(scene, jnp.asarray(q, float))))
    with jax.enable_x64(True):
        q = jnp.asarray(q, float)
        by_member, by_node, probe, product = jax.tree.map(np.asarray, _blocks(scene, q))
    edges = [edge for kind in by_member for edge in scene.structure.kinds[kind].edges]
    K = _block_diagonal(by_node)
    if edges:
        C = sp.kron(incidence(tuple(edges), len(q)), sp.eye_array(3), format="csr")
        K = K + C.T @ _block_diagonal(np.concatenate([by_member[kind] for kind in by_member])) @ C
    error = np.abs(K @ probe.ravel() - product.ravel()).max()
    if error > SEPARABLE * max(np.abs(product).max(), np.finfo(float).tiny):
        raise InputError("a term of U joins nodes otherwise than by members; expected terms of single members or nodes")
    return sp.csc_array(K)


@typed
def sparse_mass_matrix(structure: Structure) -> sp.csc_array:
    """M, kg, (3 nodes, 3 nodes): the same as `inertia.mass_matrix`, for structures of any size.

    Nodes are points; a member's mass m is spread along it, T = m/6 (v_p·v_p + v_p·v_q + v_q·v_q).
    """
    check_no_bodies(structure, "vibrations")
    nodes = len(structure.nodes)
    M = sp.diags_array(np.asarray(structure.node_mass, float))
    for mass, edges in structure.rod_masses:
        joins = abs(incidence(edges, nodes))
        sixth = sp.diags_array(np.asarray(mass, float) / 6)
        # [[2, 1], [1, 2]] is what the sum of both ends has, and the identity once more
        M = M + joins.T @ sixth @ joins + sp.diags_array(joins.T @ sixth.diagonal())
    return sp.csc_array(sp.kron(M, sp.eye_array(3)))


def free_coordinates(nodes: int, fixed: Fixed | None) -> np.ndarray:
    """The indices of the unsupported ones of the 3 nodes coordinates. Raises `InputError` on another shape."""
    if fixed is None:
        return np.arange(3 * nodes)
    if np.shape(fixed) != (nodes, 3):
        raise InputError(f"fixed has shape {np.shape(fixed)}; expected ({nodes}, 3), whether each coordinate is held")
    return np.flatnonzero(~np.asarray(fixed, bool).ravel())


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


def unresisted_motions(scene: Scene, q: NodeVectors, K: sp.csc_array) -> np.ndarray:
    """Those of the rigid motions that nothing in the scene resists, likewise; `K` is that of the free coordinates.

    Members resist none. Gravity resists the swinging of what hangs, and soft ground what sinks in or tilts.
    """
    rigid = rigid_motions(q, scene.structure.supported)
    hangs = scene.gravity is not None and bool(scene.structure.fixed)
    stands = scene.ground is not None and bool((scene.ground.measured(np.asarray(q)).distance < 0).any())
    if not (hangs or stands or any(isinstance(term, EnergyTerm) for term in scene.terms)):
        return rigid
    resistance, turned = np.linalg.eigh(rigid.T @ (K @ rigid))
    return rigid @ turned[:, np.abs(resistance) <= UNRESISTED * abs(K).max()]


def factor_if_definite(A: sp.csc_array) -> spla.SuperLU | None:
    """A sparse factorisation of the symmetric `A` where all its eigenvalues are positive, else None.

    Without pivoting, A = L D L', and by Sylvester's law of inertia the signs of D are those of the eigenvalues.
    """
    try:
        options = {"SymmetricMode": True}
        found = spla.splu(sp.csc_matrix(A), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError:  # exactly singular
        return None
    pivoted = not np.array_equal(found.perm_r, found.perm_c)
    return None if pivoted or not np.all(found.U.diagonal() > 0) else found


def _block_diagonal(blocks: Float[AnyArray, "count 3 3"]) -> sp.csr_array:
    return sp.csr_array(sp.bsr_array((blocks, np.arange(len(blocks)), np.arange(len(blocks) + 1))))


@eqx.filter_jit
def _whole(scene: Scene, q: NodeVectors) -> MassMatrix:
    return jax.hessian(scene.potential_energy)(q, 0.0).reshape(q.size, q.size)


@eqx.filter_jit
def _blocks(scene: Scene, q: NodeVectors) -> tuple:
    """The blocks of d2U by kind of member and by node; a random displacement, and its product with the Hessian."""
    kinds = scene.structure.kinds
    vectors = member_vectors(q, kinds)

    def energy(x, d):
        return scene.potential_energy(x, 0.0, d)

    def units(tree):
        return jax.tree.map(lambda x: jnp.broadcast_to(jnp.eye(3), (len(x), 3, 3)), tree)

    _, push = jax.linearize(jax.grad(energy, argnums=(0, 1)), q, vectors)
    still = jax.tree.map(jnp.zeros_like, (q, vectors))
    by_member = jax.vmap(lambda d: push(still[0], d)[1], in_axes=-1, out_axes=-1)(units(vectors)) if vectors else {}
    by_node = jax.vmap(lambda x: push(x, still[1])[0], in_axes=-1, out_axes=-1)(units(q))
    probe = jax.random.normal(jax.random.key(0), q.shape, q.dtype)
    on_nodes, on_members = push(probe, member_vectors(probe, kinds))
    return by_member, by_node, probe, on_nodes + (onto_nodes(on_members, kinds, len(q)) if vectors else 0)

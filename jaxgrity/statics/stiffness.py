"""Sparse matrices of a scene at one shape: tangent stiffness d2U/dq2, from its own U, and consistent mass."""

from collections.abc import Callable

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
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, Edges, NodeVectors
from jaxgrity.model.bodies import Bodies
from jaxgrity.model.body_points import carrying, independent_nodes
from jaxgrity.model.laws import EnergyTerm
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.model.structure import Structure
from jaxgrity.statics.hessians import block_pattern, hessian_blocks, joining_terms, made_of_blocks, whole_hessian
from jaxgrity.statics.slide_springs import Tangent, about, apart, sum_of_both
from jaxgrity.statics.spectrum import unpivoted

Fixed = Bool[AnyArray, "nodes 3"]
"""Whether supports hold each coordinate of each node."""
UNRESISTED = 1e-11
"""Stiffness of a rigid motion, as a share of the largest, that is an error of the shape and of arithmetic."""
BENT = 1e-6
"""Singular values below which a displacement leaves bodies rigid: shapes at rest are not exact."""
MOST_WHOLE = 300
"""Most nodes of a structure with terms that join nodes: the cost of a whole Hessian grows with the square of them."""


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

    Most U are sums of functions of one member's d = x_i - x_j and of one node's x. Then the Hessian is one 3 x 3 block
    for each member and each node, and three products with the Hessian give all blocks, whatever the size. With cables
    through several nodes, or terms that join nodes in another way, such as springs of hinges, the Hessian is computed
    whole. Raises `InputError` where such a term is in a structure of more than `MOST_WHOLE` nodes.
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
        joining = joining_terms(known)
    if joining and nodes > MOST_WHOLE:
        names = ", ".join(joining)
        raise InputError(f"{names}: joins nodes otherwise than by members; expected at most {MOST_WHOLE} nodes")
    if joining or (cables is not None and cables.clusters):

        def whole(q: NodeVectors) -> Tangent:
            with jax.enable_x64(True):
                U, slope, K = jax.tree.map(np.asarray, whole_hessian(known, jnp.asarray(q, float)))
            return Tangent(float(U), slope, lambda: sp.csc_array(K))

        return whole
    pattern, probe = block_pattern(scene.structure), np.random.default_rng(0).normal(size=(nodes, 3))

    def parted(q: NodeVectors) -> Tangent:
        with jax.enable_x64(True):
            U, slope, blocks, product = jax.tree.map(np.asarray, hessian_blocks(known, jnp.asarray(q, float), probe))

        def stiffness() -> sp.csc_array:
            K = pattern.matrix(blocks)
            if not made_of_blocks(K, probe, product):
                raise InputError("a term of U joins nodes otherwise than by members here, but not in the given shape")
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

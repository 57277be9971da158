"""Force densities q = f/l (N/m, tension positive): self-stress, mechanisms, stability, and prestressed shapes.

Equilibrium of a node is linear in the members' force densities, sum_j q_ij (x_i - x_j) = p_i, and for given densities
linear in the positions (Schek 1974, doi:10.1016/0045-7825(74)90045-0). A (3 nodes, members) is the first matrix, the
stress matrix Omega (nodes, nodes) the second: A q = (Omega x 1_3) x. Members are numbered struts first, then cables.
"""

from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, Edges, NodeVectors, PerMember
from jaxgrity.model.bodies import Bodies
from jaxgrity.model.body_points import body_pairs, carrying, independent_nodes
from jaxgrity.model.structure import edge_lengths
from jaxgrity.statics.stiffness import Fixed, free_coordinates, free_motions, incidence, rigid_motions

RANK = 1e-9
"""Singular values below this share of the largest count as zero."""

Columns = Float[AnyArray, "members states"]
Mechanisms = Float[AnyArray, "modes nodes 3"]


class Statics(NamedTuple):
    """The four subspaces of an equilibrium matrix (Pellegrino and Calladine 1986, doi:10.1016/0020-7683(86)90014-4)."""

    rank: int
    self_stress: Columns
    """force densities in equilibrium without loads, N/m: orthonormal columns, one for each state of self-stress"""
    mechanisms: Mechanisms
    """orthonormal displacements that change no length to first order, without rigid motions"""
    rigid: int
    """rigid motions that supports leave"""


def equilibrium_matrix(nodes: NodeVectors, edges: Edges) -> scipy.sparse.csc_array:
    """A (3 nodes, members), m: A q are the loads in equilibrium with q, the coordinates of a node side by side."""
    x = np.asarray(nodes, float)
    C = incidence(edges, len(x))
    d = C @ x
    by_axis = [C.T @ scipy.sparse.diags_array(d[:, axis]) for axis in range(3)]
    rows = np.arange(3 * len(x)).reshape(3, len(x)).T.ravel()
    return scipy.sparse.csc_array(scipy.sparse.vstack(by_axis, format="csr")[rows])


def stress_matrix(force_density: PerMember, edges: Edges, nodes: int) -> scipy.sparse.csc_array:
    """Omega = C' diag(q) C (nodes, nodes), N/m, with C the incidence matrix."""
    C = incidence(edges, nodes)
    return scipy.sparse.csc_array(C.T @ scipy.sparse.diags_array(np.asarray(force_density, float)) @ C)


def statics_of(
    nodes: NodeVectors, edges: Edges, fixed: Fixed | None = None, tolerance: float = RANK, bodies: Bodies = ()
) -> Statics:
    """Rank, states of self-stress and mechanisms of bars between `nodes`, m, from the singular values of A.

    `fixed` (nodes, 3): the coordinates held by supports. Rigid `bodies` carry any forces that balance on them: their
    equations of equilibrium, of forces and moments, take the place of those of their nodes. Singular values below
    `tolerance` times the largest count as zero: the assumed exactness of the shape. A matrix of more than some thousand
    rows takes minutes.
    """
    x = np.asarray(nodes, float)
    place, free = free_motions(x, fixed, bodies), free_coordinates(len(x), fixed)
    A = (place.T @ equilibrium_matrix(x, edges)).toarray()
    left, size, right = np.linalg.svd(A)
    rank = int(np.sum(size > tolerance * size.max(initial=0)))
    rigid = place[free].T @ rigid_motions(x, fixed)
    soft = left[:, rank:]
    inner, _, _ = np.linalg.svd(soft - rigid @ (rigid.T @ soft), full_matrices=False)
    mechanisms = (place @ inner[:, : soft.shape[1] - rigid.shape[1]]).T
    return Statics(rank, right[rank:].T, mechanisms.reshape(-1, *x.shape), rigid.shape[1])


def group_average(self_stress: Columns, permutations: tuple[tuple[int, ...], ...]) -> Columns:
    """The states of self-stress invariant under a group of symmetries: orthonormal columns, maybe none.

    `permutations` of the members: all of the group, such as `Symmetry.members`. The average over a group is the
    projection on what is invariant.
    """
    mean = np.mean([self_stress[list(moved)] for moved in permutations], axis=0)
    left, size, _ = np.linalg.svd(mean, full_matrices=False)
    return left[:, size > 0.5]


def prestress(
    nodes: NodeVectors, struts: Edges, cables: Edges, tension: float, fixed: Fixed | None = None, bodies: Bodies = ()
) -> PerMember:
    """Force densities, N/m, of the self-stress with the most evenly tight cables, the tightest with `tension`, N.

    The smallest tension in a cable is maximised for a given largest one: a linear program (HiGHS), also for thousands
    of members. Rigid `bodies` carry any forces that balance on them. Raises `InputError` where no self-stress has every
    cable in tension.
    """
    held = body_pairs(bodies)[0] if bodies else ()
    edges = (*held, *struts, *cables)
    length = edge_lengths(nodes, edges)
    A = equilibrium_matrix(nodes, edges) @ scipy.sparse.diags_array(1 / length)
    if bodies:
        A = scipy.sparse.kron(carrying(bodies, len(nodes)).T, np.eye(3), format="csc") @ A
        fixed = None if fixed is None else fixed[list(independent_nodes(bodies, len(nodes)))]
    A = A[free_coordinates(A.shape[0] // 3, fixed)]
    first, count = len(edges) - len(cables), len(edges)
    # unknowns: members' forces, and the smallest of the cables', which is what is to be large
    none = scipy.sparse.csc_array((A.shape[0], 1))
    pull = scipy.sparse.eye_array(count, format="csc")[first:]
    slack = scipy.sparse.hstack([-pull, np.ones((count - first, 1))])
    bounds = [(None, None)] * first + [(0, 1)] * (count - first) + [(None, 1)]
    goal = np.zeros(count + 1)
    goal[-1] = -1
    found = scipy.optimize.linprog(
        goal,
        A_ub=slack,
        b_ub=np.zeros(count - first),
        A_eq=scipy.sparse.hstack([A, none]),
        b_eq=np.zeros(A.shape[0]),
        bounds=bounds,
    )
    if not found.success or not cables or found.x[-1] <= RANK:
        raise InputError("no self-stress has every cable in tension: expected a structure that can be prestressed")
    return (tension * found.x[:-1] / found.x[first:-1].max() / length)[len(held) :]


def rest_lengths(nodes: NodeVectors, edges: Edges, stiffness: PerMember, force_density: PerMember) -> PerMember:
    """L = l - q l/K, m: the rest lengths of springs of stiffness K with force densities q at `nodes`. Differentiable.

    Raises `InputError` where a member would need a rest length that is not positive.
    """
    i, j = np.asarray(edges, int).reshape(-1, 2).T
    length = ((nodes[i] - nodes[j]) ** 2).sum(1) ** 0.5
    rest = length * (1 - force_density / stiffness)
    if isinstance(rest, np.ndarray) and not np.all(rest > 0):
        k = int(np.argmin(rest))
        raise InputError(f"member {k} needs a rest length of {rest[k]:.4g} m for its force; expected a stiffer member")
    return rest


def shape_of_force_densities(
    force_density: PerMember, edges: Edges, nodes: NodeVectors, fixed: Fixed, loads: NodeVectors | None = None
) -> np.ndarray:
    """The one shape in which given force densities balance `loads`, N, with some coordinates of `nodes`, m, supported.

    Omega_ff x_f = p_f - Omega_fs x_s, axis by axis (Schek 1974). Raises `InputError` without a unique solution.
    """
    x = np.array(nodes, float)
    Omega = stress_matrix(force_density, edges, len(x))
    pull = np.zeros(x.shape) if loads is None else np.asarray(loads, float)
    for axis in range(3):
        held = np.asarray(fixed, bool)[:, axis]
        rows = Omega[~held]
        try:
            solve = scipy.sparse.linalg.splu(scipy.sparse.csc_matrix(rows[:, ~held]))
        except RuntimeError as error:
            raise InputError(
                "the force densities do not decide the shape; expected more supports, or others"
            ) from error
        x[~held, axis] = solve.solve(pull[~held, axis] - rows[:, held] @ x[held, axis])
    return x


def nearest_tensegrity(
    nodes: NodeVectors, struts: Edges, cables: Edges, iterations: int = 1000
) -> tuple[np.ndarray, np.ndarray]:
    """A free-standing shape near `nodes`, m, with a self-stress, and its force densities (of unit length).

    Two linear problems in turn, until both hold to rounding (adaptive force densities: Zhang and Ohsaki 2006): the
    force densities near the last ones that are closest to equilibrium, and the nearest shape in which they are in
    equilibrium. Raises `InputError` without convergence, or with a cable in compression.
    """
    edges = (*struts, *cables)
    x = np.array(nodes, float)
    signs = np.r_[-np.ones(len(struts)), np.ones(len(cables))]
    q = signs / np.linalg.norm(signs)
    for _ in range(iterations):
        _, size, right = np.linalg.svd(equilibrium_matrix(x, edges).toarray())
        size = np.r_[size, np.zeros(len(edges) - len(size))]
        # the smallest singular value is to be zero; others as small belong to further states of self-stress
        near = right[size <= max(2 * size[-1], RANK * size[0])]
        q = near.T @ (near @ q)
        q /= np.linalg.norm(q)
        values, vectors = np.linalg.eigh(stress_matrix(q, edges, len(x)).toarray())
        flat = vectors[:, np.argsort(np.abs(values))[:4]]
        x = flat @ (flat.T @ x)
        error = np.abs(equilibrium_matrix(x, edges) @ q).max() / np.ptp(x, axis=0).max()
        if error < 1e-14:
            break
    if error > 1e-12 or np.any(q[len(struts) :] <= 0):
        raise InputError(
            "no self-stressed shape with every cable in tension is near the given one; expected another start"
        )
    return x, q


def prestress_stable(mechanisms: Mechanisms, edges: Edges, force_density: PerMember) -> bool:
    """Whether a self-stress stiffens every one of the `mechanisms` m of `statics`: m' (Omega x 1_3) m > 0.

    Second-order rigidity, whatever the members' stiffness (Connelly and Whiteley 1996, doi:10.1137/S0895480192229236).
    """
    if not len(mechanisms):
        return True
    Omega = stress_matrix(force_density, edges, mechanisms.shape[1]).toarray()
    quadratic = np.einsum("aix,ij,bjx->ab", mechanisms, Omega, mechanisms, optimize=True)
    return bool(np.linalg.eigvalsh(quadratic).min() > RANK * np.abs(force_density).max())


def super_stable(nodes: NodeVectors, edges: Edges, force_density: PerMember) -> bool:
    """Whether the shape is stable for any stiffness and any size of self-stress (Connelly 1982).

    Three conditions: Omega has no negative eigenvalue; its rank is nodes - 1 - d, with d the dimensions of the nodes'
    span (3, in a plane 2); no affine map but a rigid motion keeps all lengths.
    """
    x = np.asarray(nodes, float)
    _, spread, axes = np.linalg.svd(x - x.mean(0), full_matrices=False)
    spanned = axes[spread > RANK * spread[0]]
    values = np.linalg.eigvalsh(stress_matrix(force_density, edges, len(x)).toarray())
    zero = RANK * np.abs(values).max()
    if values.min() < -zero or int(np.sum(values > zero)) != len(x) - 1 - len(spanned):
        return False
    d = incidence(edges, len(x)) @ x @ spanned.T
    pairs = list(combinations_with_replacement(range(len(spanned)), 2))
    products = np.stack([d[:, a] * d[:, b] for a, b in pairs], axis=1)
    return int(np.linalg.matrix_rank(products, tol=RANK * np.linalg.norm(products))) == len(pairs)

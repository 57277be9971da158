"""The linearised motion of a large structure by sparse matrices: no array grows as the square of the nodes."""

import itertools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from jaxgrity.core.quick import compiled_quickly
from jaxgrity.core.tracing import evaluated
from jaxgrity.core.types import AnyArray, NodeVectors, State
from jaxgrity.model.inertia import momenta
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.model.shaking import support_acceleration
from jaxgrity.model.structure import Structure
from jaxgrity.statics.stiffness import all_edges, coordinate_map, sparse_mass_matrix
from jaxgrity.stepping.dynamics import smooth_force
from jaxgrity.stepping.linearised import Linearised, constraint_rows, turning

DEPENDENT = 1e-8
"""Relative strength below which a motion follows from the others."""
SINGULAR = 1e-12
"""Relative compliance of constraints, so that redundant ones have a solution too."""
SHARED = 1e-8
"""Likewise where it decides how redundant constraints share a force: rounding is divided by it."""
MARGIN = 1.01
"""Factor by which bounds from Lanczos' method are larger than what it finds, which is at least 0.999 of the largest."""
SEPARATE = 1e-9
"""Largest relative difference between a product with the whole Jacobian and with the sparse one."""


class SparseMotion(NamedTuple):
    """Linearised motion M y'' = -K y - C y' + J' f with J y = 0, for the n coordinates y that neither supports hold nor
    bodies carry."""

    mass: sp.csc_array
    """(n, n), kg"""
    stiffness: sp.csr_array
    """(n, n), N/m, with what the constraints' forces add as they turn"""
    damping: sp.csr_array
    """(n, n), N s/m"""
    solve: Callable[[np.ndarray], np.ndarray]
    """acceleration (n,), m/s^2, that forces (n,), N, cause along the constraints"""
    rows: sp.csr_array
    """(constraints, n), J"""
    place: sp.csr_array
    """(3 nodes, n), how all coordinates follow these"""
    coupling: float
    """lower bound for x'Mx / x'Dx with the diagonal D of M: below 1 for members and bodies with mass"""

    def bounds(self) -> tuple[float, float]:
        """Upper bounds for x'Kx / x'Mx, 1/s^2, and x'Cx / x'Mx, 1/s, by Gershgorin's theorem."""
        least = self.coupling * self.mass.diagonal()
        K, C = (float((abs(x).sum(axis=1) / least).max(initial=0)) for x in (self.stiffness, self.damping))
        return K, C

    def closer_bounds(self) -> tuple[float, float]:
        """The same among motions that keep the constraints, by Lanczos' method, with a margin for its error."""
        n = self.mass.shape[0]
        inverse = spla.LinearOperator((n, n), matvec=self.solve, dtype=float)
        start = self.solve(np.random.default_rng(0).normal(size=n))

        def largest(A: sp.csr_array) -> float:
            if not A.nnz:
                return 0.0
            found = spla.eigsh(A, 1, self.mass, which="LA", Minv=inverse, v0=start, return_eigenvectors=False, tol=1e-3)
            return MARGIN * max(0.0, float(found[0]))

        return largest(self.stiffness), largest(self.damping)

    def reduced(self, motions: np.ndarray) -> Linearised:
        """The motion within the span of displacements, (n, k)."""
        size = np.linalg.norm(motions, axis=0)
        basis = self._normalised(motions[:, size > 0] / size[size > 0])
        # once more, without what violates constraints: rounding has been divided by the smallest strength. Where
        # constraints leave few motions, more have been sought than there are, and nothing is left of the rest
        basis = self._normalised(np.stack([self.solve(x) for x in (self.mass @ basis).T], axis=1))
        stiffness, damping = (basis.T @ (x @ basis) for x in (self.stiffness, self.damping))
        return Linearised(stiffness, damping, self.place @ basis)

    def _normalised(self, basis: np.ndarray) -> np.ndarray:
        """A basis B of the same displacements, (n, k), without dependent ones: B'MB = 1."""
        strengths, axes = np.linalg.eigh(basis.T @ (self.mass @ basis))
        kept = strengths > DEPENDENT * strengths.max(initial=0)
        return basis @ (axes[:, kept] / np.sqrt(strengths[kept]))


def sparse_motion(scene: Scene, state: State) -> SparseMotion | None:
    """`linearise` with sparse matrices; None where forces join nodes otherwise than by members and bodies."""
    structure = scene.structure
    with jax.enable_x64(True), evaluated():
        q, v = (np.asarray(x, float) for x in state)
        found = _force_and_slopes(as_dtype(scene, "float64"), q, v)
    if found is None:
        return None
    force, K, C = found
    follow, free = coordinate_map(structure)
    place = sp.csr_array(sp.csc_array(follow)[:, free])
    M, J = _onto(place, sparse_mass_matrix(structure)), sp.csr_array(constraint_rows(scene, q) @ place)
    if J.shape[0]:
        K = K - turning(scene, q, _constraint_forces(sp.csc_array(M), J, place.T @ force.ravel()))
    K, C = (_onto(place, x) for x in (K, C))
    for x in (K, C):
        x.eliminate_zeros()
    M = sp.csc_array(M)
    return SparseMotion(M, K, C, constrained_inverse(M, J), J, place, _coupling(structure))


def _onto(place: sp.csr_array, x: sp.sparray) -> sp.csr_array:
    """A quadratic form of all coordinates as one of those that the others follow."""
    found = sp.csr_array(place.T @ sp.csr_array(x) @ place)
    found.sort_indices()
    return found


def _coupling(structure: Structure) -> float:
    """`SparseMotion.coupling`: the smallest one of all nodes, members and bodies, of whose parts M is the sum."""
    bounds = [1.0, *(0.5 for mass, _ in structure.rod_masses if np.any(mass))]  # [[2, 1], [1, 2]]
    for body in structure.bodies:
        matrix = np.asarray(body.matrix, float)
        root = np.sqrt(matrix.diagonal())
        bounds.append(float(np.linalg.eigvalsh(matrix / np.outer(root, root))[0]))
    return min(bounds)


def _constraint_forces(M: sp.csc_array, J: sp.csr_array, force: np.ndarray) -> np.ndarray:
    """(constraints,), N: the smallest forces f with J M^-1 (`force` + J' f) = 0."""
    solve = _with_constraints(M, J, SHARED)
    a, f = solve(force)
    # what the compliance of the constraints let pass
    for _ in range(2):
        more, of_these = solve(np.zeros(len(force)), J @ a)
        a, f = a + more, f + of_these
    return f


def constrained_inverse(M: sp.csc_array, J: sp.csr_array) -> Callable[[np.ndarray], np.ndarray]:
    """The map from forces to accelerations that keep J a = 0."""
    solve = _with_constraints(M, J, SINGULAR)
    return lambda force: solve(force)[0]


def _with_constraints(
    M: sp.csc_array, J: sp.csr_array, compliance: float
) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """The map from forces (and an acceleration that constraints take back) to accelerations and constraints' forces."""
    n, count = M.shape[0], J.shape[0]
    soft = compliance / np.abs(M.diagonal()).max(initial=0) * sp.eye_array(count)
    whole = sp.block_array([[M, J.T], [J, -soft]], format="csc") if count else M
    factor, rest = spla.splu(sp.csc_matrix(whole)), np.zeros(count)

    def solve(force: np.ndarray, taken: np.ndarray = rest) -> tuple[np.ndarray, np.ndarray]:
        found = factor.solve(np.concatenate([force, -taken]))
        return found[:n], -found[n:]

    return solve


def _neighbours(scene: Scene) -> sp.csr_array:
    """(nodes, nodes): which nodes' forces depend on which nodes' places, by members, bodies or cables in clusters.

    A ball's friction depends on how its body turns.
    """
    structure = scene.structure
    pairs = [(node, node) for node in range(len(structure.nodes))] + list(all_edges(structure))
    for body in structure.bodies:
        pairs += itertools.combinations(sorted(body.points), 2)
    for members in structure.members:
        for cluster in members.clusters:
            axles = [pulley.axle for pulley in members.pulleys if pulley.axle and pulley.between[0] in cluster]
            along = sorted({node for edge in (*(members.edges[k] for k in cluster), *axles) for node in edge})
            pairs += [(i, j) for i in along for j in along if i < j]
    i, j = np.array(pairs).T
    size = len(structure.nodes)
    joined = sp.csr_array((np.ones(len(pairs)), (i, j)), shape=(size, size))
    joined = sp.csr_array(joined + joined.T)
    joined.sort_indices()
    return joined


def _colours(joined: sp.csr_array) -> np.ndarray:
    """(nodes,): numbers such that no node has two neighbours of the same, itself among them."""
    near, colours = sp.csr_array(joined @ joined), np.full(joined.shape[0], -1)
    for node in range(len(colours)):
        taken = set(colours[near.indices[near.indptr[node] : near.indptr[node + 1]]].tolist())
        colours[node] = next(k for k in range(len(taken) + 1) if k not in taken)
    return colours


def _force_and_slopes(scene: Scene, q: np.ndarray, v: np.ndarray) -> tuple | None:
    """Force, N, -dF/dq and -dF/dv; nodes of one colour move together, since no force depends on two of them.

    One random motion more shows whether forces depend on other nodes too; None then.
    """
    joined = _neighbours(scene)
    colours = _colours(joined)
    count, nodes = colours.max() + 1, len(q)
    units = np.zeros((count, 3, nodes, 3))
    units[colours, :, np.arange(nodes)] = np.eye(3)
    probe = np.random.default_rng(0).normal(size=q.shape)
    moves = np.concatenate([units.reshape(-1, nodes, 3), probe[None]])
    force, *changes = (np.asarray(x) for x in _pushes(scene, q, v, moves))
    rows, matrices = np.repeat(np.arange(nodes), np.diff(joined.indptr)), []
    for change in changes:
        whole = change[:-1].reshape(count, 3, nodes, 3)
        blocks = -whole[colours[joined.indices], :, rows].swapaxes(1, 2)
        matrix = sp.csr_array(sp.bsr_array((blocks, joined.indices, joined.indptr), shape=(q.size, q.size)))
        if np.abs(matrix @ probe.ravel() + change[-1].ravel()).max() > SEPARATE * np.abs(change[-1]).max():
            return None
        matrices.append(matrix)
    return force, *matrices


@compiled_quickly
def _pushes(scene: Scene, q: NodeVectors, v: NodeVectors, moves: AnyArray):
    """Force, N, and its changes with displacements and with velocities `moves` (moves, nodes, 3)."""

    def total(q, v):
        force = smooth_force(scene, 0.0, q, v, scene.normal_force(q, v))
        if scene.shaking is None:
            return force
        return force - momenta(scene.structure, support_acceleration(scene.shaking, scene.structure, 0.0))

    force, push = jax.linearize(total, q, v)
    # one loop for both, which halves the time to compile
    still = jnp.zeros_like(moves)
    changes = jax.lax.map(lambda x: push(*x), (jnp.concatenate([moves, still]), jnp.concatenate([still, moves])))
    return force, changes[: len(moves)], changes[len(moves) :]

"""The motions that limit the step of a large structure, by sparse matrices: no array grows as the square of the nodes.

`linearise` has all motions of a structure, from dense matrices. Here the step of the method is a product with sparse
matrices, and Arnoldi's method (ARPACK) finds the few motions that such a step amplifies most. The limit follows from
these alone.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from jaxgrity.core.tracing import evaluated
from jaxgrity.core.types import AnyArray, NodeVectors, State
from jaxgrity.model.inertia import momenta
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.model.shaking import support_acceleration
from jaxgrity.statics.stiffness import all_edges, factor_if_definite, sparse_mass_matrix
from jaxgrity.stepping.dynamics import smooth_force
from jaxgrity.stepping.linearised import GROWTH, Linearised, constraint_rows, largest_step, turning
from jaxgrity.stepping.methods import Method, amplification

MODES = 8
"""Number of motions that are sought in each round. Motions of equal parts of a structure are equally fast."""
ROUNDS = 12
"""Most rounds: each seeks the motions that grow most at a step a little above the limit found so far."""
ABOVE = (1.1, 1.001)
"""Those steps, as multiples of the limit found so far: at first where few motions grow much, which are found quickly,
then close to the limit, where no other motion grows more than the one that sets it."""
SEEN, RESTARTS = 40, 20
"""Size of the space in which Arnoldi's method looks for motions, and most of its restarts."""
DEPENDENT = 1e-8
"""Relative strength below which a motion follows from the others."""
SAME_LIMIT = 1e-7
"""Relative change of the limit from one round to the next at which it counts as found."""
SINGULAR = 1e-12
"""Relative compliance of constraints, so that redundant ones have a solution too."""
SEPARATE = 1e-9
"""Largest relative difference between a product with the whole Jacobian and with the sparse one."""


class SparseMotion(NamedTuple):
    """Linearised motion M y'' = -K y - C y' + J' f with J y = 0, for the n coordinates y that no support holds."""

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
    """(3 nodes, n), where these coordinates are among all"""

    def bounds(self) -> tuple[float, float]:
        """Upper bounds for x'Kx / x'Mx, 1/s^2, and x'Cx / x'Mx, 1/s, by Gershgorin's theorem."""
        least = self.mass.diagonal()
        # a member's mass: [[2, 1], [1, 2]] is at least half of its diagonal
        least = least if abs(self.mass).sum() == least.sum() else least / 2
        return tuple(float((abs(x).sum(axis=1) / least).max(initial=0)) for x in (self.stiffness, self.damping))

    def reduced(self, motions: np.ndarray) -> Linearised:
        """The motion within the span of displacements, (n, k)."""
        size = np.linalg.norm(motions, axis=0)
        basis = motions[:, size > 0] / size[size > 0]
        strengths, axes = np.linalg.eigh(basis.T @ (self.mass @ basis))
        kept = strengths > DEPENDENT * strengths.max(initial=0)
        basis = basis @ (axes[:, kept] / np.sqrt(strengths[kept]))
        # once more, without what violates constraints: rounding has been divided by the smallest strength
        basis = np.stack([self.solve(x) for x in (self.mass @ basis).T], axis=1)
        root = np.linalg.cholesky(basis.T @ (self.mass @ basis))
        basis = np.linalg.solve(root, basis.T).T
        stiffness, damping = (basis.T @ (x @ basis) for x in (self.stiffness, self.damping))
        return Linearised(stiffness, damping, self.place @ basis)


def leading_modes(motion: SparseMotion, method: Method) -> Linearised:
    """The linearised motion in the span of those motions that limit the step of the method."""
    K, C = motion.bounds()
    n, fastest = motion.mass.shape[0], C / 2 + np.sqrt(C * C / 4 + K)
    if not fastest:
        return Linearised(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((motion.place.shape[0], 0)))
    start = np.concatenate([motion.solve(x) for x in np.random.default_rng(0).normal(size=(2, n))])
    # impulses of one step are compared with the fastest true growth
    found = _growing(motion, K) if method.constrained else np.zeros((n, 0))
    rates, states = _largest(_rate(motion, 1 / fastest), start)
    found, limit, above, rest = _with(found, motion, states, None), np.inf, ABOVE[0], np.abs(rates).min(initial=1.0)
    for _ in range(ROUNDS):
        linear, last = motion.reduced(found), limit
        limit = largest_step(linear, method)
        if above == ABOVE[1] and last - limit <= SAME_LIMIT * limit:
            break
        if not method.constrained and limit * rest * fastest < safe_radius(method):
            break
        above = ABOVE[0] if last == np.inf else ABOVE[1]
        _, states = _largest(_step(motion, method, above * limit), start)
        found = _with(found, motion, states, above * limit if method.constrained else None)
    return linear


def _with(found: np.ndarray, motion: SparseMotion, states: np.ndarray, h: float | None) -> np.ndarray:
    """The displacements `found` (n, k) and those of complex states (q, h v); with `h`, what a first kick adds too."""
    q, w = np.split(states, 2)
    parts = [q.real, q.imag]
    if h is not None:
        # a step multiplies by the damping twice: its factors are right where the span has what is between
        kicks = [_kick(motion, h, *state) for state in zip(q.T, w.T)]
        between = np.array(kicks, complex).reshape(-1, len(q)).T
        parts += [between.real, between.imag]
    return np.concatenate([found, *parts], axis=1)


def _largest(step: Callable, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors and states of the motions that a map multiplies by the largest factors; fewer than `MODES` at times."""
    size = len(start)
    operator = spla.LinearOperator((size, size), matvec=step, dtype=float)
    seen = min(SEEN, size)
    try:
        return spla.eigs(operator, min(MODES, size - 2), v0=start, ncv=seen, maxiter=RESTARTS, tol=1e-7)
    except spla.ArpackNoConvergence as some:
        return some.eigenvalues, some.eigenvectors


def _growing(motion: SparseMotion, bound: float) -> np.ndarray:
    """(n, few), the displacements with the least stiffness, where a stiffness may be negative; else none."""
    n, shifts = motion.mass.shape[0], bound * np.logspace(-9, 1, 11)
    shifted = (sp.csc_array(motion.stiffness + shift * motion.mass) for shift in shifts)
    shift, definite = next((x, K) for x, K in zip(shifts, shifted) if factor_if_definite(K) is not None)
    if shift == shifts[0]:
        return np.zeros((n, 0))
    inverse = spla.LinearOperator((n, n), matvec=response(definite, motion.rows), dtype=float)
    start = inverse @ np.ones(n)
    try:
        return spla.eigsh(motion.stiffness, 4, motion.mass, -shift, OPinv=inverse, v0=start, tol=1e-6)[1]
    except spla.ArpackNoConvergence as some:
        return some.eigenvectors


def _kick(motion: SparseMotion, h: float, q: np.ndarray, w: np.ndarray) -> np.ndarray:
    """The change of h v in a step of h (s) by the forces at (q, v), for w = h v."""
    force = -h * h * (motion.stiffness @ q) - h * (motion.damping @ w)
    return motion.solve(force.real) + 1j * motion.solve(force.imag) if np.iscomplexobj(force) else motion.solve(force)


def _rate(motion: SparseMotion, h: float) -> Callable[[np.ndarray], np.ndarray]:
    """The rate of change of a state (q, h v), of 2n numbers, times h (s)."""

    def rate(x: np.ndarray) -> np.ndarray:
        q, w = np.split(x.ravel(), 2)
        return np.concatenate([w, _kick(motion, h, q, w)])

    return rate


def _step(motion: SparseMotion, method: Method, h: float) -> Callable[[np.ndarray], np.ndarray]:
    """A step of h (s) from a state (q, h v), of 2n numbers, to the next."""

    def impulsive(x: np.ndarray) -> np.ndarray:
        q, w = np.split(x.ravel(), 2)
        first = w + _kick(motion, h, q, w)
        w = w + _kick(motion, h, q, (w + first) / 2)
        return np.concatenate([q + w, w])

    if method.constrained or method.symplectic:
        return impulsive
    rate = _rate(motion, h)
    tableau = method.fixed().tableau  # type: ignore[attr-defined]

    def staged(x: np.ndarray) -> np.ndarray:
        x, slopes = x.ravel(), []
        for row in ([], *tableau.a_lower):
            slopes.append(rate(x + sum((a * k for a, k in zip(row, slopes)), np.zeros(x.size))))
        return x + sum(b * k for b, k in zip(tableau.b_sol, slopes))

    return staged


def surely_stable(motion: SparseMotion, method: Method, h: float) -> bool:
    """Whether bounds of stiffness and damping show that steps of h (s) and less are stable; no eigenvalues are sought.

    With k = x'Kx / x'Mx and c = x'Cx / x'Mx of a mode x, its rate solves r^2 + c r + k = 0: |r| is at most the bound's,
    and Re r <= 0 where k and c are not negative. A complementarity step multiplies it by a root m of
    d (m - 1)^2 + h c (m - 1) + h^2 k m = 0, where 1 <= d <= 2 as long as h c <= 1. Both roots are within the unit
    circle where h^2 k + 2 h c <= 4.
    """
    if any(abs(x - x.T).max() > 1e-9 * abs(x).max() for x in (motion.stiffness, motion.damping)):
        return False
    k, c = motion.bounds()
    if method.constrained:
        small = h * c <= 1 and h * h * k + 2 * h * c <= 4
    else:
        small = h * (c / 2 + np.sqrt(c * c / 4 + k)) <= safe_radius(method)
    # slow growth is reproduced to second order: up to h^2 |k| = GROWTH it makes no difference
    shifted = [(motion.stiffness, GROWTH / h**2), (motion.damping, 1e-9 * c)]
    definite = (factor_if_definite(sp.csc_array(x + shift * motion.mass)) for x, shift in shifted if x.nnz)
    return bool(small) and all(factor is not None for factor in definite)


def safe_radius(method: Method) -> float:
    """The largest |z| within which no z = h r with Re z <= 0 is amplified by more than `GROWTH`, less a twentieth."""
    radius, angle = np.linspace(0.2, 20, 100), np.linspace(np.pi / 2, np.pi, 13)
    z = radius[:, None] * np.exp(1j * angle)
    safe = np.all(amplification(method, z.ravel()).reshape(z.shape) <= 1 + GROWTH, axis=1)
    return 0.95 * float(radius[int(np.argmin(safe)) - 1]) if not safe.all() and safe[0] else 0.0


def sparse_motion(scene: Scene, state: State) -> SparseMotion | None:
    """`linearise` with sparse matrices; None where forces join nodes otherwise than by members, and for bodies."""
    structure = scene.structure
    if structure.bodies:
        return None
    with jax.enable_x64(True), evaluated():
        q, v = (np.asarray(x, float) for x in state)
        found = _force_and_slopes(as_dtype(scene, "float64"), q, v)
    if found is None:
        return None
    force, K, C = found
    free = np.flatnonzero(structure.free.ravel())
    M, J = sparse_mass_matrix(structure)[free][:, free], constraint_rows(scene, q)[:, free]
    place = sp.csr_array((np.ones(len(free)), (free, np.arange(len(free)))), shape=(q.size, len(free)))
    if J.shape[0]:
        K = K - turning(scene, q, _constraint_forces(J, force.ravel()[free]))
    K, C = (sp.csr_array(sp.csr_array(x)[free][:, free]) for x in (K, C))
    for x in (K, C):
        x.eliminate_zeros()
    return SparseMotion(sp.csc_array(M), K, C, response(M, J), J, place)


def _constraint_forces(J: sp.csr_array, force: np.ndarray) -> np.ndarray:
    """(constraints,), N: the smallest forces f for which J' f is nearest to -`force`."""
    S, wanted = J @ J.T, -(J @ force)
    solve = spla.splu(sp.csc_matrix(S + 1e-8 * sp.eye_array(S.shape[0]))).solve
    found = solve(wanted)
    # what the shift takes off is given back
    for _ in range(2):
        found = found + solve(wanted - S @ found)
    return found


def response(M: sp.csc_array, J: sp.csr_array) -> Callable[[np.ndarray], np.ndarray]:
    """The map from forces to accelerations that keep J a = 0."""
    n, count = M.shape[0], J.shape[0]
    soft = SINGULAR / np.abs(M.diagonal()).max(initial=0) * sp.eye_array(count)
    whole = sp.block_array([[M, J.T], [J, -soft]], format="csc") if count else M
    factor, rest = spla.splu(sp.csc_matrix(whole)), np.zeros(count)
    return lambda force: factor.solve(np.concatenate([force, rest]))[:n]


def _neighbours(scene: Scene) -> sp.csr_array:
    """(nodes, nodes): which nodes' forces depend on which nodes' places, by members or by cables in clusters."""
    structure = scene.structure
    pairs = [(node, node) for node in range(len(structure.nodes))] + list(all_edges(structure))
    for members in (structure.struts, structure.cables):
        for cluster in () if members is None else members.clusters:
            along = sorted({node for k in cluster for node in members.edges[k]})
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


@eqx.filter_jit
def _pushes(scene: Scene, q: NodeVectors, v: NodeVectors, moves: AnyArray):
    """Force, N, and its changes with displacements and with velocities `moves` (moves, nodes, 3)."""

    def total(q, v):
        force = smooth_force(scene, 0.0, q, v, scene.normal_force(q, v))
        if scene.shaking is None:
            return force
        return force - momenta(scene.structure, support_acceleration(scene.shaking, scene.structure, 0.0))

    force, push = jax.linearize(total, q, v)
    still = jnp.zeros_like(q)
    by_place = jax.lax.map(lambda x: push(x, still), moves)
    return force, by_place, jax.lax.map(lambda x: push(still, x), moves)

"""The motions that limit the step of a large structure, by sparse matrices: no array grows as the square of the nodes.

`linearise` has all motions of a structure, from dense matrices. Here the step of the method is a product with sparse
matrices, and Arnoldi's method (ARPACK) finds the few motions that such a step amplifies most. The limit follows from
these alone.
"""

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from jaxgrity.statics.stiffness import factor_if_definite
from jaxgrity.stepping.linearised import GROWTH, Linearised, largest_step
from jaxgrity.stepping.methods import Method, amplification
from jaxgrity.stepping.sparse_motion import SparseMotion, constrained_inverse

MODES = 8
"""Number of motions that are sought in each round. Motions of equal parts of a structure are equally fast."""
ROUNDS = 12
"""Most rounds: each seeks the motions that grow most at a step a little above the limit found so far."""
ABOVE = (1.1, 1.0001)
"""These steps, as multiples of the limit found so far. At the first, few motions grow much, and are found quickly. The
second is close to the limit, where the motion that sets the limit grows most."""
SEEN, RESTARTS = 40, 20
"""Size of the space in which Arnoldi's method looks for motions, and most of its restarts."""
AGAINST = 10.0
"""Stiffness against constraints, as a multiple of the largest otherwise, where growth along them is looked for."""
SAME_LIMIT = 1e-7
"""Relative change of the limit from one round to the next at which it counts as found."""


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
    # thin bodies, which hardly resist being bent, make the bound large: small shifts are not to grow with it
    n, shifts = motion.mass.shape[0], bound * np.geomspace(1e-9 * motion.coupling, 10, 11)
    shifted = (sp.csc_array(motion.stiffness + shift * motion.mass) for shift in shifts)
    shift, definite = next((x, K) for x, K in zip(shifts, shifted) if factor_if_definite(K) is not None)
    if shift == shifts[0]:
        return np.zeros((n, 0))
    inverse = spla.LinearOperator((n, n), matvec=constrained_inverse(definite, motion.rows), dtype=float)
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
        x, slopes = x.ravel(), list[np.ndarray]()
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
    # slow growth is reproduced to second order: up to h^2 |k| = GROWTH it makes no difference
    shifted = [(motion.stiffness, GROWTH / h**2), (motion.damping, 1e-9 * c)]
    # motions against constraints do not count: any stiffness may be added there
    against = AGAINST * k * abs(motion.mass).max() * (motion.rows.T @ motion.rows)
    definite = (factor_if_definite(sp.csc_array(x + shift * motion.mass + against)) for x, shift in shifted if x.nnz)
    small = _within(method, h, k, c) or _within(method, h, *motion.closer_bounds())
    return small and all(factor is not None for factor in definite)


def _within(method: Method, h: float, k: float, c: float) -> bool:
    """Whether steps of h (s) are stable with stiffness and damping up to k, 1/s^2, and c, 1/s."""
    if method.constrained:
        return bool(h * c <= 1 and h * h * k + 2 * h * c <= 4)
    return bool(h * (c / 2 + np.sqrt(c * c / 4 + k)) <= safe_radius(method))


def safe_radius(method: Method) -> float:
    """The largest |z| within which no z = h r with Re z <= 0 is amplified by more than `GROWTH`, less a twentieth."""
    radius, angle = np.linspace(0.2, 20, 100), np.linspace(np.pi / 2, np.pi, 13)
    z = radius[:, None] * np.exp(1j * angle)
    safe = np.all(amplification(method, z.ravel()).reshape(z.shape) <= 1 + GROWTH, axis=1)
    return 0.95 * float(radius[int(np.argmin(safe)) - 1]) if not safe.all() and safe[0] else 0.0

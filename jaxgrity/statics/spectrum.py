"""The spectrum of small vibrations of a large structure, K x = s M x with s = (2 pi f)^2, by sparse matrices.

By Sylvester's law of inertia, K - s M has as many negative pivots as there are modes below s. So modes are counted
without computing any, and a shift can be put between those that are wanted and all others.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

WITHIN = 1e-9
"""Relative error of the squared frequencies that are found one by one."""
LARGEST_RATIO = 2.0
"""Ratio of a squared frequency to the shift below it, at most, from which it is looked for."""
ROUNDS = 4
"""Number of inverse iterations for motions without resistance."""


class Spectrum(NamedTuple):
    """Motions without momentum, R' M x = 0."""

    K: sp.csc_array
    """(n, n), stiffness of the free coordinates, N/m"""
    M: sp.csc_array
    """(n, n), mass, kg"""
    rigid: np.ndarray
    """(n, r), rigid motions R, orthonormal"""

    def stiffest(self) -> float:
        """The largest squared frequency, to a thousandth, 1/s^2; 1 where nothing has any stiffness."""
        if not abs(self.K).max():
            return 1.0
        start = np.random.default_rng(0).normal(size=self.K.shape[0])
        return float(spla.eigsh(self.K, 1, self.M, which="LM", return_eigenvectors=False, tol=1e-3, v0=start)[0])

    def below(self, square: float) -> int:
        """The number of modes with a squared frequency below this one, 1/s^2."""
        factor, momentum = unpivoted(self.K - square * self.M), self.M @ self.rigid
        negative = int(np.sum(factor.U.diagonal() < 0))
        if not momentum.shape[1]:
            return negative
        # of the matrix bordered by the momentum, which has a positive and a negative pivot more for each rigid motion
        border = -momentum.T @ factor.solve(momentum)
        return negative + int(np.sum(np.linalg.eigvalsh(border) < 0)) - momentum.shape[1]

    def inverse(self, square: float) -> spla.LinearOperator:
        """(K - s M)^-1 for motions without momentum: y with (K - s M) y = x + M R m, where m makes R' M y zero."""
        factor, momentum = spla.splu(sp.csc_matrix(self.K - square * self.M)), self.M @ self.rigid
        pushed = factor.solve(momentum)
        to_momentum, to_push = np.linalg.inv(self.rigid.T @ momentum), np.linalg.inv(momentum.T @ pushed)

        def solve(x: np.ndarray) -> np.ndarray:
            # what is of the form M R m may be left out of x, and would only cost digits
            y = factor.solve(x - momentum @ (to_momentum @ (self.rigid.T @ x)))
            return y - pushed @ (to_push @ (momentum.T @ y))

        return spla.LinearOperator(self.K.shape, matvec=solve, matmat=solve, dtype=float)

    def lowest(self, count: int, shift: float) -> tuple[np.ndarray, np.ndarray]:
        """Squared frequencies, 1/s^2, and modes as columns: the lowest, by shift and invert at a `shift` below them."""
        inverse = self.inverse(shift)
        start = inverse @ np.ones(self.K.shape[0])
        squares, x = spla.eigsh(self.K, k=count, M=self.M, sigma=shift, OPinv=inverse, which="LM", v0=start)
        order = np.argsort(squares)
        return squares[order], x[:, order]

    def without_resistance(self, count: int, shift: float) -> tuple[np.ndarray, np.ndarray]:
        """The same for so many motions without resistance that ARPACK, which begins with one, finds them slowly."""
        inverse = self.inverse(shift)
        x: np.ndarray = np.random.default_rng(0).normal(size=(self.K.shape[0], count))
        for _ in range(ROUNDS):
            x = np.linalg.qr(inverse @ (self.M @ x))[0]
        root = np.linalg.cholesky(x.T @ (self.M @ x))
        x = np.linalg.solve(root, x.T).T
        squares, turned = np.linalg.eigh(x.T @ (self.K @ x))
        return squares, x @ turned

    def next_above(self, square: float) -> float:
        """The smallest squared frequency above this positive one, 1/s^2."""
        low, high, count = square, self.stiffest(), self.below(square)
        while high > LARGEST_RATIO * low:
            middle = np.sqrt(low * high)
            low, high = (middle, high) if self.below(middle) == count else (low, middle)
        return self._beside(low, "LA")

    def last_below(self, count: int) -> float:
        """The largest of the `count` smallest squared frequencies, where those beyond are far larger, 1/s^2."""
        low, high = WITHIN * self.stiffest(), 2 * self.stiffest()
        while (found := self.below(middle := np.sqrt(low * high))) != count and high > (1 + WITHIN) * low:
            low, high = (middle, high) if found < count else (low, middle)
        return self._beside(middle, "SA")

    def largest(self) -> float:
        """The largest squared frequency, 1/s^2."""
        start = np.random.default_rng(0).normal(size=self.K.shape[0])
        return float(spla.eigsh(self.K, 1, self.M, which="LA", return_eigenvectors=False, tol=WITHIN**0.5, v0=start)[0])

    def _beside(self, square: float, side: str) -> float:
        inverse = self.inverse(square)
        start = inverse @ np.random.default_rng(0).normal(size=self.K.shape[0])
        found = spla.eigsh(
            self.K, 1, self.M, square, OPinv=inverse, which=side, v0=start, return_eigenvectors=False, tol=WITHIN**0.5
        )
        return float(found[0])


def unpivoted(A: sp.csc_array) -> spla.SuperLU:
    """A factorisation L D L' of a symmetric matrix: the signs of D are those of its eigenvalues."""
    return spla.splu(
        sp.csc_matrix(A), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )

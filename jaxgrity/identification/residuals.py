"""Tests of a fit's residuals: independent, and as large as stated? If not, wider errors of the parameters.

Intervals of least squares assume independent noise. With noise that lasts from row to row, or with model error, the
rows tell as much as fewer independent ones. Where tests find that, an autoregressive process is fitted to the residuals
(Burg's method), and the covariance is that of the estimate under it (the "sandwich" of econometrics).
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import matmul_toeplitz
from scipy.stats import chi2, norm, t

from jaxgrity.core.display import in_digits
from jaxgrity.core.types import AnyArray

FEWEST_ROWS = 10
"""Fewest rows for which residuals are tested."""
LAGS, LONGEST = 10, 20
"""Largest lag, in rows, at which residuals are compared, and largest order of the process fitted to them."""
UNLIKELY = 1e-3
"""Probability below which a test fails. For white noise, one of three tests fails in three of a thousand fits."""
FEWEST_INDEPENDENT = 12
"""Fewest independent residuals, in effect, for which an interval is given."""


class ResidualTests(NamedTuple):
    """Tests for independent noise of the stated size; NaN with too few rows."""

    autocorrelation: float
    """of residuals of neighbouring rows"""
    independence: float
    """probability that independent ones are correlated as much (Ljung and Box)"""
    runs: float
    """probability that the signs of independent ones change so rarely, or so often (Wald and Wolfowitz)"""
    size: float
    """the misfit: 1 for noise of the stated size"""
    size_probability: float
    """probability of residuals at least as large, for noise of the stated size"""
    independent: float
    """number of equivalent independent residuals; all, where they are small enough for the stated noise to cover their
    correlation"""
    share: float = 1.0
    """of all residuals, that those are"""

    @property
    def correlated(self) -> bool:
        """Whether a test of independence failed, for residuals that are not small beside the noise."""
        return bool(min(self.independence, self.runs) < UNLIKELY and self.share < 1)

    @property
    def too_large(self) -> bool:
        """Whether residuals are larger than the stated noise."""
        return bool(self.size_probability < UNLIKELY)

    @property
    def as_said(self) -> bool:
        """Whether residuals are like independent noise of the stated size."""
        return not (self.correlated or self.too_large)

    @property
    def enough(self) -> bool:
        """Whether residuals suffice for errors of the parameters."""
        return not self.correlated or self.independent >= FEWEST_INDEPENDENT

    def summary(self) -> str:
        """In words."""
        if np.isnan(self.autocorrelation):
            return f"residuals: too few rows to test ({FEWEST_ROWS} are needed)"
        found = []
        if self.correlated:
            worth = f"worth {self.independent:.0f} independent ones"
            found.append(f"correlated from row to row ({self.autocorrelation:.2f}), {worth}")
        if self.too_large:
            found.append(f"{in_digits(self.size, 2)} times the noise that was said")
        if not found:
            return "residuals: like independent noise of the size that was said"
        end = "" if self.enough else "; too few for intervals"
        return f"residuals: {' and '.join(found)}{end}. Noise of another kind, or the model lacks something"


class Series(NamedTuple):
    """The residuals of one measurement, row by row, in standard deviations of the noise."""

    r: np.ndarray
    """(rows, columns)"""
    seen: np.ndarray
    """likewise, whether there was a measurement"""


def judged_residuals(every: list[Series], misfit: float, freedom: float) -> ResidualTests:
    """The tests, over all columns of all measurements; `freedom` is the number of degrees of freedom."""
    every = [each for each in every if len(each.r) >= FEWEST_ROWS]
    if not every:
        large = float(chi2.sf(freedom * misfit**2, freedom))
        return ResidualTests(np.nan, np.nan, np.nan, misfit, large, np.nan)
    correlations, pairs = _correlations(every)
    independence = float(chi2.sf(np.sum(pairs * correlations**2), len(pairs)))
    means, squares = np.sum([_independent(each) for each in every], axis=0)
    count = sum(each.seen.sum() for each in every)
    freedom = freedom * squares / count
    large = float(chi2.sf(freedom * misfit**2, freedom))
    worth = float(min(means / max(min(1.0, misfit**2), np.finfo(float).eps), count))
    tests = float(correlations[0]), independence, _runs(every)
    return ResidualTests(*tests, misfit, large, worth, worth / float(count))


def scores_covariance(series: Series, J: np.ndarray) -> np.ndarray:
    """J'ΩJ, with Ω the covariance of the residuals by the process fitted to them; J is (rows, columns, unknowns)."""
    autocovariance, across = _process(series)
    columns = [np.where(series.seen[:, c, None], J[:, c], 0) for c in range(J.shape[1])]
    spread = [matmul_toeplitz(autocovariance, column) for column in columns]
    return np.asarray(
        sum(
            across[a, b] * columns[a].T @ spread[b]
            for a in range(len(columns))
            for b in range(len(columns))
            if across[a, b]
        )
    )


def _correlations(every: list[Series]) -> tuple[np.ndarray, np.ndarray]:
    """Pooled autocorrelations at lags from 1 on, and the number of pairs of each."""
    found, pairs = [], []
    size = sum(np.sum(each.r**2) for each in every) / sum(each.seen.sum() for each in every)
    for lag in range(1, LAGS + 1):
        known = [each for each in every if len(each.r) > 2 * lag]
        if known:
            count = sum((each.seen[lag:] & each.seen[:-lag]).sum() for each in known)
            product = sum(np.sum(each.r[lag:] * each.r[:-lag]) for each in known)
            found.append(product / max(count, 1) / max(size, np.finfo(float).tiny))
            pairs.append(count)
    return np.array(found), np.array(pairs)


def _runs(every: list[Series]) -> float:
    """The probability of so few, or so many, runs of one sign in all columns, above and below zero."""
    runs = expected = variance = 0.0
    for each in every:
        for column, seen in zip(each.r.T, each.seen.T):
            signs = column[seen] > 0
            n, above = len(signs), int(signs.sum())
            if n < 2 or not 0 < above < n:
                continue
            both = 2.0 * above * (n - above)
            runs += 1 + np.count_nonzero(np.diff(signs))
            expected += both / n + 1
            variance += both * (both - n) / (n**2 * (n - 1))
    return float(2 * norm.sf(abs(runs - expected) / np.sqrt(variance))) if variance > 0 else np.nan


def _process(series: Series) -> tuple[np.ndarray, np.ndarray]:
    """Autocorrelations of the process at all lags, and the covariance of the columns."""
    r, seen = series.r, series.seen
    rows, columns = r.shape
    coefficients = _burg(r, seen)
    counts = np.maximum(seen.T.astype(float) @ seen, 1)
    across = r.T @ r / counts
    # columns count as independent of each other unless they are not by far
    size = np.sqrt(np.maximum(np.diag(across), np.finfo(float).tiny))
    autocorrelation = _autocorrelations(coefficients, rows)
    independent = rows / (1 + 2 * np.sum(autocorrelation[1:] ** 2 * (1 - np.arange(1, rows) / rows)))
    together = np.abs(across) / np.outer(size, size) > norm.isf(UNLIKELY / max(columns**2, 1)) / np.sqrt(independent)
    return autocorrelation, np.where(together | np.eye(columns, dtype=bool), across, 0)


def _independent(series: Series) -> np.ndarray:
    """The number of independent values with an equally exact mean, and the same for the mean of squares."""
    autocorrelation, across = _process(series)
    # columns that go together count as fewer
    columns = np.trace(across) ** 2 / max(np.sum(across**2), np.finfo(float).tiny)
    share = 1 - np.arange(1, len(series.r)) / len(series.r)
    lasting = np.array([1 + 2 * np.sum(autocorrelation[1:] ** power * share) for power in (1, 2)])
    return np.asarray(series.seen.sum() / series.r.shape[1] * columns / np.maximum(lasting, 1.0))


def _burg(r: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """a of r_t = a_1 r_t-1 + a_2 r_t-2 + ... + noise, alike in all columns; the order by Akaike's criterion.

    Errors of prediction count where all their rows were seen; orders count while a third of the errors do.
    """
    counts = np.maximum(seen.sum(0), 1)
    size = np.sqrt(np.maximum(np.sum(r**2, axis=0) / counts, np.finfo(float).tiny))
    ahead = behind = np.where(seen, r / size, 0)
    rows, a, whole, number = len(r), np.zeros(0), seen, int(seen.sum())
    power = float(np.sum(ahead**2) / max(number, 1))
    best, chosen = number * np.log(max(power, 1e-300)), a
    for order in range(1, min(LONGEST, rows // 5) + 1):
        whole = whole[1:] & seen[:-order]
        if 3 * whole.sum() < number:
            break
        f, b = ahead[1:] * whole, behind[:-1] * whole
        reflection = 2 * np.sum(f * b) / max(np.sum(f**2 + b**2), np.finfo(float).tiny)
        a = np.append(a - reflection * a[::-1], reflection)
        ahead, behind = f - reflection * b, b - reflection * f
        power *= max(1 - reflection**2, np.finfo(float).eps)
        criterion = number * np.log(max(power, 1e-300)) + 2 * order
        if criterion < best:
            best, chosen = criterion, a
    return chosen


def _autocorrelations(a: np.ndarray, rows: int) -> np.ndarray:
    """(rows,), of the process with these coefficients, 1 at lag 0."""
    order = len(a)
    if not order:
        return np.eye(1, rows)[0]
    # Yule and Walker's equations for the first lags, the recursion for the others
    matrix, right = np.eye(order), a.copy()
    for k in range(1, order + 1):
        for j in range(1, order + 1):
            if k != j:
                matrix[k - 1, abs(k - j) - 1] -= a[j - 1]
    found = np.empty(max(rows, order + 1))
    found[0] = 1
    found[1 : order + 1] = np.linalg.solve(matrix, right)
    for k in range(order + 1, rows):
        found[k] = a @ found[k - order : k][::-1]
    return found[:rows]


def widened(covariance: AnyArray, least: AnyArray, tests: ResidualTests) -> np.ndarray:
    """A covariance with no variance below those of `least`, for the number of independent residuals.

    It is `least` where residuals are too few for a covariance.
    """
    variances = np.diag(covariance)
    if not (np.isfinite(covariance).all() and np.all(variances > 0)):
        return np.asarray(least)
    # the variance of a mean is known from an autoregressive process as from half as many independent residuals
    few = t.ppf(0.975, max(tests.independent / 2, 1.0)) / norm.ppf(0.975)
    larger = np.maximum(few, np.sqrt(np.diag(least) / variances))
    return np.asarray(covariance * larger[:, None] * larger)

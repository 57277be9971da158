"""Parameters of a scene from measurements, with their uncertainty: regularised least squares, linearised at its end.

The sum of squares is minimised by Levenberg and Marquardt's method. With J the residuals' Jacobian at the minimum, the
covariance is that of a linear model with Gaussian noise, (J'J + 1)^-1 (Nocedal and Wright 2006, chapter 10). A misfit
above 1 is a factor of the noise. A parameter is identified where the data bring its spread below half of the plausible
one.

Residuals are tested (`ResidualTests`). With correlated rows, intervals are those of the estimate under such noise;
there are none where the residuals say too little of it. Motions on the ground are fitted on the other contact model too
(`TwinFit`). Where residuals differ from the stated noise, and the twin fits no worse, the disagreement of both counts
as a further error.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxgrity.core.arguments import check_count, check_index, check_number
from jaxgrity.core.display import COVERING, in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray
from jaxgrity.identification.least_squares import Found, Problem, fitting_problem, least_squares, residuals
from jaxgrity.identification.measurements import Measurement, check_units, predicted
from jaxgrity.identification.parameters import Known, Parameter, Unknowns, changed, check_parameters
from jaxgrity.identification.residuals import ResidualTests, Series, judged_residuals, scores_covariance, widened
from jaxgrity.identification.twin_fit import TwinFit, compared, disagreement, twin_problem
from jaxgrity.model.scene import as_dtype

TOLD = 0.5
"""Data determine a parameter whose standard deviation they bring below this share of its plausible spread."""


class Estimate(NamedTuple):
    """The estimate of one parameter."""

    name: str
    value: float | None
    """the factor or the offset; None: not identified"""
    standard_error: float
    """of the value; if not identified, the remaining plausible spread"""
    interval: tuple[float, float] | None
    """95 % interval of the value; None: not identified, or residuals too correlated for an error"""


class Identified(NamedTuple):
    """The most probable scene, and its uncertainty."""

    scene: Any
    estimates: tuple[Estimate, ...]
    parameters: tuple[Parameter, ...]
    z: Unknowns
    """of the parameters: multiples of their plausible spreads"""
    covariance: Float[AnyArray, "parameters parameters"]
    """of z: the remaining plausible spreads, with unknown starts"""
    starts: tuple[AnyArray, ...]
    """the further unknowns of each measurement, such as the starts of windows"""
    misfit: float
    """root mean square of the residuals in standard deviations of the noise: 1 where model and noise are right"""
    converged: bool
    steps: int
    residuals: ResidualTests | None = None
    """whether they look like independent noise of the stated size"""
    twin: TwinFit | None = None
    """the fit on the other contact model, where there is one"""

    @property
    def untold(self) -> tuple[tuple[float, np.ndarray], ...]:
        """Combinations of the z that the data leave open: their remaining spread, and unit vectors."""
        left, vectors = np.linalg.eigh(self.covariance)
        return tuple((float(np.sqrt(x)), v) for x, v in zip(left, vectors.T) if np.sqrt(max(x, 0.0)) > TOLD)

    def summary(self) -> str:
        """A line for each parameter."""
        lines = []
        for each in self.estimates:
            error = f"± {in_digits(COVERING * each.standard_error, 2)}"
            value = None if each.value is None else in_digits(each.value, 4)
            told = f"the data cannot tell ({error} is left)" if value is None else f"{value} {error}"
            known = each.value is None or each.interval is not None
            lines.append(f"{each.name}: {told if known else f'{value} (error not known)'}")
        end = "" if self.converged else "; the fit did not converge, and its intervals are not to be trusted"
        lines.append(f"misfit: {in_digits(self.misfit)} standard deviations of the noise{end}")
        lines += [] if self.residuals is None else [self.residuals.summary()]
        return "\n".join([*lines, *([] if self.twin is None else [self.twin.summary()])])


@typed
def identify(
    scene: Known,
    parameters: Sequence[Parameter],
    measured: Measurement | Sequence[Measurement],
    *,
    tolerance: float = 1e-5,
    max_steps: int = 100,
    twin: bool = True,
) -> Identified:
    """The parameters whose predictions fit the measurements best, with their uncertainty.

    It minimises sum ((predicted - value)/noise)^2 + sum z^2, with z the parameters in units of their plausible spreads.
    See the module for the covariance, the tests of residuals, and the other contact model.

    Args:
        scene: the robot as known: a `Scene`, or a module from which `measured_poses` makes scenes.
        parameters: the unknown ones, with their plausible spreads.
        measured: from `measured_poses` or `measured_motion`; several count as one.
        tolerance: of the sum of squares: the end is where a full step would lower it by less, or hardly change it.
        max_steps: the largest number of Jacobians; beyond it the result is not `converged`.
        twin: whether to fit motions on the ground also on the other contact model; it takes as long again.

    Returns:
        The best fit, estimates with standard errors and 95 % intervals, and the combinations that the data leave open.

    Raises:
        InputError: unknown parameters, fewer measured numbers than parameters, values in another unit, a negative
            tolerance, or no steps.

    Example:
        >>> from jaxgrity.identification import Parameter, SeenPositions, identify, measured_poses
        >>> def hung(scene, load):  # each pose has a weight of its own on the lower node
        ...     return eqx.tree_at(lambda s: s.structure.node_mass, scene, load)
        >>> cable = jaxgrity.Members(((0, 1),), [100.0], [1.0])
        >>> hanging = jaxgrity.Structure([[0, 0, 0], [0, 0, -1.1]], [0.0, 1.0], cables=cable, fixed=((0, "xyz"),))
        >>> scene = jaxgrity.Scene(hanging, gravity=9.81)
        >>> loads, at_end = np.array([[0.0, 1.0], [0.0, 2.0]]), SeenPositions((1,), "z")
        >>> z = -1 - loads[:, 1:] * 9.81 / 110.0  # measured: the cable is 10 % stiffer than the scene says
        >>> shapes = np.array([jaxgrity.statics.resting_shape(hung(scene, load)).q for load in loads])
        >>> poses = measured_poses(scene, z, 1e-4, at_end, commands=loads, command=hung, shapes=shapes)
        >>> found = identify(scene, [Parameter("structure.cables.stiffness", spread=0.3)], poses)
        >>> print(f"{found.estimates[0].value:.3f}")
        1.100
    """
    every = (measured,) if isinstance(measured, Measurement) else tuple(measured)
    _check_given(scene, parameters, tolerance, max_steps)
    count = sum(int(np.isfinite(each.values).sum()) for each in every)
    if count < len(parameters):
        raise InputError(f"{count} numbers measured for {len(parameters)} parameters; expected at least as many")
    problem = fitting_problem(as_dtype(scene, "float64"), parameters, every)
    first = np.zeros(sum(problem.sizes))
    r = np.asarray(residuals(first, problem))
    if not np.isfinite(r).all():
        raise InputError("scene: what it predicts is not finite; expected one whose motions and shapes can be computed")
    _check_all_units(problem, r)
    found = _judged(problem, least_squares(problem, first, tolerance, max_steps))
    other = twin_problem(scene, parameters, every) if twin else None
    if other is None or isinstance(other, str):
        return found if other is None else found._replace(twin=TwinFit({}, {}, float("nan"), other))
    return _beside(found, identify(*other, tolerance=tolerance, max_steps=max_steps, twin=False))


@typed
def misfit_of(scene: Known, measured: Measurement, start: AnyArray | None = None) -> dict[str, np.ndarray]:
    """The misfit of a scene to measurements, whether it was fitted to them or not.

    Args:
        scene: such as `Identified.scene`.
        measured: from `measured_poses` or `measured_motion`.
        start: the further unknowns; by default their guess.

    Returns:
        "rms": (columns,), root mean squares of predicted less measured, SI units, NaN where nothing was measured;
        "misfit": that of all, in standard deviations of the noise. Both are infinite where the prediction fails.
    """
    guess = measured.starts()[0] if start is None else start
    found, seen = np.asarray(predicted(measured, scene, guess)), np.isfinite(measured.values)
    difference = np.where(np.isfinite(found), found, np.inf) - measured.values
    squares, count = np.sum(np.where(seen, difference, 0) ** 2, axis=0), seen.sum(0)
    return {
        "rms": np.sqrt(np.divide(squares, count, out=np.full(len(count), np.nan), where=count > 0)),
        "misfit": np.sqrt(np.mean((difference / measured.noise)[seen] ** 2)),
    }


@typed
def profile_likelihood(
    scene: Known,
    parameters: Sequence[Parameter],
    measured: Measurement | Sequence[Measurement],
    number: int,
    z: AnyArray,
) -> np.ndarray:
    """The least sum of squares with one parameter held and all others fitted.

    It rises by 1 from its minimum where that parameter is a standard deviation off. The intervals of `identify` assume
    a parabola: where it rises otherwise, they are wrong.

    Args:
        scene, parameters, measured: as for `identify`.
        number: of the held parameter, from 0; at least one other is left.
        z: (points,), its held values, in multiples of its plausible spread.

    Returns:
        (points,), the sum of squares, z^2 and those of the starts included.

    Raises:
        InputError: as `identify`.
    """
    every = (measured,) if isinstance(measured, Measurement) else tuple(measured)
    held = parameters[check_index("number", number, len(parameters))]
    others = [*parameters[:number], *parameters[number + 1 :]]
    sums = []
    for each in np.asarray(z, float):
        fitted = identify(changed(scene, [held], np.array([each])), others, every, twin=False)
        reached = fitting_problem(fitted.scene, (), every)
        starts = tuple((start, spread) for start, (_, spread) in zip(fitted.starts, reached.starts))
        r = np.asarray(residuals(np.zeros(sum(reached.sizes)), eqx.tree_at(lambda p: p.starts, reached, starts)))
        moved = ((start - guess) / spread for start, (guess, spread) in zip(fitted.starts, reached.starts))
        sums.append(float(r @ r + fitted.z @ fitted.z + each**2 + sum(np.sum(y**2) for y in moved)))
    return np.array(sums)


def _check_given(scene: Known, parameters: Sequence[Parameter], tolerance: float, max_steps: int) -> None:
    check_parameters(scene, parameters)
    check_number("tolerance", tolerance, least=0.0)
    check_count("max_steps", max_steps, 1)


def _beside(found: Identified, there: Identified) -> Identified:
    """The result with the fit on the other contact model, and errors widened by the disagreement."""
    compares, further = compared(found, there), disagreement(found, there)
    if not further.any():
        return found._replace(twin=compares)
    covariance = found.covariance + further
    known = found.residuals is not None and found.residuals.enough
    deviations = np.sqrt(np.diag(covariance))
    estimates = tuple(_estimate(*each, known) for each in zip(found.parameters, found.z, deviations))
    return found._replace(twin=compares, covariance=covariance, estimates=estimates)


def _judged(problem: Problem, found: Found) -> Identified:
    """The result with its covariance."""
    (y, r, J), size = found.at, len(problem.parameters)
    told, plausible = J.T @ J, np.eye(len(y))
    freedom = _freedom(r, told, sum(int(np.isnan(each.values).sum()) for each in problem.every))
    misfit = float(np.sqrt(r @ r / freedom))
    covariance = np.linalg.inv(told / max(1.0, misfit) ** 2 + plausible)[:size, :size]
    parts = _series(problem, r, J)
    tests = judged_residuals([series for series, _, _ in parts], misfit, freedom)
    if tests.correlated:
        scores = sum(scores_covariance(series, slopes) + further.T @ further for series, slopes, further in parts)
        inverse = np.linalg.inv(told + plausible)
        covariance = widened((inverse @ (scores + plausible) @ inverse)[:size, :size], covariance, tests)
    z, *starts = (np.asarray(part) for part in problem.split(y))
    deviations = np.sqrt(np.diag(covariance))
    return Identified(
        changed(problem.scene, problem.parameters, z),
        tuple(_estimate(*each, tests.enough) for each in zip(problem.parameters, z, deviations)),
        problem.parameters,
        z,
        covariance,
        tuple(starts),
        misfit,
        found.converged,
        found.steps,
        tests,
    )


def _series(problem: Problem, r: np.ndarray, J: np.ndarray) -> list[tuple[Series, np.ndarray, np.ndarray]]:
    """For each measurement its residuals, their slopes, (rows, columns, unknowns), and those of its further
    residuals."""
    found = []
    for each, (own, further) in zip(problem.every, problem.sizes_of_data):
        shape = each.values.shape
        series = Series(r[:own].reshape(shape), np.isfinite(each.values))
        found.append((series, J[:own].reshape(*shape, -1), J[own : own + further]))
        r, J = r[own + further :], J[own + further :]
    return found


def _check_all_units(problem: Problem, r: np.ndarray) -> None:
    """From the residuals at the given scene, by a program that is needed anyway."""
    for each, sizes in zip(problem.every, problem.sizes_of_data):
        own, r = r[: sizes[0]].reshape(each.values.shape), r[sum(sizes) :]
        check_units(each, np.asarray(each.values + own * each.noise))


def _freedom(r: np.ndarray, told: np.ndarray, missing: int) -> float:
    """Degrees of freedom of the residuals of the data, with J'J = `told`."""
    # a regularised fit follows the data in so many directions
    followed = float(np.trace(np.linalg.solve(told + np.eye(len(told)), told)))
    return max(len(r) - missing - followed, 1.0)


def _estimate(parameter: Parameter, z: float, error: float, known: bool) -> Estimate:
    value, half = float(parameter.value(z)), 1.96 * float(error)
    size = parameter.spread * float(error) * (value if parameter.kind == "factor" else 1.0)
    ends = (float(parameter.value(z - half)), float(parameter.value(z + half)))
    told = error < TOLD
    return Estimate(parameter.name, value if told else None, size, ends if told and known else None)

"""Parameters of a scene from measurements, with how sure they are: regularised least squares, linearised at its end.

The sum of squares is minimised by Levenberg and Marquardt's method. With J the residuals' Jacobian at the minimum, the
covariance is that of a linear model with Gaussian noise, (J'J + 1)^-1 (Nocedal and Wright 2006, chapter 10); where the
misfit is above 1, the noise counts as so many times as large. A parameter whose spread the data do not bring below half
of what was plausible is not told.

Residuals are tested (`ResidualTests`). Where they are correlated from row to row, intervals are those of the estimate
under such noise, and there are none where the residuals say too little of it. Motions on the ground are fitted on the
other contact model too (`TwinFit`). Where residuals are not like the noise that was said, and the twin fits no worse,
what both disagree in counts as a further error.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.arguments import check_index
from jaxgrity.core.display import COVERING
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray
from jaxgrity.identification.least_squares import Found, Problem, fitting_problem, least_squares, residuals
from jaxgrity.identification.measurements import Measurement, check_units, predicted
from jaxgrity.identification.parameters import Known, Parameter, Unknowns, changed, check_parameters
from jaxgrity.identification.residuals import ResidualTests, Series, judged_residuals, scores_covariance, widened
from jaxgrity.identification.twin_fit import TwinFit, compared, disagreement, twin_problem

TOLD = 0.5
"""Data determine a parameter whose standard deviation they bring below this share of its plausible spread."""


class Estimate(NamedTuple):
    """What the data say of one parameter."""

    name: str
    value: float | None
    """the factor or the offset; None: the data cannot tell it"""
    standard_error: float
    """of the value; where the data cannot tell it, what is left of the plausible spread"""
    interval: tuple[float, float] | None
    """in which the value is with a probability of 95 %; None: the data cannot tell it, or residuals are so alike from
    row to row that they do not say how far it may be off"""


class Identified(NamedTuple):
    """The most probable scene, and how sure it is."""

    scene: Any
    estimates: tuple[Estimate, ...]
    parameters: tuple[Parameter, ...]
    z: Unknowns
    """of the parameters: multiples of their plausible spreads"""
    covariance: Float[AnyArray, "parameters parameters"]
    """of z: what is left of the plausible spreads, starts unknown as they are"""
    starts: tuple[AnyArray, ...]
    """the further unknowns of each measurement, such as states at which windows start"""
    misfit: float
    """root mean square of the residuals in standard deviations of the noise: 1 where model and noise are right"""
    converged: bool
    steps: int
    residuals: ResidualTests | None = None
    """whether they look like independent noise of the size that was said"""
    twin: TwinFit | None = None
    """the fit on the other contact model, where there is one"""

    @property
    def untold(self) -> tuple[tuple[float, np.ndarray], ...]:
        """Combinations of the z that the data cannot tell: what is left of their spread, and unit vectors."""
        left, vectors = np.linalg.eigh(self.covariance)
        return tuple((float(np.sqrt(x)), v) for x, v in zip(left, vectors.T) if np.sqrt(max(x, 0.0)) > TOLD)

    def summary(self) -> str:
        """A line for each parameter."""
        lines = []
        for each in self.estimates:
            error = f"± {COVERING * each.standard_error:.2g}"
            told = f"the data cannot tell ({error} is left)" if each.value is None else f"{each.value:.4g} {error}"
            known = each.value is None or each.interval is not None
            lines.append(f"{each.name}: {told if known else f'{each.value:.4g} (error not known)'}")
        end = "" if self.converged else "; the fit did not converge, and its intervals are not to be trusted"
        lines.append(f"misfit: {self.misfit:.3g} standard deviations of the noise{end}")
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
    """The parameters that make what a scene predicts fit what was measured, with their uncertainty.

    It minimises sum ((predicted - value)/noise)^2 + sum z^2, z the parameters in units of their plausible spreads. The
    module says what covariance they have, how residuals are tested, and what the other contact model is for.

    Args:
        scene: the robot as far as it is known: a `Scene`, or a module of which `measured_poses` makes scenes.
        parameters: what is not known, and how well.
        measured: made by `measured_poses` or `measured_motion`; several together count as one.
        tolerance: of the sum of squares: it ends where a full step would lower it by less, or hardly changes it.
        max_steps: Jacobians, after which it gives up, and is not `converged`.
        twin: whether to fit motions on the other contact model too, where there is ground; it takes as long again.

    Returns:
        The scene that fits best, estimates with standard errors and 95 % intervals, and what the data cannot tell.

    Raises:
        InputError: parameters that the scene does not have, fewer numbers measured than parameters, or values in
            another unit.

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
    check_parameters(scene, parameters)
    count = sum(int(np.isfinite(each.values).sum()) for each in every)
    if count < len(parameters):
        raise InputError(f"{count} numbers measured for {len(parameters)} parameters; expected at least as many")
    problem = fitting_problem(jax.tree.map(lambda x: jnp.asarray(x, "float64"), scene), parameters, every)
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
    """How far a scene is from measurements that it was not fitted to, or was.

    Args:
        scene: such as `Identified.scene`.
        measured: made by `measured_poses` or `measured_motion`.
        start: the further unknowns; their guess where not given.

    Returns:
        "rms": (columns,), root mean squares of predicted less measured, in SI units; "misfit": of all of them in
        standard deviations of the noise.
    """
    guess = measured.starts()[0] if start is None else start
    difference = np.asarray(predicted(measured, scene, guess)) - measured.values
    return {
        "rms": np.sqrt(np.nanmean(difference**2, axis=0)),
        "misfit": np.sqrt(np.nanmean((difference / measured.noise) ** 2)),
    }


@typed
def profile_likelihood(
    scene: Known,
    parameters: Sequence[Parameter],
    measured: Measurement | Sequence[Measurement],
    number: int,
    z: AnyArray,
) -> np.ndarray:
    """What the other parameters cannot make up for: the least sum of squares with one parameter held.

    It rises by 1 from its minimum where that parameter is a standard deviation off; where it rises otherwise to both
    sides, the intervals of `identify`, which take a parabola for granted, are wrong.

    Args:
        scene, parameters, measured: as for `identify`.
        number: of the parameter that is held, from 0; at least one other is left.
        z: (points,), where it is held, in multiples of its plausible spread.

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


def _beside(found: Identified, there: Identified) -> Identified:
    """The result with what the fit on the other contact model says, and what its disagreement adds to the errors."""
    compares, further = compared(found, there), disagreement(found, there)
    if not further.any():
        return found._replace(twin=compares)
    covariance = found.covariance + further
    known = found.residuals is not None and found.residuals.enough
    deviations = np.sqrt(np.diag(covariance))
    estimates = tuple(_estimate(*each, known) for each in zip(found.parameters, found.z, deviations))
    return found._replace(twin=compares, covariance=covariance, estimates=estimates)


def _judged(problem: Problem, found: Found) -> Identified:
    """What was found, with its covariance."""
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
    """Of each measurement its residuals, their slopes, (rows, columns, unknowns), and those of what goes with it."""
    found = []
    for each, (own, further) in zip(problem.every, problem.sizes_of_data):
        shape = each.values.shape
        series = Series(r[:own].reshape(shape), np.isfinite(each.values))
        found.append((series, J[:own].reshape(*shape, -1), J[own : own + further]))
        r, J = r[own + further :], J[own + further :]
    return found


def _check_all_units(problem: Problem, r: np.ndarray) -> None:
    """From the residuals at the scene as it is given, which are computed by a program that is needed anyway."""
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

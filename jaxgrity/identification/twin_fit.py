"""The same fit on the other contact model: agreement on a parameter is no artefact of one model."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.identification.measurements import Measurement
from jaxgrity.identification.motions import MeasuredMotion, above_exact_ground, with_options
from jaxgrity.identification.parameters import Parameter, own_numbers
from jaxgrity.model.contact_twin import contact_twin
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.options import resolve


class TwinFit(NamedTuple):
    """The fit of the same measurements on the other contact model."""

    values: dict[str, float]
    """by the names of the parameters that the twin has too: factors or offsets; empty where there is no fit"""
    apart: dict[str, float]
    """likewise, disagreement of both fits in standard errors of their difference"""
    misfit: float
    """in standard deviations of the noise; NaN where there is no fit"""
    reason: str = ""
    """why there is no fit"""

    def summary(self) -> str:
        """In words."""
        if self.reason:
            return f"the other contact model: not fitted, since {self.reason}"
        told = ", ".join(
            f"{name} {in_digits(value, 4)}, {self.apart[name]:.1f} standard errors apart"
            for name, value in self.values.items()
        )
        return f"the other contact model: {told}; misfit {in_digits(self.misfit)}"


def twin_problem(
    scene: Any, parameters: Sequence[Parameter], every: tuple[Measurement, ...]
) -> tuple[Scene, list[Parameter], list[MeasuredMotion]] | str | None:
    """The scene, the parameters and the measurements on the other contact model.

    None without another model: no ground, or other measurements than motions. A text where the other one cannot be
    fitted.
    """
    if not isinstance(scene, Scene) or scene.ground is None:
        return None
    motions = [each for each in every if isinstance(each, MeasuredMotion)]
    if len(motions) < len(every):
        return None
    try:
        twin = contact_twin(scene)
        shared = [p for p in parameters if eqx.is_inexact_array_like(own_numbers(twin, p))]
        if not shared:
            return "it has none of the parameters"
        return twin, shared, [_on(twin, each) for each in motions]
    except InputError as error:
        return str(error)


def compared(fit: Any, twin: Any) -> TwinFit:
    """The disagreement of two results of `identify`."""
    own = [fit.parameters.index(p) for p in twin.parameters]
    z, variance = fit.z[own], np.diag(fit.covariance)[own]
    apart = np.abs(z - twin.z) / np.sqrt(variance + np.diag(twin.covariance))
    values = {p.name: float(p.value(each)) for p, each in zip(twin.parameters, twin.z)}
    return TwinFit(values, dict(zip(values, apart.tolist())), twin.misfit)


def disagreement(fit: Any, twin: Any) -> np.ndarray:
    """The contribution of the contact model to the covariance of z, where data do not favour the fit's own.

    Zero where residuals are like noise, or the twin fits worse.
    """
    added = np.zeros_like(fit.covariance)
    if fit.residuals.as_said or twin.misfit > fit.misfit:
        return added
    for p, other in zip(twin.parameters, twin.z):
        k = fit.parameters.index(p)
        added[k, k] = (fit.z[k] - other) ** 2
    return added


def _on(twin: Scene, motion: MeasuredMotion) -> MeasuredMotion:
    """The measurement of a motion for the twin; its starts are lifted out of exact ground."""
    struts = twin.structure.struts
    if motion.unknown and struts is not None and struts.rigid:
        raise InputError("its struts are rigid, and starts that are not known would stretch them")
    state = np.array(motion.state, float)
    for each in state:
        each[0] = above_exact_ground(twin, each[0])
    seconds = float(motion.times[0][-1] - motion.times[0][0])
    options = resolve(twin, seconds, None, dtype="float64", positions=state[0, 0])
    return with_options(dataclasses.replace(motion, state=state), options)

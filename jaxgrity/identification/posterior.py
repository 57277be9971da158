"""Robots drawn from the uncertainty after measurements, for populations and searches."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.identification.fits import Identified
from jaxgrity.identification.parameters import changed
from jaxgrity.populations.uncertainty import DIFFERING, Differences, Uncertainty, part_of

ONE_FRICTION = 1e-9
"""Largest difference of friction between nodes of a robot that still count as having one friction."""


@typed
def posterior_robots(key: jax.Array, found: Identified, count: int) -> Differences:
    """Robots plausible after the measurements, as factors of `Identified.scene`.

    Their z are drawn from the normal distribution with mean `Identified.z` and `Identified.covariance`. So combinations
    that the data leave open vary over their plausible range; identified combinations vary only within their errors.

    Args:
        key: of the draws.
        found: from `identify` with a `Scene`.
        count: the number of robots.

    Returns:
        The `differences` for `simulate_population(found.scene, ...)`.

    Raises:
        InputError: a parameter in which robots of a population cannot differ, or not without another: they differ alike
            in both coefficients of the Coulomb switch.
    """
    return robots_at(found, deviates(key, found, count))


def deviates(key: jax.Array, found: Identified, count: int) -> np.ndarray:
    """(count, parameters), the differences of drawn z from `Identified.z`."""
    none = jnp.zeros(len(found.z))
    return np.asarray(jax.random.multivariate_normal(key, none, jnp.asarray(found.covariance), (count,)))


def robots_at(found: Identified, drawn: np.ndarray) -> Differences:
    """Robots whose z differ from `Identified.z` by rows of `drawn`. Raises `InputError` as `posterior_robots`."""
    count, factors = len(drawn), {}
    for name, paths in DIFFERING.items():
        own = [k for k, parameter in enumerate(found.parameters) if parameter.path in paths]
        if own:
            path = _one_path(found, own)
            factors[name] = np.stack([_ratio(found, path, own, z) for z in drawn])
    places = [path for paths in DIFFERING.values() for path in paths]
    bodies = getattr(getattr(found.scene, "structure", None), "bodies", ())
    for number, path in enumerate(f"structure.bodies.{k}.matrix" for k in range(len(bodies))):
        for k in [k for k, parameter in enumerate(found.parameters) if parameter.path == path]:
            each = factors.setdefault("body_mass", np.ones((count, len(bodies))))
            each[:, number] *= [np.asarray(found.parameters[k].value(z[k])) for z in drawn]
            places.append(path)
    missing = [p.name for p in found.parameters if p.path not in places]
    if missing:
        raise InputError(
            f"{missing[0]}: robots of a population cannot differ in it; expected {', '.join(DIFFERING)}, "
            "or structure.bodies.N.matrix"
        )
    if "friction" in factors:
        friction = factors["friction"].reshape(count, -1)
        if np.ptp(friction, axis=1).max() > ONE_FRICTION:
            raise InputError("friction: robots differ alike at all nodes; expected one parameter for all of them")
        factors["friction"] = friction[:, 0]
    return Differences(**factors)


def _one_path(found: Identified, own: list[int]) -> str:
    """The common path of parameters; refuses what no factor can express."""
    paths = sorted({found.parameters[k].path for k in own})
    if len(paths) > 1:
        raise InputError(f"{', '.join(paths)}: robots differ alike in them; expected one of them")
    _check_alone(found, paths[0])
    known = np.asarray(part_of(found.scene, paths[0]))
    if any(found.parameters[k].kind == "offset" for k in own) and np.any(known == 0):
        raise InputError(f"{paths[0]}: an offset of 0 is no factor; expected factors, or numbers other than 0")
    return paths[0]


def _check_alone(found: Identified, path: str) -> None:
    """Refuse a part whose factor in populations would change another part of the scene too."""
    (alike,) = (paths for paths in DIFFERING.values() if path in paths)
    others = [other for other in alike if other != path and part_of(found.scene, other) is not None]
    if others:
        raise InputError(f"{path}: robots differ alike in {', '.join(others)}; expected a scene with one of them")


def _ratio(found: Identified, path: str, numbers: list[int], dz: np.ndarray) -> np.ndarray:
    """The factor of a place of the identified scene for a change of some of its z."""
    known = np.asarray(part_of(found.scene, path))
    moved = np.asarray(part_of(changed(found.scene, [found.parameters[k] for k in numbers], dz[numbers]), path))
    # what has no mass has none in any robot
    return np.divide(moved, known, out=np.ones_like(moved), where=known != 0)


@typed
def uncertainty_of(found: Identified, **others: float) -> Uncertainty:
    """The remaining uncertainty as half-widths of an `Uncertainty`, for searches.

    A uniform number with the half-width of root 3 standard deviations has the same standard deviation. Correlations are
    lost: `posterior_robots` keeps them.

    Args:
        found: from `identify`; friction and cable stiffness as factors of all nodes and cables are used.
        others: further half-widths of the `Uncertainty`, such as `phase=0.03`.

    Raises:
        InputError: a parameter of another kind, two for the same half-width, one coefficient of the Coulomb switch, or
            a half-width of 1 or more.
    """
    names = {path: name for name in ("friction", "cable_stiffness") for path in DIFFERING[name]}
    widths = {}
    for parameter, deviation in zip(found.parameters, np.sqrt(np.diag(found.covariance))):
        if parameter.path not in names or parameter.kind != "factor" or parameter.parts is not None:
            raise InputError(f"{parameter.name}: an Uncertainty has no half-width for it; expected {', '.join(names)}")
        if names[parameter.path] in widths:
            raise InputError(f"{parameter.name}: another parameter has the same half-width; expected one of them")
        _check_alone(found, parameter.path)
        widths[names[parameter.path]] = float(np.sqrt(3) * parameter.spread * deviation)
    return Uncertainty(**{**widths, **others})

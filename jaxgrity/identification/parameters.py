"""Unknown numbers of a scene, by the names of their places, and the scene with changed ones."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.arguments import check_indices, check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray
from jaxgrity.model.bodies import Body, with_factors
from jaxgrity.populations.uncertainty import part_of

Known = TypeVar("Known", bound=eqx.Module)
"""A scene, or another module with numbers from which scenes are made."""
KINDS = ("factor", "offset")
"""How a parameter changes a scene: as a factor on its value, or as a number added to it."""
OF_BODIES = (".mass", ".inertia")
"""Ends of paths that are no fields: the numbers of a rigid body which its matrix has together."""
Unknowns = Float[AnyArray, " unknowns"]
"""Unknowns z of a fit: each is 0 for the scene as it is given, and plausible from -1 to 1."""


class Parameter(NamedTuple):
    """One unknown number. z times `spread` is the logarithm of a factor, or an offset."""

    path: str
    """its place, such as "structure.cables.stiffness" or "friction.mu": any array of numbers in the scene. Of the first
    rigid body, "structure.bodies.0.mass" is the mass, "structure.bodies.0.inertia" the inertia about the centre, and
    "structure.bodies.0.matrix" both in proportion; the centre stays. "structure.node_mass" adds to them at its nodes"""
    spread: float
    """plausible error of the scene before measurements: a standard deviation"""
    kind: str = "factor"
    """"factor", which keeps the sign, with a relative spread; or "offset", with the spread in the place's own unit"""
    parts: tuple[int, ...] | None = None
    """which rows of the array it changes, alike; None: all"""

    @property
    def name(self) -> str:
        """Such as "structure.cables.stiffness[0,1]"."""
        return self.path + ("" if self.parts is None else f"[{','.join(map(str, self.parts))}]")

    def value(self, z):
        """The factor or the offset at z."""
        return jnp.exp(self.spread * z) if self.kind == "factor" else self.spread * z


@typed
def changed(scene: Known, parameters: Sequence[Parameter], z: Unknowns) -> Known:
    """The scene with every parameter at its z; differentiable with respect to them."""
    for parameter, each in zip(parameters, z, strict=True):
        if (place := _of_body(scene, parameter)) is not None:
            body = with_factors(part_of(scene, place), **{parameter.path.split(".")[-1]: parameter.value(each)})
            scene = eqx.tree_at(partial(part_of, path=place), scene, body)
            continue
        leaf = jnp.asarray(part_of(scene, parameter.path))
        rows = np.zeros((len(leaf), *[1] * (leaf.ndim - 1)) if leaf.ndim else (), bool)
        rows[... if parameter.parts is None else np.array(parameter.parts)] = True
        value = parameter.value(each).astype(leaf.dtype)
        new = leaf * jnp.where(rows, value, 1) if parameter.kind == "factor" else leaf + jnp.where(rows, value, 0)
        scene = eqx.tree_at(partial(part_of, path=parameter.path), scene, new)
    return scene


def own_numbers(scene: Any, parameter: Parameter) -> Any:
    """The numbers that a parameter changes; None where the scene has none there."""
    place = _of_body(scene, parameter)
    return part_of(scene, parameter.path) if place is None else part_of(scene, place).matrix


def check_parameters(scene: Known, parameters: Sequence[Parameter]) -> None:
    """Raise `InputError` for no parameters, a name given twice, and a place that the scene does not have."""
    if not parameters:
        raise InputError("parameters: there are none; expected at least one")
    for k, parameter in enumerate(parameters):
        where, leaf = f"parameters[{k}] ({parameter.name})", own_numbers(scene, parameter)
        if parameter.kind not in KINDS:
            raise InputError(f"{where}: kind = {parameter.kind!r}; expected one of {', '.join(KINDS)}")
        if parameter.parts == ():
            raise InputError(f"{where}: parts = (): expected numbers, or None for all")
        check_number(f"{where}: spread", parameter.spread, above=0.0)
        if not eqx.is_inexact_array_like(leaf) or isinstance(leaf, float):
            raise InputError(f"{where}: the scene has no such numbers; expected a path such as structure.node_mass")
        _check_of_body(where, parameter)
        rows = np.shape(leaf)[0] if np.ndim(leaf) else 0
        check_indices(f"{where}: parts", parameter.parts or (), rows)
        if parameter.name in [other.name for other in parameters[:k]]:
            raise InputError(f"{where}: named twice; expected each parameter once")


def _check_of_body(where: str, parameter: Parameter) -> None:
    """Refuse what would make a rigid body impossible: its numbers belong together."""
    named = parameter.path.endswith((".matrix", *OF_BODIES))
    if parameter.path.startswith("structure.bodies.") and not (
        named and parameter.kind == "factor" and parameter.parts is None
    ):
        raise InputError(f"{where}: would make the body impossible; expected a factor of its mass, inertia or matrix")


def _of_body(scene: Any, parameter: Parameter) -> str | None:
    """The path of the rigid body whose mass, or inertia, a parameter is; None for any other."""
    place, _, part = parameter.path.rpartition(".")
    return place if f".{part}" in OF_BODIES and isinstance(part_of(scene, place), Body) else None

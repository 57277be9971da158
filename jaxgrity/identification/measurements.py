"""Measured poses and motions, and a scene's predictions of them."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray
from jaxgrity.identification.observations import SeenQuantity
from jaxgrity.model.scene import Scene
from jaxgrity.statics.equilibrium import equilibrium_near

Values = Float[AnyArray, "rows columns"]
SCALE = 30.0
"""Values this many times larger or smaller than predicted, on the whole, are taken to be in another unit."""


class Measurement(eqx.Module):
    """Measured numbers, a row for each pose or frame, and a scene's predictions of them."""

    values: eqx.AbstractVar[Values]
    """NaN where missing"""
    noise: eqx.AbstractVar[Values]
    """standard deviations"""

    @abstractmethod
    def starts(self) -> tuple[AnyArray, AnyArray]:
        """Further unknowns, (unknowns,), such as states at which motions start: a guess, and its standard deviation."""

    @abstractmethod
    def predict(self, scene: Any, start: AnyArray) -> tuple[Values, AnyArray]:
        """The numbers, and further residuals (any,), in standard deviations, near 0 for a good fit."""

    def linearised(self, scene_at: Callable[[AnyArray], Any], z: AnyArray, start: AnyArray) -> tuple[tuple, tuple]:
        """The results of `predict` for the scene at z, and their derivatives by z and `start`, all on one last axis."""

        def both(y):
            found = self.predict(scene_at(y[: len(z)]), y[len(z) :])
            return found, found

        slopes, found = jax.jacfwd(both, has_aux=True)(jnp.concatenate([z, start]))
        return found, slopes


class MeasuredPoses(Measurement):
    """Poses at rest, one after each command. Made by `measured_poses`."""

    values: Values
    noise: Values
    observation: SeenQuantity
    commands: Any
    """arrays with a row for each pose"""
    command: Callable = eqx.field(static=True)
    """(scene, a row of the commands) -> the scene as commanded"""
    shapes: Float[AnyArray, "rows nodes 3"]
    """m, near which each pose is looked for"""

    def starts(self):
        return np.zeros(0), np.zeros(0)

    def predict(self, scene, start):
        def one(command, shape, measured):
            commanded = self.command(scene, command)
            seen = self.observation.seen(commanded, equilibrium_near(commanded, shape), 0.0)
            return self.observation.near(commanded, seen, measured)

        return jax.vmap(one)(self.commands, self.shapes, jnp.asarray(self.values)), jnp.zeros(0)


@typed
def measured_poses(
    scene: eqx.Module,
    values: Values,
    noise: AnyArray | float,
    observation: SeenQuantity,
    *,
    shapes: AnyArray,
    commands: Any,
    command: Callable[[Any, Any], Scene],
) -> MeasuredPoses:
    """Poses of a robot at rest after commands.

    Args:
        scene: the argument of `identify`: a scene, or any module with arrays from which `command` makes scenes.
        values: (poses, columns of the observation), SI units; NaN where missing.
        noise: their standard deviation: one number, one for each column, or one for each value.
        observation: the columns.
        shapes: (poses, nodes, 3), m, a shape near each pose, as from `resting_shape`.
        commands: arrays with a row for each pose.
        command: the commanded scene, from `scene` and such a row.

    Returns:
        The measurement, for `identify`.

    Raises:
        InputError: shapes do not fit each other, all values are missing, or the noise is not positive.
    """
    rows = np.shape(values)[0]
    for leaf in jax.tree.leaves(commands):
        if np.shape(leaf)[:1] != (rows,):
            raise InputError(f"commands has an array of shape {np.shape(leaf)}; expected {rows} rows, one a pose")
    one = command(scene, jax.tree.map(lambda x: x[0], commands))
    values, noise = checked(one, values, noise, observation)
    expected = (rows, *np.shape(one.structure.nodes))
    if np.shape(shapes) != expected:
        raise InputError(f"shapes has shape {np.shape(shapes)}; expected {expected}, all nodes at each pose")
    return MeasuredPoses(values, noise, observation, commands, command, np.asarray(shapes, float))


def checked(scene: Scene, values, noise, observation: SeenQuantity) -> tuple[np.ndarray, np.ndarray]:
    """Values and noise as arrays of one shape. Raises `InputError` for invalid ones."""
    values, columns = np.asarray(values, float), observation.columns(scene)
    if values.ndim != 2 or values.shape[1] != columns:
        raise InputError(f"values has shape {values.shape}; expected (rows, {columns}), {columns} columns")
    if np.isnan(values).all():
        raise InputError(f"values: all {values.size} are missing (NaN); expected some numbers")
    if np.isinf(values).any():
        raise InputError(f"values[{np.argwhere(np.isinf(values))[0].tolist()}] is infinite; expected numbers, or NaN")
    try:
        noise = np.broadcast_to(np.asarray(noise, float), values.shape)
    except ValueError as error:
        raise InputError(f"noise has shape {np.shape(noise)}; expected one number, or {values.shape}") from error
    if not (np.isfinite(noise) & (noise > 0)).all():
        raise InputError("noise: a standard deviation is not positive and finite; expected one that is")
    return values, noise


@eqx.filter_jit
@typed
def predicted(measured: Measurement, scene: Any, start: AnyArray) -> Values:
    """A scene's predictions of measurements."""
    return measured.predict(scene, start)[0]


def check_units(measured: Measurement, expected: Values) -> None:
    """Raise `InputError` for values so much larger or smaller than predicted that their unit must be another."""
    there = np.isfinite(measured.values) & np.isfinite(expected)
    theirs, ours = (float(np.linalg.norm(np.asarray(x)[there])) for x in (measured.values, expected))
    if ours > 0 and theirs > 0 and not 1 / SCALE < theirs / ours < SCALE:
        raise InputError(
            f"values are {in_digits(theirs / ours, 2)} times as large as the scene predicts: "
            "expected SI units (m, rad, N)"
        )

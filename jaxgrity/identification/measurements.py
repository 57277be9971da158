"""Measurement poses and motions, and what a scene predicts of them."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, NodeHistory, Times
from jaxgrity.identification.observations import SeenQuantity
from jaxgrity.model.equilibrium import equilibrium_near
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.integrate import integrate
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve

Values = Float[AnyArray, "rows columns"]
FITTED_FRAMES = 8
"""from which the velocity at the start of a window is guessed"""
SCALE = 30.0
"""times larger or smaller than predicted, in all: values that are so far off are in another unit"""


class Measurement(eqx.Module):
    """Measurement numbers, a row a pose or a frame, and how a scene predicts them."""

    values: eqx.AbstractVar[Values]
    """NaN where missing"""
    noise: eqx.AbstractVar[Values]
    """standard deviations"""

    @abstractmethod
    def starts(self) -> tuple[AnyArray, AnyArray]:
        """Further unknowns, (unknowns,), such as states at which motions start: a guess, and its standard deviation."""

    @abstractmethod
    def predict(self, scene: Any, start: AnyArray) -> tuple[Values, AnyArray]:
        """The numbers, and further residuals (any,), in standard deviations, that should be near 0."""


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
        def one(command, shape):
            commanded = self.command(scene, command)
            return self.observation.seen(commanded, equilibrium_near(commanded, shape), 0.0)

        return jax.vmap(one)(self.commands, self.shapes), jnp.zeros(0)


class MeasuredMotion(Measurement):
    """A motion, cut into windows that each start from a state of their own. Made by `measured_motion`."""

    values: Values
    noise: Values
    observation: SeenQuantity
    times: Float[AnyArray, "windows frames"]
    """s, from each window's start to the next one's; the first frame of the next is the last of this one"""
    options: ResolvedOptions
    state: Float[AnyArray, "windows 2 nodes 3"]
    """positions, m, and velocities, m/s, at the windows' starts: known, or a guess"""
    spread: Float[AnyArray, "windows 2 nodes 3"]
    """standard deviations of the guess; 0 where it is known"""
    unknown: tuple[int, ...] = eqx.field(static=True)
    """which numbers of the states are not known"""
    jump: tuple[float, float] = eqx.field(static=True)
    """m and m/s, standard deviations of jumps from a window to the next: what the model leaves out in each"""

    def starts(self):
        unknown = np.array(self.unknown, int)
        return np.asarray(self.state).ravel()[unknown], np.asarray(self.spread).ravel()[unknown]

    def predict(self, scene, start):
        states = jnp.asarray(self.state)
        states = states.ravel().at[np.array(self.unknown, int)].set(start).reshape(states.shape)

        def window(state, times):
            q, v = integrate((state[0], state[1]), times, scene, self.options).ys
            return jax.vmap(lambda q, t: self.observation.seen(scene, q, t))(q, times), jnp.stack([q[-1], v[-1]])

        seen, ends = jax.vmap(window)(states, jnp.asarray(self.times))
        rows = jnp.concatenate([seen[:, :-1].reshape(-1, seen.shape[2]), seen[-1, -1:]])
        jumps = (ends[:-1] - states[1:]) / np.array(self.jump)[:, None, None]
        return rows, jumps.ravel()


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
    """Poses in which a robot came to rest after commands.

    Args:
        scene: what `identify` will be given: a scene, or any module with arrays from which `command` makes scenes.
        values: (poses, columns of the observation), SI units; NaN where missing.
        noise: their standard deviation: one number, one for each column, or one for each value.
        observation: what the columns are.
        shapes: (poses, nodes, 3), m, near which each pose is looked for, such as `resting_shape` finds.
        commands: arrays with a row for each pose.
        command: makes of `scene` and such a row the scene as commanded.

    Returns:
        What `identify` takes.

    Raises:
        InputError: shapes do not fit each other, all values are missing, or the noise is not positive.
    """
    rows = np.shape(values)[0]
    for leaf in jax.tree.leaves(commands):
        if np.shape(leaf)[:1] != (rows,):
            raise InputError(f"commands has an array of shape {np.shape(leaf)}; expected {rows} rows, one a pose")
    one = command(scene, jax.tree.map(lambda x: x[0], commands))
    values, noise = _checked(one, values, noise, observation)
    expected = (rows, *np.shape(one.structure.nodes))
    if np.shape(shapes) != expected:
        raise InputError(f"shapes has shape {np.shape(shapes)}; expected {expected}, all nodes at each pose")
    return MeasuredPoses(values, noise, observation, commands, command, np.asarray(shapes, float))


class Starts(NamedTuple):
    """From where a measured motion starts, and into how many windows it is cut, each with a start of its own."""

    path: NodeHistory
    """(frames, nodes, 3), m, a guess of the motion, such as what was measured, or a rollout"""
    windows: int = 1
    spread: tuple[float, float] | None = (0.02, 1.0)
    """m and m/s, standard deviations of the guess of each window's start; None: the motion starts at rest, where the
    path does, and this is known"""
    jump: tuple[float, float] = (1e-3, 1e-2)
    """m and m/s, by which the end of a window may plausibly miss the start of the next"""


def measured_motion(
    scene: Scene,
    times: Times,
    values: Values,
    noise: AnyArray | float,
    observation: SeenQuantity,
    starts: Starts,
    *,
    options: Options = None,
) -> MeasuredMotion:
    """A motion seen at known times.

    Long rollouts that roll are chaotic, and their residuals have many minima. Cut into windows, each of which starts
    from a state of its own, they are fitted by multiple shooting: jumps between windows count as residuals too.

    Args:
        scene: the robot with its gait, to check the rest against.
        times: (frames,), s since the gait's t = 0, increasing.
        values: (frames, columns of the observation), SI units; NaN where missing.
        noise: their standard deviation: one number, one for each column, or one for each value.
        observation: what the columns are.
        starts: from where the motion starts, and how well that is known.
        options: how to integrate; where not given, the scene decides. The precision is float64.

    Returns:
        What `identify` takes.

    Raises:
        InputError: shapes do not fit each other, times do not increase, all values are missing, the noise is not
            positive, options that do not fit the scene, or unknown starts of a robot with rigid struts.
    """
    values, noise = _checked(scene, values, noise, observation)
    times, path, windows = np.asarray(times, float), np.asarray(starts.path, float), starts.windows
    if times.shape != (len(values),):
        raise InputError(f"times has shape {times.shape}; expected ({len(values)},), one for each row of values")
    early = np.flatnonzero(~(np.diff(times) > 0))
    if early.size:
        k = int(early[0]) + 1
        raise InputError(f"times[{k}] = {times[k]:g} s after {times[k - 1]:g} s: expected times that increase")
    expected, steps = (len(times), *np.shape(scene.structure.nodes)), len(times) - 1
    if path.shape != expected or not np.isfinite(path).all():
        raise InputError(f"path has shape {path.shape}; expected {expected}, finite positions of all nodes")
    if windows < 1 or steps < windows or steps % windows:
        raise InputError(f"windows = {windows}: expected a number that divides the {steps} steps from frame to frame")
    if starts.spread is None and windows > 1:
        raise InputError(f"windows = {windows}, spread = None: expected one window where the start is known")
    if starts.spread is not None and scene.structure.struts is not None and scene.structure.struts.rigid:
        raise InputError("spread: rigid struts leave no start free; expected None, or struts that are springs")
    first = np.arange(windows) * (steps // windows)
    cut = np.stack([times[k : k + steps // windows + 1] for k in first])
    state = np.stack([_state_at(times, path, int(k)) for k in first])
    if starts.spread is None:
        state[:, 1] = 0
    deviations = np.array(starts.spread or (0.0, 0.0))[:, None, None]
    spread = np.broadcast_to(deviations, state.shape) * scene.structure.free
    unknown = tuple(np.flatnonzero(spread > 0).tolist())
    resolved = resolve(scene, float(cut[0, -1] - cut[0, 0]), options, dtype="float64")
    return MeasuredMotion(values, noise, observation, cut, resolved, state, spread, unknown, starts.jump)


def _state_at(times: np.ndarray, path: np.ndarray, frame: int) -> np.ndarray:
    """(2, nodes, 3): position and velocity of the straight line, or the parabola, that fits the next frames best."""
    near = slice(frame, frame + FITTED_FRAMES)
    t = times[near] - times[frame]
    fitted = np.polynomial.polynomial.polyfit(t, path[near].reshape(len(t), -1), min(2, len(t) - 1))
    return fitted[:2].reshape(2, *path.shape[1:])


def _checked(scene: Scene, values, noise, observation: SeenQuantity) -> tuple[np.ndarray, np.ndarray]:
    """Values and noise as arrays of one shape. Raises `InputError` where they make no sense."""
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
def predicted(measured: Measurement, scene: Any, start: AnyArray) -> Values:
    """What a scene predicts of measurements."""
    return measured.predict(scene, start)[0]


def check_units(measured: Measurement, expected: Values) -> None:
    """Raise `InputError` where values are so much larger or smaller than predicted that their unit is another."""
    there = np.isfinite(measured.values) & np.isfinite(expected)
    theirs, ours = (float(np.linalg.norm(np.asarray(x)[there])) for x in (measured.values, expected))
    if ours > 0 and theirs > 0 and not 1 / SCALE < theirs / ours < SCALE:
        raise InputError(
            f"values are {theirs / ours:.2g} times as large as the scene predicts: expected SI units (m, rad, N)"
        )

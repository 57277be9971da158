"""Measured motions, cut into windows for multiple shooting, and a scene's predictions of them."""

from dataclasses import replace
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.arguments import check_count, check_each
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeHistory, NodeVectors, Scalar, Times
from jaxgrity.identification.measurements import Measurement, Values, checked
from jaxgrity.identification.observations import SeenQuantity
from jaxgrity.model.actuation import Commands
from jaxgrity.model.rigidity import linked
from jaxgrity.model.scales import length_scale, speed_scale
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.discretisation import integrate
from jaxgrity.stepping.final_state import states_at
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve
from jaxgrity.stepping.simulate import with_commands

SPREAD, JUMP = (0.02, 1.0), (1e-3, 1e-2)
"""Standard deviations of guessed starts, and jumps between windows, in m and m/s for a body of one metre."""
FITTED_FRAMES = 8
"""Number of frames from which the velocity at the start of a window is guessed."""


class MeasuredMotion(Measurement):
    """A motion, cut into windows, each with a start of its own. Made by `measured_motion`."""

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
    jump: Float[AnyArray, "2"]
    """m and m/s, standard deviations of jumps from a window to the next: the model's error in each"""
    steps: int | None = eqx.field(static=True)
    """from frame to frame; None: the method adapts its step"""
    commands: Commands | None = None
    """rest lengths that were commanded in this motion; None: those of the scene's gait"""

    def starts(self):
        unknown = np.array(self.unknown, int)
        return np.asarray(self.state).ravel()[unknown], np.asarray(self.spread).ravel()[unknown]

    def predict(self, scene, start):
        scene, states = self._commanded(scene), self._states(start)
        found = jax.lax.map(lambda one: self._window(scene, *one), (states, jnp.asarray(self.times)))
        return self._nearest(scene, *self._joined(scene, *found, states))

    def linearised(self, scene_at, z, start):
        """Window by window: each depends on its own start alone, and all starts at once would cost their square."""
        count, windows = len(z), len(self.state)
        own, states = len(self.unknown) // windows, self._states(start)
        places = np.array(self.unknown[:own], int)

        def window(given):
            state, times, y = given

            def both(y):
                there = state.ravel().at[places].set(y[count:]).reshape(state.shape)
                # jacfwd returns derivatives alone: `has_aux` hands out the values of the same pass
                found = (*self._window(self._commanded(scene_at(y[:count])), there, times), there)
                return found, found

            slopes, found = jax.jacfwd(both, has_aux=True)(y)
            return found, slopes

        y = jnp.concatenate([jnp.broadcast_to(z, (windows, count)), start.reshape(windows, own)], axis=1)
        found, slopes = jax.lax.map(window, (states, jnp.asarray(self.times), y))
        scene = scene_at(z)
        slopes = self._joined(scene, *(_spread_out(slope, count) for slope in slopes))
        return self._nearest(scene, *self._joined(scene, *found)), slopes

    def _commanded(self, scene):
        return scene if self.commands is None else with_commands(scene, self.commands)

    def _nearest(self, scene, rows, jumps):
        return self.observation.near(scene, rows, self.values), jumps

    def _states(self, start):
        """The states at the windows' starts, those that are not known as given."""
        states = jnp.asarray(self.state)
        return states.ravel().at[np.array(self.unknown, int)].set(start).reshape(states.shape)

    def _window(self, scene, state, times):
        """The observations in a window, a row for each frame, and the state at its end.

        Unless the start is known, supports are where this scene has them: parameters may move them.
        """
        if self.unknown:
            state = with_supports_placed(scene, times[0], state)
        if self.steps:
            q, v = states_at(scene, (state[0], state[1]), times, self.steps, self.options)
        else:
            q, v = integrate((state[0], state[1]), times, scene, self.options).ys  # type: ignore[misc]
        return jax.vmap(lambda q, t: self.observation.seen(scene, q, t))(q, times), jnp.stack([q[-1], v[-1]])

    def _joined(self, scene, seen, ends, states):
        """The rows of all windows, and the jumps between windows; with one more axis, the derivatives of both.

        Supports jump nowhere, and count as no residuals: these would make the misfit smaller.
        """
        # the last frame of a window is the first of the next one, and counts once
        rows = jnp.concatenate([seen[:, :-1].reshape(-1, *seen.shape[2:]), seen[-1, -1:]])
        allowed = jnp.asarray(self.jump).reshape(2, 1, 1, *[1] * (states.ndim - 4))
        jumps = ((ends[:-1] - states[1:]) / allowed)[:, :, scene.structure.free]
        return rows, jumps.reshape(-1, *jumps.shape[3:])


def _spread_out(slopes: AnyArray, count: int) -> AnyArray:
    """(windows, ..., z and a window's own start) to (windows, ..., z and the starts of all windows)."""
    windows, own = len(slopes), slopes.shape[-1] - count
    apart = jnp.zeros((windows, *slopes.shape[1:-1], windows, own), slopes.dtype)
    number = np.arange(windows)
    apart = apart.at[number, ..., number, :].set(slopes[..., count:])
    return jnp.concatenate([slopes[..., :count], apart.reshape(*slopes.shape[:-1], windows * own)], axis=-1)


class Starts(NamedTuple):
    """The start of a measured motion, and its number of windows, each with a start of its own."""

    path: NodeHistory
    """(frames, nodes, 3), m, a guess of the motion, such as the measured one, or a rollout"""
    windows: int = 1
    spread: tuple[float, float] | Literal["usual"] | None = "usual"
    """m and m/s, standard deviations of the guess of each window's start, by default `SPREAD` of a body of this size;
    None: the motion starts at rest, where the path does, and this is known"""
    jump: tuple[float, float] | None = None
    """m and m/s, plausible jump from the end of a window to the start of the next; None: `JUMP`, likewise"""


@typed
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

    Long rolling motions are chaotic, and their residuals have many minima. So the motion is cut into windows with
    starts of their own (multiple shooting): jumps between windows count as residuals too.

    Args:
        scene: the robot with its gait, for checks of the other arguments.
        times: (frames,), s since the gait's t = 0, increasing.
        values: (frames, columns of the observation), SI units; NaN where missing.
        noise: their standard deviation: one number, one for each column, or one for each value.
        observation: the columns.
        starts: the start of the motion, and its uncertainty. If it is not known, supports start where the structure has
            them.
        options: solver options; by default the scene's. The precision is float64.

    Returns:
        The measurement, for `identify`.

    Raises:
        InputError: shapes that do not fit, or times that do not increase. Only missing values, or a noise that is not
            positive. Options that do not fit the scene. Starts that rigid struts or exact contact do not allow.
    """
    values, noise = checked(scene, values, noise, observation)
    times, path, windows = np.asarray(times, float), np.asarray(starts.path, float), starts.windows
    if times.shape != (len(values),):
        raise InputError(f"times has shape {times.shape}; expected ({len(values)},), one for each row of values")
    early = np.flatnonzero(~(np.diff(times) > 0))
    if early.size:
        k = int(early[0]) + 1
        raise InputError(f"times[{k}] = {times[k]:g} s after {times[k - 1]:g} s: expected times that increase")
    _check_path(path, (len(times), *np.shape(scene.structure.nodes)))
    intervals = len(times) - 1
    if check_count("windows", windows, 1) > intervals or intervals % windows:
        raise InputError(f"windows = {windows}: expected a divisor of the {intervals} steps from frame to frame")
    _check_spread(scene, starts)
    first = range(0, intervals, intervals // windows)
    cut = np.stack([times[k : k + intervals // windows + 1] for k in first])
    if starts.spread is None:
        resolved = resolve(scene, options=options, dtype="float64", positions=path[0], since=times[0])
        state = np.stack([path[:1], 0 * path[:1]], axis=1)
    else:
        resolved = resolve(scene, options=options, dtype="float64")
        with jax.enable_x64(True):
            state = np.stack([with_supports_placed(scene, times[k], state_at(times, path, k)) for k in first])
    deviations, jump = _deviations(scene, starts)
    spread = np.ones(state.shape) * deviations[:, None, None] * scene.structure.free
    unknown = tuple(np.flatnonzero(spread > 0).tolist())
    found = MeasuredMotion(values, noise, observation, cut, resolved, state, spread, unknown, jump, None)
    return with_options(found, resolved)


def _check_spread(scene: Scene, starts: Starts) -> None:
    if starts.spread is None and starts.windows > 1:
        raise InputError(f"windows = {starts.windows}, spread = None: expected one window where the start is known")
    if starts.spread is not None and linked(scene):
        raise InputError("spread: rigid struts and bodies leave no start free; expected None, or struts as springs")


def _deviations(scene: Scene, starts: Starts) -> tuple[np.ndarray, np.ndarray]:
    """The standard deviations of starts and of jumps, m and m/s."""
    size = np.array([float(length_scale(scene)), float(speed_scale(scene))])
    if not isinstance(starts.spread, str):
        check_each("spread", starts.spread, shape=(2,), least=0.0)
    check_each("jump", starts.jump, shape=(2,), above=0.0)
    given = starts.spread or (0.0, 0.0)
    spread = size * SPREAD if isinstance(given, str) else np.array(given, float)
    return spread, size * JUMP if starts.jump is None else np.array(starts.jump, float)


def with_options(motion: MeasuredMotion, options: ResolvedOptions) -> MeasuredMotion:
    """The measurement with other options, and the number of steps from frame to frame that they need."""
    longest = max(float(np.diff(times).max()) for times in np.asarray(motion.times))
    steps = None if options.dt is None else int(np.ceil(longest / options.dt - 1e-6))
    return replace(motion, options=options, steps=steps)


def above_exact_ground(scene: Scene, q: NodeVectors) -> np.ndarray:
    """Positions, m, moved out of exact ground, below which no motion can start."""
    q, ground = np.asarray(q, float), scene.ground
    if ground is None or not ground.impulsive or float(ground.measured(q).distance.min()) >= 0:
        return q
    return ground.set_down(q, 0.0, float(length_scale(scene)))


def _check_path(path: np.ndarray, expected: tuple[int, ...]) -> None:
    if path.shape != expected:
        raise InputError(f"path has shape {path.shape}; expected {expected}, positions of all nodes")
    if not np.isfinite(path).all():
        frame, node = np.argwhere(~np.isfinite(path))[0, :2]
        raise InputError(f"path[{frame}, {node}] is not finite; expected a guess of it where it was not seen")


def state_at(times: np.ndarray, path: np.ndarray, frame: int) -> np.ndarray:
    """(2, nodes, 3): position and velocity of the straight line or parabola through the next frames, by least
    squares."""
    near = slice(frame, frame + FITTED_FRAMES)
    t = times[near] - times[frame]
    fitted = np.polynomial.polynomial.polyfit(t, path[near].reshape(len(t), -1), min(2, len(t) - 1))
    return fitted[:2].reshape(2, *path.shape[1:])


def with_supports_placed(scene: Scene, t: Scalar, state: AnyArray) -> jax.Array:
    """The state with supports where the structure has them at `t`, s: their measured places are no more than noise."""
    q: AnyArray = jnp.asarray(scene.structure.nodes)
    v: AnyArray = jnp.zeros(3)
    if scene.shaking is not None:
        now = jnp.asarray(t, q.dtype)
        q, v = q + scene.shaking.displacement(now), scene.shaking.velocity(now)
    return jnp.where(scene.structure.free, state, jnp.stack([q, jnp.broadcast_to(v, q.shape)]))

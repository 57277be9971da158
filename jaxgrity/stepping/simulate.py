"""Simulation of one scene with saved frames, by any method.

`simulate` checks and completes its arguments, `discretisation.integrate` does the steps, and `frame_velocities.py`
moves velocities to the frames. `rollout` (`rollout.py`) is another way, for reverse mode: it takes the steps one by one
(`loop.py`).
"""

import math
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.display import of_report
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import forward_mode_only, traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeHistory, NodeVectors, Scalar, State, Times
from jaxgrity.model.actuation import Commands
from jaxgrity.model.rigidity import linked
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.stepping.discretisation import even_step, failure_code, integrate, state_failure, with_scales_and_mobility
from jaxgrity.stepping.frame_velocities import midway
from jaxgrity.stepping.methods import find_method
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve
from jaxgrity.stepping.pieces import OnTime, at_frames, in_pieces, is_long, seconds_since_midstep, with_room
from jaxgrity.stepping.starts import check_velocities, start_failure, velocities_stretch

MOST_FRAMES = 10**7
"""Most frames of a motion: positions and velocities of twelve nodes are 6 GB then."""
NO_REVERSE_MODE = (
    "simulate has derivatives in forward mode alone (jax.jacfwd, jax.jvp); for reverse mode use jaxgrity.rollout"
)
"""Message where reverse mode meets `simulate`."""


class Trajectory(eqx.Module):
    """A motion: positions and velocities of all nodes at saved times, the method, and whether the simulation failed."""

    times: Times
    """(frames,), s"""
    positions: NodeHistory
    """(frames, nodes, 3), m"""
    velocities: NodeHistory
    """(frames, nodes, 3), m/s, at the time of each frame. Those of complementarity stepping lack the impulses of struts
    and ground in the last half step, h/2: a node at rest has h/2 F/m, not 0, where F is the sum of its other
    forces. Use `velocities_midway` for energies and slip"""
    failure: jax.Array
    """index into `FAILURES`; 0: succeeded"""
    steps: jax.Array
    """number of accepted steps"""
    rejected: jax.Array
    """number of steps that an adaptive method rejected"""
    method: str = eqx.field(static=True)
    dt: float | None = eqx.field(static=True)
    """fixed step, s; None: adaptive"""
    scene: Scene | None = None
    """the scene of the motion; None if unknown, and then the motion cannot be shown"""
    commands: Commands | None = None
    """rest lengths that a controller commanded in a closed loop; None: those of the scene's gait"""

    @property
    def failed(self) -> bool:
        return bool(np.asarray(self.failure) != 0)

    def show(self, **how: Any) -> Any:
        """Replay the motion in 3D in Jupyter. `how` goes to `jaxgrity.report.view.replay`.

        Raises `InputError` if the trajectory does not know its scene, or viser is not installed.
        """
        if self.scene is None:
            raise InputError("this trajectory does not know its scene; expected a trajectory from `simulate`")
        return of_report("view", "replay")(self.scene, self, **how)

    def _repr_html_(self) -> str:
        return of_report("notebook", "trajectory_html")(self)


def check_frames(scene: Scene, trajectory: Trajectory) -> None:
    """Raises `InputError` for a motion of another robot, without frames, or with times that do not grow."""
    count, nodes = np.size(trajectory.times), len(scene.structure.nodes)
    for name in ("positions", "velocities"):
        if np.shape(getattr(trajectory, name)) != (count, nodes, 3):
            found = f"trajectory.{name} has shape {np.shape(getattr(trajectory, name))}"
            raise InputError(f"{found}; expected ({count}, {nodes}, 3): a motion of this scene")
    if not count or not np.all(np.diff(np.asarray(trajectory.times)) > 0):
        raise InputError(f"trajectory.times has {count} numbers; expected one or more, and that they grow")


def driven(scene: Scene, trajectory: Trajectory) -> Scene:
    """The scene with the rest lengths that its members had in this motion: in a closed loop the scene has no gait."""
    return scene if trajectory.commands is None else with_commands(scene, trajectory.commands)


def with_commands(scene: Scene, commands: Commands) -> Scene:
    """The scene with commanded rest lengths in place of its gait."""
    # scales are those of the scene as it is: commands have no frequency
    return eqx.tree_at(lambda s: s.gait, with_scales_and_mobility(scene), commands, is_leaf=lambda x: x is None)


@typed
def centre_path(scene: Scene, trajectory: Trajectory) -> np.ndarray:
    """(frames, 3), the centre of mass along a trajectory, m."""
    mass = np.asarray(scene.structure.lumped_mass, float)
    return np.einsum("n,fnk->fk", mass / mass.sum(), np.asarray(trajectory.positions, float))


@typed
def velocities_midway(scene: Scene, trajectory: Trajectory) -> np.ndarray:
    """(frames, nodes, 3), m/s: velocities after contact and rigid struts have acted, for reports on slip and impulses.

    For complementarity stepping these are the velocities in the middle of the step before each frame. For other methods
    they are those of the trajectory.
    """
    if trajectory.dt is None or not find_method(trajectory.method).constrained:
        return np.asarray(trajectory.velocities, float)
    dtype, nodes = str(trajectory.positions.dtype), len(scene.structure.nodes)
    frames = (trajectory.times, trajectory.positions, trajectory.velocities)
    kept = _midway(as_dtype(scene, dtype), np.asarray(trajectory.dt, dtype), *(with_room(x, nodes) for x in frames))
    return np.asarray(kept, float)[: len(trajectory.times)]


@eqx.filter_jit
def _midway(scene: Scene, dt: Scalar, times: Times, positions: NodeHistory, velocities: NodeHistory) -> NodeHistory:
    return midway(with_scales_and_mobility(scene), dt, times, positions, velocities)


def some_frames(trajectory: Trajectory, frames: np.ndarray | slice) -> Trajectory:
    """The same motion with only the given frames."""
    # known numbers are sliced by NumPy, which compiles nothing for it; inside of another jitted function none are
    known = (lambda x: x) if traced(trajectory) else np.asarray
    names = ("times", "positions", "velocities")
    kept = {name: jax.device_put(known(getattr(trajectory, name))[frames]) for name in names}
    return replace(trajectory, **kept)  # type: ignore[arg-type]


def frame_times(duration: float, frame_rate: float, at_most: float = math.inf) -> np.ndarray:
    """(frames,), s: even times from 0 to `duration`, two or more, about `frame_rate` per second, or `at_most`.

    Raises `InputError` if the rate is not positive and finite, or for more than `MOST_FRAMES`.
    """
    if not (frame_rate > 0 and math.isfinite(frame_rate)):
        raise InputError(f"frame_rate = {frame_rate}: expected a positive, finite number of frames a second")
    count = max(1, round(duration * min(frame_rate, at_most))) + 1
    if count > MOST_FRAMES:
        found = f"duration = {duration:g} s: {count:.2g} frames at {frame_rate:g} a second"
        raise InputError(f"{found}; expected at most {MOST_FRAMES:.2g} frames")
    return np.linspace(0, duration, count)


@typed
def simulate(
    scene: Scene,
    duration: Scalar,
    *,
    options: Options = None,
    frame_rate: float = 100.0,
    positions: NodeVectors | None = None,
    velocities: NodeVectors | None = None,
    on_progress: OnTime = lambda done, total: None,
) -> Trajectory:
    """Simulate a scene: integrate its equations of motion.

    You can differentiate the motion in forward mode; use `rollout` for reverse mode. To continue a motion, pass the
    positions and velocities of one of its frames; time then starts again at 0.

    Args:
        scene: the scene to simulate.
        duration: simulated time, s.
        options: solver options; by default the scene decides.
        frame_rate: saved frames per second, rounded so that evenly spaced frames end at `duration`.
        positions: (nodes, 3), m, at the start; by default those of the structure.
        velocities: (nodes, 3), m/s, at the start; by default zero.
        on_progress: called with the simulated time that is done, and the whole one, s. A long motion at even steps is
            simulated in pieces of a fraction of a second; others are one call of a compiled program.

    Returns:
        The motion from t = 0 to `duration`. Its `dt` is the step taken: complementarity stepping shortens the step
        until it divides the duration. A motion that fails is returned with its failure code. On exact contact, use
        `velocities_midway` for energies and slip (see `Trajectory.velocities`).

    Raises:
        InputError: bad options (see `resolve`), or a frame rate that is not positive and finite. Positions or
            velocities of the wrong shape. Velocities that move supports, or that stretch rigid struts if the method has
            no impulses to correct them.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> trajectory = jaxgrity.simulate(scene, 0.2)
        >>> trajectory.positions.shape  # (frames, nodes, 3), m
        (21, 12, 3)
    """
    if traced(duration):
        raise InputError("duration is being traced; pass a known number of seconds, or use jaxgrity.rollout")
    for name, given in (("positions", positions), ("velocities", velocities)):
        expected = np.shape(scene.structure.nodes)
        if given is not None and np.shape(given) != expected:
            raise InputError(f"{name} has shape {np.shape(given)}; expected {expected}, a row for each node")
    resolved = resolve(scene, float(duration), options, positions=positions)
    times = frame_times(float(duration), frame_rate)
    q = scene.structure.nodes if positions is None else positions
    v = np.zeros(np.shape(q)) if velocities is None else velocities
    check_velocities(scene, (q, v), 0.0, resolved.method.constrained)
    trajectory = _motion(as_dtype(scene, resolved.dtype), (q, v), times, resolved, on_progress)
    dt = resolved.dt
    if dt is not None and resolved.method.constrained:
        dt = float(even_step(np.asarray(dt, float), np.asarray(duration, float)))
    return replace(trajectory, dt=dt, scene=scene)  # type: ignore[arg-type]


def _motion(scene: Scene, start: State, times: np.ndarray, options: ResolvedOptions, on_progress: OnTime) -> Trajectory:
    """`simulate` at these times (s), in one call of a program, or in pieces if the motion is long."""
    count, inputs = np.asarray(len(times)), options.as_inputs()
    if traced((scene, start)):
        return _simulate(scene, start, times, count, inputs)
    q, v = (np.asarray(x, options.dtype) for x in start)  # else each precision has its own program
    if is_long(times, len(q), options):
        motion, failure, steps = in_pieces(scene, (q, v), times, inputs, on_progress)
        (q, v), at = jax.device_put((motion, np.asarray(times, options.dtype)))
        return Trajectory(at, q, v, jnp.asarray(failure), jnp.asarray(steps), jnp.asarray(0), options.method.name, None)
    saved = with_room(times, len(q))
    trajectory = _simulate(scene, (q, v), saved, count, inputs)
    on_progress(float(times[-1]), float(times[-1]))
    return some_frames(trajectory, slice(len(times))) if len(saved) > len(times) else trajectory


@eqx.filter_jit
def _simulate(scene: Scene, start: State, times: Times, frames: int | AnyArray, options: ResolvedOptions) -> Trajectory:
    """`simulate` at these times (s), of which the first `frames` differ, and the others repeat the last."""
    times = jnp.asarray(times, options.dtype)
    start = jax.tree.map(lambda x: jnp.asarray(x, options.dtype), start)
    solution = integrate(start, times, scene, options)
    q, v = solution.ys  # type: ignore[misc]
    stats, failure = solution.stats, failure_code(solution.result, state_failure(scene, q[-1], v[-1]))
    since = None
    if options.method.constrained:
        assert options.dt is not None, "complementarity stepping has steps of a fixed size"
        since = seconds_since_midstep(times, times[0], (times[-1] - times[0]) / stats["num_accepted_steps"], start[1])
    v = at_frames(scene, times, (q, v), since, frames)
    if linked(scene) and not options.method.constrained:
        failure = jnp.where(velocities_stretch(scene, start), 1, failure)
    misplaced = start_failure(scene, start[0])  # of traced numbers, which `resolve` could not check
    failure = jnp.where(misplaced != 0, misplaced, failure)
    q, v = forward_mode_only((q, v), NO_REVERSE_MODE)
    return Trajectory(
        times=times,
        positions=q,
        velocities=v,
        failure=failure,
        steps=stats["num_accepted_steps"],
        rejected=stats["num_rejected_steps"],
        method=options.method.name,
        dt=None,  # an input here, which `simulate` knows, as it does the scene
    )

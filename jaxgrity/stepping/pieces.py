"""A long motion at even steps in pieces, bit for bit the motion in one call: it shows progress, and can be stopped.

Nothing stops a compiled program before its end. So all pieces are calls of one program. Each takes over what the method
carries from step to step (`loop.Carried`), and counts the steps of the whole motion.
"""

import time
from collections.abc import Callable
from dataclasses import replace

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.tracing import traced
from jaxgrity.core.types import AnyArray, NodeHistory, NodeVectors, Scalar, State, Times, namespace_of
from jaxgrity.model.scene import Scene
from jaxgrity.model.shaking import with_supports
from jaxgrity.stepping.discretisation import (
    discretise,
    even_step,
    failure_code,
    integrate,
    state_failure,
    with_scales_and_mobility,
)
from jaxgrity.stepping.frame_velocities import at_rest, velocities_at
from jaxgrity.stepping.loop import Carried, carried_at
from jaxgrity.stepping.options import ResolvedOptions

SHARED_POSITIONS = 2**16
"""Number of saved positions (frames x nodes) up to which motions of a scene share one compiled program. The last frame
is repeated to fill it, unless the motion is differentiated. A minute of a robot with ten nodes, at 100 frames a second,
fits in; so many positions and velocities are 3 MB."""
LONG = 2**19
"""Number of steps x nodes from which on a motion is simulated in pieces: half a second or more on one core."""
SPAN = 0.2
"""Wall time, s, that a piece is to take. It does not change the motion."""

OnTime = Callable[[float, float], object]
"""Hears the simulated time that is done, and the whole one, s."""


class EvenSteps(diffrax.AbstractStepSizeController):
    """The steps of a motion after the first `done`: at the times that `diffrax.ConstantStepSize` gives the whole."""

    done: AnyArray
    """number of steps that were taken before"""
    number: AnyArray
    """number of steps of the whole motion"""
    first: AnyArray
    """size of its first step, s"""
    end: AnyArray
    """of the whole motion, s; it starts at 0"""

    def wrap(self, direction):
        return self

    def after(self, steps: AnyArray) -> Scalar:
        """The time after so many steps, s."""
        xp, dtype = namespace_of(self.end), self.end.dtype
        t = self.end * (xp.asarray(steps, dtype) / xp.asarray(self.number, dtype))
        return xp.where(steps == 1, self.first, xp.where(steps == self.number, self.end, t))

    def init(self, *_of_the_whole):
        return self.after(self.done + 1), self.done + 1

    def adapt_step_size(self, t0, t1, *more):  # the last of them is the number of steps
        steps = more[-1] + 1
        return True, t1, self.after(steps), False, steps, diffrax.RESULTS.successful


def with_room(frames: AnyArray, nodes: int) -> np.ndarray:
    """The same frames, the last one repeated up to `SHARED_POSITIONS`, so that motions share compiled programs."""
    more = max(0, SHARED_POSITIONS // nodes - len(frames))
    return np.pad(frames, [(0, more), *[(0, 0)] * (np.ndim(frames) - 1)], mode="edge")


def is_long(times: np.ndarray, nodes: int, options: ResolvedOptions) -> bool:
    """Whether a motion at even steps is to be simulated in pieces; each has room for the frames of some steps."""
    if options.dt is None or traced(options.dt):
        return False
    steps, room = times[-1] / float(options.dt), frames_at_once(nodes)
    fits = room >= 8 and len(times) * 8 < steps * room
    if not (fits and (steps * nodes > LONG or len(times) > SHARED_POSITIONS // nodes)):
        return False
    return not traced(jnp.zeros(()))  # inside of another jitted function, all results are traced


def frames_at_once(nodes: int) -> int:
    """Most frames of a piece, whose two ends are saved too."""
    return SHARED_POSITIONS // nodes - 2


def in_pieces(
    scene: Scene, start: State, times: np.ndarray, options: ResolvedOptions, on_progress: OnTime
) -> tuple[State, AnyArray, int]:
    """The frames (q, v) of a long motion at these times (s) from 0 on, its failure code and its number of steps."""
    times, nodes = np.asarray(times, options.dtype), len(start[0])
    scene, steps, carried = _begun(scene, start, times[-1], options)
    steps = jax.tree.map(np.asarray, steps)
    end, number = times[-1], int(steps.number)
    failure: AnyArray = jnp.zeros((), int)
    shape = (len(times), nodes, 3)
    motion = np.full(shape, np.inf, options.dtype), np.full(shape, np.inf, options.dtype)
    size, done, seen, room = LONG // 4 // nodes, 0, 0, frames_at_once(nodes)
    while done < number:
        on_progress(float(end) * done / number, float(end))
        began, until = time.perf_counter(), min(done + max(1, size), number)
        if seen + room < len(times):  # as many steps as there is room for their frames
            until = min(until, int(times[seen + room] / end * number) - 1)
        ends = [steps.after(np.asarray(count)) for count in (done, until)]
        last = int(np.searchsorted(times, ends[1], side="right"))
        saved = with_room(np.concatenate([ends[:1], times[seen:last], ends[1:]]), nodes)
        piece = replace(steps, done=np.asarray(done, np.int32))
        found, carried, failure, count = _piece(scene, (piece, carried), saved, options)
        for whole, part in zip(motion, found, strict=True):
            whole[seen:last] = np.asarray(part)[1 : 1 + last - seen]
        taken = int(count)
        done, seen = done + taken, last
        if done < until:  # the method gave up
            break
        size = int(taken * np.clip(SPAN / (time.perf_counter() - began), 0.25, 2.0))
    moved = options.method.constrained or scene.shaking is not None
    for first in range(0, seen if moved else 0, room):
        rows = slice(first, min(first + room, seen))
        t, q, w = (with_room(x[rows], nodes) for x in (times, *motion))
        kept = _velocities(scene, steps, start[1], (t, q, w), np.asarray(rows.stop - first), options)
        motion[1][rows] = np.asarray(kept)[: rows.stop - first]
    on_progress(float(end), float(end))
    return motion, failure, done


def at_frames(
    scene: Scene, times: Times, motion: State, since_midstep: Times | None, frames: int | AnyArray
) -> NodeHistory:
    """Velocities of the first `frames`, from those that the method carries; None: it has them at the frames' times."""
    if since_midstep is not None:
        return velocities_at(with_scales_and_mobility(scene), times, motion, since_midstep, frames)
    if scene.shaking is None:
        return motion[1]
    return jax.vmap(lambda t, v: with_supports(scene.shaking, scene.structure, t, v))(times, motion[1])


def seconds_since_midstep(times: Times, begin: Scalar, h: Scalar, v: NodeVectors) -> Times:
    """(frames,), s: by how much later each frame is than the velocities that complementarity stepping has there.

    At the end of a step that is half of its size h, s, and 0 at the start `begin`, s, of a robot at rest (v = 0). In
    the first step it changes evenly, as velocities are interpolated.
    """
    halves = jnp.stack([jnp.where(at_rest(v), 0, h), h]) / 2
    return jnp.interp(times, begin + jnp.stack([0 * h, h]), halves)


@eqx.filter_jit
def _begun(scene: Scene, start: State, end: AnyArray, options: ResolvedOptions) -> tuple[Scene, EvenSteps, Carried]:
    """The scene with what is computed once, the steps of a motion from 0 to `end`, s, none of them taken, and the carry
    at its start."""
    h, zero = jnp.asarray(options.dt, options.dtype), jnp.zeros((), options.dtype)
    h = jnp.asarray(even_step(h, end)) if options.method.constrained else h
    scene = with_scales_and_mobility(scene)
    carried = carried_at(discretise(options), scene, zero, h, start)
    number = jnp.ceil(end / jnp.nextafter(h, jnp.inf)).astype(jnp.int32)
    return scene, EvenSteps(jnp.zeros((), jnp.int32), number, h, end), carried


@eqx.filter_jit
def _piece(
    scene: Scene, state: tuple[EvenSteps, Carried], times: Times, options: ResolvedOptions
) -> tuple[State, Carried, AnyArray, AnyArray]:
    """What the method has, (q, w), at these times (s); the carry, failure code and steps then.

    The state has the motion's steps from here on, and its carry.
    """
    steps, carried = state
    saveat = diffrax.SaveAt(ts=jnp.asarray(times), t1=True, solver_state=True)
    solution = integrate(carried.motion, times, scene, options, saveat, part=(steps, carried.memory))
    q, w = (x[:-1] for x in solution.ys)  # type: ignore[union-attr]
    failure = failure_code(solution.result, state_failure(scene, q[-1], w[-1]))
    carried = Carried(jax.tree.map(lambda x: x[-1], solution.ys), solution.solver_state)
    return (q, w), carried, failure, solution.stats["num_accepted_steps"]


@eqx.filter_jit
def _velocities(
    scene: Scene,
    steps: EvenSteps,
    begun: NodeVectors,
    frames: tuple[Times, NodeHistory, NodeHistory],
    count: AnyArray,
    options: ResolvedOptions,
) -> NodeHistory:
    """`at_frames` of `frames` (times, q, w), of which the first `count` differ, of a motion that starts with the
    velocities `begun`, m/s. Not piece by piece: a few frames cost as much as many."""
    (times, q, w), since = frames, None
    if options.method.constrained:
        since = seconds_since_midstep(times, 0 * steps.end, steps.end / steps.number, begun)
    return at_frames(scene, times, (q, w), since, count)

"""Velocities at frames, from those that a method carries, and back.

Complementarity stepping is a leapfrog: its velocity w lives in the middle of its last step, of size h. A rollout
returns the velocity at the time of the positions, half a step on by the forces there: v = w + h/2 a(q, v, t). A rollout
from there takes that half step back, and continues without a break; one from rest begins with half a kick (`loop.py`).
So (q, v) is the whole state, and a motion in pieces is the motion in one piece. The contacts and rigid struts of the
next step have not yet acted on v.
"""

import jax
import jax.numpy as jnp

from jaxgrity.core.dense import least_solution
from jaxgrity.core.types import AnyArray, NodeHistory, NodeVectors, Scalar, Times
from jaxgrity.model.inertia import momenta
from jaxgrity.model.scene import Scene
from jaxgrity.model.shaking import left_by_step, with_supports
from jaxgrity.model.structure import Structure
from jaxgrity.stepping.dynamics import acceleration

FRAMES_AT_ONCE = 32
"""Number of frames whose velocities are solved for side by side: enough to fill vector units."""
CORRECTIONS = 8
"""Most corrections of Newton's method. The second leaves only rounding where dissipative forces are linear in v."""
DIRECTIONS = 60
"""Most iterations of conjugate gradients in each of those corrections."""


def at_rest(v: AnyArray) -> AnyArray:
    """Whether no node moves; for each of many robots side by side."""
    return jnp.all(v == 0, axis=(0, 1))


def velocity_at(scene: Scene, t: Scalar, q: NodeVectors, w: NodeVectors, since_midstep: Scalar) -> NodeVectors:
    """v = w + since_midstep a(q, v, t), m/s: the velocity of one robot at t, from w at `since_midstep` seconds before.

    With dissipative forces it is an equation with one solution, since they are gradients of a convex R. It is solved to
    rounding; its derivative is that of the solution, in both modes. Supports have their own velocities.
    """
    v = _velocity_after(scene.during(t - since_midstep, t), t, q, w, since_midstep)
    return with_supports(scene.shaking, scene.structure, t, v)


def _velocity_after(scene: Scene, t: Scalar, q: NodeVectors, w: NodeVectors, since_midstep: Scalar) -> NodeVectors:
    """`velocity_at` of the scene in the mean of that time."""

    def changed(v):
        return w + since_midstep * acceleration(scene, t, q, v)

    if not scene.dissipates:
        return changed(w)

    def solve(missed, guess):
        return _newton(scene.structure, missed, guess)

    def along(linear, y):
        slope = jax.jacfwd(linear)(jnp.zeros_like(y)).reshape(y.size, y.size)
        return least_solution(slope, y.ravel()).reshape(y.shape)

    return jax.lax.custom_root(lambda v: v - changed(v), jax.lax.stop_gradient(w), solve, along)


def velocities_at(
    scene: Scene, times: Times, motion: tuple[NodeHistory, NodeHistory], since_midstep: Times, frames: AnyArray | int
) -> NodeHistory:
    """`velocity_at` of the first `frames` of a motion (q, w); the filling after them stays."""
    q, w = motion
    size = min(FRAMES_AT_ONCE, len(times))

    def some(k, found):
        first = jnp.minimum(k * size, len(times) - size)
        part = [jax.lax.dynamic_slice_in_dim(x, first, size) for x in (times, q, w, since_midstep)]
        new = jax.vmap(lambda *frame: velocity_at(scene, *frame))(*part)
        return jax.lax.dynamic_update_slice_in_dim(found, new, first, 0)

    return jax.lax.fori_loop(0, (frames + size - 1) // size, some, w)


def midway(scene: Scene, dt: Scalar, times: Times, positions: NodeHistory, velocities: NodeHistory) -> NodeHistory:
    """w, m/s: the velocities in the middle of the step before each frame, which satisfy the constraints.

    For the frames of a rollout by complementarity stepping; frames at rest stay so.
    """

    def frame(t, q, v):
        shaken = left_by_step(scene.shaking, scene.structure, t, dt, v)
        before = shaken - dt / 2 * acceleration(scene.during(t - dt / 2, t), t, q, shaken)
        return jnp.where(at_rest(v), v, before)

    return jax.vmap(frame)(times, positions, velocities)


def _newton(structure: Structure, missed, v: NodeVectors) -> NodeVectors:
    """The root of `missed`, whose slope is symmetric and positive in the inner product of kinetic energy."""
    smallest = jnp.finfo(v.dtype).eps

    def unmet(carry):
        _, correction, size, count = carry
        return (count < CORRECTIONS) & (correction > 2 * smallest * size)

    def corrected(carry):
        v, _, _, count = carry
        miss, slope = jax.linearize(missed, v)
        size = jnp.maximum(jnp.max(jnp.abs(v)), jnp.max(jnp.abs(miss)))
        change = _conjugate_gradients(structure, slope, miss, smallest * size)
        return v - change, jnp.max(jnp.abs(change)), size, count + 1

    infinite = jnp.array(jnp.inf, v.dtype)
    return jax.lax.while_loop(unmet, corrected, (v, infinite, jnp.ones_like(infinite), 0))[0]


def _conjugate_gradients(structure: Structure, slope, right: NodeVectors, enough: Scalar) -> NodeVectors:
    """x with slope(x) = right, until no coordinate misses by more than `enough`, m/s."""

    def energy(x, y):
        return jnp.sum(momenta(structure, x) * y)

    def unmet(carry):
        _, left, _, _, count = carry
        return (count < DIRECTIONS) & (jnp.max(jnp.abs(left)) > enough)

    def further(carry):
        x, left, direction, size, count = carry
        pushed = slope(direction)
        bend = energy(direction, pushed)
        step = jnp.where(bend > 0, size / jnp.where(bend > 0, bend, 1), 0)
        x, left = x + step * direction, left - step * pushed
        now = energy(left, left)
        direction = left + jnp.where(size > 0, now / jnp.where(size > 0, size, 1), 0) * direction
        return x, left, direction, now, count + 1

    first = (jnp.zeros_like(right), right, right, energy(right, right), 0)
    return jax.lax.while_loop(unmet, further, first)[0]

"""Impulses of rigid struts, exact contact and supports along a finished trajectory, as mean forces between frames."""

import dataclasses
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from jaxgrity.core.types import AnyArray, NodeHistory, PerMember, Scalar, Times
from jaxgrity.model.actuation import rest_length, rest_lengths_along
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.stepping.constraints import rigid_struts
from jaxgrity.stepping.discretisation import discretise, with_scales_and_mobility
from jaxgrity.stepping.loop import Carried, Step, advance, carried_at
from jaxgrity.stepping.options import ResolvedOptions, options_anew
from jaxgrity.stepping.power import between_struts, ground_impulses, strut_impulses, strut_tensions, support_impulses
from jaxgrity.stepping.simulate import Trajectory, with_room

MOST = 2**10
"""Smallest number of steps for which there is room: motions with fewer share a compiled program."""
NEAR = 1e-3
"""Share of a step within which a frame counts as at the step's beginning: times are rounded."""


class Exerted(NamedTuple):
    """Impulses of one step, N s, or mean forces from frame to frame, N, with the frames in front."""

    struts: AnyArray
    """of the rigid struts, (struts,); what pushes is negative"""
    ground: AnyArray
    """of the ground on each node, (nodes, 3)"""
    supports: AnyArray
    """of the supports, (nodes, 3)"""
    between: AnyArray
    """of struts on each other, (nodes, 3)"""


class StepPlan(NamedTuple):
    """The steps of a motion, with room for more."""

    times: Times
    """(steps + 1,), s, at which they begin, and the last one ends"""
    taken_up: AnyArray
    """(steps,), whether a saved frame is at the step's beginning, from which it starts"""
    positions: NodeHistory
    """(steps, nodes, 3), m, of that frame"""
    velocities: NodeHistory
    """likewise, m/s"""
    longer: AnyArray
    """(steps + 1, struts), m, by which rigid struts are longer in the frames than the scene says"""


def impulses_along(scene: Scene, trajectory: Trajectory) -> Exerted:
    """Mean forces, N, from each frame to the next, and over one more step after the last.

    The motion is stepped again. Steps that begin at a saved frame start from its state: so they follow the motion,
    however sensitive it is. The impulse of each step is spread evenly over it, as for frames between steps.
    """
    times = np.asarray(trajectory.times, float)
    dt, dtype = float(trajectory.dt), str(trajectory.positions.dtype)  # type: ignore[arg-type]
    options = options_anew(scene, trajectory.method, dt, dtype)
    duration = times[-1] - times[0]
    count = math.ceil(duration / dt - NEAR)
    h = duration / count
    ends_of_steps = h * np.arange(count)
    starts = times[0] + np.r_[ends_of_steps, duration, duration + h]
    plan = _plan(scene, trajectory, starts)
    taken = _stepped(as_dtype(scene, dtype), options.as_inputs(), plan, np.asarray(count + 1))
    ends, sizes = np.append(times, starts[-1]), np.diff(starts)
    before = np.clip(np.searchsorted(starts, ends, side="right") - 1, 0, count)
    # velocities are those in the middle of steps: forces act from one middle to the next, at first from the start on
    first = sizes[0] if np.asarray(trajectory.velocities)[0].any() else 0.0
    kicks = (sizes + np.append(first, sizes[:-1])) / 2

    def between(each):
        """The sums over steps from one end to the next."""
        total = np.cumsum(each, axis=0)
        total = np.concatenate([0 * total[:1], total])
        share = ((ends - starts[before]) / sizes[before]).reshape(-1, *[1] * (total.ndim - 1))
        return np.diff(total[before] + share * (total[before + 1] - total[before]), axis=0)

    acted = between(kicks)
    return jax.tree.map(lambda x: (between(np.asarray(x, float)[: count + 1]).T / acted).T, taken)


def _plan(scene: Scene, trajectory: Trajectory, starts: np.ndarray) -> StepPlan:
    """The steps from each of `starts`, s, to the next."""
    times, steps = np.asarray(trajectory.times, float), len(starts) - 1
    q, v = (np.asarray(x) for x in (trajectory.positions, trajectory.velocities))
    room = max(MOST, 2 ** math.ceil(math.log2(steps)))
    frame = np.clip(np.searchsorted((times[1:] + times[:-1]) / 2, starts[:-1]), 0, len(times) - 1)
    near = np.abs(times[frame] - starts[:-1]) < NEAR * float(trajectory.dt)  # type: ignore[arg-type]
    struts, more = rigid_struts(scene), np.zeros((len(times), 0))
    if struts is not None:
        i, j = np.array(struts.edges).T
        with jax.enable_x64(True):
            asked = rest_lengths_along(struts, scene.gait, with_room(times, q.shape[1]), 0)
        more = np.linalg.norm(q[:, i].astype(float) - q[:, j], axis=-1) - np.asarray(asked)[: len(times)]
    # Only frames at steps have the true lengths, and they are smooth: their second derivative is a force.
    at = np.unique(frame[near])
    if len(at) < 2:
        at, more = np.arange(2), 0 * more[:2]
    smooth = scipy.interpolate.make_interp_spline(times[at], np.nan_to_num(more[at]), k=min(3, len(at) - 1))
    places, speeds = (_padded(x[frame] * near[:, None, None], room) for x in (q, v))
    return StepPlan(
        _padded(starts, room + 1),
        _padded(near, room),
        places,
        speeds,
        _padded(smooth(starts), room + 1).astype(q.dtype),
    )


def _padded(rows: np.ndarray, size: int) -> np.ndarray:
    return np.pad(rows, [(0, max(0, size - len(rows))), *[(0, 0)] * (rows.ndim - 1)], mode="edge")


@eqx.filter_jit
def _stepped(scene: Scene, options: ResolvedOptions, plan: StepPlan, count: AnyArray) -> Exerted:
    """The impulses of the first `count` steps of the plan, in front; zeros after them."""
    scene = with_scales_and_mobility(scene)
    scheme = discretise(options)
    nodes = scene.structure.nodes
    times = plan.times.astype(nodes.dtype)

    def step(k, carry):
        before, found = carry
        t, h = times[k], (plan.times[k + 1] - plan.times[k]).astype(nodes.dtype)
        here = _with_lengths(scene, t + h, plan.longer[k + 1])
        saved, anew = carried_at(scheme, here, t, h, (plan.positions[k], plan.velocities[k]))
        # only at its very start does a motion have half a kick
        anew = anew._replace(
            step_size=jnp.where(k > 0, h, anew.step_size),
            impulses=before.memory.impulses,
            landed=before.memory.landed,
        )
        new = plan.taken_up[k]
        before = jax.tree.map(lambda a, b: jnp.where(new, a, b), Carried(saved, anew), before)
        after = advance(scheme, here, (t, t + h), before)
        impulses = _impulses(here, Step(t, h, before, after))
        return after, jax.tree.map(lambda rows, row: rows.at[k].set(row), found, impulses)

    first = carried_at(scheme, scene, times[0], times[1] - times[0], (plan.positions[0], plan.velocities[0]))
    struts = rigid_struts(scene)
    room = len(plan.taken_up)
    empty = (
        jnp.zeros((room, *shape), nodes.dtype) for shape in ((len(struts.edges) if struts else 0,), *[nodes.shape] * 3)
    )
    return jax.lax.fori_loop(0, count, step, (first, Exerted(*empty)))[1]


def _with_lengths(scene: Scene, t: Scalar, longer: PerMember) -> Scene:
    """The scene with the lengths of rigid struts at the time t, s, plus `longer`, m."""
    struts = rigid_struts(scene)
    if struts is None:
        return scene
    lengths = rest_length(struts, scene.gait, t, 0) + longer
    still = dataclasses.replace(struts, rest_length=lengths, motors=(), stuck=tuple(range(len(struts.edges))))
    return eqx.tree_at(lambda s: s.structure, scene, dataclasses.replace(scene.structure, struts=still))


def _impulses(scene: Scene, step: Step) -> Exerted:
    nothing: AnyArray = jnp.zeros_like(step.before.motion[0])
    struts = rigid_struts(scene)
    supports: AnyArray = support_impulses(scene, step) if scene.structure.fixed else nothing
    pulls: AnyArray = jnp.zeros(0, nothing.dtype)
    if struts is not None:
        pulls = strut_tensions(scene, step.before.motion[0], strut_impulses(scene, step))
    ground, between = (sum(each(scene, step), nothing) for each in (ground_impulses, between_struts))
    return Exerted(pulls, ground, supports, between)

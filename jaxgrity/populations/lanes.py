"""Robots side by side: the population as the last axis in memory of every array, a chunk of it for each core.

Computations for one robot are mapped over that axis here; `population.py` deals chunks to the devices.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, Count, Scalar, State
from jaxgrity.model.actuation import Gait
from jaxgrity.model.inertia import independent_mobility
from jaxgrity.model.rigidity import linked
from jaxgrity.model.scene import Scene, start_of, with_scales
from jaxgrity.populations.metrics import Metrics, initial_metrics, updated_metrics
from jaxgrity.populations.uncertainty import Differences, differing
from jaxgrity.stepping.complementarity import Lift
from jaxgrity.stepping.discretisation import discretise, failure_code, integrate, state_failure
from jaxgrity.stepping.dynamics import centre_of_mass
from jaxgrity.stepping.loop import Carried, Step, carried_at, numbered
from jaxgrity.stepping.options import ResolvedOptions
from jaxgrity.stepping.starts import start_failure, velocities_stretch

FEWEST, SIDE_BY_SIDE = 32, 256
"""Fewest robots that a core integrates side by side, and most bytes that one number of all of them takes. That is
enough to fill the vector units, and few enough for the nearest cache (measured)."""
MANY = 2**16
"""Most robots that a GPU integrates side by side: enough to fill it, few enough for its caches (measured,
docs/scaling.md)."""
CACHE = 2**20
"""Most bytes that the members' vectors of all robots side by side take: a step uses them over and over (measured)."""
ROOM = 512
"""Parts of the time that a program of `parts_with_room` has room for, or a multiple: enough for a minute of a gait."""

Parts = int | tuple[int, Count]
"""Number of equal parts of the time. Or two numbers: of the parts that a program has room for, and of those in use. A
path then has rows for all of the room. Those of parts not in use repeat the end."""


class LaneOutcomes(NamedTuple):
    """The arrays of `Outcomes`, with the lanes as the last axis of each."""

    com_path: AnyArray
    positions: AnyArray
    failure: AnyArray
    steps: AnyArray
    rejected: AnyArray
    metrics: Metrics | None


class LaneEnd(NamedTuple):
    """The ends of rollouts."""

    state: State
    com_path: AnyArray
    result: diffrax.RESULTS
    steps: AnyArray
    rejected: AnyArray


def most_lanes(scene: Scene, options: ResolvedOptions) -> int:
    """The number of robots that a device integrates side by side: a power of two for a core, all on a GPU."""
    if jax.default_backend() != "cpu":
        return MANY
    bytes_each = 3 * np.dtype(options.dtype).itemsize * max(scene.structure.member_count, 1)
    most = SIDE_BY_SIDE // np.dtype(options.dtype).itemsize
    return int(np.clip(2 ** int(np.log2(max(CACHE / bytes_each, 1))), FEWEST, most))


def parts_with_room(parts: int, options: ResolvedOptions) -> Parts:
    """The same parts, of a program that calls with other numbers of parts share, where steps are equal.

    Not on a GPU, which would hand out thousands of paths with all of the room.
    """
    if parts == 1 or options.dt is None or options.method.implicit or jax.default_backend() != "cpu":
        return parts
    return ROOM * -(-parts // ROOM), np.asarray(parts)


@typed
def roll_out_lanes(
    scene: Scene,
    gaits: Gait,
    differences: Differences | None,
    duration: Scalar,
    options: ResolvedOptions,
    with_metrics: bool | Scalar = False,
    parts: Parts = 1,
) -> LaneOutcomes:
    """The rollouts of one chunk: the arrays of `gaits` and `differences` have lanes last.

    All returned arrays have the lanes last. `parts` is as in `roll_out`, or (room, number). The number is then an input
    of the program, so that one program serves up to `room` parts; the path's rows beyond it repeat the end. Steps have
    to be equal.
    """
    room, used = parts if isinstance(parts, tuple) else (parts, None)
    lanes, keeps_lengths = gaits.phase.shape[-1], linked(scene) and not options.method.constrained
    scene, axes = in_lanes(scene, gaits, differences)
    start = start_of(scene)
    if differences is not None and differences.velocities is not None:
        start = start[0], differences.velocities
    # robots that share their steps go through one loop: a map over robots' own takes 2.5 times as long (measured)
    metrics, together = None, options.dt is not None and not options.method.implicit
    if with_metrics is not False or (together and room > 1):
        end, metrics = _in_parts(start, duration, scene, axes, options, (room, used), with_metrics)
    elif together:
        centre = over_lanes(centre_of_mass, (axes, -1))
        end = _last(start, duration, scene, options, room, centre, discretise_lanes(options, axes))
        end = end._replace(steps=jnp.full(lanes, end.steps), rejected=jnp.full(lanes, end.rejected))
    else:
        one = lambda y, s: _last(y, duration, s, options, room, centre_of_mass)  # noqa: E731
        end = over_lanes(one, (-1, axes))(start, scene)
    q, v = end.state
    failure = failure_code(end.result, over_lanes(state_failure, (axes, -1, -1))(scene, q, v))
    if keeps_lengths:
        failure = jnp.where(over_lanes(velocities_stretch, (axes, -1))(scene, start), 1, failure)
    misplaced = over_lanes(start_failure, (axes, -1))(scene, start[0])
    failure = jnp.where(misplaced != 0, misplaced, failure)
    return LaneOutcomes(end.com_path, q, failure, end.steps, end.rejected, metrics)


def _in_parts(
    start: State,
    duration: Scalar,
    scene: Scene,
    axes: Scene,
    options: ResolvedOptions,
    parts: tuple[int, Count | None],
    with_metrics: bool | Scalar,
) -> tuple[LaneEnd, Metrics | None]:
    """The end at `duration`, after equal steps, and all robots' metrics.

    `parts`: how many the program has room for, and how many are used (None: all). `with_metrics`: whether, or the time
    (s) since when.
    """
    room, used = parts
    measures, since = with_metrics is not False, None if isinstance(with_metrics, bool) else with_metrics
    count = room if used is None else used
    scheme = discretise_lanes(options, axes)
    # less a thousandth of a step: rounding in float32 would add a whole one
    each = jnp.ceil(duration / count / jnp.asarray(options.dt, options.dtype) - 1e-3).astype(int)
    h = duration / (count * each)
    centre = over_lanes(centre_of_mass, (axes, -1))
    measured = over_lanes(initial_metrics, (axes, None))(scene, since) if measures else None
    # stepped by a loop of our own: metrics need the impulses of every step, which diffrax does not hand out
    first, step = carried_at(scheme, scene, 0 * h, h, start), numbered(scheme, scene, h)
    update = over_lanes(updated_metrics, (axes, step_axes(first), -1))

    def measured_step(k, carry):
        before, measured = carry
        after = step(before, k)
        return after, update(scene, Step(k * h, h, before, after), measured) if measures else None

    def part(carry, number):
        # parts beyond `used` have no steps, so that one program serves any number of parts up to `room`
        after = number + 1 if used is None else jnp.minimum(number + 1, used)
        carry = jax.lax.fori_loop(number * each, after * each, measured_step, carry)
        return carry, centre(scene, carry[0].motion[0])

    (last, measured), ends = jax.lax.scan(part, (first, measured), jnp.arange(room))
    path: AnyArray = jnp.concatenate([centre(scene, first.motion[0])[None], ends])
    lanes_of = path.shape[-1]
    done: Any = diffrax.RESULTS.successful
    return LaneEnd(last.motion, path, done, jnp.full(lanes_of, count * each), jnp.zeros(lanes_of, int)), measured


def _last(
    start: State,
    duration: Scalar,
    scene: Scene,
    options: ResolvedOptions,
    parts: int,
    centre: Callable,
    scheme: tuple | None = None,
) -> LaneEnd:
    """The end at `duration` of one robot, or by `scheme` of all of them at once."""
    times = jnp.stack([jnp.zeros_like(duration), duration])
    end = diffrax.SubSaveAt(t1=True)
    if parts == 1:
        solution = integrate(start, times, scene, options, diffrax.SaveAt(subs=end), scheme)
        last = jax.tree.map(lambda x: x[0], solution.ys)
        path = jnp.stack([centre(scene, start[0]), centre(scene, last[0])])
    else:
        between = diffrax.SubSaveAt(ts=jnp.linspace(0, duration, parts + 1), fn=lambda t, y, s: centre(s, y[0]))
        solution = integrate(start, times, scene, options, diffrax.SaveAt(subs=[end, between]), scheme)
        last, path = jax.tree.map(lambda x: x[0], solution.ys[0]), solution.ys[1]  # type: ignore[index]
    steps, rejected = (solution.stats[f"num_{kind}_steps"] for kind in ("accepted", "rejected"))
    return LaneEnd(last, path, solution.result, steps, rejected)


@typed
def discretise_lanes(options: ResolvedOptions, axes: Scene) -> tuple[diffrax.AbstractTerm, diffrax.AbstractSolver]:
    """`discretise` for a whole chunk, whose scene has these `in_axes`."""
    return discretise(options, lift_over(axes))


def lift_over(axes: Scene) -> Lift:
    """The `Lift` of robots whose scene has these `in_axes`."""
    return lambda function, in_axes: over_lanes(function, tuple(axes if a == "s" else a for a in in_axes))


def over_lanes(function: Callable, in_axes: tuple) -> Callable:
    """`vmap` that leaves the population last."""
    return jax.vmap(function, in_axes=in_axes, out_axes=-1)


@typed
def in_lanes(scene: Scene, gaits: Gait, differences: Differences | None = None) -> tuple[Scene, Scene]:
    """The scene of many robots, with a last axis of lanes on every array but scalars, and its `in_axes`.

    `gaits` and `differences` have lanes last already. All arrays get the axis: with a mixture, JAX's rules for
    elementwise operations would move it to the front. Scales are those of the scene, one number for all robots.
    """
    if np.shape(gaits.phase)[:-1] != (len(gaits.members),):
        expected = f"expected ({len(gaits.members)}, robots), as lanes_last gives it"
        raise InputError(f"gaits.phase has shape {np.shape(gaits.phase)}; {expected}")
    scene, lanes = with_scales(scene), gaits.phase.shape[-1]
    spread = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, lanes)) if x.ndim else x, scene)
    spread = differing(eqx.tree_at(lambda s: s.gait, spread, gaits, is_leaf=lambda x: x is None), differences)
    if spread.structure.needs_mobility:
        response = over_lanes(independent_mobility, (last_axes(spread.structure),))(spread.structure)
        spread = eqx.tree_at(lambda s: s.structure.mobility, spread, response, is_leaf=lambda x: x is None)
    if scene.ground is not None and scene.ground.surface is not None:
        # all robots' alike: its numbers are scalars, or tables to look into, and meet no array of nodes by elements
        spread = eqx.tree_at(_surface, spread, scene.ground.surface)
    return spread, lane_axes(spread)


def step_axes(carried: Carried) -> Step:
    """The `in_axes` of a `Step` of many robots, from the method's carry."""
    axes = last_axes(carried)
    return Step(None, None, axes, axes)  # type: ignore[arg-type]


def lane_axes(scene: Scene) -> Scene:
    """The `in_axes` of a scene with lanes: the last axis of every array but scalars and a surface's arrays."""
    axes = last_axes(scene)
    if scene.ground is None or scene.ground.surface is None:
        return axes
    common = jax.tree.map(lambda x: None, scene.ground.surface)
    return eqx.tree_at(_surface, axes, common, is_leaf=lambda x: x is None)


def _surface(scene: Scene):
    return scene.ground.surface  # type: ignore[union-attr]


def last_axes(x):
    """The `in_axes` of a tree with the lanes last in every array but scalars."""
    return jax.tree.map(lambda x: -1 if jnp.ndim(x) else None, x)


def lanes_last(rows):
    """A population's gaits, or differences, with the population as the last axis of every array."""
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1) if jnp.ndim(x) else x, rows)

"""Many gaits of one scene in one call: one `vmap`'d vector field inside one `diffeqsolve`, over every device.

The population is the last axis in memory (see `primitives.py`), split into chunks that stay in a core's cache, and the
chunks are split over `jax.devices()`. A robot that fails is marked, and disturbs no other.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, Failures, FinalPositions, PerGait, Phases, Scalar, State, Table, Vectors
from jaxgrity.model.actuation import Gait, Overtone
from jaxgrity.model.scene import Scene, as_dtype, start_of, with_gait
from jaxgrity.rollout.metrics import Metrics, initial_metrics, updated_metrics
from jaxgrity.rollout.uncertainty import Differences, differing
from jaxgrity.stepping.dynamics import centre_of_mass
from jaxgrity.stepping.integrate import discretise, failure_code, integrate, state_failure
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve
from jaxgrity.stepping.power import Step

LANES = (32, 128)
"""robots that a core integrates side by side, where there are so many: enough to fill the vector units (measured)"""
MANY = 2**20
"""on a GPU, which runs them at once (not measured)"""
CACHE = 2**20
"""bytes that the members' vectors of all robots side by side may take: they are used over and over (measured)"""


class Outcomes(eqx.Module):
    """Where a population's robots got to."""

    com_start: Vectors
    """(population, 3), centre of mass at the start, m"""
    com_end: Vectors
    """(population, 3), centre of mass at the end, m"""
    positions: FinalPositions
    """(population, nodes, 3), where every node is at the end, m"""
    failure: Failures
    """(population,), index into `FAILURES`; 0: succeeded"""
    steps: Failures
    """(population,), accepted steps"""
    rejected: Failures
    """(population,), steps that an adaptive method tried and gave up"""
    metrics: Metrics | None
    """of every robot, a row for each, where they were asked for"""
    method: str = eqx.field(static=True)
    dt: float | None = eqx.field(static=True)
    """fixed step, s; None: adaptive, or, inside of compiled functions, an input of theirs"""

    def distance(self) -> PerGait:
        """(population,), horizontal displacement of the centre of mass, m; NaN where the rollout failed."""
        moved = (self.com_end - self.com_start)[:, :2]
        return jnp.where(self.failure == 0, jnp.sqrt(jnp.sum(moved * moved, axis=1)), jnp.nan)


class LaneOutcomes(NamedTuple):
    """The arrays of `Outcomes`, with the lanes as the last axis of each."""

    com_start: AnyArray
    com_end: AnyArray
    positions: AnyArray
    failure: AnyArray
    steps: AnyArray
    rejected: AnyArray
    metrics: Metrics | None


class LaneEnd(NamedTuple):
    """How rollouts ended."""

    state: State
    result: diffrax.RESULTS
    steps: AnyArray
    rejected: AnyArray


def gaits_of(gait: Gait | None, phase: Phases, amplitude: Table | None = None, frequency: Table | None = None) -> Gait:
    """A population of gaits as one `Gait`, a row of each array a robot; what is not given is `gait`'s own.

    Raises `InputError` where the scene has no gait, the rows have another length than its list of members, or the
    arrays differ in their number of rows, or there are none.
    """
    if gait is None:
        raise InputError("the scene has no gait; expected a [gait] table to vary")
    if np.ndim(phase) == 2 and len(phase) == 0:
        raise InputError("phase has no rows; expected at least one gait")

    def rows(given, own):
        return jnp.broadcast_to(own, np.shape(phase)) if given is None else given

    count = len(gait.members)
    for name, given in (("phase", phase), ("amplitude", amplitude), ("frequency", frequency)):
        if given is not None and (np.ndim(given) != 2 or np.shape(given)[1] != count):
            raise InputError(f"{name} has shape {np.shape(given)}; expected (gaits, {count}), one an actuated member")
        if given is not None and np.shape(given) != np.shape(phase):
            raise InputError(f"{name} has {len(given)} rows; expected {len(phase)}, as many as phase has")
    varied = rows(amplitude, gait.amplitude), rows(frequency, gait.frequency)
    overtones = tuple(Overtone(rows(None, o.size), rows(None, o.phase)) for o in gait.overtones)
    return Gait(gait.members, phase, *varied, gait.start, gait.ramp, overtones)


def one_gait(gaits: Gait, k: int) -> Gait:
    """Gait number `k` of a population."""
    return jax.tree.map(lambda x: x[k] if np.ndim(x) else x, gaits)


def as_population(gait: Gait) -> Gait:
    """A population of one gait."""
    return jax.tree.map(lambda x: np.asarray(x)[None] if np.ndim(x) else x, gait)


def simulate_population(
    scene: Scene,
    gaits: Gait,
    duration: float,
    *,
    options: Options = None,
    differences: Differences | None = None,
    with_metrics: bool = False,
) -> Outcomes:
    """Roll the scene out once for each of `gaits`, from the structure's own pose at rest.

    Fixed steps of an explicit method advance all robots at once; the steps of any other are chosen, or solved for,
    robot by robot.

    Args:
        scene: what moves; its own gait, if it has one, does not count: members, start and ramp are those of `gaits`.
        gaits: a population of gaits, as from `gaits_of`.
        duration: s.
        options: how to integrate; where not given, the scene decides. Steps are judged by the scene itself.
        differences: in what the robots differ beside their gaits.
        with_metrics: whether to measure actuators and contact, which needs an explicit method at a fixed step.

    Returns:
        Where each robot got to, a row for each gait. A robot that fails is marked, and disturbs no other.

    Raises:
        InputError: bad options (see `resolve`), gaits that do not fit the scene, or that are no population.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> gaits = jaxgrity.gaits_of(scene.gait, jaxgrity.random_phases(3, actuators=6, seed=0))
        >>> outcomes = jaxgrity.simulate_population(scene, gaits, duration=0.2)
        >>> outcomes.distance().shape  # m
        (3,)
    """
    if np.ndim(gaits.phase) != 2 or len(gaits.phase) == 0:
        raise InputError(
            f"gaits.phase has shape {np.shape(gaits.phase)}; expected (gaits, actuators), one gait or more"
        )
    scene = with_gait(scene, one_gait(gaits, 0))
    resolved = resolve(scene, duration, options)
    end = np.asarray(duration, float)
    outcomes = roll_out(
        as_dtype(scene, resolved.dtype), gaits, end, resolved.as_inputs(), differences, with_metrics=with_metrics
    )
    return replace(outcomes, dt=resolved.dt)  # type: ignore[arg-type]


@eqx.filter_jit
def roll_out(
    scene: Scene,
    gaits: Gait,
    duration: Scalar,
    options: ResolvedOptions,
    differences: Differences | None = None,
    *,
    with_metrics: bool = False,
) -> Outcomes:
    """`simulate_population` without its checks, of a scene with one of the gaits, for other compiled functions."""
    if with_metrics and (options.dt is None or options.method.implicit):
        raise InputError(f"method = {options.method.name!r}: expected an explicit one at a fixed step, for metrics")
    size = gaits.phase.shape[0]
    # lineax's linear solve, inside implicit methods, cannot be traced under shard_map
    devices = 1 if options.method.implicit else jax.device_count()
    chunks = -(-size // (devices * most_lanes(scene, options)))
    lanes = -(-size // (devices * chunks))

    def deal(x):
        """(population, ...) to (devices, chunks, ..., lanes), the last row repeated to fill them."""
        full = jnp.asarray(x, options.dtype)[np.minimum(np.arange(devices * chunks * lanes), size - 1)]
        return jnp.moveaxis(full.reshape(devices, chunks, lanes, *full.shape[1:]), 2, -1)

    def collect(x):
        """(devices, chunks, ..., lanes) back to (population, ...)."""
        return jnp.moveaxis(x, -1, 2).reshape(-1, *x.shape[2:-1])[:size]

    varied, common = eqx.partition((gaits, differences), lambda x: jnp.ndim(x) > 0)
    inputs, fixed = eqx.partition(options, eqx.is_array)

    def share(rows, scene, common, end, inputs):
        def chunk(rows):
            return roll_out_lanes(scene, *eqx.combine(rows, common), end, eqx.combine(inputs, fixed), with_metrics)

        outcomes = jax.lax.map(chunk, jax.tree.map(lambda x: x[0], rows))
        return jax.tree.map(lambda x: x[None], outcomes)

    if devices > 1:
        mesh = Mesh(np.array(jax.devices()), ("population",))
        split, whole = PartitionSpec("population"), PartitionSpec()
        specs = split, whole, whole, whole, whole
        share = jax.shard_map(share, mesh=mesh, in_specs=specs, out_specs=split, check_vma=False)
    common = jax.tree.map(lambda x: jnp.asarray(x, options.dtype), common)
    outcomes = share(jax.tree.map(deal, varied), scene, common, jnp.asarray(duration, options.dtype), inputs)
    outcomes = jax.tree.map(collect, outcomes)
    if devices > jax.local_device_count():
        # every host gets all outcomes, and goes on as if it had computed them alone
        outcomes = jax.lax.with_sharding_constraint(outcomes, NamedSharding(mesh, PartitionSpec()))
    return Outcomes(**outcomes._asdict(), method=options.method.name, dt=None)


def most_lanes(scene: Scene, options: ResolvedOptions) -> int:
    """How many robots of this size a device integrates side by side: a power of two for a core, all on a GPU."""
    if jax.default_backend() != "cpu":
        return MANY
    bytes_each = 3 * np.dtype(options.dtype).itemsize * max(scene.structure.member_count, 1)
    return int(np.clip(2 ** int(np.log2(max(CACHE / bytes_each, 1))), *LANES))


def roll_out_lanes(
    scene: Scene,
    gaits: Gait,
    differences: Differences | None,
    duration: Scalar,
    options: ResolvedOptions,
    with_metrics: bool = False,
) -> LaneOutcomes:
    """The rollouts of one chunk: the arrays of `gaits` and `differences` have lanes last.

    All arrays that come back have the lanes last.
    """
    lanes = gaits.phase.shape[-1]
    scene, axes = in_lanes(scene, gaits, differences)
    start = start_of(scene)
    metrics = None
    if with_metrics:
        (q, v), metrics, count = _measured(start, duration, scene, axes, options)
        done = diffrax.RESULTS.successful
        end = LaneEnd((q, v), done, jnp.full(lanes, count), jnp.zeros(lanes, int))  # type: ignore[arg-type]
    elif options.dt is not None and not options.method.implicit:
        end = _last(start, duration, scene, options, discretise_lanes(options, axes))
        end = end._replace(steps=jnp.full(lanes, end.steps), rejected=jnp.full(lanes, end.rejected))
    else:
        end = over_lanes(lambda y, s: _last(y, duration, s, options), (-1, axes))(start, scene)
    q, v = end.state
    failure = failure_code(end.result, over_lanes(state_failure, (axes, -1, -1))(scene, q, v))
    com = over_lanes(centre_of_mass, (axes, -1))
    return LaneOutcomes(com(scene, start[0]), com(scene, q), q, failure, end.steps, end.rejected, metrics)


def _measured(start: State, duration: Scalar, scene: Scene, axes: Scene, options: ResolvedOptions):
    """The state at `duration`, all robots' metrics, and how many steps were taken, each as long as the others."""
    terms, solver = discretise_lanes(options, axes)
    count = jnp.ceil(duration / jnp.asarray(options.dt, options.dtype) - 1e-3).astype(int)
    h = duration / count
    held = over_lanes(initial_metrics, (axes,))(scene)
    first = solver.init(terms, 0 * h, h, start, scene)
    lanes = jax.tree.map(lambda x: -1 if x.ndim else None, first)
    step_axes = Step(None, None, (-1, -1), (-1, -1), lanes, lanes)  # type: ignore[arg-type]
    update = over_lanes(updated_metrics, (axes, step_axes, -1))

    def step(k, carry):
        y, before, held = carry
        y1, _, _, after, _ = solver.step(terms, k * h, (k + 1) * h, y, scene, before, False)
        return y1, after, update(scene, Step(k * h, h, y, y1, before, after), held)

    end, _, held = jax.lax.fori_loop(0, count, step, (start, first, held))
    return end, held, count


def _last(
    start: State, duration: Scalar, scene: Scene, options: ResolvedOptions, problem: tuple | None = None
) -> LaneEnd:
    """The end at `duration` of one robot, or by `problem` of all of them at once."""
    times = jnp.stack([jnp.zeros_like(duration), duration])
    solution = integrate(start, times, scene, options, diffrax.SaveAt(t1=True), problem)
    steps, rejected = (solution.stats[f"num_{kind}_steps"] for kind in ("accepted", "rejected"))
    return LaneEnd(jax.tree.map(lambda x: x[0], solution.ys), solution.result, steps, rejected)


def discretise_lanes(options: ResolvedOptions, axes: Scene) -> tuple[diffrax.AbstractTerm, diffrax.AbstractSolver]:
    """`discretise` for a whole chunk, whose scene has these `in_axes`."""

    def lift(function, in_axes):
        return over_lanes(function, tuple(axes if a == "s" else a for a in in_axes))

    return discretise(options, lift)


def over_lanes(function: Callable, in_axes: tuple) -> Callable:
    """`vmap` that leaves the population last."""
    return jax.vmap(function, in_axes=in_axes, out_axes=-1)


def in_lanes(scene: Scene, gaits: Gait, differences: Differences | None = None) -> tuple[Scene, Scene]:
    """The scene of many robots, with a last axis of lanes on every array but scalars, and the `in_axes` that say so.

    `gaits` and `differences` have lanes last already. Where some arrays had the axis and others not, JAX's rules for
    elementwise operations would move it to the front.
    """
    lanes = gaits.phase.shape[-1]
    spread = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, lanes)) if x.ndim else x, scene)
    spread = differing(eqx.tree_at(lambda s: s.gait, spread, gaits, is_leaf=lambda x: x is None), differences)
    return spread, jax.tree.map(lambda x: -1 if jnp.ndim(x) else None, spread)


def lanes_last(rows):
    """Of a population's gaits, or of what differs: the population as the last axis of every array."""
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1) if jnp.ndim(x) else x, rows)

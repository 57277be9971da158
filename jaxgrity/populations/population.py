"""Many gaits of one scene in one call, on all devices.

The population is the last axis in memory (see `lanes.py`). It is split into chunks that fit a core's cache, and the
chunks are shared by `jax.devices()`. A robot that fails is marked, and does not affect the others.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxgrity.core.arguments import check_count, check_index, check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.functions import hold_functions
from jaxgrity.core.remembered import remembered
from jaxgrity.core.tracing import evaluated, traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import Failures, FinalPositions, Paths, PerGait, Phases, Scalar, Table, Vectors, namespace_of
from jaxgrity.model.actuation import Gait, Overtone
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.populations.lanes import Parts, most_lanes, roll_out_lanes
from jaxgrity.populations.metrics import Metrics
from jaxgrity.populations.uncertainty import Differences, check_many
from jaxgrity.stepping.options import KEPT, Options, ResolvedOptions, resolve
from jaxgrity.stepping.starts import check_known_velocities


class Outcomes(eqx.Module):
    """Results of a population, one row per robot."""

    com_path: Paths
    """(population, parts + 1, 3), centre of mass at the start and at the end of each part of the time, m"""
    positions: FinalPositions
    """(population, nodes, 3), positions of the nodes at the end, m"""
    failure: Failures
    """(population,), index into `FAILURES`; 0: succeeded"""
    steps: Failures
    """(population,), number of accepted steps"""
    rejected: Failures
    """(population,), number of steps that an adaptive method rejected"""
    metrics: Metrics | None
    """measurements of actuators and contact; None if not requested"""
    method: str = eqx.field(static=True)
    dt: float | None = eqx.field(static=True)
    """fixed step, s, shortened until steps divide each part of the time; None: adaptive, or unknown inside compiled
    functions"""

    @property
    def com_start(self) -> Vectors:
        """(population, 3), centre of mass at the start, m."""
        return self.com_path[:, 0]

    @property
    def com_end(self) -> Vectors:
        """(population, 3), centre of mass at the end, m."""
        return self.com_path[:, -1]

    def distance(self) -> PerGait:
        """(population,), horizontal displacement of the centre of mass, m; NaN for failed robots."""
        moved = (self.com_end - self.com_start)[:, :2]
        return jnp.where(self.failure == 0, jnp.sqrt(jnp.sum(moved * moved, axis=1)), jnp.nan)


@typed
def gaits_of(gait: Gait | None, phase: Phases, amplitude: Table | None = None, frequency: Table | None = None) -> Gait:
    """Make a population of gaits: one `Gait` whose arrays have a row per robot.

    Phases, and if given amplitudes and frequencies, have the shape (gaits, actuators). All else is taken from `gait`.

    Raises `InputError` if the scene has no gait, if a row does not have one number per actuated member, or if the
    arrays have no rows or different numbers of rows.
    """
    if gait is None:
        raise InputError("the scene has no gait; expected a [gait] table to vary")
    if np.ndim(phase) == 2 and len(phase) == 0:
        raise InputError("phase has no rows; expected at least one gait")

    def rows(given, own):
        return namespace_of(phase).broadcast_to(own, np.shape(phase)) if given is None else given

    count = len(gait.members)
    for name, given in (("phase", phase), ("amplitude", amplitude), ("frequency", frequency)):
        if given is None and name != "phase":
            continue
        shape = () if given is None else np.shape(given)
        if len(shape) != 2 or shape[1] != count:
            raise InputError(f"{name} has shape {shape}; expected (gaits, {count}), one per actuated member")
        if shape != np.shape(phase):
            raise InputError(f"{name} has {shape[0]} rows; expected {len(phase)}, as many as phase has")
    varied = rows(amplitude, gait.amplitude), rows(frequency, gait.frequency)
    overtones = tuple(Overtone(rows(None, o.size), rows(None, o.phase)) for o in gait.overtones)
    return Gait(gait.members, phase, *varied, gait.start, gait.ramp, overtones, gait.robot)


@typed
def one_gait(gaits: Gait, k: int) -> Gait:
    """Gait number `k` of a population, from 0 on. Raises `InputError` if there is none."""
    check_many(gaits)
    if not traced(k):
        check_index("k", np.asarray(k)[()], len(gaits.phase))
    return jax.tree.map(lambda x: x[k] if np.ndim(x) else x, gaits)


@typed
def as_population(gait: Gait) -> Gait:
    """A population of one gait. Raises `InputError` for one that is a population already."""
    if np.ndim(gait.phase) != 1:
        raise InputError(f"gait.phase has shape {np.shape(gait.phase)}; expected (actuators,), one gait")
    return jax.tree.map(lambda x: np.asarray(x)[None] if np.ndim(x) else x, gait)


@typed
def simulate_population(
    scene: Scene,
    gaits: Gait,
    duration: float,
    *,
    options: Options = None,
    differences: Differences | None = None,
    with_metrics: bool | float = False,
    parts: int = 1,
) -> Outcomes:
    """Simulate the scene once for each of `gaits`, from the structure's nodes at rest.

    Explicit methods with a fixed step advance all robots at once. Adaptive and implicit methods go robot by robot.

    Args:
        scene: the scene to simulate. Its own gait is ignored: members, start and ramp are those of `gaits`.
        gaits: a population of gaits, as from `gaits_of`.
        duration: simulated time, s.
        options: solver options; by default the scene decides. The scene itself determines the stable step.
        differences: differences between the robots besides their gaits.
        with_metrics: whether to measure actuators and contact (`Metrics`). True measures from the start of the gait
            on, and a number from that time on, s. This needs an explicit method with a fixed step. Peaks are those of
            a moving mean that begins at zero. So if robots start in motion, measure from the second cycle on.
        parts: number of equal parts of the time, at whose ends the centre of mass is returned.

    Returns:
        The results, a row for each gait. A robot that fails is marked, and does not affect the others.

    Raises:
        InputError: bad options (see `resolve`), gaits that do not fit the scene, or a single gait.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> gaits = jaxgrity.gaits_of(scene.gait, jaxgrity.random_phases(3, actuators=6, seed=0))
        >>> outcomes = jaxgrity.simulate_population(scene, gaits, duration=0.2)
        >>> outcomes.distance().shape  # m
        (3,)
    """
    check_many(gaits)
    check_number("duration", duration, above=0.0, unit="s")
    check_count("parts", parts, 1)
    if differences is not None:
        differences.check(scene, len(gaits.phase))
        if differences.velocities is not None:
            check_known_velocities(scene, differences.velocities)
    end, asked = np.asarray(duration, float), with_metrics
    if not isinstance(asked, bool) and not 0 <= float(asked) < float(duration):
        raise InputError(f"with_metrics = {asked}: expected True, False, or a time, s, from 0 to before the end")
    x64 = bool(jax.config.jax_enable_x64)  # type: ignore[attr-defined]
    common = _common(scene, at_start(scene, gaits), options, x64)
    measured = asked if isinstance(asked, bool) else np.asarray(asked, float)
    outcomes = roll_out(common.scene, gaits, end, common.inputs, differences, with_metrics=measured, parts=parts)
    return replace(outcomes, dt=common.dt)  # type: ignore[arg-type]


def at_start(scene: Scene, gaits: Gait) -> Gait:
    """A gait with the first one's rest lengths at t = 0: rigid struts must have them at the start.

    It is the first one where gaits may have begun by then. Else nothing moves yet: its numbers are zeros, the same for
    all populations, but for the frequency of the scene's own gait: the time scale without weights and springs.
    """
    first = one_gait(gaits, 0)
    known = not traced((gaits.start, gaits.ramp))
    if not known or np.any(np.less(gaits.start, 0)) or np.any(np.less_equal(gaits.ramp, 0)):
        return first
    still = jax.tree.map(lambda x: np.zeros(np.shape(x)), first)
    fastest = (gaits if scene.gait is None else scene.gait).frequency.max()
    return replace(still, start=first.start, ramp=first.ramp, frequency=still.frequency + fastest)


class _Common(NamedTuple):
    """The common part of all gaits of a call, and mostly of the next call too."""

    scene: Scene
    inputs: ResolvedOptions
    dt: float | None
    """s"""


@remembered(KEPT)
def _common(scene: Scene, gait: Gait, options: Options, x64: bool) -> _Common:
    """The scene in the precision of its options, the resolved options, and one gait in the place of the call's.

    Its arrays are put on every device once, where possible: that takes longer than a short rollout.
    """
    scene = hold_functions(with_gait(scene, gait))
    resolved = resolve(scene, options=options)
    # copies, since the caller may change the numbers of NumPy's arrays
    cast = lambda x: namespace_of(x).array(x, resolved.dtype)  # noqa: E731
    with evaluated():
        arrays = jax.tree.map(cast, scene), resolved.as_inputs()
        if not traced(arrays) and jax.process_count() == 1 and not resolved.method.implicit:
            everywhere = NamedSharding(Mesh(np.array(jax.devices()), ("population",)), PartitionSpec())
            arrays = jax.tree.map(lambda x: jax.device_put(x, everywhere), arrays)
    return _Common(*arrays, resolved.dt)  # type: ignore[arg-type]


@eqx.filter_jit
@typed
def roll_out(
    scene: Scene,
    gaits: Gait,
    duration: Scalar,
    options: ResolvedOptions,
    differences: Differences | None = None,
    *,
    with_metrics: bool | Scalar = False,
    parts: Parts = 1,
) -> Outcomes:
    """`simulate_population` without checks, of a scene with one of the gaits, for other compiled functions."""
    if with_metrics is not False and (options.dt is None or options.method.implicit):
        raise InputError(f"method = {options.method.name!r}: expected an explicit one at a fixed step, for metrics")
    check_many(gaits)
    size = gaits.phase.shape[0]
    # lineax's linear solve, inside implicit methods, cannot be traced under shard_map
    devices = 1 if options.method.implicit else jax.device_count()
    chunks = -(-size // (devices * most_lanes(scene, options)))
    lanes = -(-size // (devices * chunks))

    def deal(x):
        """(population, ...) to (devices, chunks, ..., lanes), the last row repeated to fill them."""
        # copies fill the last chunk: made-up numbers might need more steps than any robot, and all would wait
        full = jnp.asarray(x, options.dtype)[np.minimum(np.arange(devices * chunks * lanes), size - 1)]
        return jnp.moveaxis(full.reshape(devices, chunks, lanes, *full.shape[1:]), 2, -1)

    def collect(x):
        """(devices, chunks, ..., lanes) back to (population, ...)."""
        return jnp.moveaxis(x, -1, 2).reshape(-1, *x.shape[2:-1])[:size]

    varied, common = eqx.partition((gaits, differences), lambda x: jnp.ndim(x) > 0)
    inputs, fixed = eqx.partition(options, eqx.is_array)

    def share(rows, scene, common, times, inputs):
        def chunk(rows):
            end, since, used = times
            asked = with_metrics if since is None else since, parts if used is None else (parts[0], used.astype(int))
            return roll_out_lanes(scene, *eqx.combine(rows, common), end, eqx.combine(inputs, fixed), *asked)

        # one chunk after the other: each stays in the cache of its core, where all of them would not
        outcomes = jax.lax.map(chunk, jax.tree.map(lambda x: x[0], rows))
        return jax.tree.map(lambda x: x[None], outcomes)

    if devices > 1:
        mesh = Mesh(np.array(jax.devices()), ("population",))
        split, whole = PartitionSpec("population"), PartitionSpec()
        specs = split, whole, whole, whole, whole
        share = jax.shard_map(share, mesh=mesh, in_specs=specs, out_specs=split, check_vma=False)
    common = jax.tree.map(lambda x: jnp.asarray(x, options.dtype), common)
    # an input beside the times, and a float like them until it is used: it is small enough to be exact
    number = parts[1] if isinstance(parts, tuple) else None
    times = (duration, None if isinstance(with_metrics, bool) else with_metrics, number)
    times = jax.tree.map(lambda t: jnp.asarray(t, options.dtype), times)
    outcomes = share(jax.tree.map(deal, varied), scene, common, times, inputs)
    outcomes = jax.tree.map(collect, outcomes)
    if devices > jax.local_device_count():
        # every host gets all outcomes, and goes on as if it had computed them alone
        outcomes = jax.lax.with_sharding_constraint(outcomes, NamedSharding(mesh, PartitionSpec()))
    return Outcomes(**outcomes._asdict(), method=options.method.name, dt=None)

"""Many gaits of one scene in one call: one `vmap`'d vector field inside one `diffeqsolve`, over every device.

The population is the last axis in memory (see `primitives.py`), split into chunks that stay in a core's cache, and the
chunks are split over `jax.devices()`. A robot that fails is marked, and disturbs no other.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxgrity.actuation import Gait, Overtone
from jaxgrity.complementarity import Complementarity
from jaxgrity.dynamics import State, centre_of_mass
from jaxgrity.meter import Meters, nothing, read
from jaxgrity.scene import Scene, as_dtype, with_gait
from jaxgrity.simulate import Settings, as_inputs, discretise, failure_code, integrate, settle, state_failure
from jaxgrity.structure import InputError
from jaxgrity.types import Failures, Path, PerGait, Phases, Scalar, Table, Vectors
from jaxgrity.uncertainty import Differences, differing

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
    positions: Path
    """(population, nodes, 3), where every node is at the end, m"""
    failure: Failures
    """(population,), index into `simulate.FAILURES`; 0: succeeded"""
    steps: Failures
    """(population,), accepted steps"""
    rejected: Failures
    """(population,), steps that an adaptive method tried and gave up"""
    meters: Meters | None
    """of every robot, the actuators' with a row for each, where they were asked for"""
    method: str = eqx.field(static=True)
    dt: float | None = eqx.field(static=True)
    """fixed step, s; None: adaptive, or, inside of compiled functions, an input of theirs"""

    def distance(self) -> PerGait:
        """(population,), horizontal displacement of the centre of mass, m; NaN where the rollout failed."""
        moved = (self.com_end - self.com_start)[:, :2]
        return jnp.where(self.failure == 0, jnp.sqrt(jnp.sum(moved * moved, axis=1)), jnp.nan)


def gaits_of(gait: Gait | None, phase: Phases, amplitude: Table | None = None, frequency: Table | None = None) -> Gait:
    """A population of gaits as one `Gait`, a row of each array a robot; what is not given is `gait`'s own.

    Raises `InputError` where the scene has no gait, the rows have another length than its list of members, or the
    arrays differ in their number of rows.
    """
    if gait is None:
        raise InputError("the scene has no gait; expected a [gait] table to vary")

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
    method: str | None = None,
    dt: float | None = None,
    dtype: str | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    any_step: bool = False,
    sweeps: int | None = None,
    strut_tolerance: float | None = None,
    differences: Differences | None = None,
    metered: bool = False,
) -> Outcomes:
    """Roll the scene out once for each of `gaits` (from `gaits_of`), from the structure's own pose at rest.

    They take the place of the scene's own gait, if it has one, with all that they say: members, start and ramp too.
    The robots may differ in more than their gaits; steps are judged by the scene itself. `metered` adds `Meters` to
    what comes back, and needs an explicit method with a fixed step.
    Fixed steps of an explicit method advance all robots at once; the steps of any other are chosen, or solved for,
    robot by robot. Options and errors are those of `simulate.settle`.
    """
    scene = with_gait(scene, one_gait(gaits, 0))
    settings = settle(scene, duration, method, dt, dtype, rtol, atol, any_step, sweeps, strut_tolerance)
    end = np.asarray(duration, float)
    outcomes = roll_out(as_dtype(scene, settings.dtype), gaits, end, as_inputs(settings), differences, metered)
    return replace(outcomes, dt=settings.dt)  # type: ignore[arg-type]


@eqx.filter_jit
def roll_out(
    scene: Scene,
    gaits: Gait,
    duration: Scalar,
    settings: Settings,
    differences: Differences | None = None,
    metered: bool = False,
) -> Outcomes:
    """`simulate_population` without its checks, of a scene with one of the gaits, for other compiled functions."""
    if metered and (settings.dt is None or settings.method.implicit):
        raise InputError(f"method = {settings.method.name!r}: expected an explicit one at a fixed step, to be metered")
    size = gaits.phase.shape[0]
    # lineax's linear solve, inside implicit methods, cannot be traced under shard_map
    devices = 1 if settings.method.implicit else jax.device_count()
    chunks = -(-size // (devices * most_lanes(scene, settings)))
    lanes = -(-size // (devices * chunks))

    def deal(x):
        """(population, ...) to (devices, chunks, ..., lanes), the last row repeated to fill them."""
        full = jnp.asarray(x, settings.dtype)[np.minimum(np.arange(devices * chunks * lanes), size - 1)]
        return jnp.moveaxis(full.reshape(devices, chunks, lanes, *full.shape[1:]), 2, -1)

    def collect(x):
        """(devices, chunks, ..., lanes) back to (population, ...)."""
        return jnp.moveaxis(x, -1, 2).reshape(-1, *x.shape[2:-1])[:size]

    varied, common = eqx.partition((gaits, differences), lambda x: jnp.ndim(x) > 0)
    inputs, fixed = eqx.partition(settings, eqx.is_array)

    def share(rows, scene, common, end, inputs):
        def chunk(rows):
            return roll_out_lanes(scene, *eqx.combine(rows, common), end, eqx.combine(inputs, fixed), metered)

        outcomes = jax.lax.map(chunk, jax.tree.map(lambda x: x[0], rows))
        return jax.tree.map(lambda x: x[None], outcomes)

    if devices > 1:
        mesh = Mesh(np.array(jax.devices()), ("population",))
        split, whole = PartitionSpec("population"), PartitionSpec()
        specs = split, whole, whole, whole, whole
        share = jax.shard_map(share, mesh=mesh, in_specs=specs, out_specs=split, check_vma=False)
    common = jax.tree.map(lambda x: jnp.asarray(x, settings.dtype), common)
    outcomes = share(jax.tree.map(deal, varied), scene, common, jnp.asarray(duration, settings.dtype), inputs)
    outcomes = jax.tree.map(collect, outcomes)
    if devices > jax.local_device_count():
        # every host gets all outcomes, and goes on as if it had computed them alone
        outcomes = jax.lax.with_sharding_constraint(outcomes, NamedSharding(mesh, PartitionSpec()))
    return Outcomes(*outcomes, settings.method.name, None)  # type: ignore[call-arg]


def most_lanes(scene: Scene, settings: Settings) -> int:
    """How many robots of this size a device integrates side by side: a power of two for a core, all on a GPU."""
    if jax.default_backend() != "cpu":
        return MANY
    members = sum(len(m.edges) for m in (scene.structure.struts, scene.structure.cables) if m is not None)
    bytes_each = 3 * np.dtype(settings.dtype).itemsize * max(members, 1)
    return int(np.clip(2 ** int(np.log2(max(CACHE / bytes_each, 1))), *LANES))


def roll_out_lanes(
    scene: Scene,
    gaits: Gait,
    differences: Differences | None,
    duration: Scalar,
    settings: Settings,
    metered: bool = False,
) -> tuple:
    """The rollouts of one chunk: the arrays of `gaits` and `differences` have lanes last.

    Returns the arrays of `Outcomes`, each with the lanes last.
    """
    lanes = gaits.phase.shape[-1]
    scene, axes = in_lanes(scene, gaits, differences)
    nodes = scene.structure.nodes
    start: State = (nodes, jnp.zeros_like(nodes))
    meters = None
    if metered:
        (q, v), meters, count = _metered(start, duration, scene, axes, settings)
        result, steps = diffrax.RESULTS.successful, [jnp.full(lanes, count), jnp.zeros(lanes, int)]
    elif settings.dt is not None and not settings.method.implicit:
        (q, v), result, steps = _last(start, duration, scene, settings, discretise_lanes(settings, axes))
        steps = [jnp.full(lanes, count) for count in steps]
    else:
        solve = over_lanes(lambda y, s: _last(y, duration, s, settings), (-1, axes))
        (q, v), result, steps = solve(start, scene)
    state = over_lanes(state_failure, (axes, -1, -1))(scene, q, v)
    com = over_lanes(centre_of_mass, (axes, -1))
    return com(scene, nodes), com(scene, q), q, failure_code(result, state), *steps, meters


def _metered(start: State, duration: Scalar, scene: Scene, axes: Scene, settings: Settings):
    """The state at `duration`, all robots' meters, and how many steps were taken, each as long as the others."""
    terms, solver = discretise_lanes(settings, axes)
    count = jnp.ceil(duration / jnp.asarray(settings.dt, settings.dtype) - 1e-3).astype(int)
    h = duration / count
    held = over_lanes(nothing, (axes,))(scene)
    first = solver.init(terms, 0 * h, h, start, scene)
    lanes = lambda tree: jax.tree.map(lambda x: -1 if x.ndim else None, tree)  # noqa: E731
    metering = partial(read, impulsive=isinstance(solver, Complementarity))
    reading = over_lanes(metering, (axes, None, None, -1, -1, lanes(first), lanes(first), -1))

    def step(k, carry):
        y, state, held = carry
        y1, _, _, after, _ = solver.step(terms, k * h, (k + 1) * h, y, scene, state, False)
        return y1, after, reading(scene, k * h, h, y, y1, state, after, held)

    end, _, held = jax.lax.fori_loop(0, count, step, (start, first, held))
    return end, held, count


def _last(start: State, duration: Scalar, scene: Scene, settings: Settings, problem: tuple | None = None):
    """The state at `duration`, diffrax's result, and how many steps were accepted and rejected."""
    times = jnp.stack([jnp.zeros_like(duration), duration])
    solution = integrate(start, times, scene, settings, diffrax.SaveAt(t1=True), problem)
    counts = [solution.stats[f"num_{kind}_steps"] for kind in ("accepted", "rejected")]
    return jax.tree.map(lambda x: x[0], solution.ys), solution.result, counts


def discretise_lanes(settings: Settings, axes: Scene) -> tuple[diffrax.AbstractTerm, diffrax.AbstractSolver]:
    """`simulate.discretise` for a whole chunk, whose scene has these `in_axes`."""

    def lift(function, in_axes):
        return over_lanes(function, tuple(axes if a == "s" else a for a in in_axes))

    return discretise(settings, lift)


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

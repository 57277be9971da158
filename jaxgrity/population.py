"""Many gaits of one scene in one call: one `vmap`'d vector field inside one `diffeqsolve`, over every device.

The population is the last axis in memory (see `primitives.py`), split into chunks that stay in a core's cache, and the
chunks are split over `jax.devices()`. A robot that fails is marked, and disturbs no other.
"""

from collections.abc import Callable

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxgrity.actuation import Gait
from jaxgrity.dynamics import State, centre_of_mass
from jaxgrity.scene import Scene, as_dtype, with_gait
from jaxgrity.simulate import Settings, discretise, failure_code, integrate, settle, state_failure
from jaxgrity.structure import InputError
from jaxgrity.types import Failures, Path, PerGait, Phases, Scalar, Table, Vectors

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
    method: str = eqx.field(static=True)
    dt: float | None = eqx.field(static=True)
    """fixed step, s; None: adaptive"""

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
    return Gait(
        gait.members, phase, rows(amplitude, gait.amplitude), rows(frequency, gait.frequency), gait.start, gait.ramp
    )


def one_gait(gaits: Gait, k: int) -> Gait:
    """Gait number `k` of a population."""
    phase, amplitude, frequency = (x[k] for x in (gaits.phase, gaits.amplitude, gaits.frequency))
    return Gait(gaits.members, phase, amplitude, frequency, gaits.start, gaits.ramp)


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
) -> Outcomes:
    """Roll the scene out once for each of `gaits` (from `gaits_of`), from the structure's own pose at rest.

    They take the place of the scene's own gait, if it has one, with all that they say: members, start and ramp too.
    Fixed steps of an explicit method advance all robots at once; the steps of any other are chosen, or solved for,
    robot by robot. Options and errors are those of `simulate.settle`.
    """
    scene = with_gait(scene, one_gait(gaits, 0))
    settings = settle(scene, duration, method, dt, dtype, rtol, atol, any_step, sweeps, strut_tolerance)
    return roll_out(as_dtype(scene, settings.dtype), gaits, np.asarray(duration, float), settings)


@eqx.filter_jit
def roll_out(scene: Scene, gaits: Gait, duration: Scalar, settings: Settings) -> Outcomes:
    """`simulate_population` without its checks, of a scene with one of the gaits, for other compiled functions."""
    size = gaits.phase.shape[0]
    # lineax's linear solve, inside implicit methods, cannot be traced under shard_map
    devices = 1 if settings.method.implicit else jax.device_count()
    chunks = -(-size // (devices * most_lanes(scene, settings)))
    lanes = -(-size // (devices * chunks))

    def deal(x):
        """(population, k) to (devices, chunks, k, lanes), the last row repeated to fill them."""
        full = jnp.asarray(x, settings.dtype)[np.minimum(np.arange(devices * chunks * lanes), size - 1)]
        return full.reshape(devices, chunks, lanes, -1).swapaxes(2, 3)

    def collect(x):
        """(devices, chunks, ..., lanes) back to (population, ...)."""
        return jnp.moveaxis(x, -1, 2).reshape(-1, *x.shape[2:-1])[:size]

    def share(rows, scene, end):
        outcomes = jax.lax.map(lambda r: roll_out_lanes(scene, *r, end, settings), [x[0] for x in rows])
        return jax.tree.map(lambda x: x[None], outcomes)

    if devices > 1:
        mesh = Mesh(np.array(jax.devices()), ("population",))
        split, whole = PartitionSpec("population"), PartitionSpec()
        share = jax.shard_map(share, mesh=mesh, in_specs=(split, whole, whole), out_specs=split, check_vma=False)
    rows = [deal(x) for x in (gaits.phase, gaits.amplitude, gaits.frequency)]
    outcomes = share(rows, scene, jnp.asarray(duration, settings.dtype))
    outcomes = [collect(x) for x in outcomes]
    if devices > jax.local_device_count():
        # every host gets all outcomes, and goes on as if it had computed them alone
        outcomes = jax.lax.with_sharding_constraint(outcomes, NamedSharding(mesh, PartitionSpec()))
    com_start, com_end, positions, failure, accepted, rejected = outcomes
    name, dt = settings.method.name, settings.dt
    return Outcomes(com_start, com_end, positions, failure, accepted, rejected, name, dt)


def most_lanes(scene: Scene, settings: Settings) -> int:
    """How many robots of this size a device integrates side by side: a power of two for a core, all on a GPU."""
    if jax.default_backend() != "cpu":
        return MANY
    members = sum(len(m.edges) for m in (scene.structure.struts, scene.structure.cables) if m is not None)
    bytes_each = 3 * np.dtype(settings.dtype).itemsize * max(members, 1)
    return int(np.clip(2 ** int(np.log2(max(CACHE / bytes_each, 1))), *LANES))


def roll_out_lanes(scene: Scene, phase, amplitude, frequency, duration, settings: Settings) -> tuple:
    """The rollouts of one chunk: `phase`, `amplitude`, `frequency` are (actuators, lanes).

    Returns the arrays of `Outcomes`, each with the lanes last.
    """
    scene, axes = in_lanes(scene, phase, amplitude, frequency)
    nodes = scene.structure.nodes
    start: State = (nodes, jnp.zeros_like(nodes))
    if settings.dt is not None and not settings.method.implicit:
        (q, v), result, steps = _last(start, duration, scene, settings, discretise_lanes(settings, axes))
        steps = [jnp.full(phase.shape[-1], count) for count in steps]
    else:
        solve = over_lanes(lambda y, s: _last(y, duration, s, settings), (-1, axes))
        (q, v), result, steps = solve(start, scene)
    state = over_lanes(state_failure, (axes, -1, -1))(scene, q, v)
    com = over_lanes(centre_of_mass, (axes, -1))
    return com(scene, nodes), com(scene, q), q, failure_code(result, state), *steps


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


def in_lanes(scene: Scene, phase, amplitude, frequency) -> tuple[Scene, Scene]:
    """The scene with a last axis of lanes on every array but scalars, and the `in_axes` that say so.

    Where some arrays had the axis and others not, JAX's rules for elementwise operations would move it to the front.
    """
    lanes = phase.shape[-1]
    spread = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None], (*x.shape, lanes)) if x.ndim else x, scene)
    varied = lambda s: (s.gait.phase, s.gait.amplitude, s.gait.frequency)  # noqa: E731
    spread = eqx.tree_at(varied, spread, (phase, amplitude, frequency))
    return spread, jax.tree.map(lambda x: -1 if x.ndim else None, spread)

"""One rollout of one scene, by any method."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.complementarity import Complementarity, check_start
from jaxgrity.dynamics import State, vector_field
from jaxgrity.methods import Method, find_method
from jaxgrity.primitives import edge_vectors, length
from jaxgrity.scene import Scene, as_dtype
from jaxgrity.stability import check_step, default_method, default_step
from jaxgrity.structure import InputError
from jaxgrity.types import NodeVectors, Path, Scalar, Times

FAILURES = (
    "succeeded",
    "the motion is not finite, or misses its constraints",
    "the structure was torn apart",
    "the most steps allowed were taken",
    "an implicit step did not converge",
    "the step became too small",
)
TORN = 10.0
"""a member this many times as long as it was built shows a motion that has blown up, finite or not"""


MOST_SWEEPS = 1000
"""of complementarity stepping in one step, where a tolerance is asked for"""


class Trajectory(eqx.Module):
    """A motion: where every node was at each saved time, how it was computed, and whether it can be believed."""

    times: Times
    """(frames,), s"""
    positions: Path
    """(frames, nodes, 3), m"""
    velocities: Path
    """(frames, nodes, 3), m/s; of complementarity stepping those in the middle of the step before each frame"""
    failure: jax.Array
    """index into `FAILURES`; 0: succeeded"""
    steps: jax.Array
    """accepted steps"""
    rejected: jax.Array
    """steps that an adaptive method tried and gave up"""
    method: str = eqx.field(static=True)
    dt: float | None = eqx.field(static=True)
    """fixed step, s; None: adaptive"""

    @property
    def failed(self) -> bool:
        return bool(self.failure != 0)


def centre_path(scene: Scene, trajectory: Trajectory) -> np.ndarray:
    """(frames, 3), the centre of mass along a trajectory, m."""
    mass = np.asarray(scene.structure.node_mass, float)
    return np.einsum("n,fnk->fk", mass / mass.sum(), np.asarray(trajectory.positions, float))


class Settings(eqx.Module):
    """How to integrate, settled: what `settle` makes of the options a user gives."""

    method: Method = eqx.field(static=True)
    dt: Scalar | None
    dtype: str = eqx.field(static=True)
    rtol: Scalar
    atol: Scalar
    sweeps: int | None = eqx.field(static=True, default=None)
    strut_tolerance: float | None = eqx.field(static=True, default=None)
    max_steps: int = eqx.field(static=True, default=10**6)


def as_inputs(settings: Settings) -> Settings:
    """The settings with step and tolerances as arrays, with which a function is compiled once for all their values.

    As numbers they are part of the compiled program; reverse mode, which has to count the steps, needs them so.
    """
    return jax.tree.map(lambda x: np.asarray(x, float), settings)


def settle(
    scene: Scene,
    duration: float,
    method: str | None = None,
    dt: float | None = None,
    dtype: str | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    any_step: bool = False,
    sweeps: int | None = None,
    strut_tolerance: float | None = None,
    positions: NodeVectors | None = None,
    max_steps: int = 10**6,
) -> Settings:
    """Choose what was left open, and refuse what cannot work, before anything compiles.

    Without `method` the scene decides; without `dt` an adaptive method adapts its step to `rtol` and `atol` (1e-8, or
    1e-5 in float32, where not given), any other takes `default_step`. `any_step` lets a step pass that would blow up.
    Complementarity stepping couples its constraints by a number of `sweeps`, or by as many as bring every strut within
    `strut_tolerance` (m) of its length; a robot for which `sweeps` (1000, where not given) do not suffice then fails.
    `positions` (m) are where the motion starts, if not at the structure's own. An adaptive method gives up, and the
    rollout fails, after `max_steps`.

    Raises `InputError`: unknown method; duration, step or tolerance that is not positive and finite; a step too large
    for the scene; a method that cannot meet the scene's constraints; a start that violates them; the symplectic method
    where something dissipates; sweeps or their tolerance for any other method; a tolerance below what the precision
    allows; float64 while JAX's x64 mode is off.
    """
    chosen = find_method(method) if method is not None else default_method(scene)
    for name, value in (("duration", duration), ("dt", dt), ("rtol", rtol), ("atol", atol)):
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise InputError(f"{name} = {value}: expected a positive, finite number")
    dtype = dtype or str(jnp.zeros(()).dtype)
    if dtype not in ("float32", "float64"):
        raise InputError(f"dtype = {dtype!r}: expected 'float32' or 'float64'")
    if rtol is not None and rtol < 10 * np.finfo(dtype).eps:
        raise InputError(f"rtol = {rtol:g}: {dtype} cannot meet it; expected at least {10 * np.finfo(dtype).eps:.1g}")
    if (rtol is not None or atol is not None) and (dt is not None or not chosen.adaptive):
        raise InputError(f"rtol, atol: {chosen.name!r} at a fixed step has no tolerances; expected none, or no dt")
    usual = 1e-8 if dtype == "float64" else 1e-5
    rtol, atol = (usual if x is None else x for x in (rtol, atol))
    if scene.constrained and not chosen.constrained:
        raise InputError(
            f"method = {chosen.name!r}: this scene has rigid struts or exact contact; expected 'complementarity'"
        )
    if chosen.symplectic and scene.dissipates:
        raise InputError(
            "method = 'symplectic' integrates scenes without dissipation; this one has damping or friction"
        )
    if dtype == "float64" and not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise InputError("dtype = 'float64' needs jax.config.update(\"jax_enable_x64\", True) first")
    if (sweeps is not None or strut_tolerance is not None) and not chosen.constrained:
        raise InputError(f"sweeps, strut_tolerance: only complementarity stepping has them, not {chosen.name!r}")
    if sweeps is not None and sweeps < 1:
        raise InputError(f"sweeps = {sweeps}: expected at least 1")
    if strut_tolerance is not None:
        finest = 100 * float(np.finfo(dtype).eps)
        if not strut_tolerance >= finest:
            raise InputError(f"strut_tolerance = {strut_tolerance:g} m: expected at least {finest:.1g} m in {dtype}")
        sweeps = MOST_SWEEPS if sweeps is None else sweeps
    concrete = not any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(scene))
    if dt is None and not chosen.adaptive:
        dt = default_step(scene, chosen)
    elif dt is not None and not any_step and concrete:
        check_step(scene, chosen, dt)
    if concrete and scene.constrained and not isinstance(positions, jax.core.Tracer):
        check_start(scene, np.asarray(scene.structure.nodes if positions is None else positions, float))
    # no NumPy numbers: those are inputs
    dt, rtol, atol = jax.tree.map(float, (dt, rtol, atol))
    return Settings(chosen, dt, dtype, rtol, atol, sweeps, strut_tolerance, max_steps)


def simulate(
    scene: Scene,
    duration: float,
    *,
    method: str | None = None,
    dt: float | None = None,
    dtype: str | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    frame_rate: float = 100.0,
    max_steps: int = 10**6,
    positions: NodeVectors | None = None,
    velocities: NodeVectors | None = None,
    any_step: bool = False,
    sweeps: int | None = None,
    strut_tolerance: float | None = None,
) -> Trajectory:
    """Integrate the scene's equations of motion over `duration` (s) and save `frame_rate` frames a second.

    The motion starts from `positions` (m; the structure's own where not given) and `velocities` (m/s; at rest). The
    other options are those of `settle`, which raises `InputError` on bad ones. A motion that fails is returned with
    its failure code.
    """
    settings = settle(
        scene, duration, method, dt, dtype, rtol, atol, any_step, sweeps, strut_tolerance, positions, max_steps
    )
    q = scene.structure.nodes if positions is None else positions
    v = np.zeros(q.shape) if velocities is None else velocities
    times = np.linspace(0, duration, max(1, round(duration * frame_rate)) + 1)
    trajectory = _simulate(as_dtype(scene, settings.dtype), (q, v), times, as_inputs(settings))
    return replace(trajectory, dt=settings.dt)  # type: ignore[arg-type]


@eqx.filter_jit
def _simulate(scene: Scene, start: State, times: Times, settings: Settings) -> Trajectory:
    times = jnp.asarray(times, settings.dtype)
    start = jax.tree.map(lambda x: jnp.asarray(x, settings.dtype), start)
    solution = integrate(start, times, scene, settings)
    q, v = solution.ys  # type: ignore[misc]
    stats = solution.stats
    return Trajectory(
        times=times,
        positions=q,
        velocities=v,
        failure=failure_code(solution.result, state_failure(scene, q[-1], v[-1])),
        steps=stats["num_accepted_steps"],
        rejected=stats["num_rejected_steps"],
        method=settings.method.name,
        dt=None,  # an input here, which `simulate` knows
    )


def refinements(settings: Settings) -> list[dict[str, Any]]:
    """Options of `simulate` at the settings' step, its half and its quarter; or at their tolerances, a tenth and a
    hundredth of them."""
    name, dt = settings.method.name, settings.dt
    if dt is not None:
        return [{"method": name, "dt": dt / 2**k} for k in range(3)]
    tightest = 10 * float(np.finfo("float64").eps)
    return [
        {"method": name, "rtol": max(tightest, settings.rtol / 10**k), "atol": settings.atol / 10**k} for k in range(3)
    ]


def discretise(
    settings: Settings, lift: Callable = lambda function, in_axes: function
) -> tuple[diffrax.AbstractTerm, diffrax.AbstractSolver]:
    """The equations of motion and the solver for them, as diffrax takes them.

    `lift(function, in_axes)` maps the functions over a population; in `in_axes` the letter "s" stands for the scene's.
    """
    method = settings.method
    solver = method.step() if settings.dt is not None or method.adapt is None else method.adapt()
    if isinstance(solver, Complementarity):
        axes = {
            "prepare": ("s", None, None, -1, -1),
            "sweep": ("s", None, -1, -1, -1),
            "length_error": ("s", None, -1, -1),
        }
        lifted = {name: lift(getattr(solver, name), in_axes) for name, in_axes in axes.items()}
        solver = Complementarity(settings.sweeps, settings.strut_tolerance, **lifted)
    # jit, so that it is traced once for all its uses in a step
    return diffrax.ODETerm(jax.jit(lift(vector_field, (None, -1, "s")))), solver


def integrate(
    start: tuple,
    times: Times,
    scene: Scene,
    settings: Settings,
    saveat: diffrax.SaveAt | None = None,
    problem: tuple[diffrax.AbstractTerm, diffrax.AbstractSolver] | None = None,
) -> diffrax.Solution:
    """`diffeqsolve` from the first of `times` to the last, saved at all of them unless `saveat` says else.

    `problem` is what `discretise` makes of the settings, for one robot and `start` = (q, v), where not given. It can be
    traced, and differentiated in forward mode.
    """
    terms, solver = discretise(settings) if problem is None else problem
    fixed = settings.dt is not None
    smallest = 16 * jnp.finfo(times.dtype).eps * times[-1]
    dt0, rtol, atol = jax.tree.map(lambda x: jnp.asarray(x, times.dtype), (settings.dt, settings.rtol, settings.atol))
    adaptive = diffrax.PIDController(rtol=rtol, atol=atol, dtmin=smallest, force_dtmin=False)
    controller = diffrax.ConstantStepSize() if fixed else adaptive
    return diffrax.diffeqsolve(
        terms,
        solver,
        times[0],
        times[-1],
        dt0,
        start,
        scene,
        saveat=diffrax.SaveAt(ts=jnp.asarray(times)) if saveat is None else saveat,
        stepsize_controller=controller,
        adjoint=diffrax.ForwardMode(),
        max_steps=None if fixed else settings.max_steps,
        throw=False,
    )


def failure_code(result, state_failure):
    """Index into `FAILURES`, from diffrax's result and what `state_failure` says of the last state."""
    results = diffrax.RESULTS
    code = jnp.where(result == results.successful, state_failure, 4)
    code = jnp.where(result == results.max_steps_reached, 3, code)
    return jnp.where(result == results.dt_min_reached, 5, code)


def state_failure(scene: Scene, q: NodeVectors, v: NodeVectors):
    """1 where the state is not finite, 2 where a member is `TORN` times as long as it was built, else 0."""
    finite = jnp.all(jnp.isfinite(q)) & jnp.all(jnp.isfinite(v))
    torn = jnp.zeros((), bool)
    for members in (scene.structure.struts, scene.structure.cables):
        if members is not None:
            built = length(edge_vectors(scene.structure.nodes, members.edges))
            torn |= jnp.any(length(edge_vectors(q, members.edges)) > TORN * built)
    return jnp.where(finite, jnp.where(torn, 2, 0), 1)

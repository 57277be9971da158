"""Integration by diffrax, and the failure codes of rollouts.

`discretise` puts the equations of motion and the solver of a method together, and `integrate` runs them.
"""

import dataclasses
from typing import Any

import diffrax
import jax
import jax.numpy as jnp

from jaxgrity.core.primitives import edge_vectors, length
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeVectors, Scalar, Times, namespace_of
from jaxgrity.model.clusters import added_up
from jaxgrity.model.inertia import with_mobility
from jaxgrity.model.laws import Law
from jaxgrity.model.motors import bends_of
from jaxgrity.model.scene import Scene, with_scales
from jaxgrity.stepping.complementarity import Lift, one_robot
from jaxgrity.stepping.dynamics import vector_field
from jaxgrity.stepping.loop import carried_at
from jaxgrity.stepping.options import ResolvedOptions
from jaxgrity.stepping.rigid_multipliers import vector_field_with_multipliers

FAILURES = (
    "succeeded",
    "the motion is not finite, or misses its constraints",
    "the structure was torn apart",
    "the most steps allowed were taken",
    "an implicit step did not converge",
    "the step became too small",
    "the start lies below the ground, has struts in each other, or rigid struts of other lengths",
)
"""What became of a rollout, by its failure code."""
TORN = 10.0
"""Length of a member, as a multiple of its length as built, at which a motion has blown up, finite or not. Cables that
somebody would build break far below it; a step that is unstable passes it within some steps."""


@typed
def discretise(options: ResolvedOptions, lift: Lift = one_robot) -> tuple[diffrax.AbstractTerm, diffrax.AbstractSolver]:
    """The equations of motion and their solver, for diffrax, for one robot or, by `lift`, for many."""
    method = options.method
    build = method.fixed if options.dt is not None or method.adaptive is None else method.adaptive
    if options.coupled and method.coupled is not None:
        build = method.coupled
    solver = build()
    if method.constrained:
        chosen: dict = {"tolerance": options.strut_tolerance, "lift": lift}
        if hasattr(solver, "sweeps"):
            chosen["sweeps"] = options.sweeps
        solver = dataclasses.replace(solver, **chosen)  # type: ignore[type-var]
    # jit, so that it is traced once for all its uses in a step
    field = vector_field if method.constrained else vector_field_with_multipliers
    # one time for all robots, states in the last axis, and the scene's own axes (`Lift`)
    return diffrax.ODETerm(jax.jit(lift(field, (None, -1, "s")))), solver


@typed
def integrate(
    start: tuple,
    times: Times,
    scene: Scene,
    options: ResolvedOptions,
    saveat: diffrax.SaveAt | None = None,
    scheme: tuple[diffrax.AbstractTerm, diffrax.AbstractSolver] | None = None,
    part: tuple[diffrax.AbstractStepSizeController, Any] | None = None,
) -> diffrax.Solution:
    """`diffeqsolve` from the first of `times` (s) to the last, saved at all of them, or by `saveat`.

    The solution can be traced, and differentiated in forward mode. `scheme` is by default that of `discretise`, for
    one robot and `start` = (q, v). Velocities are those of the method's carry (`frame_velocities.py`). `part` continues
    a motion: by its steps, from `start` and the memory that the method carries (`pieces.py`).
    """
    terms, solver = discretise(options) if scheme is None else scheme
    scene, memory = with_scales_and_mobility(scene), None
    fixed = options.dt is not None
    smallest = 16 * jnp.finfo(times.dtype).eps * times[-1]
    dt0, rtol, atol = jax.tree.map(lambda x: jnp.asarray(x, times.dtype), (options.dt, options.rtol, options.atol))
    adaptive: Any = diffrax.PIDController(rtol=rtol, atol=atol, dtmin=smallest, force_dtmin=False)
    if not fixed and (bends := _bends(scene)):  # lanes, at fixed steps, may have bends of their own
        # an error estimate sees nothing of a push that lies between two of its stages
        adaptive = diffrax.ClipStepSizeController(adaptive, step_ts=jnp.sort(jnp.concatenate(bends)))
    controller = diffrax.ConstantStepSize() if fixed else adaptive
    if part is not None:
        controller, memory = part
    elif options.method.constrained:
        dt0 = even_step(dt0, times[-1] - times[0])
        start, memory = carried_at((terms, solver), scene, times[0], dt0, start)
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
        solver_state=memory,
        adjoint=diffrax.ForwardMode(),
        max_steps=None if fixed else options.max_steps,
        throw=False,
    )


def even_step(dt: Scalar, duration: Scalar) -> Scalar:
    """s: the longest step, up to `dt`, that divides the duration."""
    xp, ratio = namespace_of(duration), duration / dt
    # relative, since so is rounding: 0.3/0.005 is more than 60 in float32
    count = xp.maximum(xp.ceil(ratio * (1 - 1e-6)), 1)
    return xp.where(abs(ratio - count) <= 1e-6 * count, dt, duration / count)


def _bends(scene: Scene) -> list[AnyArray]:
    """s: when laws, motors and supports begin, end, or bend otherwise."""
    found = [term.bends() for term in scene.terms if type(term).bends is not Law.bends]
    for members in scene.structure.members:
        found += [bends_of(motor, members.rest_length[motor.member]) for motor in members.motors]
    return found if scene.shaking is None else [*found, scene.shaking.bends()]


def with_scales_and_mobility(scene: Scene) -> Scene:
    """The scene with everything computed once for all steps: its scales, and the nodes' mobility where it is not
    1/m_i."""
    scene = with_scales(scene)
    if not scene.structure.needs_mobility or scene.structure.mobility is not None:
        return scene
    return dataclasses.replace(scene, structure=with_mobility(scene.structure))


def failure_code(result, of_state):
    """Index into `FAILURES`, from diffrax's result and the last state's `state_failure`."""
    results = diffrax.RESULTS
    code = jnp.where(result == results.successful, of_state, 4)
    code = jnp.where(result == results.max_steps_reached, 3, code)
    return jnp.where(result == results.dt_min_reached, 5, code)


def state_failure(scene: Scene, q: NodeVectors, v: NodeVectors):
    """1 where the state is not finite, 2 where a member is `TORN` times its built length, else 0.

    A cable that runs over several nodes counts as a whole: it slides there, so that a segment may grow without strain.
    """
    finite = jnp.all(jnp.isfinite(q)) & jnp.all(jnp.isfinite(v))
    torn = jnp.zeros((), bool)
    for members in scene.structure.members:
        built, now = (
            added_up(length(edge_vectors(x, members.edges)), members.clusters) for x in (scene.structure.nodes, q)
        )
        torn |= jnp.any(now > TORN * built)
    return jnp.where(finite, jnp.where(torn, 2, 0), 1)

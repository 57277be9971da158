"""The balance of energy and momentum along a simulation."""

import math
import warnings
from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import Count, NodeHistory, NodeVectors, Scalar, Times
from jaxgrity.model.inertia import energy_of_motion
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import Scene, as_dtype, start_of
from jaxgrity.model.shaking import with_supports
from jaxgrity.stepping.complementarity import CoupledState
from jaxgrity.stepping.discretisation import FAILURES, discretise, integrate, state_failure, with_scales_and_mobility
from jaxgrity.stepping.dynamics import angular_momentum, momentum
from jaxgrity.stepping.loop import Step, carried_at, numbered
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve
from jaxgrity.stepping.power import Work, powers, step_work
from jaxgrity.stepping.rigid_multipliers import rigid_forces, vector_field_with_multipliers
from jaxgrity.stepping.simulate import frame_times, with_room

BESIDE = 1e-9
"""Time from a frame to the moments just before and after it, at which the gait is evaluated, s for a body of one
metre."""


class Amounts(NamedTuple):
    """Energies and momenta in every frame."""

    times: Times
    positions: NodeHistory
    kinetic: Times
    potential: Times
    momentum: NodeVectors
    """(frames, 3), N s"""
    angular_momentum: NodeVectors
    """(frames, 3), N m s"""
    failure: jax.Array | np.ndarray
    """(frames,), index into `FAILURES`, 0 before the motion fails"""


class EnergyAudit(NamedTuple):
    """Energy balance in every frame, J: change of energy = work of the actuators - dissipated energy."""

    times: Times
    """(frames,), s; for complementarity stepping, the middle of the step before each frame"""
    positions: NodeHistory
    """(frames, nodes, 3), m"""
    kinetic: Times
    """(frames,), kinetic energy T"""
    potential: Times
    """(frames,), potential energy U of members, gravity and penalty contact"""
    actuation: Times
    """(frames,), work of the actuators: the integral of dU/dt at fixed q, and of -T dL/dt for rigid struts"""
    dissipated: dict[str, Times]
    """(frames,) by cause: the integral of v·dR/dv, or of -v·F_switch for the Coulomb switch. Losses of exact contact
    come from its impulses. "stepping" is the loss of the scheme itself, at rigid struts and on curved ground"""
    momentum_residual: Times
    """(frames,), |change of momentum - impulse of external forces|, N s"""
    angular_residual: Times
    """(frames,), |change of angular momentum - impulse of external moments| about the origin, N m s"""
    constraint_residual: float = 0.0
    """largest difference between velocities and those that the impulses give in any step, m/s"""

    @property
    def residual(self) -> Times:
        """(frames,), residual of the balance, J: an error of the time steps."""
        energy = self.kinetic + self.potential
        return energy - energy[0] - self.actuation + self.lost

    @property
    def lost(self) -> Times:
        """(frames,), all dissipated energy, J."""
        return sum(self.dissipated.values(), np.zeros_like(self.times))

    @property
    def turned_over(self) -> float:
        """Largest change of any part of the balance, J; compare the residual with it."""
        return float(max(np.ptp(x) for x in (self.kinetic, self.potential, self.actuation, self.lost)))


@typed
def energy_audit(scene: Scene, duration: float, *, options: Options = None, frame_rate: float = 100.0) -> EnergyAudit:
    """Simulate a scene in float64, and balance its energy and momentum.

    dE/dt = dU/dt - v·dR/dv + v·F_switch, and dp/dt is the sum of the external forces; angular momentum changes by
    their moments. The method integrates these equations together with those of motion. Symplectic methods and
    complementarity stepping sum the works step by step instead: forces and impulses times the mean velocity of the
    step. Their steps are shortened to fit the frames. If the motion fails, a warning says how, and until when the
    numbers are valid.

    Args:
        scene: the scene to simulate.
        duration: simulated time, s.
        options: solver options; by default the scene decides. The precision is float64 in any case.
        frame_rate: frames of the balance per second.

    Returns:
        Energies (J), works (J) and residuals of momentum, a number for each frame.

    Raises:
        InputError: bad options (see `resolve`), or a frame rate that is not positive and finite.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> audit = jaxgrity.energy_audit(scene, 0.2)
        >>> bool(abs(audit.residual).max() < 1e-3 * audit.turned_over)
        True
    """
    refuse_traced((scene, duration), "energy_audit")
    resolved = resolve(scene, duration, options, dtype="float64")
    times = frame_times(duration, frame_rate, at_most=math.inf if resolved.dt is None else 1 / float(resolved.dt))
    exact, saved = as_dtype(scene, "float64"), with_room(times, len(scene.structure.nodes))
    if resolved.method.symplectic or resolved.method.constrained:
        count = int(np.ceil(times[1] / resolved.dt - 1e-9))  # type: ignore[operator]
        counts = np.asarray(count), np.asarray(len(times))
        amounts, work, missed = _step_by_step(exact, saved, resolved.as_inputs(), counts)
    else:
        (amounts, work), missed = _beside(exact, saved, resolved.as_inputs()), jnp.zeros(())
    amounts, work = jax.tree.map(lambda x: np.asarray(x)[: len(times)], (amounts, work))
    _warn_of_failure(amounts)
    actuation, impulse, moment = (work.pop(name) for name in ("actuation", "impulse", "moment"))
    return EnergyAudit(
        times=amounts.times,
        positions=amounts.positions,
        kinetic=amounts.kinetic,
        potential=amounts.potential,
        actuation=actuation,
        dissipated=work,
        momentum_residual=_residual(amounts.momentum, impulse),
        angular_residual=_residual(amounts.angular_momentum, moment),
        constraint_residual=float(missed),
    )


def _warn_of_failure(found: Amounts) -> None:
    """Say in a line that the motion fails, since nothing else in the balance does."""
    if found.failure.any():
        first = int(np.argmax(found.failure > 0))
        why, when = FAILURES[found.failure[first]], f"{found.times[first]:.3g} s"
        warnings.warn(f"energy_audit: {why} at {when}; numbers from then on mean nothing", stacklevel=4)


def _residual(momenta: np.ndarray, gained: np.ndarray) -> Times:
    with np.errstate(over="ignore", invalid="ignore"):  # of a motion that failed
        return np.linalg.norm(momenta - momenta[0] - gained, axis=1)


@eqx.filter_jit
def _beside(scene: Scene, times: Times, options: ResolvedOptions) -> tuple[Amounts, Work]:
    """With the works as further equations beside those of motion."""
    start = start_of(scene)

    def field(t, y, scene):
        q, v = y[0][0], with_supports(scene.shaking, scene.structure, t, y[0][1])
        return vector_field_with_multipliers(t, y[0], scene), powers(scene, t, q, v, rigid_forces(scene, t, (q, v)))

    nothing = jax.tree.map(jnp.zeros_like, powers(scene, 0.0, *start))
    _, solver = discretise(options)
    # as equations of the same method, the works have its order; a sum over frames would not
    scheme = (diffrax.ODETerm(field), solver)
    (q, v), work = integrate((start, nothing), jnp.asarray(times), scene, options, scheme=scheme).ys  # type: ignore[misc]
    if options.dt is not None:
        work["actuation"] += _one_sided(scene, jnp.asarray(times), q, solver.tableau, options.dt)  # type: ignore[attr-defined]
    return _amounts(scene, jnp.asarray(times), q, v), work


def _one_sided(scene: Scene, times: Times, q: NodeHistory, tableau: diffrax.ButcherTableau, h: Scalar) -> Times:
    """(frames,), J: what the work of actuators lacks where a gait's ramp begins or ends in a frame.

    There dU/dt jumps. The stage at the end of the step before the frame should see its value before the jump, and the
    stage at the beginning of the step after it the value after; both see the value in between. Over both steps this
    cancels, but not in between, nor where the motion begins with a jump.
    """

    beside = BESIDE * time_scale(scene)

    def off(t, q, side):
        power = jax.grad(scene.potential_energy, argnums=1)
        return power(q, t + side * beside) - power(q, t)

    c, b = np.concatenate([[0.0], tableau.c]), np.asarray(tableau.b_sol)
    before = h * b[c == 1].sum() * jax.vmap(lambda t, q: off(t, q, -1))(times, q)
    after = h * b[c == 0].sum() * off(times[0], q[0], 1)
    return jnp.where(jnp.arange(len(times)) > 0, before + after, 0.0)


def _amounts(scene: Scene, times: Times, q: NodeHistory, v: NodeHistory) -> Amounts:
    return Amounts(
        times=times,
        positions=q,
        kinetic=jnp.asarray(jax.vmap(lambda v: energy_of_motion(scene.structure, v))(v)),
        potential=jnp.asarray(jax.vmap(scene.potential_energy)(q, times)),
        momentum=jax.vmap(lambda v: momentum(scene, v))(v),
        angular_momentum=jax.vmap(lambda q, v: angular_momentum(scene, q, v))(q, v),
        failure=jax.vmap(lambda q, v: state_failure(scene, q, v))(q, v),
    )


@eqx.filter_jit
def _step_by_step(
    scene: Scene, times: Times, options: ResolvedOptions, counts: tuple[Count, Count]
) -> tuple[Amounts, Work, jax.Array]:
    """Works summed up step by step, and the largest residual of any step.

    `counts` are the steps from one frame to the next, and the frames; `times` has room for more of these.
    """
    count, frames = counts
    scene = with_scales_and_mobility(scene)
    scheme = discretise(options)
    h = jnp.asarray(times[1] / count)
    first, step = carried_at(scheme, scene, 0 * h, h, start_of(scene)), numbered(scheme, scene, h)

    def booked_step(k, carry):
        before, work, missed = carry
        after = step(before, k)
        gained = step_work(scene, Step(k * h, h, before, after))
        if isinstance(after.memory, CoupledState):
            missed = jnp.maximum(missed, after.memory.residual)
        return after, jax.tree.map(jnp.add, work, gained), missed

    def frame(number, held):
        carry, rows = held
        # a loop in a loop: memory holds the frames, not every step
        carry = jax.lax.fori_loop(number * count, (number + 1) * count, booked_step, carry)
        return carry, jax.tree.map(lambda all_of, x: all_of.at[number + 1].set(x), rows, (carry[0].motion, carry[1]))

    still = Step(0 * h, h, first, first)
    nothing = jax.tree.map(jnp.zeros_like, step_work(scene, still))
    rows = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(times), *jnp.shape(x))), (first.motion, nothing))
    start = (first, nothing, jnp.zeros_like(h))
    (*_, missed), ((path, speeds), work) = jax.lax.fori_loop(0, frames - 1, frame, (start, rows))
    # impulsive velocities are those of the middle of a step: positions and times go back to there, so that T and U are
    # of the same moment
    back = jnp.where(jnp.arange(len(times)) > 0, h / 2, 0) if still.impulsive else 0 * times
    path = path - back[:, None, None] * speeds
    return _amounts(scene, jnp.asarray(times) - back, path, speeds), work, missed

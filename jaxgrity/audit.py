"""Where the energy and the momentum of a rollout come from, and where they go."""

from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.complementarity import Complementarity
from jaxgrity.dynamics import (
    State,
    acceleration,
    angular_momentum,
    kinetic_energy,
    momentum,
    pressing_force,
    smooth_force,
    switched_friction,
    vector_field,
)
from jaxgrity.friction import SwitchFriction
from jaxgrity.primitives import along, dot, inner, scale
from jaxgrity.scene import Scene, as_dtype
from jaxgrity.simulate import Settings, as_inputs, discretise, integrate, settle
from jaxgrity.types import NodeVectors, Path, Scalar, Times

Work = dict[str, jax.Array]
"""J of the actuators and of each cause of dissipation; N s and N m s, (3,), of the forces from outside"""


class EnergyAudit(NamedTuple):
    """Change of energy = actuation work - dissipation, each integrated beside the motion, at every frame, in J."""

    times: Times
    """(frames,), s; of complementarity stepping the middle of the step before each frame, where its velocities are"""
    positions: Path
    """(frames, nodes, 3), m"""
    kinetic: Times
    """(frames,), T"""
    potential: Times
    """(frames,), U: members, gravity and penalty contact"""
    actuation: Times
    """(frames,), work done by the actuators: the integral of dU/dt at fixed q; rigid struts do theirs as they change"""
    dissipated: dict[str, Times]
    """(frames,) for each cause: the integral of v·dR/dv, for the Coulomb switch of -v·F_switch; impacts and friction of
    exact contact by its impulses"""
    momentum_residual: Times
    """(frames,), N s: |change of momentum - impulse of the forces from outside|"""
    angular_residual: Times
    """(frames,), N m s, about the origin: |change of angular momentum - impulse of the moments from outside|"""

    @property
    def residual(self) -> Times:
        """(frames,), what the balance lacks, J: an error of the time steps."""
        energy = self.kinetic + self.potential
        return energy - energy[0] - self.actuation + self.lost

    @property
    def lost(self) -> Times:
        """(frames,), all dissipation, J."""
        return sum(self.dissipated.values(), np.zeros_like(self.times))

    @property
    def turned_over(self) -> float:
        """The largest of the amounts that went through the balance, J, against which a residual is small."""
        return float(max(np.ptp(x) for x in (self.kinetic, self.potential, self.actuation, self.lost)))


def energy_audit(
    scene: Scene,
    duration: float,
    *,
    method: str | None = None,
    dt: float | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    any_step: bool = False,
    sweeps: int | None = None,
    strut_tolerance: float | None = None,
    frame_rate: float = 100.0,
) -> EnergyAudit:
    """Roll the scene out in float64, and balance its energy and its momentum.

    dE/dt = dU/dt - v·dR/dv + v·F_switch, dp/dt = sum of the forces that no member exerts, and likewise their moments.
    Each is a further equation beside those of motion, integrated by the same method. The symplectic method and
    complementarity stepping take no further equations: there the works are summed step by step, from the forces and
    impulses of each step times the mean of its velocities; steps are shortened to fit the frames. Where the rollout
    fails, what comes after is NaN or no longer means anything: `simulate` says whether it does.

    Raises `InputError` as `simulate.settle` does.
    """
    settings = settle(scene, duration, method, dt, "float64", rtol, atol, any_step, sweeps, strut_tolerance)
    stepwise = settings.method.symplectic or settings.method.constrained
    interval = max(1 / frame_rate, float(settings.dt or 0.0))
    times = np.linspace(0, duration, max(1, round(duration / interval)) + 1)
    exact = as_dtype(scene, "float64")
    if stepwise:
        count = int(np.ceil(times[1] / settings.dt - 1e-9))  # type: ignore[operator]
        found = _step_by_step(exact, times, settings, count)
    else:
        found = _beside(exact, times, as_inputs(settings))
    found = jax.tree.map(np.asarray, found)
    times, positions, kinetic, potential, momenta, work = found
    actuation = work.pop("actuation")
    outside = [work.pop("impulse"), work.pop("moment")]
    residuals = [np.linalg.norm(p - p[0] - gained, axis=1) for p, gained in zip(momenta, outside)]
    return EnergyAudit(times, positions, kinetic, potential, actuation, work, *residuals)


@eqx.filter_jit
def _beside(scene: Scene, times: Times, settings: Settings):
    start = (scene.structure.nodes, jnp.zeros_like(scene.structure.nodes))

    def field(t, y, scene):
        return vector_field(t, y[0], scene), powers(scene, t, *y[0])

    nothing = jax.tree.map(jnp.zeros_like, powers(scene, 0.0, *start))
    _, solver = discretise(settings)
    problem = (diffrax.ODETerm(field), solver)
    (q, v), work = integrate((start, nothing), jnp.asarray(times), scene, settings, problem=problem).ys  # type: ignore[misc]
    if settings.dt is not None:
        work["actuation"] += _one_sided(scene, jnp.asarray(times), q, solver.tableau, settings.dt)  # type: ignore[attr-defined]
    return *_amounts(scene, jnp.asarray(times), q, v), work


def _one_sided(scene: Scene, times: Times, q: Path, tableau: diffrax.ButcherTableau, h: Scalar) -> Times:
    """(frames,), J: what the work of actuators lacks where a gait's ramp begins or ends in a frame.

    There dU/dt jumps. The stage at the end of the step before the frame should see its value before the jump, and the
    stage at the beginning of the step after it the value after; both see the value in between. Over both steps this
    cancels, but not in between, nor where the motion begins with a jump.
    """

    def off(t, q, side):
        power = jax.grad(scene.potential_energy, argnums=1)
        return power(q, t + side * 1e-9) - power(q, t)

    c, b = np.concatenate([[0.0], tableau.c]), np.asarray(tableau.b_sol)
    before = h * b[c == 1].sum() * jax.vmap(lambda t, q: off(t, q, -1))(times, q)
    after = h * b[c == 0].sum() * off(times[0], q[0], 1)
    return jnp.where(jnp.arange(len(times)) > 0, before + after, 0.0)


def _amounts(scene: Scene, times, q, v):
    """Times, positions, T, U and the two momenta in all frames."""
    kinetic = jax.vmap(lambda v: kinetic_energy(scene, v))(v)
    potential = jax.vmap(scene.potential_energy)(q, times)
    momenta = (
        jax.vmap(lambda v: momentum(scene, v))(v),
        jax.vmap(lambda q, v: angular_momentum(scene, q, v))(q, v),
    )
    return times, q, kinetic, potential, momenta


@eqx.filter_jit
def _step_by_step(scene: Scene, times: Times, settings: Settings, count: int):
    """With `count` steps from one frame to the next."""
    terms, solver = discretise(settings)
    h = jnp.asarray(times[1] / count)
    q, v = scene.structure.nodes, jnp.zeros_like(scene.structure.nodes)
    balance = impulsive_work if isinstance(solver, Complementarity) else conservative_work

    def step(carry, k):
        y, inner_state, work = carry
        y1, _, _, after, _ = solver.step(terms, k * h, (k + 1) * h, y, scene, inner_state, False)
        gained = balance(scene, k * h, h, y, y1, inner_state, after)
        return (y1, after, jax.tree.map(jnp.add, work, gained)), None

    def frame(carry, numbers):
        carry, _ = jax.lax.scan(step, carry, numbers)
        return carry, (carry[0], carry[2])

    first = solver.init(terms, 0 * h, h, (q, v), scene)
    nothing = jax.tree.map(jnp.zeros_like, balance(scene, 0 * h, h, (q, v), (q, v), first, first))
    numbers = jnp.arange(count * (len(times) - 1)).reshape(-1, count)
    _, ((path, speeds), work) = jax.lax.scan(frame, ((q, v), first, nothing), numbers)
    prepend = lambda a, b: jnp.concatenate([jnp.asarray(a)[None], b])  # noqa: E731
    path, speeds = prepend(q, path), prepend(v, speeds)
    back = jnp.where(jnp.arange(len(times)) > 0, h / 2, 0) if isinstance(solver, Complementarity) else 0 * times
    path = path - back[:, None, None] * speeds
    return *_amounts(scene, jnp.asarray(times) - back, path, speeds), jax.tree.map(prepend, nothing, work)


def powers(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors) -> Work:
    """W: of the actuators, dU/dt, and of each cause of dissipation, v·dR/dv, those that the scene has.

    Beside them "impulse" and "moment": the force, N, and the moment about the origin, N m, that come from outside.
    """
    pressed = pressing_force(scene, q, v)
    outside = smooth_force(_without_members(scene), t, q, v, pressed)
    found = {"actuation": jax.grad(scene.potential_energy, argnums=1)(q, jnp.asarray(t, q.dtype))}
    found |= jax.jvp(lambda v_: scene.dissipation_terms(v_, q, t, pressed), (v,), (v,))[1]
    if isinstance(scene.friction, SwitchFriction):
        friction = switched_friction(scene, v, pressed, smooth_force(scene, t, q, v, pressed))
        found["friction"] = -inner(jnp.ones_like(v[:, 0]), dot(v, friction))
        outside = outside + friction
    return found | {"impulse": outside.sum(0), "moment": jnp.cross(q, outside).sum(0)}


def conservative_work(scene: Scene, t0, h, start: State, end: State, before, after) -> Work:
    """What one step of velocity Verlet gained: the mean of the powers at both its ends."""
    rates = powers(scene, t0, *start), powers(scene, t0 + h, *end)
    return jax.tree.map(lambda a, b: h / 2 * (a + b), *rates)


def impulsive_work(scene: Scene, t0, h, start: State, end: State, before, after) -> Work:
    """What one step of complementarity stepping gained, each impulse times the mean of the velocities around it.

    What forces and ground do not account for is the work of the rigid struts, which is actuation.
    """
    (q, v), (_, w) = start, end
    kick, mean = (before[0] + h) / 2, (v + w) / 2
    mass = scene.structure.node_mass
    smooth = jax.tree.map(lambda power: kick * power, powers(scene, t0, q, mean))
    ground = _ground_impulses(scene, after)
    work = lambda force: inner(jnp.ones_like(mass), dot(force, mean))  # noqa: E731
    if ground:
        smooth["impacts"] = -work(ground[0])
        if scene.friction is not None:
            smooth["friction"] = -work(ground[1] + ground[2])
    if scene.structure.struts is not None and scene.structure.struts.rigid:
        struts = strut_impulses(scene, t0, h, start, end, before, after)
        smooth["actuation"] = smooth["actuation"] + work(struts)
    outside: NodeVectors = sum(ground, jnp.zeros_like(q))
    smooth["impulse"] = smooth["impulse"] + outside.sum(0)
    smooth["moment"] = smooth["moment"] + jnp.cross(q, outside).sum(0)
    return smooth


def strut_impulses(scene: Scene, t0, h, start: State, end: State, before, after) -> NodeVectors:
    """N s, on each node, of its rigid struts in one step: what neither forces nor the ground account for."""
    (q, v), (_, w) = start, end
    forces = (before[0] + h) / 2 * acceleration(scene, t0, q, (v + w) / 2)
    return scale(w - v - forces, scene.structure.node_mass) - sum(_ground_impulses(scene, after), jnp.zeros_like(q))


def _ground_impulses(scene: Scene, after) -> list[NodeVectors]:
    """N s, of exact contact on each node, along the normal and the two tangents, where the scene has it."""
    if scene.ground is None or not scene.ground.exact:
        return []
    directions = (scene.ground.normal, *scene.ground.tangents)
    return [scale(along(p, n), scene.structure.node_mass) for p, n in zip(after[1], directions)]


def _without_members(scene: Scene) -> Scene:
    parts = lambda s: (s.structure.struts, s.structure.cables, s.gait)  # noqa: E731
    return eqx.tree_at(parts, scene, (None, None, None), is_leaf=lambda x: x is None)

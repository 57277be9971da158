"""Where energy and momentum come from and go to: the powers of forces, and the works of one step's impulses."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxgrity.core.primitives import along, dot, inner, scale
from jaxgrity.core.types import NodeVectors, Scalar, State
from jaxgrity.model.inertia import held, momenta
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.complementarity import ContactState
from jaxgrity.stepping.constraints import exact_ground, rigid_struts
from jaxgrity.stepping.dynamics import acceleration, outside_force, smooth_force, support_forces, total_force
from jaxgrity.stepping.entering import where_met

Work = dict[str, jax.Array]
"""J of the actuators and of each cause of dissipation; N s and N m s, (3,), of the forces from outside"""


class Step(NamedTuple):
    """One step of a fixed size."""

    t0: Scalar
    """s"""
    h: Scalar
    """s"""
    start: State
    end: State
    before: Any
    """the solver's state at the start; a `ContactState` where impulses act"""
    after: Any
    """likewise at the end"""

    @property
    def impulsive(self) -> bool:
        """Whether it is a step of complementarity stepping."""
        return isinstance(self.after, ContactState)

    @property
    def kick(self) -> Scalar:
        """s, for which forces acted on the velocity: from the middle of the last step to the middle of this one."""
        return (self.before.step_size + self.h) / 2

    def acting(self, scene: Scene) -> Scene:
        """The scene with what acts for a time as it acts in the mean of these seconds."""
        return scene.during(self.t0 - self.before.step_size / 2, self.t0 + self.h / 2)


def powers(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors) -> Work:
    """W: of the actuators, dU/dt, and of each cause of dissipation, v·dR/dv, those that the scene has.

    Beside them "impulse" and "moment": the force, N, and the moment about the origin, N m, that come from outside.
    """
    normal_force = scene.normal_force(q, v)
    outside = outside_force(scene, t, q, v, normal_force)
    found = {"actuation": jax.grad(scene.potential_energy, argnums=1)(q, jnp.asarray(t, q.dtype))}
    found |= jax.jvp(lambda v_: scene.dissipation_by_cause(v_, q, t, normal_force), (v,), (v,))[1]
    if scene.force_laws:
        others, motion = smooth_force(scene, t, q, v, normal_force), scene.motion(v, q, t, normal_force)
        for law in scene.force_laws:
            force = law.force(motion, others)
            _book(found, law.cause, -inner(jnp.ones_like(v[:, 0]), dot(v, force)))
            outside = outside + force
    if scene.structure.fixed:
        reaction = support_forces(scene, t, q, v)
        outside = outside + reaction
        if scene.shaking is not None:
            _book(found, "supports", -inner(jnp.ones_like(v[:, 0]), dot(v, reaction)))
    return found | {"impulse": outside.sum(0), "moment": jnp.cross(q, outside).sum(0)}


def step_work(scene: Scene, step: Step) -> Work:
    """What one step gained: by its impulses, or by the mean of the powers at both its ends."""
    if step.impulsive:
        return impulsive_work(scene, step)
    rates = powers(scene, step.t0, *step.start), powers(scene, step.t0 + step.h, *step.end)
    return jax.tree.map(lambda a, b: step.h / 2 * (a + b), *rates)


def impulsive_work(scene: Scene, step: Step) -> Work:
    """What one step of complementarity stepping gained, each impulse times the mean of the velocities around it.

    What forces and ground do not account for is the work of the rigid struts, which is actuation.
    """
    (q, v), (_, w) = step.start, step.end
    mean = (v + w) / 2
    gained = jax.tree.map(lambda power: step.kick * power, powers(step.acting(scene), step.t0, q, mean))
    gained["actuation"] = _actuation(scene, step)
    ground = ground_impulses(scene, step)
    work = lambda force: inner(jnp.ones_like(v[:, 0]), dot(force, mean))  # noqa: E731
    if ground:
        _book(gained, "impacts", -work(ground[0]))
        if scene.friction is not None:
            _book(gained, "friction", -work(ground[1] + ground[2]))
    if rigid_struts(scene) is not None:
        gained["actuation"] = gained["actuation"] + work(strut_impulses(scene, step))
    outside: NodeVectors = sum(ground, jnp.zeros_like(q))
    if scene.structure.fixed:
        # those of the forces are among the powers already
        at_rest = step.kick * support_forces(step.acting(scene), step.t0, q, mean)
        outside = outside + support_impulses(scene, step) - at_rest
        if scene.shaking is not None:
            _book(gained, "supports", -work(support_impulses(scene, step) - at_rest))
    gained["impulse"] = gained["impulse"] + outside.sum(0)
    gained["moment"] = gained["moment"] + jnp.cross(q, outside).sum(0)
    return gained


def _book(work: Work, cause: str, lost) -> None:
    """Add what was lost to what a cause has lost already."""
    work[cause] = work[cause] + lost if cause in work else lost


def _actuation(scene: Scene, step: Step) -> Scalar:
    """J: the integral of dU/dt at fixed q over the time for which forces acted; dU/dt may jump within it."""
    end = step.t0 + step.h / 2
    q = step.start[0]
    return scene.potential_energy(q, end) - scene.potential_energy(q, end - step.kick)


def strut_impulses(scene: Scene, step: Step) -> NodeVectors:
    """N s, on each node, of its rigid struts in one step: what neither forces nor the ground account for."""
    if step.after.struts is not None:
        return step.after.struts
    (q, v), (_, w) = step.start, step.end
    forces = step.kick * acceleration(step.acting(scene), step.t0, q, (v + w) / 2)
    impulses = momenta(scene.structure, w - v - forces)
    return impulses - sum(ground_impulses(scene, step), jnp.zeros_like(q))


def support_impulses(scene: Scene, step: Step) -> NodeVectors:
    """N s, on each node, of its support in one step of complementarity stepping: what nothing else accounts for."""
    (q, v), (_, w) = step.start, step.end
    forces = step.kick * total_force(step.acting(scene), step.t0, q, (v + w) / 2)
    others = sum(ground_impulses(scene, step), forces + strut_impulses(scene, step))
    return held(scene.structure, momenta(scene.structure, w - v) - others)


def ground_impulses(scene: Scene, step: Step) -> list[NodeVectors]:
    """N s, of exact contact on each node, along the normal and the two tangents, where the scene has it."""
    ground = exact_ground(scene)
    if ground is None:
        return []
    impulses, frame = step.after.impulses, ground.frame(where_met(ground, length_scale(scene), step.h, *step.start).at)
    speeds, directions = (impulses.normal, *impulses.tangential), (frame.normal, *frame.tangents)
    return [scale(along(p, n), scene.structure.lumped_mass) for p, n in zip(speeds, directions)]

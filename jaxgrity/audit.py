"""Where the energy of a rollout comes from, and where it goes."""

from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.dynamics import kinetic_energy, pressing_force, smooth_force, switched_friction, vector_field
from jaxgrity.friction import SwitchFriction
from jaxgrity.scene import Scene, as_dtype
from jaxgrity.simulate import Settings, integrate, settle
from jaxgrity.structure import InputError
from jaxgrity.types import Times


class EnergyAudit(NamedTuple):
    """Change of energy = actuation work - dissipation, each integrated beside the motion, at every frame, in J."""

    times: Times
    """(frames,), s"""
    kinetic: Times
    """(frames,), T"""
    potential: Times
    """(frames,), U: members, gravity and penalty contact"""
    actuation: Times
    """(frames,), work done by the actuators: the integral of dU/dt at fixed q"""
    dissipated: dict[str, Times]
    """(frames,) for each cause: the integral of v·dR/dv, and for the Coulomb switch of -v·F_switch"""

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
    scene: Scene, duration: float, *, method: str | None = None, dt: float | None = None, frame_rate: float = 100.0
) -> EnergyAudit:
    """Roll the scene out in float64, and balance its energy.

    dE/dt = dU/dt - v·dR/dv + v·F_switch; each power is a further equation beside those of motion, integrated by the
    same method. Raises `InputError` as `simulate.settle` does, and for methods that take no further equations: the
    symplectic one and complementarity stepping.
    """
    settings = settle(scene, duration, method, dt, "float64")
    if settings.method.symplectic or settings.method.constrained:
        raise InputError(f"method = {settings.method.name!r} takes no equations but those of motion; expected another")
    times = np.linspace(0, duration, max(1, round(duration * frame_rate)) + 1)
    kinetic, potential, work = jax.tree.map(np.asarray, _audit(as_dtype(scene, "float64"), times, settings))
    actuation = work.pop("actuation")
    return EnergyAudit(times, kinetic, potential, actuation, work)


@eqx.filter_jit
def _audit(scene: Scene, times: Times, settings: Settings):
    q = scene.structure.nodes
    state = (q, jnp.zeros_like(q))

    def field(t, y, scene):
        return vector_field(t, y[0], scene), powers(scene, t, *y[0])

    start = (state, jax.tree.map(jnp.zeros_like, powers(scene, 0.0, *state)))
    solver = settings.method.step() if settings.dt is not None else settings.method.adapt()  # type: ignore[misc]
    (moved, work) = integrate(start, jnp.asarray(times), scene, settings, problem=(diffrax.ODETerm(field), solver)).ys  # type: ignore[misc]
    kinetic = jax.vmap(lambda v: kinetic_energy(scene, v))(moved[1])
    potential = jax.vmap(scene.potential_energy)(moved[0], jnp.asarray(times))
    return kinetic, potential, work


def powers(scene: Scene, t, q, v) -> dict:
    """W: of the actuators, dU/dt, and of each cause of dissipation, v·dR/dv, those that the scene has."""
    pressed = pressing_force(scene, q, v)
    found = {"actuation": jax.grad(scene.potential_energy, argnums=1)(q, jnp.asarray(t, q.dtype))}
    found |= jax.jvp(lambda v_: scene.dissipation_terms(v_, q, t, pressed), (v,), (v,))[1]
    if isinstance(scene.friction, SwitchFriction):
        other = smooth_force(scene, t, q, v, pressed)
        found["friction"] = -jnp.sum(v * switched_friction(scene, v, pressed, other))
    return found

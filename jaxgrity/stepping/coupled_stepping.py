"""Complementarity stepping with all struts and contacts solved together.

It is for structures with nodes of several rigid struts, rods with mass, or supports.
"""

import equinox as eqx
import jax.numpy as jnp

from jaxgrity.core.types import Scalar
from jaxgrity.model.scales import speed_scale
from jaxgrity.model.shaking import moved_along
from jaxgrity.stepping.capsules import capsules_of, ends_of
from jaxgrity.stepping.complementarity import (
    LARGEST_LENGTH_ERROR,
    Complementarity,
    CoupledState,
    Lift,
    first_memory,
    kick_of,
    one_robot,
)
from jaxgrity.stepping.coupled import coupled_impulses
from jaxgrity.stepping.strut_contacts import TouchingStruts, points_between, touching_struts

LARGEST_SPEED_ERROR = 1e-3
"""Largest difference, m/s for a body of one metre, between a velocity and the one that the impulses give, if struts and
contacts are solved together."""


class CoupledImpulses(Complementarity):
    """Impulses of contacts and struts by Newton's method (`coupled.py`), without sweeps."""

    tolerance: Scalar | None = None
    lift: Lift = eqx.field(static=True, default=one_robot)

    def init(self, terms, t0, t1, y0, args):
        step_size, impulses = first_memory(t0, t1, y0)
        none = lambda points: jnp.zeros_like(y0[1], shape=(points, *y0[1].shape[1:]))  # noqa: E731
        if (capsules := capsules_of(args)) is not None:
            impulses = impulses._replace(along_struts=none(len(ends_of(capsules)[0])))
        if points := points_between(args):
            impulses = impulses._replace(between_struts=none(points))
        return CoupledState(step_size, impulses, 0 * y0[1], jnp.zeros_like(y0[1][0, 0]))

    def velocity_after_impulses(self, terms, ends, start, scene, memory):
        (q, v), (t0, t1) = start, ends
        h, (kick, forces) = t1 - t0, kick_of(scene, ends, memory)
        solve = self.lift(coupled_impulses, ("s", None, -1, -1, -1, -1, -1))
        touching = TouchingStruts()
        if capsules_of(scene) is not None or points_between(scene):
            touching = self.lift(touching_struts, ("s", None, -1))(scene, h, start)
        _, a = terms.vf(t0, start, forces)
        free = self._carried(scene, t0, t1, v + kick * a)
        # robots that rest or slide need nearly the impulses of their last step: Newton's method begins there
        found = solve(scene, (h, t1), start, free, free, memory.impulses, touching)
        if scene.dissipates:
            _, a = terms.vf(t0, (q, (v + found.velocity) / 2), forces)
            free = self._carried(scene, t0, t1, v + kick * a)
            found = solve(scene, (h, t1), start, free, found.velocity, found.impulses, touching)
        fastest = LARGEST_SPEED_ERROR * speed_scale(scene)
        met = (found.stretch <= LARGEST_LENGTH_ERROR) & (found.error <= fastest)
        if self.tolerance is not None:
            met = met & (found.off <= self.tolerance)
        if touching.each_other is not None:
            met = met & ~touching.each_other.missed
        w = jnp.where(met, found.velocity, jnp.nan)
        taken = jnp.broadcast_to(h, jnp.shape(memory.step_size))
        return w, CoupledState(taken, found.impulses, found.struts, found.error)

    def _carried(self, scene, t0, t1, v):
        """Velocities with those of moving supports: their places after the step are known."""
        if scene.shaking is None:
            return v
        one = lambda scene, v: moved_along(scene.shaking, scene.structure, t0, t1, v)  # noqa: E731
        return self.lift(one, ("s", -1))(scene, v)

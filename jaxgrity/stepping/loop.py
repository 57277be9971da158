"""Steps one by one: what a method carries from step to step, its start, its advance and its end.

`diffrax.diffeqsolve` (`discretisation.integrate`) makes rollouts that give frames or an end alone: those of `simulate`,
of most populations, and of populations whose robots each have steps of their own. What has to see every step, or has
derivatives in reverse mode, steps here with the same solver: metrics, populations that look at the path in between
(`simulate_population(parts=...)`), audits, ground impulses, `final_state`, orbits, closed loops. Both begin
complementarity stepping by `carried_at`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.tracing import traced
from jaxgrity.core.types import AnyArray, Scalar, State
from jaxgrity.model.scene import Scene
from jaxgrity.model.shaking import left_by_step, with_supports
from jaxgrity.stepping.complementarity import ImpulseState
from jaxgrity.stepping.frame_velocities import at_rest, velocity_at
from jaxgrity.stepping.options import ResolvedOptions
from jaxgrity.stepping.swept import SWEPT

Scheme = tuple[diffrax.AbstractTerm, diffrax.AbstractSolver]
"""what `discretise` makes of options"""


class Carried(NamedTuple):
    """The carry of a method from one step to the next."""

    motion: State
    """q, m, and v, m/s, (nodes, 3) each; v in the middle of the last step where memory is an `ImpulseState`"""
    memory: Any
    """what the method remembers of its last step"""


class Step(NamedTuple):
    """One step of a fixed size."""

    t0: Scalar
    """s"""
    h: Scalar
    """s"""
    before: Carried
    after: Carried

    @property
    def impulsive(self) -> bool:
        """Whether it is a step of complementarity stepping."""
        return isinstance(self.after.memory, ImpulseState)

    @property
    def kick(self) -> Scalar:
        """s, the time of the kick: from the middle of the last step to the middle of this one."""
        return (self.before.memory.step_size + self.h) / 2

    def acting(self, scene: Scene) -> Scene:
        """The scene with temporary laws in their mean over these seconds."""
        return scene.during(self.t0 - self.before.memory.step_size / 2, self.t0 + self.h / 2)


def carried_at(scheme: Scheme, scene: Scene, t: Scalar, h: Scalar, start: State) -> Carried:
    """The method's carry at t (s), before a first step of size h (s), from `start` = (q, v) then.

    Robots at rest begin with half a kick, as if nothing had acted before; moving robots with a whole one.
    """
    terms, solver = scheme
    first = solver.init(terms, t, t + h, start, scene)
    q, v = start
    # of a robot that is known to be at rest all of the rest is nothing, and its program is shorter without it
    if not isinstance(first, ImpulseState) or not (traced(v) or np.any(np.asarray(v))):
        return Carried(start, first)
    still = at_rest(v)
    if scene.shaking is not None:
        shaken = lambda scene, v: left_by_step(scene.shaking, scene.structure, t, h, v)  # noqa: E731
        v = jnp.where(still, v, solver.lift(shaken, ("s", -1))(scene, v))  # type: ignore[attr-defined]
    # v in the middle of a step that would end now: the first kick then takes as long as any other, and passes v on its
    # way. So a motion that goes on from a frame does not differ from one that was never cut
    _, a = terms.vf(t, (q, v), scene.during(t - h / 2, t))
    w = jnp.where(still, v, v - h / 2 * a)
    return Carried((q, w), first._replace(step_size=jnp.where(still, 0, h).astype(q.dtype)))


def advance(scheme: Scheme, scene: Scene, ends: tuple[Scalar, Scalar], carried: Carried) -> Carried:
    """One step on, from the first to the second of its `ends`, s. They are given: (k + 1) h and k h + h round apart."""
    (terms, solver), (t0, t1) = scheme, ends
    motion, _, _, memory, _ = solver.step(terms, t0, t1, carried.motion, scene, carried.memory, False)
    return Carried(motion, memory)


def numbered(scheme: Scheme, scene: Scene, h: Scalar, since: Scalar = 0.0) -> Callable[[Carried, Any], Carried]:
    """`advance` as a function of the carry and a number k, from `since` + k h to `since` + (k + 1) h, s."""

    def step(carried, k):
        return advance(scheme, scene, (since + k * h, since + (k + 1) * h), carried)

    return step


def repeated(step: Callable[[Carried, Any], Carried], carried: Carried, numbers: AnyArray) -> Carried:
    """A scan over steps with these numbers."""
    return jax.lax.scan(lambda carried, k: (step(carried, k), None), carried, numbers)[0]


def recomputed(step: Callable, options: ResolvedOptions) -> Callable:
    """A step that reverse mode runs again, but for sweeps whose results are kept; one that does so itself stays."""
    sweeps = jax.checkpoint_policies.save_only_these_names(SWEPT)
    return step if options.method.recomputes else jax.checkpoint(step, policy=sweeps)


def state_of(scene: Scene, t: Scalar, carried: Carried) -> State:
    """(q, v) at t (s), of one robot, from the method's carry."""
    (q, w), memory = carried
    if not isinstance(memory, ImpulseState):
        return q, with_supports(scene.shaking, scene.structure, t, w)
    return q, velocity_at(scene, t, q, w, memory.step_size / 2)

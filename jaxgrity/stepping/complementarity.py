"""Exact contact and rigid struts: a time step whose velocities satisfy constraints.

The scheme of Moreau and Jean: forces act on the velocity, then impulses make it satisfy the constraints at the end of
the step. M. Jean 1999, doi:10.1016/S0045-7825(98)00383-1; Stewart and Trinkle 1996. Here is the common part of its two
solvers: `swept.py` finds impulses by sweeps over struts and contacts, `coupled_stepping.py` all at once.
"""

import abc
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from jaxgrity.core.types import AnyArray, NodeVectors, PerNode, Scalar, State
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.constraints import GroundImpulses, exact_ground
from jaxgrity.stepping.ground_impulses import bounce_gains
from jaxgrity.stepping.impact_times import impact_times, moved_on, without_bounces

LARGEST_LENGTH_ERROR = 1e-3
"""Largest share of its length by which a strut may be off at the end of a step. A robot beyond it gets NaN, and needs
more sweeps or smaller steps."""

Lift = Callable[[Callable, tuple], Callable]
"""`lift(function, in_axes)` maps a function over a population; in `in_axes` the letter "s" stands for the scene's"""


def one_robot(function: Callable, in_axes: tuple) -> Callable:
    """The `Lift` of a rollout of one robot: the function as it is."""
    return function


class SweptState(NamedTuple):
    """The carry of complementarity stepping from step to step, with impulses by sweeps."""

    step_size: Scalar
    """of the last step, s; 0 before the first step of a robot at rest. A number, or one for each robot"""
    impulses: GroundImpulses
    """of the last step"""
    landed: PerNode | None = None
    """share of the last step after which a node landed in it; 0 for a node that did not. None: landings have no time of
    their own (`timed_contact.py`)"""


class CoupledState(NamedTuple):
    """That of sweeps with struts and contacts solved together."""

    step_size: Scalar
    impulses: GroundImpulses
    struts: NodeVectors
    """N s, (nodes, 3), of the rigid struts in the last step"""
    residual: Scalar
    """m/s, by which velocities miss what the impulses make of them, at most"""
    landed: PerNode | None = None


ImpulseState = SweptState | CoupledState
"""carries that hold the size of the last step, in whose middle the velocities are"""


class Complementarity(diffrax.AbstractSolver):
    """A leapfrog with constraints: v lives in the middle of the steps, and forces act on it at the nodes' positions.

    From q at t0 and v in the middle of the last step, of size h0:

        w = v + (h0 + h)/2 M^-1 F(q, (v + w)/2, t0) + impulses,    q1 = q + h w.

    A robot that starts at rest has v at t0 (h0 = 0). One that starts in motion is taken as if a step had just ended
    (`loop.py`).
    Laws that act for a short time are averaged over the time of the kick. Dissipative forces need w: a first round,
    with F(q, v, t0), predicts it, and the last round uses the prediction. The order is 2 where nothing begins
    or ends to touch, stick or slip, also along curved ground without friction. It is 1 there, and where the direction
    of slip turns: friction acts against w, not the mean of v and w.

    Where restitution and friction would create energy (`bounce_gains`), the impacts of the step are plastic.
    Derivatives through bounces are those of the motion in continuous time (`impact_times.py`).

    No impulse lets a node end a step below the ground. A robot whose struts are off by more than
    `LARGEST_LENGTH_ERROR` of their lengths, or by more than the tolerance, at the end of a step gets NaN: no exception
    stops the others of a population.
    """

    tolerance: eqx.AbstractVar[Scalar | None]
    """m: every strut has its length within this at the end of a step. None: as near as the solver comes"""
    lift: eqx.AbstractVar[Lift]
    """how what is done for one robot is mapped over a population"""
    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable] = diffrax.LocalLinearInterpolation

    @abc.abstractmethod
    def velocity_after_impulses(self, field, ends, start, scene, memory) -> tuple[AnyArray, ImpulseState]:
        """w, m/s, in the step from the first to the second of `ends`, s, and the memory of the step.

        `field(t, (q, v), scene)` is the motion by forces alone: (v, a).
        """

    def order(self, terms):
        return 1

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        # in diffrax's words, `terms` holds the vector field, and `args` is the scene; `scene.terms` are the user's laws
        scene, field = args, terms.vf
        ground, ends = exact_ground(scene), (t0, t1)
        bounces = ground is not None and ground.restitution is not None
        start, times = self._at_impacts(field, ends, y0, scene, solver_state) if bounces else (y0, None)
        w, after = self.velocity_after_impulses(field, ends, start, scene, solver_state)
        if bounces and scene.friction is not None:
            # both are computed: mapped over a population, a condition would compute both too
            still = eqx.tree_at(lambda scene: scene.ground.restitution, scene, 0 * ground.restitution)
            plastic = self.velocity_after_impulses(field, ends, start, still, solver_state)
            gains = self.lift(bounce_gains, ("s", None, -1, -1, -1))(scene, t1 - t0, start, w, after.impulses)
            taken = after.step_size
            w, after = jax.tree.map(lambda a, b: jnp.where(gains, a, b), plastic, (w, after))
            # of a population one number for all robots
            after = after._replace(step_size=taken)
        y1 = (start[0] + (t1 - t0) * w, w)
        if times is not None:
            # back along the motion after the impacts
            accelerations = self._unhindered(field, (t1, t1 + (t1 - t0)), y1, scene, after)
            y1 = self.lift(moved_on, ("s", None, -1, -1, -1))(scene, (t1, t1), -times, y1, accelerations)
        return y1, None, {"y0": y0, "y1": y1}, after, diffrax.RESULTS.successful

    def _at_impacts(self, field, ends, start, scene, memory) -> tuple[State, AnyArray]:
        """The start of a step with its derivative at the impacts, and their times. Programs without derivatives leave
        out all that this takes."""
        accelerations = self._unhindered(field, ends, start, scene, memory)
        times = self.lift(impact_times, ("s", None, -1, -1))(scene, ends[1] - ends[0], start, accelerations)
        return self.lift(moved_on, ("s", None, -1, -1, -1))(scene, ends, times, start, accelerations), times

    def _unhindered(self, field, ends, start, scene, memory) -> AnyArray:
        """m/s^2: the accelerations in a step in which nodes pass through the ground where they would bounce."""
        ends, start, memory = jax.lax.stop_gradient((ends, start, memory))
        scene = without_bounces(scene)
        w, _ = self.velocity_after_impulses(field, ends, start, scene, memory)
        gained = (w - start[1]) / kick_of(scene, ends, memory)[0]
        # a failure is that of the step itself
        return jnp.where(jnp.isfinite(gained), gained, 0)

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)


def kick_of(scene: Scene, ends: tuple[Scalar, Scalar], memory: ImpulseState) -> tuple[AnyArray | Scalar, Scene]:
    """s, the time of the kick, common to many robots or of each; and the scene with temporary laws in their mean over
    it."""
    (t0, t1), last = ends, memory.step_size
    return (last + (t1 - t0)) / 2, scene.during(t0 - last / 2, t0 + (t1 - t0) / 2)


def first_memory(t0: Scalar, t1: Scalar, y0: State) -> SweptState:
    """The memory before the first step of a robot at rest."""
    nothing = jnp.zeros_like(y0[1][:, 0])
    return SweptState(jnp.zeros_like(t1 - t0), GroundImpulses(nothing, (nothing, nothing)))

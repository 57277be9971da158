"""Exact contact and rigid struts: a time step whose velocities satisfy constraints.

The scheme is Moreau's and Jean's: forces act on the velocity, impulses then make it satisfy the constraints at the end
of the step. M. Jean 1999, doi:10.1016/S0045-7825(98)00383-1; Stewart and Trinkle 1996.
"""

from collections.abc import Callable
from typing import ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name

from jaxgrity.core.primitives import store_cotangent
from jaxgrity.core.types import Count, NodeVectors, Scalar
from jaxgrity.model.scales import speed_scale
from jaxgrity.model.shaking import moved_along
from jaxgrity.stepping.constraints import (
    GroundImpulses,
    blocks_of,
    bounce_gains,
    exact_ground,
    excess,
    impulses,
    length_error,
    prepare,
    pushed,
    rates_at_lengths,
    rates_held,
    sweep,
    trials_of,
    usual_sweeps,
    velocities,
)
from jaxgrity.stepping.coupled import coupled_impulses

LARGEST_LENGTH_ERROR = 1e-3
"""Largest share of its length by which a strut may be off at the end of a step. A robot beyond it gets NaN, and needs
more sweeps or smaller steps."""

LARGEST_SPEED_ERROR = 1e-3
"""Largest difference, m/s for a body of one metre, between a velocity and what the impulses make of it, where struts
and contacts are solved together."""

SWEPT = "swept"
"""Name under which reverse mode keeps what the sweeps of a step have found, where each node belongs to one strut. So
sweeps are not run again (but for the last one of a round that predicts)."""

Lift = Callable[[Callable, tuple], Callable]
"""`lift(function, in_axes)` maps a function over a population; in `in_axes` the letter "s" stands for the scene's"""


def one_robot(function: Callable, in_axes: tuple) -> Callable:
    """The `Lift` of a rollout of one robot: the function as it is."""
    return function


class ContactState(NamedTuple):
    """What complementarity stepping carries from step to step."""

    step_size: Scalar
    """of the last step, s; 0 before the first of a robot at rest; of many robots, common to all or of each"""
    impulses: GroundImpulses
    """of the last step"""
    struts: NodeVectors | None = None
    """N s, (nodes, 3), of the rigid struts in the last step, where they are solved together; else None"""
    residual: Scalar | None = None
    """m/s, by which velocities miss what the impulses make of them, at most; likewise"""


class Complementarity(diffrax.AbstractSolver):
    """A leapfrog with constraints: v lives in the middle of the steps, and forces act on it at the nodes' positions.

    From q at t0 and v in the middle of the last step, of size h0:

        w = v + (h0 + h)/2 M^-1 F(q, (v + w)/2, t0) + impulses,    q1 = q + h w.

    A robot at rest starts from v at t0 (h0 = 0); one that moves as if there had been a step before (`handover.py`).
    Laws that act for a time are taken in their mean over that of the kick. Dissipative forces need w: a first round of
    sweeps, with F(q, v, t0), predicts it, and the last round uses the prediction. The order is 2 where nothing begins
    or ends to touch, stick or slip, and 1 there and where a node slides along a curve: friction acts against w, not the
    mean of v and w.

    Where restitution and friction would make energy (`bounce_gains`), the impacts of the step are plastic.

    Velocities are read from trial impulses (see `ground_response.py`), none of which lets a node end a step below the
    ground. A robot whose struts are off by more than `LARGEST_LENGTH_ERROR` of their lengths, or by more than the
    tolerance, at the end of a step gets NaN.
    """

    sweeps: Count | None = None
    """over all constraints, in a step; the most there are where a tolerance is given. None: `usual_sweeps`"""
    tolerance: Scalar | None = None
    """m: sweeps end where every strut has its length within this. None: after all sweeps"""
    together: bool = eqx.field(static=True, default=False)
    """whether struts and contacts are solved together (`coupled.py`), as structures need whose nodes belong to several
    struts, or whose rods have mass, or that are supported"""
    lift: Lift = eqx.field(static=True, default=one_robot)
    """how what is done for one robot is mapped over a population"""
    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable] = diffrax.LocalLinearInterpolation

    def order(self, terms):
        return 1

    def init(self, terms, t0, t1, y0, args):
        nothing = jnp.zeros_like(y0[1][:, 0])
        first = ContactState(jnp.zeros_like(t1 - t0), GroundImpulses(nothing, (nothing, nothing)))
        return first._replace(struts=0 * y0[1], residual=nothing[0]) if self.together else first

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        taken = self._taken(terms, t0, t1, y0, args, solver_state)
        ground = exact_ground(args)
        if ground is None or ground.restitution is None or args.friction is None:
            return taken
        # both are computed: mapped over a population, a condition would compute both too
        still = eqx.tree_at(lambda scene: scene.ground.restitution, args, 0 * ground.restitution)
        plastic = self._taken(terms, t0, t1, y0, still, solver_state)
        gains = self.lift(bounce_gains, ("s", None, -1, -1, -1))(args, t1 - t0, y0, taken[0][1], taken[3].impulses)
        y1, error, dense, after = jax.tree.map(lambda a, b: jnp.where(gains, a, b), plastic[:4], taken[:4])
        # of a population one number for all robots
        return y1, error, dense, after._replace(step_size=taken[3].step_size), taken[4]

    def _taken(self, terms, t0, t1, y0, args, solver_state):
        if self.together:
            return self._step_together(terms, t0, t1, y0, args, solver_state)
        (q, v), h = y0, t1 - t0
        kick = (solver_state.step_size + h) / 2
        forces = args.during(t0 - solver_state.step_size / 2, t0 + h / 2)
        problem = jax.tree.map(store_cotangent, self.lift(prepare, ("s", None, None, -1, -1))(args, h, t1, q, v))
        found = self.lift(velocities, ("s", -1, -1))
        accelerated = lambda v: store_cotangent(terms.vf(t0, (q, v), forces)[1])  # noqa: E731
        a = accelerated(v)
        trials = self.lift(trials_of, ("s", -1))(args, v + kick * a)
        if args.dissipates:
            # no tolerance here: what this round misses changes the answer by way of the dissipative forces alone
            trials = self._constrain(args, h, problem, trials, usual_sweeps(args), converged=False)
            corrected = accelerated((v + found(args, problem, trials)) / 2)
            # the impulses found so far stay, so that the last round begins near its answer
            trials = self.lift(pushed, ("s", -1, -1))(args, trials, kick * (corrected - a))
        trials = self._constrain(args, h, problem, trials, self._most_sweeps(args), self.tolerance)
        w = found(args, problem, trials)
        taken = jnp.broadcast_to(h, jnp.shape(solver_state.step_size))
        after = ContactState(taken, self.lift(impulses, ("s", -1, -1))(args, problem, trials))
        if problem.lengths is not None:
            error = self._length_error(args, h, problem, trials)
            met = error.relative <= LARGEST_LENGTH_ERROR if self.tolerance is None else error.largest <= self.tolerance
            # NaN in place of an exception: the others of a population go on, and this robot is marked as failed
            w = jnp.where(met, w, jnp.nan)
        y1 = (q + h * w, w)
        return y1, None, {"y0": y0, "y1": y1}, after, diffrax.RESULTS.successful

    def _step_together(self, terms, t0, t1, y0, args, solver_state):
        (q, v), h = y0, t1 - t0
        kick = (solver_state.step_size + h) / 2
        forces = args.during(t0 - solver_state.step_size / 2, t0 + h / 2)
        solve = self.lift(coupled_impulses, ("s", None, -1, -1, -1, -1))
        _, a = terms.vf(t0, y0, forces)
        start = self._carried(args, t0, t1, v + kick * a)
        # robots that rest or slide need nearly the impulses of their last step: Newton's method begins there
        found = solve(args, (h, t1), y0, start, start, solver_state.impulses)
        if args.dissipates:
            _, a = terms.vf(t0, (q, (v + found.velocity) / 2), forces)
            start = self._carried(args, t0, t1, v + kick * a)
            found = solve(args, (h, t1), y0, start, found.velocity, found.impulses)
        fastest = LARGEST_SPEED_ERROR * speed_scale(args)
        met = (found.stretch <= LARGEST_LENGTH_ERROR) & (found.error <= fastest)
        if self.tolerance is not None:
            met = met & (found.off <= self.tolerance)
        w = jnp.where(met, found.velocity, jnp.nan)
        y1 = (q + h * w, w)
        taken = jnp.broadcast_to(h, jnp.shape(solver_state.step_size))
        after = ContactState(taken, found.impulses, found.struts, found.error)
        return y1, None, {"y0": y0, "y1": y1}, after, diffrax.RESULTS.successful

    def _carried(self, scene, t0, t1, v):
        """Velocities with those of supports that move: where they are after the step is known."""
        if scene.shaking is None:
            return v
        one = lambda scene, v: moved_along(scene.shaking, scene.structure, t0, t1, v)  # noqa: E731
        return self.lift(one, ("s", -1))(scene, v)

    def _most_sweeps(self, scene):
        return usual_sweeps(scene) if self.sweeps is None else self.sweeps

    def _length_error(self, scene, h, problem, trials):
        return self.lift(length_error, ("s", None, -1, -1))(scene, h, problem, trials)

    def _constrain(self, scene, h, problem, trials, sweeps, tolerance=None, converged=True):
        """Trial impulses after so many sweeps, or after as many as the tolerance needs.

        Where they have not `converged` to rounding, their derivative is through the last of them.
        """
        once = self.lift(sweep, ("s", -1, -1))

        # rolled up, and outside the map over a population: unrolled sweeps, or mapped loops, are many times slower
        def swept(sweeps, scene, h, problem, trials):
            if tolerance is None:
                return jax.lax.fori_loop(0, sweeps, lambda _, trials: once(scene, problem, trials), trials)

            # until the last robot is there: one loop for all of them keeps sweeps in vectors
            def short_of(carry):
                done, trials = carry
                return (done < sweeps) & jnp.any(self._length_error(scene, h, problem, trials).largest > tolerance)

            def again(carry):
                return carry[0] + 1, once(scene, problem, carry[1])

            return jax.lax.while_loop(short_of, again, (0, trials))[1]

        # the theorem would need a system of all struts where they share nodes: derivatives go through the sweeps there
        if not blocks_of(scene).by_struts:
            return swept(sweeps, scene, h, problem, trials)

        # at the solution (`_rates`): a loop that ends at a tolerance has no reverse mode, and one of a fixed number of
        # sweeps would keep each of them
        @jax.custom_jvp
        def differentiable(scene, h, problem, trials):
            return swept(sweeps, scene, h, problem, trials)

        @differentiable.defjvp
        def derivative(primals, tangents):
            # what follows from the size of the step is in the problem
            (scene, _, problem, before), (scene_dot, _, problem_dot, before_dot) = primals, tangents
            if converged:
                after = checkpoint_name(differentiable(*primals), SWEPT)
                return after, self._rates(scene, problem, before, after, (scene_dot, problem_dot, before_dot))
            almost = checkpoint_name(swept(sweeps - 1, *primals), SWEPT)
            almost_dot = self._rates(scene, problem, before, almost, (scene_dot, problem_dot, before_dot))
            return jax.jvp(once, (scene, problem, almost), (scene_dot, problem_dot, almost_dot))

        return differentiable(scene, h, problem, trials)

    def _rates(self, scene, problem, before, after, rates):
        """The derivative of what sweeps converge to, where each node belongs to one strut.

        Sweeps change the trial impulses by z = z0 - S u alone, with u the `pushes` of impulses of 1 along the struts,
        until F(z, ...) = 0, the struts' `excess`. By the implicit function theorem the derivative of S is that of F
        with S held, over -dF/dS: it costs less than one sweep's, and needs none of those before.
        """
        scene_dot, problem_dot, before_dot = rates
        held = self.lift(rates_held, (-1, -1, -1, -1, -1))(problem, problem_dot, before, before_dot, after)
        at, along = (scene, problem, after), (scene_dot, problem_dot, held)
        _, missed, slope = jax.jvp(self.lift(excess, ("s", -1, -1)), at, along, has_aux=True)
        return self.lift(rates_at_lengths, (-1, -1, -1, -1))(problem, held, missed, slope)

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

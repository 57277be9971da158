"""Complementarity stepping by sweeps over rigid struts and contacts, each of which has an impulse in closed form.

Where each node belongs to one strut, sweeps are Newton steps. Where struts share nodes they converge slowly: by default
`coupled_stepping.py` solves such scenes.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name

from jaxgrity.core.primitives import store_cotangent
from jaxgrity.core.types import Count, Scalar
from jaxgrity.stepping.complementarity import (
    LARGEST_LENGTH_ERROR,
    Complementarity,
    Lift,
    SweptState,
    first_memory,
    kick_of,
    one_robot,
)
from jaxgrity.stepping.constraints import (
    blocks_of,
    impulses,
    length_error,
    length_gap,
    rates_at_impulses,
    rates_at_lengths,
    step_problem,
    sweep,
    trials_of,
    usual_sweeps,
    velocities,
    with_change,
)

SWEPT = "swept"
"""Name under which reverse mode keeps what the sweeps of a step have found, where each node belongs to one strut. So
sweeps are not run again. The last sweep of the first round is, which predicts velocities for dissipative forces."""


class SweptImpulses(Complementarity):
    """Impulses of contacts and struts by sweeps over them, until all hold.

    Velocities are read from trial impulses (see `ground_response.py`).
    """

    sweeps: Count | None = None
    """over all constraints, in a step; the most there are where a tolerance is given. None: `usual_sweeps`"""
    tolerance: Scalar | None = None
    """m: sweeps end where every strut has its length within this. None: after all sweeps"""
    lift: Lift = eqx.field(static=True, default=one_robot)

    def init(self, terms, t0, t1, y0, args):
        return first_memory(t0, t1, y0)

    def velocity_after_impulses(self, field, ends, start, scene, memory):
        (q, v), (t0, t1) = start, ends
        h, (kick, acting) = t1 - t0, kick_of(scene, ends, memory)
        # "s" and -1 say which axis of each argument counts robots (`Lift`)
        problem = jax.tree.map(store_cotangent, self.lift(step_problem, ("s", None, None, -1, -1))(scene, h, t1, q, v))
        found = self.lift(velocities, ("s", -1, -1))
        accelerated = lambda v: store_cotangent(field(t0, (q, v), acting)[1])  # noqa: E731
        a = accelerated(v)
        trials = self.lift(trials_of, ("s", -1))(scene, v + kick * a)
        if scene.dissipates:
            # no tolerance here: an error of this round reaches the answer only through the dissipative forces
            trials = self._constrain(scene, h, problem, trials, usual_sweeps(scene), converged=False)
            corrected = accelerated((v + found(scene, problem, trials)) / 2)
            # the impulses found so far stay, so that the last round begins near its answer
            trials = self.lift(with_change, ("s", -1, -1))(scene, trials, kick * (corrected - a))
        return self._finished(scene, h, problem, trials, memory)

    def _finished(self, scene, h, problem, trials, memory):
        """The last round of a step: velocities, m/s, and the memory."""
        most = usual_sweeps(scene) if self.sweeps is None else self.sweeps
        trials = self._constrain(scene, h, problem, trials, most, self.tolerance)
        w = self.lift(velocities, ("s", -1, -1))(scene, problem, trials)
        taken = jnp.broadcast_to(h, jnp.shape(memory.step_size))
        after = SweptState(taken, self.lift(impulses, ("s", -1, -1))(scene, problem, trials))
        if problem.lengths is not None:
            error = self._length_error(scene, h, problem, trials)
            met = error.relative <= LARGEST_LENGTH_ERROR if self.tolerance is None else error.largest <= self.tolerance
            # NaN in place of an exception: the others of a population go on, and this robot is marked as failed
            w = jnp.where(met, w, jnp.nan)
        return w, after

    def _length_error(self, scene, h, problem, trials):
        return self.lift(length_error, ("s", None, -1, -1))(scene, h, problem, trials)

    def _constrain(self, scene, h, problem, trials, sweeps, tolerance=None, converged=True):
        """Trial impulses after a number of sweeps, or after as many as the tolerance needs.

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
        """The derivative of the sweeps' limit, where each node belongs to one strut.

        Sweeps change the trial impulses to z = z0 - S u, until F(z) = 0. S are the impulses along the struts, u the
        nodes' motion by impulses of 1 (`pushes`), and F the error of the squared lengths (`length_gap`). By the
        implicit function theorem, the derivative of S is the derivative of F at constant S, divided by -dF/dS. It costs
        less than the derivative of one sweep, and no earlier sweep is needed for it.
        """
        scene_dot, problem_dot, before_dot = rates
        partial = self.lift(rates_at_impulses, (-1, -1, -1, -1, -1))(problem, problem_dot, before, before_dot, after)
        at, along = (scene, problem, after), (scene_dot, problem_dot, partial)
        _, missed, slope = jax.jvp(self.lift(length_gap, ("s", -1, -1)), at, along, has_aux=True)
        return self.lift(rates_at_lengths, ("s", -1, -1, -1, -1))(scene, problem, partial, missed, slope)

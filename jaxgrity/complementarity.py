"""Exact contact and rigid struts: a time step whose velocities satisfy constraints.

The scheme is Moreau's and Jean's: forces act on the velocity, impulses then make it satisfy the constraints at the end
of the step. M. Jean 1999, doi:10.1016/S0045-7825(98)00383-1; Stewart and Trinkle 1996.
"""

from collections.abc import Callable
from typing import ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.actuation import rest_length
from jaxgrity.constraints import length_error, prepare, sweep, usual_sweeps
from jaxgrity.scene import Scene
from jaxgrity.structure import InputError, edge_lengths

MISSED = 1e-3
"""of its length, by which no strut may be off at the end of a step: more sweeps, or smaller steps, are needed there"""

VIOLATED = 1e-6
"""m, by which a start may violate the constraints"""


def check_start(scene: Scene, q: np.ndarray) -> None:
    """Refuse a start from which one step would have to jump.

    Raises `InputError` where a node lies below exact ground, or a rigid strut does not have its length L(0).
    """
    struts, ground = scene.structure.struts, scene.ground
    if ground is not None and ground.exact:
        depth = -(q @ np.array(ground.normal))
        node = int(np.argmax(depth))
        if depth[node] > VIOLATED:
            raise InputError(
                f"node {node} starts {depth[node]:.3g} m below the ground; expected: on exact contact, on or above it"
            )
    if struts is not None and struts.rigid:
        lengths, wanted = edge_lengths(q, struts.edges), np.asarray(rest_length(struts, scene.gait, 0.0, 0))
        strut = int(np.argmax(np.abs(lengths - wanted)))
        if abs(lengths[strut] - wanted[strut]) > VIOLATED:
            raise InputError(
                f"strut {strut} starts {lengths[strut]:.6g} m long; expected {wanted[strut]:.6g} m, its rest length at "
                "t = 0, since it is rigid"
            )


class Complementarity(diffrax.AbstractSolver):
    """A leapfrog with constraints: v lives in the middle of the steps, and forces act on it at the nodes' positions.

    From q at t0 and v in the middle of the last step, of size h0:

        w = v + (h0 + h)/2 M^-1 F(q, (v + w)/2, t0) + impulses,    q1 = q + h w.

    The first step starts from v at t0 (h0 = 0). Dissipative forces need w: sweeps with F(q, v, t0) foretell it, the
    last ones use what they foretold. The order is 2 where nothing begins or ends to touch, stick or slip, and 1 there.

    The last thing that a sweep does is to put every node on or above the ground, so no node is ever below a plane at
    the end of a step. A robot whose struts are off by more than `MISSED` of their lengths, or by more than the
    tolerance, at the end of a step gets NaN.
    """

    sweeps: int | None = eqx.field(static=True, default=None)
    """over all constraints, in a step; the most there are where a tolerance is given. None: `usual_sweeps`"""
    tolerance: float | None = eqx.field(static=True, default=None)
    """m: sweeps end where every strut has its length within this. None: after all sweeps"""
    prepare: Callable = eqx.field(static=True, default=prepare)
    """as the function of this module, or mapped over a population"""
    sweep: Callable = eqx.field(static=True, default=sweep)
    """likewise"""
    length_error: Callable = eqx.field(static=True, default=length_error)
    """likewise"""
    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable] = diffrax.LocalLinearInterpolation

    def order(self, terms):
        return 1

    def init(self, terms, t0, t1, y0, args):
        none = jnp.zeros_like(y0[0][:, 0])
        return jnp.zeros_like(t1 - t0), (none, none, none)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        (q, v), h = y0, t1 - t0
        kick = (solver_state[0] + h) / 2
        none = jnp.zeros_like(q[:, 0])
        problem = self.prepare(args, h, t1, q, v)

        def constrain(w, impulses, sweeps, tolerance=None):
            return self._constrain(args, h, problem, (w, impulses), sweeps, tolerance)

        _, a = terms.vf(t0, y0, args)
        w, impulses = v + kick * a, (none, none, none)
        if args.dissipates:
            w, impulses = constrain(w, impulses, usual_sweeps(args))
            _, corrected = terms.vf(t0, (q, (v + w) / 2), args)
            w = w + kick * (corrected - a)
        w, impulses = constrain(w, impulses, self.sweeps or usual_sweeps(args), self.tolerance)
        if "lengths" in problem:
            allowed = MISSED * problem["lengths"].min(0) if self.tolerance is None else self.tolerance
            w = jnp.where(self.length_error(args, h, problem, w) <= allowed, w, jnp.nan)
        y1 = (q + h * w, w)
        return y1, None, {"y0": y0, "y1": y1}, (h, impulses), diffrax.RESULTS.successful

    def _constrain(self, scene, h, problem, state, sweeps, tolerance):
        """`state` = (w, impulses) after so many sweeps, or after as many as the tolerance needs."""

        # rolled up, and outside the map over a population: unrolled sweeps, or mapped loops, are many times slower
        if tolerance is None:
            return jax.lax.fori_loop(0, sweeps, lambda _, s: self.sweep(scene, h, problem, *s), state)

        def off(state):
            return self.length_error(scene, h, problem, state[0])

        def short_of(carry):
            done, state = carry
            return (done < sweeps) & jnp.any(off(state) > tolerance)

        def again(carry):
            return carry[0] + 1, self.sweep(scene, h, problem, *carry[1])

        return jax.lax.while_loop(short_of, again, (0, state))[1]

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

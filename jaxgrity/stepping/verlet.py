"""Velocity Verlet, the symplectic method, for scenes without dissipation."""

from collections.abc import Callable
from typing import ClassVar

import diffrax
import jax
import jax.numpy as jnp


class Verlet(diffrax.AbstractSolver):
    """Velocity Verlet, symplectic, order 2, fixed step, for forces of position and time alone.

    v' = v + h/2 a(q, t); q1 = q + h v'; v1 = v' + h/2 a(q1, t1). One force evaluation a step: the solver's state is
    the acceleration at the end of the last one (Hairer, Lubich, Wanner 2006, section I.1.4).
    """

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable] = diffrax.ThirdOrderHermitePolynomialInterpolation.from_k

    def order(self, terms):
        return 2

    def init(self, terms, t0, t1, y0, args):
        return terms.vf(t0, y0, args)[1]

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        (q, v), a, h = y0, solver_state, t1 - t0
        half = v + h / 2 * a
        q1 = q + h * half
        a1 = terms.vf(t1, (q1, half), args)[1]
        y1 = (q1, half + h / 2 * a1)
        k = jax.tree.map(lambda start, end: h * jnp.stack([start, end]), (v, a), (y1[1], a1))
        return y1, None, dict(y0=y0, y1=y1, k=k), a1, diffrax.RESULTS.successful

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

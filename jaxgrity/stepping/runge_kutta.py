"""Classical Runge-Kutta of order 4; its stages are a loop that stores each once."""

from collections.abc import Callable
from typing import ClassVar

import diffrax
import jax
import jax.numpy as jnp
import numpy as np


class RK4(diffrax.AbstractSolver):
    """Classical Runge-Kutta, order 4, fixed step (Kutta 1901; Hairer, Norsett, Wanner 1993, table 1.2).

    With k_i = f(t + c_i h, Y_i) and Y_1 = y, each stage needs the last alone: Y_i+1 = y + h a_i+1,i k_i. Since h k_i
    = (Y_i+1 - y)/a_i+1,i, the step's end needs no other: y1 = y + (Y_2 - y)/3 + 2/3 (Y_3 - y) + (Y_4 - y)/3 + h/6 k_4.
    The stages are a loop, and each is stored once: written out, XLA computes them anew for each of their uses. Saving
    in the middle of steps costs two more evaluations a step, of f at its ends.
    """

    tableau: ClassVar[diffrax.ButcherTableau] = diffrax.ButcherTableau(
        c=np.array([1 / 2, 1 / 2, 1.0]),
        a_lower=(np.array([1 / 2]), np.array([0.0, 1 / 2]), np.array([0.0, 0.0, 1.0])),
        b_sol=np.array([1 / 6, 1 / 3, 1 / 3, 1 / 6]),
        b_error=np.zeros(4),
    )
    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable] = diffrax.ThirdOrderHermitePolynomialInterpolation.from_k

    def order(self, terms):
        return 4

    def init(self, terms, t0, t1, y0, args):
        return None

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        h = t1 - t0
        b, below = self.tableau.b_sol, np.array([row[-1] for row in self.tableau.a_lower])
        columns = [0, *self.tableau.c], [0, *b[:-1] / below], [*below, b[-1]], [0, 0, 0, 1]
        c, weight, a, last = (jnp.asarray(x, h.dtype) for x in columns)

        def stage(i, carry):
            y, so_far = carry
            k = terms.vf(t0 + c[i] * h, y, args)
            so_far = jax.tree.map(lambda s, y, y0: s + weight[i] * (y - y0), so_far, y, y0)
            y = jax.tree.map(lambda y0, s, k: y0 + last[i] * s + a[i] * h * k, y0, so_far, k)
            return y, so_far

        # in reverse mode a stage is computed again: that costs less than to store all that its result depends on
        again = jax.checkpoint(stage, prevent_cse=False)
        y1, _ = jax.lax.fori_loop(0, 4, again, (y0, jax.tree.map(jnp.zeros_like, y0)))
        ends = jax.tree.map(lambda *k: h * jnp.stack(k), self.func(terms, t0, y0, args), self.func(terms, t1, y1, args))
        return y1, None, dict(y0=y0, y1=y1, k=ends), None, diffrax.RESULTS.successful

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

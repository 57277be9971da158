"""The methods that integrate the equations of motion, as diffrax solvers, by their names."""

from collections.abc import Callable
from typing import ClassVar, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from jaxgrity.complementarity import Complementarity
from jaxgrity.structure import InputError


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

        # in reverse mode a stage is computed again: that costs less than to store what leads to it
        again = jax.checkpoint(stage, prevent_cse=False)
        y1, _ = jax.lax.fori_loop(0, 4, again, (y0, jax.tree.map(jnp.zeros_like, y0)))
        ends = jax.tree.map(lambda *k: h * jnp.stack(k), self.func(terms, t0, y0, args), self.func(terms, t1, y1, args))
        return y1, None, dict(y0=y0, y1=y1, k=ends), None, diffrax.RESULTS.successful

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)


class Verlet(diffrax.AbstractSolver):
    """Velocity Verlet, symplectic, order 2, fixed step, for forces that depend on position and time alone.

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


class Method(NamedTuple):
    """One way to integrate: `step` builds the solver for steps of fixed size, `adapt` for those that its error sets."""

    name: str
    order: int
    step: Callable[[], diffrax.AbstractSolver]
    adapt: Callable[[], diffrax.AbstractSolver] | None = None
    implicit: bool = False
    symplectic: bool = False
    constrained: bool = False
    """whether it meets rigid struts and exact contact, as only complementarity stepping does"""

    @property
    def adaptive(self) -> bool:
        return self.adapt is not None


Build = Callable[[], diffrax.AbstractSolver]


def _implicit(kind: type) -> tuple[Build, Build]:
    """A Kvaerno method for fixed and for adapted steps, with full Newton iterations.

    diffrax's default, which keeps one Jacobian for all iterations, converges so slowly where contact, friction and
    cables switch that most steps are rejected. A tolerance much tighter than 1e-9 fails there in turn.
    """
    by_error = diffrax.with_stepsize_controller_tols(optimistix.Newton)
    fixed: optimistix.Newton = optimistix.Newton(rtol=1e-9, atol=1e-9, norm=optimistix.max_norm)
    return lambda: kind(root_finder=fixed), lambda: kind(root_finder=by_error())


METHODS = {
    method.name: method
    for method in (
        Method("rk4", 4, RK4),
        Method("tsit5", 5, diffrax.Tsit5, diffrax.Tsit5),
        Method("dopri8", 8, diffrax.Dopri8, diffrax.Dopri8),
        Method("kvaerno3", 3, *_implicit(diffrax.Kvaerno3), implicit=True),
        Method("kvaerno5", 5, *_implicit(diffrax.Kvaerno5), implicit=True),
        Method("symplectic", 2, Verlet, symplectic=True),
        Method("complementarity", 1, Complementarity, constrained=True),
    )
}


def find_method(name: str) -> Method:
    """The method called `name`. Raises `InputError` where there is none."""
    if name not in METHODS:
        raise InputError(f"method = {name!r}: unknown; expected one of {', '.join(METHODS)}")
    return METHODS[name]


def amplification(method: Method, z: np.ndarray) -> np.ndarray:
    """|R(z)|, by how much one explicit step of size h multiplies a mode y' = lambda y, z = h lambda.

    Runge-Kutta: R(z) = 1 + z b^T (1 - z A)^-1 1. Verlet, on a mode of frequency |lambda|: 1 up to |z| = 2, then
    w + sqrt(w^2 - 1) with w = |z|^2/2 - 1.
    """
    z = np.atleast_1d(np.asarray(z, complex))
    if method.symplectic:
        w = np.maximum(np.abs(z) ** 2 / 2 - 1, 1)
        return w + np.sqrt(w * w - 1)
    tableau = method.step().tableau  # type: ignore[attr-defined]
    stages = len(tableau.b_sol)
    a = np.zeros((stages, stages))
    for row, entries in enumerate(tableau.a_lower, start=1):
        a[row, : len(entries)] = entries
    inverse = np.linalg.inv(np.eye(stages) - z[:, None, None] * a)
    return np.abs(1 + z * np.einsum("i,zij->z", tableau.b_sol, inverse))

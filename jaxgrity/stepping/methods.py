"""Integration methods by name, as diffrax solvers, with their properties."""

import warnings
from collections.abc import Callable
from typing import NamedTuple

import diffrax
import numpy as np
import optimistix

from jaxgrity.core.errors import InputError, check_known
from jaxgrity.core.typed import typed
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.coupled_stepping import CoupledImpulses
from jaxgrity.stepping.runge_kutta import RK4
from jaxgrity.stepping.swept import SweptImpulses
from jaxgrity.stepping.timed_contact import TimedImpulses, untimed
from jaxgrity.stepping.timed_coupled import TimedCoupledImpulses
from jaxgrity.stepping.verlet import Verlet

Build = Callable[[], diffrax.AbstractSolver]


class Method(NamedTuple):
    """An integration method and its properties. The library asks for these properties, never for the name.

    A method that is neither implicit nor symplectic nor constrained needs a solver with a Butcher `tableau`, which
    predicts its stability.
    """

    name: str
    order: int
    fixed: Build
    """builds the solver for steps of fixed size"""
    adaptive: Build | None = None
    """builds the solver for adaptive steps; None: no error estimate"""
    coupled: Build | None = None
    """builds the solver that solves struts and contacts together; None: no such variant"""
    refuses: Callable[[Scene, bool], str | None] = lambda scene, coupled: None
    """what of a scene it cannot solve, if struts and contacts are solved together or not; None: nothing"""
    implicit: bool = False
    """whether it solves equations in each step; it is then stable at any step, and computes robot by robot"""
    symplectic: bool = False
    """whether it needs forces that are independent of velocity"""
    constrained: bool = False
    """whether impulses satisfy the constraints in each step: exact contact, and rigid struts that a gait or motors
    move. Other methods keep distances that are constant"""
    recomputes: bool = False
    """whether a step recomputes its stages in reverse mode, and so needs no checkpoint"""


METHODS: dict[str, Method] = {}
"""Integration methods, by name."""

ALIASES = {"symplectic": "verlet"}
"""Former names of methods, with their present names."""


@typed
def register_method(method: Method) -> Method:
    """Register your own method. Returns it.

    Raises `InputError` if the name is taken, or an explicit method has no tableau.
    """
    if method.name in METHODS or method.name in ALIASES:
        raise InputError(f"method = {method.name!r}: there is one of this name already; expected another name")
    plain = not (method.implicit or method.symplectic or method.constrained)
    if plain and not hasattr(method.fixed(), "tableau"):
        raise InputError(f"method = {method.name!r}: its solver has no tableau; expected a diffrax.ButcherTableau")
    METHODS[method.name] = method
    return method


def find_method(name: str) -> Method:
    """The method with this name. Raises `InputError` if there is none."""
    if name in ALIASES:
        warnings.warn(f"method {name!r} is now called {ALIASES[name]!r}", FutureWarning, stacklevel=2)
        name = ALIASES[name]
    check_known("method", name, METHODS)
    return METHODS[name]


def check_solves(method: Method, scene: Scene, coupled: bool) -> None:
    """Refuse a scene, with struts and contacts `coupled` or not, that the method cannot solve."""
    if what := method.refuses(scene, coupled):
        raise InputError(f"method = {method.name!r}: {what}; expected {constrained_method().name!r}")


def constrained_method() -> Method:
    """The first method whose impulses satisfy constraints."""
    return next(method for method in METHODS.values() if method.constrained)


@typed
def default_method(scene: Scene) -> Method:
    """The default method: complementarity if the scene has constraints, otherwise rk4."""
    return constrained_method() if scene.constrained else next(iter(METHODS.values()))


def amplification(method: Method, z: np.ndarray) -> np.ndarray:
    """Factor |R(z)| of an explicit step of size h on a mode y' = lambda y, with z = h lambda.

    Runge-Kutta: R(z) = 1 + z b^T (1 - z A)^-1 1. Verlet, for a mode of frequency |lambda|: 1 up to |z| = 2, then
    w + sqrt(w^2 - 1) with w = |z|^2/2 - 1.
    """
    z = np.atleast_1d(np.asarray(z, complex))
    if method.symplectic:
        w = np.maximum(np.abs(z) ** 2 / 2 - 1, 1)
        return w + np.sqrt(w * w - 1)
    tableau = method.fixed().tableau  # type: ignore[attr-defined]
    stages = len(tableau.b_sol)
    a = np.zeros((stages, stages))
    for row, entries in enumerate(tableau.a_lower, start=1):
        a[row, : len(entries)] = entries
    inverse = np.linalg.inv(np.eye(stages) - z[:, None, None] * a)
    return np.abs(1 + z * np.einsum("i,zij->z", tableau.b_sol, inverse))


def _implicit(kind: type) -> tuple[Build, Build]:
    """A Kvaerno method for fixed and for adaptive steps, with full Newton iterations.

    By default diffrax keeps one Jacobian for all iterations. Where contact, friction and cables switch, this converges
    so slowly that most steps are rejected. A tolerance much tighter than 1e-9 fails there too.
    """
    by_error = diffrax.with_stepsize_controller_tols(optimistix.Newton)
    fixed: optimistix.Newton = optimistix.Newton(rtol=1e-9, atol=1e-9, norm=optimistix.max_norm)
    return lambda: kind(root_finder=fixed), lambda: kind(root_finder=by_error())


for _method in (
    Method("rk4", 4, RK4, recomputes=True),
    Method("tsit5", 5, diffrax.Tsit5, diffrax.Tsit5),
    Method("dopri8", 8, diffrax.Dopri8, diffrax.Dopri8),
    Method("kvaerno3", 3, *_implicit(diffrax.Kvaerno3), implicit=True),
    Method("kvaerno5", 5, *_implicit(diffrax.Kvaerno5), implicit=True),
    Method("verlet", 2, Verlet, symplectic=True),
    Method("complementarity", 1, SweptImpulses, coupled=CoupledImpulses, constrained=True),
    Method("complementarity2", 1, TimedImpulses, coupled=TimedCoupledImpulses, refuses=untimed, constrained=True),
):
    register_method(_method)

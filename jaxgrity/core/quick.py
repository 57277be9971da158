"""Programs that run a few times only: how long XLA takes to compile them matters more than how fast they are."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import equinox as eqx
import jax

from jaxgrity.core.tracing import compiling, traced

P = ParamSpec("P")
R = TypeVar("R")

OPTIONS = {"xla_backend_optimization_level": 0}
"""Options of XLA's compiler for CPUs. Together with older kernels they compile in a quarter of the time."""
OLDER_KERNELS = {"xla_cpu_use_fusion_emitters": False}
"""The same, of JAX below 0.11 (see `cli/script.py`)."""


def compiled_quickly(function: Callable[P, R]) -> Callable[P, R]:
    """`eqx.filter_jit`, which on CPUs spends little time on optimising the program.

    Inside another compiled function, and where its arguments are traced, it is `eqx.filter_jit` alone: JAX takes such
    options for whole programs only.
    """
    options = OPTIONS | (OLDER_KERNELS if jax.__version_info__ < (0, 11) else {})
    usual = eqx.filter_jit(function)
    quick = eqx.filter_jit(function, compiler_options=options)  # type: ignore[call-overload]

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        whole = jax.default_backend() == "cpu" and not compiling() and not traced((args, kwargs))
        return (quick if whole else usual)(*args, **kwargs)

    return run

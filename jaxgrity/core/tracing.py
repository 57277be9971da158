"""Known numbers and tracers: the latter stand for numbers during differentiation or compilation."""

from contextlib import AbstractContextManager, nullcontext
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from jaxgrity.core.arguments import check_number
from jaxgrity.core.errors import InputError


def traced(tree: Any) -> bool:
    """Whether any number of it is a tracer, of unknown value."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def refuse_traced(tree: Any, where: str, instead: str = "differentiate a `rollout` in its place") -> None:
    """Raises `InputError` for a traced number in `tree`: `where` cannot take it, `instead` can."""
    if traced(tree):
        raise InputError(f"{where}: its numbers have to be known, under grad, jit and vmap too; {instead}")


def as_incline(x: object) -> float:
    """Of a plane, rad, less than a right angle: a part of the compiled program itself.

    Raises `InputError` for another one, and where it is being traced.
    """
    if isinstance(x, jax.core.Tracer):
        raise InputError("incline: it is being traced; expected a known number (gravity can lean instead: Scene.up)")
    incline = check_number("incline", x if isinstance(x, str) else np.asarray(x)[()], unit="rad")
    if not abs(incline) < np.pi / 2:
        raise InputError(f"incline = {incline:g} rad: expected an angle of less than pi/2 from level ground")
    return incline


def compiling() -> bool:
    """Whether a function around the caller is being compiled, so that operations on known numbers are traced too."""
    return traced(jnp.zeros(()))


def evaluated() -> AbstractContextManager:
    """A context in which known numbers have known results, also during the compilation of a function around it.

    Elsewhere it does nothing: `ensure_compile_time_eval` would make JAX run jitted functions operation by operation,
    which takes seconds.
    """
    return jax.ensure_compile_time_eval() if compiling() else nullcontext()


def forward_mode_only(tree: Any, instead: str) -> Any:
    """The tree itself; reverse mode through it raises `InputError` with this message, before a later failure."""
    return jax.tree.map(lambda x: _forward_only.bind(x, instead=instead), tree)


def _no_way_back(cotangent, x, *, instead):
    raise InputError(instead)


_forward_only = Primitive("forward_mode_only")
_forward_only.def_impl(lambda x, instead: x)
_forward_only.def_abstract_eval(lambda x, instead: x)
ad.deflinear2(_forward_only, _no_way_back)
batching.primitive_batchers[_forward_only] = lambda x, axes, instead: (_forward_only.bind(*x, instead=instead), axes[0])
mlir.register_lowering(_forward_only, lambda ctx, x, instead: [x])

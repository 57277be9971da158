"""Whether numbers are known, or only stand for those of a function that is being differentiated or compiled."""

from contextlib import AbstractContextManager, nullcontext
from typing import Any

import jax
import jax.numpy as jnp

from jaxgrity.core.errors import InputError


def traced(tree: Any) -> bool:
    """Whether any number of it is a tracer, whose value is not known."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def refuse_traced(tree: Any, where: str, instead: str) -> None:
    """Raises `InputError` where a number of `tree` is being traced, which `where` cannot take; `instead` of it what can."""
    if traced(tree):
        raise InputError(f"{where}: its numbers have to be known, under grad, jit and vmap too; {instead}")


def evaluated() -> AbstractContextManager:
    """Within it operations on known numbers have known results, also where a function around it is being compiled.

    Elsewhere it does nothing: `ensure_compile_time_eval` would make JAX run jitted functions operation by operation,
    which takes seconds.
    """
    return jax.ensure_compile_time_eval() if traced(jnp.zeros(())) else nullcontext()

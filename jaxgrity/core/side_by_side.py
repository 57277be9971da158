"""Linear algebra and loops of one system, or of many side by side.

Further axes, after those of one system, count the systems: (rows, columns) become (rows, columns, systems). All is then
elementwise in the last axis, which a CPU does in vectors. JAX's own rules for many put their axis first.
"""

import itertools
from collections.abc import Callable
from functools import reduce
from operator import add
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.types import AnyArray

WRITTEN_OUT = 64
"""Most terms of a sum that is written out for many systems."""


def contracted(axes: str, a: AnyArray, b: AnyArray) -> AnyArray:
    """The sum of products that `axes` names as `jnp.einsum` does, for instance "ij,j->i", of one system or many."""
    (of_a, of_b), out = axes.split("->")[0].split(","), axes.split("->")[1]
    if a.ndim == len(of_a):
        # a sum of all products is part of XLA's loop around it, where einsum's would be a call
        return jnp.einsum(axes, a, b) if out else jnp.sum(a * b)
    summed = "".join(axis for axis in of_a if axis not in out)
    ranges = [range(a.shape[of_a.index(axis)]) for axis in summed]
    if not 0 < np.prod([len(each) for each in ranges]) <= WRITTEN_OUT:
        return jnp.einsum(f"{of_a}...,{of_b}...->{out}...", a, b)
    terms = (dict(zip(summed, numbers)) for numbers in itertools.product(*ranges))
    return kept(reduce(add, (_at(a, of_a, out, term) * _at(b, of_b, out, term) for term in terms)))


def _at(x: AnyArray, axes: str, out: str, term: dict[str, int]) -> AnyArray:
    """The entries of `x` in one term of a sum, with an axis for each of `out`."""
    x = x[tuple(term.get(axis, slice(None)) for axis in axes)]
    left = [axis for axis in axes if axis not in term]
    order = sorted(range(len(left)), key=lambda k: out.index(left[k]))
    x = x.transpose(*order, *range(len(left), x.ndim))
    return jnp.expand_dims(x, [k for k, axis in enumerate(out) if axis not in left])


def kept(x: AnyArray) -> AnyArray:
    """x, divided by a 1 unknown to XLA, which keeps quotients, and computes sums of products anew for each use."""
    return x / (x == x).astype(x.dtype)


def applied(matrix: AnyArray, x: AnyArray) -> AnyArray:
    """matrix @ x, where `x`, of any shape, is read as one vector; of one system or many."""
    return contracted("ij,j->i", matrix, x.reshape(matrix.shape[1:])).reshape(x.shape)


def for_many(constant: Any, like: AnyArray) -> AnyArray:
    """A constant of one system, of the type of `like`, (systems...), as one of many."""
    return jnp.asarray(constant, like.dtype).reshape(*np.shape(constant), *[1] * like.ndim)


def where_needed(needed: AnyArray, compute: Callable, otherwise: Any) -> Any:
    """`compute()` in the systems that need it, `otherwise` in others; not computed where none needs it."""
    # a loop, since a condition under `jax.vmap` computes both
    once = lambda state: (jnp.zeros_like(needed), compute())  # noqa: E731
    return while_any(lambda state: state[0], once, (needed, otherwise))[1]


def while_any(unmet: Callable, step: Callable, state: Any) -> Any:
    """`jax.lax.while_loop`, until the last system is done; each stays as it is once `unmet`, (systems...), is false."""

    def again(state):
        going, after = unmet(state), step(state)
        return jax.tree.map(lambda new, old: jnp.where(going, new, old), after, state) if going.ndim else after

    return jax.lax.while_loop(lambda state: jnp.any(unmet(state)), again, state)


def alone_and_in_rows(one: Callable, rows: Callable) -> tuple[Callable, Callable]:
    """A function of one problem, and that of a row for each problem, which takes the place of `jax.vmap` of both."""
    alone, together = jax.custom_batching.custom_vmap(one), jax.custom_batching.custom_vmap(rows)

    @alone.def_vmap
    def robots(count: int, batched: Any, *problem):
        found = together(*_rows(count, batched, problem))
        return found, jax.tree.map(lambda _: True, found)

    @together.def_vmap
    def parts_of_robots(count: int, batched: Any, *problems):
        rows = _rows(count, batched, problems)
        parts = len(problems[-1][0]) if batched[-1] else len(problems[-1])
        # not -1: there may be no struts
        found = together(*jax.tree.map(lambda x: x.reshape(count * parts, *x.shape[2:]), rows))
        return jax.tree.map(lambda x: x.reshape(count, parts, *x.shape[1:]), found), jax.tree.map(lambda _: True, found)

    return alone, together


def _rows(count: int, batched: Any, arrays: Any):
    """The arrays with a first axis, (count, ...), those of one robot as often as there are robots."""
    return jax.tree.map(lambda many, x: x if many else jnp.broadcast_to(x, (count, *x.shape)), tuple(batched), arrays)

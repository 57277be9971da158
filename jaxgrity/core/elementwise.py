"""Elementwise functions of one or two numbers; their derivatives keep the population last.

JAX's own rules for the derivatives of `jnp.maximum` and `jnp.minimum` choose between arrays without the population
axis, and move it to the front (see `primitives.py`).
"""

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.types import AnyArray

Numbers = Float[AnyArray, "..."]


@jax.custom_jvp
def larger(a: Numbers, b: Numbers) -> Numbers:
    """The larger number; for equal ones the derivative is that of the first."""
    return jnp.maximum(a, b)


@jax.custom_jvp
def smaller(a: Numbers, b: Numbers) -> Numbers:
    """The smaller number, likewise."""
    return jnp.minimum(a, b)


@larger.defjvp
def _larger_jvp(primals, tangents):
    a, b = primals
    return larger(a, b), _chosen(a >= b, *tangents)


@smaller.defjvp
def _smaller_jvp(primals, tangents):
    a, b = primals
    return smaller(a, b), _chosen(a <= b, *tangents)


@jax.custom_jvp
def inverse_root(x: Numbers) -> Numbers:
    """1/sqrt(x) for x > 0, as the root of a quotient.

    Both are rounded alike on every processor. XLA's own `rsqrt` is not, and XLA also makes it of the quotient of a
    root. In float32 it begins with an approximation that depends on the length of the processor's vectors. In float64,
    with vectors of 256 bits, it calls a function for each number.
    """
    return jnp.sqrt(1 / x)


@inverse_root.defjvp
def _inverse_root_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    value = inverse_root(x)
    return value, x_dot * (value * value * value * -0.5)


@jax.custom_jvp
def magnitude(x: Numbers) -> Numbers:
    """|x|, with derivative 0 at x = 0."""
    return jnp.abs(x)


magnitude.defjvps(lambda x_dot, value, x: jnp.sign(x) * x_dot)


@partial(jax.custom_jvp, nondiff_argnums=(1, 2))
def clipped(x: Numbers, low: float, high: float) -> Numbers:
    """x, cut at `low` and `high`."""
    return jnp.clip(x, low, high)


@clipped.defjvp
def _clipped_jvp(low, high, primals, tangents):
    (x,), (x_dot,) = primals, tangents
    inside = ((x > low) & (x < high)).astype(x.dtype)
    return clipped(x, low, high), inside * x_dot


def _chosen(first, a_dot: Numbers, b_dot: Numbers) -> Numbers:
    share = first.astype(a_dot.dtype)
    return share * a_dot + (1 - share) * b_dot


@jax.custom_jvp
def sine(x: Numbers) -> Numbers:
    """sin x within 3e-7 (float32) and 1e-15 (float64) for |x| up to 1e4, by products and sums alone.

    On a CPU XLA calls the C library for each element of `jnp.sin`, once for each use in a loop.
    """
    y = _within_half_a_turn(x)
    return _sine_near_zero(jnp.maximum(jnp.minimum(y, np.pi - y), -np.pi - y))


@jax.custom_jvp
def cosine(x: Numbers) -> Numbers:
    """cos x, likewise."""
    return _sine_near_zero(np.pi / 2 - jnp.abs(_within_half_a_turn(x)))


sine.defjvps(lambda x_dot, value, x: cosine(x) * x_dot)
cosine.defjvps(lambda x_dot, value, x: -sine(x) * x_dot)


def _within_half_a_turn(x: Numbers) -> Numbers:
    """x less whole turns, from -pi to pi; a turn is in two parts, the first with few digits."""
    turns = jnp.round(x / (2 * np.pi))
    return x - turns * 6.28125 - turns * 0.00193530717958647692529


def _sine_near_zero(y: Numbers) -> Numbers:
    """Taylor's series; its first omitted term is below the rounding error for |y| up to pi/2."""
    square, last = y * y, 5 if y.dtype == jnp.float32 else 10
    found = (-1) ** last / math.factorial(2 * last + 1) * square
    for k in range(last - 1, 0, -1):
        found = (found + (-1) ** k / math.factorial(2 * k + 1)) * square
    return y + found * y


def rows_where(which: AnyArray, new: Any, old: Any) -> Any:
    """The tree whose arrays have the rows of `new` where `which`, (rows,), is true, and those of `old` elsewhere."""
    return jax.tree.map(lambda x, y: jnp.where(which.reshape(-1, *[1] * (x.ndim - 1)), x, y), new, old)


@jax.custom_jvp
def derived_as(value, like):
    """`value`, with the derivative of `like`. Programs that take no derivative do not compute `like`."""
    return value


@derived_as.defjvp
def _derived_as_jvp(primals, tangents):
    return primals[0], tangents[1]

"""Random numbers outside compiled programs: those of `jax.random` to the last bit, with less to compile.

XLA compiles `jax.random.normal` as long as a rollout, and anew for each shape. A number depends only on the key and its
place: one program makes the bits of all draws up to a size, and NumPy turns them into numbers as JAX does.
"""

from functools import partial

import jax
import numpy as np

from jaxgrity.core.tracing import compiling, traced
from jaxgrity.core.types import AnyArray

FEWEST = 4096
"""Numbers that a program makes at least: a search needs few more at once, and so makes one program."""


def uniform(key, shape: tuple[int, ...], dtype, low: float = 0.0, high: float = 1.0) -> AnyArray:
    """`jax.random.uniform`: from `low` to `high`."""
    if traced(key) or compiling():
        return jax.random.uniform(key, shape, dtype, low, high)
    return _between(key, shape, np.dtype(dtype), low, high)


def normal(key, shape: tuple[int, ...], dtype) -> AnyArray:
    """`jax.random.normal`: of mean 0 and variance 1."""
    if traced(key) or compiling():
        return jax.random.normal(key, shape, dtype)
    dtype = np.dtype(dtype)
    count = int(np.prod(shape))
    between = _between(key, (_room(count),), dtype, float(np.nextafter(dtype.type(-1), dtype.type(0))), 1.0)
    return (np.sqrt(dtype.type(2)) * np.asarray(jax.lax.erf_inv(between))[:count]).reshape(shape)


def _between(key, shape: tuple[int, ...], dtype: np.dtype, low: float, high: float) -> np.ndarray:
    """Mantissas of random bits are numbers from 1 to 2."""
    size, one = np.finfo(dtype), np.ones((), dtype)
    count = int(np.prod(shape))
    bits = np.asarray(_bits(key, _room(count), f"uint{size.bits}"))[:count]
    share = (bits >> bits.dtype.type(size.bits - size.nmant) | one.view(bits.dtype)).view(dtype) - one
    first, last = dtype.type(low), dtype.type(high)
    return np.maximum(first, share * (last - first) + first).reshape(shape)


def _room(count: int) -> int:
    """The size of a program's draw: a power of two, at least `FEWEST`."""
    return max(FEWEST, 1 << (count - 1).bit_length())


@partial(jax.jit, static_argnums=(1, 2))
def _bits(key, count: int, dtype: str) -> AnyArray:
    return jax.random.bits(key, (count,), dtype)

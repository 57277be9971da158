"""Numbers drawn outside of programs are those of `jax.random`."""

import jax
import numpy as np
import pytest

from jaxgrity.core import draws


@pytest.mark.parametrize("dtype", ["float32", pytest.param("float64", marks=pytest.mark.campaign)])
def test_draws_are_those_of_jax(dtype):
    """To the last bit, in any number, also within a function that is being compiled."""
    key = jax.random.key(3)
    for shape in ((), (5, 6, 7)):
        np.testing.assert_array_equal(draws.normal(key, shape, dtype), jax.random.normal(key, shape, dtype))
        wanted = jax.random.uniform(key, shape, dtype, -1.0, 3.0)
        np.testing.assert_array_equal(draws.uniform(key, shape, dtype, -1.0, 3.0), wanted)
        np.testing.assert_array_equal(jax.jit(lambda k, s=shape: draws.uniform(k, s, dtype, -1.0, 3.0))(key), wanted)
    assert draws.normal(key, (0, 2), dtype).shape == (0, 2)
    assert draws.normal(key, (3,), dtype).dtype == dtype


def test_draws_of_many_sizes_share_a_program():
    """Which compiled programs of JAX do not."""
    draws.normal(jax.random.key(0), (10, 3), "float32")
    made = draws._bits._cache_size()
    draws.uniform(jax.random.key(1), (64, 5), "float32")
    assert draws._bits._cache_size() == made

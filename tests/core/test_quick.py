"""Functions that are compiled quickly give what they give, also within other compiled functions and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.quick import compiled_quickly


@compiled_quickly
def cubes(x, factor):
    return factor * x**3


def test_alone_and_within_others():
    """Compiler options are for whole programs only: JAX refuses them in functions within others."""
    x = np.arange(3.0)
    for found in (cubes(x, 2), jax.jit(cubes)(x, 2), jax.vmap(cubes)(x, jnp.full(3, 2.0))):
        np.testing.assert_allclose(found, 2 * x**3, rtol=1e-12)
    np.testing.assert_allclose(jax.grad(lambda x: cubes(x, 2).sum())(x), 6 * x**2, rtol=1e-12)


def test_known_numbers_while_another_function_is_compiled():
    known = np.arange(3.0)

    @jax.jit
    def outer(x):
        return x * cubes(known, 2)

    np.testing.assert_allclose(outer(known), 2 * known**4, rtol=1e-12)

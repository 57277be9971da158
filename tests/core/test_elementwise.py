"""Functions element by element: their values and derivatives are those of NumPy's and JAX's own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity.core.elementwise import clipped, cosine, inverse_root, larger, magnitude, sine, smaller


@pytest.mark.parametrize(("dtype", "within"), [("float32", 3e-7), ("float64", 1e-15)])
def test_sine_and_cosine_are_those_of_numpy(dtype, within):
    """To rounding, near zero and far from it."""
    for size in (0.1, 10.0, 1e4):
        x = np.random.default_rng(0).uniform(-size, size, 10_000).astype(dtype)
        for own, numpys in ((sine, np.sin), (cosine, np.cos)):
            found = jax.jit(own)(x)
            assert found.dtype == dtype
            np.testing.assert_allclose(np.asarray(found, float), numpys(x.astype(float)), rtol=0, atol=within)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_inverse_roots(dtype):
    """1/sqrt(x) and its derivative, for numbers of any size."""
    x = np.logspace(-20, 20, 81).astype(dtype)
    tolerance = 8 * np.finfo(dtype).eps
    np.testing.assert_allclose(jax.jit(inverse_root)(x), x.astype(float) ** -0.5, rtol=tolerance)
    near = jnp.asarray(np.logspace(-3, 3, 7), dtype)
    slopes = jax.jit(lambda x: jax.jvp(inverse_root, (x,), (jnp.ones_like(x),))[1])(near)
    np.testing.assert_allclose(slopes, -0.5 * np.asarray(near, float) ** -1.5, rtol=tolerance)


def test_derivatives_of_a_sine_are_sines():
    """Of every order, forwards and backwards."""
    x = jnp.linspace(-7.0, 7.0, 29)
    third = jax.jit(jax.vmap(jax.grad(jax.jacfwd(jax.grad(sine)))))(x)
    np.testing.assert_allclose(third, -np.cos(x), atol=2e-15)
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.grad(cosine)))(x), -np.sin(x), atol=2e-15)


@pytest.mark.parametrize(
    ("own", "jaxs"),
    [
        (lambda x, y: larger(x, y), jnp.maximum),
        (lambda x, y: smaller(x, y), jnp.minimum),
        (lambda x, y: magnitude(x) * y, lambda x, y: jnp.abs(x) * y),
        (lambda x, y: clipped(x, -0.5, 1.0) * y, lambda x, y: jnp.clip(x, -0.5, 1) * y),
    ],
)
def test_values_and_slopes_are_those_of_jax(own, jaxs):
    """Away from their kinks."""
    x, y = np.random.default_rng(0).normal(size=(2, 50))
    np.testing.assert_array_equal(own(x, y), jaxs(x, y))
    for found, expected in zip(*(jax.jit(jax.vmap(jax.grad(f, argnums=(0, 1))))(x, y) for f in (own, jaxs))):
        np.testing.assert_array_equal(found, expected)

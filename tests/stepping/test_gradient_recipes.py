"""The gradient that a docstring shows is that of something: large beside rounding, and as differences say."""

import doctest

import jax
import jax.numpy as jnp
import pytest

import jaxgrity


@pytest.mark.slow
def test_the_example_of_final_state_says_what_falls(central_difference):
    """Its gradient is what it prints, not 0, and what differences say."""
    tests = doctest.DocTestFinder().find(jaxgrity.final_state, globs={"jaxgrity": jaxgrity, "jax": jax, "jnp": jnp})
    (example,) = [test for test in tests if test.examples]
    example.globs["eqx"] = __import__("equinox")
    result = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(example, clear_globs=False)
    assert result.attempted
    assert not result.failed
    height = example.globs["height"]
    slope = float(jax.grad(height)(jnp.asarray(9.81)))
    assert slope == pytest.approx(float(central_difference(height, jnp.asarray(9.81), 1e-3)), rel=1e-6)
    assert slope < -1e-3

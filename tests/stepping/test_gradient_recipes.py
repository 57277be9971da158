"""The gradients that docs and docstrings show are those of something: large beside rounding, and as differences say."""

import doctest
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

import jaxgrity

HOWTO = Path(__file__).parents[2] / "docs" / "howto.md"


@pytest.mark.slow
def test_the_recipe_for_gradients_is_that_of_a_motion(central_difference, capsys):
    """Of how far a robot rolls, by friction, in docs/howto.md: within a thousandth of the central difference."""
    text = HOWTO.read_text(encoding="utf-8")
    before, recipe = text.split("## ... get gradients")
    shown: dict = {}
    for block in (re.findall(r"```python\n(.*?)```", part, re.DOTALL)[0] for part in (before, recipe)):
        exec(block, shown)
    far, slope = float(shown["far"]), float(shown["slope"])
    assert f"{far:.3f} m" in capsys.readouterr().out
    assert far > 0.5
    assert abs(slope) > 0.1
    step = central_difference(jax.jit(lambda mu: shown["distance"](mu)), jnp.asarray(0.5), 1e-5)
    assert slope == pytest.approx(float(step), rel=1e-3)


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

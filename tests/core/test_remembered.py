"""Functions that keep their last answers: by numbers, not by which arrays hold them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrity
from jaxgrity.core.remembered import remembered
from jaxgrity.stepping import options


@pytest.fixture
def doubled():
    """A function that notes every call."""
    calls = []

    @remembered(2)
    def double(x, *, name=""):
        calls.append(name)
        if name == "bad":
            raise jaxgrity.InputError("bad")
        return 2 * x

    double.calls = calls
    return double


def test_equal_numbers_are_looked_up(doubled):
    """In another array, of NumPy or of JAX; another number, precision, shape or name is another call."""
    one = np.array([1.0, 2.0])
    first = doubled(one)
    assert doubled(one.copy()) is first
    assert doubled(jnp.asarray(one)) is first
    assert len(doubled.calls) == 1
    for x in (np.array([1.0, 3.0]), one.astype("float32"), one[None]):
        doubled(x)
    doubled(one, name="other")
    assert len(doubled.calls) == 5


def test_an_array_that_changed_is_another(doubled):
    """Its numbers count when it is passed."""
    x = np.array([1.0])
    doubled(x)
    x[0] = 5.0
    np.testing.assert_array_equal(doubled(x), [10.0])


def test_only_the_last_are_kept(doubled):
    """The one that was not used for longest goes."""
    for x in (1.0, 2.0, 1.0, 3.0, 1.0):
        doubled(x)
    assert len(doubled.calls) == 3
    doubled(2.0)
    assert len(doubled.calls) == 4


def test_what_is_traced_or_raised_is_not_kept(doubled):
    """A tracer has no number; an error is raised each time."""
    for _ in range(2):
        np.testing.assert_array_equal(jax.jit(doubled)(3.0), 6.0)
        with pytest.raises(jaxgrity.InputError):
            doubled(1.0, name="bad")
    assert doubled.calls.count("bad") == 2
    assert float(jax.grad(doubled)(3.0)) == 2.0


def test_options_are_checked_once_for_each_scene(exact, monkeypatch):
    """And anew where the scene is another, or float64 was switched off since."""
    checked = []
    monkeypatch.setattr(options, "step_fault", lambda *args: checked.append(args))
    asked = jaxgrity.SolverOptions(dt=1.234e-3, dtype="float64")
    for _ in range(3):
        options.resolve(exact, 1.0, asked)
    assert len(checked) == 1
    options.resolve(jaxgrity.with_gait(exact, None), 1.0, asked)
    assert len(checked) == 2
    with jax.enable_x64(False), pytest.raises(jaxgrity.InputError, match="jax_enable_x64"):
        options.resolve(exact, 1.0, asked)

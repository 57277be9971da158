"""Kinds of friction, and numbers that none has; `test_dissipation.py` has their forces."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import ConeFriction, InputError, SmoothFriction, SwitchFriction


@pytest.mark.parametrize(("mu_static", "mu_kinetic"), [(0.4, 0.5), (np.array([0.6, 0.4]), np.array([0.5, 0.5]))])
def test_static_friction_below_kinetic_is_refused(mu_static, mu_kinetic):
    """Of any node: friction would grow as it begins to slide."""
    with pytest.raises(
        InputError,
        match=r"friction\.mu_static(\[1\])? = 0\.4: expected at least mu_kinetic(\[1\])? = 0\.5, since friction",
    ):
        SwitchFriction(mu_static, mu_kinetic, 1e-3)


def test_static_and_kinetic_friction_may_be_one():
    """And their numbers may be traced, when nobody knows them."""
    assert SwitchFriction(0.5, 0.5, 1e-3).sliding_mu == 0.5
    SwitchFriction(jnp.asarray(0.4), jnp.asarray(0.5), 1e-3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SmoothFriction(-0.1, 0.01), r"friction\.mu = -0\.1: expected a finite number, at least 0"),
        (lambda: SmoothFriction(0.5, 0.0), r"friction\.slip_speed = 0 m/s: expected a positive number"),
        (
            lambda: SwitchFriction(0.6, -0.5, 0.01),
            r"friction\.mu_kinetic = -0\.5: expected a finite number, at least 0",
        ),
        (lambda: SwitchFriction(0.6, 0.5, -0.01), r"friction\.slip_speed = -0\.01 m/s: expected a positive number"),
        (
            lambda: ConeFriction(np.array([0.5, -0.5])),
            r"friction\.mu\[1\] = -0\.5: expected a finite number, at least 0",
        ),
        (lambda: SwitchFriction(np.nan, 0.5, 0.01), r"friction\.mu_static = nan: expected a finite number"),
        (lambda: ConeFriction(np.nan), r"friction\.mu = nan: expected a finite number"),
    ],
)
def test_numbers_that_no_friction_has_are_refused(make, message):
    """By the name of the number."""
    with pytest.raises(InputError, match=message):
        make()

"""Derivatives of an orbit's speed in the numbers of its gait, by tangents that settle."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest

from jaxgrity import InputError, SolverOptions, load_gait, with_gait
from jaxgrity.orbits import closed_orbit, find_orbit, speed_gradient


def test_tangents_settle_at_the_derivative_of_closed_orbits(crawler):
    """On a smooth scene, where Newton's method closes orbits: by differences of their speeds."""
    scene, orbit, options = crawler
    found = speed_gradient(scene, orbit, options=options)
    assert found.settled
    np.testing.assert_allclose(found.speed, orbit.speed, rtol=1e-5)
    close = jax.jit(lambda s: closed_orbit(s, orbit, options))

    def speed(change):
        return float(close(eqx.tree_at(lambda s: s.gait.amplitude, scene, scene.gait.amplitude + change)).speed)

    expected = (speed(1e-4) - speed(-1e-4)) / 2e-4
    assert abs(expected) > 1e-3
    np.testing.assert_allclose(found.of_speed.amplitude, expected, rtol=1e-4)


def test_a_gait_that_begins_earlier_is_as_fast(crawler):
    """All phases together, overtones' twice, are a shift of time: no speed depends on it."""
    scene, orbit, options = crawler
    slope = speed_gradient(scene, orbit, options=options).of_speed
    shift = slope.phase.sum() + 2 * slope.overtones[0].phase.sum()
    assert abs(slope.phase.sum()) > 1e-3
    np.testing.assert_allclose(shift, 0, atol=1e-4 * abs(slope.phase.sum()))


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["amplitude", "frequency"])
def test_derivatives_agree_with_orbits_found_anew(exact, name):
    """With exact contact at a coarse step, by central differences that move no touch-down to another step."""
    options, h = SolverOptions(dt=0.01), 1e-6
    scene = with_gait(exact, load_gait("lasting"))
    found = speed_gradient(scene, find_orbit(scene, 80.0, options=options), options=options)
    assert found.settled

    def speed(change):
        gait = dataclasses.replace(scene.gait, **{name: np.asarray(getattr(scene.gait, name)) + change})
        return find_orbit(with_gait(scene, gait), 80.0, options=options).speed

    differences = (speed(h) - speed(-h)) / (2 * h)
    np.testing.assert_allclose(np.sum(getattr(found.of_speed, name)), differences, rtol=1e-5)


def test_what_has_no_derivative_is_refused(crawler):
    """A rollout that failed, and too few cycles to see tangents settle."""
    scene, orbit, options = crawler
    with pytest.raises(InputError, match="orbit: its rollout failed; expected one that was watched to the end"):
        speed_gradient(scene, orbit._replace(verified_for=0.0), options=options)
    with pytest.raises(InputError, match="most_cycles = 2: expected a whole number, at least 3"):
        speed_gradient(scene, orbit, options=options, most_cycles=2)

"""What a gait asks of its actuators."""

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxgrity import Gait, InputError, random_phases
from jaxgrity.model.actuation import Overtone, contraction, peak_rates, ramp_rates


def test_peak_rates_are_those_of_the_rest_lengths():
    """max |dL/dt| over a period by small differences in time: of single sines, and of Fourier series,
    short and long; of many gaits."""
    amplitude, frequency, lengths = np.array([0.3, 0.1]), np.array([0.5, 0.8]), np.array([1.0, 0.6])
    overtone = Overtone(np.array([0.4, 0.2]), np.array([0.3, 2.0]))
    for overtones in ((), (overtone,)):
        gait = Gait((0, 1), np.array([0.2, 1.1]), amplitude, frequency, start=0.0, ramp=1e-6, overtones=overtones)
        times = np.linspace(1.0, 11.0, 4001)
        shortened = np.asarray(jax.vmap(lambda t, gait=gait: contraction(gait, t))(times))
        steepest = lengths * np.abs(np.diff(shortened, axis=0)).max(0) / (times[1] - times[0])
        np.testing.assert_allclose(peak_rates(gait, lengths), steepest, rtol=2e-4)
    draw, angle = np.random.default_rng(0), np.linspace(0, 2 * np.pi, 40001)[:, None]
    many = tuple(Overtone(draw.uniform(0, 0.7, 2), draw.uniform(0, 6, 2)) for _ in range(20))
    slope = np.cos(angle) + sum(h * each.size * np.cos(h * angle + each.phase) for h, each in enumerate(many, start=2))
    steepest = np.abs(slope).max(0) / (1 + sum(each.size for each in many))
    rich = Gait((0, 1), np.zeros(2), amplitude, frequency, overtones=many)
    np.testing.assert_allclose(peak_rates(rich, lengths), lengths * amplitude * np.pi * frequency * steepest, rtol=1e-3)
    several = jax.tree.map(lambda x: np.stack([x, x]) if np.ndim(x) else x, gait)
    np.testing.assert_array_equal(peak_rates(several, lengths), np.stack([peak_rates(gait, lengths)] * 2))


@pytest.mark.parametrize(("start", "ramp"), [(0.3, 0.2), (1.0, 0.9), (0.0, 7.3)])
def test_rates_in_the_ramp_are_those_of_the_rest_lengths(start, ramp):
    """max |dL/dt| in ramps shorter and longer than a period, by small differences in time; of one gait and of many."""
    lengths, times = np.array([1.0, 0.6, 1.0, 1.0]), np.linspace(start, start + ramp, 40001)
    phase, frequency = np.array([0.2, 1.1, 4.0, 5.5]), np.array([0.5, 0.8, 1.3, 0.0])
    overtones = (Overtone(np.array([0.4, 0.2, 0, 0.1]), np.array([0.3, 2.0, 1.0, 4.0])),)
    for shape in ((), overtones):
        gait = Gait((0, 1, 2, 3), phase, np.array([0.3, 0.1, 0.4, 0.5]), frequency, start, ramp, shape)
        shortened = np.asarray(jax.vmap(lambda t, gait=gait: contraction(gait, t))(times))
        steepest = lengths * np.abs(np.diff(shortened, axis=0)).max(0) / (times[1] - times[0])
        np.testing.assert_allclose(ramp_rates(gait, lengths), steepest, rtol=1e-3)
        several = jax.tree.map(lambda x: np.stack([x, x]) if np.ndim(x) else x, gait)
        np.testing.assert_array_equal(ramp_rates(several, lengths), np.stack([ramp_rates(gait, lengths)] * 2))


def test_rates_in_a_ramp_of_a_small_part_of_a_period_are_right_to_a_thousandth():
    """Of 300 waves with six overtones; the steepest moment may be anywhere in the ramp."""
    draw, many = np.random.default_rng(0), 300
    overtones = tuple(Overtone(draw.uniform(0, 1, many), draw.uniform(0, 6, many)) for _ in range(6))
    phase, frequency = draw.uniform(0, 6, many), draw.uniform(0.05, 1.0, many)
    gait = Gait(tuple(range(many)), phase, np.full(many, 0.4), frequency, 0.3, 0.1, overtones)
    times = np.linspace(0.3, 0.4, 2001)
    shortened = np.asarray(jax.vmap(lambda t: contraction(gait, t))(times))
    steepest = np.abs(np.diff(shortened, axis=0)).max(0) / (times[1] - times[0])
    np.testing.assert_allclose(ramp_rates(gait, np.ones(many)), steepest, rtol=1e-3)


@pytest.mark.parametrize("dtype", [np.float32, pytest.param(np.float64, marks=pytest.mark.campaign)])
def test_at_a_corner_of_the_ramp_the_derivative_is_the_mean_of_both_sides(dtype):
    """The corners are at 0.3 and 0.8 s; sums of steps of 0.1 s miss both by their rounding.

    Beside a corner it is that of its side, and values are those of the formula to the last bit.
    """

    def shortened(start, t):
        one, half = np.ones(1, dtype), jnp.asarray(0.5, dtype)
        gait = Gait((0,), 0 * one, 0.5 * one, 0 * one, start, half)
        return contraction(gait, t)[0]

    sums = np.cumsum(np.full(8, 0.1, dtype), dtype=dtype)
    start = dtype(0.3)
    values, slopes = jax.vmap(jax.value_and_grad(shortened), (None, 0))(start, sums)
    assert np.any(sums[[2, 7]] != np.array([0.3, 0.8], dtype))
    np.testing.assert_array_equal(values, np.clip((sums - start) / dtype(0.5), 0, 1) / 4)
    np.testing.assert_allclose(slopes, [0, 0, -0.25, -0.5, -0.5, -0.5, -0.5, -0.25], rtol=1e-6)
    beside = np.array([0.2999, 0.3001, 0.7999, 0.8001], dtype)
    np.testing.assert_allclose(jax.vmap(jax.grad(shortened), (None, 0))(start, beside), [0, -0.5, -0.5, 0], rtol=1e-6)


def test_a_ramp_of_no_time_is_refused():
    """It would divide by zero before the gait begins."""
    with pytest.raises(InputError, match=r"^gait.ramp = 0 s: expected a positive number"):
        Gait((0,), [0.0], [0.1], [1.0], ramp=0.0)


@pytest.mark.parametrize(
    ("numbers", "name"), [((-3, 6, 0), "gaits = -3"), ((2, "6", 0), "actuators = '6'"), ((2, 6, -1), "seed = -1")]
)
def test_random_phases_need_whole_numbers(numbers, name):
    """In the words of all other numbers."""
    jaxtyping.config.update("jaxtyping_disable", True)  # which users do not have; of this test alone
    with pytest.raises(InputError, match=f"{name}: expected a whole number, at least 0"):
        random_phases(*numbers)


@pytest.mark.parametrize("members", [0, ("0",), (0.5,), (True,), ((0, 1),)])
def test_the_members_of_a_gait_are_whole_numbers(members):
    """One number alone is no list of them."""
    jaxtyping.config.update("jaxtyping_disable", True)  # which users do not have; of this test alone
    with pytest.raises(InputError, match=r"gait\.members = .*: expected whole numbers"):
        Gait(members, [0.0], [0.3], [1.0])

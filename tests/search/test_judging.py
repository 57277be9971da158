"""Errors that are said after a "±": redrawn many times, they cover the truth as often as they should."""

from dataclasses import replace

import numpy as np
import pytest

from jaxgrity import (
    ActuatorBounds,
    SolverOptions,
    SteadySpeed,
    gaits_of,
    random_phases,
    simulate_population,
    with_gait,
)
from jaxgrity.core.display import COVERING, mean_of_robots, with_error
from jaxgrity.model.actuation import Overtone
from jaxgrity.populations.metrics import Metrics
from jaxgrity.populations.population import roll_out
from jaxgrity.search.judging import Fitness, ensembles_rolled_out, influences, scored, standard_error
from jaxgrity.search.models import model_of
from jaxgrity.search.polish import gain_words

REDRAWS = 1500


def two_gaits(draw, pairs: int) -> np.ndarray:
    """(2, robots): what robots with opposite draws are worth; the second gait is better, and spreads more."""
    z = draw.uniform(-1, 1, (3, pairs))
    z = np.concatenate([z, -z], axis=1)
    first = 1.0 + 0.1 * z[0] - 0.2 * z[1] ** 2 + 0.02 * np.sign(z[2]) * z[0]
    second = 1.15 + 0.2 * z[0] - 0.5 * z[1] ** 2 - 0.6 * (z[2] > 0.8)
    return np.stack([first, second])


@pytest.fixture(scope="module")
def redrawn() -> list[np.ndarray]:
    draw = np.random.default_rng(0)
    return [two_gaits(draw, 64) for _ in range(REDRAWS)]


@pytest.mark.parametrize("caution", [0.0, 1.0])
def test_the_gain_of_a_polish_is_known_by_its_error(redrawn, caution):
    """The difference of two fitnesses, with the error of that, not of the means."""
    found = [scored(each, caution).fitness for each in redrawn]
    gains = np.array([after - before for before, after in found])
    errors = np.array([standard_error(np.subtract(*influences(each, caution)[::-1])) for each in redrawn])
    covered = np.abs(gains - gains.mean()) <= COVERING * errors
    assert 0.93 < covered.mean() < 0.98
    assert errors.mean() == pytest.approx(gains.std(), rel=0.06)


def test_a_mean_over_robots_is_known_by_its_error(redrawn):
    means = np.array([each[1].mean() for each in redrawn])
    errors = np.array([standard_error(each[1]) for each in redrawn])
    assert 0.93 < (np.abs(means - means.mean()) <= COVERING * errors).mean() < 0.98


@pytest.mark.parametrize("caution", [0.0, 1.0])
def test_few_robots_that_fall_are_allowed_for(caution):
    """One pair in 20 has a robot that falls behind, as on a rolling gait: many an ensemble has hardly any."""
    draw = np.random.default_rng(1)
    z = draw.uniform(-1, 1, (REDRAWS, 64))
    each = np.concatenate([0.8 + 0.01 * z, 0.8 - 0.01 * z - draw.uniform(0.2, 0.8, z.shape) * (z > 0.9)], axis=1)
    truth = scored(each.reshape(1, -1), caution).fitness[0]
    found = scored(each, caution).fitness
    says = influences(each, caution)
    plain = says.reshape(REDRAWS, 2, -1).mean(1).std(1, ddof=1) / 8
    errors = np.array([standard_error(one) for one in says])
    assert (np.abs(found - truth) <= COVERING * plain).mean() < 0.89
    assert 0.90 < (np.abs(found - truth) <= COVERING * errors).mean() < 0.99
    assert np.all(errors >= plain)


def test_robots_that_are_not_skewed_have_the_usual_error():
    """And the one of skewed robots does not depend on the unit, nor on the side to which they are."""
    level = np.repeat([-1.0, 1.0, 3.0], 2)[[0, 2, 4, 1, 3, 5]]
    assert standard_error(level) == pytest.approx(2 / np.sqrt(3), rel=1e-12)
    skewed = np.array([0.8, 0.8, 0.8, 0.1] * 4 + [0.8] * 16)
    assert standard_error(-1000 * skewed) == pytest.approx(1000 * standard_error(skewed), rel=1e-9)
    assert standard_error(np.ones(8)) == 0
    assert standard_error(np.ones(2)) == np.inf


def test_influences_have_the_fitness_as_their_mean(redrawn):
    """That of gaits whose robots are all alike too."""
    each = redrawn[0]
    np.testing.assert_allclose(influences(each, 0.7).mean(1), scored(each, 0.7).fitness, rtol=1e-12)
    np.testing.assert_array_equal(influences(np.ones((1, 4)), 0.7), np.ones((1, 4)))


def test_the_gain_is_said_with_two_of_its_errors(redrawn):
    """And the number beside it is what it is the error of."""
    each = redrawn[0]
    before, after = (scored(each[k : k + 1], 1.0) for k in (0, 1))
    gain = float(after.fitness[0] - before.fitness[0])
    error = 2 * standard_error(np.subtract(*influences(each, 1.0)[::-1]))
    assert gain_words(before, after, 1.0).startswith(
        f"fitness {'up' if gain > 0 else 'down'} by {abs(gain):.3f} ± {error:.2g}"
    )


def test_bounds_are_no_worth():
    """Fitness is in the objective's unit whatever the bounds; gaits within them come first, then those less beyond."""
    each = np.array([[0.9, 1.1], [2.0, 2.2], [3.0, 3.2], [0.1, np.nan], [-4.0, -4.2]])
    excess = np.array([[0, 0], [0, 0.2], [0.3, 0.1], [0, 0], [0, 0]])
    found = scored(each, 1.0, excess)
    np.testing.assert_allclose(found.fitness, [0.9, 2.0, 3.0, -np.inf, -4.2])
    np.testing.assert_array_equal(found.beyond, [0, 0.5, 1.0, 0, 0])
    np.testing.assert_array_equal(np.argsort(-found.merit), [0, 4, 1, 2, 3])
    np.testing.assert_array_equal(found.merit[[0, 4]], found.fitness[[0, 4]])


def test_any_fitness_counts_as_it_is():
    """In whatever unit, and however little a gait is worth."""
    worth = np.array([[-1500.0], [-5000.0], [-1e6], [1e9]])
    np.testing.assert_array_equal(scored(worth, 0.0).merit, worth[:, 0])
    over = scored(worth, 0.0, np.array([[0.0], [1e-6], [np.inf], [0.0]]))
    np.testing.assert_array_equal(np.argsort(-over.merit), [3, 0, 1, 2])


def test_the_gain_says_that_a_robot_failed(redrawn):
    each = redrawn[0]
    lost = np.where(np.arange(each.shape[1]) == 3, np.nan, each[:1])
    told = gain_words(scored(lost, 1.0), scored(each[1:], 1.0), 1.0)
    assert told == "a robot failed with the start's gait: the polished gait is kept"


def test_a_polish_that_changes_nothing_goes_neither_up_nor_down(redrawn):
    same = scored(redrawn[0][:1], 1.0)
    assert gain_words(same, same, 1.0) == "fitness unchanged: the gait is kept as it was"


def test_excess_is_the_share_beyond_each_bound():
    """Of rate, force and power, summed up; without bounds there is none."""
    none = np.zeros((2, 3))
    numbers = dict.fromkeys(Metrics._fields, none) | {
        "peak_force": np.tile([5.0, 20, 0], (2, 1)),
        "peak_power": np.repeat([[90.0], [30]], 3, axis=1),
    }
    rate, metrics = np.array([0.5, 1.5]), Metrics(**numbers)
    np.testing.assert_array_equal(ActuatorBounds().excess(rate, None), [0, 0])
    np.testing.assert_allclose(ActuatorBounds(rate=1.0).excess(rate, None), [0, 0.5])
    np.testing.assert_allclose(ActuatorBounds(1.0, 10.0, 60.0).excess(rate, metrics), [1 + 0.5, 0.5 + 1])


def test_the_gain_says_who_is_beyond_a_bound(redrawn):
    """And what is beyond is not kept for its worth."""
    each = redrawn[0]
    before = scored(each[:1], 0.0)
    over = np.zeros((1, each.shape[1]))
    over[0, ::4] = 0.1
    told = gain_words(before, scored(each[:1] + 1, 0.0, over), 0.0)
    assert told.startswith("fitness up by 1.000")
    assert told.endswith("robots; 25 % of them beyond a bound on actuators: the gait is kept as it was")


def test_means_over_robots_say_spread_and_error_apart():
    robots = {"mean": 0.6, "standard_deviation": 0.1, "standard_error": 0.01}
    assert mean_of_robots(robots, "m") == "0.60 ± 0.02 m (standard deviation 0.1)"
    assert mean_of_robots({**robots, "standard_error": None}, "") == "0.600 (error not known) (standard deviation 0.1)"
    lost = {**robots, "standard_error": None, "failed": 2}
    assert mean_of_robots(lost, "m") == "0.600 m (error not known) (standard deviation 0.1; 2 robots failed)"
    assert mean_of_robots({**lost, "standard_deviation": 0.0, "failed": 1}, "m") == "0.600 m (1 robot failed)"
    assert mean_of_robots({**lost, "mean": np.nan, "standard_deviation": np.nan}, "m") == "not known (2 robots failed)"


@pytest.mark.parametrize(
    ("value", "error", "digits", "decimals", "told"),
    [
        (0.808, 5e-8, ".1g", 3, "0.808 ± 0.0005"),
        (2.4181, 0.18, ".2g", 4, "2.42 ± 0.18"),
        (2.4181, 0.18, ".1g", None, "2.4 ± 0.2"),
        (0.815, 0.0019, ".1g", 3, "0.815 ± 0.002"),
        (3.3896, 11.0, ".2g", None, "3 ± 11"),
        (3.3896, 11.0, ".1g", None, "3 ± 10"),
        (2718.28, 314.0, ".1g", None, "2718 ± 300"),
        (0.13, 0.0996, ".2g", 2, "0.13 ± 0.1"),
        (1.2e-17, 3e-18, ".1g", None, "1.20e-17 ± 3e-18"),
        (0.004, 1e-6, ".1g", None, "0.004000 ± 1e-06"),
        (0.52637, 0.003, ".1g", None, "0.526 ± 0.003"),
        (0.0052637, 3e-5, ".1g", None, "0.00526 ± 3e-05"),
        (1.0, 0.0, ".1g", None, "1.000 ± 0.0005"),
        (-1e-12, 0.2, ".1g", None, "0.0 ± 0.2"),
        (0.81523, None, ".1g", 3, "0.815 (error not known)"),
        (0.81523, np.inf, ".1g", None, "0.815 (error not known)"),
    ],
)
def test_numbers_have_the_digits_that_their_errors_let_them_have(value, error, digits, decimals, told):
    """And errors are at least what rounding takes."""
    assert with_error(value, error, digits=digits, decimals=decimals) == told


def test_stages_of_a_search_share_programs(exact):
    """The number of parts, and the gait that a scene comes with, are inputs; paths are those of these parts alone."""
    gaits = gaits_of(exact.gait, random_phases(2, actuators=6, seed=0))
    shaped = replace(exact.gait, overtones=(Overtone(np.full(6, 0.1), np.zeros(6)),))
    options, made = SolverOptions(dt=0.01, dtype="float32"), roll_out._cached._cache_size()
    of_parts = {}
    for scene, parts in ((exact, 4), (with_gait(exact, shaped), 9)):
        model = model_of(scene, 0.3, options)
        *_, of_parts[parts] = ensembles_rolled_out(None, model, gaits, 0.3, Fitness(SteadySpeed()), parts, False)
    assert roll_out._cached._cache_size() == made + 1
    for parts, found in of_parts.items():
        alone = simulate_population(exact, gaits, 0.3, options=options, parts=parts)
        assert found.com_path.shape == (128, parts + 1, 3)
        np.testing.assert_array_equal(found.com_path[:2], alone.com_path)

"""Numbers in words."""

import pytest

from jaxgrity.core.display import finite_or, in_digits, known_words, mean_of_robots, significant, with_error


@pytest.mark.parametrize(
    ("value", "digits", "told"),
    [
        (1234.0, 3, "1230"),
        (999_499.0, 3, "999000"),
        (123.4, 2, "120"),
        (20000.0, 4, "20000"),
        (-1234.0, 2, "-1200"),
        (0.000123, 2, "0.00012"),
        (0.5, 3, "0.5"),
        (0.0, 3, "0"),
        (-0.0, 3, "0"),
        (1.0000004, 8, "1.0000004"),
        (float("inf"), 2, "inf"),
        (3e-14, 2, "3e-14"),
        (1.234e50, 2, "1.2e+50"),
    ],
)
def test_numbers_have_no_power_of_ten_where_people_need_none(value, digits, told):
    assert in_digits(value, digits) == told


def test_finite_numbers_have_their_unit():
    assert finite_or(1234.0, "m/rad", "not known") == "1200 m/rad"
    assert finite_or(float("nan"), "m/rad", "not known") == "not known"


@pytest.mark.parametrize(
    ("value", "error", "how", "told"),
    [
        (0.8860412, 3e-11, {}, "0.8860 ± 5e-05"),
        (12.3456789, 1e-9, {}, "12.35 ± 0.005"),
        (-3.57e-16, 1e-11, {}, "0 ± 1e-11"),
        (-3.57e-16, 1e-11, {"decimals": 3}, "0.000 ± 0.0005"),
    ],
)
def test_an_error_far_below_what_anyone_can_use_gives_no_digits(value, error, how, told):
    """Four significant digits at most, and an error bar of at least half a unit of the last of them."""
    assert with_error(value, error, **how) == told


def test_a_number_within_its_error_is_not_known():
    """The reader learns what to do; where no error is known, and where it is small, as usual."""
    assert known_words(11.0, 88.0, " m") == (
        "not known: 11.00 m at this time step, with an error bar of 88 m; take a smaller step, or a shorter time"
    )
    assert known_words(-1.75, 0.003, " m") == "-1.750 ± 0.003 m"
    assert known_words(1.75, float("inf"), " m") == "1.750 m (error not known)"


def test_rounding_is_shown_as_nothing():
    """Of a number, and of robots that stay where they are; those that do beside others are counted."""
    assert significant(-2.86e-16) == "0.000"
    robots = {"mean": 3e-16, "standard_deviation": 1e-16, "standard_error": 1e-17, "robots": 128, "failed": 0}
    assert mean_of_robots(robots, "m/s") == "0 m/s"
    creeping = {**robots, "mean": 2e-4, "standard_deviation": 1e-4}
    assert mean_of_robots({**creeping, "stay": 128}, "m/s") == "0 m/s (128 robots stay where they are)"
    lost = {**creeping, "stay": 127, "failed": 1, "standard_error": None}
    assert mean_of_robots(lost, "m/s") == "0 m/s (1 robot failed; 127 robots stay where they are)"
    some = {**robots, "mean": 0.5, "standard_deviation": 0.1, "standard_error": 0.01, "stay": 1}
    assert mean_of_robots(some, "m/s") == "0.50 ± 0.02 m/s (standard deviation 0.1; 1 robot stays where it is)"

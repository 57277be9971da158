"""Numbers in words."""

import pytest

from jaxgrity.core.display import finite_or, in_digits


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

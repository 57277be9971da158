"""Numbers with their errors in words, and the display of the lower layers' classes in notebooks."""

import math
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, SupportsFloat

COVERING = 2.0
"""Number of standard errors after a "±" where a number is known by draws: the range then covers the truth in 19 of 20
cases. How much robots differ is said in words, as their standard deviation."""

KNOWN = 4
"""Most significant digits of a number beside its error: no robot is measured, and no gait chosen, by more."""
NOTHING = 1e-12
"""Results that are no larger are rounding alone, and shown as 0."""
MOST_DECIMALS = 8
"""Most decimals of a number. One whose first digits need more is written with a power of ten."""


def of_report(module: str, function: str) -> Callable:
    """A function of `jaxgrity.report`, imported when an object is displayed.

    Scenes, gaits and trajectories have Jupyter's display methods, but need no pictures otherwise: this is the only
    import from a higher layer.
    """
    return getattr(import_module(f"jaxgrity.report.{module}"), function)


def significant(value: float, decimals: int = 3, digits: int = 3) -> str:
    """A number with some decimals, and more for a small one, so that `digits` digits are left."""
    if not math.isfinite(value):
        return f"{value}"
    value = 0.0 if abs(value) <= NOTHING else value
    needed = digits - 1 - _exponent(value)
    return f"{value:.{digits - 1}e}" if needed > MOST_DECIMALS else f"{_rounded(value, max(decimals, needed))}"


def with_error(
    value: float, error: float | None, unit: str = "", digits: str = ".1g", decimals: int | None = None
) -> str:
    """A number and its error, in words; an error that is infinite, None or NaN is "not known".

    The error has `digits` digits, and decides the decimals of the number. There are at most `decimals`, if given, and
    else as many as `KNOWN` digits need; the error is at least that of this rounding. A number that would be zeros in
    more than `KNOWN` decimals is "0".
    """
    if error is None or not math.isfinite(error):
        return f"{significant(value) if decimals is None else _rounded(value, decimals)}{unit} (error not known)"
    most = KNOWN - 1 - _exponent(value) if decimals is None else decimals
    error = max(error, 0.5 * 10.0 ** -max(0, most))
    error = float(f"{error:{digits}}")
    known = min(most, int(digits[1:-1]) - 1 - _exponent(error))
    told = f"{value:.2e}" if known > MOST_DECIMALS + KNOWN else _rounded(value, max(0, known))
    if known > KNOWN and not round(value, known):
        told = "0"
    return f"{told} ± {error:g}{unit}"


def known_words(value: float, error: float | None, unit: str = "", digits: str = ".1g") -> str:
    """A number with its error (`with_error`). If the error is larger, the number is not known, and what helps."""
    if not math.isfinite(value):
        return "not known"
    if error is None or not math.isfinite(error) or error <= abs(value):
        return with_error(value, error, unit, digits)
    found = f"{significant(value, 2, 2)}{unit} at this time step, with an error bar of {in_digits(error, 2)}{unit}"
    return f"not known: {found}; take a smaller step, or a shorter time"


def in_digits(value: SupportsFloat, digits: int = 3) -> str:
    """A number rounded to some digits, without zeros after them: 1230 N, not 1.23e+03 N. Zero has no sign.

    Numbers below 1e-4, or from 1e6 on, have a power of ten.
    """
    return f"{float(f'{float(value):.{digits}g}') + 0.0:.{max(digits, 6)}g}"


def finite_or(value: float, unit: str, otherwise: str) -> str:
    """A number of two digits with its unit, or other words where it is not finite."""
    return f"{in_digits(value, 2)} {unit}".rstrip() if math.isfinite(value) else otherwise


def _exponent(value: float) -> int:
    """The power of ten of the number's first digit; 0 for zero."""
    return math.floor(math.log10(abs(value))) if value and math.isfinite(value) else 0


def _rounded(value: float, decimals: int) -> str:
    """Zero has no sign."""
    return f"{round(value, decimals) + 0.0:.{decimals}f}"


def mean_of_robots(robots: dict[str, Any], unit: str, mean: str = "mean") -> str:
    """A mean over perturbed robots, with `COVERING` standard errors, and their standard deviation, in words.

    The record has "standard_error" (None of one robot), "standard_deviation", and the mean by its name. It may also
    count "robots", those that "failed", and those that "stay" where they are. If robots do not differ, the mean is all.
    """
    deviation, error, failed = robots["standard_deviation"], robots["standard_error"], robots.get("failed", 0)
    still = robots.get("stay", 0)
    counts = ((failed, "failed"), (still, "stay where they are" if still > 1 else "stays where it is"))
    lost = "; ".join(f"{count} robot{'s' * (count != 1)} {what}" for count, what in counts if count)
    if deviation is None or not math.isfinite(deviation):
        return f"not known ({lost})" if failed else "not known"
    beside = f" ({lost})" if lost else ""
    if (still and still + failed == robots["robots"]) or max(abs(robots[mean]), deviation) <= NOTHING:
        return f"0 {unit}".rstrip() + beside
    if not deviation:
        return f"{significant(robots[mean])} {unit}".rstrip() + beside
    known = with_error(robots[mean], None if error is None else COVERING * error, f" {unit}".rstrip())
    return f"{known} (standard deviation {in_digits(deviation, 2)}{f'; {lost}' if lost else ''})"


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """A table in words: a line for each row, with columns that begin one below the other."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return "\n".join("  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths)).rstrip() for row in rows)


def counted_robots(count: int) -> str:
    """How many robots a mean is of, in words."""
    return f"{count} perturbed robots" if count > 1 else "one robot, as nothing is uncertain"

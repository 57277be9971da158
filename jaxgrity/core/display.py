"""How numbers are said with their errors, and how the classes of the lower layers get shown in notebooks."""

import math
from collections.abc import Callable
from importlib import import_module
from typing import Any

COVERING = 2.0
"""standard errors that follow a "±", wherever a number is known by draws: the range then covers the truth in 19 of 20
cases. By how much robots differ is said in words, as their standard deviation."""


def of_report(module: str, function: str) -> Callable:
    """A function of `jaxgrity.report`, imported when somebody looks at an object.

    Scenes, gaits and trajectories have to have the methods that Jupyter asks for, and none of them needs a picture: so
    this is the one way upward through the layers.
    """
    return getattr(import_module(f"jaxgrity.report.{module}"), function)


def with_error(value: str, error: float | None, unit: str = "", digits: str = ".1g") -> str:
    """A number and its error, in words; where the error is infinite, None or no number, that it is not known.

    The number has as many digits as the error lets it have, and the error is at least what rounding takes.
    """
    if error is None or not math.isfinite(error):
        return f"{value}{unit} (error not known)"
    decimals = len(value.partition(".")[2]) if "e" not in value else None
    if decimals is None:
        return f"{value} ± {error:{digits}}{unit}"
    error = max(error, 0.5 * 10.0**-decimals)
    known = int(digits[1:-1]) - 1 - math.floor(math.log10(float(f"{error:{digits}}")))
    return f"{float(value):.{max(0, min(decimals, known))}f} ± {error:{digits}}{unit}"


def mean_of_robots(robots: dict[str, Any], unit: str, mean: str = "mean") -> str:
    """A mean over robots that differ, with `COVERING` standard errors, and their standard deviation, in words.

    From a record with "standard_error" (None of one robot), "standard_deviation", and the mean by its name.
    """
    error = robots["standard_error"]
    known = with_error(f"{robots[mean]:.3f}", None if error is None else COVERING * error, f" {unit}".rstrip())
    return f"{known} (standard deviation {robots['standard_deviation']:.2g})"

"""How numbers are said with their errors, and how the classes of the lower layers get shown in notebooks."""

import math
from collections.abc import Callable
from importlib import import_module


def of_report(module: str, function: str) -> Callable:
    """A function of `jaxgrity.report`, imported when somebody looks at an object.

    Scenes, gaits and trajectories have to have the methods that Jupyter asks for, and none of them needs a picture: so
    this is the one way upward through the layers.
    """
    return getattr(import_module(f"jaxgrity.report.{module}"), function)


def with_error(value: str, error: float | None, unit: str = "", digits: str = ".1g") -> str:
    """A number and its error, in words; where the error is infinite, None or no number, that it is not known."""
    if error is None or not math.isfinite(error):
        return f"{value}{unit} (error not known)"
    return f"{value} ± {error:{digits}}{unit}"

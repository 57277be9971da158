"""How the classes of the lower layers get shown in notebooks by what draws pictures, in a layer above them."""

from collections.abc import Callable
from importlib import import_module


def of_report(module: str, function: str) -> Callable:
    """A function of `jaxgrity.report`, imported when somebody looks at an object.

    Scenes, gaits and trajectories have to have the methods that Jupyter asks for, and none of them needs a picture: so
    this is the one way upward through the layers.
    """
    return getattr(import_module(f"jaxgrity.report.{module}"), function)

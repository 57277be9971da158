"""jaxgrity: tensegrity robots, simulated differentiably, and the gaits that make them roll.

The names that most users need stand in `__init__.pyi`, in groups; each module is imported when one of its names is
first used. The rooms have further names: `jaxgrity.control`, `formats`, `identification`, `model`, `orbits`,
`populations`, `report`, `search`, `statics`, `stepping`, `structures`.
"""

import warnings
from importlib import import_module, metadata

import lazy_loader

_found, _, _names = lazy_loader.attach_stub(__name__, __file__)
ROOMS = (
    "control",
    "formats",
    "identification",
    "model",
    "orbits",
    "populations",
    "report",
    "search",
    "statics",
    "stepping",
    "structures",
)
"""Names of the rooms (sub-packages) that have public names."""
__all__ = [name for name in _names if name not in ROOMS]
RENAMED = {"Motors": "MotorLimits", "Wave": "TravellingWave"}
"""Names that were at the top, with the names that they have in their rooms."""


def __getattr__(name: str):
    if name == "__version__":
        return metadata.version(__name__)
    if name in _names or name.startswith("_"):
        return _found(name)
    now = RENAMED.get(name, name)
    for room in ROOMS:
        home = import_module(f"{__name__}.{room}")
        if now in home.__all__:
            moved = f"jaxgrity.{name} is jaxgrity.{room}.{now} now; the short name goes with the next release"
            warnings.warn(moved, DeprecationWarning, stacklevel=2)
            return getattr(home, now)
    return _found(name)


def __dir__() -> list[str]:
    return [*__all__, *ROOMS]

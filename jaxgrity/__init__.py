"""jaxgrity: tensegrity robots, simulated differentiably, and the gaits that make them roll.

The names that most users need stand in `__init__.pyi`, in groups; each module is imported when one of its names is
first used. Sub-packages have further names: `jaxgrity.control`, `formats`, `identification`, `model`, `orbits`,
`populations`, `report`, `search`, `statics`, `stepping`, `structures`.
"""

import warnings
from importlib import import_module, metadata

from jaxgrity.core.errors import unknown
from jaxgrity.core.moved_names import MOVED, RENAMED, REPLACED
from jaxgrity.core.public_names import public_names

_found, _, _names = public_names(__name__, __file__)
SUB_PACKAGES = (
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
"""Sub-packages that have public names."""
__all__ = [name for name in _names if name not in SUB_PACKAGES]


def __getattr__(name: str):
    if name == "__version__":
        return metadata.version(__name__)
    if name in _names or name.startswith("_"):
        return _found(name)
    if name in REPLACED:
        raise AttributeError(f"{__name__}.{name}: expected {__name__}.{REPLACED[name]}")
    now = RENAMED.get(name, name)
    rooms = {
        each: f"{__name__}.{room}" for room in SUB_PACKAGES for each in import_module(f"{__name__}.{room}").__all__
    }
    rooms |= dict.fromkeys(__all__, __name__)
    if now not in rooms:
        raise AttributeError(f"{__name__}.{name}: {unknown(name, [*_names, *rooms])}")
    place = f"{rooms[now]}.{now}"
    if name not in MOVED and name not in RENAMED:
        raise AttributeError(f"{__name__}.{name}: expected {place}")
    moved = f"{__name__}.{name} is {place} now; the short name goes with the next release"
    warnings.warn(moved, DeprecationWarning, stacklevel=2)
    # kept, so that `from jaxgrity import name`, which asks twice, warns once
    globals()[name] = getattr(import_module(rooms[now]), now)
    return globals()[name]


def __dir__() -> list[str]:
    return [*__all__, *SUB_PACKAGES]

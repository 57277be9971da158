"""The public names of a package: imported at first use; the error of a misspelt one suggests the nearest."""

from collections.abc import Callable
from typing import Any

import lazy_loader

from jaxgrity.core.errors import unknown


def public_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package with its names in a stub (.pyi)."""
    found, listed, names = lazy_loader.attach_stub(package, file)

    def get(name: str) -> Any:
        if name in names or name.startswith("_"):
            return found(name)
        raise AttributeError(f"{package}.{name}: {unknown(name, names)}")

    return get, listed, names

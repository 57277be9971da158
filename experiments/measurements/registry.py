"""The measurements that there are; as a command, the names of those that `make measure` runs as they are."""

import importlib
from pathlib import Path

from measurement import Measurement

HERE = Path(__file__).parent


def measurements() -> dict[str, Measurement]:
    """All measurements by their names."""
    names = (path.stem for path in sorted(HERE.glob("*.py")) if "\n@measurement(" in path.read_text(encoding="utf-8"))
    return {name: getattr(importlib.import_module(name), name) for name in names}


if __name__ == "__main__":
    print("\n".join(name for name, found in measurements().items() if found.listed))

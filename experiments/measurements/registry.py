"""The measurements that there are; as a command, the names of those that `make measure` runs as they are."""

import importlib
from pathlib import Path

from measurement import Measurement

HERE = Path(__file__).parent


def measurements() -> dict[str, Measurement]:
    """All measurements by the names of their scripts."""
    names = (path.stem for path in sorted(HERE.glob("*.py")) if "\n@measurement(" in path.read_text(encoding="utf-8"))
    found = ((name, each) for name in names for each in vars(importlib.import_module(name)).values())
    return {name: each for name, each in found if isinstance(each, Measurement)}


if __name__ == "__main__":
    print("\n".join(name for name, found in measurements().items() if found.listed))

"""All measurements and studies; as a command, the names of the measurements that `make measure` runs as they are."""

import importlib
import sys
from pathlib import Path

from measurement import Measurement

HERE = Path(__file__).parent
STUDIES = HERE.parent / "studies"
sys.path.append(str(STUDIES))


def measurements(*folders: Path) -> dict[str, Measurement]:
    """Those of the folders, or all, by the names of their scripts."""
    paths = (path for folder in folders or (HERE, STUDIES) for path in sorted(folder.glob("*.py")))
    names = (path.stem for path in paths if "\n@measurement(" in path.read_text(encoding="utf-8"))
    found = ((name, each) for name in names for each in vars(importlib.import_module(name)).values())
    return {name: each for name, each in found if isinstance(each, Measurement)}


if __name__ == "__main__":
    print("\n".join(name for name, found in measurements(HERE).items() if found.listed))

"""What experiments/run.py runs: measurements, studies, and scripts that write pages."""

import ast
import importlib
import re
from functools import cache
from pathlib import Path
from typing import Any

from measurements.measurement import Measurement

EXPERIMENTS = Path(__file__).parents[1]
FOLDERS = "measurements", "studies", "docs_tables"


@cache
def scripts() -> dict[str, Path]:
    """Files that can be run, by their names: of measurements, and those with `Settings` and `main`."""
    paths = (path for folder in FOLDERS for path in sorted((EXPERIMENTS / folder).glob("*.py")))
    runs = re.compile(r"^(@measurement\(|class Settings:)", re.MULTILINE)
    return {path.stem: path for path in paths if runs.search(path.read_text("utf-8"))}


def loaded(name: str) -> Any:
    """The measurement of a file, or its module: both have `Settings`, and `main`, which takes them."""
    module = importlib.import_module(f"{scripts()[name].parent.name}.{name}")
    return next((each for each in vars(module).values() if isinstance(each, Measurement)), module)


def measurements(*folders: str) -> dict[str, Measurement]:
    """Measurements of the folders, or all, by the names of their files."""
    found = {name: loaded(name) for name, path in scripts().items() if path.parent.name in (folders or FOLDERS)}
    return {name: each for name, each in found.items() if isinstance(each, Measurement)}


def measured() -> list[str]:
    """What `make measure` runs, in this order: every measurement, the gaits that they use, and what fills the pages."""
    found = [f"run.py {name} {each.options}".strip() for name, each in measurements("measurements").items()]
    return [*found, "run.py watch_gaits", "gait_search.py --restart", "run.py update_docs"]


def sentence(name: str) -> str:
    """The first sentence of what a file says of itself."""
    told = ast.get_docstring(ast.parse(scripts()[name].read_text("utf-8"))) or ""
    return " ".join(told.partition("\n\n")[0].split()).partition(". ")[0]

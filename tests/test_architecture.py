"""The floor plan of docs/design.md is that of the package, and what is public is all there."""

import re
from pathlib import Path

import jaxgrity

ROOT = Path(__file__).parents[1]
PLAN = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")


def test_floor_plan_names_every_module_once_and_no_other():
    named = re.findall(r"^\| `(\w+/\w+)` \|", PLAN, re.MULTILINE)
    modules = [path.relative_to(ROOT / "jaxgrity") for path in (ROOT / "jaxgrity").rglob("*.py")]
    assert sorted(named) == sorted(str(path.with_suffix("")) for path in modules if path.name != "__init__.py")


def test_floor_plan_is_in_the_order_of_the_layers_contract():
    """From the bottom up."""
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (layers,) = re.findall(r"^layers = \[(.*)\]", project, re.MULTILINE)
    assert re.findall(r"^\| \*\*(\w+)\*\* \|", PLAN, re.MULTILINE) == re.findall(r"\w+", layers)[::-1]


def test_every_public_name_can_be_imported():
    for name in jaxgrity.__all__:
        getattr(jaxgrity, name)

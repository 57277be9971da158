"""The floor plan of docs/layout.md is that of the package, and the scene file of docs/design.md loads."""

import re
from pathlib import Path

from jaxgrity import load_scene

ROOT = Path(__file__).parents[1]
PLAN, PAGE = ((ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("layout.md", "design.md"))


def test_floor_plan_names_every_module_once_and_no_other():
    """Modules that only gather others aside."""
    named = re.findall(r"^\| `(\w+/\w+|__main__)` \|", PLAN, re.MULTILINE)
    modules = [path.relative_to(ROOT / "jaxgrity") for path in (ROOT / "jaxgrity").rglob("*.py")]
    assert sorted(named) == sorted(path.with_suffix("").as_posix() for path in modules if path.name != "__init__.py")


def test_floor_plan_is_in_the_order_of_the_layers_contract():
    """From the bottom up."""
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (layers,) = re.findall(r"^layers = \[([^]]*)\]", project, re.MULTILINE)
    assert re.findall(r"^\| \*\*(\w+)\*\* \|", PLAN, re.MULTILINE) == re.findall(r"\w+", layers)[::-1]


def test_walks_lead_through_modules_that_define_what_they_name():
    """Each step as `room/module.name`."""
    steps = re.findall(r"`(\w+/\w+)\.(\w+)`", PLAN.partition("## Every module")[0])
    assert len(steps) >= 20
    for module, name in steps:
        text = (ROOT / "jaxgrity" / f"{module}.py").read_text(encoding="utf-8")
        assert re.search(rf"^(def|class) {name}\b", text, re.MULTILINE), f"{module}: {name}"


def test_scene_file_of_the_page_loads(tmp_path):
    """With every table and key that is not a comment there."""
    (found,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    path = tmp_path / "scene.toml"
    path.write_text(found, encoding="utf-8")
    assert [law.name for law in load_scene(path).terms] == ["wind", "push", "largest force of cables"]


def test_links_of_the_pages_lead_somewhere():
    """Of those for contributors and newcomers."""
    for page in (
        "docs/design.md",
        "docs/layout.md",
        "docs/extending.md",
        "docs/glossary.md",
        "CONTRIBUTING.md",
        "CHANGELOG.md",
    ):
        text = (ROOT / page).read_text(encoding="utf-8")
        for target in re.findall(r"\]\(((?!http)[^)#]+)\)", text):
            assert ((ROOT / page).parent / target).exists(), f"{page}: {target}"

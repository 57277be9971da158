"""The examples of docs/extending.md run as they stand, are as short as the page says, and do what it says."""

import re
from pathlib import Path

import pytest

from jaxgrity import METHODS, OBJECTIVES

PAGE = (Path(__file__).parents[1] / "docs" / "extending.md").read_text(encoding="utf-8")
SECTIONS = {
    section.splitlines()[0]: re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    for section in PAGE.split("\n## ")[1:]
}


@pytest.fixture
def _registries_as_before():
    """An example registers what other tests do not expect."""
    before = [(registry, dict(registry)) for registry in (METHODS, OBJECTIVES)]
    yield
    for registry, known in before:
        registry.clear()
        registry.update(known)


@pytest.mark.slow
@pytest.mark.usefixtures("_registries_as_before")
@pytest.mark.parametrize("section", SECTIONS)
def test_example_works(section):
    """Each section's blocks run one after the other, as one program; the last one checks what the first one adds."""
    names = {"__name__": "example"}
    for block in SECTIONS[section]:
        exec(compile(block, f"docs/extending.md, {section}", "exec"), names)


@pytest.mark.parametrize("section", SECTIONS)
def test_example_is_short(section):
    """40 lines at most, blank ones aside, and a check of its own."""
    example, *checks = SECTIONS[section]
    assert sum(bool(line.strip()) for line in example.splitlines()) <= 40
    assert any("assert" in check for check in checks)

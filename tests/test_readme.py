"""The README's library example runs as it stands, and its measured numbers are those of the files it names."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import search_words
import update_docs

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_library_example_runs():
    """In a process of its own, from the repository's root, as a reader would run it."""
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    done = subprocess.run([sys.executable, "-c", example], cwd=ROOT, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stderr
    assert "modelled" in done.stdout
    distance, _, error_bar, _ = done.stdout.splitlines()[-1].split()
    assert float(distance) > float(error_bar) > 0


def test_measured_numbers_are_those_of_the_files():
    """The distance and the times per step in the README stand in docs/measured/."""
    gait = json.loads((ROOT / "docs" / "measured" / "gait_search.json").read_text())
    assert f"**{gait['distance']:.3f} ± {gait['error_bar']:.1g} m**" in README
    speed = json.loads((ROOT / "docs" / "measured" / "benchmark.json").read_text())
    assert update_docs.benchmark(speed) in README


@pytest.mark.parametrize(("name", "count"), [("numerics", 11), ("performance", 3), ("scaling", 2), ("search", 4)])
def test_page_says_what_was_measured(name, count):
    """Each block of a page of docs/ holds what its file in docs/measured/ says; its pictures and links are there."""
    page = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    blocks = re.findall(r"<!-- measured: (\S+) -->\n(.*?)<!-- end -->", page, re.DOTALL)
    measured = [block for block in blocks if block[0] in update_docs.SOURCES]
    assert len(measured) == count
    for name, words in measured:
        source = update_docs.SOURCES[name]
        facts = json.loads((ROOT / "docs" / "measured" / update_docs.measured_name(name, source)).read_text())
        assert source.words(facts).strip() == words.strip(), name
    for target in re.findall(r"\]\(((?!http)[^)#]+)\)", page):
        assert (ROOT / "docs" / target).exists(), target


def test_pictures_and_links_are_there():
    """Every file that the README shows or links to is in the repository."""
    targets = re.findall(r"\]\(((?!http)[^)#]+)\)", README)
    assert targets
    for target in targets:
        assert (ROOT / target).exists(), target


def test_gaits_of_the_library_are_those_of_their_records():
    """In the README, and with the commands that found them in docs/search.md."""
    assert search_words.gaits_table() in README
    assert search_words.library() in (ROOT / "docs" / "search.md").read_text(encoding="utf-8")


def test_importing_changes_no_configuration():
    """`import jaxgrity` leaves x64 off, and does not load matplotlib."""
    code = "import sys, jaxgrity, jax; assert not jax.config.jax_enable_x64; assert 'matplotlib' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr

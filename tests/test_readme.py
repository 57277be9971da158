"""The README's library example runs as it stands, and what it links to is there."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_library_example_runs():
    """In a process of its own, from the repository's root, as a reader would run it."""
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    done = subprocess.run([sys.executable, "-c", example], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "modelled" in done.stdout
    said, error_bar, unit = done.stdout.splitlines()[-1].rsplit(maxsplit=2)
    assert (said, unit) == ("centre of mass at the end: ±", "m")
    assert 0 < float(error_bar) < 1e-3


def test_pictures_and_links_are_there():
    """Every file that the README shows or links to is in the repository."""
    targets = re.findall(r"\]\(((?!http)[^)#]+)\)", README)
    assert targets
    for target in targets:
        assert (ROOT / target).exists(), target


def test_importing_changes_no_configuration():
    """`import jaxgrity` leaves x64 off, and does not load matplotlib."""
    code = "import sys, jaxgrity, jax; assert not jax.config.jax_enable_x64; assert 'matplotlib' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr

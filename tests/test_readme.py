"""The README's library example runs as it stands, and what it links to is there."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


CHECK = """
import numpy as np
ends = [[distance(scene.gait.phase + off * np.eye(6)[k])[0] for off in (-1e-5, 1e-5)] for k in range(6)]
np.testing.assert_allclose(gradient, np.diff(np.array(ends))[:, 0] / 2e-5, atol=1e-4)
assert 0.3 < far < 3 and abs(gradient).max() > 0.1
"""
"""The example's gradient is that of central differences, and not of rounding."""


@pytest.mark.slow
def test_library_example_runs():
    """In a process of its own, as a reader would run it: it prints what it says, and its gradient is right."""
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    done = subprocess.run([sys.executable, "-c", example + CHECK], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert f"# {done.stdout.strip()}" in example.splitlines()


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

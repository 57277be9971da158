"""Compiled programs are kept for the next process."""

import os
import subprocess
import sys

import equinox
import pytest

import jaxgrity
from jaxgrity import InputError

LATE = """
import equinox
import jaxgrity
jaxgrity.keep_compiled({folder!r})
"""
KEPT = """
import jaxgrity
assert jaxgrity.keep_compiled({folder!r}).name == "programs"
import jax
scene = jaxgrity.load_scene("exact")
jax.block_until_ready(jaxgrity.simulate(scene, 0.01).positions)
"""


def run(program: str, folder: str) -> subprocess.CompletedProcess:
    """In a process of its own, without the settings of the tests."""
    ours = ("EQX_ON_ERROR", "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS")
    environment = {name: value for name, value in os.environ.items() if name not in ours}
    return subprocess.run(
        [sys.executable, "-c", program.format(folder=folder)], capture_output=True, text=True, env=environment
    )


@pytest.mark.slow
def test_rollouts_are_kept(tmp_path):
    done = run(KEPT, str(tmp_path / "programs"))
    assert done.returncode == 0, done.stderr
    assert [path for path in (tmp_path / "programs").iterdir() if path.name.startswith("jit__simulate")]


def test_it_is_refused_where_it_would_keep_nothing(tmp_path):
    """Equinox, imported before, calls back from rollouts, and such programs are kept nowhere."""
    done = run(LATE, str(tmp_path))
    assert "InputError: keep_compiled: Equinox is imported already" in done.stderr


def test_another_setting_of_checks_is_refused(monkeypatch):
    monkeypatch.setenv("EQX_ON_ERROR", "raise")
    with pytest.raises(InputError, match="EQX_ON_ERROR = 'raise': expected 'nan'"):
        jaxgrity.keep_compiled()
    assert equinox._config.EQX_ON_ERROR == "nan"

"""Hundreds of damaged files: each is read, or refused in one clear line, with little work and memory."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from bad_files import BOMBS, damaged, good_files, outcome

HERE = Path(__file__).parent
LONGEST = 60.0
"""processor seconds for one file: work, which no other program on the machine makes more"""
MOST_MEMORY = 2**30
"""bytes, of the whole process, with JAX and MuJoCo in it"""


def test_good_files_are_read(tmp_path):
    """Those of which bad ones are made: else all would be refused for the same reason."""
    for paths in good_files(tmp_path).values():
        for path in paths:
            assert outcome(path)["kind"] == "read", path


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".toml", ".yaml", ".xml", ".mat", ".csv", ".json"])
def test_three_hundred_damaged_files(ending, tmp_path):
    """Cut off, with noise, other values, lines lost or there twice: no error but the one for bad input, in one line."""
    found = [outcome(path) for path in damaged(tmp_path, ending, 300)]
    wrong = [each for each in found if each["kind"] not in ("read", "refused")]
    assert not wrong, wrong[:3]
    assert sum(each["kind"] == "refused" for each in found) > 100


@pytest.mark.campaign
def test_bombs_are_refused():
    """In a process of their own, whose memory stays below a gigabyte."""
    environment = os.environ | {"PYTHONPATH": str(HERE.parents[1])}
    command = [sys.executable, str(HERE / "bad_files.py")]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout)
    assert [each["kind"] for each in found["outcomes"]] == ["refused"] * BOMBS, found["outcomes"]
    assert max(each["seconds"] for each in found["outcomes"]) < LONGEST
    assert found["peak"] < MOST_MEMORY

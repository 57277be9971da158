"""Hundreds of bad files: each is read, or refused in one clear line, with little work and memory."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from bad_files import BOMBS, bad_files, bombs, good_files, outcome

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


def test_forty_bad_files(tmp_path):
    """Small ones with something wrong: no error but the one for bad input, in one line."""
    found = [outcome(path) for path in _damaged(tmp_path, 40)]
    assert {each["kind"] for each in found} <= {"read", "refused"}, found
    assert sum(each["kind"] == "refused" for each in found) > 15


def _damaged(folder: Path, count: int):
    """The damaged robots alone; each is read before the next one takes its name."""
    for number, path in enumerate(bad_files(folder, count + BOMBS)):
        if number >= BOMBS:
            yield path


def test_bombs_are_counted(tmp_path):
    assert len(list(bombs(tmp_path))) == BOMBS


@pytest.mark.slow
def test_three_hundred_bad_files():
    """In a process of their own, whose memory stays below a gigabyte; bombs are refused, each of them."""
    environment = os.environ | {"PYTHONPATH": str(HERE.parents[1])}
    done = subprocess.run(
        [sys.executable, str(HERE / "bad_files.py"), "300"],
        capture_output=True,
        text=True,
        env=environment,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout)
    outcomes = found["outcomes"]
    assert len(outcomes) == 300
    wrong = [each for each in outcomes if each["kind"] not in ("read", "refused")]
    assert not wrong, wrong[:3]
    assert all(each["kind"] == "refused" for each in outcomes[:BOMBS])
    assert sum(each["kind"] == "refused" for each in outcomes) > 150
    assert max(each["seconds"] for each in outcomes) < LONGEST
    assert found["peak"] < MOST_MEMORY

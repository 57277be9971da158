"""Files appear whole or not at all, and what is read is checked."""

import json

import numpy as np
import pytest

from jaxgrity import InputError
from jaxgrity.files import load_phases, save_arrays, save_json, write_whole


def test_phases_from_csv(tmp_path):
    """Rows are gaits; blank lines do not count."""
    path = tmp_path / "gaits.csv"
    path.write_text("0.5, 1\n\n-2,3e-1\n")
    np.testing.assert_array_equal(load_phases(path, 2), [[0.5, 1.0], [-2.0, 0.3]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2\n1\n", "row 2 has 1 phases; expected 2"),
        ("a,b\n", "row 1 has 'a'; expected a finite number"),
        ("1,nan\n", "row 1 has 'nan'; expected a finite number"),
        ("\n", "has no gaits"),
    ],
)
def test_bad_csv_is_refused(tmp_path, text, message):
    """File, row, what was found, what was expected."""
    path = tmp_path / "gaits.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        load_phases(path, 2)
    assert "gaits.csv" in str(caught.value)


def test_a_write_that_fails_leaves_the_old_file(tmp_path):
    """Neither half a file nor a temporary one stays behind."""
    path = tmp_path / "result.json"
    path.write_text("old")

    def fail(file):
        file.write(b"half")
        raise RuntimeError("the disk is full")

    with pytest.raises(RuntimeError, match="full"):
        write_whole(path, fail)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_json_holds_arrays_and_numbers(tmp_path):
    """NumPy values become plain ones; what is not finite becomes null, as JSON has no word for it."""
    path = tmp_path / "deep" / "result.json"
    save_json(path, {"a": np.arange(2), "b": np.float64(0.1), "c": (np.nan, np.inf), "d": None, "e": np.bool_(True)})
    expected = {"a": [0, 1], "b": 0.1, "c": [None, None], "d": None, "e": True}
    assert json.loads(path.read_text()) == expected


def test_arrays_come_back(tmp_path):
    """An npz of named arrays."""
    save_arrays(tmp_path / "x.npz", q=np.eye(2), t=[1.0, 2.0])
    with np.load(tmp_path / "x.npz") as saved:
        np.testing.assert_array_equal(saved["q"], np.eye(2))
        np.testing.assert_array_equal(saved["t"], [1.0, 2.0])

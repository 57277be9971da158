"""Files appear whole or not at all, and what is read is checked."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import InputError
from jaxgrity.io.files import load_phases, read_json, save_arrays, save_json, write_whole


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
        ("1,\n", "row 1 has ''; expected a finite number"),
        ("1,2\n3,-inf\n", "row 2 has '-inf'; expected a finite number"),
        ("\n", "has no gaits; expected one row of 2 phases"),
    ],
)
def test_bad_csv_is_refused(tmp_path, text, message):
    """File, row, what was found, what was expected."""
    path = tmp_path / "gaits.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        load_phases(path, 2)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [None, b"0.5,\xff\n"], ids=["missing", "not text"])
def test_phases_that_cannot_be_read(tmp_path, content):
    """A file that is not there or holds no text is named."""
    path = tmp_path / "gaits.csv"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"gaits\.csv: cannot be read: "):
        load_phases(path, 2)


@pytest.mark.parametrize(("text", "message"), [("", "not JSON: Expecting value"), ("[1]", "holds no JSON object")])
def test_json_without_an_object_is_refused(tmp_path, text, message):
    """An empty file, and a list."""
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(InputError, match=rf"run\.json: {message}"):
        read_json(tmp_path / "run.json")


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
    with pytest.raises(RuntimeError, match="full"):
        write_whole(tmp_path / "new.json", fail)
    assert list(tmp_path.iterdir()) == [path]


def test_no_file_is_written_in_the_place_of_a_folder(tmp_path):
    """Nor in a folder whose place a file has; the work is not begun, and nothing is left behind."""
    (tmp_path / "taken").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"taken: is a folder; expected the name of a file to write$"):
        write_whole(tmp_path / "taken", lambda file: pytest.fail("begun"))
    with pytest.raises(InputError, match=r"result\.json: \S*/file is a file; expected a folder"):
        save_json(tmp_path / "file" / "result.json", {})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "taken"]


def test_a_file_appears_only_when_it_is_complete(tmp_path):
    """Until the last byte, readers find the old content."""
    path = tmp_path / "result.json"
    path.write_text("old")
    seen = []

    def write(file):
        file.write(b"new")
        file.flush()
        seen.append(path.read_text())

    write_whole(path, write)
    assert seen == ["old"]
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mode & 0o777 == 0o644


def test_json_holds_arrays_and_numbers(tmp_path):
    """NumPy values become plain ones; what is not finite becomes null, as JSON has no word for it."""
    path = tmp_path / "deep" / "result.json"
    numbers = {"a": np.arange(2), "b": np.float64(0.1), "c": (np.nan, np.inf), "d": None, "e": np.bool_(True)}
    nested = {"f": [np.array([[1.5, np.nan]]), {3: np.int64(4)}], "g": jnp.ones(1), "h": np.float32(2)}
    save_json(path, numbers | nested)
    expected = {"a": [0, 1], "b": 0.1, "c": [None, None], "d": None, "e": True}
    expected |= {"f": [[[1.5, None]], {"3": 4}], "g": [1.0], "h": 2.0}
    assert json.loads(path.read_text()) == expected


def test_arrays_come_back(tmp_path):
    """An npz of named arrays."""
    save_arrays(tmp_path / "x.npz", q=np.eye(2), t=[1.0, 2.0])
    with np.load(tmp_path / "x.npz") as saved:
        np.testing.assert_array_equal(saved["q"], np.eye(2))
        np.testing.assert_array_equal(saved["t"], [1.0, 2.0])

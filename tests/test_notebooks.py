"""The notebooks are stored with what their cells show, and that belongs to the code in them. (nbmake runs them.)"""

from pathlib import Path

import nbformat
import pytest
from docs_tables import run_notebooks

NOTEBOOKS = sorted(run_notebooks.FOLDER.glob("*.ipynb"))


def test_there_are_six():
    """From a first roll to a robot of one's own."""
    assert [path.stem for path in NOTEBOOKS] == [
        "build_your_own_robot",
        "explore_a_gait",
        "first_roll",
        "gradients_and_where_they_end",
        "speed_against_error",
        "teach_it_to_roll",
    ]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_stored_outputs_are_current(path):
    """All cells were run in their order, without an error, and are as they were then; they show pictures."""
    assert run_notebooks.current(path), f"run python experiments/run.py run_notebooks {path}"
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert len(cells) <= 10
    shown = [output for cell in cells for output in cell.outputs]
    assert not [output for output in shown if output.output_type == "error" or output.get("name") == "stderr"]
    assert any("image/png" in str(output.get("data", "")) for output in shown)
    assert path.stat().st_size < run_notebooks.LARGEST


def test_changed_code_is_noticed(tmp_path):
    """One letter of it is enough; words between the cells may change."""
    notebook = nbformat.read(NOTEBOOKS[0], as_version=4)
    notebook.cells[0].source += " More words."
    nbformat.write(notebook, tmp_path / "words.ipynb")
    assert run_notebooks.current(tmp_path / "words.ipynb")
    next(cell for cell in notebook.cells if cell.cell_type == "code").source += " "
    nbformat.write(notebook, tmp_path / "code.ipynb")
    assert not run_notebooks.current(tmp_path / "code.ipynb")


def test_what_does_not_run_is_not_stored(tmp_path):
    """With the notebook's name and the error."""
    path = tmp_path / "broken.ipynb"
    nbformat.write(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1 / 0")]), path)
    before = path.read_bytes()
    with pytest.raises(run_notebooks.InputError, match=r"broken.ipynb: [\s\S]*ZeroDivisionError"):
        run_notebooks.main(run_notebooks.Settings((Path(path),)))
    assert path.read_bytes() == before

"""Run the notebooks and store them with what their cells show, so that they can be read where nothing is run."""

import hashlib
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import nbformat
import tyro
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from tqdm import tqdm

from jaxgrity import InputError
from jaxgrity.io.files import write_whole

FOLDER = Path(__file__).parents[2] / "notebooks"
LARGEST = 500_000
"""bytes of a stored notebook"""


@dataclass
class Settings:
    notebooks: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """those to run; without any, all in notebooks/ whose stored outputs are not of the code that is in them"""


def main(settings: Settings) -> None:
    """Run and store them. Raises `InputError` where a cell fails, or a notebook with its outputs is too large."""
    found = settings.notebooks or tuple(path for path in sorted(FOLDER.glob("*.ipynb")) if not current(path))
    for path in tqdm(found, unit="notebook", disable=not found):
        notebook = nbformat.read(path, as_version=4)
        try:
            NotebookClient(
                notebook, timeout=600, record_timing=False, resources={"metadata": {"path": path.parent}}
            ).execute()
        except CellExecutionError as error:
            raise InputError(f"{path}: {error}") from error
        notebook.metadata["jaxgrity"] = stamp(notebook)
        text = nbformat.writes(notebook) + "\n"
        if len(text) > LARGEST:
            raise InputError(f"{path}: {len(text)} bytes with its outputs; expected at most {LARGEST}")
        write_whole(path, lambda file, text=text: file.write(text.encode()))


def stamp(notebook: nbformat.NotebookNode) -> dict[str, str]:
    """What the outputs of a notebook belong to: the code of its cells, and the version of jaxgrity that ran it."""
    code = "\n\n".join(cell.source for cell in notebook.cells if cell.cell_type == "code")
    return {"code": hashlib.sha256(code.encode()).hexdigest(), "version": version("jaxgrity")}


def current(path: Path) -> bool:
    """Whether a notebook's stored outputs are those of the code in it, with this version of jaxgrity."""
    notebook = nbformat.read(path, as_version=4)
    return notebook.metadata.get("jaxgrity") == stamp(notebook)

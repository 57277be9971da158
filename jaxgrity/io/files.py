"""Files: gaits (CSV), results (JSON, npz). Input is checked; a file is written whole or not at all."""

import json
import math
import os
import tempfile
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import IO, Any

import numpy as np
from PIL import Image

from jaxgrity.core.errors import InputError, unknown

PART = ".part"
"""Ending of a file that is not complete yet. A process that is killed leaves it behind."""


def shipped(kind: str) -> dict[str, Path]:
    """The files of a folder of jaxgrity/data, by their names in the library, in order."""
    folder = Path(str(resources.files("jaxgrity"))) / "data" / kind
    return {path.stem: path for path in sorted(folder.iterdir())}


def found_file(what: str, kind: str, name: str | Path) -> Path:
    """The library's file of that name, or else the one at that path. Raises `InputError` if there is neither."""
    known = shipped(kind)
    if str(name) not in known and not (str(name) and Path(name).exists()):  # the path "" is the folder one is in
        expected = f"expected a file, or one of {', '.join(known)}"
        raise InputError(f"{what} {str(name)!r}: {unknown(str(name), tuple(known))}; {expected}")
    return known.get(str(name), Path(name))


def read_text(path: str | Path) -> str:
    """The file's text. Raises `InputError` for a file that cannot be read."""
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error


def read_json(path: str | Path) -> dict[str, Any]:
    """The object in a JSON file. Raises `InputError` for a file that cannot be read, or holds something else."""
    try:
        found = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: not JSON: {error}") from error
    if not isinstance(found, dict):
        raise InputError(f"{path}: holds no JSON object; expected one, names with their values")
    return found


def read_picture(path: str | Path) -> np.ndarray:
    """The brightness of a picture, (rows, columns), from 0, black, to 1, white; its first row is the upper one.

    Raises `InputError` for a picture that cannot be read, or has floats beyond 0 to 1.
    """
    try:
        with Image.open(path) as picture:
            own = picture.mode == "F"
            deep = picture.mode.startswith("I") or own
            grey = np.asarray(picture if deep else picture.convert("L"), float)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: no picture: {getattr(error, 'strerror', None) or error}") from error
    grey = grey if own else grey / (65535 if deep else 255)
    low, high = (grey.min(), grey.max()) if np.isfinite(grey).all() else (np.nan, np.nan)
    if not (low >= 0 and high <= 1):
        raise InputError(f"{path}: brightness from {low:g} to {high:g}; expected numbers from 0, black, to 1, white")
    return grey


def load_phases(path: str | Path, actuators: int) -> np.ndarray:
    """Gaits from a CSV without a header, (gaits, actuators), rad.

    Raises `InputError` where the file cannot be read, a number is not finite, or a row has another number of phases.
    """
    rows = [line.split(",") for line in read_text(path).splitlines() if line.strip()]
    if not rows:
        raise InputError(f"{path}: has no gaits; expected one row of {actuators} phases for each")
    for number, row in enumerate(rows, start=1):
        if len(row) != actuators:
            raise InputError(
                f"{path}: row {number} has {len(row)} phases; expected {actuators}, one per actuated member"
            )
        for text in row:
            if not _is_finite(text):
                raise InputError(f"{path}: row {number} has {text.strip()!r}; expected a finite number")
    return np.array(rows, float)


def _is_finite(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def check_folder(folder: Path, where: str) -> None:
    """Raise `InputError` for a folder in a file's place, or where nothing can be written, before there are results."""
    there = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    if not there.is_dir():
        raise InputError(f"{where}: {there} is a file; expected a folder, which is made where there is none")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{where}: nothing can be written to {there}; expected another folder")


def check_file(path: str | Path) -> None:
    """Raise `InputError` for a file that cannot be written, such as one in a folder's place."""
    if Path(path).is_dir():
        raise InputError(f"{path}: is a folder; expected the name of a file to write")
    check_folder(Path(path).parent, str(path))


def write_whole(path: str | Path, write: Callable[[IO[bytes]], object]) -> None:
    """Let `write` fill a file; it replaces `path` only when complete. Raises `InputError` as `check_file` does."""
    check_file(path)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=PART)
    try:
        with os.fdopen(descriptor, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise


def save_json(path: str | Path, content: Any) -> None:
    """Write `content` (arrays and NumPy numbers allowed) as JSON; a number that is not finite as null."""
    text = json.dumps(plain(content), indent=2, allow_nan=False) + "\n"
    write_whole(path, lambda file: file.write(text.encode()))


def plain(value: Any) -> Any:
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return plain(np.asarray(value).tolist())


def save_arrays(path: str | Path, **arrays: Any) -> None:
    """Write arrays by their names as a compressed npz file."""
    plain = {name: np.asarray(array) for name, array in arrays.items()}
    write_whole(path, lambda file: np.savez_compressed(file, **plain))  # type: ignore[arg-type]

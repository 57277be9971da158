"""From one kind of file to another, by the endings of their names."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.formats.engine_scenes import read_engine
from jaxgrity.formats.foreign import Imported
from jaxgrity.formats.matlab import read_matlab, save_matlab
from jaxgrity.formats.meshes import save_mesh
from jaxgrity.formats.mjcf_reading import read_mjcf
from jaxgrity.formats.mjcf_writing import save_mjcf
from jaxgrity.formats.ntrt import read_ntrt
from jaxgrity.formats.ntrt_writing import save_ntrt
from jaxgrity.formats.spreadsheets import read_tables, save_tables
from jaxgrity.formats.urdf import save_urdf
from jaxgrity.io.scene_files import load_scene, scene_names
from jaxgrity.io.scene_writing import save_scene
from jaxgrity.model.scene import Scene


class Format(NamedTuple):
    """A kind of file."""

    name: str
    endings: tuple[str, ...]
    read: Callable[[Path], Imported] | None
    write: Callable[[Scene, Path], tuple[str, ...]] | None
    """returns sentences on what the file does not hold"""


def _read_scene(path: Path) -> Imported:
    return Imported(load_scene(path), ("SI units, z up",))


def _write_scene(scene: Scene, path: Path) -> tuple[str, ...]:
    save_scene(scene, path)
    return ()


def _write_mjcf(scene: Scene, path: Path) -> tuple[str, ...]:
    return save_mjcf(scene, path).notes


FORMATS = (
    Format("scene file (TOML)", (".toml",), _read_scene, _write_scene),
    Format("NTRT structure (YAML)", (".yaml", ".yml"), read_ntrt, save_ntrt),
    Format("MuJoCo model (MJCF)", (".xml", ".mjcf"), read_mjcf, _write_mjcf),
    Format("MATLAB file", (".mat",), read_matlab, save_matlab),
    Format("tables (CSV)", (".csv",), read_tables, save_tables),
    Format("robot of a differentiable engine (JSON)", (".json",), read_engine, None),
    Format("robot description (URDF)", (".urdf",), None, save_urdf),
    Format("mesh", (".glb", ".obj"), None, save_mesh),
)
"""All kinds of files that hold a robot."""


@typed
def read_any(path: str | Path) -> Imported:
    """A robot from a file of any kind that is read, by its ending, or a scene of the library by its name.

    Raises `InputError` where the ending is unknown, or as the reader of that kind does.
    """
    if str(path) in scene_names():
        return _read_scene(Path(path))
    found = find_format(path)
    if found.read is None:
        raise InputError(f"{path}: a {found.name} is not read; expected {_endings(lambda each: each.read)}")
    return found.read(Path(path))


@typed
def write_any(scene: Scene, path: str | Path) -> tuple[str, ...]:
    """Write a robot as a file of any kind that is written, by its ending. Returns what such a file does not hold.

    Raises `InputError` where the ending is unknown, or the scene has what that kind of file cannot hold.
    """
    return writer_of(path)(scene, Path(path))


def writer_of(path: str | Path) -> Callable[[Scene, Path], tuple[str, ...]]:
    """What writes files of this kind. Raises `InputError` where nothing does."""
    found = find_format(path)
    if found.write is None:
        raise InputError(f"{path}: a {found.name} is not written; expected {_endings(lambda each: each.write)}")
    return found.write


def find_format(path: str | Path) -> Format:
    """The kind of file that an ending stands for. Raises `InputError` where it is unknown."""
    for found in FORMATS:
        if Path(path).suffix.lower() in found.endings:
            return found
    raise InputError(f"{path}: unknown ending; expected {_endings(lambda each: True)}")


def _endings(wanted: Callable[[Format], object]) -> str:
    return ", ".join(ending for each in FORMATS if wanted(each) for ending in each.endings)

"""Convert a robot between file formats: TOML, NTRT (YAML), MuJoCo (XML), MATLAB, CSV, URDF, GLB, OBJ."""

from pathlib import Path

from jaxgrity.cli.settings import ConvertSettings
from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.formats.conversion import find_format, read_any, write_any
from jaxgrity.formats.foreign import Imported
from jaxgrity.formats.mjcf_reading import read_mjcf
from jaxgrity.formats.ntrt import DECIMETRE, read_ntrt
from jaxgrity.formats.spreadsheets import read_tables
from jaxgrity.io.files import check_file
from jaxgrity.model.scene import Scene
from jaxgrity.statics.settling import settled

MUJOCO = (".xml", ".mjcf")
"""Endings of MuJoCo models."""


def main(settings: ConvertSettings) -> None:
    """Read, settle on request, write, and report what was read how and what was lost."""
    found = _read(settings)
    print(f"read {settings.source}: {counts(found.scene)}")
    print("\n".join(f"  {note}" for note in found.notes))
    scene = found.scene
    if settings.settle:
        scene, moved = settled(scene)
        print(f"settled: nodes moved by up to {moved:.4g} m")
    lost = write_any(scene, settings.target)
    print(f"wrote {settings.target}")
    print("\n".join(f"  {note}" for note in lost or ("nothing is lost",)))


def _read(settings: ConvertSettings) -> Imported:
    find_format(settings.target)  # refuses what it does not know before anything is read
    check_file(settings.target)
    ending, unit = Path(settings.source).suffix.lower(), settings.unit
    if settings.columns and ending != ".csv":
        raise InputError(f"--columns {' '.join(settings.columns)}: expected --columns with tables (.csv) alone")
    if settings.keyframe and ending not in MUJOCO:
        raise InputError(f"--keyframe {settings.keyframe}: expected --keyframe with MuJoCo models (.xml) alone")
    if ending in (".yaml", ".yml"):
        return read_ntrt(settings.source, DECIMETRE if unit is None else unit, settings.drop)
    if unit is not None:
        raise InputError(f"--unit {unit:g}: {settings.source} is read in metres; expected --unit with NTRT files alone")
    if ending in MUJOCO:
        return read_mjcf(settings.source, settings.drop, settings.keyframe)
    if settings.drop:
        found = f"--drop {' '.join(settings.drop)}: {settings.source} is read whole"
        raise InputError(f"{found}; expected --drop with NTRT files and MuJoCo models alone")
    if ending == ".csv":
        return read_tables(settings.source, dict(pair.rpartition("=")[::2] for pair in settings.columns))
    return read_any(settings.source)


def counts(scene: Scene) -> str:
    """The size of a robot, in words."""
    structure = scene.structure
    struts, cables = (len(m.edges) if m is not None else 0 for m in (structure.struts, structure.cables))
    bodies = f"{len(structure.bodies)} rigid bodies, " if structure.bodies else ""
    return f"{len(structure.nodes)} nodes, {bodies}{struts} struts, {cables} cables, {in_digits(structure.mass, 4)} kg"

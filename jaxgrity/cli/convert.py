"""Convert a robot between file formats: TOML, NTRT (YAML), MuJoCo (XML), MATLAB, CSV, JSON, URDF, GLB, OBJ."""

import dataclasses
from pathlib import Path

import numpy as np

from jaxgrity.cli.settings import ConvertSettings
from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.formats.conversion import read_any, write_any, writer_of
from jaxgrity.formats.engine_scenes import read_engine
from jaxgrity.formats.foreign import Imported
from jaxgrity.formats.mjcf_reading import read_mjcf
from jaxgrity.formats.ntrt import DECIMETRE, read_ntrt
from jaxgrity.formats.spreadsheets import read_tables
from jaxgrity.io.files import check_file
from jaxgrity.model.inertia import rod_inertia, with_mass_at_ends
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
    if settings.mass_at_ends:
        print(f"  {ends_words(scene, settings.source)}")
        scene = dataclasses.replace(scene, structure=with_mass_at_ends(scene.structure))
    if settings.settle:
        scene, moved = settled(scene)
        print(f"settled: nodes moved by up to {moved:.4g} m")
    lost = write_any(scene, settings.target)
    print(f"wrote {settings.target}")
    print("\n".join(f"  {note}" for note in lost or ("nothing is lost",)))
    if settings.target.suffix.lower() == ".toml" and (words := gait_words(found)):
        print(f"  {words}")


def _read(settings: ConvertSettings) -> Imported:
    writer_of(settings.target)  # refuses what it does not know before anything is read
    check_file(settings.target)
    ending, unit = Path(settings.source).suffix.lower(), settings.unit
    if settings.columns and ending != ".csv":
        raise InputError(f"--columns {' '.join(settings.columns)}: expected --columns with tables (.csv) alone")
    if settings.keyframe and ending not in MUJOCO:
        raise InputError(f"--keyframe {settings.keyframe}: expected --keyframe with MuJoCo models (.xml) alone")
    if ending in (".yaml", ".yml"):
        return read_ntrt(settings.source, DECIMETRE if unit is None else unit, settings.drop)
    if ending == ".json":
        return read_engine(settings.source, 1.0 if unit is None else unit, settings.drop)
    if unit is not None:
        found = f"--unit {unit:g}: {settings.source} is read in metres"
        raise InputError(f"{found}; expected --unit with NTRT (.yaml) and JSON files alone")
    if ending in MUJOCO:
        return read_mjcf(settings.source, settings.drop, settings.keyframe)
    if settings.drop:
        found = f"--drop {' '.join(settings.drop)}: {settings.source} is read whole"
        raise InputError(f"{found}; expected --drop with NTRT and JSON files and MuJoCo models alone")
    if ending == ".csv":
        return read_tables(settings.source, dict(pair.rpartition("=")[::2] for pair in settings.columns))
    return read_any(settings.source)


def ends_words(scene: Scene, source: str) -> str:
    """What it changes to put the mass of members at their ends, in words. Raises `InputError` where none has mass."""
    structure, parts = scene.structure, []
    for name, members, _ in structure.numbered:
        if members.mass is None or not np.any(members.mass):
            continue
        mass, lengths = np.asarray(members.mass, float), np.asarray(members.rest_length, float)
        ends = np.asarray(structure.node_mass, float)[np.asarray(members.edges)]
        whole = mass + ends.sum(axis=1)
        k = int(np.argmax(whole))
        found, known = (in_digits(rod_inertia(mass, ends, lengths, moved)[k], 3) for moved in (True, False))
        parts.append(
            f"{np.count_nonzero(mass)} {name} have their mass at their ends now. The heaviest has "
            f"{in_digits(float(whole[k]), 3)} kg with its ends, and a moment of inertia of {found} kg m^2 about its "
            f"centre of mass in place of {known}"
        )
    if not parts:
        raise InputError(f"--mass-at-ends: no member of {source} has a mass of its own; expected rods with mass")
    return "; ".join(parts)


def gait_words(found: Imported) -> str:
    """Which members a gait may move, in words, where neither the scene nor a note says so; else empty."""
    structure = found.scene.structure
    if found.scene.gait is not None or not structure.member_count or any("[gait] members" in n for n in found.notes):
        return ""
    kind = "struts" if structure.cables is None else "cables"
    return f'the file names no actuators. For a search, add a [gait] and choose them: [gait] members = "{kind}"'


def counts(scene: Scene) -> str:
    """The size of a robot, in words."""
    structure = scene.structure
    struts, cables = (len(m.edges) if m is not None else 0 for m in (structure.struts, structure.cables))
    bodies = f"{len(structure.bodies)} rigid bodies, " if structure.bodies else ""
    return f"{len(structure.nodes)} nodes, {bodies}{struts} struts, {cables} cables, {in_digits(structure.mass, 4)} kg"

"""Gaits as files, and the library's own gaits."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.io.files import found_file, read_json, shipped
from jaxgrity.model.actuation import Gait, Overtone
from jaxgrity.model.structure import Structure


def gait_names() -> tuple[str, ...]:
    """The names of the library's gaits."""
    return tuple(shipped("gaits"))


@typed
def load_gait(name: str | Path) -> Gait:
    """A gait of the library by its name, or one from a JSON file (`gait.json` of a search).

    Raises `InputError` for an unknown name and an incomplete file.
    """
    return gait_of(gait_record(name), str(name))


@typed
def gait_record(name: str | Path) -> dict[str, Any]:
    """What a gait's JSON file holds, as a dictionary: the gait, its scene, its results, and its command.

    `name` is that of a library gait, or the path of a file. Raises `InputError` for an unknown name, and for a file
    that is not JSON.
    """
    path = found_file("gait", "gaits", name)
    if path.is_dir():
        raise InputError(f"gait {str(name)!r}: a folder; expected a file, such as {path / 'gait.json'}")
    return read_json(path)


def gait_of(record: dict[str, Any], where: str) -> Gait:
    """The gait of a record. Raises `InputError` for a missing or a wrong part."""
    try:
        parts = {name: np.array(record[name], float) for name in ("phase", "amplitude", "frequency")}
        overtones = tuple(Overtone(np.array(o["size"]), np.array(o["phase"])) for o in record.get("overtones", []))
        members, start, ramp = tuple(int(k) for k in record["members"]), float(record["start"]), float(record["ramp"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{where}: not a gait: {error}; expected what a search leaves in gait.json") from error
    for name, part in parts.items():
        if part.shape != (len(members),) or not np.isfinite(part).all():
            raise InputError(f"{where}: {name} = {record[name]}: expected {len(members)} finite numbers")
    for name in ("robot", "scene"):
        if not isinstance(record.get(name), str | None):
            raise InputError(f"{where}: {name} = {record[name]}: expected a text, as a search leaves it in gait.json")
    phase, amplitude, frequency = parts.values()
    return Gait(members, phase, amplitude, frequency, start, ramp, overtones, record.get("robot"))


@typed
def gait_facts(gait: Gait, structure: Structure | None = None) -> dict[str, Any]:
    """A gait as a dictionary with the keys of a gait's JSON file, which `load_gait` reads; arrays stay arrays.

    If you pass the robot's `structure`, `with_gait` refuses the gait for any other robot.
    """
    robot = gait.robot if structure is None else structure.robot
    return {
        "robot": robot,
        "members": gait.members,
        "phase": gait.phase,
        "amplitude": gait.amplitude,
        "frequency": gait.frequency,
        "start": float(gait.start),
        "ramp": float(gait.ramp),
        "overtones": [{"size": o.size, "phase": o.phase} for o in gait.overtones],
    }

"""JSON files of differentiable engines: what they hold, with the place of what is wrong."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrity.core.errors import InputError, unknown
from jaxgrity.formats.foreign import finite, numbers, read_limited, short

ROBOTS = {"tensegrity_robot_config": "springs", "tensegrity_cfg": "cables"}
"""Tables that hold a robot, with the name of its cables there: of the engine by formulas, and of the one with a
network."""


def parsed(path: str | Path) -> dict[str, Any]:
    """What the file holds. All numbers are floats. Of two values of a key the last one counts, as in the engines."""
    text = read_limited(path)
    try:
        found = json.loads(text, parse_int=float)
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: not JSON: {error}") from error
    except RecursionError:
        raise InputError(f"{path}: lists and tables are nested too deeply; expected a robot") from None
    if not isinstance(found, dict) or not any(name in found for name in ROBOTS):
        raise InputError(f"{path}: holds no robot of a differentiable engine; expected a table {' or '.join(ROBOTS)}")
    return found


def parts_in(table: dict[str, Any], key: str, where: str) -> list[Any]:
    found = taken(table, key, where)
    if not isinstance(found, list) or not found:
        raise InputError(f"{where}.{key} = {short(found)}: expected a list of at least one")
    return found


def taken(table: dict[str, Any], key: str, where: str) -> Any:
    """What a table says under a key. Raises `InputError` where it says nothing."""
    if key not in table:
        raise InputError(f"{where}.{key} is missing; expected it")
    return table[key]


def table_of(value: Any, where: str) -> dict[str, Any]:
    """A table. Raises `InputError` where it is none."""
    if not isinstance(value, dict):
        raise InputError(f"{where} = {short(value)}: expected names with their values")
    return value


def name_in(table: dict[str, Any], key: str, where: str) -> str:
    """A name. Raises `InputError` where it is none."""
    value = taken(table, key, where)
    if not isinstance(value, str) or not value.isprintable():
        raise InputError(f"{where}.{key} = {short(value)}: expected a name")
    return value


def number_in(table: dict[str, Any], key: str, where: str, check: Any = finite) -> float:
    """A number, as `check` has it. Raises `InputError` where it is none."""
    value = taken(table, key, where)
    if not isinstance(value, float):  # text, and true and false, which Python would take for numbers
        raise InputError(f"{where}.{key} = {short(value)}: expected a number")
    return check(value, f"{where}.{key}")


def vector_of(value: Any, where: str, count: int = 3) -> np.ndarray:
    """So many numbers. Raises `InputError` where it is something else."""
    if not isinstance(value, list) or not all(isinstance(each, float) for each in value):
        raise InputError(f"{where} = {short(value)}: expected a list of {count} numbers")
    return np.array(numbers(value, count, where))


def check_keys(table: dict[str, Any], known: tuple[str, ...], where: str) -> None:
    """Raises `InputError` for a key that is unknown: it might change the motion."""
    for key in table:
        if key not in known:
            raise InputError(f"{where}.{short(key)}: {unknown(key, known)}; expected only keys that the engines know")

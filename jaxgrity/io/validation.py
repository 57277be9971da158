"""Validation errors in a user's words: the key, the value received, what was expected."""

import re
import reprlib
import sys
import types
import typing
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec

WORDS = {
    float: ("a number", "numbers"),
    int: ("a whole number", "whole numbers"),
    bool: ("true or false", "true or false"),
    str: ("a string", "strings"),
}
"""What is expected, of one and of many, in words of the file."""
GOT = {
    "float": "a number",
    "int": "a whole number",
    "bool": "a boolean",
    "str": "a string",
    "array": "a list",
    "list": "a list",
    "object": "a table",
    "date": "a date",
    "datetime": "a date",
    "time": "a time",
}
"""What was found, in words of the file, by the words of msgspec."""


def explain(message: str, tables: dict, model: type) -> str:
    """msgspec's `message` about `tables`, converted to `model`, as "key = value: expected ...".

    msgspec ends a message with the path to the place, such as "... - at `$.cables.stiffness[3]`".
    """
    reason, _, path = message.partition(" - at `$")
    steps = [int(index) if index else name for name, index in re.findall(r"\.([^.\[\]`]+)|\[(\d+)\]", path)]
    value: Any = tables
    kinds: list[Any] = [model]
    for step in steps:
        kinds, value = _inside(kinds, value, step), value[step]
    unknown = re.search(r"unknown field `(.*)`", reason, re.DOTALL)
    if unknown:
        key = place([*steps, unknown[1]])
        what, table = "key" if steps else "table", _table(kinds, value)
        known, advice = ", ".join(_keys(table)), getattr(table, "elsewhere", {}).get(unknown[1])
        found = f"{key}{_received(value.get(unknown[1]))}: unknown {what}; expected one of {known}"
        return found if advice is None else f"{found}; {advice}"
    missing = re.search(r"required field `(.*)`", reason)
    if missing:
        return f"{place([*steps, missing[1]])}: missing; expected {_expected(_inside(kinds, value, missing[1]))}"
    got = re.search(r", got `?(\w+)", reason)
    tail = f", got {GOT.get(got[1], got[1])}" if got else ""
    return f"{place(steps)}{_received(value)}: expected {_expected(kinds)}{tail}"


def place(steps: Sequence[str | int]) -> str:
    """The place of a value in the file, such as `cables.stiffness[3]`; a key that is no plain word is quoted."""
    text = ""
    for step in steps:
        if isinstance(step, int):
            text += f"[{step}]"
        else:
            text += "." + (step if re.fullmatch(r"[\w-]+", step) else repr(step))
    return text.removeprefix(".")


def not_finite(value: Any, steps: tuple[str | int, ...] = ()) -> Iterator[tuple[str, int | float]]:
    """The numbers of a file that are infinite, NaN or too large for a float, and their places."""
    if isinstance(value, (int, float)) and not abs(value) <= sys.float_info.max:
        yield place(steps), value
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for step, item in items:
        yield from not_finite(item, (*steps, step))


class _Shown(reprlib.Repr):
    """Values as in the file, long ones shortened."""

    def repr_bool(self, value: bool, level: int) -> str:
        return "true" if value else "false"

    def repr_date(self, value: Any, level: int) -> str:
        return str(value)

    repr_datetime = repr_time = repr_date


shown = _Shown().repr


def _received(value: Any) -> str:
    return "" if isinstance(value, dict) else f" = {shown(value)}"


def _expected(kinds: Sequence[Any], many: bool = False) -> str:
    *others, last = (_named(kind, many) for kind in kinds)
    return f"{', '.join(others)} or {last}" if others else last


def _named(kind: Any, many: bool = False) -> str:
    """A type in a user's words: `float` is a number, `list[int]` a list of whole numbers."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Annotated:
        return _named(inner[0], many) + "".join(_limits(limit) for limit in inner[1:])
    if origin is typing.Literal:
        return repr(inner[0])
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_named(part, many) for part in inner)
    if origin in (list, tuple):
        size = f"{len(inner)} " if origin is tuple else ""
        return f"{'lists' if many else 'a list'} of {size}{_expected(_parts(inner[0]), many=True)}"
    if kind in WORDS:
        return WORDS[kind][many]
    tag = kind.__struct_config__.tag_field
    return f"a table ({f'{tag} = {kind.__struct_config__.tag!r}' if tag else ', '.join(kind.__struct_fields__)})"


def _limits(limit: msgspec.Meta) -> str:
    signs = {">": limit.gt, ">=": limit.ge, "<": limit.lt, "<=": limit.le}
    text = " and ".join(f"{sign} {number:.4g}" for sign, number in signs.items() if number is not None)
    least = f", at least {limit.min_length}" if limit.min_length is not None else ""
    return (f" {text}" if text else "") + least


def _inside(kinds: Sequence[Any], value: Any, step: str | int) -> list[Any]:
    """The allowed types at `step`, a key or an index, inside a `value` of one of the `kinds`."""
    found: list[Any] = []
    for kind in kinds:
        kind = typing.get_args(kind)[0] if typing.get_origin(kind) is typing.Annotated else kind
        if isinstance(step, int):
            found += _parts(typing.get_args(kind)[0]) if typing.get_origin(kind) in (list, tuple) else []
        elif _is_table(kind) and step == kind.__struct_config__.tag_field:
            found.append(typing.Literal[kind.__struct_config__.tag])
        elif _is_table(kind) and _fits(kind, value):
            found += _parts(typing.get_type_hints(kind, include_extras=True)[step])
    return found


def _table(kinds: Sequence[Any], value: dict) -> Any:
    """The type of a table with this `value`."""
    return next(kind for kind in kinds if _is_table(kind) and _fits(kind, value))


def _keys(kind: Any) -> list[str]:
    """The keys that a table of a type may have."""
    tag = kind.__struct_config__.tag_field
    return [*([tag] if tag else []), *kind.__struct_fields__]


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _fits(kind: Any, value: dict) -> bool:
    tag = kind.__struct_config__.tag_field
    return tag is None or value.get(tag) == kind.__struct_config__.tag


def _parts(hint: Any) -> list[Any]:
    """The types of a hint, each choice of an enumeration by itself, without None."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return [part for member in typing.get_args(hint) for part in _parts(member)]
    if typing.get_origin(hint) is typing.Literal:
        return [typing.Literal[choice] for choice in typing.get_args(hint)]
    return [] if hint is type(None) else [hint]

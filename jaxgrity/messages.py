"""Validation errors in a user's words: the key, the value received, what was expected."""

import re
import types
import typing
from typing import Any

import msgspec

WORDS = {
    "float": "a number",
    "int": "a whole number",
    "bool": "true or false",
    "str": "a text",
    "array": "a list",
    "object": "a table",
    "null": "nothing",
}


def explain(message: str, tables: dict, model: type) -> str:
    """What msgspec's `message` says of `tables`, converted to `model`: key = value: what was expected.

    msgspec ends a message with the path to the place, such as "... - at `$.cables.stiffness[3]`".
    """
    reason, _, path = message.partition(" - at `$")
    key = path.rstrip("`").lstrip(".")
    value = _look_up(tables, key)
    unknown = re.search(r"unknown field `(.*)`", reason)
    if unknown:
        name = unknown[1]
        place, keys = f"{key}.{name}".lstrip("."), ", ".join(_keys(model, key, value))
        return f"{place}{_received(value.get(name))}: unknown {'key' if key else 'table'}; expected one of {keys}"
    missing = re.search(r"required field `(.*)`", reason)
    if missing:
        return f"{key}.{missing[1]}".lstrip(".") + ": missing; expected it to be given"
    if reason.startswith(("Invalid value", "Invalid enum value")):
        return f"{key} = {value!r}: expected {' or '.join(repr(c) for c in _choices(model, key))}"
    return f"{key}{_received(value)}: {_in_words(reason)}"


def _received(value: Any) -> str:
    return "" if isinstance(value, dict) else f" = {value!r}"


def _in_words(reason: str) -> str:
    """msgspec's names of types, such as `float | array`, as a user would name what the file holds."""

    def words(match: re.Match) -> str:
        names = [WORDS.get(name, name) for name in match[1].split(" | ") if name != "null"]
        return " or ".join(names)

    text = re.sub(r"`([^`]*)`", words, reason)
    return re.sub(r"(\d)\.0\b", r"\1", text[:1].lower() + text[1:])


def _look_up(tables: Any, key: str) -> Any:
    for step in re.findall(r"[^.\[\]]+", key):
        if isinstance(tables, list) and step.isdigit():
            tables = tables[int(step)]
        elif isinstance(tables, dict) and step in tables:
            tables = tables[step]
    return tables


def _keys(model: type, key: str, table: Any) -> list[str]:
    """The keys that the table at `key` may have."""
    config = next(c for c in _models(model, key) if _fits(c, table))
    tag = [config.__struct_config__.tag_field] if config.__struct_config__.tag_field else []
    return [*tag, *config.__struct_fields__]


def _fits(model: Any, table: Any) -> bool:
    tag = model.__struct_config__.tag_field
    return tag is None or table.get(tag) == model.__struct_config__.tag


def _choices(model: type, key: str) -> list[str]:
    """The texts that stand for something at `key`: an enumeration's, or the tags of the kinds of table."""
    table, _, name = key.rpartition(".")
    found: list[str] = []
    for config in _models(model, table):
        if config.__struct_config__.tag_field == name:
            found.append(config.__struct_config__.tag)
        elif name in config.__struct_fields__:
            kinds = _parts(typing.get_type_hints(config)[name])
            found += [c for kind in kinds if typing.get_origin(kind) is typing.Literal for c in typing.get_args(kind)]
    return list(dict.fromkeys(found))


def _models(model: type, key: str) -> list[Any]:
    """The msgspec structures that the table at `key` may be."""
    models: list[Any] = [model]
    for step in filter(None, key.split(".")):
        parts = [p for m in models for p in _parts(typing.get_type_hints(m)[step])]
        models = [p for p in parts if isinstance(p, type) and issubclass(p, msgspec.Struct)]
    return models


def _parts(hint: Any) -> tuple:
    """The members of a union, or the one type."""
    union = typing.get_origin(hint) in (typing.Union, types.UnionType)
    return typing.get_args(hint) if union else (hint,)

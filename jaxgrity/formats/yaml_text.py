"""YAML of which every scalar is text, within limits: no aliases, no deep nesting, no key twice."""

from typing import Any

import yaml

from jaxgrity.core.errors import InputError

DEEPEST = 20
"""Most levels of lists and tables within each other."""
MOST_EVENTS = 30_000
"""Most scalars, and beginnings and ends of lists and tables, in one file."""


def parse_yaml(text: str) -> Any:
    """Tables, lists and strings: `no` and `1e3` stay as they are written; None where there is nothing.

    Raises `InputError`, with the line, where the text is no YAML, has aliases, tags or several documents, is nested too
    deeply or too long, or gives a key twice, of which other readers take the last without a word.
    """
    found: list[Any] = []
    open_ones: list[tuple[Any, list[str]]] = [(found, [])]
    line = 1
    try:
        for number, event in enumerate(yaml.parse(text, Loader=yaml.BaseLoader)):
            line = event.start_mark.line + 1
            if number > MOST_EVENTS:
                raise InputError(f"line {line}: is too long; expected at most {MOST_EVENTS} values")
            _take(event, open_ones, line)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise InputError(f"line {line if mark is None else mark.line + 1}: not YAML: {problem}") from error
    if len(found) > 1:
        raise InputError("has several documents; expected one")
    return found[0] if found else None


def _take(event: yaml.Event, open_ones: list[tuple[Any, list[str]]], line: int) -> None:
    """Put what an event brings into the innermost list or table that is open."""
    if isinstance(event, yaml.AliasEvent):
        raise InputError(f"line {line}: *{event.anchor} is an alias; expected what it stands for")
    if isinstance(event, yaml.CollectionEndEvent):
        open_ones.pop()
    if not isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent):
        return
    if event.tag is not None and event.tag != "!":
        raise InputError(f"line {line}: {event.tag} is a tag; expected plain values")
    value: Any = event.value if isinstance(event, yaml.ScalarEvent) else {}
    if isinstance(event, yaml.SequenceStartEvent):
        value = []
    inside, key = open_ones[-1]
    if isinstance(inside, list):
        inside.append(value)
    elif key:
        inside[key.pop()] = value
    elif not isinstance(value, str):
        raise InputError(f"line {line}: a list or a table stands for a key; expected a name")
    elif value in inside:
        raise InputError(f"line {line}: {value!r} is there twice; expected each key once")
    else:
        key.append(value)
    if isinstance(event, yaml.CollectionStartEvent):
        open_ones.append((value, []))
        if len(open_ones) > DEEPEST:
            raise InputError(f"line {line}: lists or tables within each other, more than {DEEPEST} levels deep")

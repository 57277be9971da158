"""YAML of which every scalar is text, within limits, and the line of each value."""

from typing import Any, NamedTuple

import yaml

from jaxgrity.core.errors import InputError

DEEPEST = 20
"""Most levels of lists and tables within each other."""
MOST_VALUES = 30_000
"""Most scalars, lists and tables in one file, those that aliases repeat too."""
PLAIN = {f"tag:yaml.org,2002:{kind}" for kind in ("str", "seq", "map")}
"""What a value is where the file gives it no tag."""


class YamlText(NamedTuple):
    """What a file says, and where."""

    value: Any
    """tables, lists and strings: `no` and `1e3` stay as they are written; None where there is nothing"""
    lines: dict[str, int]
    """the line, from 1, of each value, by its place, such as `nodes.a[2]`"""


class _Loader(yaml.BaseLoader):
    """PyYAML's own, which stops where a file is deeper or longer than that of a robot."""

    depth = count = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        mark = self.peek_event().start_mark
        self.depth, self.count = self.depth + 1, self.count + 1
        if self.depth > DEEPEST:
            raise yaml.MarkedYAMLError(problem=f"more than {DEEPEST} levels within each other", problem_mark=mark)
        if self.count > MOST_VALUES:
            raise yaml.MarkedYAMLError(problem=f"more than {MOST_VALUES} values", problem_mark=mark)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


def parse_yaml(text: str) -> YamlText:
    """Tables, lists and strings of a file, with their lines. A tab is a space, as in yaml-cpp, which NTRT uses.

    Raises `InputError`, with the line, if the text is no YAML, has tags or several documents, or is nested too deeply
    or too long. A key that comes twice is refused too: other readers take the last one without a word.
    """
    try:
        node = _Loader(text.replace("\t", " ")).get_single_node()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise InputError(f"{'' if mark is None else f'line {mark.line + 1}: '}not YAML: {problem}") from error
    lines: dict[str, int] = {}
    return YamlText(None if node is None else _plain(node, "", lines, 0), lines)


def _plain(node: yaml.Node, place: str, lines: dict[str, int], depth: int) -> Any:
    """A node and all within it; what aliases repeat is there as often."""
    line = node.start_mark.line + 1
    lines[place] = line
    if node.tag not in PLAIN:
        raise InputError(f"line {line}: {node.tag} is a tag; expected plain values")
    if depth > DEEPEST or len(lines) > MOST_VALUES:
        raise InputError(f"line {line}: aliases repeat more than {MOST_VALUES} values, or themselves; expected fewer")
    if isinstance(node, yaml.ScalarNode):
        return node.value
    if isinstance(node, yaml.SequenceNode):
        return [_plain(each, f"{place}[{k}]", lines, depth + 1) for k, each in enumerate(node.value)]
    found: dict[str, Any] = {}
    for key, value in node.value:
        line = key.start_mark.line + 1
        if not isinstance(key, yaml.ScalarNode):
            raise InputError(f"line {line}: a list or a table stands for a key; expected a name")
        if key.value in found:
            raise InputError(f"line {line}: {key.value!r} is there twice; expected each key once")
        found[key.value] = _plain(value, f"{place}.{key.value}" if place else key.value, lines, depth + 1)
    return found


def with_line(message: str, lines: dict[str, int]) -> str:
    """A message that begins with the place of a value, after the line of that value."""
    places = [place for place in lines if place and message.startswith(place)]
    return f"line {lines[max(places, key=len)]}: {message}" if places else message

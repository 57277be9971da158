"""The text of a MuJoCo model as MuJoCo's compiler is given it: included files in their places, pictures left out.

Elements stay on their lines, so that messages of the compiler name these. What an included file holds stands on the
line of the element that includes it.
"""

import re
from pathlib import Path
from typing import Any
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import read_limited, short

REFUSED = {
    **dict.fromkeys(("replicate", "composite", "flexcomp", "flex", "attach"), "makes many parts of one"),
    **dict.fromkeys(("hfield", "mesh", "skin", "model", "plugin", "extension"), "takes its shape from elsewhere"),
}
"""Elements that are refused, and what they do."""
LEFT_OUT = ("asset", "visual", "statistic", "light", "camera", "sensor", "custom", "size")
"""Elements that move nothing. Meshes and fields of heights stand within assets, and are refused nevertheless. Sizes ask
for memory, which MuJoCo now finds by itself."""
NO_LONGER = ("sensornoise", "material", "collision", "mpr_iterations", "mpr_tolerance")
"""Attributes that name what is left out, or that MuJoCo knew once and that move nothing here."""
ELEMENTS = {
    **{tag: tag for tag in ("body", "geom", "site")},
    "tendon": "spatial|fixed",
    "actuator": "general|motor|position|velocity|intvelocity|damper|cylinder|muscle|adhesion",
    "equality": "connect|weld|joint|tendon|flex",
}
"""Elements of parts that messages name."""
PLACES = {
    "air of ": r"<option\b[^>]* (?:density|viscosity)=",
    "gravity is ": r"<option\b[^>]* gravity=",
    "option flag ": r"<flag\b",
    "the plane's normal ": r"<geom\b[^>]* type=\"plane\"",
}
"""Elements of what messages begin with, where it has no name."""
TURNS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")
"""Attributes that turn a body."""
DEEPEST = 50
"""Most levels of XML elements within each other."""
MOST_INCLUDED = 50
"""Most files that one model includes."""


class _Text:
    """What is read so far."""

    def __init__(self, main: Path, pairs_alone: bool = False):
        self.main, self.pairs_alone = main, pairs_alone
        self.seen: list[Path] = []
        self.out: list[str] = []
        self.everywhere = False
        """whether positions are those in the world, as MuJoCo before 2.3.4 could have them"""
        self.predefined = False
        """whether the pairs alone touch, as MuJoCo before 3 could have it"""

    def read(self, path: Path, lines: bool) -> None:
        """Add a file, with line breaks where it has them. Raises `InputError`, with the line, as `mjcf_text` does."""
        if path.resolve() in self.seen or len(self.seen) > MOST_INCLUDED:
            raise InputError(f"includes {path.name} twice, or more than {MOST_INCLUDED} files; expected each once")
        self.seen.append(path.resolve())
        parser = expat.ParserCreate()
        one = _OneFile(self, parser, lines)
        parser.StartElementHandler, parser.EndElementHandler = one.start, one.end
        parser.StartDoctypeDeclHandler = one.refuse_doctype
        try:
            parser.Parse(read_limited(path), True)
        except expat.ExpatError as error:
            raise InputError(f"line {error.lineno}: not XML: {expat.ErrorString(error.code)}") from error
        except InputError as error:
            raise InputError(f"line {parser.CurrentLineNumber}: {error}") from error


class _OneFile:
    """The handlers of one file."""

    def __init__(self, text: _Text, parser: Any, lines: bool):
        self.text, self.parser, self.lines = text, parser, lines
        self.open: list[str] = []
        self.hidden = 0
        self.line = 1

    def refuse_doctype(self, *_: Any) -> None:
        raise InputError("has a document type or entities; expected plain elements")

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self.open.append(tag)
        if len(self.open) > DEEPEST:
            raise InputError(f"elements within each other, more than {DEEPEST} levels deep")
        if tag in REFUSED:
            raise InputError(f"<{tag}> {REFUSED[tag]}; expected bodies, sites, tendons and actuators alone")
        if self.lines:
            self.text.out.append("\n" * (self.parser.CurrentLineNumber - self.line))
            self.line = self.parser.CurrentLineNumber
        if tag == "include":
            self._include(attributes.get("file", ""))
        if self.hidden or tag in LEFT_OUT or tag == "include":
            self.hidden += 1
        elif len(self.open) > 1 or self.lines:
            self.text.out.append(f"<{tag}{''.join(self._attributes(tag, attributes))}>")

    def end(self, tag: str) -> None:
        self.open.pop()
        if self.hidden:
            self.hidden -= 1
        elif self.open or self.lines:
            self.text.out.append(f"</{tag}>")

    def _include(self, name: str) -> None:
        folders = (self.text.main.parent, self.text.seen[-1].parent)
        found = next((folder / name for folder in folders if (folder / name).is_file()), None)
        if found is None:
            raise InputError(f"<include file={short(name)}>: there is no such file")
        try:
            self.text.read(found, lines=False)
        except InputError as error:
            raise InputError(f"{found.name}: {error}") from error

    def _attributes(self, tag: str, given: dict[str, str]) -> list[str]:
        """As they are, but for pictures; where all positions are those in the world, bodies are at its origin."""
        text = self.text
        if tag == "option" and (collision := given.get("collision", "all")) != "all":
            if collision != "predefined":
                raise InputError(f"<option collision={short(collision)}>: expected all or predefined")
            text.predefined = True
        if tag == "geom" and text.pairs_alone:
            given = {**given, "contype": "0", "conaffinity": "0"}
        if tag == "compiler" and given.get("coordinate") == "global":
            text.everywhere, given = True, {name: value for name, value in given.items() if name != "coordinate"}
        placed = tag in ("geom", "site", "inertial", "joint") and "body" in self.open and given.get("type") != "free"
        if text.everywhere and placed and not {"pos", "fromto"} & set(given):
            raise InputError(f"<{tag}> has no place of its own, in a model with global coordinates; expected pos")
        left_out = {*NO_LONGER, *(("pos", *TURNS) if text.everywhere and tag == "body" else ())}
        return [f" {name}={quoteattr(value)}" for name, value in given.items() if name not in left_out]


def mjcf_text(path: Path) -> str:
    """A model with all that it includes, for MuJoCo's compiler.

    Raises `InputError`, with the line, where a file is no XML or not there, or has what is refused.
    """
    text = _Text(path)
    text.read(path, lines=True)
    if text.predefined:  # the option may stand after the geoms that it is about
        text = _Text(path, pairs_alone=True)
        text.read(path, lines=True)
    return "".join(text.out)


def with_element_lines(message: str, text: str) -> str:
    """A message with the line of each part of a model's text that it names first, by a name or by an attribute."""
    return "; ".join(_with_line(part, text) for part in message.split("; "))


def _with_line(message: str, text: str) -> str:
    part = re.match(rf"({'|'.join(ELEMENTS)}) (\S+?):? |bodies (\S+) and ", message)
    if part:
        element = rf"<(?:{ELEMENTS[part[1] or 'body']})\b[^>]* name={re.escape(quoteattr(part[2] or part[3]))}"
    else:
        element = next((which for begin, which in PLACES.items() if message.startswith(begin)), "")
    found = re.search(element, text) if element else None
    return f"line {text.count(chr(10), 0, found.start()) + 1}: {message}" if found else message

"""A reference page for each group of public names and for each room, as the stubs list them, from their docstrings."""

import inspect
import re
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from sphinx.ext.napoleon import Config, GoogleDocstring

import jaxgrity

PAGES = Path(__file__).parents[1] / "reference"
"""where the pages are written, for Sphinx to read; git ignores them"""


class Group(NamedTuple):
    """Names that belong together, of the package or of one of its rooms."""

    title: str
    names: tuple[str, ...]
    package: str
    stub: str
    """the text of its stub"""

    @property
    def page(self) -> str:
        """The name of its page: the first words of its title."""
        return re.sub(r"\W+", "_", re.split(r"[:,(]", self.title)[0].strip().lower())


def groups() -> tuple[Group, ...]:
    """Those of the package's `__all__`, each of which begins with a comment, its title; and one for each room."""
    stub = _stub(jaxgrity)
    parts = re.split(r"^    # (.*)$", stub.partition("__all__ = [")[2], flags=re.MULTILINE)[1:]
    found = [Group(title, _names(text), "jaxgrity", stub) for title, text in zip(parts[::2], parts[1::2])]
    for name in jaxgrity.SUB_PACKAGES:
        room, text = getattr(jaxgrity, name), _stub(getattr(jaxgrity, name))
        title = f"{room.__name__}: {room.__doc__[0].lower()}{room.__doc__[1:].rstrip('.')}"
        found.append(Group(title, _names(text.partition("__all__ = [")[2]), room.__name__, text))
    return tuple(found)


def _stub(package: ModuleType) -> str:
    return Path(package.__file__).with_suffix(".pyi").read_text(encoding="utf-8")


def _names(text: str) -> tuple[str, ...]:
    return tuple(re.findall(r'"(\w+)"', text))


def entry(name: str, group: Group) -> str:
    """What makes autodoc say what stands in the docstring of a public name."""
    thing = getattr(import_module(group.package), name)
    if inspect.ismodule(thing):
        # what has an entry of its own is not said twice
        lines = f".. rubric:: {thing.__name__}", "", f".. automodule:: {thing.__name__}", "   :members:"
        return "\n".join([*lines, f"   :exclude-members: {', '.join(group.names)}"])
    if inspect.isclass(thing):
        return f".. autoclass:: {group.package}.{name}\n   :members:"
    if callable(thing):
        return f".. autofunction:: {group.package}.{name}"
    # a value has no docstring of its own: it stands below the value, in its module
    stub = group.stub.replace("(\n", "(").replace(",\n    ", ", ")
    home = re.search(rf"^from \.(\S+) import [^\n]*\b{name}\b", stub, re.M)
    assert home, f"{name} is imported from nowhere"
    return f".. autodata:: {group.package}.{home[1]}.{name}\n   :no-value:"


def page(group: Group) -> str:
    """A table of the group's functions and classes, and what each of the names says of itself."""
    title = group.title if group.package != "jaxgrity" else group.title[0].upper() + group.title[1:]
    title = re.sub(r" \(.*\)", "", title)
    lines = [
        title,
        "=" * len(title),
        "",
        f".. currentmodule:: {group.package}",
        "",
        ".. autosummary::",
        "   :nosignatures:",
        "",
    ]
    lines += [f"   {name}" for name in group.names if callable(getattr(import_module(group.package), name))]
    for name in group.names:
        lines += ["", entry(name, group)]
    return "\n".join(lines) + "\n"


def write_pages(app) -> None:
    """Write the reference pages that changed, and the page that lists them."""
    found = groups()
    pages = {f"{group.page}.rst": page(group) for group in found}
    title = "Public names"
    entries = "\n".join(f"   {group.page}" for group in found)
    pages["index.rst"] = f"{title}\n{'=' * len(title)}\n\n.. toctree::\n   :maxdepth: 1\n\n{entries}\n"
    PAGES.mkdir(exist_ok=True)
    for stale in set(PAGES.iterdir()) - {PAGES / name for name in pages}:
        stale.unlink()
    for name, text in pages.items():
        path = PAGES / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


MARKUP = re.compile(r"(`[^`]*`)|([*|\\]|(?<=\w)_(?=\W|$))")
"""code, which stays; or a sign that means something else to reStructuredText"""


def as_plain_text(app, what, name, thing, options, lines: list[str]) -> None:
    """Docstrings are plain text with `code` and sections: other signs stand for themselves, as reStructuredText."""
    plain, in_example = [], False
    for line in lines:
        in_example = line.lstrip().startswith(">>>") or (in_example and bool(line.strip()))
        plain.append(line if in_example else MARKUP.sub(lambda found: found[1] or "\\" + found[2], line))
    # what stands beside an attribute is a sentence, and has no sections
    lines[:] = plain if what in ("attribute", "data") else GoogleDocstring(plain, Config(), app, what, name).lines()


def setup(app) -> dict:
    """Called by Sphinx."""
    app.connect("builder-inited", write_pages)
    app.connect("autodoc-process-docstring", as_plain_text, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

"""A reference page for each group of public names, as jaxgrity/__init__.pyi lists them, from their docstrings."""

import inspect
import re
from pathlib import Path
from typing import NamedTuple

from sphinx.ext.napoleon import Config, GoogleDocstring

import jaxgrity

PAGES = Path(__file__).parents[1] / "reference"
"""where the pages are written, for Sphinx to read; git ignores them"""


class Group(NamedTuple):
    """Names that belong together."""

    title: str
    names: tuple[str, ...]

    @property
    def page(self) -> str:
        """The name of its page: the first words of its title."""
        return re.sub(r"\W+", "_", re.split(r"[:,(]", self.title)[0].strip().lower())


def groups(stub: str) -> tuple[Group, ...]:
    """The groups of `__all__` in the text of a stub file: each begins with a comment, its title."""
    names = stub.partition("__all__ = [")[2]
    parts = re.split(r"^    # (.*)$", names, flags=re.MULTILINE)[1:]
    return tuple(Group(title, tuple(re.findall(r'"(\w+)"', text))) for title, text in zip(parts[::2], parts[1::2]))


def entry(name: str, stub: str) -> str:
    """What makes autodoc say what stands in the docstring of a public name."""
    thing = getattr(jaxgrity, name)
    if inspect.ismodule(thing):
        own = re.findall(r'^    "(\w+)",', stub, re.M)
        # what has an entry of its own is not said twice
        lines = f".. rubric:: {thing.__name__}", "", f".. automodule:: {thing.__name__}", "   :members:"
        return "\n".join([*lines, f"   :exclude-members: {', '.join(own)}"])
    if inspect.isclass(thing):
        return f".. autoclass:: jaxgrity.{name}\n   :members:"
    if callable(thing):
        return f".. autofunction:: jaxgrity.{name}"
    # a value has no docstring of its own: it stands below the value, in its module
    home = re.search(rf"^from \.(\S+) import [^\n]*\b{name}\b", stub.replace("(\n", "(").replace(",\n    ", ", "), re.M)
    assert home, f"{name} is imported from nowhere"
    return f".. autodata:: jaxgrity.{home[1]}.{name}\n   :no-value:"


def page(group: Group, stub: str) -> str:
    """A table of the group's functions and classes, and what each of the names says of itself."""
    title = group.title[0].upper() + re.sub(r" \(.*\)", "", group.title)[1:]
    lines = [
        title,
        "=" * len(title),
        "",
        ".. currentmodule:: jaxgrity",
        "",
        ".. autosummary::",
        "   :nosignatures:",
        "",
    ]
    lines += [f"   {name}" for name in group.names if callable(getattr(jaxgrity, name))]
    for name in group.names:
        lines += ["", entry(name, stub)]
    return "\n".join(lines) + "\n"


def write_pages(app) -> None:
    """Write the reference pages that changed, and the page that lists them."""
    stub = Path(jaxgrity.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    found = groups(stub)
    pages = {f"{group.page}.rst": page(group, stub) for group in found}
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

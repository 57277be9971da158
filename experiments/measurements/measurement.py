"""A measurement: a function whose parameters are its settings, the page that quotes it, its table and its figure."""

import inspect
import re
import sys
from collections.abc import Callable, Generator, Iterator
from dataclasses import field, make_dataclass
from pathlib import Path
from typing import Annotated, Any

from jaxgrity.cli.script import configure, execute, measured

import tyro
from matplotlib.figure import Figure
from pages import made_by
from tqdm import tqdm

from jaxgrity.cli.command_line import from_command_line
from jaxgrity.io.files import save_json
from jaxgrity.report import plot

Record = dict[str, Any]
"""what a measurement leaves, by name; `rows` are those that it yielded, of what it returned the rest"""


class Measurement:
    """What `measurement` makes of a function."""

    def __init__(self, function: Callable[..., Any], page: str, quick: Record, raw: tuple[str, ...], listed: bool):
        self.name, self.page, self.raw, self.listed = function.__name__, page, raw, listed
        self.draw: Callable[[Record], Figure] | None = None
        self._function, self._quick = function, quick
        self._words: Callable[[Record], str] | None = None
        self.Settings = settings_of(function, quick)

    def table(self, words: Callable[[Record], str]) -> Callable[[Record], str]:
        """Decorate the function that says in Markdown what the page quotes of a record."""
        self._words = words
        return words

    def figure(self, draw: Callable[[Record], Figure]) -> Callable[[Record], Figure]:
        """Decorate the function that draws a record."""
        self.draw = plot.styled(draw)
        return self.draw

    def words(self, record: Record) -> str:
        """The table of a record, the command that made it, and where its file is."""
        assert self._words is not None, "a measurement has a table"
        return self._words(record) + made_by(record, self.name)

    def quoted(self, record: Record) -> Record:
        """The record without what pages do not quote."""
        kept = {key: value for key, value in record.items() if key not in self.raw}
        if "rows" in kept:
            kept["rows"] = [{key: row[key] for key in row if key not in self.raw} for row in kept["rows"]]
        self.words(kept)  # a record that lacks something is refused before it is kept
        return kept

    def main(self, settings: Any) -> None:
        """Measure: keep every row as it comes, then the figure, and say the table."""
        chosen = {name: getattr(settings, name) for name in inspect.signature(self._function).parameters}
        path = settings.out / f"{self.name}.json"
        found = self._function(**chosen | (self._quick if settings.quick else {}))
        record = measured() | (found if isinstance(found, dict) else row_by_row(found, path))
        save_json(path, record)
        if self.draw is not None:
            plot.save(self.draw(record), path.with_suffix(".png"))
        print(f"{self.words(record)}\n\nwrote {settings.out}/")

    def run(self) -> None:
        """Measure as the command line asks for."""
        configure()
        execute(self.main, from_command_line(self.Settings, description=self.Settings.__doc__))


def row_by_row(found: Generator[Record, None, Record | None], path: Path) -> Record:
    """All rows and what is returned beside them; each row is in the file as soon as it is there."""
    rows: list[Record] = []
    more: Record = {}

    def rest() -> Iterator[Record]:
        more.update((yield from found) or {})

    for row in tqdm(rest(), unit="row"):
        rows.append(row)
        save_json(path, measured() | {"rows": rows})
    return more | {"rows": rows}


def measurement(
    page: str, quick: Record, raw: tuple[str, ...] = (), listed: bool = True
) -> Callable[[Callable[..., Any]], Measurement]:
    """Make a measurement of a function that returns its record, or that yields rows and returns the rest of it.

    Args:
        page: the page that quotes it, in docs/
        quick: settings with which it takes at most a minute
        raw: names of what the page does not quote, in the record and in its rows
        listed: whether `make measure` runs it as it is; one that needs options has a line in the Makefile, if any
    """
    return lambda function: Measurement(function, page, quick, raw, listed)


def settings_of(function: Callable[..., Any], quick: Record) -> type:
    """A dataclass with the parameters of a function, described by its docstring; `out` and `quick` beside them.

    A function that leaves more than a record has a parameter `out`, the folder, without a default.
    """
    text = inspect.getdoc(sys.modules[function.__module__]) or ""
    told = dict(re.findall(r"^ *(\w+): (.+)$", inspect.getdoc(function) or "", re.MULTILINE))
    unknown = set(quick) - set(inspect.signature(function).parameters)
    assert not unknown, f"quick = {unknown}: no parameters of {function.__name__}"
    fields = [
        (name, _described(each.annotation, told.get(name, "")), field(default=each.default))
        for name, each in inspect.signature(function).parameters.items()
        if name != "out"
    ]
    out = _described(Path, f"folder for {function.__name__}.json and its figure")
    small = _described(bool, ", ".join(f"{name} = {value}" for name, value in quick.items()))
    fields += [
        ("out", out, field(default=Path("results") / function.__name__)),
        ("quick", small, field(default=False)),
    ]
    return make_dataclass("Settings", fields, namespace={"__doc__": text})


def _described(kind: Any, words: str) -> Any:
    return Annotated[kind, tyro.conf.arg(help=words)]

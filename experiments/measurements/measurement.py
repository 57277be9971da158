"""A measurement: a function whose parameters are its settings, the page that quotes it, its table and its figure."""

import inspect
import re
import sys
from collections.abc import Callable, Collection, Generator, Iterable, Iterator
from dataclasses import field, make_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

from jaxgrity.cli.script import command_header

import tyro
from matplotlib.figure import Figure
from measurements.pages import made_by, rounded
from tqdm import tqdm

from jaxgrity import InputError
from jaxgrity.io.files import save_json
from jaxgrity.report import plot

Record = dict[str, Any]
"""what a measurement leaves, by name; `rows` are those that it yielded, of what it returned the rest"""

Words = Callable[[Record], str]
"""Function that says in Markdown what a page quotes of a record."""

Draw = Callable[[Record, Figure], None]
"""Function that draws a record on an empty figure."""


DIGITS = 4
"""Significant digits of numbers that only a figure shows: it has about a thousand pixels."""


class Kept(NamedTuple):
    """What docs/measured keeps of a record and of its rows."""

    raw: tuple[str, ...]
    """names of what is left out"""
    drawn: tuple[str, ...]
    """names of what the figure alone shows"""

    def of(self, part: Record) -> Record:
        """A record, or a row."""
        kept = {key: value for key, value in part.items() if key not in self.raw}
        return {key: rounded(value, DIGITS) if key in self.drawn else value for key, value in kept.items()}


class Table(NamedTuple):
    """One generated table."""

    page: str
    words: Words


class Measurement:
    """What `measurement` makes of a function."""

    def __init__(self, function: Callable[..., Any], page: str, quick: Record, kept: Kept, options: str):
        self.name, self.page, self.kept, self.options = function.__name__, page, kept, options
        self.draw: Callable[[Record], Figure] | None = None
        self.tables: dict[str, Table] = {}
        self._function, self._quick = function, quick
        self._values = values_of(function)
        self.Settings = settings_of(function, quick)

    @property
    def names(self) -> dict[str, Record]:
        """The names of its records, and with which arguments each is made: one a value of a `Literal` parameter."""
        return {
            "_".join([self.name, value.replace(" ", "_")]): {parameter: value}
            for parameter, values in self._values.items()
            for value in values
        } or {self.name: {}}

    def table(self, words: Words | None = None, part: str = "", page: str = "") -> Any:
        """Decorate the function that says in Markdown what a page quotes of a record.

        Args:
            words: the function
            part: of a table beside the first: its mark is the record's name, "/" and this
            page: where such a table stands, if not on the measurement's page
        """

        def kept(words: Words) -> Words:
            self.tables[part] = Table(page or self.page, words)
            return words

        return kept if words is None else kept(words)

    def figure(self, height: float = 4.5) -> Callable[[Draw], Draw]:
        """Decorate the function that draws a record on an empty figure of this height, inches, as wide as a page."""

        def kept(draw: Draw) -> Draw:
            @plot.styled
            def drawn(record: Record) -> Figure:
                chart = Figure(figsize=(plot.WIDTH, height), layout="constrained")
                draw(record, chart)
                return chart

            self.draw = drawn
            return draw

        return kept

    def words(self, record: Record, name: str | None = None, part: str = "") -> str:
        """A table of a record, the command that made it, and where its file is."""
        return self.tables[part].words(record) + made_by(record, name or self.name, self.tables[part].page)

    def all_words(self, record: Record, name: str | None = None) -> str:
        """All tables of a record."""
        return "\n\n".join(self.words(record, name, part) for part in self.tables)

    def quoted(self, record: Record) -> Record:
        """What pages quote of the record, and its figure shows."""
        kept = self.kept.of(record)
        if "rows" in kept:
            both = [key for key in self.kept.raw if key in record and any(key in row for row in kept["rows"])]
            assert not both, f"{both}: left out of the record, and so of its rows"
            kept["rows"] = [self.kept.of(row) for row in kept["rows"]]
        self.all_words(kept)  # a record that lacks something is refused before it is kept
        return kept

    def main(self, settings: Any) -> None:
        """Measure: keep every row as it comes, then the figure, and say the tables; one record after the other."""
        chosen = {name: getattr(settings, name) for name in inspect.signature(self._function).parameters}
        if settings.quick:  # options with another value than their default win
            usual = self.Settings()
            chosen |= {name: value for name, value in self._quick.items() if chosen[name] == getattr(usual, name)}
        if chosen.get("seed", 0) < 0:
            raise InputError(f"seed = {chosen['seed']}: expected 0 or more")
        for name, arguments in self.names.items():
            if all(value in chosen[parameter] for parameter, value in arguments.items()):
                self._measure(settings.out / f"{name}.json", chosen | arguments)
        print(f"wrote {settings.out}/")

    def _measure(self, path: Path, chosen: Record) -> None:
        found = self._function(**chosen)
        record = command_header() | (found if isinstance(found, dict) else row_by_row(found, path))
        save_json(path, record)
        if self.draw is not None:
            plot.save(self.draw(record), path.with_suffix(".png"))
        print(self.all_words(record, path.stem), end="\n\n")


def check_names(option: str, asked: Iterable[str], names: Collection[str]) -> None:
    """Raises `InputError` where one of the names that an option asks for is not among these."""
    for name in asked:
        if name not in names:
            raise InputError(f"{option} = {name!r}: unknown here; expected {', '.join(names)}")


def row_by_row(found: Generator[Record, None, Record | None], path: Path) -> Record:
    """What is returned, and beside it all rows unless it has some; each row is in the file as soon as it is there."""
    rows: list[Record] = []
    more: Record = {}

    def rest() -> Iterator[Record]:
        more.update((yield from found) or {})

    for row in tqdm(rest(), unit="row"):
        rows.append(row)
        save_json(path, command_header() | {"rows": rows})
    return {"rows": rows} | more


def measurement(
    page: str, quick: Record, raw: tuple[str, ...] = (), drawn: tuple[str, ...] = (), options: str = ""
) -> Callable[[Callable[..., Any]], Measurement]:
    """Make a measurement of a function that returns its record, or that yields rows and returns the rest of it.

    A parameter without a default, whose kind is a `Literal`, makes a record for each of its values.

    Args:
        page: the page that quotes it, in docs/, or README.md
        quick: settings with which it takes at most a minute; those that the user gives win
        raw: names of what the page does not quote, in the record and in its rows
        drawn: names of what the figure alone shows, likewise: kept with few digits
        options: with which `make measure` runs it
    """
    return lambda function: Measurement(function, page, quick, Kept(raw, drawn), options)


def values_of(function: Callable[..., Any]) -> dict[str, tuple[str, ...]]:
    """The values of the parameter for which there is a record each, by its name; nothing where there is none."""
    parameters = inspect.signature(function).parameters.values()
    return {each.name: get_args(each.annotation) for each in parameters if get_origin(each.annotation) is Literal}


def settings_of(function: Callable[..., Any], quick: Record) -> type:
    """A dataclass with the parameters of a function, described by its docstring; `out` and `quick` beside them.

    A function that leaves more than a record has a parameter `out`, the folder, without a default. Of a parameter for
    which there is a record each, a tuple is asked for.
    """
    text = inspect.getdoc(sys.modules[function.__module__]) or ""
    told = dict(re.findall(r"^ *(\w+): (.+)$", inspect.getdoc(function) or "", re.MULTILINE))
    parameters, several = inspect.signature(function).parameters, values_of(function)
    unknown = set(quick) - set(parameters)
    assert not unknown, f"quick = {unknown}: no parameters of {function.__name__}"
    asked = {name: (each.annotation, each.default) for name, each in parameters.items() if name != "out"}
    asked |= {name: (tuple[asked[name][0], ...], values) for name, values in several.items()}
    fields = [
        (name, _described(kind, told.get(name, "")), field(default=default)) for name, (kind, default) in asked.items()
    ]
    out = _described(Path, f"folder for {function.__name__}.json and its figure")
    sizes = ", ".join(f"{name} = {value}" for name, value in quick.items())
    small = _described(bool, f"unless you give others: {sizes}")
    fields += [
        ("out", out, field(default=Path("results") / function.__name__)),
        ("quick", small, field(default=False)),
    ]
    return make_dataclass("Settings", fields, namespace={"__doc__": text})


def _described(kind: Any, words: str) -> Any:
    return Annotated[kind, tyro.conf.arg(help=words)]

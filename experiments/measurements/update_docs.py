"""Write the tables of README and docs anew, from docs/measured.

Where measurements left results, what the pages quote of them goes to docs/measured first, and their pictures to
docs/images. --redraw draws figures anew whose measurement need not run again.
"""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

from measurements import library_tables as library
from measurements.measurement import Measurement
from measurements.pages import fill_page, save_compact
from measurements.registry import measurements

from jaxgrity import InputError, gait_names
from jaxgrity.io.files import read_text
from jaxgrity.report import plot

ROOT = Path(__file__).parents[2]
README, GAITS = "README.md", "docs/gaits.md"
GAIT_RECORDS, SEARCH_RECORDS = "docs/gait_records.md", "docs/search_records.md"


class Block(NamedTuple):
    """One generated part of a page."""

    page: str
    words: Callable[[dict], str]
    """made of the facts"""


class Source(NamedTuple):
    """One result: what pages quote of it, and where."""

    raw: str
    """file in the results folder"""
    facts: Callable[[dict], dict]
    """what is quoted of that file"""
    blocks: dict[str, Block]
    """by the names of their marks"""
    pictures: dict[str, str] = {}
    """file in the result's folder: name in docs/images"""


def sources_of(found: Measurement) -> dict[str, Source]:
    """What pages quote of a measurement, by the names of its records."""
    return {
        name: Source(
            f"{found.name}/{name}.json",
            found.quoted,
            {
                f"{name}/{part}".rstrip("/"): Block(place(table.page), partial(found.words, name=name, part=part))
                for part, table in found.tables.items()
            },
            {} if found.draw is None else {f"{name}.png": f"{name}.png"},
        )
        for name in found.names
    }


def place(page: str) -> str:
    """Where a page is."""
    return page if page == README else f"docs/{page}"


SOURCES: dict[str, Source] = {
    **{name: source for found in measurements().values() for name, source in sources_of(found).items()},
    "gait_search": Source(
        "gait_search/summary.json",
        library.gait_search_facts,
        {
            "gait_search": Block(README, library.gait_search_table),
            "gait_search/all": Block(SEARCH_RECORDS, library.full_gait_search_table),
        },
        {"polish.png": "polish.png"},
    ),
}
"""by their names in docs/measured"""


@dataclass
class Settings:
    results: Path = Path("results")
    """folder in which the scripts left their results, each in a folder of its own name"""
    docs: Path = ROOT
    """folder with README.md and docs/"""
    redraw: tuple[str, ...] = ()
    """names of records in docs/measured that hold all that their figures show: their figures are drawn anew"""


def main(settings: Settings) -> None:
    for name, source in SOURCES.items():
        if (settings.results / source.raw).exists():
            condense(name, source, settings)
            print(f"docs/measured/{name}.json: from {settings.results / source.raw}")
    for name in settings.redraw:
        redraw(name, settings.docs / "docs")
    for page, blocks in pages(settings.docs).items():
        fill_page(settings.docs / page, blocks)
        print(f"{page}: {', '.join(blocks)}")


def condense(name: str, source: Source, settings: Settings) -> None:
    """Keep what pages quote of a result, and its pictures. Raises `InputError` where the result lacks something."""
    path, docs = settings.results / source.raw, settings.docs / "docs"
    try:
        facts = source.facts(json.loads(read_text(path)))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: not what the script leaves: {error!r}") from error
    save_compact(docs / "measured" / f"{name}.json", facts)
    for picture, target in source.pictures.items():
        shutil.copyfile(path.parent / picture, docs / "images" / target)


def redraw(name: str, docs: Path) -> None:
    """Draw the figure of a kept record anew. Raises `InputError` where there is no figure, or the record lacks data."""
    drawing = {each: found.draw for found in measurements().values() for each in found.names}
    if (draw := drawing.get(name)) is None:
        raise InputError(f"redraw = {name!r}: no measurement with a figure; expected a name such as 'climbing'")
    path = docs / "measured" / f"{name}.json"
    try:
        figure = draw(json.loads(read_text(path)))
    except (KeyError, TypeError) as error:
        raise InputError(f"{path}: holds less than its figure shows ({error!r}); measure again") from error
    plot.save(figure, docs / "images" / f"{name}.png")


def pages(root: Path) -> dict[str, dict[str, str]]:
    """The generated parts of every page by the names of their marks, from docs/measured and the library's gaits."""
    found: dict[str, dict[str, str]] = {}
    for name, source in SOURCES.items():
        facts = json.loads(read_text(root / "docs" / "measured" / f"{name}.json"))
        for mark, block in source.blocks.items():
            found.setdefault(block.page, {})[mark] = block.words(facts)
    found[README]["library"] = library.gaits_table(tuple(n for n in gait_names() if n not in library.NOT_FIRST))
    found[GAITS] = {"library": library.gaits_table()}
    found[GAIT_RECORDS] |= library.full_gaits_tables() | {"library/commands": library.gait_commands()}
    return found

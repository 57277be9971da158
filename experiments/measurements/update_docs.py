"""Write the tables of README and docs anew, from docs/measured.

Where measurements left results, what the pages quote of them goes to docs/measured first, and their pictures to
docs/images.
"""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

from jaxgrity.cli.script import run
from measurement import Measurement

import control_tables as control
import identification_tables as identification
import identify_spine as validation
import library_tables as library
import numerics_tables as numerics
import orbit_tables
import search_tables as search
import speed_tables as speed
from compact_json import save_compact
from pages import fill_page
from registry import measurements

from jaxgrity import InputError
from jaxgrity.io.files import read_text

ROOT = Path(__file__).parents[2]
README, NUMERICS, SEARCH = "README.md", "docs/numerics.md", "docs/search.md"
GAITS, CONTROL = "docs/gaits.md", "docs/control.md"
TERRAIN = "docs/terrain.md"
VALIDATION, IDENTIFICATION = "docs/validation.md", "docs/identification.md"
PERFORMANCE, SCALING = "docs/performance.md", "docs/scaling.md"


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


def one_block(name: str, page: str, facts: Callable, words: Callable) -> Source:
    """A result with one block and one picture, all of the same name."""
    return Source(f"{name}/{name}.json", facts, {name: Block(page, words)}, {f"{name}.png": f"{name}.png"})


def source_of(found: Measurement) -> Source:
    """What a page quotes of a measurement."""
    page, picture = f"docs/{found.page}", f"{found.name}.png"
    pictures = {} if found.draw is None else {picture: picture}
    return Source(f"{found.name}/{found.name}.json", found.quoted, {found.name: Block(page, found.words)}, pictures)


SOURCES: dict[str, Source] = {
    **{found.name: source_of(found) for found in measurements().values()},
    "gait_search": Source(
        "gait_search/summary.json",
        library.gait_search_facts,
        {"gait_search": Block(README, library.gait_search_table)},
    ),
    "benchmark": one_block("benchmark", README, speed.benchmark_facts, speed.benchmark_table),
    "gradients": one_block("gradients", PERFORMANCE, speed.gradients_facts, speed.gradients_table),
    "scaling": Source(
        "scaling/scaling.json",
        speed.scaling_facts,
        {
            "scaling/cost": Block(SCALING, speed.scaling_table),
            "scaling/million": Block(SCALING, speed.million_table),
            "scaling/compiled": Block(PERFORMANCE, speed.compiled_table),
            "scaling/start": Block(PERFORMANCE, speed.start_table),
        },
        {"scaling.png": "scaling.png"},
    ),
    "first_commands": Source(
        "first_commands/first_commands.json",
        speed.first_commands_facts,
        {"first_commands": Block(PERFORMANCE, speed.first_commands_table)},
    ),
    "hard_cases": one_block("hard_cases", NUMERICS, numerics.hard_cases_facts, numerics.hard_cases_table),
    **{
        f"{folder}_{name}": Source(
            f"{folder}/{name}.json",
            facts,
            {f"{folder}/{name}": Block(page, words)},
            {f"{name}.png": f"{folder}_{name}.png"},
        )
        for folder, page, facts, words, names in (
            (
                "work_precision",
                NUMERICS,
                numerics.work_precision_facts,
                numerics.work_precision_table,
                ("free_flight", "drop_and_settle", "0.5_Hz_roll", "1_Hz_roll"),
            ),
            (
                "equivalence",
                NUMERICS,
                numerics.equivalence_facts,
                numerics.equivalence_table,
                ("drop", "settle", "roll"),
            ),
            (
                "search_baselines",
                SEARCH,
                search.search_baselines_facts,
                search.search_baselines_table,
                ("exact", "reference"),
            ),
        )
        for name in names
    },
    "damage": one_block("damage", SEARCH, search.damage_facts, search.damage_table),
    "lasting_baselines": one_block(
        "lasting_baselines", SEARCH, search.lasting_baselines_facts, search.lasting_baselines_table
    ),
    "library_gaits": one_block("library_gaits", SEARCH, library.library_gaits_facts, library.library_gaits_table),
    "repertoire": one_block("repertoire", GAITS, orbit_tables.repertoire_facts, orbit_tables.repertoire_table),
    "polish_comparison": one_block(
        "polish_comparison", GAITS, orbit_tables.polish_comparison_facts, orbit_tables.polish_comparison_table
    ),
    **{
        name: Source(
            f"feedback/{name}.json",
            control.feedback_facts,
            {name: Block(CONTROL, partial(control.feedback_table, name))},
            {f"{name}.png": f"{name}.png"},
        )
        for name in ("feedback_exact", "feedback_penalty")
    },
    **{
        name: Source(
            f"goals/{name}.json",
            control.goals_facts,
            {name: Block(CONTROL, partial(control.goals_table, name))},
            {f"{name}.png": f"{name}.png"},
        )
        for name in ("goals_slope", "goals_bumps")
    },
    "obstacles": one_block("obstacles", CONTROL, control.obstacles_facts, control.obstacles_table),
    "task_baselines": one_block("task_baselines", CONTROL, control.task_baselines_facts, control.task_baselines_table),
    "spine": Source(
        "spine/spine.json",
        validation.spine_facts,
        {
            "spine": Block(VALIDATION, validation.spine_table),
            "spine/parameters": Block(VALIDATION, validation.spine_parameters_table),
        },
        {"spine.png": "spine.png"},
    ),
    "identification": one_block(
        "identification", IDENTIFICATION, identification.identification_facts, identification.identification_table
    ),
    "sim_to_real": Source(
        "sim_to_real/sim_to_real.json",
        identification.sim_to_real_facts,
        {
            "sim_to_real": Block(IDENTIFICATION, identification.sim_to_real_table),
            "sim_to_real/shares": Block(IDENTIFICATION, identification.sim_to_real_shares),
        },
        {"sim_to_real.png": "sim_to_real.png"},
    ),
}
"""by their names in docs/measured"""


@dataclass
class Settings:
    results: Path = Path("results")
    """folder in which the scripts left their results, each in a folder of its own name"""
    docs: Path = ROOT
    """folder with README.md and docs/"""
    quick: bool = False
    """it is quick already"""


def main(settings: Settings) -> None:
    for name, source in SOURCES.items():
        if (settings.results / source.raw).exists():
            condense(name, source, settings)
            print(f"docs/measured/{name}.json: from {settings.results / source.raw}")
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


def pages(root: Path) -> dict[str, dict[str, str]]:
    """The generated parts of every page by the names of their marks, from docs/measured and the library's gaits."""
    found: dict[str, dict[str, str]] = {}
    for name, source in SOURCES.items():
        facts = json.loads(read_text(root / "docs" / "measured" / f"{name}.json"))
        for mark, block in source.blocks.items():
            found.setdefault(block.page, {})[mark] = block.words(facts)
    found[README]["library"] = found[SEARCH]["library"] = library.gaits_table()
    found[SEARCH]["library/commands"] = library.gait_commands()
    return found


if __name__ == "__main__":
    run(main, Settings)

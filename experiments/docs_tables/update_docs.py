"""Write the measured numbers of README and docs, and their pictures, from the results that the scripts left."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from jaxgrity.cli.script import run

from hard_cases import Cell, markdown
from search_words import damage, gait_search, gaits_table, kills, library, rivals
from speed_words import benchmark, compiled, gradients, made_by, million, scaling, start_up, table

from jaxgrity.io.files import save_json, write_whole
from jaxgrity.stepping.methods import METHODS
from jaxgrity.core.errors import InputError

ROOT = Path(__file__).parents[1]


class Source(NamedTuple):
    """One result: the page that quotes it, the words, and the files in its folder."""

    page: str
    words: Callable[[dict], str]
    facts: str
    pictures: dict[str, str]
    """file in the results folder: name in docs/images"""


@dataclass
class Settings:
    results: Path = Path("results")
    """folder in which the scripts left their results, each in a folder of its own name"""
    quick: bool = False
    """it is quick already"""


def main(settings: Settings) -> None:
    sources = found(settings.results)
    if not sources:
        raise InputError(f"{settings.results}: holds no results; expected those of {', '.join(SOURCES)}")
    for name, (source, facts) in sources.items():
        save_json(ROOT / "docs" / "measured" / measured_name(name, source), facts)
        for picture, target in source.pictures.items():
            shutil.copyfile(settings.results / Path(name).parts[0] / picture, ROOT / "docs" / "images" / target)
        page = ROOT / source.page
        text = fill(page.read_text(encoding="utf-8"), name, source.words(facts))
        write_whole(page, lambda file, text=text: file.write(text.encode()))
        print(f"{source.page}: {name}")
    fast = settings.results / "fast" / "animation.gif"
    if fast.exists():
        shutil.copyfile(fast, ROOT / "docs" / "images" / "fast.gif")
    for name, words in (("README.md", gaits_table()), (SEARCH, library())):
        text = fill((ROOT / name).read_text(encoding="utf-8"), "library", words)
        write_whole(ROOT / name, lambda file, text=text: file.write(text.encode()))
    for name in SOURCES.keys() - sources.keys():
        print(f"left as it was, no results: {name}")


def found(results: Path) -> dict[str, tuple[Source, dict]]:
    """The sources whose results are there, with what they say."""
    paths = {name: results / Path(name).parts[0] / source.facts for name, source in SOURCES.items()}
    return {name: (SOURCES[name], json.loads(path.read_text())) for name, path in paths.items() if path.exists()}


def measured_name(name: str, source: Source) -> str:
    """The file in docs/measured: parts of a page that come from one file share it."""
    folder, stem = Path(name).parts[0], Path(source.facts).stem
    return f"{folder if stem == folder or '/' not in name else f'{folder}_{stem}'}.json"


def fill(text: str, name: str, words: str) -> str:
    """`text` with what stands between the marks of `name` replaced. Raises `InputError` where there are none."""
    marks = re.compile(rf"(<!-- measured: {name} -->\n).*?(<!-- end -->)", re.DOTALL)
    if not marks.search(text):
        raise InputError(f"no marks '<!-- measured: {name} -->' in the page; expected one pair")
    return marks.sub(lambda match: f"{match[1]}{words}\n{match[2]}", text)


def error_bars(facts: dict) -> str:
    rows = [
        [
            row["scene"],
            f"{row['duration']:g} s",
            f"{row['dt']:g} s",
            f"{row['covered']:.0%}",
            f"{row['median_error']:.1e} m",
            f"{row['median_bar']:.1e} m",
            f"{row['median_ratio']:.1f}",
        ]
        for row in facts["rows"]
    ]
    head = ["scene", "horizon", "step", "covered", "median error", "median bar", "median of bar / error"]
    return table(head, rows) + made_by(facts, "error_bars")


def stability(facts: dict) -> str:
    rows = [[name, f"{off:.0%}"] for name, off in facts["worst"].items()]
    head = ["method", f"largest deviation, {facts['scenes']} scenes"]
    limits = [[row["scene"], row["method"], f"{1e3 * row['step']:.3g} ms", row["set_by"]] for row in facts["limits"]]
    known = table(["scene", "method", "largest stable step", "set by"], limits)
    return f"{table(head, rows)}\n\n{known}" + made_by(facts, "stability")


def equivalence(name: str) -> Callable[[dict], str]:
    def words(facts: dict) -> str:
        rows = []
        for symbol in ("K", "K, no friction", "k_n"):
            row = facts[symbol]
            ends = f"{row['distance'][0]:.1e} to {row['distance'][-1]:.1e} m"
            rows.append([symbol, f"{row['values'][0]:g} to {row['values'][-1]:g} N/m", ends, f"{row['slope']:.2f}"])
        contact = facts["k_n"]
        said = table(["grows", "from, to", "distance between the models, rms", "slope"], rows)
        if name == "settle":
            share = contact["penetration_at_end"][-1] / contact["weight_over_n_k"][-1]
            said += f"\n\nAt the highest k_n the robot stands {share:.3f} m g / (n k_n) deep in the ground."
        return said + made_by(facts, f"equivalence_{name}")

    return words


def stiff(facts: dict) -> str:
    rows = [
        [
            row["scene"],
            f"{row['tolerance']:g}",
            row["method"],
            str(row["steps"]),
            str(row["rejected"]),
            f"{row['seconds']:.2f} s",
            f"{row['error']:.0e} m",
        ]
        for row in facts["rows"]
    ]
    head = ["scene", "tolerance", "method", "steps", "rejected", "wall time", "error"]
    return table(head, rows) + made_by(facts, "stiff")


def hard_cases(facts: dict) -> str:
    counts = ", ".join(f"{count} {verdict}" for verdict, count in facts["counts"].items())
    rows = {
        name: {dtype: {m: Cell(**cell) for m, cell in kind.items()} for dtype, kind in row.items()}
        for name, row in facts["table"].items()
    }
    cells = [(m, cell) for row in rows.values() for kind in row.values() for m, cell in kind.items()]
    reasons = sorted({f"- {m}: {cell.reason}" for m, cell in cells if cell.verdict == "refused"})
    said = f"Of all cells {counts}; implicit methods were given {facts['most_implicit_steps']} steps."
    refused = "\n".join(["Refused, with the reason:", "", *reasons])
    return f"{said}\n\n{markdown(rows, tuple(METHODS))}\n{refused}" + made_by(facts, "hard_cases")


def work_precision(facts: dict) -> str:
    costs = facts["cost_at_target"]
    cheapest = min(costs.values())
    rows = [[name, f"{1e3 * cost:.3f}", f"{cost / cheapest:.1f}"] for name, cost in costs.items()]
    head = ["cheapest setting", "ms per gait and simulated second", "times the cheapest"]
    said = f"Cost of an error of at most {1e3 * facts['target']:g} mm (median) in {facts['error_of']}; the converged "
    said += f"answers of the two models are {facts['models_apart']:.1e} m apart.\n\n"
    return said + table(head, rows) + made_by(facts, f"work_precision_{facts['scene'].replace(' ', '_')}")


NUMERICS, SEARCH = "docs/numerics.md", "docs/search.md"
PERFORMANCE, SCALING = "docs/performance.md", "docs/scaling.md"
SOURCES = (
    {
        "gait_search": Source("README.md", gait_search, "summary.json", {"animation.gif": "rolling.gif"}),
        "benchmark": Source("README.md", benchmark, "benchmark.json", {"benchmark.png": "benchmark.png"}),
        "gradients": Source(PERFORMANCE, gradients, "gradients.json", {"gradients.png": "gradients.png"}),
        "error_bars": Source(NUMERICS, error_bars, "error_bars.json", {"error_bars.png": "error_bars.png"}),
        "stability": Source(NUMERICS, stability, "stability.json", {"stability.png": "stability.png"}),
        "stiff": Source(NUMERICS, stiff, "stiff.json", {"stiff.png": "stiff.png"}),
        "hard_cases": Source(NUMERICS, hard_cases, "hard_cases.json", {"hard_cases.png": "hard_cases.png"}),
    }
    | {
        f"work_precision/{name}": Source(
            NUMERICS, work_precision, f"{name}.json", {f"{name}.png": f"work_precision_{name}.png"}
        )
        for name in ("free_flight", "drop_and_settle", "0.5_Hz_roll", "1_Hz_roll")
    }
    | {
        f"scaling/{name}": Source(page, words, "scaling.json", {"scaling.png": "scaling.png"})
        for name, page, words in (
            ("cost", SCALING, scaling),
            ("million", SCALING, million),
            ("compiled", PERFORMANCE, compiled),
            ("start", PERFORMANCE, start_up),
        )
    }
    | {
        f"rivals/{name}": Source(SEARCH, rivals(name), f"{name}.json", {f"{name}.png": f"rivals_{name}.png"})
        for name in ("exact", "reference")
    }
    | {
        "damage": Source(SEARCH, damage, "damage.json", {"damage.png": "damage.png"}),
        "kills": Source(SEARCH, kills, "kills.json", {}),
    }
    | {
        f"equivalence/{name}": Source(
            NUMERICS, equivalence(name), f"{name}.json", {f"{name}.png": f"equivalence_{name}.png"}
        )
        for name in ("drop", "settle", "roll")
    }
)


if __name__ == "__main__":
    run(main, Settings)

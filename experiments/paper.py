"""The paper that the project began from, claim by claim: what was measured, and whether it holds.

Writes docs/paper.md with its figures and docs/measured/paper.json. With --claims some of them are checked alone, and
the page stays as it is.
"""

import importlib
import json
import multiprocessing
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common import configure, run

from tqdm import tqdm

from jaxgrity import InputError, plot
from jaxgrity.io.files import save_json, write_whole

CLAIMS = (
    "structure_drawn",
    "refinement",
    "energy_drift",
    "block",
    "animation",
    "penalty",
    "step_limits",
    "actuation",
    "rigid_limit",
    "gradients",
    "runge_kutta",
    "search",
    "future",
)
"""modules of the folder claims/, in the order of the page, where they count from 1"""
LONGEST_FIRST = ("refinement", "search", "penalty", "energy_drift", "rigid_limit", "step_limits", "actuation")
DOCS = Path(__file__).parents[1] / "docs"
INTRODUCTION = """# The paper, claim by claim

*Least-Action-Based Modeling and Rolling Locomotion of a Six-Strut Tensegrity Robot* is where this project comes from.
This page says which of its claims hold when they are measured. `make paper` writes it: every number below comes out of
the command in its row ([measured/paper.json](measured/paper.json)), and each verdict is computed from the numbers
beside it.

Claims are checked on three robots where that makes sense: **paper_program**, the one of the program published with the
paper (opposite vertices joined by struts, 30 cables, no prestress, 0.19 m, 0.6 kg); **paper_text**, the paper's own
structure with the program's numbers (24 cables, level ground); and **reference**, the robot of this project (1 m, 6 kg,
prestressed, damped).
"""


@dataclass
class Settings:
    claims: tuple[int, ...] = ()
    """numbers of the claims to check (1 to 13); all, where none are given, and only then the page is written"""
    out: Path = Path("results/paper")
    """folder for the numbers and the figures"""
    docs: Path = DOCS
    """folder for paper.md, images/ and measured/paper.json"""
    quick: bool = False
    """everything small: shows that it runs, and measures nothing; the page goes into `out`"""


def main(settings: Settings) -> None:
    unknown = [k for k in settings.claims if not 1 <= k <= len(CLAIMS)]
    if unknown:
        raise InputError(f"claims = {unknown}: expected numbers from 1 to {len(CLAIMS)}")
    names = [CLAIMS[k - 1] for k in settings.claims] or list(CLAIMS)
    settings.out.mkdir(parents=True, exist_ok=True)
    tasks = [(name, settings.out, settings.quick) for name in sorted(names, key=cost)]
    # a process for each: compiled programs of all claims together would be too many for one
    context = multiprocessing.get_context("spawn")
    with context.Pool(len(os.sched_getaffinity(0)), configure, maxtasksperchild=1) as pool:
        found = dict(tqdm(pool.imap_unordered(check, tasks), total=len(tasks), desc="claims", unit="claim"))
    reports = [found[name] for name in CLAIMS if name in found]
    for report in reports:
        for row in report["rows"]:
            print(f"{report['number']:3d}  {row['verdict']:24s} {row['scene']:40s} {row['claim']}")
    if not settings.claims:
        write_page(reports, settings.out if settings.quick else settings.docs, settings.out)


def cost(name: str) -> int:
    """Place in the queue."""
    return LONGEST_FIRST.index(name) if name in LONGEST_FIRST else len(LONGEST_FIRST)


def check(task: tuple[str, Path, bool]) -> tuple[str, dict[str, Any]]:
    """Check one claim, and leave its numbers and figures in the folder."""
    name, out, quick = task
    report = importlib.import_module(f"claims.{name}").check(quick)
    figures = {}
    for label, (figure, caption) in report.figures.items():
        plot.save(figure, out / f"paper_{label}.png")
        figures[f"paper_{label}.png"] = caption
    number = CLAIMS.index(name) + 1
    rows = [row._asdict() for row in report.rows]
    facts = {"number": number, "title": report.title, "rows": rows, "figures": figures, "facts": report.facts}
    save_json(out / f"{name}.json", facts)
    return name, json.loads((out / f"{name}.json").read_text())


def write_page(reports: list[dict], docs: Path, pictures: Path) -> None:
    """docs/paper.md, its figures, and the numbers that it quotes."""
    quoted = [{key: value for key, value in report.items() if key != "facts"} for report in reports]
    save_json(docs / "measured" / "paper.json", quoted)
    for report in reports:
        for picture in report["figures"]:
            content = (pictures / picture).read_bytes()
            write_whole(docs / "images" / picture, lambda file, content=content: file.write(content))
    write_whole(docs / "paper.md", lambda file: file.write(page(quoted).encode()))
    print(f"wrote {docs}/paper.md")


def page(reports: list[dict]) -> str:
    """The page: a summary, then each claim with its table and figures."""
    counts: dict[str, int] = {}
    for row in (row for report in reports for row in report["rows"]):
        counts[row["verdict"]] = counts.get(row["verdict"], 0) + 1
    said = ", ".join(f"{count} {verdict}" for verdict, count in sorted(counts.items(), key=lambda item: -item[1]))
    parts = [INTRODUCTION, f"Verdicts: {said}.\n"]
    for report in reports:
        parts.append(f"## {report['number']}. {report['title']}\n")
        command = f"`paper.py --claims {report['number']}`"
        parts.append("| claim | section | robot or case | command | measured | verdict | why |\n" + "|---" * 7 + "|")
        for row in report["rows"]:
            case = (row["claim"], row["section"], row["scene"], command)
            cells = (*case, row["measured"], f"**{row['verdict']}**", row["why"])
            parts.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
        for picture, caption in report["figures"].items():
            parts.append(f"\n![{report['title']}](images/{picture})\n\n*{caption}*")
        parts.append("")
    return "\n".join(parts)


if __name__ == "__main__":
    run(main, Settings)

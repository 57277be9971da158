"""The paper that the project began from, claim by claim: what was measured, and whether it holds.

Writes the tables of docs/paper.md, its figures, and docs/measured/paper.json. With --claims some of them are checked
alone, and the page stays as it is.
"""

import importlib
import json
import multiprocessing
import os
from dataclasses import dataclass
from pathlib import Path
from string import ascii_lowercase
from typing import Any

from jaxgrity.cli.script import configure, run

from measurements.measurement import DIGITS, Figure
from measurements.pages import fill_page, rounded, save_compact, table
from paper_claims.report import VERDICTS
from tqdm import tqdm

from jaxgrity import InputError
from jaxgrity.io.files import read_text, save_json, write_whole
from jaxgrity.report import plot

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
"""modules of the folder paper_claims/, in the order of the page, where they count from 1"""
LONGEST_FIRST = ("refinement", "search", "penalty", "energy_drift", "rigid_limit", "step_limits", "actuation")
DOCS = Path(__file__).parents[1] / "docs"


@dataclass
class Settings:
    claims: tuple[int, ...] = ()
    """numbers of the claims to check (1 to 13); all, where none are given, and only then the page is written"""
    out: Path = Path("results/paper")
    """folder for the numbers and the figures"""
    docs: Path = DOCS
    """folder with paper.md, for its tables, images/ and measured/paper.json"""
    page_only: bool = False
    """fill the page's tables again from measured/paper.json, and check nothing"""
    redraw: tuple[int, ...] = ()
    """numbers of claims whose figures are drawn anew from measured/paper.json, and nothing checked"""
    quick: bool = False
    """everything small: shows that it runs, and measures nothing; the page goes into `out`"""


def main(settings: Settings) -> None:
    unknown = [k for k in (*settings.claims, *settings.redraw) if not 1 <= k <= len(CLAIMS)]
    if unknown:
        raise InputError(f"claims = {unknown}: expected numbers from 1 to {len(CLAIMS)}")
    if settings.redraw:
        for claim in load_facts(settings.docs)["claims"]:
            if claim["number"] in settings.redraw:
                plot.save(drawn(claim), settings.docs / "images" / claim["figures"][0])
        return
    if settings.page_only:
        fill_page(settings.docs / "paper.md", tables(load_facts(settings.docs)))
        return
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
        write_page(reports, settings, settings.out if settings.quick else settings.docs)


def cost(name: str) -> int:
    """Place in the queue."""
    return LONGEST_FIRST.index(name) if name in LONGEST_FIRST else len(LONGEST_FIRST)


def check(task: tuple[str, Path, bool]) -> tuple[str, dict[str, Any]]:
    """Check one claim, and leave its rows and its figure in the folder."""
    name, out, quick = task
    report = importlib.import_module(f"paper_claims.{name}").check(quick)
    picture = f"paper_{report.picture}.png"
    facts = {
        "number": CLAIMS.index(name) + 1,
        "title": report.title,
        "rows": [row._asdict() for row in report.rows],
        "figures": [picture],
        "drawn": [report.drawn],  # a row, and so a line of the record
    }
    save_json(out / f"{name}.json", facts)
    found = json.loads((out / f"{name}.json").read_text())
    plot.save(drawn(found), out / picture)
    return name, found


def drawn(claim: dict[str, Any]) -> Figure:
    """The figure of a claim. Raises `InputError` where it lacks what that shows."""
    if "drawn" not in claim:
        place = f"redraw = {claim['number']}: measured/paper.json"
        raise InputError(f"{place} holds less than the figure shows; measure again")
    return importlib.import_module(f"paper_claims.{CLAIMS[claim['number'] - 1]}").figure(**claim["drawn"][0])


def write_page(reports: list[dict], settings: Settings, docs: Path) -> None:
    """The tables of paper.md, its figures, and the numbers that it quotes, in the folder `docs`."""
    quoted = facts(reports)
    save_compact(docs / "measured" / "paper.json", quoted)
    for report in reports:
        for picture in report["figures"]:
            content = (settings.out / picture).read_bytes()
            write_whole(docs / "images" / picture, lambda file, content=content: file.write(content))
    fill_page(docs / "paper.md", tables(quoted), settings.docs / "paper.md")
    print(f"wrote {docs}/paper.md")


def facts(reports: list[dict]) -> dict[str, Any]:
    """What the page quotes of the reports."""
    kept = ("number", "title", "rows", "figures")
    shown = [rounded(report["drawn"], DIGITS) for report in reports]
    return {"claims": [{key: each[key] for key in kept} | {"drawn": drawn} for each, drawn in zip(reports, shown)]}


def load_facts(docs: Path) -> dict[str, Any]:
    """What the page quotes now."""
    return json.loads(read_text(docs / "measured" / "paper.json"))


def tables(facts: dict[str, Any]) -> dict[str, str]:
    """What the page quotes, by the names of its marks: all verdicts, and the cases of every claim by section."""
    rows = [row for section in facts["claims"] for row in section["rows"]]
    counts = {verdict: sum(row["verdict"] == verdict for row in rows) for verdict in VERDICTS}
    found = {"paper/verdicts": table(list(counts), [[str(count) for count in counts.values()]])}
    found["paper/claims"] = overview(facts["claims"])
    return found | {f"paper/{section['number']}": section_words(section) for section in facts["claims"]}


def overview(sections: list[dict[str, Any]]) -> str:
    """A row for each claim, with a link to its section."""
    rows = []
    for section in sections:
        slug = f"#{section['number']}-{section['title'].lower().replace(' ', '-')}"
        for label, (claim, cases) in claims_of(section).items():
            cell = claim.replace("|", "\\|")
            rows.append([f"[{label}]({slug})", cell, cases[0]["section"], short_verdict(cases)])
    return table(["", "claim", "in the paper", "verdict"], rows)


def claims_of(section: dict[str, Any]) -> dict[str, tuple[str, list[dict[str, str]]]]:
    """The claims of a section, each with its cases, by the number of the section and a letter."""
    claims = list(dict.fromkeys(row["claim"] for row in section["rows"]))
    cases = [[row for row in section["rows"] if row["claim"] == claim] for claim in claims]
    return {f"{section['number']}{letter}": found for letter, found in zip(ascii_lowercase, zip(claims, cases))}


def short_verdict(cases: list[dict[str, str]]) -> str:
    """One verdict for all cases, or in how many the claim holds."""
    holds, conditional, fails = (sum(case["verdict"] == each for case in cases) for each in VERDICTS)
    if len(cases) in (holds, conditional, fails):
        return cases[0]["verdict"]
    if not holds:
        return f"holds with a condition in {conditional} of {len(cases)}"
    return f"holds in {holds} of {len(cases)}" + (f", with a condition in {conditional}" if conditional else "")


def section_words(section: dict[str, Any]) -> str:
    """A heading for each claim, its cases with their verdicts, below them the reason, and the command that measures."""
    found = []
    for label, (claim, cases) in claims_of(section).items():
        found += [f"### {label}: {claim}"]
        for why in dict.fromkeys(case["why"] for case in cases):
            same = [case for case in cases if case["why"] == why]
            found += ["\n".join(f"- **{case['verdict']}** ({case['scene']}): {case['measured']}" for case in same)]
            found += [f"Why: {why}."]
    return "\n\n".join([*found, f"`python experiments/paper.py --claims {section['number']}`"])


if __name__ == "__main__":
    run(main, Settings)

"""The paper's claims at their quick size: each check runs; where size does not matter its verdict is the known one."""

import importlib
import json
import re
import shutil
from pathlib import Path

import paper
import pytest
from measurements.pages import filled, save_compact
from paper import CLAIMS, check
from paper_claims.penalty import half_millimetre_row
from paper_claims.report import CONDITIONAL, FAILS, HOLDS

from jaxgrity import InputError

DOCS = Path(__file__).parents[2] / "docs"
KNOWN = {
    "structure_drawn": [FAILS, HOLDS, HOLDS],
    "gradients": [FAILS, HOLDS, HOLDS, FAILS, CONDITIONAL],
    "runge_kutta": [HOLDS],
}
"""verdicts that hold at any size"""
CHEAP = ("structure_drawn", "runge_kutta")
"""claims that show how all are checked; the others are campaigns"""


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if name in CHEAP else pytest.mark.campaign) for name in CLAIMS],
)
def test_every_claim_is_measured_and_judged(name, tmp_path):
    """Rows with numbers in them and a verdict, figures that are there, all in a JSON file."""
    found, report = check((name, tmp_path, True))
    assert found == name
    assert report == json.loads((tmp_path / f"{name}.json").read_text())
    for row in report["rows"]:
        assert row["verdict"] in (HOLDS, CONDITIONAL, FAILS)
        assert any(letter.isdigit() for letter in row["measured"]), row
        assert "nan" not in row["measured"], row
        assert all(row.values())
    if name in KNOWN:
        assert [row["verdict"] for row in report["rows"]] == KNOWN[name]
    assert report["figures"]
    for picture in report["figures"]:
        assert (tmp_path / picture).stat().st_size > 10_000


def test_every_claim_finds_what_it_imports():
    for name in CLAIMS:
        assert callable(importlib.import_module(f"paper_claims.{name}").check)


def test_the_page_says_what_was_measured():
    """docs/paper.md has the tables that its JSON makes, about all claims, and its figures, each with a caption."""
    facts = paper.load_facts(DOCS)
    assert [claim["number"] for claim in facts["claims"]] == list(range(1, len(CLAIMS) + 1))
    page = (DOCS / "paper.md").read_text(encoding="utf-8")
    assert page == filled(page, paper.tables(facts))
    for claim in facts["claims"]:
        assert f"\n## {claim['number']}. {claim['title']}\n" in page
        assert claim["figures"]
        for picture in claim["figures"]:
            assert (DOCS / "images" / picture).exists(), picture
            assert re.search(rf"!\[.+\]\(images/{picture}\)\n\n\*[^*]+\*\n", page), picture


def test_the_page_is_written_anew_from_its_file(tmp_path):
    """Where tables were lost, with nothing measured; and nothing changes where nothing was."""
    page = (DOCS / "paper.md").read_text(encoding="utf-8")
    (tmp_path / "measured").mkdir()
    shutil.copyfile(DOCS / "measured" / "paper.json", tmp_path / "measured" / "paper.json")
    lost = re.sub(r"(<!-- measured: paper/3 -->\n).*?(<!-- end -->)", r"\1\2", page, flags=re.DOTALL)
    assert lost != page
    for before in (lost, page):
        (tmp_path / "paper.md").write_text(before, encoding="utf-8")
        paper.main(paper.Settings(docs=tmp_path, page_only=True))
        assert (tmp_path / "paper.md").read_text(encoding="utf-8") == page


def test_a_figure_is_drawn_anew_from_its_record(tmp_path):
    """One that keeps less is refused, with what to do."""
    claim = {"number": CLAIMS.index("future") + 1, "figures": ["paper_future.png"]}
    for folder in ("measured", "images"):
        (tmp_path / folder).mkdir()
    again = paper.Settings(docs=tmp_path, redraw=(claim["number"],))
    save_compact(tmp_path / "measured" / "paper.json", {"claims": [claim]})
    with pytest.raises(InputError, match=r"redraw = 13: .*holds less than the figure shows; measure again"):
        paper.main(again)
    save_compact(
        tmp_path / "measured" / "paper.json", {"claims": [claim | {"drawn": [{"moved": [[1.0, 0.5], [0.2, 0]]}]}]}
    )
    paper.main(again)
    assert (tmp_path / "images" / "paper_future.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("deepest", "verdict"),
    [
        ({"0.001": 1.2e-3, "0.0005": 1.2e-3, "0.0001": 1.2e-3}, FAILS),
        ({"0.001": 1.2e-3, "0.0005": 6e-4, "0.0001": 4e-4}, CONDITIONAL),
        ({"0.001": 4e-4, "0.0005": 4e-4, "0.0001": 4e-4}, HOLDS),
        ({"0.001": float("nan"), "0.0005": 1.2e-3, "0.0001": 1.2e-3}, FAILS),
    ],
)
def test_a_penetration_that_every_landing_exceeds_is_not_bounded_by_it(deepest, verdict):
    """Section 6.1's 0.5 mm: a robot at rest is less deep, which makes the claim about landings no truer."""
    row = half_millimetre_row("reference", deepest, weight=58.86)
    assert "at rest on three nodes m g/(3 k_n) = 0.000196 m" in row.measured
    assert row.verdict == verdict


def test_the_measured_landings_all_exceed_the_papers_bound():
    """So the page says that the claim does not hold, for all three robots."""
    (claim,) = (claim for claim in paper.load_facts(DOCS)["claims"] if claim["title"] == "Penalty against KKT")
    rows = [row for row in claim["rows"] if "stays below 0.5 mm" in row["claim"]]
    assert len(rows) == 3
    for row in rows:
        landings = re.findall(r"([\d.e-]+) m at", row["measured"])
        assert len(landings) == 2
        assert min(map(float, landings)) > 0.5e-3
        assert row["verdict"] == FAILS


def test_a_claim_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"claims = \[0, 14\]: expected numbers from 1 to 13"):
        paper.main(paper.Settings(claims=(0, 1, 14), out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()

"""The paper's claims at their quick size: each check runs; where size does not matter its verdict is the known one."""

import json
from pathlib import Path

import pytest
from claims.report import CONDITIONAL, FAILS, HOLDS
from paper import CLAIMS, check, page

DOCS = Path(__file__).parents[1] / "docs"
KNOWN = {
    "structure_drawn": [FAILS, HOLDS, HOLDS],
    "gradients": [FAILS, HOLDS, HOLDS, FAILS, CONDITIONAL],
    "runge_kutta": [HOLDS],
}
"""verdicts that hold at any size"""


@pytest.mark.parametrize("name", CLAIMS)
def test_every_claim_is_measured_and_judged(name, tmp_path):
    """Rows with numbers in them and a verdict, figures with captions that are there, all in a JSON file."""
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
    for picture, caption in report["figures"].items():
        assert (tmp_path / picture).stat().st_size > 10_000
        assert caption


def test_the_page_says_what_was_measured():
    """docs/paper.md is what its JSON makes of it, about all claims, and its figures are in the repository."""
    reports = json.loads((DOCS / "measured" / "paper.json").read_text())
    assert [report["number"] for report in reports] == list(range(1, len(CLAIMS) + 1))
    assert (DOCS / "paper.md").read_text(encoding="utf-8") == page(reports)
    for report in reports:
        for picture in report["figures"]:
            assert (DOCS / "images" / picture).exists(), picture

"""The tables of README and docs are those of docs/measured, which holds no more than they quote."""

import functools
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from measurements import keep_gait, update_docs
from measurements.pages import filled, laid_out, rounded, save_compact, table

from jaxgrity import InputError, gait_record, load_gait
from jaxgrity.cli.search_settings import UncertaintySettings
from jaxgrity.search import EvaluationConfig

ROOT = Path(__file__).parents[2]
MEASURED = ROOT / "docs" / "measured"
BLOCKS = {
    "README.md": 3,
    "docs/conformance.md": 5,
    "docs/control.md": 12,
    "docs/environments.md": 6,
    "docs/files.md": 2,
    "docs/gaits.md": 1,
    "docs/gait_records.md": 20,
    "docs/accuracy.md": 15,
    "docs/terrain.md": 2,
    "docs/performance.md": 6,
    "docs/scaling.md": 6,
    "docs/identification.md": 4,
    "docs/search_records.md": 7,
    "docs/validation.md": 4,
    "docs/matrix.md": 4,
}


@pytest.fixture(scope="module")
def generated():
    """The generated parts of every page."""
    return update_docs.pages(ROOT)


@pytest.fixture
def copied(tmp_path):
    """README and docs, to be written to."""
    shutil.copyfile(ROOT / "README.md", tmp_path / "README.md")
    shutil.copytree(ROOT / "docs", tmp_path / "docs")
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), BLOCKS.items())
def test_page_says_what_was_measured(name, count, generated):
    """Each table of a page holds what its file in docs/measured/ says; its pictures and links are there."""
    page = (ROOT / name).read_text(encoding="utf-8")
    marks = re.findall(r"<!-- measured: (\S+) -->", page)
    assert len(set(marks)) == len(marks) == count
    blocks = generated[name]
    assert set(marks) == set(blocks)
    assert filled(page, blocks) == page
    for target in re.findall(r"\]\(((?!http)[^)#]+)\)", page):
        assert ((ROOT / name).parent / target).exists(), target


def test_every_block_is_a_table_or_a_list_of_commands(generated):
    """Prose is written by hand: between marks there are tables, the command that measured them, and nothing else."""
    blocks = {mark: words for page in generated.values() for mark, words in page.items()}
    commands = blocks.pop("library/commands").splitlines()
    assert all(line.startswith("    ") for line in commands)
    known = r"\|.*\||`python .*|\*\*float(32|64), (fixed|adapted) step\*\*, error in m|"
    for mark, words in blocks.items():
        for line in words.splitlines():
            assert re.fullmatch(known, line), (mark, line)


def test_half_widths_of_the_page_are_the_defaults():
    """What "robust" means on docs/search.md is what a search and its command take."""
    page = (ROOT / "docs" / "search.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\|.*\| `--uncertainty\.(\S+)` \| ([\d.]+)", page, re.MULTILINE)
    written = {name.replace("-", "_"): float(value) for name, value in rows}
    assert written == vars(EvaluationConfig().uncertainty) == vars(UncertaintySettings())


def test_measured_files_hold_what_pages_quote():
    """One for each source and one for the paper, as `save_compact` writes it, of thirty lines on average."""
    files = sorted(MEASURED.iterdir())
    assert [file.stem for file in files] == sorted([*update_docs.SOURCES, "paper"])
    for file in files:
        text = file.read_text(encoding="utf-8")
        assert text == laid_out(rounded(json.loads(text))) + "\n", file
    assert sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files) < 30 * len(files)


def test_without_results_nothing_changes(copied, tmp_path):
    """Where nothing was measured anew, every page and every file comes out as it was; a lost table comes back."""
    before = {path: path.read_bytes() for path in copied.rglob("*") if path.is_file()}
    page = copied / "docs" / "scaling.md"
    page.write_text(page.read_text(encoding="utf-8").replace("| rk4 |", "| euler |"), encoding="utf-8")
    update_docs.main(update_docs.Settings(results=tmp_path / "none", docs=copied))
    assert {path: path.read_bytes() for path in copied.rglob("*") if path.is_file()} == before


def test_results_are_condensed_first(copied, tmp_path):
    """Of a new result the file keeps what the page quotes, and the page says it."""
    kept = {"command": "python x.py", "cores": 3, "killed": 3, "between_generations": 2, "same_population": 2}
    kept |= {"undisturbed_seconds": 12.3456789, "broken_files": 1}
    folder = tmp_path / "results" / "crash_recovery"
    save_compact(folder / "crash_recovery.json", kept | {"rows": [{"after_seconds": 1.0}]})
    update_docs.main(update_docs.Settings(results=tmp_path / "results", docs=copied))
    facts = json.loads((copied / "docs" / "measured" / "crash_recovery.json").read_text())
    assert facts == kept | {"undisturbed_seconds": 12.3457}
    assert "`python x.py`, [measured/crash_recovery.json]" in (copied / "docs" / "search_records.md").read_text()


def test_a_result_that_lacks_something_is_refused(copied, tmp_path):
    """With its path, before any page is touched."""
    save_compact(tmp_path / "results" / "stiff" / "stiff.json", {"command": "python x.py", "cores": 2})
    with pytest.raises(InputError, match=r"stiff.json: not what the script leaves: KeyError\('rows'\)"):
        update_docs.main(update_docs.Settings(results=tmp_path / "results", docs=copied))
    assert (copied / "docs" / "accuracy.md").read_bytes() == (ROOT / "docs" / "accuracy.md").read_bytes()


def test_a_figure_is_drawn_anew_from_a_whole_record(copied, tmp_path):
    """Without a measurement; a record that keeps less than its figure shows, and an unknown one, are refused."""
    again = functools.partial(update_docs.Settings, results=tmp_path / "none", docs=copied)
    picture = copied / "docs" / "images" / "climbing.png"
    picture.write_bytes(b"")
    update_docs.main(again(redraw=("climbing",)))
    assert picture.read_bytes().startswith(b"\x89PNG")
    record = copied / "docs" / "measured" / "climbing.json"
    whole = json.loads(record.read_text())
    save_compact(record, {name: whole[name] for name in whole if name != "friction"})
    with pytest.raises(InputError, match=r"climbing.json: holds less than its figure shows \(KeyError\('friction'\)\)"):
        update_docs.redraw("climbing", copied / "docs")
    with pytest.raises(InputError, match=r"redraw = 'conformance': no measurement with a figure"):
        update_docs.main(again(redraw=("conformance",)))


@pytest.mark.parametrize("page", ["no marks", 2 * "<!-- measured: a -->\nold\n<!-- end -->\n"])
def test_a_page_without_its_marks_is_refused(page):
    """Or with two pairs of them."""
    with pytest.raises(InputError, match=r"[02] pairs of marks '<!-- measured: a -->' in the page; expected one pair"):
        filled(page, {"a": "new"})


def test_marks_of_one_name_are_not_those_of_another():
    """A name is no pattern, and what stands outside of the marks stays."""
    page = "x\n<!-- measured: a.b -->\nold\n<!-- end -->\ny\n<!-- measured: aXb -->\nold\n<!-- end -->\n"
    expected = page.replace("a.b -->\nold", "a.b -->\nnew \\1")
    assert filled(page, {"a.b": "new \\1"}) == expected


def test_a_table_has_a_cell_for_each_head():
    assert table(["a", "b"], [["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |"
    with pytest.raises(AssertionError, match="a cell for each head"):
        table(["a", "b"], [["1"]])


def test_compact_json_is_short_and_exact_to_six_digits(tmp_path):
    """A row a line, lists of numbers on one line, no number that is not finite."""
    content = {
        "number": np.float32(1 / 3),
        "list": np.array([1e-12 / 3, 2e9, np.nan]),
        "rows": [{"name": "ä", "values": {"x": 123456789.0, "y": np.inf}}, {"name": "b", "values": None}],
        "count": np.int64(1234567890),
        "table": {"yes": True},
    }
    save_compact(tmp_path / "x.json", content)
    text = (tmp_path / "x.json").read_text(encoding="utf-8")
    assert text.splitlines() == [
        "{",
        '  "number": 0.333333,',
        '  "list": [3.33333e-13, 2000000000.0, null],',
        '  "rows": [',
        '    {"name": "ä", "values": {"x": 123457000.0, "y": null}},',
        '    {"name": "b", "values": null}',
        "  ],",
        '  "count": 1234567890,',
        '  "table": {"yes": true}',
        "}",
    ]
    assert json.loads(text) == rounded(content)


def test_a_gait_is_kept_in_the_library(tmp_path):
    """With what the library's records have, and no more; what is no run of a search is refused."""
    record = gait_record("straight") | {"diagnosis": {}, "wall_seconds": 1.0}
    save_compact(tmp_path / "run" / "gait.json", record)
    keep_gait.main(keep_gait.Settings(tmp_path / "run", "mine", tmp_path / "library"))
    kept = json.loads((tmp_path / "library" / "mine.json").read_text())
    assert set(kept) == set(gait_record("straight"))
    assert load_gait(tmp_path / "library" / "mine.json").members == load_gait("lasting").members
    del record["robust"]
    save_compact(tmp_path / "run" / "gait.json", record)
    with pytest.raises(InputError, match=r"gait.json: has no robust; expected what gait_search.py leaves"):
        keep_gait.main(keep_gait.Settings(tmp_path / "run", "mine", tmp_path / "library"))

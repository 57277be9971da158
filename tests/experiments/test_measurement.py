"""What the decorator makes of a function: settings, a record that is kept row by row, and what a page quotes of it."""

import json
import struct
from typing import Literal

import pytest
import tyro
from measurements import registry, update_docs
from measurements.measurement import measurement
from measurements.pages import columns

from jaxgrity import InputError
from jaxgrity.report import plot


def example():
    """Squares, with an array that no page quotes, and one that a figure shows."""

    @measurement(page="accuracy.md", quick={"count": 2}, raw=("all",), drawn=("roots",))
    def squares(count: int = 3, first: float = 1.0):
        """A row for each number.

        Args:
            count: numbers
            first: the least of them
        """
        for k in range(count):
            yield {"x": first + k, "square": (first + k) ** 2, "all": [0] * 9, "roots": [(first + k) ** 0.5]}
            if (first + k) == 13:
                raise RuntimeError
        return {"count": count}

    @squares.table
    def words(record):
        return columns(record["rows"], {"x": "{x:g}", "square": lambda row: f"{row['square']:g} m"})

    return squares


def test_parameters_are_options(capsys):
    """With what the docstring says of them, and with --out and --quick."""
    squares = example()
    chosen = tyro.cli(squares.Settings, args=["--first", "4"])
    assert (chosen.count, chosen.first, chosen.quick, str(chosen.out)) == (3, 4.0, False, "results/squares")
    with pytest.raises(SystemExit, match="0"):
        tyro.cli(squares.Settings, args=["--help"])
    said = capsys.readouterr().out
    assert "the least of them" in said
    assert "count = 2" in said


def test_a_record_has_all_rows_and_a_page_what_it_quotes(tmp_path, capsys):
    """The table is said, and stands with the command that made it."""
    squares = example()
    squares.main(squares.Settings(quick=True, out=tmp_path))
    record = json.loads((tmp_path / "squares.json").read_text())
    assert [row["square"] for row in record["rows"]] == [1.0, 4.0]
    assert record["count"] == 2
    assert len(record["rows"][0]["all"]) == 9
    kept = [{"x": 1.0, "square": 1.0, "roots": [1.0]}, {"x": 2.0, "square": 4.0, "roots": [1.414]}]
    assert squares.quoted(record)["rows"] == kept
    table = "| x | square |\n| --- | --- |\n| 1 | 1 m |\n| 2 | 4 m |"
    assert squares.words(record).startswith(f"{table}\n\n`{record['command']}`, [measured/squares.json]")
    assert table in capsys.readouterr().out


def test_an_option_wins_over_the_quick_size(tmp_path):
    """Larger ones too; other options have their quick size."""
    squares = example()
    chosen = tyro.cli(squares.Settings, args=["--quick", "--count", "4", "--out", str(tmp_path)])
    squares.main(chosen)
    assert len(json.loads((tmp_path / "squares.json").read_text())["rows"]) == 4


def test_a_negative_seed_is_refused(tmp_path):
    @measurement(page="accuracy.md", quick={})
    def draws(seed: int = 0):
        pytest.fail("begun")

    with pytest.raises(InputError, match="seed = -1: expected 0 or more"):
        draws.main(draws.Settings(seed=-1, out=tmp_path))


def test_rows_outlive_an_error(tmp_path):
    """Each is in the file as soon as it is there."""
    squares = example()
    with pytest.raises(RuntimeError):
        squares.main(squares.Settings(first=12.0, out=tmp_path))
    assert [row["x"] for row in json.loads((tmp_path / "squares.json").read_text())["rows"]] == [12.0, 13.0]


def test_rows_alone_are_a_record(tmp_path):
    """A function need not return anything beside them."""

    @measurement(page="accuracy.md", quick={})
    def ones():
        yield {"x": 1}

    ones.table(lambda record: columns(record["rows"], {"x": "{x}"}))
    ones.main(ones.Settings(out=tmp_path))
    assert json.loads((tmp_path / "ones.json").read_text())["rows"] == [{"x": 1}]


def test_a_figure_stands_beside_its_record(tmp_path):
    """Of the width that all have, so that letters of all figures are of one size on a page."""
    squares = example()
    squares.figure(2)(lambda record, chart: chart.subplots().plot([row["x"] for row in record["rows"]]))
    squares.main(squares.Settings(out=tmp_path))
    width, height = struct.unpack(">II", (tmp_path / "squares.png").read_bytes()[16:24])
    assert (width, height) == (130 * plot.WIDTH, 130 * 2)


def test_every_measurement_has_a_table_and_names_its_page():
    """The registry knows each by the name of its script."""
    found = registry.measurements()
    assert {"stiff", "validate", "third_opinions"} <= set(found)
    docs = registry.EXPERIMENTS.parent / "docs"
    for name, each in ((name, one) for one in found.values() for name in one.names):
        record = json.loads((docs / "measured" / f"{name}.json").read_text())
        for part, table in each.tables.items():
            page = docs.parent / update_docs.place(table.page)
            assert each.words(record, name, part) in page.read_text(encoding="utf-8")


def test_a_record_for_each_value_of_a_literal(tmp_path):
    """All of them, or those that are asked for; each has a file and a table of its own, and a table may have parts."""

    @measurement(page="accuracy.md", quick={"ground": ("rough ice",)})
    def slides(ground: Literal["mud", "rough ice"], far: float = 2.0):
        return {"ground": ground, "far": far}

    slides.table(lambda record: columns([record], {"far": "{far:g}"}))
    slides.table(lambda record: columns([record], {"on": "{ground}"}), part="where", page="README.md")
    assert list(slides.names) == ["slides_mud", "slides_rough_ice"]
    slides.main(slides.Settings(out=tmp_path / "all"))
    assert len(list((tmp_path / "all").iterdir())) == 2
    slides.main(slides.Settings(out=tmp_path / "quick", quick=True))
    (path,) = (tmp_path / "quick").iterdir()
    record = json.loads(path.read_text())
    assert "| rough ice |" in slides.words(record, path.stem, "where")
    assert "[docs/measured/slides_rough_ice.json](docs" in slides.words(record, path.stem, "where")
    assert "[measured/slides_rough_ice.json](measured" in slides.words(record, path.stem)

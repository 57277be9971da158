"""Pages whose tables are generated: what stands between `<!-- measured: NAME -->` and `<!-- end -->` is replaced."""

import re
from collections.abc import Callable
from pathlib import Path

from jaxgrity import InputError
from jaxgrity.io.files import read_text, write_whole


def table(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    assert all(len(row) == len(head) for row in rows), "a cell for each head"
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def columns(rows: list[dict], cells: dict[str, str | Callable[[dict], str]]) -> str:
    """A Markdown table with a line for each row: under every head a format of the row's values, or a function of it."""
    made = [[cell.format(**row) if isinstance(cell, str) else cell(row) for cell in cells.values()] for row in rows]
    return table(list(cells), made)


def filled(text: str, blocks: dict[str, str]) -> str:
    """`text` with what stands between the marks of each name replaced.

    Raises `InputError` where a name has no marks, or more than one pair of them.
    """
    for name, words in blocks.items():
        marks = re.compile(rf"(<!-- measured: {re.escape(name)} -->\n).*?(<!-- end -->)", re.DOTALL)
        text, count = marks.subn(lambda match, words=words: f"{match[1]}{words}\n{match[2]}", text)
        if count != 1:
            raise InputError(f"{count} pairs of marks '<!-- measured: {name} -->' in the page; expected one pair")
    return text


def fill_page(path: Path, blocks: dict[str, str], page: Path | None = None) -> None:
    """Fill the marks of a page, or those of `page` to be written to `path`."""
    text = filled(read_text(page or path), blocks)
    write_whole(path, lambda file: file.write(text.encode()))


def made_by(facts: dict, name: str, page: str = "") -> str:
    """The command and the file beside the numbers, as a page sees it."""
    folder = "docs/measured" if page == "README.md" else "measured"
    return f"\n\n`{facts['command']}`, [{folder}/{name}.json]({folder}/{name}.json)."


def short(value: float) -> str:
    """Two digits, without an exponent where the number is large."""
    return f"{float(f'{value:.2g}'):g}"


def whole_zero(value: float) -> float:
    """Without a sign where it is rounding alone."""
    return 0.0 if abs(value) < 1e-6 else value

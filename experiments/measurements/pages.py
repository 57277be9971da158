"""Pages whose tables are generated: what stands between `<!-- measured: NAME -->` and `<!-- end -->` is replaced.

What they quote is kept as JSON that can be read: a row a line, numbers to six significant digits.
"""

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrity import InputError
from jaxgrity.io.files import read_text, write_whole

DIGITS = 6
WIDTH = 120
"""characters, above which a table of values by name takes a line for each of them"""


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


def save_compact(path: Path, content: Any) -> None:
    """Write `content`, arrays and NumPy numbers allowed, a number that is not finite as null."""
    text = laid_out(rounded(content)) + "\n"
    write_whole(path, lambda file: file.write(text.encode()))


def by_name(rows: list[dict], *names: str) -> dict[str, list]:
    """What rows have by these names, or by all of the first row: a list each, which takes less room than rows do."""
    return {name: [row[name] for row in rows] for name in names or rows[0]}


def rounded(value: Any, digits: int = DIGITS) -> Any:
    """The same with plain numbers of at most so many significant digits."""
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, dict):
        return {str(key): rounded(item, digits) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(item, digits) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    return rounded(np.asarray(value).tolist(), digits)


def laid_out(value: Any, indent: str = "", row: bool = False) -> str:
    """The text of a value: a line for each row of a table of several, and for each name of what has such tables or is
    long."""
    inner = indent + "  "
    if _has_rows(value) and isinstance(value, list):
        items = [laid_out(item, inner, row=True) for item in value]
        return "[\n" + ",\n".join(inner + item for item in items) + f"\n{indent}]"
    flat = json.dumps(value, ensure_ascii=False)
    if isinstance(value, dict) and (_has_rows(value) or (not row and (not indent or len(flat) > WIDTH))):
        items = [f"{json.dumps(key, ensure_ascii=False)}: {laid_out(item, inner)}" for key, item in value.items()]
        return "{\n" + ",\n".join(inner + item for item in items) + f"\n{indent}}}"
    return flat


def _has_rows(value: Any) -> bool:
    """Whether a list of several dictionaries is somewhere in it."""
    if isinstance(value, dict):
        return any(_has_rows(item) for item in value.values())
    rows = [item for item in value if isinstance(item, dict)] if isinstance(value, list) else []
    return len(rows) > 1 or any(_has_rows(row) for row in rows)

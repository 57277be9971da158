"""JSON that is short and can be read: what pages quote, a row a line, numbers to six significant digits."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrity.io.files import write_whole

DIGITS = 6
WIDTH = 120
"""characters, above which a table of values by name takes a line for each of them"""


def save_compact(path: Path, content: Any) -> None:
    """Write `content`, arrays and NumPy numbers allowed, a number that is not finite as null."""
    text = laid_out(rounded(content)) + "\n"
    write_whole(path, lambda file: file.write(text.encode()))


def rounded(value: Any) -> Any:
    """The same with plain numbers of at most `DIGITS` significant digits."""
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, dict):
        return {str(key): rounded(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return rounded(np.asarray(value).tolist())


def laid_out(value: Any, indent: str = "", row: bool = False) -> str:
    """The text of a value: a line for each row of a table, and for each name of what has tables or is long."""
    inner = indent + "  "
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        items = [laid_out(item, inner, row=True) for item in value]
        return "[\n" + ",\n".join(inner + item for item in items) + f"\n{indent}]"
    flat = json.dumps(value, ensure_ascii=False)
    if isinstance(value, dict) and (_has_rows(value) or (not row and (not indent or len(flat) > WIDTH))):
        items = [f"{json.dumps(key, ensure_ascii=False)}: {laid_out(item, inner)}" for key, item in value.items()]
        return "{\n" + ",\n".join(inner + item for item in items) + f"\n{indent}}}"
    return flat


def _has_rows(value: Any) -> bool:
    """Whether a list of dictionaries is somewhere in it."""
    if isinstance(value, dict):
        return any(_has_rows(item) for item in value.values())
    return isinstance(value, list) and any(isinstance(item, dict) for item in value)

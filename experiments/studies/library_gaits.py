"""The searches that found the library's gaits, once more, each by its own command: what they find here.

Another machine adds in another order, so that a search may end at another gait: its steady speed stands beside that of
the library's.
"""

import json
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from measurements.measurement import Figure, Record, check_names, measurement
from measurements.pages import columns

from jaxgrity import gait_names, gait_record
from jaxgrity.io.files import read_text

SEARCH = Path(__file__).parents[1] / "gait_search.py"


@measurement(page="gait_records.md", quick={"gaits": gait_names()[:1], "small": True})
def library_gaits(out: Path, gaits: tuple[str, ...] = gait_names(), small: bool = False) -> Iterator[Record]:
    """A row for each gait; each search leaves a folder.

    Args:
        gaits: names of the library's gaits
        small: whether searches are as small as with --quick
    """
    check_names("gaits", gaits, gait_names())
    for name in gaits:
        folder, record = out / name, gait_record(name)
        asked = [*options_of(record["command"]), *["--quick"] * small, "--restart", "--out", folder]
        subprocess.run([sys.executable, SEARCH, *asked], check=True)
        steady = json.loads(read_text(folder / "summary.json")).get("steady")
        found = steady["body_lengths_per_second"] if steady and steady["settled"] else None
        library = record["steady"]["body_lengths_per_second"]
        yield {"gait": name, "command": record["command"], "library": library, "found": found}


@library_gaits.table
def words(record: Record) -> str:
    """What each search found, and the speed of the library's gait."""
    cells = {
        "search of": "`{gait}`",
        "steady speed found, body lengths/s": lambda row: "no orbit" if row["found"] is None else f"{row['found']:.3f}",
        "the library's gait at that time": "{library:.3f}",
        "share of it": lambda row: f"{(row['found'] or 0) / row['library']:.0%}",
    }
    return columns(record["rows"], cells)


def options_of(command: str) -> list[str]:
    """What follows the name of the program in the command of a search: `jaxgrity search` or a Python script."""
    return shlex.split(command)[2:]


@library_gaits.figure()
def figure(record: Record, chart: Figure) -> None:
    """Speeds of what was found beside those of the library."""
    rows = record["rows"]
    chart.set_figheight(0.5 * len(rows) + 1.5)
    axes = chart.subplots()
    for k, (name, label) in enumerate((("library", "in the library"), ("found", "found again"))):
        axes.barh(np.arange(len(rows)) + 0.4 * k - 0.2, [row[name] or 0 for row in rows], height=0.35, label=label)
    axes.set_yticks(range(len(rows)), [row["gait"] for row in rows])
    axes.set(xlabel="steady speed (body lengths/s)")
    axes.grid(axis="y", visible=False)
    axes.invert_yaxis()
    chart.legend(loc="outside upper center", ncols=2)

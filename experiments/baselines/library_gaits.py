"""The searches that found the library's gaits, once more, each by its own command: what they find here.

Another machine adds in another order, so that a search may end at another gait: its steady speed stands beside that of
the library's.
"""

import json
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import InputError, gait_names, gait_record
from jaxgrity.io.files import read_text, save_json
from jaxgrity.report import plot

SEARCH = Path(__file__).parents[1] / "gait_search.py"


@dataclass
class Settings:
    gaits: tuple[str, ...] = gait_names()
    """names of the library's gaits"""
    out: Path = Path("results/library_gaits")
    """folder for library_gaits.json, its figure, and a folder for each search"""
    quick: bool = False
    """one gait, by a small search"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.gaits = settings.gaits[:1]
    unknown = sorted(set(settings.gaits) - set(gait_names()))
    if unknown:
        raise InputError(f"gaits = {unknown}: unknown; expected some of {', '.join(gait_names())}")
    rows: list[dict[str, Any]] = []
    for name in tqdm(settings.gaits, unit="gait"):
        folder, record = settings.out / name, gait_record(name)
        quick = ["--quick"] if settings.quick else []
        command = [sys.executable, SEARCH, *options_of(record["command"]), *quick, "--restart", "--out", folder]
        subprocess.run(command, check=True)
        found = json.loads(read_text(folder / "summary.json")).get("steady")
        speeds = {"library": record["steady"]["body_lengths_per_second"], "found": None}
        if found and found["settled"]:
            speeds["found"] = found["body_lengths_per_second"]
        rows.append({"gait": name, "command": record["command"], **speeds})
        save_json(settings.out / "library_gaits.json", {**measured(), "rows": rows})
    plot.save(figure(rows), settings.out / "library_gaits.png")
    for row in rows:
        print(f"{row['gait']}: {row['found'] or 'no orbit'}, in the library {row['library']:.3f} body lengths/s")


def options_of(command: str) -> list[str]:
    """What follows the name of the program in the command of a search: `jaxgrity search` or a Python script."""
    return shlex.split(command)[2:]


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """Speeds of what was found beside those of the library."""
    chart = Figure(figsize=(5.5, 0.5 * len(rows) + 1.5), layout="constrained")
    axes = chart.subplots()
    for k, (name, label) in enumerate((("library", "in the library"), ("found", "found here"))):
        axes.barh(np.arange(len(rows)) + 0.4 * k - 0.2, [row[name] or 0 for row in rows], height=0.35, label=label)
    axes.set_yticks(range(len(rows)), [row["gait"] for row in rows])
    axes.set(xlabel="steady speed (body lengths/s)")
    axes.grid(axis="y", visible=False)
    axes.invert_yaxis()
    chart.legend(loc="outside upper center", ncols=2)
    return chart


if __name__ == "__main__":
    run(main, Settings)

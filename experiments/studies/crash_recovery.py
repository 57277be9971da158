"""Crash recovery: a search is killed (SIGKILL) at random moments and resumed; it has to end as if it had not been.

Moments are uniform from the beginning of the search to the end of its last generation, as an undisturbed run has them.
Each time every file in the run's folder has to be whole, and after --resume the final population has to be the same to
the last bit as that of a run that nobody killed. One resumed run goes on to its report; the others end with their last
generation.
"""

import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from measurements.measurement import Record, measurement
from measurements.pages import table

from jaxgrity import InputError
from jaxgrity.io.files import PART
from jaxgrity.search import load_states

SMALL = ("--duration", "2", "--population", "16", "--generations", "12", "8", "--polish-rollouts", "0")
"""a search on both fidelity levels, without polish"""
QUICK = (
    *("--scene", "exact", "--duration", "2", "--population", "4", "--generations", "3", "2", "--robots", "2"),
    *("--polish-rollouts", "0"),
)
"""one that only its processes and their compilation take time for"""


@measurement(page="search_records.md", quick={"kills": 1, "timed": False}, raw=("rows",))
def crash_recovery(out: Path, kills: int = 20, seed: int = 0, timed: bool = True) -> Iterator[Record]:
    """A row for each run that is killed; counts of what became of them.

    Raises `InputError` where a final population differs, or a file is broken.

    Args:
        kills: how many runs are killed
        seed: seed of the moments
        timed: kill at these moments; else as soon as a generation is saved, of a small search without its report
    """
    options, whole = SMALL if timed else QUICK, out / "whole"
    if timed:
        # so that the moments are those of a run whose programs are compiled, as the others' will be
        search(whole, "--restart", *options)
    shutil.rmtree(whole, ignore_errors=True)
    began = time.time()
    search(whole, "--restart", *options)
    undisturbed, lasted = population(whole), time.time() - began
    first, last = ((whole / name).stat().st_mtime - began for name in (".lock", "population.npz"))
    rows = []
    for number, moment in enumerate(np.random.default_rng(seed).uniform(first, last, kills)):
        folder = out / f"killed_{number}"
        kill(folder, moment if timed else None, *options)
        states, broken = load_states(folder), broken_files(folder)
        again = "--resume" if (folder / "run.json").exists() else "--restart"
        search(folder, again, *options, to_the_end=number == kills - 1 and timed)
        rows.append(
            {
                "after_seconds": moment,
                "generations_saved": [state.number for state in states],
                "broken_files": broken + broken_files(folder),
                "same_population": all(
                    np.array_equal(undisturbed[name], population(folder)[name]) for name in undisturbed
                ),
            }
        )
        yield rows[-1]
    same, broken = sum(row["same_population"] for row in rows), sum(len(row["broken_files"]) for row in rows)
    if same < kills or broken:
        raise InputError(f"{out}: {same} identical populations, {broken} broken files; expected {kills} and none")
    return {
        "killed": kills,
        "undisturbed_seconds": lasted,
        "between_generations": sum(0 < sum(row["generations_saved"]) < 20 for row in rows),
        "same_population": same,
        "broken_files": broken,
    }


@crash_recovery.table
def words(record: Record) -> str:
    """What became of the searches that were killed."""
    rows = [
        ["searches killed at random moments", str(record["killed"])],
        ["of these, killed after the first and before the last generation", str(record["between_generations"])],
        ["resumed, with the same final population", str(record["same_population"])],
        ["broken files", str(record["broken_files"])],
        ["duration of a search that nobody killed", f"{record['undisturbed_seconds']:.0f} s"],
    ]
    return table(["crash recovery", "measured"], rows)


def kill(folder: Path, moment: float | None, *options: str) -> None:
    """Begin a run, and kill it after so many seconds, or else once a generation is saved, if it lives that long."""
    alive = subprocess.Popen(
        command(folder, "--restart", *options), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    while moment is None and alive.poll() is None and not list(folder.glob("state_*.npz")):
        time.sleep(0.01)
    try:
        alive.wait(moment or 0)
    except subprocess.TimeoutExpired:
        alive.send_signal(signal.SIGKILL)
        alive.wait()


def command(folder: Path, *options: str) -> list[str]:
    """A search with these options."""
    return [sys.executable, str(Path(__file__).parents[1] / "gait_search.py"), "--out", str(folder), *options]


def search(folder: Path, *options: str, to_the_end: bool = False) -> None:
    """A run to its last generation, or to the end of its report. Raises `InputError` where it ends before."""
    final = folder / "population.npz"
    final.unlink(missing_ok=True)
    with tempfile.TemporaryFile("w+") as said:
        alive = subprocess.Popen(command(folder, *options), stdout=subprocess.DEVNULL, stderr=said)
        while alive.poll() is None and (to_the_end or not final.exists()):
            time.sleep(0.05)
        alive.kill()
        if alive.wait() if to_the_end else not final.exists():
            said.seek(0)
            raise InputError(f"{folder}: the search ended with {alive.returncode}: {said.read()[-500:]}")


def population(folder: Path) -> dict[str, np.ndarray]:
    """The final population."""
    with np.load(folder / "population.npz") as saved:
        return {name: saved[name] for name in saved}


def broken_files(folder: Path) -> list[str]:
    """Those that cannot be read, or are empty; what was never complete has another name, and does not count."""
    found = []
    for path in folder.iterdir() if folder.exists() else ():
        if path.name.endswith(PART) or path.name == ".lock":
            continue
        try:
            if path.suffix == ".json":
                json.loads(path.read_text())
            elif path.suffix == ".npz":
                with np.load(path) as saved:
                    _ = [saved[name] for name in saved]
            elif not path.stat().st_size:
                found.append(path.name)
        except Exception:
            found.append(path.name)
    return found

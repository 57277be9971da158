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
from dataclasses import dataclass
from pathlib import Path

from jaxgrity.cli.script import measured, run

import numpy as np
from tqdm import tqdm

from jaxgrity import InputError
from jaxgrity.io.files import PART, save_json
from jaxgrity.search import load_states

SMALL = ("--duration", "2", "--population", "16", "--generations", "12", "8", "--polish-rollouts", "0")
"""a search on both fidelity levels, without polish"""
QUICK = (
    *("--scene", "exact", "--duration", "2", "--population", "4", "--generations", "3", "2", "--robots", "2"),
    *("--polish-rollouts", "0"),
)
"""one that only its processes and their compilation take time for"""


@dataclass
class Settings:
    kills: int = 20
    """how many runs are killed"""
    seed: int = 0
    """of the moments"""
    out: Path = Path("results/crash_recovery")
    """folder for the runs and crash_recovery.json"""
    quick: bool = False
    """one kill, as soon as a generation is saved, of a small search on the scene "exact"; no report"""


def main(settings: Settings) -> None:
    kills, whole = 1 if settings.quick else settings.kills, settings.out / "whole"
    options = QUICK if settings.quick else SMALL
    if not settings.quick:
        # so that the moments are those of a run whose programs are compiled, as the others' will be
        search(whole, "--restart", *options)
    shutil.rmtree(whole, ignore_errors=True)
    began = time.time()
    search(whole, "--restart", *options)
    undisturbed, lasted = population(whole), time.time() - began
    first, last = ((whole / name).stat().st_mtime - began for name in (".lock", "population.npz"))
    moments = np.random.default_rng(settings.seed).uniform(first, last, kills)
    facts: dict = {**measured(), "undisturbed_seconds": lasted, "moments_between": [first, last], "kills": []}
    for number, moment in enumerate(tqdm(moments, unit="kill")):
        folder = settings.out / f"killed_{number}"
        kill(folder, None if settings.quick else moment, *options)
        states, broken = load_states(folder), broken_files(folder)
        again = "--resume" if (folder / "run.json").exists() else "--restart"
        search(folder, again, *options, to_the_end=number == kills - 1 and not settings.quick)
        same = all(np.array_equal(undisturbed[name], population(folder)[name]) for name in undisturbed)
        facts["kills"].append(
            {
                "after_seconds": moment,
                "generations_saved": [state.number for state in states],
                "broken_files": broken + broken_files(folder),
                "same_population": same,
            }
        )
        save_json(settings.out / "crash_recovery.json", facts)
    same = sum(one["same_population"] for one in facts["kills"])
    broken = sum(len(one["broken_files"]) for one in facts["kills"])
    print(f"{kills} kills: {same} identical final populations, {broken} broken files")
    if same < kills or broken:
        raise InputError(f"{settings.out}: expected {kills} identical populations and no broken file")


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


if __name__ == "__main__":
    run(main, Settings)

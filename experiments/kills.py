"""Nothing lost: a search is killed (SIGKILL) at random moments and resumed; it has to end as if nothing had happened.

Each time every file in the run's folder has to be whole, and after --resume the final population has to be the same to
the last bit as that of a run that nobody killed.
"""

import json
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from common import SCENES, measured, run

import numpy as np
from tqdm import tqdm

from jaxgrity import InputError
from jaxgrity.files import PART, save_json


@dataclass
class Settings:
    kills: int = 20
    """how many runs are killed"""
    seed: int = 0
    """of the moments"""
    out: Path = Path("results/kills")
    """folder for the runs and kills.json"""
    quick: bool = False
    """two kills"""


def main(settings: Settings) -> None:
    kills = 2 if settings.quick else settings.kills
    began = time.perf_counter()
    search(settings.out / "whole", "--restart")
    whole, lasted = population(settings.out / "whole"), time.perf_counter() - began
    moments = np.random.default_rng(settings.seed).uniform(0.05, 0.95, kills) * lasted
    facts: dict = {**measured(), "undisturbed_seconds": lasted, "kills": []}
    for number, moment in enumerate(tqdm(moments, unit="kill")):
        folder = settings.out / f"killed_{number}"
        alive = subprocess.Popen(command(folder, "--restart"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            alive.wait(moment)
        except subprocess.TimeoutExpired:
            alive.send_signal(signal.SIGKILL)
            alive.wait()
        broken = broken_files(folder)
        begun = (folder / "run.json").exists()
        generations = sum(path.name.startswith("state_") for path in folder.glob("*.npz"))
        search(folder, "--resume" if begun else "--restart")
        facts["kills"].append(
            {
                "after_seconds": moment,
                "searches_saved": generations,
                "broken_files": broken + broken_files(folder),
                "same_population": all(np.array_equal(whole[name], population(folder)[name]) for name in whole),
            }
        )
        save_json(settings.out / "kills.json", facts)
    same = sum(kill["same_population"] for kill in facts["kills"])
    broken = sum(len(kill["broken_files"]) for kill in facts["kills"])
    print(f"{kills} kills: {same} identical final populations, {broken} broken files")
    if same < kills or broken:
        raise InputError(f"{settings.out}: expected {kills} identical populations and no broken file")


def command(folder: Path, *options: str) -> list[str]:
    script = Path(__file__).with_name("gait_search.py")
    return [
        sys.executable,
        str(script),
        "--quick",
        "--scene",
        str(SCENES / "exact.toml"),
        "--out",
        str(folder),
        *options,
    ]


def search(folder: Path, *options: str) -> None:
    """A whole run. Raises `InputError` where it ends badly."""
    done = subprocess.run(command(folder, *options), capture_output=True, text=True)
    if done.returncode:
        raise InputError(f"{folder}: the search ended with {done.returncode}: {done.stderr[-500:]}")


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

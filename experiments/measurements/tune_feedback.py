"""Gains of phase-locked feedback, from none, by the cross-entropy method: from which drops robots soon roll, how fast.

In the end the library's gains and those that were found are compared on drops on which nothing was tuned.
"""

from dataclasses import dataclass
from pathlib import Path

from jaxgrity.cli.script import measured, run

import numpy as np
from basin import ENOUGH
from tuning import OPEN_LOOP, Search, Size, judgement, leave, level, numbers_of, orbit_speed, tuned

from jaxgrity import load_gait
from jaxgrity.control import PhaseLocked
from jaxgrity.io.files import save_json

SPREAD = np.array([0.6] * 4 + [0.0] * 6)
COUNTED = 1.1
"""times the orbit's speed, beyond which being faster does not count"""


@dataclass
class Settings(Size):
    generations: int = 20
    candidates: int = 24
    robots: int = 32
    judged: int = 256
    seed: int = 0
    out: Path = Path("results/tune_feedback")
    """folder for tune_feedback.json and its figure"""
    quick: bool = False
    """2 generations of 6 candidates and 4 robots"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.generations, settings.candidates, settings.robots, settings.judged = 2, 6, 4, 4
    found, rows = tuned(level(), Search(OPEN_LOOP, SPREAD, worth), settings)
    own = numbers_of(PhaseLocked(load_gait("lasting")))
    judged = judgement({"open loop": OPEN_LOOP, "default": own, "found by this run": found}, settings)
    facts = {**measured(), "seconds": 15.0, "robots": settings.judged, "rows": rows, "judged": judged}
    save_json(settings.out / "tune_feedback.json", facts)
    leave(settings.out, "tune_feedback", facts)


def worth(speeds: np.ndarray) -> np.ndarray:
    """m/s, the mean speed, up to a bound, and as much again for the share of robots that roll."""
    speed = orbit_speed()
    return np.minimum(speeds, COUNTED * speed).mean(1) + speed * (speeds >= ENOUGH * speed).mean(1)


if __name__ == "__main__":
    run(main, Settings)

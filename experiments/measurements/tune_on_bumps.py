"""Feedback for bumps of 2 cm: gains, amplitude and frequency, from plain feedback, by the cross-entropy method.

The mean speed counts. In the end plain feedback, the library's `sure_footed` and what was found are compared on ground
and from drops on which nothing was tuned.
"""

from dataclasses import dataclass
from pathlib import Path

from jaxgrity.cli.script import measured, run

import numpy as np
from tuning import Search, Size, judgement, leave, numbers_of, rough, tuned

from jaxgrity import load_gait
from jaxgrity.control import PhaseLocked, sure_footed
from jaxgrity.io.files import save_json

BUMPS_SEED = 10
"""which ground, another one than where results are measured"""
SPREAD = np.array([0.15] * 4 + [0.1] * 4 + [0.07, 0.08])


@dataclass
class Settings(Size):
    generations: int = 30
    candidates: int = 24
    robots: int = 32
    judged: int = 256
    seed: int = 0
    out: Path = Path("results/tune_on_bumps")
    """folder for tune_on_bumps.json and its figure"""
    quick: bool = False
    """2 generations of 6 candidates and 2 robots"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.generations, settings.candidates, settings.robots, settings.judged = 2, 6, 2, 2
    gait = load_gait("lasting")
    start = numbers_of(PhaseLocked(gait))
    search = Search(start, SPREAD, lambda speeds: speeds.mean(1))
    found, rows = tuned(rough(BUMPS_SEED), search, settings)
    known = {"plain feedback": start, "`sure_footed`": numbers_of(sure_footed(gait)), "found by this run": found}
    judged = judgement(known, settings)
    facts = {**measured(), "seconds": 15.0, "robots": settings.judged, "rows": rows, "judged": judged}
    save_json(settings.out / "tune_on_bumps.json", facts)
    leave(settings.out, "tune_on_bumps", facts)


if __name__ == "__main__":
    run(main, Settings)

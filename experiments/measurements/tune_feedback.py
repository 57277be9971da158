"""Gains of phase-locked feedback, from none, by the cross-entropy method: from which drops robots soon roll, how fast.

In the end the library's gains and those that were found are compared on drops on which nothing was tuned.
"""

from measurement import Record, measurement

import numpy as np
from basin import ENOUGH
from tuning import OPEN_LOOP, Search, Size, figure, judgement, level, numbers_of, orbit_speed, tuned, words

from jaxgrity import load_gait
from jaxgrity.control import PhaseLocked

SPREAD = np.array([0.6] * 4 + [0.0] * 6)
COUNTED = 1.1
"""times the orbit's speed, beyond which being faster does not count"""


@measurement(
    page="control.md",
    quick={"generations": 2, "candidates": 6, "robots": 4, "judged": 4},
    raw=("rows",),
)
def tune_feedback(
    generations: int = 20, candidates: int = 24, robots: int = 32, judged: int = 256, seed: int = 0
) -> Record:
    """Open loop, the defaults and what was found.

    Args:
        generations: of candidates
        candidates: in a generation
        robots: dropped under each candidate
        judged: robots of the last judgement, under each controller
        seed: of candidates and drops
    """
    size = Size(generations, candidates, robots, judged, seed)
    found, rows = tuned(level(), Search(OPEN_LOOP, SPREAD, worth), size)
    own = numbers_of(PhaseLocked(load_gait("lasting")))
    known = {"open loop": OPEN_LOOP, "default": own, "found by this run": found}
    return {"seconds": 15.0, "robots": judged, "rows": rows, "judged": judgement(known, size)}


def worth(speeds: np.ndarray) -> np.ndarray:
    """m/s, the mean speed, up to a bound, and as much again for the share of robots that roll."""
    speed = orbit_speed()
    return np.minimum(speeds, COUNTED * speed).mean(1) + speed * (speeds >= ENOUGH * speed).mean(1)


tune_feedback.table(words)
tune_feedback.figure(figure)


if __name__ == "__main__":
    tune_feedback.run()

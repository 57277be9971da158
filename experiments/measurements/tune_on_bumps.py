"""Feedback for bumps of 2 cm: gains, amplitude and frequency, from plain feedback, by the cross-entropy method.

The mean speed counts. In the end plain feedback, the library's `sure_footed` and what was found are compared on ground
and from drops on which nothing was tuned.
"""

from measurement import Record, measurement

import numpy as np
from tuning import Search, Size, figure, judgement, numbers_of, rough, tuned, words

from jaxgrity import load_gait
from jaxgrity.control import PhaseLocked, sure_footed

BUMPS_SEED = 10
"""which ground, another one than where results are measured"""
SPREAD = np.array([0.15] * 4 + [0.1] * 4 + [0.07, 0.08])


@measurement(
    page="control.md",
    quick={"generations": 2, "candidates": 6, "robots": 2, "judged": 2},
    raw=("rows",),
)
def tune_on_bumps(
    generations: int = 30, candidates: int = 24, robots: int = 32, judged: int = 256, seed: int = 0
) -> Record:
    """Plain feedback, `sure_footed` and what was found.

    Args:
        generations: of candidates
        candidates: in a generation
        robots: dropped under each candidate
        judged: robots of the last judgement, under each controller
        seed: of candidates and drops
    """
    size, gait = Size(generations, candidates, robots, judged, seed), load_gait("lasting")
    start = numbers_of(PhaseLocked(gait))
    found, rows = tuned(rough(BUMPS_SEED), Search(start, SPREAD, lambda speeds: speeds.mean(1)), size)
    known = {"plain feedback": start, "`sure_footed`": numbers_of(sure_footed(gait)), "found by this run": found}
    return {"seconds": 15.0, "robots": judged, "rows": rows, "judged": judgement(known, size)}


tune_on_bumps.table(words)
tune_on_bumps.figure(figure)


if __name__ == "__main__":
    tune_on_bumps.run()

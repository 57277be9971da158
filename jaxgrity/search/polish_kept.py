"""What of a polished gait a search keeps: bounds on its actuators, and its orbit, may forbid it."""

import numpy as np

from jaxgrity.search.climb import OneGait
from jaxgrity.search.fidelity import FidelityLevels, excess_at
from jaxgrity.search.polish import (
    AS_IT_WAS,
    FOR_A_PART,
    KEPT,
    Polished,
    before_and_after,
    gain_words,
    options_of_stages,
    purpose_key,
)
from jaxgrity.search.polish_config import PolishConfig
from jaxgrity.search.problem import SearchProblem
from jaxgrity.search.promotion import Promoted, multiplier_words, multipliers_of, orbit_words

PARTS = (1.0, 0.75, 0.5, 0.25)
"""Parts of the way from start to end that are tried, the longest first."""


def kept_or_undone(
    problem: SearchProblem,
    levels: FidelityLevels,
    promoted: Promoted,
    start: OneGait,
    polished: Polished,
    config: PolishConfig,
    seed: int = 0,
) -> Polished:
    """The polished gait; or its start, if polishing left the start's attracting orbit.

    If the polished gait exceeds bounds by more than its start, the search goes back to the longest of `PARTS` of the
    way that does not, and keeps this gait if an ensemble finds it better.

    Args:
        problem: with all bounds, and the genome of the polished gait.
        levels: on the own model of which bounds are measured.
        promoted: gaits from which polishing began.
        start: genes of the best of them, in the polished genome.
        polished: result of polishing.
        config: settings of the ensemble.
        seed: of its draws.
    """
    if not polished.improved:
        return polished
    found, before = _within_bounds(problem, levels, start, polished, config, seed), promoted.multipliers
    if not found.improved or before is None or before[0] >= 1:
        return found
    after = multipliers_of(problem, found.genes[None], 2 * levels.verification.dt)
    if after is None or after[0] < 1:
        return found
    but = f"it settles on {orbit_words(after[0])}, the start on one with {multiplier_words(before[0])}"
    return _undone(found, start, f"but {but}: {AS_IT_WAS}")


def _within_bounds(
    problem: SearchProblem,
    levels: FidelityLevels,
    start: OneGait,
    polished: Polished,
    config: PolishConfig,
    seed: int,
) -> Polished:
    """The gait that is farthest on the way from the start to the polished one, and no further beyond bounds."""
    genome, end, plain = problem.genome, polished.genes, problem.without_force_bounds
    ways = [end if part == 1 else genome.wrapped(start + part * genome.towards(start, end)) for part in PARTS]
    least, *excess = excess_at(levels.own, np.stack([start, *map(np.asarray, ways)]), plain, problem.fitness.bounds)
    if excess[0] <= least:
        return polished
    but = f"but it is {'further ' if least else ''}beyond a bound on actuators"
    part, way = next((each for each, more in zip(zip(PARTS, ways), excess) if more <= least), (0.0, start))
    if not part:
        return _undone(polished, start, f"{but}: {AS_IT_WAS}")
    final = options_of_stages(plain, levels.rough_own.options, levels.own.options)[1]
    before, after = before_and_after(plain, start, np.asarray(way), final, config, purpose_key(seed, FOR_A_PART))
    told = f"{but}; {100 * part:.0f} % of the way: {gain_words(before, after, problem.fitness.caution)}"
    if not after.merit[0] > before.merit[0]:
        return _undone(polished, start, told)
    reason = f"{polished.reason.removesuffix(f': {KEPT}')}; {told}"
    return polished._replace(genes=np.asarray(way), before=before, after=after, reason=reason)


def _undone(polished: Polished, start: OneGait, why: str) -> Polished:
    """Polishing that came to nothing."""
    reason = f"{polished.reason.removesuffix(f': {KEPT}')}; {why}"
    return polished._replace(genes=start, improved=False, reason=reason)

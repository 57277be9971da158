"""From the gaits that an evolution ends with to the one that goes on: judged on both contact models, by more robots."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.orbits.finding import IN_TIME, find_orbit, shortest_watch
from jaxgrity.orbits.orbit_stability import stability
from jaxgrity.populations.population import one_gait
from jaxgrity.search.fidelity import FidelityLevel, FidelityLevels, excess_at, judge_at, rank_correlation
from jaxgrity.search.genetic_algorithm import Evolution, distinct
from jaxgrity.search.genome import Genes
from jaxgrity.search.judging import Scores, judge
from jaxgrity.search.objectives import ActuatorBounds
from jaxgrity.search.problem import SearchProblem
from jaxgrity.search.search_config import COMPARED, SearchConfig
from jaxgrity.search.search_space import overtones_to_polish
from jaxgrity.stepping.methods import default_method
from jaxgrity.stepping.options import SolverOptions
from jaxgrity.stepping.step_limits import default_step

FINALISTS = 4
"""Number of gaits that are compared once more, over more robots: a few robots rank close gaits by chance."""
FINALIST_ROBOTS = 16
"""Number of robots per finalist, as a multiple of the robots per gait in a generation."""


class Agreement(NamedTuple):
    """How far the fidelity levels agree about gaits, the first `evolved` of which evolved, the rest being random."""

    levels: tuple[FidelityLevel, ...]
    fitness: np.ndarray
    """(levels, gaits); NaN for gaits beyond the bound on rates on any robot, which have no rank"""
    evolved: int
    rank_correlation: np.ndarray
    """(levels, levels), over all gaits"""
    rank_correlation_of_the_evolved: np.ndarray
    """(levels, levels)"""


class Promoted(NamedTuple):
    """The gaits with which a search goes on."""

    genes: Float[np.ndarray, "polished genes"]
    """best first"""
    finals: Scores
    """of the finalists, best first, by many robots"""
    multipliers: Float[np.ndarray, " finalists"] | None
    """largest Floquet multiplier of each finalist's orbit: the growth of a disturbance in a cycle; infinite without an
    orbit `IN_TIME`. None: not requested, or no orbit is sought for the objective or the ground"""
    agreement: Agreement


def promote(
    problem: SearchProblem,
    bounds: ActuatorBounds,
    levels: FidelityLevels,
    evolution: Evolution,
    config: SearchConfig,
    on_part: Callable[[int, int, dict[str, str]], None],
) -> Promoted:
    """The best gaits of an evolution.

    Evolved and random gaits are judged by the same draws on all `levels.compared`. Finalists are the best few: least
    excess over bounds on the nominal robot, then most merit on the decisive level. They are judged there again by more
    robots, since a few do not tell how often a gait fails. Where that is asked for, finalists whose orbit does not
    attract (a multiplier of 1 or more) come after those whose orbit does. Gaits beyond a bound on actuators come last,
    the farther the later: bounds on forces and powers on the nominal robot, the one on rates on all robots.

    Raises `InputError` where every rollout of the last generation failed. `on_part` gets how many comparisons are done,
    how many there are, and the next: each level, then the finalists, then the orbit of each.
    """
    wanted = 1 if config.polish is None else config.polish.gaits
    evolved = distinct(evolution.last, problem.genome, COMPARED)
    if not len(evolved):
        raise InputError("every rollout of the last generation failed; expected a scene that can be integrated")
    chance = np.random.default_rng(config.seed).uniform(size=(COMPARED, problem.genome.size))
    # the same gaits, with overtones that are 0: so they run through the compiled programs of polished gaits
    overtones = overtones_to_polish(problem, config.polish)
    genome, tried_genes = problem.genome.with_overtones(np.concatenate([evolved, chance]), overtones, 0.0)
    shaped, genes = problem._replace(genome=genome), tried_genes[: len(evolved)].astype(evolved.dtype)
    gaits = genome.gaits(problem.scene.gait, tried_genes)
    tried, finalists = levels.compared, min(max(FINALISTS, wanted), len(genes))
    watched = config.evaluation.attracting and _have_orbits(problem)
    parts = len(tried) + 1 + (finalists if watched else 0)
    scores: list[Scores] = []
    for level in tried:
        on_part(len(scores), parts, {"level": level.name})
        scores.append(judge_at(level, gaits, shaped, config.seed + 2))
    on_part(len(tried), parts, {"level": "finalists, by more robots"})
    first, table = len(genes), np.array([np.where(each.excess.any(1), np.nan, each.fitness) for each in scores])
    agreement = Agreement(tried, table, first, rank_correlation(table), rank_correlation(table[:, :first]))
    excess = excess_at(levels.own, genes, shaped, bounds)
    best = np.lexsort((-scores[-1].merit[:first], excess))[:finalists]
    finals = _finals(shaped, levels.decisive, genes[best], config.seed)
    multipliers = None
    if watched:
        orbits = lambda k: on_part(len(tried) + 1 + k, parts, {"orbit of finalist": str(k + 1)})  # noqa: E731
        multipliers = multipliers_of(shaped, genes[best], 2 * levels.verification.dt, orbits)
    on_part(parts, parts, {})
    repels = np.zeros(len(best), bool) if multipliers is None else multipliers >= 1
    order = np.lexsort((-finals.merit, repels, excess[best]))
    best, finals = best[order], Scores(*(np.asarray(part)[order] for part in finals))
    multipliers = None if multipliers is None else multipliers[order]
    chosen = np.asarray(evolved, float)[best[:wanted]]
    return Promoted(chosen, finals, multipliers, agreement)


def multipliers_of(
    problem: SearchProblem, genes: Genes, step: float, on_orbit: Callable[[int], None] = lambda number: None
) -> np.ndarray | None:
    """Of the gaits' orbits (`orbit_multipliers`), for objectives that look for orbits, on planes; else None."""
    if not _have_orbits(problem):
        return None
    return orbit_multipliers(problem.scene, problem.genome.gaits(problem.scene.gait, genes), step, on_orbit)


def _have_orbits(problem: SearchProblem) -> bool:
    return problem.seeks_orbits and problem.scene.ground is not None


def orbit_multipliers(
    scene: Scene, gaits: Gait, dt: float, on_orbit: Callable[[int], None] = lambda number: None
) -> Float[np.ndarray, " gaits"]:
    """The largest multiplier of each gait's orbit (`stability`); infinite without an orbit in `shortest_watch`.

    Steps are `dt` (s), or the scene's for a gait that needs smaller ones. `on_orbit` hears the number of each gait
    before its orbit is sought. Raises `InputError` as `find_orbit` does.
    """
    found = []
    for k in range(len(gaits.phase)):
        on_orbit(k)
        found.append(_multiplier(with_gait(scene, one_gait(gaits, k)), dt))
    return np.array(found)


def multiplier_words(multiplier: float) -> str:
    """A Floquet multiplier with two digits, or with as many as tell it from 1, beyond which an orbit repels."""
    shown = (in_digits(multiplier, digits) for digits in range(2, 17))
    return next((each for each in shown if float(each) != 1), "1")


def orbit_words(multiplier: float) -> str:
    """An orbit with its Floquet multiplier, or that there is none, in words."""
    if np.isfinite(multiplier):
        return f"an orbit that multiplies a disturbance in one cycle by {multiplier_words(multiplier)}"
    return f"no orbit that attracts disturbed robots, {IN_TIME}"


def _multiplier(scene: Scene, dt: float) -> float:
    assert scene.gait is not None, "it was given"
    options = SolverOptions(dt=min(dt, default_step(scene, default_method(scene))))
    orbit = find_orbit(scene, shortest_watch(scene.gait), options=options)
    return stability(scene, orbit, options=options).largest if orbit.settled else np.inf


def _finals(problem: SearchProblem, level: FidelityLevel, genes: Genes, seed: int) -> Scores:
    """The finalists' scores by `FINALIST_ROBOTS` times as many robots as in a generation, where robots differ."""
    few = problem.fitness.robots
    judging = level.judging(problem).with_robots(few * FINALIST_ROBOTS if few > 1 else 1)
    return judge(jax.random.key(seed + 3), judging, problem.genome.gaits(problem.scene.gait, genes))

"""The whole way to a gait: evolve, promote the best to finer models, polish by gradients, verify."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxgrity.core.display import of_report
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.io.files import save_arrays
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.populations.population import one_gait
from jaxgrity.search.checkpoint import Checkpoint, open_checkpoint
from jaxgrity.search.fidelity import (
    FidelityLevel,
    Verdict,
    evolve_through,
    excess_at,
    fidelity_levels,
    final_verdict,
    search_levels,
)
from jaxgrity.search.genetic_algorithm import Evolution, SearchProblem
from jaxgrity.search.judging import without_measuring
from jaxgrity.search.objectives import ActuatorBounds
from jaxgrity.search.polish import Polished, polish
from jaxgrity.search.polish_config import PolishConfig
from jaxgrity.search.promotion import Promoted, multipliers_of, promote
from jaxgrity.search.search_config import (
    SearchConfig,
    fingerprint,
    ga_configs,
    genome_to_polish,
    plain_config,
    search_problem,
    with_actuated,
    without_idle,
)
from jaxgrity.stepping.options import resolve
from jaxgrity.stepping.step_limits import default_method, default_step

UNSEEN = 10**6
"""Number added to the seed of the last judgement, so that its draws are none by which gaits were chosen."""
FINAL_ROBOTS = 128
"""Most robots that judge what polishing gained: the verdict, which follows, takes more."""
Stage = Literal["evolving", "promoting", "polishing", "verifying"]


class Progress(NamedTuple):
    """How far a search is."""

    stage: Stage
    done: int
    """generations, fidelity levels, steps of polish or judgements"""
    total: int | None
    """of them; None: not known"""
    facts: dict[str, Any]
    """what is known of the search at this moment"""


class SearchResult(NamedTuple):
    """What a search found, and how."""

    scene: Scene
    """with the gait that was found"""
    gait: Gait
    problem: SearchProblem
    levels: tuple[FidelityLevel, ...]
    searches: tuple[Evolution, ...]
    """on the levels where gaits evolve"""
    promoted: Promoted
    polished: Polished | None
    verdict: Verdict
    seconds: dict[Stage, float]
    """wall time of each stage, s, compilation included"""

    def _repr_html_(self) -> str:
        return of_report("notebook", "search_html")(self)


Listener = Callable[[Progress], None]


@typed
def search_gaits(
    scene: Scene,
    config: SearchConfig | None = None,
    *,
    folder: Path | str | None = None,
    resume: bool = False,
    restart: bool = False,
    on_progress: Listener | None = None,
    report: Callable[[SearchResult], None] | None = None,
) -> SearchResult:
    """Search for a gait that rolls, and keeps rolling where robot and model differ; polish it, and verify it.

    Thousands of rough rollouts screen gaits, the scene's own model goes on with the best, and few exact rollouts judge
    what comes out. With a folder every generation is saved, and an interrupted search can be resumed to the very same
    end.

    Args:
        scene: the robot, with a gait around which gaits are searched.
        config: duration, population, objective, uncertainty and so on.
        folder: where to save the search's states and its last population; nothing is saved where not given.
        resume: go on with the search in the folder, which had the same scene and config.
        restart: begin again where the folder holds an unfinished search.
        on_progress: hears of every generation, level, step and judgement.
        report: gets the result before the search in the folder counts as done, to leave files there.

    Returns:
        The gait, and all that is known of it.

    Raises:
        InputError: a scene without a gait, a config that cannot be searched with, a folder that is in use, cannot be
            written to or holds another search; before anything compiles, as far as it can be known then.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> config = jaxgrity.SearchConfig(duration=1.5, population=8, generations=(1, 1), robots=2, polish_rollouts=0)
        >>> result = jaxgrity.search_gaits(scene, config)
        >>> result.gait.phase.shape, bool(result.verdict.verified.error_bar[0] < 0.1)
        ((6,), True)
    """
    config = config or SearchConfig()
    if (resume or restart) and folder is None:
        raise InputError("resume, restart: there is no folder to find a search in; expected folder")
    scene = with_actuated(scene, config.members)
    problem = search_problem(scene, config)
    levels = fidelity_levels(scene, config.dt, config.both_models, config.wide)
    # both refuse now what a later stage could not do
    for level in levels:
        resolve(level.scene, config.duration, level.options)
    ga_configs(config, len(search_levels(levels)))
    with ExitStack() as held:
        checkpoint = None
        if folder is not None:
            settings = {**plain_config(config), "fingerprint of the scene": fingerprint(scene)}
            checkpoint = held.enter_context(open_checkpoint(Path(folder), settings, resume, restart))
        result = _search(problem, levels, config, checkpoint, on_progress or (lambda progress: None))
        if report is not None:
            report(result)
        if checkpoint is not None:
            checkpoint.done()
    return result


def _search(
    problem: SearchProblem,
    levels: tuple[FidelityLevel, ...],
    config: SearchConfig,
    checkpoint: Checkpoint | None,
    listener: Listener,
) -> SearchResult:
    """The four stages, one after the other."""
    seconds: dict[Stage, float] = {}
    began = time.perf_counter()

    def clocked(stage: Stage) -> None:
        nonlocal began
        now = time.perf_counter()
        seconds[stage], began = now - began, now

    searches = _evolve(problem, levels, config, checkpoint, listener)
    clocked("evolving")
    # what few gaits ask of their actuators is looked at once, since measuring costs several times a plain rollout
    plain = problem._replace(fitness=without_measuring(problem.fitness))
    bounds = problem.fitness.bounds

    def heard(done: int, total: int, facts: dict[str, str]) -> None:
        listener(Progress("promoting", done, total, facts))

    promoted = promote(plain, bounds, levels, searches[-1], config, heard)
    clocked("promoting")
    polished, genome, best = None, problem.genome, promoted.genes[0]
    if config.polish_rollouts:
        wider, starts = genome_to_polish(problem, promoted.genes, config)
        polishing = plain._replace(genome=wider)
        polished = _polish(polishing, levels, starts, config, listener)
        if polished.improved:
            polished = _allowed(polishing, bounds, levels, (promoted, starts[0]), polished)
        if polished.improved:
            genome, best = polished.genome, polished.genes
    clocked("polishing")
    gait = one_gait(genome.gaits(problem.scene.gait, best[None]), 0)
    gait = gait if config.active is None else without_idle(gait)

    def judged(done: int, total: int) -> None:
        listener(Progress("verifying", done, total, {}))

    found = with_gait(problem.scene, gait)
    # a stronger gait than the scene's own may need a smaller step
    dt = min(levels[-1].dt, default_step(found, default_method(found)) / 2)
    verdict = final_verdict(plain, gait, dt=dt, bounds=bounds, seed=config.seed + UNSEEN, on_progress=judged)
    clocked("verifying")
    return SearchResult(found, gait, problem, levels, tuple(searches), promoted, polished, verdict, seconds)


def _evolve(
    problem: SearchProblem,
    levels: tuple[FidelityLevel, ...],
    config: SearchConfig,
    checkpoint: Checkpoint | None,
    listener: Listener,
) -> list[Evolution]:
    """The genetic search in float32, on every core, on each of the levels where gaits are searched."""
    searched, configs = search_levels(levels), ga_configs(config, len(search_levels(levels)))
    total, states = sum(each.generations for each in configs), () if checkpoint is None else checkpoint.states
    done = sum(state.number for state in states)
    listener(Progress("evolving", done, total, {}))

    def heard(number: int, state) -> None:
        nonlocal done
        if checkpoint is not None:
            checkpoint.save(number, state)
        done += 1
        facts = {
            "level": searched[number].name,
            "best": float(state.record.best[-1]),
            "failed": int(state.record.failed[-1]),
            "within bounds": int(state.record.within[-1]),
        }
        listener(Progress("evolving", done, total, facts))

    found = evolve_through(searched, problem, configs, seed=config.seed, states=states, on_generation=heard)
    if checkpoint is not None:
        last = found[-1].last
        save_arrays(checkpoint.folder / "population.npz", genes=last.genes, fitness=last.fitness)
    return found


def _allowed(
    problem: SearchProblem,
    bounds: ActuatorBounds,
    levels: tuple[FidelityLevel, ...],
    start: tuple[Promoted, np.ndarray],
    polished: Polished,
) -> Polished:
    """The polished gait, or the one before where that alone keeps the bounds, or is on an orbit that attracts."""
    promoted, first = start
    genes, before, but = polished.genes[None], promoted.multipliers, ""
    if promoted.within_bounds and excess_at(levels[1], genes, problem, bounds)[0] > 0:
        but = "it is beyond a bound on actuators"
    elif before is not None and before[0] < 1:
        after = multipliers_of(problem, genes, 2 * levels[-1].dt)
        if after is not None and after[0] >= 1:
            but = f"its orbit multiplies a disturbance in one cycle by {after[0]:.2g}, not {before[0]:.2g}"
    if not but:
        return polished
    reason = f"{polished.reason}; but {but}: the gait is kept as it was"
    return polished._replace(genes=first, improved=False, reason=reason)


def _polish(
    problem: SearchProblem,
    levels: tuple[FidelityLevel, ...],
    genes: np.ndarray,
    config: SearchConfig,
    listener: Listener,
) -> Polished:
    """The gradient stage, on the last level on which gaits evolved."""
    own, done = search_levels(levels)[-1], 0
    listener(Progress("polishing", 0, None, {}))

    def heard(step) -> None:
        nonlocal done
        done += 1
        listener(Progress("polishing", done, None, {"fitness": step.fitness}))

    return polish(
        problem._replace(scene=own.scene),
        genes,
        PolishConfig(config.polish_rollouts, config.polish, final_robots=FINAL_ROBOTS),
        options=own.options,
        final_options=own.options,
        seed=config.seed,
        on_step=heard,
    )

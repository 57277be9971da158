"""The complete search for a gait: evolve, compare the best on both contact models, polish by gradients, verify."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

from jaxgrity.core.display import of_report
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.io.files import save_arrays
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.populations.population import one_gait
from jaxgrity.search.checkpoint import Checkpoint, fingerprint, open_checkpoint
from jaxgrity.search.fidelity import (
    FidelityLevels,
    Verdict,
    evolve_through,
    fidelity_levels,
    final_verdict,
    search_levels,
)
from jaxgrity.search.genetic_algorithm import Evolution, GAConfig
from jaxgrity.search.kept_stages import check_kept_stages, load_polished, load_promoted, save_polished, save_promoted
from jaxgrity.search.objectives import ActuatorBounds
from jaxgrity.search.polish import Polished, polish
from jaxgrity.search.polish_kept import kept_or_undone
from jaxgrity.search.problem import SearchProblem
from jaxgrity.search.promotion import Promoted, promote
from jaxgrity.search.search_config import SearchConfig, ga_configs, plain_config, search_problem
from jaxgrity.search.search_space import genome_to_polish, with_actuated, without_idle
from jaxgrity.stepping.methods import default_method
from jaxgrity.stepping.options import resolve
from jaxgrity.stepping.step_limits import default_step

UNSEEN = 10**6
"""Number added to the seed for the final evaluation, so that its draws did not choose any gait."""
BRED = "crossover", "mutation_rate", "mutation_size"
"""Settings of the genetic algorithm that no config gives: a search that is resumed has to breed as it began."""
KEPT_RESULT = {"result": "as saved"}
"""Fact about a stage that is not repeated, since the folder holds its result."""
Stage = Literal["evolving", "promoting", "polishing", "verifying"]


class Progress(NamedTuple):
    """Progress of a search."""

    stage: Stage
    done: int
    """number of finished generations, comparisons of promotion, steps of polish or evaluations"""
    total: int | None
    """their total number; None: not known"""
    facts: dict[str, Any]
    """current facts about the search, by name"""


class SearchResult(NamedTuple):
    """Result of a search."""

    scene: Scene
    """the scene with the found gait"""
    gait: Gait
    problem: SearchProblem
    levels: FidelityLevels
    searches: tuple[Evolution, ...]
    """the evolution on each level where gaits evolve (`search_levels`)"""
    promoted: Promoted
    polished: Polished | None
    verdict: Verdict
    seconds: dict[Stage, float]
    """wall time of each stage, with compilation, s; of a search that was resumed, the time since then"""

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
    """Search for a gait that rolls on perturbed robots too, polish it by estimated gradients, and verify it.

    Thousands of rough rollouts screen gaits, and the scene's own model improves them. The best are compared on both
    contact models, gradients polish them, and some hundred fine rollouts evaluate the result. If you give a folder,
    every generation is saved, and so are the promoted and the polished gaits. You can resume an interrupted search to
    the same result. The verdict is then made again.

    Args:
        scene: a scene with a gait. What the search does not vary stays as in this gait.
        config: settings of the search: duration, population, what varies, how gaits are evaluated, and so on.
        folder: folder for the states of the search and its last population; by default nothing is saved.
        resume: whether to continue the search in the folder; scene and config must be the same.
        restart: whether to start again if the folder holds an unfinished search.
        on_progress: called at the beginning of each stage, and after every generation, comparison, step and evaluation.
        report: called with the result before the search counts as finished, for example to write files.

    Returns:
        The gait, and everything known about it.

    Raises:
        InputError: a scene without a gait; a config that cannot work; JAX's x64 mode is off, without which nothing can
            be verified; a folder that is in use, cannot be written to, or holds another search. If possible, it is
            raised before anything compiles.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> evaluation = jaxgrity.search.EvaluationConfig(robots=2)
        >>> config = jaxgrity.SearchConfig(1.5, population=8, generations=(1, 1), evaluation=evaluation, polish=None)
        >>> result = jaxgrity.search_gaits(scene, config)
        >>> result.gait.phase.shape, bool(result.verdict.verified.error_bar[0] < 0.1)
        ((6,), True)
    """
    with _begun(scene, config or SearchConfig(), on_progress, folder, resume, restart) as search:
        evolutions = search.timed("evolving", _evolve)
        promoted = search.timed("promoting", _promote, evolutions[-1])
        polished = search.timed("polishing", _polish, promoted)
        gait = _best(search, promoted, polished)
        verdict = search.timed("verifying", _verify, gait)
        scene, found = with_gait(search.problem.scene, gait), (evolutions, promoted, polished, verdict)
        result = SearchResult(scene, gait, search.problem, search.levels, *found, search.seconds)
        if report is not None:
            report(result)
        if search.checkpoint is not None:
            search.checkpoint.done()
    return result


@dataclass(frozen=True)
class _Search:
    """A running search, as its stages need it."""

    problem: SearchProblem
    levels: FidelityLevels
    config: SearchConfig
    breeding: tuple[GAConfig, ...]
    """settings of the genetic algorithm on each of the `search_levels`"""
    checkpoint: Checkpoint | None
    tell: Listener
    seconds: dict[Stage, float]

    @property
    def bounds(self) -> ActuatorBounds:
        """Bounds on the actuators."""
        return self.problem.fitness.bounds

    @property
    def folder(self) -> Path | None:
        """The folder of the search, if any."""
        return None if self.checkpoint is None else self.checkpoint.folder

    def timed(self, stage: Stage, run: Callable, *given: Any) -> Any:
        """The result of a stage, whose wall time is recorded."""
        began = time.perf_counter()
        found = run(self, *given)
        self.seconds[stage] = time.perf_counter() - began
        return found


@contextmanager
def _begun(
    scene: Scene,
    config: SearchConfig,
    listener: Listener | None,
    folder: Path | str | None,
    resume: bool,
    restart: bool,
) -> Iterator[_Search]:
    """Prepare a search, and lock its folder. Refuses settings that a later stage could not use."""
    if (resume or restart) and folder is None:
        raise InputError("resume, restart: there is no folder to find a search in; expected folder")
    if resume and restart:
        raise InputError("resume, restart: one continues a search, the other removes it; expected one of them")
    scene = with_actuated(scene, config.space)
    problem = search_problem(scene, config)
    levels = fidelity_levels(scene, config.dt, config.evaluation.both_models, force_bounds=not config.wide)
    for level in levels:  # refuses what cannot be rolled out, as without x64 for verification
        resolve(level.scene, config.duration, level.options)
    breeding = ga_configs(config, len(search_levels(levels)))
    with ExitStack() as held:
        checkpoint = None
        if folder is not None:
            bred = {name: [getattr(each, name) for each in breeding] for name in BRED}
            settings = {**plain_config(config), **bred, "fingerprint of the scene": fingerprint(scene)}
            checkpoint = held.enter_context(open_checkpoint(Path(folder), settings, resume, restart))
            check_kept_stages(checkpoint.folder)
        yield _Search(problem, levels, config, breeding, checkpoint, listener or (lambda progress: None), {})


def _evolve(search: _Search) -> tuple[Evolution, ...]:
    """The genetic search in float32, on every core, on each of the levels where gaits are searched."""
    checkpoint, levels = search.checkpoint, search_levels(search.levels)
    configs, states = search.breeding, () if checkpoint is None else checkpoint.states
    total, done = sum(each.generations for each in configs), sum(state.number for state in states)
    search.tell(Progress("evolving", done, total, {}))

    def save_and_tell(number: int, state) -> None:
        nonlocal done
        if checkpoint is not None:
            checkpoint.save(number, state)
        done += 1
        record, bounds = state.record, levels[number].counted(search.problem).fitness.bounds.words
        within = {f"within {bounds}": int(record.within[-1])} if bounds else {}
        facts = {"level": levels[number].name, "best": float(record.best[-1]), "failed": int(record.failed[-1])}
        search.tell(Progress("evolving", done, total, facts | within))

    seed = search.config.seed
    gait = search.problem.scene.gait if search.config.from_gait else None
    parent = None if gait is None else search.problem.genome.genes_of(gait)
    found = evolve_through(
        levels, search.problem, configs, seed=seed, parent=parent, states=states, on_generation=save_and_tell
    )
    if checkpoint is not None:
        last = found[-1].last
        save_arrays(checkpoint.folder / "population.npz", genes=last.genes, fitness=last.fitness)
    return tuple(found)


def _promote(search: _Search, last: Evolution) -> Promoted:
    """The best gaits of the last evolution, on both contact models and by more robots."""

    def tell(done: int, total: int, facts: dict[str, str]) -> None:
        search.tell(Progress("promoting", done, total, facts))

    found = None if search.folder is None else load_promoted(search.folder, search.levels.compared)
    if found is not None:
        tell(1, 1, KEPT_RESULT)
        return found
    found = promote(search.problem.without_force_bounds, search.bounds, search.levels, last, search.config, tell)
    if search.folder is not None:
        save_promoted(search.folder, found)
    return found


def _polish(search: _Search, promoted: Promoted) -> Polished | None:
    """The gradient stage, on the scene's own model at a rough step; start and end are compared at its own step."""
    config, levels, done = search.config, search.levels, 0
    if config.polish is None:
        return None
    genome, starts = genome_to_polish(search.problem, promoted.genes, config.polish)
    found = None if search.folder is None else load_polished(search.folder, genome)
    if found is not None:
        search.tell(Progress("polishing", len(found.steps), len(found.steps), KEPT_RESULT))
        return found
    search.tell(Progress("polishing", 0, None, {}))

    def tell_step(step) -> None:
        nonlocal done
        done += 1
        search.tell(Progress("polishing", done, None, {"fitness": step.fitness}))

    problem = search.problem._replace(genome=genome)
    found = polish(
        problem.without_force_bounds,
        starts,
        config.polish,
        options=levels.rough_own.options,
        final_options=levels.own.options,
        seed=config.seed,
        on_step=tell_step,
    )
    found = kept_or_undone(problem, levels, promoted, starts[0], found, config.polish, config.seed)
    if search.folder is not None:
        save_polished(search.folder, found)
    return found


def _best(search: _Search, promoted: Promoted, polished: Polished | None) -> Gait:
    """The polished gait if polishing improved it, otherwise the best promoted gait."""
    genome, genes = search.problem.genome, promoted.genes[0]
    if polished is not None and polished.improved:
        genome, genes = polished.genome, polished.genes
    gait = one_gait(genome.gaits(search.problem.scene.gait, genes[None]), 0)
    return gait if search.config.space.active is None else without_idle(gait)


def _verify(search: _Search, gait: Gait) -> Verdict:
    """Evaluate the gait by fine rollouts, with draws that did not choose it."""

    def tell_part(done: int, total: int) -> None:
        search.tell(Progress("verifying", done, total, {}))

    problem, seed = search.problem.without_force_bounds, search.config.seed + UNSEEN
    found = with_gait(problem.scene, gait)
    # a stronger gait than the scene's own may need a smaller step
    step = min(2 * search.levels.verification.dt, default_step(found, default_method(found)))
    return final_verdict(problem, gait, own_step=step, bounds=search.bounds, seed=seed, on_progress=tell_part)

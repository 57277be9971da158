"""Tasks of minutes, with progress and a stop: the search for a gait, and its polishing by gradients."""

import threading
from collections.abc import Callable

import numpy as np

from jaxgrity.core.display import significant
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene
from jaxgrity.populations.population import one_gait
from jaxgrity.populations.uncertainty import Uncertainty
from jaxgrity.search.climb import ClimbStep
from jaxgrity.search.genetic_algorithm import EvolutionState, GAConfig, evolve
from jaxgrity.search.genome import Genome
from jaxgrity.search.judging import Fitness
from jaxgrity.search.polish import polish
from jaxgrity.search.polish_config import PolishConfig
from jaxgrity.search.problem import SearchProblem
from jaxgrity.stepping.options import SolverOptions

SEARCH = GAConfig(population=64, generations=16, elites=4)
"""The explorer's search: small, so that it ends while somebody waits."""
POLISH = PolishConfig(rollouts=1024, robots=4, final_robots=64)
"""The explorer's polish: a third of a search's own budget, for the same reason."""
FITNESS = Fitness(uncertainty=Uncertainty(phase=0.03), robots=2)
"""Mean distance of robots whose phases are a little off, so that what is found does not depend on the last digit."""

Tell = Callable[[str], object]
"""Function that hears in words how far a task is."""


class StoppedError(Exception):
    """A task was stopped early."""


def search_gait(scene: Scene, duration: float, tell: Tell) -> Gait:
    """The scene's gait with phases from a genetic algorithm; `tell` may raise to end it."""
    problem = _problem(scene, duration)
    tell(f"searching: compiling for {SEARCH.population} gaits at once …")

    def after_generation(state: EvolutionState) -> None:
        tell(f"searching: generation {state.number} of {SEARCH.generations}, best {_metres(state.record.best[-1])}")

    found = evolve(problem, SEARCH, options=SolverOptions(dtype="float32"), on_generation=after_generation)
    tell(f"searched {found.rollouts} rollouts: the best goes {_metres(found.best[-1])} in the mean over its robots")
    return _gait(problem, found.last.genes[0])


def polish_gait(scene: Scene, duration: float, tell: Tell) -> Gait:
    """The scene's gait with phases improved by smoothed gradients, if verified; `tell` may raise to end it."""
    problem = _problem(scene, duration)
    assert scene.gait is not None, "the explorer's scenes have a gait"
    turns = np.mod(np.asarray(scene.gait.phase, float) / (2 * np.pi), 1.0)
    tell("polishing: compiling …")
    steps: list[ClimbStep] = []

    def after_step(step: ClimbStep) -> None:
        steps.append(step)
        tell(f"polishing: step {len(steps)}, {_metres(step.fitness)}")

    found = polish(problem, turns[None], POLISH, on_step=after_step)
    tell(f"polished: {found.reason}")
    return _gait(problem, found.genes) if found.improved else scene.gait


def _metres(distance: float) -> str:
    """With at least two digits, for small robots too."""
    return f"{significant(float(distance), 2, 2)} m"


def _problem(scene: Scene, duration: float) -> SearchProblem:
    """A search over phases with fixed amplitudes and frequency. Raises `InputError` where the gait barely begins."""
    assert scene.gait is not None, "the explorer's scenes have a gait"
    if duration <= float(scene.gait.start):
        raise InputError(
            f"the gait begins after {float(scene.gait.start):g} s of {duration:g} s; expected a longer motion"
        )
    return SearchProblem(scene, Genome(len(scene.gait.members)), duration, FITNESS)


def _gait(problem: SearchProblem, genes: AnyArray) -> Gait:
    assert problem.scene.gait is not None, "the explorer's scenes have a gait"
    return one_gait(problem.genome.gaits(problem.scene.gait, np.asarray(genes, float)[None]), 0)


class Runner:
    """Runs one task at a time, beside the sliders."""

    def __init__(self, tell: Tell):
        self._tell, self._stop = tell, threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def busy(self) -> bool:
        """Whether a task is running."""
        return self._thread is not None and self._thread.is_alive()

    def start(self, task: Callable[[Tell], None]) -> None:
        """Start a task, unless one is running; `stop` reaches it at its next report of progress."""
        if self.busy:
            return
        self._stop.clear()
        self._thread = threading.Thread(target=self._run, args=(task,), daemon=True)
        self._thread.start()

    def stop(self, wait: bool = False) -> None:
        """Ask the task to end."""
        self._stop.set()
        if wait and self._thread is not None:
            self._thread.join()

    def _run(self, task: Callable[[Tell], None]) -> None:
        try:
            task(self._hear)
        except StoppedError:
            self._tell("stopped")
        except InputError as error:
            self._tell(f"**not possible**: {error}")

    def _hear(self, words: str) -> None:
        if self._stop.is_set():
            raise StoppedError
        self._tell(words)

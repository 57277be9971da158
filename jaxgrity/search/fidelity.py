"""From thousands of rough rollouts to a few fine ones: the levels of a search, and the verification of the best."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np
import scipy
from jaxtyping import Float

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray
from jaxgrity.model.actuation import Gait
from jaxgrity.model.contact_twin import contact_twin, exact_twin, is_exact
from jaxgrity.model.scene import Scene
from jaxgrity.populations.population import as_population
from jaxgrity.search.genetic_algorithm import Evolution, EvolutionState, GAConfig, begin, evolve_by
from jaxgrity.search.genome import Genes
from jaxgrity.search.judging import (
    ROBOTS_PER_ROUND,
    Fitness,
    Judging,
    Scores,
    judge,
    judge_until,
    over_robots,
    standard_error,
    with_robots,
)
from jaxgrity.search.models import model_of, rough_step
from jaxgrity.search.objectives import ActuatorBounds
from jaxgrity.search.problem import SearchProblem
from jaxgrity.stepping.methods import default_method
from jaxgrity.stepping.options import SolverOptions
from jaxgrity.stepping.step_limits import default_step
from jaxgrity.trust.error_bars import Verified, verify

FEWEST_RANKED = 5
"""Fewest gaits for which a rank correlation is computed: two always rank alike or opposite."""
PRECISION = 0.01
"""Step error and standard error that a gait's final verdict aims at, as shares of its fitness."""


class FidelityLevel(NamedTuple):
    """One way to roll out gaits in a search: a scene, a step and a precision."""

    name: str
    scene: Scene
    dt: float
    """step, s"""
    dtype: str
    twin: Scene | None = None
    """its contact twin, where gaits are tried on both contact models"""
    force_bounds: bool = True
    """whether bounds on forces and powers count there: they cost much to measure"""

    @property
    def options(self) -> SolverOptions:
        """Its step and its precision."""
        return SolverOptions(dt=self.dt, dtype=self.dtype)

    def counted(self, problem: SearchProblem) -> SearchProblem:
        """The problem with those of its bounds that count there."""
        return problem if self.force_bounds else problem.without_force_bounds

    def judging(self, problem: SearchProblem) -> Judging:
        """The judging of a problem's gaits on it: on its model, and its twin's, if any, by the bounds that count there.

        The twin has a rough step. Raises `InputError` as `resolve` does.
        """
        duration = problem.duration
        models = [model_of(self.scene, duration, self.options)]
        if self.twin is not None:
            models.append(model_of(self.twin, duration, SolverOptions(dt=rough_step(self.twin), dtype=self.dtype)))
        return Judging(tuple(models), duration, self.counted(problem).fitness)


class FidelityLevels(NamedTuple):
    """The levels of a search, from rough to fine."""

    screening: FidelityLevel
    own: FidelityLevel
    decisive: FidelityLevel
    """that of both models, if there is one, else that of verification"""
    verification: FidelityLevel

    @property
    def compared(self) -> tuple[FidelityLevel, ...]:
        """Those on which the best gaits are compared; the last one decides."""
        return self.screening, self.own, self.decisive

    @property
    def rough_own(self) -> FidelityLevel:
        """The roughest level of the scene's own model."""
        return self.screening if self.screening.scene is self.own.scene else self.own


@typed
def fidelity_levels(
    scene: Scene, dt: float | None = None, both: bool = False, force_bounds: bool = True
) -> FidelityLevels:
    """The levels from rough to fine; `dt` (s) is by default the scene's own step.

    | level | model | step | precision | what it is for |
    |---|---|---|---|---|
    | screening | exact: the scene, or its contact twin | `SCREENING_STEP` | float32 | evolution |
    | own model | the scene | its own; on penalty ground twice that, if stable | float32 | evolution, polish |
    | both models | the scene and its contact twin, if `both` | as above | float32 | the choice of finalists |
    | verification | the scene | half of its own | float64 | the choice, without `both`; step of the verdict |

    The verdict begins at twice the step of verification, and its ensembles are in float32 (`final_verdict`).
    Without `force_bounds`, bounds on forces and powers are left to the levels after screening.

    Raises `InputError` where the scene or its contact twin cannot be rolled out.
    """
    step = default_step(scene, default_method(scene)) if dt is None else dt
    exact = scene if is_exact(scene) else exact_twin(scene)
    own_step = step if is_exact(scene) else rough_step(scene, step)
    screening = FidelityLevel("screening", exact, rough_step(exact), "float32", force_bounds=force_bounds)
    own = FidelityLevel("own model", scene, own_step, "float32")
    verification = FidelityLevel("verification", scene, step / 2, "float64")
    if not both:
        return FidelityLevels(screening, own, verification, verification)
    decisive = FidelityLevel("both models", scene, own_step, "float32", contact_twin(scene))
    return FidelityLevels(screening, own, decisive, verification)


@typed
def search_levels(levels: FidelityLevels) -> tuple[FidelityLevel, ...]:
    """The levels of evolution: screening and the own model, or screening alone if it is the own model.

    The levels differ if screening is of the contact twin, or has no bounds on forces, as in every wide search.
    """
    alike = levels.rough_own is levels.screening and levels.screening.force_bounds
    return (levels.screening,) if alike else (levels.screening, levels.own)


@typed
def evolve_through(
    levels: tuple[FidelityLevel, ...],
    problem: SearchProblem,
    configs: tuple[GAConfig, ...],
    *,
    seed: int = 0,
    parent: Genes | None = None,
    states: tuple[EvolutionState, ...] = (),
    on_generation: Callable[[int, EvolutionState], None] | None = None,
) -> list[Evolution]:
    """Evolve on the scene of each level in turn, without its contact twin, and carry the best over to the next.

    Returns the evolution on each. The first begins with a `parent` and its mutations, if given. With `states`
    interrupted ones continue. `on_generation` is called with an
    evolution's number and its state. Raises `InputError` for a population larger than the one before.
    """
    sizes = [config.population for config in configs]
    if sizes != sorted(sizes, reverse=True):
        raise InputError(f"populations of {sizes} gaits: expected none larger than the one before it")
    found: list[Evolution] = []
    for number, (level, config) in enumerate(zip(levels, configs)):
        begun = begin(problem.genome, config, seed + number, level.dtype, None if number else parent)
        state = states[number] if number < len(states) else begun
        if found and number >= len(states):
            state = state._replace(genes=found[-1].last.genes[: config.population])
        told = None if on_generation is None else lambda state, n=number: on_generation(n, state)
        found.append(evolve_by(level._replace(twin=None).judging(problem), problem.genome, config, state, told))
    return found


@typed
def judge_at(level: FidelityLevel, gaits: Gait, problem: SearchProblem, seed: int) -> Scores:
    """`judge` on a fidelity level."""
    return judge(jax.random.key(seed), level.judging(problem), gaits)


def excess_at(level: FidelityLevel, genes: Genes, problem: SearchProblem, bounds: ActuatorBounds) -> np.ndarray:
    """(gaits,), `ActuatorBounds.excess` on a robot that is as the level's own model says; infinite where it failed."""
    fitness, gaits = Fitness(problem.fitness.objective, bounds=bounds), problem.genome.gaits(problem.scene.gait, genes)
    found = judge(jax.random.key(0), problem.judging(level.options, scene=level.scene, fitness=fitness), gaits)
    return np.where(found.failed, np.inf, found.excess[:, 0])


def rank_correlation(rows: Float[AnyArray, "levels gaits"]) -> np.ndarray:
    """Spearman's correlation of every two fidelity levels, over the gaits that succeed on all.

    NaN for fewer than `FEWEST_RANKED`, and for a level on which all are worth the same.
    """
    rows = np.asarray(rows)[:, np.isfinite(rows).all(0)]
    ranked = [rows.shape[1] >= FEWEST_RANKED and np.ptp(row) > 0 for row in rows]
    each = list(zip(rows, ranked))
    return np.array([[scipy.stats.spearmanr(a, b).statistic if m and n else np.nan for b, n in each] for a, m in each])


class Verdict(NamedTuple):
    """The final verdict on one gait."""

    verified: Verified
    """of the gait itself"""
    robust: Scores
    """scores of an ensemble, one row. In float32: rounding is far below the standard error"""
    robust_step: float
    """s, at which they are"""
    step_error: float
    """of the mean of the first `ROBOTS_PER_ROUND` robots, between the step of verification and twice that step"""
    other_model: Scores
    """on the scene's contact twin"""
    beyond: float
    """share of robots that exceed a bound on their actuators: of those of `robust`, or of `ROBOTS_PER_ROUND` robots
    where forces or powers have bounds"""

    def summary(self) -> dict[str, Any]:
        """The numbers for a JSON file; SI units. Robots that failed are counted, and in no other number."""
        robust, other = self.robust.each[0], self.other_model.each[0]
        known = robust[np.isfinite(robust)]
        return {
            "distance": float(self.verified.distance[0]),
            "error_bar": float(self.verified.error_bar[0]),
            "steps": self.verified.steps,
            "robust": {
                **over_robots(robust),
                "tenth_percentile": float(np.quantile(known, 0.1)) if known.size else np.nan,
                "step": self.robust_step,
                "step_error": self.step_error,
            },
            "other_contact_model": over_robots(other),
            "beyond_bounds": self.beyond,
        }


@typed
def final_verdict(
    problem: SearchProblem,
    gait: Gait,
    *,
    own_step: float,
    bounds: ActuatorBounds,
    robots: int = 256,
    seed: int = 1,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Verdict:
    """Evaluate one gait: its error bar, an ensemble of perturbed robots, and `ROBOTS_PER_ROUND` robots on the contact
    twin.

    The ensemble is simulated with the step `own_step` (s), or with half of it if this changes the mean by more than
    `PRECISION`. The step of the nominal robot is chosen in the same way, by its error bar. `ROBOTS_PER_ROUND` robots at
    a time are added to the ensemble, until the standard error of their mean is within `PRECISION`, or there are
    `robots`.

    Robots beyond `bounds` are counted; the problem need not have these bounds. `on_progress` is called with the number
    of finished evaluations, and their total.
    """
    scene, gaits = problem.scene, as_population(gait)
    some = with_robots(problem.fitness, min(robots, ROBOTS_PER_ROUND))

    def verified_at(step: float) -> Verified:
        return verify(scene, gaits, problem.duration, options=SolverOptions(dt=step))

    def judged(step: float, number: int = 0, within: ActuatorBounds = problem.fitness.bounds) -> Scores:
        options = SolverOptions(dt=step, dtype="float32")
        judging = problem.judging(options, fitness=replace(some, bounds=within))
        return judge(jax.random.key(seed + number), judging, gaits)

    on_progress(0, 4)
    with ThreadPoolExecutor() as beside:  # one robot rolls on one core
        verifying = beside.submit(verified_at, own_step)
        fine, coarse = judged(own_step / 2), judged(own_step)
        step_error = abs(float(fine.mean[0] - coarse.mean[0]))
        fine_enough = step_error <= PRECISION * abs(float(fine.mean[0]))
        step, first = (own_step, coarse) if fine_enough else (own_step / 2, fine)
        on_progress(1, 4)
        robust = judge_until(
            lambda number: judged(step, number) if number else first,
            with_robots(problem.fitness, robots).rollouts,
            problem.fitness.caution,
            lambda each: standard_error(each[0]) <= PRECISION * abs(float(each.mean())),
        )
        on_progress(2, 4)
        other = contact_twin(scene)
        usual = SolverOptions(dt=default_step(other, default_method(other)), dtype="float32")
        seen = judge(jax.random.key(seed), problem.judging(usual, scene=other, fitness=some), gaits)
        on_progress(3, 4)
        beyond = judged(step, within=bounds).beyond if bounds.needs_metrics else robust.beyond
        verified = verifying.result()
    if not verified.error_bar[0] <= PRECISION * verified.distance[0]:
        verified = verified_at(own_step / 2)
    on_progress(4, 4)
    return Verdict(verified, robust, step, step_error, seen, float(beyond[0]))

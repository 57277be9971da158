"""From thousands of rough rollouts to a few exact ones: where gaits are searched, and how the best are verified."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.stats import spearmanr

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray
from jaxgrity.model.actuation import Gait
from jaxgrity.model.contact_twin import contact_twin, exact_twin
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.rollout.population import as_population
from jaxgrity.search.genetic_algorithm import Evolution, GAConfig, SearchProblem, SearchState, begin, evolve
from jaxgrity.search.objectives import ROUND, Scores, judge, judge_until, standard_error, with_robots
from jaxgrity.stepping.options import SolverOptions, resolve
from jaxgrity.stepping.stability import default_method, default_step, strictest
from jaxgrity.trust.error_bars import Verified, verify

SCREENING_STEP = 0.01
"""s, of complementarity stepping: gaits rank at it as they do at half of it"""
PRECISION = 0.01
"""share of a gait's worth to which the last judgement tells it"""


class FidelityLevel(NamedTuple):
    """One way to roll a gait out."""

    name: str
    scene: Scene
    dt: float
    """s"""
    dtype: str

    @property
    def options(self) -> SolverOptions:
        """Its step and its precision."""
        return SolverOptions(dt=self.dt, dtype=self.dtype)


def fidelity_levels(scene: Scene, dt: float | None = None) -> tuple[FidelityLevel, ...]:
    """From rough to exact; `dt` (s) is the scene's own step where not given.

    Screening is complementarity stepping at `SCREENING_STEP` in float32: of the scene itself where it is exact, else of
    its contact twin. Then come the scene's own model in float32 (a penalty scene's at twice its step, where that is
    stable), and in float64 at half its step.

    Raises `InputError` where the scene or its contact twin cannot be rolled out.
    """
    step = default_step(scene, default_method(scene)) if dt is None else dt
    exact = scene if scene.constrained else exact_twin(scene)
    coarse = default_step(exact, default_method(exact))
    screening = FidelityLevel("screening", exact, _stable(SCREENING_STEP, coarse, exact), "float32")
    own_step = step if scene.constrained else _stable(2 * step, step, scene)
    own = FidelityLevel("own model", scene, own_step, "float32")
    return screening, own, FidelityLevel("verification", scene, step / 2, "float64")


def _stable(dt: float, otherwise: float, scene: Scene) -> float:
    """`dt`, s, where the scene is stable at it."""
    return dt if dt <= strictest(scene, default_method(scene))[0] else otherwise


def search_levels(levels: tuple[FidelityLevel, ...]) -> tuple[FidelityLevel, ...]:
    """The levels on which gaits evolve: screening, and the own model where screening was on another."""
    return levels[:1] if levels[0].scene is levels[1].scene else levels[:2]


def evolve_through(
    levels: tuple[FidelityLevel, ...],
    problem: SearchProblem,
    configs: tuple[GAConfig, ...],
    *,
    seed: int = 0,
    states: tuple[SearchState, ...] = (),
    on_generation: Callable[[int, SearchState], None] | None = None,
) -> list[Evolution]:
    """Evolve on each of the levels in turn, the population of one going on to the next; the searches, one each.

    With `states`, as far as the searches got before, they go on from there. `on_generation` gets a search's number and
    its state. Raises `InputError` where populations differ in size.
    """
    sizes = {config.population for config in configs}
    if len(sizes) > 1:
        raise InputError(f"populations of {sorted(sizes)} gaits: expected one size on all levels")
    found: list[Evolution] = []
    for number, (level, config) in enumerate(zip(levels, configs)):
        state = states[number] if number < len(states) else begin(problem.genome, config, seed + number, level.dtype)
        if found and number >= len(states):
            state = state._replace(genes=found[-1].last.genes)
        told = None if on_generation is None else lambda state, n=number: on_generation(n, state)
        here = problem._replace(scene=level.scene)
        found.append(evolve(here, config, options=level.options, state=state, on_generation=told))
    return found


def judge_at(level: FidelityLevel, gaits: Gait, problem: SearchProblem, seed: int) -> Scores:
    """`judge` on a fidelity level, by the problem's duration and fitness, as NumPy arrays."""
    resolved = resolve(level.scene, problem.duration, level.options)
    gaits = jax.tree.map(lambda x: np.asarray(x, level.dtype), gaits)
    key, end, scene = jax.random.key(seed), np.asarray(problem.duration, float), as_dtype(level.scene, level.dtype)
    return jax.tree.map(np.asarray, judge(key, scene, gaits, end, resolved.as_inputs(), problem.fitness))


def rank_correlation(rows: Float[AnyArray, "levels gaits"]) -> np.ndarray:
    """Spearman's, of every two fidelity levels, over the gaits that all of them could roll out."""
    rows = np.asarray(rows)[:, np.isfinite(rows).all(0)]
    return np.array([[spearmanr(a, b).statistic for b in rows] for a in rows])


class Verdict(NamedTuple):
    """What one gait is worth, in the end."""

    verified: Verified
    """of the gait itself"""
    robust: Scores
    """over an ensemble in float64, one row"""
    robust_step: float
    """s, at which they are"""
    step_error: float
    """of the mean of the first `ROUND` robots, at the step of verification and at twice that step, with equal draws"""
    other_model: Scores
    """on the scene's contact twin"""

    def summary(self) -> dict[str, Any]:
        """The numbers, as they go into a JSON file; SI units."""
        robust, other = self.robust.each[0], self.other_model.each[0]
        return {
            "distance": float(self.verified.distance[0]),
            "error_bar": float(self.verified.error_bar[0]),
            "steps": self.verified.steps,
            "robust": {
                "mean": float(robust.mean()),
                "standard_deviation": float(robust.std()),
                "standard_error": standard_error(robust) if robust.size > 1 else None,
                "tenth_percentile": float(np.quantile(robust, 0.1)),
                "robots": robust.size,
                "step": self.robust_step,
                "step_error": self.step_error,
            },
            "other_contact_model": {"mean": float(other.mean()), "standard_deviation": float(other.std())},
        }


def final_verdict(
    problem: SearchProblem,
    gait: Gait,
    *,
    dt: float,
    robots: int = 256,
    seed: int = 1,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Verdict:
    """Verify one gait, judge it by an ensemble, and roll it out on the contact twin, as closely as `PRECISION` asks.

    The step is 2 `dt` (s) where its error is within `PRECISION`, else `dt`. Robots are added by `ROUND` until the
    standard error of their mean is within it, or there are `robots`. `on_progress` gets how many of these judgements
    are done, and how many there are.
    """
    scene, gaits = problem.scene, as_population(gait)
    on_progress(0, 4)
    verified = verify(scene, gaits, problem.duration, options=SolverOptions(dt=2 * dt))
    if not verified.error_bar[0] <= PRECISION * verified.distance[0]:
        verified = verify(scene, gaits, problem.duration, options=SolverOptions(dt=dt))
    on_progress(1, 4)
    some = problem._replace(fitness=with_robots(problem.fitness, min(robots, ROUND)))

    def judged(step: float, number: int = 0) -> Scores:
        return judge_at(FidelityLevel("", scene, step, "float64"), gaits, some, seed + number)

    fine, coarse = judged(dt), judged(2 * dt)
    step_error = abs(float(fine.mean[0] - coarse.mean[0]))
    step, first = (2 * dt, coarse) if step_error <= PRECISION * abs(float(fine.mean[0])) else (dt, fine)
    on_progress(2, 4)
    robust = judge_until(
        lambda number: judged(step, number) if number else first,
        with_robots(problem.fitness, robots).rollouts,
        problem.fitness.caution,
        lambda each: standard_error(each[0]) <= PRECISION * abs(float(each.mean())),
    )
    on_progress(3, 4)
    other = contact_twin(scene)
    level = FidelityLevel("", other, default_step(other, default_method(other)), "float32")
    seen = judge_at(level, gaits, some, seed)
    on_progress(4, 4)
    return Verdict(verified, robust, step, step_error, seen)

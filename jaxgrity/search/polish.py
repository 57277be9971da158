"""Polish: improve gaits by gradients.

There are three gradients, and a combination of the first two. The pathwise gradient differentiates the rollouts: it is
exact, but useless if they are too sensitive. The smoothed gradient (evolution strategies) is a regression on the ranks
of perturbed gaits: it is noisy, but works on any horizon. The orbit's gradient is that of the nominal robot's steady
speed (`polish_orbit`).

Each climb gets the same share of the rollouts. Each step is a gradient that optax turns into an update (momentum, with
a step length that falls by a cosine). Smoothed gradients are those of the fitness. Bounds on forces and powers, if
the problem has any, count only when ends are compared (a search leaves them to `kept_or_undone`). Pathwise
and combined gradients are those of the mean objective at a horizon: the time up to which the start's sensitivity stays
below `PolishConfig.largest_sensitivity`. The first half of the steps uses half of this horizon. If the horizon ends
before the first period of full actuation, they are not used, and a combined polish climbs by smoothed gradients.

In the end the same robots evaluate the first start and the best end, until the better one is clear, or up to
`PolishConfig.final_robots`. The better one is kept.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxgrity.core.arguments import check_each
from jaxgrity.core.display import COVERING, significant, with_error
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray
from jaxgrity.model.scene import as_dtype
from jaxgrity.search.climb import Climb, ClimbStep, OneGait, Route, Routes, climb, routes_from
from jaxgrity.search.genome import Genome
from jaxgrity.search.gradients import ClimbTask
from jaxgrity.search.judging import (
    ROBOTS_PER_ROUND,
    Judging,
    Scores,
    influences,
    judge,
    judge_until,
    standard_error,
    with_robots,
)
from jaxgrity.search.polish_config import PolishConfig, budget, check_polish, cost_of_gradient
from jaxgrity.search.polish_orbit import climb_on_orbit
from jaxgrity.search.problem import SearchProblem
from jaxgrity.stepping.options import Options, ResolvedOptions, SolverOptions, resolve
from jaxgrity.trust.sensitivity import Sensitivity

FOR_CLIMBS, FOR_COMPARISON, FOR_THE_END, FOR_A_PART = range(4)
"""Purposes of random numbers. In one polish, no draw serves two of them."""
CLEAR = 3.0
"""Difference between two gaits, in standard errors, at which the better one is clear."""
CLOSE_ENOUGH = 0.005
"""Standard error of that difference, as a fraction of the fitness, at which the comparison stops."""
KEPT, AS_IT_WAS = "the polished gait is kept", "the gait is kept as it was"
"""Outcomes of polishing, in words."""


class Polished(NamedTuple):
    """Result of polishing."""

    genes: OneGait
    """genes of the better gait: the best start or the best end"""
    genome: Genome
    """genome of these genes; it may have more overtones than that of the search"""
    improved: bool
    before: Scores
    after: Scores
    """scores of the best start and the best end, by the same ensemble"""
    steps: tuple[ClimbStep, ...]
    """steps of the climb that ended best"""
    horizon: float
    """horizon of its last gradient, s"""
    sensitivity: Sensitivity | None
    """sensitivity of the best start; None without pathwise gradients"""
    rollouts: int
    """cost of the steps, in rollouts of the whole duration, without the final comparison"""
    reason: str


@typed
def polish(
    problem: SearchProblem,
    genes: Float[AnyArray, "starts genes"],
    config: PolishConfig | None = None,
    *,
    options: Options = None,
    final_options: Options = None,
    seed: int = 0,
    on_step: Callable[[ClimbStep], None] | None = None,
) -> Polished:
    """Improve gaits by gradients, and keep the result if an ensemble finds it better.

    `Polished.reason` says what was done, with the gain and its two standard errors.

    Args:
        problem: scene, genome, duration (s) and fitness.
        genes: (starts, genes) in [0, 1), best start first.
        config: settings of polishing.
        options: solver options of the climbs, with a fixed step; by default in float32.
        final_options: solver options of the final comparison, in float64 whatever they say; by default half the step.
        seed: seed of the random number generator.
        on_step: called with each finished step.

    Returns:
        The better gait, and a record of the climbs.

    Raises:
        InputError: genes of another genome, bad settings or options (see `resolve`), a gradient that the fitness does
            not have, or too few rollouts for a step from each start.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> problem = jaxgrity.SearchProblem(scene, jaxgrity.Genome(6), 1.5, jaxgrity.Fitness())
        >>> turns = jaxgrity.random_phases(1, actuators=6, seed=0) / 6.2832
        >>> polished = jaxgrity.polish(problem, turns, jaxgrity.PolishConfig(rollouts=8, samples=4, final_robots=1))
        >>> polished.genes.shape, len(polished.steps)
        ((6,), 2)
    """
    config, genes = config or PolishConfig(), np.atleast_2d(np.asarray(genes, float))
    check_each("genes", genes, shape=(max(1, len(genes)), problem.genome.size))
    check_polish(config, problem.fitness, len(genes))
    resolved, final = options_of_stages(problem, options, final_options)
    found = routes_from(problem, genes, resolved, config)
    best, spent = Climb(genes[0], (), 0), 0
    if found.routes:
        best, spent = _climb_all(problem, resolved, config, found.routes, seed, on_step)
    before, after = before_and_after(problem, genes[0], best.end, final, config, purpose_key(seed, FOR_THE_END))
    improved = bool(after.merit[0] > before.merit[0])
    return Polished(
        genes=best.end if improved else genes[0],
        genome=problem.genome,
        improved=improved,
        before=before,
        after=after,
        steps=best.steps,
        horizon=best.steps[-1].horizon if best.steps else problem.duration,
        sensitivity=found.sensitivity,
        rollouts=spent,
        reason="; ".join(_told(found, best, before, after, problem.fitness.caution)),
    )


def options_of_stages(
    problem: SearchProblem, options: Options, final_options: Options
) -> tuple[ResolvedOptions, ResolvedOptions]:
    """Solver options of the climbs and of the final comparison."""
    given = SolverOptions() if options is None else options
    if isinstance(given, SolverOptions) and given.dtype is None:
        given = replace(given, dtype="float32")
    resolved = resolve(problem.scene, problem.duration, given)
    if resolved.dt is None:
        raise InputError(f"method = {resolved.method.name!r} adapts its step; expected a fixed one (dt) to polish with")
    half = replace(resolved, dt=float(resolved.dt) / 2)
    return resolved, resolve(problem.scene, problem.duration, final_options or half, dtype="float64")


def _told(found: Routes, best: Climb, before: Scores, after: Scores, caution: float) -> list[str]:
    """Text of `Polished.reason`."""
    done = [f"{len(best.steps)} steps", gain_words(before, after, caution)] if best.steps else []
    return [*found.remarks, *([best.remark] if best.remark else []), *done]


def gain_words(before: Scores, after: Scores, caution: float) -> str:
    """The gain in words, with two standard errors."""
    outcome = KEPT if after.merit[0] > before.merit[0] else AS_IT_WAS
    for name, scores in (("start", before), ("end", after)):
        if scores.failed[0]:
            return f"a robot failed with the {name}'s gait: {outcome}"
    gain = np.subtract(*(influences(scores.each, caution)[0] for scores in (after, before)))
    difference = float(after.fitness[0] - before.fitness[0])
    if not gain.any():
        return f"fitness unchanged: {outcome}"
    told = significant(abs(difference))
    if gain.size > 1:
        told = with_error(abs(difference), COVERING * standard_error(gain), digits=".2g") + f" over {gain.size} robots"
    way = "up" if difference > 0 else "down"
    beyond = f"; {100 * after.beyond[0]:.0f} % of them beyond a bound on actuators" if after.beyond[0] > 0 else ""
    return f"fitness {way} by {told}{beyond}: {outcome}"


def _climb_all(
    problem: SearchProblem,
    options: ResolvedOptions,
    config: PolishConfig,
    routes: list[Route],
    seed: int,
    on_step: Callable | None,
) -> tuple[Climb, int]:
    """The climb that ended best, and the cost of all climbs."""
    judging, plain = problem.judging(options), problem.without_force_bounds
    fitness, judging_climbs = plain.fitness, plain.judging(options)
    rolled = plain._replace(scene=as_dtype(problem.scene, options.dtype))
    task = ClimbTask(rolled, options, judging_climbs, np.asarray(config.width, options.dtype))
    duration = problem.duration
    costs = [cost_of_gradient(config, fitness, route.kind, route.horizon / duration) for route in routes]
    each, comparison = budget(config, fitness, costs)
    climbs = []
    for number, alike in enumerate(_side_by_side(routes)):
        key = purpose_key(seed, FOR_CLIMBS, number)
        if alike[0].kind == "orbit":
            climbs.append(climb_on_orbit(plain, options, judging_climbs, config, (alike[0].genes, each), key, on_step))
        else:
            climbs += climb(task, config, alike, each, key, on_step)
    spent = sum(done.cost for done in climbs) + comparison
    if len(routes) == 1:
        return climbs[0], spent
    ends = np.stack([done.end for done in climbs])
    key = purpose_key(seed, FOR_COMPARISON)
    scores = _judge_genes(key, problem, ends, judging.with_robots(config.comparison_robots))
    return climbs[int(np.argmax(scores.merit))], spent


def _side_by_side(routes: list[Route]) -> list[list[Route]]:
    """Groups of routes that climb together: all smoothed ones; others one by one, since their horizons differ."""
    smoothed = [route for route in routes if route.kind == "smoothed"]
    return [group for group in (smoothed, *([route] for route in routes if route.kind != "smoothed")) if group]


def before_and_after(
    problem: SearchProblem, start: OneGait, end: OneGait, options: ResolvedOptions, config: PolishConfig, key
) -> list[Scores]:
    """Scores of the best start and the best end, by the same ensemble."""
    pair = np.stack([start, end])
    judging = problem.judging(options).with_robots(min(config.final_robots, ROBOTS_PER_ROUND))

    def judged(number: int) -> Scores:
        return _judge_genes(jax.random.fold_in(key, number), problem, pair, judging)

    def clear(each: np.ndarray) -> bool:
        gain = np.subtract(*influences(each, problem.fitness.caution)[::-1])
        error = standard_error(gain)
        return bool(abs(gain.mean()) > CLEAR * error or error <= CLOSE_ENOUGH * abs(each.mean()))

    robots = with_robots(problem.fitness, config.final_robots).rollouts
    found = judge_until(judged, robots, problem.fitness.caution, clear)
    return [jax.tree.map(lambda x, k=k: x[k : k + 1], found) for k in (0, 1)]


def _judge_genes(key, problem: SearchProblem, genes, judging: Judging) -> Scores:
    """`judge` for a gait per row of genes."""
    return judge(key, judging, problem.genome.gaits(problem.scene.gait, np.asarray(genes, judging.dtype)))


def purpose_key(seed: int, *purpose: int):
    key = jax.random.key(seed)
    for number in purpose:
        key = jax.random.fold_in(key, number)
    return key

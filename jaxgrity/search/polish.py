"""Polish: better gaits by gradients, where gradients mean something.

The pathwise gradient differentiates the rollouts; it is exact, and useless where they are too sensitive. The smoothed
one (evolution strategies) is a regression on the ranks of perturbed gaits: noisy, and sound on any horizon.
"""

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Float

from jaxgrity.model.actuation import Gait
from jaxgrity.trust.error_bars import Sensitivity, sensitivity
from jaxgrity.search.genome import Genome
from jaxgrity.search.gradients import Gradient, Task, combine, pathwise_gradient, smoothed_gradient
from jaxgrity.search.objectives import Fitness, Scores, judge, with_robots
from jaxgrity.rollout.population import one_gait
from jaxgrity.model.scene import Scene, as_dtype, with_gait
from jaxgrity.stepping.simulate import Settings, as_inputs, settle
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray

Kind = Literal["smoothed", "pathwise", "combined"]
OneGait = Float[AnyArray, " genes"]
COST = 6.0
"""of a pathwise gradient, in rollouts of its horizon: experiments/gradients.py and benchmark.py measure 4 to 6"""
AVERAGED = 0.2
"""share of a climb's steps, the last, whose gaits' mean is its end: it is less noisy than any of them"""
CLIMB, ENDS, LAST = range(3)
"""what random numbers are drawn for: none twice in one polish"""


class Polishing(NamedTuple):
    """How to polish."""

    rollouts: int = 1024
    """that all steps from all starts may cost together, in rollouts over the whole duration"""
    kind: Kind = "smoothed"
    samples: int = 12
    """perturbed gaits for each smoothed gradient, robots for each pathwise one"""
    robots: int = 4
    """in the ensemble that judges each of those"""
    width: tuple[float, float] = (0.006, 0.004)
    """standard deviation of the smoothed gradient's perturbations in the first and in the last step, in turns of the
    circle or shares of the bounds"""
    learning_rate: float = 0.0065
    """length of the first step, in the same unit; the last has a fifth of it"""
    momentum: float = 0.5
    final_robots: int = 64
    """in the ensemble by which the ends of all climbs are compared"""
    largest_sensitivity: float = 3.0
    """m/rad: beyond it a pathwise gradient describes less than a step's length of the landscape"""


class Step(NamedTuple):
    """One step of polishing."""

    horizon: float
    """s, of the gradient"""
    gradient_norm: float
    """of the fitness, per turn of the circle or per width of the bounds"""
    pathwise_share: float
    """weight of the pathwise gradient, 0 to 1"""
    fitness: float
    """at the horizon, in the mean over what the gradient was taken from"""


class Route(NamedTuple):
    """From where to climb, and how."""

    genes: OneGait
    kind: Kind
    horizon: float
    """s"""


class Polished(NamedTuple):
    """What polishing did, and why."""

    genes: OneGait
    """the better gait of the best start and the best end, by the last judgement"""
    improved: bool
    before: Scores
    after: Scores
    """of both, one row each, by one ensemble"""
    steps: tuple[Step, ...]
    """of the climb that ended best"""
    horizon: float
    """s, that its last gradient looked ahead"""
    sensitivity: Sensitivity | None
    """of the best start; None where no pathwise gradient was asked for"""
    rollouts: int
    """spent on the steps, in rollouts over the whole duration; the last judgement comes on top"""
    reason: str


def polish(
    scene: Scene,
    genome: Genome,
    genes: Float[AnyArray, "starts genes"],
    duration: float,
    polishing: Polishing | None = None,
    *,
    fitness: Fitness | None = None,
    dt: float | None = None,
    dtype: str = "float32",
    final_dt: float | None = None,
    final_robots: int = 256,
    seed: int = 0,
    any_step: bool = False,
    on_step: Callable[[Step], None] | None = None,
) -> Polished:
    """Climb from each of the gaits that `genes` stand for, best first, and keep what verifies.

    Each climb has the same share of the rollouts. Each of its steps is a gradient, turned into an update by optax
    (momentum, its length falling by a cosine). Smoothed gradients are of the fitness. Pathwise and combined ones are of
    the mean objective at a horizon: as far ahead as the measured sensitivity of the start stays below
    `polishing.largest_sensitivity`, in the first half of the steps half way there. Where it does not let them look past
    the first period of full actuation they are not used, and `reason` says so; a combined polish climbs by smoothed
    gradients then. In the end the first of all starts and the best of all ends meet one ensemble of `final_robots` in
    float64 at `final_dt` (half of dt where not given), and the better one is kept, however little better; `reason` has
    the gain with two standard errors.

    Raises `InputError` as `settle` does, and where the rollouts do not pay for a step from each start.
    """
    polishing, fitness = polishing or Polishing(), fitness or Fitness()
    genes = np.atleast_2d(np.asarray(genes, float))
    check_polishing(polishing, fitness, len(genes))
    settings = settle(scene, duration, None, dt, dtype, any_step=any_step)
    final_dt = float(settings.dt) / 2 if final_dt is None else final_dt  # type: ignore[arg-type]
    final = settle(scene, duration, None, final_dt, "float64", any_step=any_step)
    routes, growth, told = [Route(start, "smoothed", duration) for start in genes], None, ""
    if polishing.kind != "smoothed":
        routes, growth, told = _routes(scene, genome, genes, duration, settings, polishing)
    last, steps, spent = genes[0], [], 0
    if routes:
        task = Task(as_dtype(scene, dtype), genome, duration, settings, fitness, np.asarray(polishing.width[0], dtype))
        last, steps, spent = _climb_all(task, polishing, routes, seed, on_step)
    pair = np.stack([genes[0], last])
    judged = _judge_genes(_key(seed, LAST), scene, genome, pair, duration, final, fitness, final_robots)
    before, after = (jax.tree.map(lambda x, k=k: np.asarray(x)[k : k + 1], judged) for k in (0, 1))
    improved = bool(after.fitness[0] > before.fitness[0])
    outcome = "the polished gait is kept" if improved else "the gait is kept as it was"
    reason = f"{told}{len(steps)} steps; {_gain(before, after)}: {outcome}" if steps else told[:-2]
    best, horizon = last if improved else genes[0], steps[-1].horizon if steps else duration
    return Polished(best, improved, before, after, tuple(steps), horizon, growth, spent, reason)


def check_polishing(polishing: Polishing, fitness: Fitness, starts: int) -> None:
    """Raise `InputError` for what no polishing can do from so many starts, before a search that it is to follow.

    What pathwise gradients cost depends on the sensitivity of the starts, which is not known then.
    """
    if polishing.kind not in get_args(Kind):
        raise InputError(f"polishing by {polishing.kind!r}: unknown; expected one of {', '.join(get_args(Kind))}")
    if polishing.samples < 4 or polishing.samples % 2:
        raise InputError(f"samples = {polishing.samples}: expected an even number, 4 or more")
    if polishing.kind != "smoothed" and (fitness.objective.metered or fitness.caution):
        what = "caution" if fitness.caution else "what is metered"
        raise InputError(f"{what} has no pathwise gradient; expected a smoothed one")
    if polishing.kind == "smoothed":
        _share(polishing, fitness, [_cost(polishing, fitness, "smoothed", 1.0)] * starts)


def _share(polishing: Polishing, fitness: Fitness, costs: list[float]) -> tuple[int, int]:
    """Rollouts for each of the climbs, of whose steps none costs more than this, and for comparing their ends."""
    judging = len(costs) * _robots(fitness, polishing.final_robots) if len(costs) > 1 else 0
    each = (polishing.rollouts - judging) // len(costs)
    if each < max(costs):
        least = math.ceil(max(costs)) * len(costs) + judging
        raise InputError(f"{polishing.rollouts} rollouts of polish: expected {least} or more, for {len(costs)} climbs")
    return each, judging


def _gain(before: Scores, after: Scores) -> str:
    """In words, with two standard errors of the difference of the means, whose draws come in pairs."""
    gain = after.each[0] - before.each[0]
    pairs = gain.reshape(2, -1).mean(0) if gain.size % 2 == 0 else gain
    error = f" ± {2 * pairs.std(ddof=1) / np.sqrt(pairs.size):.2g}" if pairs.size > 1 else ""
    over = f" over {gain.size} robots" if gain.size > 1 else ""
    difference = float(after.fitness[0] - before.fitness[0])
    return f"fitness {'up' if difference > 0 else 'down'} by {abs(difference):.3f}{error}{over}"


def _routes(scene: Scene, genome: Genome, genes, duration: float, settings: Settings, polishing: Polishing):
    """A route from each start by what its sensitivity allows; the sensitivity of the first; words."""
    routes, growth, refused = [], [], 0
    gaits, bound = genome.gaits(scene.gait, genes), polishing.largest_sensitivity
    for k, start in enumerate(genes):
        gait = one_gait(gaits, k)
        growth.append(sensitivity(with_gait(scene, gait), duration, dt=settings.dt, any_step=True))  # type: ignore[arg-type]
        horizon = min(duration, growth[-1].horizon(bound))
        if horizon >= _one_period(gait):
            routes.append(Route(start, polishing.kind, horizon))
        else:
            refused += 1
            routes += [Route(start, "smoothed", duration)] if polishing.kind == "combined" else []
    told = f"{refused} of {len(genes)} starts are too sensitive for pathwise gradients; " if refused else ""
    if refused == len(genes):
        told = (
            f"no pathwise gradient was used: |d com/d phase| passes {bound:g} m/rad after "
            f"{growth[0].horizon(bound):.1f} s, before one period of full actuation is over; "
        )
    return routes, growth[0], told


def _judge_genes(key, scene: Scene, genome: Genome, genes, duration, settings: Settings, fitness: Fitness, robots: int):
    """`judge`, of a gait for each row of genes, by ensembles of another size."""
    gaits = genome.gaits(scene.gait, jnp.asarray(genes, settings.dtype))
    end, many = np.asarray(duration, float), with_robots(fitness, robots)
    return judge(key, as_dtype(scene, settings.dtype), gaits, end, as_inputs(settings), many)


def _climb_all(task: Task, polishing: Polishing, routes: list[Route], seed: int, on_step):
    """The best of the gaits at which the climbs ended, the steps of its climb, and what all of them cost."""
    costs = [_cost(polishing, task.fitness, route.kind, route.horizon / task.duration) for route in routes]
    each, judging = _share(polishing, task.fitness, costs)
    polishing = polishing._replace(rollouts=each)
    climbs = [_climb(task, polishing, route, _key(seed, CLIMB, k), on_step) for k, route in enumerate(routes)]
    ends = np.stack([end for end, _, _ in climbs])
    spent = sum(cost for _, _, cost in climbs) + judging
    best = 0
    if len(routes) > 1:
        options = task.duration, task.settings, task.fitness, polishing.final_robots
        scores = _judge_genes(_key(seed, ENDS), task.scene, task.genome, ends, *options)
        best = int(jnp.argmax(scores.fitness))
    return ends[best], climbs[best][1], spent


def _climb(task: Task, polishing: Polishing, route: Route, key, on_step):
    """The gait at the end, the steps that led to it, and what they cost."""
    genes, kind, horizon = route
    ahead = [horizon] if kind == "smoothed" else [(horizon + _shortest(task, genes)) / 2, horizon]
    costs = [_cost(polishing, task.fitness, kind, reach / task.duration) for reach in ahead]
    count = int(polishing.rollouts / np.mean(costs))
    schedule = optax.cosine_decay_schedule(polishing.learning_rate, count, alpha=0.2)
    optimiser = optax.chain(
        optax.trace(polishing.momentum), optax.normalize_by_update_norm(), optax.scale_by_schedule(schedule)
    )
    # NumPy: on all devices, as a step leaves it, x would have the next one compiled again
    first = x = np.asarray(genes, task.settings.dtype)
    state, path, found, spent = optimiser.init(x), [], [], 0.0
    widths = np.geomspace(*polishing.width, count).astype(task.settings.dtype)
    for number in range(count):
        half = min(len(ahead) - 1, 2 * number // count)
        task = task._replace(width=widths[number])
        gradient, share = _gradient(jax.random.fold_in(key, number), x, task, kind, ahead[half], polishing)
        spent += costs[half]
        if jnp.any(gradient.mean):
            update, state = optimiser.update(gradient.mean / gradient.scale, state)
            # angles go on beyond a turn, so that their mean is one
            x = np.asarray(task.genome.bounded(x + update))
        path.append(x)
        found.append(Step(ahead[half], float(jnp.linalg.norm(gradient.mean)), float(share), float(gradient.value)))
        if on_step is not None:
            on_step(found[-1])
    last = np.stack(path[-math.ceil(AVERAGED * count) :])
    # genes that did not move keep the digits that the climb's precision lacks
    end = np.where((last == first).all(0), genes, task.genome.within(last.mean(0, dtype=float)))
    return end, found, int(spent)


def _one_period(gait: Gait) -> float:
    """The time, s, when every actuator has gone through a period at full amplitude."""
    return float(gait.start + gait.ramp + 1 / np.max(gait.frequency))


def _shortest(task: Task, genes) -> float:
    return _one_period(one_gait(task.genome.gaits(task.scene.gait, genes[None]), 0))


def _cost(polishing: Polishing, fitness: Fitness, kind: Kind, share: float) -> float:
    """Of one gradient that looks ahead for a share of the duration, in rollouts over the whole of it."""
    robots = _robots(fitness, polishing.robots)
    each = {"smoothed": robots, "pathwise": COST, "combined": robots + COST}[kind]
    return share * polishing.samples * each


def _robots(fitness: Fitness, robots: int) -> int:
    """In an ensemble that is asked to have so many: where nothing is uncertain one says it all."""
    return 1 if fitness.uncertainty.none else robots


def _gradient(key, genes, task: Task, kind: Kind, ahead: float, polishing: Polishing) -> tuple[Gradient, Any]:
    """Of the fitness at the time `ahead`, and the share that the pathwise one has in it."""
    one, other = jax.random.split(key)
    if kind == "pathwise":
        return pathwise_gradient(other, genes, task, ahead, polishing.samples), 1.0
    any_step = task._replace(settings=as_inputs(task.settings))
    smoothed = smoothed_gradient(one, genes, any_step, np.asarray(ahead), polishing.samples, polishing.robots)
    if kind == "smoothed":
        return smoothed, 0.0
    return combine(smoothed, pathwise_gradient(other, genes, task, ahead, polishing.samples))


def _key(seed: int, *purpose: int):
    key = jax.random.key(seed)
    for number in purpose:
        key = jax.random.fold_in(key, number)
    return key

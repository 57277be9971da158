"""Polish: better gaits by gradients, where gradients mean something.

The pathwise gradient differentiates the rollouts; it is exact, and useless where they are too sensitive. The smoothed
one (evolution strategies) is a regression on rollouts with perturbed genes: noisy, and sound on any horizon.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Float

from jaxgrity.actuation import Gait
from jaxgrity.diagnostics import Sensitivity, sensitivity
from jaxgrity.genome import Genome
from jaxgrity.gradients import Task, combine, pathwise_gradient, smoothed_gradient
from jaxgrity.objectives import Fitness, Scores, judge, with_robots
from jaxgrity.population import one_gait
from jaxgrity.scene import Scene, as_dtype, with_gait
from jaxgrity.simulate import Settings, settle
from jaxgrity.structure import InputError
from jaxgrity.types import AnyArray

Kind = Literal["smoothed", "pathwise", "combined"]
OneGait = Float[AnyArray, " genes"]
COST = 6.0
"""of a pathwise gradient, in rollouts of its horizon (experiments/benchmark.py measures it)"""
LENGTHS = (0.0, 0.5, 1.0, 2.0, 4.0)
"""of each step that are tried: the best goes on, and the next steps grow or shrink with it"""
CLIMB, ENDS, LAST = range(3)
"""what random numbers are drawn for: none are drawn twice"""


class Polishing(NamedTuple):
    """How to polish."""

    rollouts: int = 1024
    """that all steps from all starts may cost together, in rollouts over the whole duration"""
    kind: Kind = "smoothed"
    samples: int = 32
    """rollouts for each gradient"""
    width: tuple[float, float] = (0.005, 0.005)
    """standard deviation of the smoothed gradient's perturbations in the first and in the last step, in turns of the
    circle or shares of the bounds"""
    learning_rate: float = 0.0065
    """length of the first step, in the same unit"""
    robots: int = 16
    """in the ensemble by which each length of a step is judged"""
    final_robots: int = 64
    """in the ensemble by which the ends of all climbs are compared"""
    largest_sensitivity: float = 3.0
    """m/rad: beyond it a pathwise gradient describes less than a step's length of the landscape"""


class Step(NamedTuple):
    """One step of polishing."""

    horizon: float
    """s, of the gradient"""
    gradient_norm: float
    """of the objective, per turn of the circle or per width of the bounds"""
    pathwise_share: float
    """weight of the pathwise gradient, 0 to 1"""
    length: float
    """which of `LENGTHS` was best"""
    fitness: float
    """of the gait that goes on, by this step's ensemble"""


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
    """s, that gradients look ahead"""
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

    Each climb has the same share of the rollouts. Each of its steps is a gradient of the fitness, turned into an update
    by optax (momentum, its length falling by a cosine); `LENGTHS` of it are judged by one ensemble, and the best goes
    on. Pathwise gradients look as far ahead as the measured sensitivities of the starts stay below
    `polishing.largest_sensitivity`, in the first half of the steps half way there. A start whose own does not let them
    look past the first period of full actuation is not climbed by them; where none does they are not used, and `reason`
    says so. A combined gradient weighs both by their measured variances, on that horizon. In the end the first of all
    starts and the best of all ends meet one ensemble of `final_robots` in float64 at `final_dt` (half of dt where not
    given), and the end counts as an improvement where the mean difference of their fitness passes two standard errors.

    Raises `InputError` as `settle` does.
    """
    polishing, fitness = polishing or Polishing(), fitness or Fitness()
    if polishing.kind not in get_args(Kind):
        raise InputError(f"polishing by {polishing.kind!r}: unknown; expected one of {', '.join(get_args(Kind))}")
    settings = settle(scene, duration, None, dt, dtype, any_step=any_step)
    genes = np.atleast_2d(np.asarray(genes, float))
    kind, starts, horizon, growth, told = polishing.kind, genes, duration, None, ""
    if kind != "smoothed":
        kind, starts, horizon, growth, told = _reach(scene, genome, genes, duration, settings, polishing)
    last, steps, spent = genes[0], [], 0
    if kind is not None:
        task = Task(as_dtype(scene, dtype), genome, duration, settings, fitness, np.asarray(polishing.width[0], dtype))
        last, steps, spent = _climb_all(task, polishing, starts, kind, horizon, seed, on_step)
    final = settle(scene, duration, None, final_dt or settings.dt / 2, "float64", any_step=any_step)  # type: ignore[operator]
    pair = np.stack([genes[0], last])
    judged = _judge_genes(_key(seed, LAST), scene, genome, pair, duration, final, fitness, final_robots)
    before, after = (jax.tree.map(lambda x, k=k: np.asarray(x)[k : k + 1], judged) for k in (0, 1))
    gain = np.asarray(judged.each[1] - judged.each[0])
    error = 2 * gain.std() / np.sqrt(gain.size)
    difference = float(judged.fitness[1] - judged.fitness[0])
    improved = bool(difference > error)
    verdict = f"fitness {'up' if difference > 0 else 'down'} by {abs(difference):.3f} ± {error:.2g}"
    outcome = "the polished gait is kept" if improved else "the gait is kept as it was"
    reason = f"{told}{len(steps)} steps; {verdict} over {final_robots} robots: {outcome}" if steps else told[:-2]
    best = last if improved else genes[0]
    return Polished(best, improved, before, after, tuple(steps), horizon, growth, spent, reason)


def _reach(scene: Scene, genome: Genome, genes, duration: float, settings: Settings, polishing: Polishing):
    """Which gradient the sensitivity allows, from which starts, how far ahead; the first's sensitivity; words."""
    found, allowed = [], []
    gaits = genome.gaits(scene.gait, genes)
    for k in range(len(genes)):
        gait = one_gait(gaits, k)
        found.append(sensitivity(with_gait(scene, gait), duration, dt=settings.dt, any_step=True))
        horizon = min(duration, found[-1].horizon(polishing.largest_sensitivity))
        if horizon >= _one_period(gait):
            allowed.append((k, horizon))
    if allowed:
        starts, horizon = genes[[k for k, _ in allowed]], min(ahead for _, ahead in allowed)
        dropped = len(genes) - len(allowed)
        told = f"{dropped} of {len(genes)} starts are too sensitive for pathwise gradients; " if dropped else ""
        return polishing.kind, starts, horizon, found[0], told
    told = (
        f"no pathwise gradient was used: |d com/d phase| passes {polishing.largest_sensitivity:g} m/rad after "
        f"{found[0].horizon(polishing.largest_sensitivity):.1f} s, before one period of full actuation is over; "
    )
    kind = "smoothed" if polishing.kind == "combined" else None
    return kind, genes, duration, found[0], told


def _judge_genes(key, scene: Scene, genome: Genome, genes, duration, settings: Settings, fitness: Fitness, robots: int):
    """`judge`, of a gait for each row of genes, by ensembles of another size."""
    gaits = genome.gaits(scene.gait, jnp.asarray(genes, settings.dtype))
    return judge(
        key, as_dtype(scene, settings.dtype), gaits, np.asarray(duration, float), settings, with_robots(fitness, robots)
    )


def _climb_all(task: Task, polishing: Polishing, starts, kind: Kind, horizon: float, seed: int, on_step):
    """The best of the gaits at which the climbs ended, the steps of its climb, and what all of them cost."""
    judging = polishing.final_robots * len(starts) if len(starts) > 1 else 0
    share = polishing.rollouts - judging
    if share < len(starts):
        raise InputError(f"{polishing.rollouts} rollouts: expected more, to polish {len(starts)} gaits")
    each = polishing._replace(rollouts=share // len(starts))
    climbs = [_climb(task, each, x, kind, horizon, _key(seed, CLIMB, k), on_step) for k, x in enumerate(starts)]
    ends = np.stack([end for end, _, _ in climbs])
    spent = sum(cost for _, _, cost in climbs) + judging
    best = 0
    if len(starts) > 1:
        key, robots = _key(seed, ENDS), polishing.final_robots
        scores = _judge_genes(key, task.scene, task.genome, ends, task.duration, task.settings, task.fitness, robots)
        best = int(jnp.argmax(scores.fitness))
    return ends[best], climbs[best][1], spent


def _climb(task: Task, polishing: Polishing, genes, kind: Kind, horizon: float, key, on_step):
    """The last gait, the steps that led to it, and what they cost."""
    genome = task.genome
    ahead = [horizon] if kind == "smoothed" else [(horizon + _shortest(task, genes)) / 2, horizon]
    costs = [_cost(task, polishing, kind, reach) + len(LENGTHS) * polishing.robots for reach in ahead]
    count = max(1, int(polishing.rollouts / np.mean(costs)))
    schedule = optax.cosine_decay_schedule(polishing.learning_rate, count, alpha=0.2)
    optimiser = optax.chain(optax.trace(0.5), optax.normalize_by_update_norm(), optax.scale_by_schedule(schedule))
    x, scale, found, spent = jnp.asarray(genes, task.settings.dtype), 1.0, [], 0.0
    state = optimiser.init(x)
    widths = np.geomspace(*polishing.width, count).astype(task.settings.dtype)
    for number in range(count):
        half = min(len(ahead) - 1, 2 * number // count)
        drawn, judged, key = jax.random.split(key, 3)
        task = task._replace(width=widths[number])
        gradient, share = _gradient(drawn, x, task, kind, ahead[half], polishing.samples)
        if not jnp.any(gradient):
            continue
        update, state = optimiser.update(gradient, state)
        tried = genome.within(x + scale * jnp.asarray(LENGTHS, x.dtype)[:, None] * update)
        scores = _judge_genes(
            judged, task.scene, genome, tried, task.duration, task.settings, task.fitness, polishing.robots
        )
        best = int(jnp.argmax(scores.fitness))
        x, scale, spent = tried[best], scale * max(LENGTHS[best], 0.25) ** 0.5, spent + costs[half]
        fitness, norm = float(scores.fitness[best]), float(jnp.linalg.norm(gradient))
        found.append(Step(ahead[half], norm, float(share), LENGTHS[best], fitness))
        if on_step is not None:
            on_step(found[-1])
    # genes that did not move keep the digits that the climb's precision lacks
    stayed = np.asarray(x) == np.asarray(genes, task.settings.dtype)
    return np.where(stayed, genes, np.asarray(x, float)), found, int(spent)


def _one_period(gait: Gait) -> float:
    """The time, s, when every actuator has gone through a period at full amplitude."""
    return float(gait.start + gait.ramp + 1 / np.max(gait.frequency))


def _shortest(task: Task, genes) -> float:
    return _one_period(one_gait(task.genome.gaits(task.scene.gait, genes[None]), 0))


def _cost(task: Task, polishing: Polishing, kind: Kind, ahead: float) -> float:
    """Of one gradient, in rollouts over the whole duration."""
    share = ahead / task.duration * polishing.samples
    return share * {"smoothed": 1, "pathwise": COST, "combined": 1 + COST}[kind]


def _gradient(key, genes, task: Task, kind: Kind, ahead: float, samples: int) -> tuple[AnyArray, AnyArray]:
    """Of the mean objective at the time `ahead`, and the share that the pathwise one has in it."""
    few = samples // 2
    one, other = jax.random.split(key)
    pathwise = smoothed = None
    if kind in ("smoothed", "combined"):
        smoothed = smoothed_gradient(one, genes, task, np.asarray(ahead), few)
    if kind in ("pathwise", "combined"):
        pathwise = pathwise_gradient(other, genes, task, ahead, 2 * few)
    if smoothed is None or pathwise is None:
        (mean, _), share = (smoothed or pathwise), 0.0 if pathwise is None else 1.0  # type: ignore[misc]
        return mean, jnp.asarray(share)
    return combine(smoothed, pathwise)


def _key(seed: int, *purpose: int):
    key = jax.random.key(seed)
    for number in purpose:
        key = jax.random.fold_in(key, number)
    return key

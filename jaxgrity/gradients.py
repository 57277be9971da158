"""Gradients of rollouts: pathwise by reverse mode, smoothed by regression on perturbed ones, and both combined."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.actuation import Gait
from jaxgrity.dynamics import centre_of_mass
from jaxgrity.genome import Genome
from jaxgrity.methods import RK4
from jaxgrity.objectives import Fitness
from jaxgrity.population import Outcomes, discretise_lanes, in_lanes, lanes_last, over_lanes, roll_out
from jaxgrity.scene import Scene
from jaxgrity.simulate import Settings
from jaxgrity.structure import InputError
from jaxgrity.types import AnyArray, PerGait, Phases, Scalar, Vectors
from jaxgrity.uncertainty import Differences, ensemble


class Task(NamedTuple):
    """What stays the same from step to step."""

    scene: Scene
    genome: Genome
    duration: float
    settings: Settings
    fitness: Fitness
    width: Scalar
    """of the smoothed gradient"""


def distance_and_gradient(scene: Scene, gaits: Gait, horizon: float, settings: Settings) -> tuple[PerGait, Phases]:
    """Horizontal distance of each gait at `horizon` (m), and its gradient in the phases (m/rad), by reverse mode.

    All gaits are integrated at once, in lanes, by `checkpointed_end`.
    """

    def total(phase):
        distance = distances(scene, eqx.tree_at(lambda g: g.phase, gaits, phase), horizon, settings)
        return jnp.sum(distance), distance

    gradient, distance = jax.grad(total, has_aux=True)(gaits.phase)
    return distance, gradient


def distances(scene: Scene, gaits: Gait, horizon: float, settings: Settings, end: Callable | None = None) -> PerGait:
    """Horizontal distance of each gait at `horizon`, m, in a form that reverse mode differentiates.

    `end` integrates all gaits, in lanes; `checkpointed_end` where not given.
    """
    first, last = centres(scene, gaits, None, horizon, settings, end)
    moved = (last - first)[:, :2]
    return jnp.sqrt(jnp.sum(moved * moved, axis=1))


def centres(
    scene: Scene,
    gaits: Gait,
    differences: Differences | None,
    horizon: float,
    settings: Settings,
    end: Callable | None = None,
) -> tuple[Vectors, Vectors]:
    """(population, 3), centre of mass of each robot at the start and at `horizon`, m, as for `distances`."""
    scene, axes = in_lanes(scene, lanes_last(gaits), lanes_last(differences))
    nodes = scene.structure.nodes
    q, _ = (end or checkpointed_end)(scene, axes, (nodes, jnp.zeros_like(nodes)), horizon, settings)
    com = over_lanes(centre_of_mass, (axes, -1))
    return com(scene, nodes).T, com(scene, q).T


def checkpointed_end(scene: Scene, axes: Scene, start, horizon: float, settings: Settings):
    """The state at `horizon`, by the scene's method stepped inside two nested scans, for reverse mode.

    On the way back the inner scan is run again, stretch by stretch; RK4 then computes each of its stages once more, any
    other method each of its steps. Where the steps do not divide into two such scans there are a few more of them, as
    much smaller.
    """
    terms, solver = discretise_lanes(settings, axes)
    count = horizon / settings.dt  # type: ignore[operator]
    stretches, steps = _divide(max(1, int(np.ceil(count - 1e-6))))
    h = horizon / (stretches * steps)

    def step(carry, k):
        y, solver_state = carry
        y, _, _, solver_state, _ = solver.step(terms, k * h, (k + 1) * h, y, scene, solver_state, False)
        return (y, solver_state), None

    kept = step if isinstance(solver, RK4) else jax.checkpoint(step)

    def stretch(carry, k):
        return jax.lax.scan(kept, carry, k)

    numbers = jnp.arange(stretches * steps, dtype=settings.dtype).reshape(stretches, steps)
    first = (start, solver.init(terms, 0.0, h, start, scene))
    (end, _), _ = jax.lax.scan(jax.checkpoint(stretch), first, numbers)
    return end


def _divide(count: int) -> tuple[int, int]:
    """Two factors of `count` near its root; of the next number above it that has such, where it has none."""
    while True:
        root = int(np.sqrt(count))
        for small in range(root, root // 2, -1):
            if count % small == 0:
                return count // small, small
        count += 1


def combine(smoothed, pathwise) -> tuple[AnyArray, AnyArray]:
    """The mean of two gradients by the inverse of their variances, and the second one's weight in it.

    Each is a mean and the squared standard error of it, summed over the genes. Suh, Simchowitz, Zhang, Tedrake 2022.
    """
    (first, noise), (second, other) = smoothed, pathwise
    share = jnp.where(jnp.isfinite(other), noise / (noise + other), 0.0)
    return first + share * (jnp.where(share > 0, second, 0) - first), share


@eqx.filter_jit
def smoothed_gradient(key, genes, task: Task, ahead, pairs: int):
    """g = mean of (f(x + s e) - f(x - s e))/(2 s) e over pairs of robots, e normal, and its squared standard error."""
    drawn, disturbed = jax.random.split(key)
    e = jax.random.normal(drawn, (pairs, genes.size), genes.dtype)
    width, both = task.width, []
    for sign in (1, -1):
        gaits = task.genome.gaits(task.scene.gait, genes + sign * width * e)
        # pairs meet the same draws of what is uncertain, whose effect then cancels
        robots, differences = ensemble(disturbed, task.scene, gaits, task.fitness.uncertainty, 1, common=False)
        objective = task.fitness.objective
        outcomes = roll_out(task.scene, robots, ahead, task.settings, differences, objective.metered)
        both.append(objective.worth(task.scene, outcomes, ahead))
    slope = (both[0] - both[1]) / (2 * width)
    return _mean_and_noise(slope[:, None] * e)


@eqx.filter_jit
def pathwise_gradient(key, genes, task: Task, ahead: float, robots: int):
    """The mean gradient over an ensemble of robots, by reverse mode, and its squared standard error."""
    if task.fitness.objective.metered:
        raise InputError("what is metered has no pathwise gradient; expected a smoothed one")

    def total(each):
        gaits = task.genome.gaits(task.scene.gait, each)
        many, differences = ensemble(key, task.scene, gaits, task.fitness.uncertainty, 1, common=False)
        start, end = centres(task.scene, many, differences, ahead, task.settings)
        none = jnp.zeros(robots, int)
        name, dt = task.settings.method.name, task.settings.dt
        outcomes = Outcomes(start, end, jnp.zeros((robots, 0, 3)), none, none, none, None, name, dt)
        return jnp.sum(task.fitness.objective.worth(task.scene, outcomes, ahead))

    gradients = jax.grad(total)(jnp.tile(genes, (robots, 1)))
    # draws come in pairs of opposite signs, whose gradients are no independent samples
    pairs = gradients.reshape(2, -1, genes.size).mean(0) if robots % 2 == 0 else gradients
    return _mean_and_noise(pairs)


def _mean_and_noise(samples) -> tuple[AnyArray, AnyArray]:
    """The mean over those samples that are finite, 0 where none is, and its squared standard error."""
    good = jnp.isfinite(samples).all(1, keepdims=True)
    count = jnp.sum(good)
    kept = jnp.where(good, samples, 0)
    mean = kept.sum(0) / jnp.maximum(count, 1)
    spread = jnp.sum(jnp.where(good, kept - mean, 0) ** 2)
    return mean, jnp.where(count > 1, spread / jnp.maximum(count, 1) / jnp.maximum(count - 1, 1), jnp.nan)

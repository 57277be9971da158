"""Pathwise gradients of a population's rollouts, by reverse mode."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.actuation import Gait
from jaxgrity.dynamics import centre_of_mass
from jaxgrity.methods import RK4
from jaxgrity.population import discretise_lanes, in_lanes, lanes_last, over_lanes
from jaxgrity.scene import Scene
from jaxgrity.simulate import Settings
from jaxgrity.types import PerGait, Phases, Vectors
from jaxgrity.uncertainty import Differences


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

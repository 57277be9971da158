"""Polish: better gaits by gradients, where gradients mean something."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxgrity.actuation import Gait
from jaxgrity.diagnostics import Sensitivity, Verified, sensitivity, verify
from jaxgrity.dynamics import centre_of_mass
from jaxgrity.methods import RK4
from jaxgrity.population import discretise_lanes, in_lanes, one_gait, over_lanes, simulate_population
from jaxgrity.scene import Scene, as_dtype, with_gait
from jaxgrity.simulate import Settings, settle
from jaxgrity.structure import InputError
from jaxgrity.types import PerGait, Phases


class Polishing(NamedTuple):
    """How to polish."""

    steps: int = 30
    learning_rate: float = 0.03
    """rad, of Adam's first step; it falls to a tenth by a cosine"""
    largest_sensitivity: float = 3.0
    """m/rad: beyond it a gradient describes less than a step's length of the landscape"""
    dt: float | None = None
    """step of the rollouts that are differentiated, and of those that choose what to verify, s; None: verification's"""


class Polished(NamedTuple):
    """What polishing did, and why it stopped."""

    gait: Gait
    """the best verified gait, polished or not"""
    verified: Verified
    """of that gait alone"""
    improved: bool
    horizon: float
    """s, up to which the sensitivity allowed gradients"""
    sensitivity: Sensitivity
    """of the gait that polishing started from"""
    gradient_norm: np.ndarray
    """(steps,), median over the gaits, m/rad"""
    distance: np.ndarray
    """(steps,), of the best gait at the horizon, m"""
    reason: str


def polish(
    scene: Scene,
    gaits: Gait,
    duration: float,
    polishing: Polishing | None = None,
    *,
    dt: float,
    on_step: Callable[[int, float], None] | None = None,
) -> Polished:
    """Climb in the phases of each of `gaits` by Adam, side by side, and keep the best gait that verifies.

    The objective is the distance at a horizon up to which the measured sensitivity of the best gait stays below
    `polishing.largest_sensitivity`; every gait on the way is then judged at the whole `duration`, the best few are
    verified at dt, dt/2 and dt/4 in float64, and one takes the place of the best starting gait only where it goes
    further by more than both error bars.
    """
    polishing = polishing or Polishing()
    verified = verify(scene, gaits, duration, dt)
    best = _best(verified)
    incumbent = one_gait(gaits, best)
    growth = sensitivity(with_gait(scene, incumbent), duration, dt=dt)
    horizon = min(duration, growth.horizon(polishing.largest_sensitivity))
    kept = (incumbent, _only(verified, best), False, horizon, growth)
    shortest = float(gaits.start + gaits.ramp + 1 / np.max(incumbent.frequency))
    if horizon < shortest:
        return Polished(*kept, np.zeros(0), np.zeros(0), _too_sensitive(polishing, horizon, shortest))
    settings = settle(scene, horizon, None, polishing.dt or dt, "float64")
    visited, norms, distances = _climb(scene, gaits, horizon, polishing, settings, on_step)
    candidates = _most_promising(scene, visited, duration, polishing.dt or dt, count=16)
    checked = verify(scene, candidates, duration, dt)
    if not np.isfinite(checked.error_bar).any():
        return Polished(*kept, norms, distances, "no gait on the way could be integrated at every step of verification")
    winner = _best(checked)
    gain = checked.distance[winner] - verified.distance[best]
    bars = checked.error_bar[winner] + verified.error_bar[best]
    if gain > bars:
        reason = f"all {polishing.steps} steps taken; verified gain {gain:.4f} m, error bars {bars:.1g} m together"
        kept = (one_gait(candidates, winner), _only(checked, winner), True, horizon, growth)
    else:
        reason = f"no gait on the way goes verifiably further (gain {gain:.4f} m, error bars {bars:.1g} m together)"
    return Polished(*kept, norms, distances, reason)


def _too_sensitive(polishing: Polishing, horizon: float, shortest: float) -> str:
    return (
        f"no gradient was used: |d com/d phase| passes {polishing.largest_sensitivity:g} m/rad after {horizon:.1f} s, "
        f"before one period of full actuation is over ({shortest:.1f} s)"
    )


def _best(verified: Verified) -> int:
    """The gait that goes furthest when its error bar is held against it. Raises `InputError` where all failed."""
    worth = np.where(np.isfinite(verified.error_bar), verified.distance - verified.error_bar, -np.inf)
    if not np.isfinite(worth).any():
        raise InputError("every gait failed when it was verified; expected at least one that can be integrated")
    return int(np.argmax(worth))


def _only(verified: Verified, k: int) -> Verified:
    return verified._replace(**{name: getattr(verified, name)[k : k + 1] for name in verified._fields[:-1]})


def _climb(scene: Scene, gaits: Gait, horizon: float, polishing: Polishing, settings: Settings, on_step):
    """All gaits that Adam visits, as one population, and the gradient norm and best distance at each step."""
    schedule = optax.cosine_decay_schedule(polishing.learning_rate, polishing.steps, alpha=0.1)
    optimiser = optax.adam(schedule)
    scene, gaits = as_dtype(scene, settings.dtype), jax.tree.map(jnp.asarray, gaits)

    @eqx.filter_jit
    def ascend(phase, state):
        distance, gradient = distance_and_gradient(scene, _with_phase(gaits, phase), horizon, settings)
        size = jnp.linalg.norm(gradient, axis=1)
        usable = jnp.isfinite(distance) & jnp.isfinite(size)
        updates, state = optimiser.update(jnp.where(usable[:, None], -gradient, 0), state)
        return optax.apply_updates(phase, updates), state, jnp.where(usable, distance, -jnp.inf), size

    phase, state = gaits.phase, optimiser.init(gaits.phase)
    visited, norms, distances = [], [], []
    for number in range(polishing.steps):
        phase, state, distance, size = ascend(phase, state)
        visited.append(_with_phase(gaits, phase))
        norms.append(float(jnp.nanmedian(size)))
        distances.append(float(jnp.max(distance)))
        if on_step is not None:
            on_step(number, distances[-1])
    together = jax.tree.map(lambda *rows: np.concatenate(rows) if rows[0].ndim else rows[0], *visited)
    return together, np.array(norms), np.array(distances)


def _with_phase(gaits: Gait, phase) -> Gait:
    return eqx.tree_at(lambda g: g.phase, gaits, phase)


def _most_promising(scene: Scene, visited: Gait, duration: float, dt: float, count: int) -> Gait:
    """The `count` gaits, of all that were visited, that go furthest over the whole duration at the step `dt`."""
    distance = np.asarray(simulate_population(scene, visited, duration, dt=dt).distance())
    order = np.argsort(-np.where(np.isfinite(distance), distance, -np.inf))[:count]
    return jax.tree.map(lambda x: x[order] if np.ndim(x) else x, visited)


def distance_and_gradient(scene: Scene, gaits: Gait, horizon: float, settings: Settings) -> tuple[PerGait, Phases]:
    """Horizontal distance of each gait at `horizon` (m), and its gradient in the phases (m/rad), by reverse mode.

    All gaits are integrated at once, in lanes, by `checkpointed_end`.
    """

    def total(phase):
        distance = distances(scene, _with_phase(gaits, phase), horizon, settings)
        return jnp.sum(distance), distance

    gradient, distance = jax.grad(total, has_aux=True)(gaits.phase)
    return distance, gradient


def distances(scene: Scene, gaits: Gait, horizon: float, settings: Settings, end: Callable | None = None) -> PerGait:
    """Horizontal distance of each gait at `horizon`, m, in a form that reverse mode differentiates.

    `end` integrates all gaits, in lanes; `checkpointed_end` where not given.
    """
    scene, axes = in_lanes(scene, gaits.phase.T, gaits.amplitude.T, gaits.frequency.T)
    nodes = scene.structure.nodes
    q, _ = (end or checkpointed_end)(scene, axes, (nodes, jnp.zeros_like(nodes)), horizon, settings)
    com = over_lanes(centre_of_mass, (axes, -1))
    moved = (com(scene, q) - com(scene, nodes))[:2]
    return jnp.sqrt(jnp.sum(moved * moved, axis=0))


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

"""From thousands of rough rollouts to a few exact ones: where gaits are searched, and how the best are verified."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.stats import spearmanr

from jaxgrity.model.actuation import Gait
from jaxgrity.trust.error_bars import Verified, verify
from jaxgrity.search.genome import Genome
from jaxgrity.search.objectives import Fitness, Scores, judge, with_robots
from jaxgrity.rollout.population import as_population
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.search.genetic_algorithm import Breeding, Search, State, begin, evolve
from jaxgrity.stepping.simulate import as_inputs, settle
from jaxgrity.stepping.stability import default_method, default_step, strictest
from jaxgrity.core.errors import InputError
from jaxgrity.model.contact_twin import exact_twin, twin
from jaxgrity.core.types import AnyArray

COARSE = 0.01
"""s, the step of screening by complementarity: its ranks agree with those at half of it (experiments/gait_search.py)"""


class Rung(NamedTuple):
    """One way to roll a gait out."""

    name: str
    scene: Scene
    dt: float
    dtype: str


def rungs(scene: Scene, dt: float | None = None) -> tuple[Rung, ...]:
    """From rough to exact; `dt` is the scene's own step where not given.

    Screening is by complementarity at `COARSE` in float32: of the scene itself where it is exact, else of its exact
    twin. Then come the scene's own model in float32 (a penalty scene's at twice its step, where that is stable), and in
    float64 at half its step.
    """
    step = default_step(scene, default_method(scene)) if dt is None else dt
    exact = scene if scene.constrained else exact_twin(scene)
    coarse = default_step(exact, default_method(exact))
    screening = Rung("screening", exact, _stable(COARSE, coarse, exact), "float32")
    own = Rung("own model", scene, step if scene.constrained else _stable(2 * step, step, scene), "float32")
    return screening, own, Rung("verification", scene, step / 2, "float64")


def _stable(dt: float, otherwise: float, scene: Scene) -> float:
    """`dt`, s, where the scene is stable at it."""
    return dt if dt <= strictest(scene, default_method(scene))[0] else otherwise


def searched(ladder: tuple[Rung, ...]) -> tuple[Rung, ...]:
    """The rungs on which gaits evolve: screening, and the own model where screening was another's."""
    return ladder[:1] if ladder[0].scene is ladder[1].scene else ladder[:2]


def evolve_up(
    ladder: tuple[Rung, ...],
    genome: Genome,
    duration: float,
    breedings: tuple[Breeding, ...],
    *,
    fitness: Fitness,
    seed: int = 0,
    states: tuple[State, ...] = (),
    on_generation: Callable[[int, State], None] | None = None,
) -> list[Search]:
    """Evolve on each of the rungs in turn, the population of one going on to the next; the searches, one each.

    With `states`, as far as the searches got before, they go on from there. `on_generation` gets a search's number and
    its state. Raises `InputError` where populations differ in size.
    """
    sizes = {breeding.population for breeding in breedings}
    if len(sizes) > 1:
        raise InputError(f"populations of {sorted(sizes)} gaits: expected one size on all rungs")
    found: list[Search] = []
    for number, (rung, breeding) in enumerate(zip(ladder, breedings)):
        state = states[number] if number < len(states) else begin(genome, breeding, seed + number, rung.dtype)
        if found and number >= len(states):
            state = state._replace(genes=found[-1].last.genes)
        told = None if on_generation is None else lambda state, n=number: on_generation(n, state)
        search = evolve(
            rung.scene,
            genome,
            duration,
            breeding,
            fitness=fitness,
            dt=rung.dt,
            dtype=rung.dtype,
            state=state,
            on_generation=told,
        )
        found.append(search)
    return found


def judge_on(rung: Rung, gaits: Gait, duration: float, fitness: Fitness, seed: int) -> Scores:
    """`judge` on a rung, as NumPy arrays."""
    settings = settle(rung.scene, duration, None, rung.dt, rung.dtype)
    gaits = jax.tree.map(lambda x: np.asarray(x, rung.dtype), gaits)
    key, end, scene = jax.random.key(seed), np.asarray(duration, float), as_dtype(rung.scene, rung.dtype)
    return jax.tree.map(np.asarray, judge(key, scene, gaits, end, as_inputs(settings), fitness))


def rank_correlation(rows: Float[AnyArray, "rungs gaits"]) -> np.ndarray:
    """Spearman's, of every two rungs, over the gaits that all of them could roll out."""
    rows = np.asarray(rows)[:, np.isfinite(rows).all(0)]
    return np.array([[spearmanr(a, b).statistic for b in rows] for a in rows])


class Verdict(NamedTuple):
    """What one gait is worth, in the end."""

    verified: Verified
    """of the gait itself"""
    robust: Scores
    """over an ensemble in float64 at the step of verification, one row"""
    step_error: float
    """of the robust mean, by twice the step, with the same draws"""
    other_model: Scores
    """on the scene's other contact model"""

    def summary(self) -> dict[str, Any]:
        """The numbers, as they go into a JSON file; SI units."""
        robust, other = self.robust.each[0], self.other_model.each[0]
        return {
            "distance": float(self.verified.distance[0]),
            "error_bar": float(self.verified.error_bar[0]),
            "robust": {
                "mean": float(robust.mean()),
                "standard_deviation": float(robust.std()),
                "tenth_percentile": float(np.quantile(robust, 0.1)),
                "robots": robust.size,
                "step_error": self.step_error,
            },
            "other_contact_model": {"mean": float(other.mean()), "standard_deviation": float(other.std())},
        }


def final_verdict(
    scene: Scene, gait: Gait, duration: float, fitness: Fitness, *, dt: float, robots: int = 256, seed: int = 1
) -> Verdict:
    """Verify one gait at `dt` and below, judge it by a large ensemble, and ask the other contact model."""
    gaits = as_population(gait)
    verified = verify(scene, gaits, duration, dt)
    many = with_robots(fitness, robots)
    fine, coarse = (judge_on(Rung("", scene, h, "float64"), gaits, duration, many, seed) for h in (dt, 2 * dt))
    other = twin(scene)
    step = default_step(other, default_method(other))
    seen = judge_on(Rung("", other, step, "float32"), gaits, duration, with_robots(fitness, min(robots, 64)), seed)
    return Verdict(verified, fine, abs(float(fine.mean[0] - coarse.mean[0])), seen)

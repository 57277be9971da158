"""How far a number can be trusted: error bars by step refinement, and sensitivity to the gait."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.actuation import Gait
from jaxgrity.dynamics import centre_of_mass
from jaxgrity.population import simulate_population
from jaxgrity.scene import Scene, as_dtype
from jaxgrity.simulate import Settings, integrate, settle
from jaxgrity.structure import InputError
from jaxgrity.types import PerActuator, PerGait, Times, Vectors


class Verified(NamedTuple):
    """Distances in float64, each with an error bar from rollouts at smaller steps."""

    distance: PerGait
    """(population,), horizontal displacement of the centre of mass at the first of `steps`, m; NaN where it failed"""
    error_bar: PerGait
    """(population,), of the centre of mass at the end, m; infinite where any of the rollouts failed"""
    com_start: Vectors
    com_end: Vectors
    """(population, 3), m, at the first of `steps`"""
    steps: tuple[float, float, float]
    """the steps used, s"""


def verify(scene: Scene, gaits: Gait, duration: float, dt: float, method: str | None = None) -> Verified:
    """Distance of each gait at the step `dt`, with an error bar from rollouts at dt, dt/2 and dt/4, all in float64.

    With c the centres of mass, d1 = |c(dt) - c(dt/2)| and d2 = |c(dt/2) - c(dt/4)|, further halvings of a method that
    converges at first order or faster add up to d1 + d2 + d2/2 + ... <= d1 + 2 d2. The bar is twice this, for a single
    difference may happen to be small. It covers the error of the steps, not what the model leaves out;
    experiments/error_bars.py measures how often it does.
    """
    steps = (dt, dt / 2, dt / 4)
    runs = [simulate_population(scene, gaits, duration, method=method, dt=h, dtype="float64") for h in steps]
    failed = np.any([np.asarray(run.failure) != 0 for run in runs], axis=0)
    bar = np.where(failed, np.inf, refinement_bar(*(np.asarray(run.com_end) for run in runs)))
    return Verified(
        np.asarray(runs[0].distance()), bar, np.asarray(runs[0].com_start), np.asarray(runs[0].com_end), steps
    )


def refinement_bar(coarse: np.ndarray, middle: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """2 (|c1 - c2| + 2 |c2 - c3|), m, for points c1, c2, c3 computed at a step, its half and its quarter."""
    first, second = np.linalg.norm(coarse - middle, axis=-1), np.linalg.norm(middle - fine, axis=-1)
    return 2 * (first + 2 * second)


class Sensitivity(NamedTuple):
    """How strongly the centre of mass depends on the gait's phases, as time goes on."""

    times: Times
    norm: Times
    """(frames,), spectral norm of d(com)/d(phase), m/rad"""

    def horizon(self, largest: float) -> float:
        """The time, s, up to which the norm stays at or below `largest` (m/rad)."""
        above = ~(self.norm <= largest)
        return float(self.times[-1] if not above.any() else self.times[max(0, int(np.argmax(above)) - 1)])


def sensitivity(
    scene: Scene, duration: float, *, method: str | None = None, dt: float | None = None, frame_rate: float = 10.0
) -> Sensitivity:
    """|d com/d phase| along one rollout of the scene's own gait, by forward-mode differentiation, in float64.

    Where it is large, neither the distance of a gait nor its gradient says much: a phase off by 0.01 rad moves the
    robot by a hundredth of this. Raises `InputError` where the scene has no gait, and as `settle` does.
    """
    if scene.gait is None:
        raise InputError("the scene has no gait; expected one, to be sensitive to its phases")
    settings = settle(scene, duration, method, dt, "float64")
    times = np.linspace(0, duration, max(1, round(duration * frame_rate)) + 1)
    jacobian = np.asarray(_com_jacobian(as_dtype(scene, "float64"), scene.gait.phase, times, settings))
    norm = np.where(np.isfinite(jacobian).all((1, 2)), np.linalg.norm(np.nan_to_num(jacobian), 2, axis=(1, 2)), np.inf)
    return Sensitivity(times, norm)


@eqx.filter_jit
def _com_jacobian(scene: Scene, phase: PerActuator, times: Times, settings: Settings):
    """d com(t)/d phase, (frames, 3, actuators)."""

    def path(phase):
        changed = eqx.tree_at(lambda s: s.gait.phase, scene, phase)
        start = (changed.structure.nodes, jnp.zeros_like(changed.structure.nodes))
        solution = integrate(start, jnp.asarray(times), changed, settings)
        return jax.vmap(lambda q: centre_of_mass(changed, q))(solution.ys[0])

    return jax.jacfwd(path)(jnp.asarray(phase))

"""How far numbers of many rollouts can be trusted: error bars by step refinement, and sensitivity to the gait."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.actuation import Gait
from jaxgrity.dynamics import centre_of_mass
from jaxgrity.population import simulate_population
from jaxgrity.scene import Scene, as_dtype
from jaxgrity.simulate import Settings, as_inputs, integrate, refinements, settle
from jaxgrity.types import PerGait, Times, Vectors

SAFETY = 2.5
"""of error bars: 2 covered 94 % of the least predictable set of gaits, 3 would be five times the error"""


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
    """the steps used, s; of an adaptive method, the relative tolerances"""


def verify(
    scene: Scene,
    gaits: Gait,
    duration: float,
    dt: float | None = None,
    method: str | None = None,
    any_step: bool = False,
) -> Verified:
    """Distance of each gait at the step `dt`, with an error bar from rollouts at dt, dt/2 and dt/4, all in float64.

    With c the centres of mass, d1 = |c(dt) - c(dt/2)| and d2 = |c(dt/2) - c(dt/4)|, further halvings of a method that
    converges at first order or faster add up to d1 + d2 + d2/2 + ... <= d1 + 2 d2. The bar is `SAFETY` times this, for
    a single difference may happen to be small. It covers the error of the steps, not what the model leaves out;
    experiments/error_bars.py measures how often it does. Without `dt` the scene decides, and a method that adapts its
    step is compared at 1, 1/10 and 1/100 of its tolerances.
    """
    steps = refinements(settle(scene, duration, method, dt, "float64", any_step=any_step))
    runs = [
        simulate_population(scene, gaits, duration, dtype="float64", any_step=any_step, **options) for options in steps
    ]
    failed = np.any([np.asarray(run.failure) != 0 for run in runs], axis=0)
    bar = np.where(failed, np.inf, refinement_bar(*(np.asarray(run.com_end) for run in runs)))
    first = runs[0]
    ladder = tuple(options.get("dt") or options["rtol"] for options in steps)
    return Verified(np.asarray(first.distance()), bar, np.asarray(first.com_start), np.asarray(first.com_end), ladder)


def refinement_bar(coarse: np.ndarray, middle: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """SAFETY (|c1 - c2| + 2 |c2 - c3|), m, for points c1, c2, c3 computed at a step, its half and its quarter."""
    first, second = np.linalg.norm(coarse - middle, axis=-1), np.linalg.norm(middle - fine, axis=-1)
    return SAFETY * (first + 2 * second)


class Sensitivity(NamedTuple):
    """How strongly the centre of mass depends on what is never known exactly, as time goes on."""

    times: Times
    """(frames,), s"""
    norm: Times
    """(frames,), spectral norm of d(com)/d(phase), m/rad; without a gait of d(com)/d(initial velocities), m/(m/s)"""
    unit: str = "m/rad"

    def horizon(self, largest: float) -> float:
        """The time, s, up to which the norm stays at or below `largest`."""
        above = ~(self.norm <= largest)
        return float(self.times[-1] if not above.any() else self.times[max(0, int(np.argmax(above)) - 1)])

    @property
    def growth_rate(self) -> float:
        """1/s, by which the norm grows in the second half of the rollout: a finite-time Lyapunov exponent."""
        late = (self.times >= self.times[-1] / 2) & (self.norm > 0) & np.isfinite(self.norm)
        return float(np.polyfit(self.times[late], np.log(self.norm[late]), 1)[0]) if late.sum() > 1 else np.nan


def sensitivity(
    scene: Scene,
    duration: float,
    *,
    method: str | None = None,
    dt: float | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    any_step: bool = False,
    sweeps: int | None = None,
    strut_tolerance: float | None = None,
    frame_rate: float = 10.0,
) -> Sensitivity:
    """|d com/d phase| along one rollout of the scene's own gait, by forward-mode differentiation, in float64.

    Where it is large, neither the distance of a gait nor its gradient says much: a phase off by 0.01 rad moves the
    robot by a hundredth of this. A scene without a gait is asked for its initial velocities instead. Raises
    `InputError` as `settle` does.
    """
    settings = settle(scene, duration, method, dt, "float64", rtol, atol, any_step, sweeps, strut_tolerance)
    times = np.linspace(0, duration, max(1, round(duration * frame_rate)) + 1)
    varied = np.zeros(scene.structure.nodes.shape) if scene.gait is None else scene.gait.phase
    jacobian = np.asarray(
        _com_jacobian(as_dtype(scene, "float64"), np.asarray(varied, float), times, as_inputs(settings))
    )
    norm = np.where(np.isfinite(jacobian).all((1, 2)), np.linalg.norm(np.nan_to_num(jacobian), 2, axis=(1, 2)), np.inf)
    return Sensitivity(times, norm, "m/rad" if scene.gait is not None else "m/(m/s)")


@eqx.filter_jit
def _com_jacobian(scene: Scene, varied, times: Times, settings: Settings):
    """d com(t)/d varied, (frames, 3, size of varied)."""

    def path(varied):
        still = jnp.zeros_like(scene.structure.nodes)
        changed = scene if scene.gait is None else eqx.tree_at(lambda s: s.gait.phase, scene, varied)
        start = (scene.structure.nodes, varied if scene.gait is None else still)
        solution = integrate(start, jnp.asarray(times), changed, settings)
        return jax.vmap(lambda q: centre_of_mass(changed, q))(solution.ys[0])

    return jax.jacfwd(path)(jnp.asarray(varied)).reshape(len(times), 3, -1)

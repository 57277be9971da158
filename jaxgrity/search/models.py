"""The models on which gaits are judged: a scene, and how it is integrated."""

from typing import NamedTuple

from jaxgrity.core.typed import typed
from jaxgrity.model.contact_twin import is_exact
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.stepping.methods import default_method
from jaxgrity.stepping.options import Options, ResolvedOptions, SolverOptions, is_coupled, resolve
from jaxgrity.stepping.step_limits import default_step, strictest

SCREENING_STEP = 0.01
"""Step of complementarity stepping in screening, s for a body of one metre: half of it ranks gaits the same way."""

FEWEST_ON_TWIN = 4
"""Fewest robots that are tried on the contact twin: two pairs, whose difference says how uncertain their mean is."""


class RolloutModel(NamedTuple):
    """One way to roll gaits out, as compiled functions take it."""

    scene: Scene
    """of the precision of the options"""
    options: ResolvedOptions
    """`as_inputs`"""


@typed
def model_of(scene: Scene, duration: float, options: Options = None) -> RolloutModel:
    """The scene, integrated as `options` say. Raises `InputError` as `resolve` does."""
    resolved = resolve(scene, duration, options)
    return RolloutModel(as_dtype(scene, resolved.dtype), resolved.as_inputs())


@typed
def rough_step(scene: Scene, dt: float | None = None) -> float:
    """The step for rough rollouts, s: `SCREENING_STEP` on an exact scene, twice `dt` on another, where that is stable.

    Where that is not stable, it is `dt`, or the scene's own step without a `dt`.
    """
    method = default_method(scene)
    own = default_step(scene, method) if dt is None else dt
    wanted = SCREENING_STEP * float(time_scale(scene)) if is_exact(scene) else 2 * own
    return wanted if wanted <= strictest(scene, method)[0] else own


@typed
def on_twin(twin: Scene, own_step: float, robots: int) -> tuple[SolverOptions, int]:
    """How a gait is tried on the contact twin of its scene: solver options in float32, and the number of robots.

    They are the twin's own step and `robots`. On penalty ground a robot with rigid bodies needs the coupled solver at
    a hundred times as many steps as on exact contact. There the step is the rough one, and only as many robots are
    tried as take the steps of `robots` at `own_step` (s), but at least `FEWEST_ON_TWIN`.
    """
    method = default_method(twin)
    if is_exact(twin) or not is_coupled(twin, SolverOptions(), method, True):
        return SolverOptions(dt=default_step(twin, method), dtype="float32"), robots
    step = rough_step(twin)
    pairs = int(robots * step / own_step / 2)
    return SolverOptions(dt=step, dtype="float32"), min(robots, max(FEWEST_ON_TWIN, 2 * pairs))

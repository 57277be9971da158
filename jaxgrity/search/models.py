"""The models on which gaits are judged: a scene, and how it is integrated."""

from typing import NamedTuple

from jaxgrity.core.typed import typed
from jaxgrity.model.contact_twin import is_exact
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.stepping.methods import default_method
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve
from jaxgrity.stepping.step_limits import default_step, strictest

SCREENING_STEP = 0.01
"""Step of complementarity stepping in screening, s for a body of one metre: half of it ranks gaits the same way."""


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

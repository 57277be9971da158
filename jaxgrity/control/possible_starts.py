"""Whether robots can start from a given state."""

import jax.numpy as jnp
import numpy as np

from jaxgrity.core.tracing import traced
from jaxgrity.core.types import AnyArray, NodeVectors, State
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.complementarity import Lift
from jaxgrity.stepping.starts import check_known_velocities, check_start, start_failure, supports_slip


def possible(scene: Scene, lift: Lift, start: State, *, one: bool) -> State:
    """The start, q and v. Robots whose constraints or supports forbid it, or whose numbers are not finite, get
    velocities of NaN, so that they fail.

    Raises `InputError` for `one` robot whose numbers are known.
    """
    q, v = start
    off = lift(_impossible, ("s", -1, -1))(scene, jnp.asarray(q), jnp.asarray(v))
    if not traced(off):
        if not np.any(off):
            return start
        if one:
            check_start(scene, q)
            check_known_velocities(scene, v)
    return q, jnp.where(off, jnp.nan, v)


def _impossible(scene: Scene, q: NodeVectors, v: NodeVectors) -> AnyArray:
    finite = jnp.all(jnp.isfinite(q)) & jnp.all(jnp.isfinite(v))
    return (start_failure(scene, q) != 0) | jnp.any(supports_slip(scene, v, 0.0)) | ~finite

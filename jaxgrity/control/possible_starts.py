"""Whether robots can start from a given state."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.tracing import traced
from jaxgrity.core.types import AnyArray, NodeVectors, State
from jaxgrity.model.rigidity import linked
from jaxgrity.model.scene import Scene
from jaxgrity.populations.lanes import lane_axes, lift_over
from jaxgrity.stepping.complementarity import Lift, one_robot
from jaxgrity.stepping.starts import (
    check_start,
    check_velocities,
    start_failure,
    supports_slip,
    velocities_stretch,
)


def possible(scene: Scene, start: State, *, one: bool, constrained: bool) -> State:
    """The start, q and v. Robots whose constraints or supports forbid it, or whose numbers are not finite, get
    velocities of NaN, so that they fail. A `constrained` method corrects velocities that stretch rigid struts.

    Raises `InputError` for `one` robot whose numbers are known.
    """
    q, v = start
    if one:
        check_velocities(scene, start, 0.0, constrained)

    off = _impossible(scene, (jnp.asarray(q), jnp.asarray(v)), one, constrained)
    if not traced(off):
        if not np.any(off):
            return start
        if one:
            check_start(scene, q)
    return q, jnp.where(off, jnp.nan, v)


@eqx.filter_jit
def _impossible(scene: Scene, start: State, one: bool, constrained: bool) -> AnyArray:
    """Whether the start of each robot is impossible, in one program."""

    def impossible(scene: Scene, q: NodeVectors, v: NodeVectors) -> AnyArray:
        finite = jnp.all(jnp.isfinite(q)) & jnp.all(jnp.isfinite(v))
        off = (start_failure(scene, q) != 0) | jnp.any(supports_slip(scene, v, 0.0)) | ~finite
        return off if constrained or not linked(scene) else off | velocities_stretch(scene, (q, v))

    return lift_for(scene, one)(impossible, ("s", -1, -1))(scene, *start)


def lift_for(scene: Scene, one: bool) -> Lift:
    """What makes a function of one robot a function of `one`, or of many beside each other."""
    return one_robot if one else lift_over(lane_axes(scene))

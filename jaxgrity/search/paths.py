"""The path of the centre of mass, at the ends of parts of a rollout: its speed, its bend, and its size."""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, PerGait, Scalar
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scales import length_scale, speed_scale, time_scale
from jaxgrity.model.scene import Scene, body_length
from jaxgrity.populations.population import Outcomes

FEWEST_PARTS = 24
"""Fewest parts of a rollout at whose ends steady objectives look at the centre of mass."""
SETTLING_SHARE = 0.25
"""First share of a rollout, which steady objectives ignore while the robot settles."""
LONGEST_PART = 2.5
"""Longest time between two looks at a path, s for a body of one metre. In that time a path must turn by less than half
a circle."""
MOMENTS = 7
"""Number of moments in each part from which paths that turn are measured. From a single one of each cycle the speed
depends on the moment, as the robot sways towards the centre of its circle. A prime number of moments averages all
swaying that is not as quick as they are."""
STILL = 1e-3
"""A robot that is slower stays where it is, m/s for a body of one metre: the directions of its path are rounding."""
NEARBY = 0.01
"""A robot is where it was if it got less far, m for a body of one metre: so far it may move as it settles."""
QUARTERS = 4
"""Factor of the number of parts, so that one part ends where `SETTLING_SHARE` does."""


def stays(scene: Scene, speed: Float[AnyArray, "..."] | float) -> np.ndarray:
    """Whether a robot with this speed, m/s, of any shape, stays where it is (`STILL`); NaN does not."""
    return np.asarray(np.asarray(speed, float) < STILL * float(speed_scale(scene)))


def stays_within(scene: Scene, distance: float, duration: float) -> bool:
    """Whether a robot that gets so far (m) in a time (s) stays where it is: `stays`, and less than `NEARBY`."""
    return bool(stays(scene, distance / duration)) and distance < NEARBY * float(length_scale(scene))


def parts_of_path(scene: Scene, duration: float) -> int:
    """A multiple of `FEWEST_PARTS`, of which none is longer than `LONGEST_PART`; `duration` is in s."""
    longest = LONGEST_PART * float(time_scale(scene))
    return FEWEST_PARTS * max(1, math.ceil(duration / FEWEST_PARTS / longest - 1e-9))


def parts_of(scene: Scene, gaits: Gait, duration: float) -> tuple[int, float]:
    """Whole periods of actuation (`whole_cycles`), where all gaits have one in common, or else `parts_of_path`."""
    frequencies = np.unique(np.asarray(gaits.frequency, float))
    if frequencies.size == 1 and frequencies[0] > 0:
        return whole_cycles(scene, duration, float(1 / frequencies[0]))
    return parts_of_path(scene, duration), duration


def whole_cycles(scene: Scene, duration: float, cycle: float) -> tuple[int, float]:
    """Parts that are each a whole number of cycles (s), and how long all of them are, s: at least the `duration`."""
    each = cycle * max(1, int(LONGEST_PART * float(time_scale(scene)) / cycle + 1e-9))
    parts = QUARTERS * max(1, math.ceil(duration / (QUARTERS * each) - 1e-9))
    return parts, parts * each


@typed
def path_bend(scene: Scene, outcomes: Outcomes, duration: Scalar, moments: int = 1) -> tuple[PerGait, PerGait]:
    """Speed along the path, body lengths/s, and its bend, rad per body length to the left, of the settled part.

    The path is made of arcs that turn alike. They go through the centre of mass at the ends of the parts of the time.
    An arc that turns by a has a chord of its length times sin(a/2)/(a/2). On a slope it is looked at along that. How a
    robot sways counts too, but where parts are whole numbers of cycles, and of several `moments`, of which outcomes
    have so many in each part, the mean counts. `duration` is in s.
    """
    path = _settled(_along_ground(scene, outcomes.com_path))
    steps, count = path[:, moments:] - path[:, :-moments], (path.shape[1] - 1) // moments
    chord = _over_moments(jnp.sqrt(jnp.sum(steps * steps, axis=2)), moments) / body_length(scene)
    a, b = steps[:, :-moments], steps[:, moments:]
    turned = jnp.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], jnp.sum(a * b, axis=2))
    of_each = _over_moments(turned, moments)
    length = count * chord / jnp.sinc(of_each / (2 * jnp.pi))
    return length / (duration * (1 - SETTLING_SHARE)), of_each * count / jnp.maximum(length, 1e-3)


def _over_moments(each: Float[AnyArray, "population places"], moments: int) -> PerGait:
    """The mean over the moments of a part of the means over parts."""
    return jnp.stack([each[:, k::moments].mean(1) for k in range(moments)]).mean(0)


def path_size(scene: Scene, outcomes: Outcomes) -> PerGait:
    """The diagonal of the smallest rectangle about the settled part of the path, in body lengths."""
    path = _settled(_along_ground(scene, outcomes.com_path))
    return jnp.sqrt(jnp.sum(jnp.square(path.max(1) - path.min(1)), axis=1)) / body_length(scene)


def along_and_across(moved: Float[AnyArray, "population axes"], heading: float) -> tuple[PerGait, PerGait]:
    """The parts of horizontal vectors along a heading (rad from +x), and to its left."""
    ahead, left = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    return moved[:, :2] @ ahead, moved[:, :2] @ left


def steady_velocity(outcomes: Outcomes, duration: Scalar) -> Float[AnyArray, "population 2"]:
    """(population, 2), m/s, over the settled part of paths in a multiple of `QUARTERS` parts; NaN where one failed."""
    path = _settled(outcomes.com_path[:, :, :2])
    velocity = (path[:, -1] - path[:, 0]) / (duration * (1 - SETTLING_SHARE))
    return jnp.where((outcomes.failure == 0)[:, None], velocity, jnp.nan)


def _settled(path: Float[AnyArray, "population places 2"]) -> Float[AnyArray, "population settled 2"]:
    return path[:, round(SETTLING_SHARE * (path.shape[1] - 1)) :]


def _along_ground(scene: Scene, path: Float[AnyArray, "population places 3"]) -> Float[AnyArray, "population places 2"]:
    """Down the slope and across it; of ground that is no plane along x and y."""
    if scene.ground is None or scene.ground.surface is not None:
        return path[:, :, :2]
    return path @ jnp.array(scene.ground.tangents, path.dtype).T

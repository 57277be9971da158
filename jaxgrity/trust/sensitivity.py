"""Sensitivity of a simulation: derivatives of its centre of mass with respect to the gait or the start."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.primitives import place_rows
from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, Count, Scalar, Times
from jaxgrity.model.actuation import Gait
from jaxgrity.model.body_points import independent_nodes
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.populations.lanes import lanes_last, roll_out_lanes
from jaxgrity.populations.uncertainty import Differences
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve
from jaxgrity.stepping.simulate import frame_times

SHARED_FRAMES = 128
"""Frames of a motion are padded to multiples of this number, so that short motions share compiled programs."""

MOST_VARIED = 64
"""Largest number of derivatives that are all computed if each step solves for all impulses at once. Beyond, the cost
of such robots would grow with the square of their size."""
DIRECTIONS = 16
"""Number of random directions that estimate the norm of more derivatives, to about 1/sqrt(2 * 16), a sixth."""


class Sensitivity(NamedTuple):
    """Sensitivity of the centre of mass to the phases of the gait, or without a gait to the initial velocities."""

    times: Times
    """(frames,), s"""
    norm: Times
    """(frames,), spectral norm of d(com)/d(phase), m/rad; without a gait, of d(com)/d(initial velocities), m/(m/s)"""
    unit: str = "m/rad"
    spread: float = 0.0
    """standard deviation of the norm as a share of it, where random directions estimate it; 0 where it is computed"""

    def horizon(self, largest: float) -> float:
        """Time up to which the norm is at most `largest`, s."""
        return last_within(self.times, self.norm, largest)

    @property
    def growth_rate(self) -> float:
        """Growth rate of the norm in the second half of the simulation, 1/s: a finite-time Lyapunov exponent."""
        # the first half is transient: what a disturbance does at once says nothing of how it grows
        late = (self.times >= self.times[-1] / 2) & (self.norm > 0) & np.isfinite(self.norm)
        return float(np.polyfit(self.times[late], np.log(self.norm[late]), 1)[0]) if late.sum() > 1 else np.nan


def last_within(times: Times, values: Times, largest: float) -> float:
    """The time of the last frame before values exceed the largest one, s."""
    beyond = ~(values <= largest)
    return float(times[max(0, int(np.argmax(beyond)) - 1)] if beyond.any() else times[-1])


@typed
def sensitivity(scene: Scene, duration: float, *, options: Options = None, frame_rate: float = 10.0) -> Sensitivity:
    """|d com/d phase| along a simulation with the scene's gait, by forward-mode differentiation in float64.

    At 3 m/rad, for example, an error of 0.01 rad in the phases moves the robot by 3 cm. If the sensitivity is large, do
    not trust distances or their gradients. For a scene without a gait, the derivative is with respect to the initial
    velocities.

    Robots of many rigid bodies have hundreds of such velocities. If there are more than `MOST_VARIED`, and each step
    solves for all impulses at once, derivatives along `DIRECTIONS` random directions estimate the norm. The directions
    are the same in each call and at each time.

    Args:
        scene: the scene to simulate.
        duration: simulated time, s.
        options: solver options; by default the scene decides. The precision is float64 in any case.
        frame_rate: number of derivatives per second.

    Returns:
        The spectral norm of the derivative, m/rad or m/(m/s), at every frame.

    Raises:
        InputError: bad options (see `resolve`), or a frame rate that is not positive and finite.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> growth = jaxgrity.sensitivity(scene, 0.2)
        >>> growth.unit, growth.norm.shape
        ('m/rad', (3,))
    """
    refuse_traced((scene, duration), "sensitivity")
    resolved = resolve(scene, duration, options, dtype="float64")
    times = frame_times(duration, frame_rate)
    parts = len(times) - 1
    exact, end, inputs = as_dtype(scene, "float64"), np.asarray(duration, float), resolved.as_inputs()
    shared, count = (SHARED_FRAMES * -(-parts // SHARED_FRAMES), np.asarray(parts)), _varied(exact).size
    estimated = resolved.coupled and count > MOST_VARIED
    if resolved.dt is None or resolved.method.implicit:
        found = _com_along(exact, end, inputs, parts, np.eye(count))
    elif estimated:
        drawn = np.random.default_rng(0).standard_normal((count, DIRECTIONS))
        found = _com_along(exact, end, inputs, shared, drawn / np.sqrt(DIRECTIONS))
    else:
        found = _com_jacobian(exact, end, inputs, *shared)
    jacobian = np.asarray(found)[: len(times)]
    norm = np.where(np.isfinite(jacobian).all((1, 2)), np.linalg.norm(np.nan_to_num(jacobian), 2, axis=(1, 2)), np.inf)
    unit, spread = "m/rad" if scene.gait is not None else "m/(m/s)", 1 / np.sqrt(2 * DIRECTIONS)
    return Sensitivity(times, norm, unit, float(spread) if estimated else 0.0)


@eqx.filter_jit
def _com_jacobian(scene: Scene, duration: Scalar, options: ResolvedOptions, room: int, parts: Count) -> AnyArray:
    """d com(t)/d varied, (room + 1, 3, numbers varied), where all robots of a population take the same steps.

    Each varies another number, and this is one derivative of their rollout: mapping the derivative of one robot's
    rollout over the numbers takes JAX three times as long to trace, and twice as long to run.
    """
    own = _varied(scene)
    each = jnp.broadcast_to(own[..., None], (*own.shape, own.size))
    one_each = jnp.eye(own.size, dtype=own.dtype).reshape(each.shape) * _free(scene, own)[..., None]
    return jax.jvp(lambda x: _paths(scene, x, duration, options, (room, parts)), (each,), (one_each,))[1]


@eqx.filter_jit
def _com_along(
    scene: Scene, duration: Scalar, options: ResolvedOptions, parts: int | tuple[int, Count], directions: AnyArray
) -> AnyArray:
    """d com(t) along each of the directions, (numbers varied, directions), by one rollout that all of them share.

    (parts + 1, 3, directions). Where robots choose their steps, each of many would choose its own.
    """
    own, free = _varied(scene), _free(scene, _varied(scene))
    path = lambda x: _paths(scene, x[..., None], duration, options, parts)[..., 0]  # noqa: E731
    one = lambda along: jax.jvp(path, (own,), (along.reshape(own.shape) * free,))[1]  # noqa: E731
    return jax.vmap(one, in_axes=-1, out_axes=-1)(directions)


def _free(scene: Scene, own: AnyArray) -> AnyArray:
    """1 of what can vary: not the velocities of supports; else 0."""
    if scene.gait is not None:
        return jnp.ones_like(own)
    return jnp.asarray(scene.structure.free[np.array(_independent(scene))], own.dtype)


def _varied(scene: Scene) -> AnyArray:
    """What the scene itself says of what is varied: phases, or velocities of the nodes that follow no others."""
    if scene.gait is not None:
        return scene.gait.phase
    return jnp.zeros((len(_independent(scene)), 3), scene.structure.nodes.dtype)


def _independent(scene: Scene) -> tuple[int, ...]:
    return independent_nodes(scene.structure.bodies, len(scene.structure.nodes))


def _paths(
    scene: Scene, varied: AnyArray, duration: Scalar, options: ResolvedOptions, parts: int | tuple[int, Count]
) -> AnyArray:
    """(parts + 1, 3, lanes), m: paths of the centre of mass where this varies, lanes last."""
    lanes, differences = varied.shape[-1], None
    spread = lambda x: jnp.broadcast_to(x[..., None], (*x.shape, lanes)) if jnp.ndim(x) else x  # noqa: E731
    if scene.gait is None:
        nothing = jnp.zeros((0, lanes))
        gaits = Gait((), nothing, nothing, nothing)
        of_all = place_rows(varied, _independent(scene), len(scene.structure.nodes))
        differences = lanes_last(Differences(velocities=jnp.moveaxis(of_all, -1, 0)))
    else:
        gaits = eqx.tree_at(lambda g: g.phase, jax.tree.map(spread, scene.gait), varied)
    return roll_out_lanes(scene, gaits, differences, duration, options, parts=parts).com_path

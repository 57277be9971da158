"""A simulation as a pure function, for `jax.jit`, `jax.vmap` and `jax.grad` in any order.

Unlike `simulate`, it takes fixed steps only, and has derivatives in reverse mode. `final_state.states_at` does the
steps.
"""

from typing import NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_count
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeHistory, Scalar, State, Times
from jaxgrity.model.rigidity import linked
from jaxgrity.model.scene import Scene, as_dtype, start_of
from jaxgrity.stepping.discretisation import state_failure
from jaxgrity.stepping.final_state import LONGER, check_times, enough_steps, states_at
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve
from jaxgrity.stepping.starts import check_shapes, check_velocities, start_failure, supports_slip, velocities_stretch


class RolledOut(NamedTuple):
    """A motion, and whether it is valid."""

    positions: NodeHistory
    """(frames, nodes, 3), m"""
    velocities: NodeHistory
    """(frames, nodes, 3), m/s. On exact contact or with rigid struts, the constraints have not acted on them yet"""
    ok: AnyArray
    """whether start and end satisfy the constraints and the motion is finite; if False, do not use the rest"""


@typed
def rollout(
    scene: Scene, times: Times, *, start: State | None = None, options: Options = None, steps: int | None = None
) -> RolledOut:
    """Simulate a scene by fixed steps, as a pure function of the scene, the times and the start.

    You can differentiate it in forward and reverse mode, with respect to all numbers in these. To continue a motion,
    pass its last frame as the start. Keep velocities out of a loss on exact contact or rigid struts (`final_state`).

    If you simulate a motion in pieces, you get the same motion up to rounding, as long as the step stays the same. If
    it changes between pieces, exact scenes with dampers differ in second order of the step: by 1e-6 m for a body of one
    metre, from 5 ms to 1 ms.

    Args:
        scene: the scene to simulate.
        times: (frames,), s: two or more ascending times of the frames. Gaits, motors and pushes follow these times.
        start: positions, m, and velocities, m/s, (nodes, 3) each, at the first time; by default the nodes at rest.
        options: solver options with a fixed step; by default the scene decides. If JAX traces the scene, pass options
            that `resolve` made for a scene with known numbers, with `SolverOptions(coupled=True)` if friction reaches
            mu = 1.
        steps: number of steps between frames; by default as many as the longest interval needs.

    Returns:
        Positions, velocities, and whether they are valid.

    Raises:
        InputError: a known start that violates rigid struts or exact contact. Arrays of the wrong shape, or times that
            do not ascend. Bad options (see `resolve`), or a method that adapts its step. Traced times without `steps`.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> options = jaxgrity.stepping.resolve(scene, 0.1)
        >>> def height(mu):
        ...     there = eqx.tree_at(lambda s: s.friction.mu, scene, mu)
        ...     return jaxgrity.rollout(there, np.array([0.0, 0.1]), options=options).positions[-1, :, 2].mean()
        >>> jax.jit(jax.vmap(jax.grad(height)))(jnp.array([0.3, 0.5])).shape
        (2,)
    """
    _check_frames(times)
    start = check_shapes(scene, start_of(scene) if start is None else start)
    q, v = (x if isinstance(x, jax.Array) else np.asarray(x, float) for x in start)
    if steps is not None:
        check_count("steps", steps, 1)
    elif traced(times):
        raise InputError("times are being traced; pass `steps`, the number of steps between frames")
    resolved = resolve(scene, options=options, positions=q, since=times[0])
    if resolved.dt is None:
        raise InputError(f"method = {resolved.method.name!r} adapts its step; expected a fixed one (dt)")
    check_velocities(scene, (q, v), times[0], resolved.method.constrained)
    if not traced((times, resolved)):
        check_times(max(times, key=abs), resolved)
        steps = enough_steps(0.0, float(np.diff(times).max()), resolved, steps)
    return _rolled(as_dtype(scene, resolved.dtype), (q, v), times, cast(int, steps), resolved.as_inputs())


def _check_frames(times: Times) -> None:
    listed = np.ndim(times) == 1 and np.shape(times)[0] > 1
    if not (listed and (traced(times) or (np.isfinite(times).all() and np.all(np.diff(times) > 0)))):
        raise InputError(f"times of shape {np.shape(times)}; expected two or more ascending, finite times, (frames,)")


@eqx.filter_jit
def _rolled(scene: Scene, start: State, times: Times, steps: int, options: ResolvedOptions) -> RolledOut:
    times = jnp.asarray(times, options.dtype)
    start = jax.tree.map(lambda x: jnp.asarray(x, options.dtype), start)
    q, v = states_at(scene, start, times, steps, options, reverse=True)
    valid = ~jnp.any(supports_slip(scene, start[1], times[0]))
    if linked(scene) and not options.method.constrained:
        valid = valid & ~velocities_stretch(scene, start)
    apart, rounding = jnp.diff(times), 4 * jnp.finfo(times.dtype).eps * jnp.max(jnp.abs(times))
    fit = jnp.all(apart > 0) & jnp.all(apart <= LONGER * steps * cast(Scalar, options.dt) + rounding)
    fit = fit & valid & (start_failure(scene, start[0], times[0]) == 0) & (start_failure(scene, q[-1], times[-1]) == 0)
    return RolledOut(q, v, fit & (state_failure(scene, q[-1], v[-1]) == 0))

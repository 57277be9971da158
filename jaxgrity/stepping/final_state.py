"""Simulations by fixed steps, differentiable in forward and reverse mode: `final_state`, and `states_at` for frames.

Both go through the steps of `loop.py`. Orbits, gradients of a search and `rollout` use them; `simulate` does not.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_count, check_finite
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import Scalar, State, Times
from jaxgrity.model.scene import Scene, as_dtype, start_of
from jaxgrity.stepping.discretisation import discretise, with_scales_and_mobility
from jaxgrity.stepping.loop import Carried, Scheme, carried_at, numbered, recomputed, repeated, state_of
from jaxgrity.stepping.options import ResolvedOptions, check_options
from jaxgrity.stepping.starts import check_shapes, check_start, check_velocities

LONGER = 1.01
"""Factor by which steps may exceed the step of the options if their number is given: room for rounding."""
ROUNDED = 0.1
"""Largest rounding of a time, as a share of the step: methods stay stable where steps differ by that."""


@typed
def final_state(
    scene: Scene,
    duration: Scalar,
    options: ResolvedOptions,
    start: State | None = None,
    *,
    steps: int | None = None,
    since: Scalar = 0.0,
) -> State:
    """The state (q, v) after a simulation by fixed steps, differentiable in forward and reverse mode.

    You can differentiate with respect to every array of the scene and its gait, and the start; docs/numerics.md says
    what the derivative is where something switches. Traced numbers are not checked (`rollout` has `ok`).

    With rigid struts or on exact contact, keep the returned velocities out of a loss: constraints have not acted on
    them yet, and they can be off by more than 1 m/s. Use (q_end - q_before)/h of positions a step h apart.

    After some seconds of rolling, derivatives say little about longer motions (`sensitivity`). Differentiate the speed
    of an orbit instead (`closed_orbit`), or the mean over many robots.

    Args:
        scene: the scene to simulate.
        duration: simulated time, s. It is divided into equal steps, no longer than the step of the options.
        options: options from `resolve`, with a fixed step, as constants: if JAX traces them, give `steps`.
        start: positions, m, and velocities, m/s, (nodes, 3) each; by default the structure's nodes at rest.
        steps: number of steps; by default the options decide. Needed for derivatives with respect to the duration.
        since: time of the start, s. Gaits, motors and pushes follow this time.

    Returns:
        Positions, m, and velocities, m/s, at the end, (nodes, 3) each.

    Raises:
        InputError: a method that adapts its step, options for another kind of scene, a start of another shape or that
            violates rigid struts or exact contact, a traced duration without `steps`.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> options = jaxgrity.stepping.resolve(scene, 0.05)
        >>> def height(g):
        ...     there = eqx.tree_at(lambda s: s.gravity, scene, g)
        ...     return jaxgrity.final_state(there, 0.05, options)[0][:, 2].mean()
        >>> print(f"{jax.grad(height)(jnp.array(9.81)):.4f}")  # -t^2/2 in free fall, less what damping takes
        -0.0012
    """
    if options.dt is None:
        raise InputError(f"method = {options.method.name!r} adapts its step; expected a fixed one (dt)")
    if not (traced(duration) or float(duration) > 0):
        raise InputError(f"duration = {duration} s: expected a positive number")
    count = _counted(duration, options, steps)
    check_times(since + duration, options)
    check_options(scene, options)
    q, v = check_shapes(scene, start_of(scene) if start is None else start)
    check_start(scene, None if start is None else q, since)
    check_velocities(scene, (q, v), since, options.method.constrained)
    # numbers that are known stay so: nothing has to be computed of a start at rest
    v = np.asarray(v, options.dtype) if isinstance(v, np.ndarray) else jnp.asarray(v, options.dtype)
    scene, first = with_scales_and_mobility(as_dtype(scene, options.dtype)), (jnp.asarray(q, options.dtype), v)
    end = stepped(scene, first, (since, since + duration), options, discretise(options), count)
    return state_of(scene, since + duration, end)


def stepped(
    scene: Scene,
    start: State,
    times: tuple[Scalar, Scalar],
    options: ResolvedOptions,
    scheme: Scheme,
    steps: int | None = None,
) -> Carried:
    """What the method of `scheme` carries at the second of `times`, s, from the start at the first one.

    It is stepped inside two nested scans. On the way back the inner scan runs again, segment by segment. A method that
    recomputes its stages then does so once more. Any other method runs again step by step, except for sweeps, whose
    results are kept (`SWEPT`). If the steps do not divide into two such scans, there are a few more, smaller steps.
    """
    since, until = times
    if steps is None:
        steps = steps_between(since, until, options)
    segments, steps = _divide(steps)
    h = (until - since) / (segments * steps)

    step = recomputed(numbered(scheme, scene, h, since), options)
    numbers = jnp.arange(segments * steps, dtype=options.dtype).reshape(segments, steps)
    segment = jax.checkpoint(lambda carried, numbers: repeated(step, carried, numbers))
    return repeated(segment, carried_at(scheme, scene, since, h, start), numbers)


def _counted(duration: Scalar, options: ResolvedOptions, given: int | None) -> int:
    if not traced((duration, options)):
        return enough_steps(0.0, float(duration), options, given)
    if given is None:
        raise InputError("duration is being traced, so its steps cannot be counted; pass `steps`")
    return given


def enough_steps(since: Scalar, until: Scalar, options: ResolvedOptions, given: int | None) -> int:
    """How many steps are `given`, or are needed; raises `InputError` where these are more."""
    needed = steps_between(since, until, options)
    if given is None:
        return needed
    check_count("steps", given, 1)
    if float(until) - float(since) > LONGER * given * float(options.dt):  # type: ignore[arg-type]
        raise InputError(f"steps = {given}: they would be longer than options.dt; expected {needed} or more")
    return given


def check_times(latest: Scalar, options: ResolvedOptions) -> None:
    """Raises `InputError` where known times up to `latest`, s, are rounded by as much as a share of the steps."""
    if traced((latest, options)):
        return
    check_finite("time", float(latest))
    apart, dt = float(jnp.finfo(options.dtype).eps) * abs(float(latest)), float(options.dt)  # type: ignore[arg-type]
    if apart > ROUNDED * dt:
        raise InputError(
            f"times up to {float(latest):g} s are {apart:.2g} s apart in {options.dtype}, for steps of {dt:g} s; "
            "expected times nearer to 0, or float64"
        )


def steps_between(since: Scalar, until: Scalar, options: ResolvedOptions) -> int:
    """How many steps, no longer than the options say."""
    return max(1, int(np.ceil((float(until) - float(since)) / float(options.dt) - 1e-6)))  # type: ignore[arg-type]


@typed
def states_at(
    scene: Scene, start: State, times: Times, steps: int, options: ResolvedOptions, *, reverse: bool = False
) -> State:
    """(q, v) at all of `times` (s), (frames, nodes, 3) each, by so many fixed steps from each frame to the next.

    A bare scan: for the derivatives of one rollout by many numbers in forward mode, which identification needs, it
    costs two thirds of a `diffeqsolve` with saved frames, and compiles in less than half of the time. With `reverse`
    it is made for reverse mode: frames are stored, and what is between them is run again.
    """
    scene, scheme = with_scales_and_mobility(scene), discretise(options)
    times = jnp.asarray(times, options.dtype)

    def frame(carried, ends):
        step = numbered(scheme, scene, (ends[1] - ends[0]) / steps, ends[0])
        kept = recomputed(step, options) if reverse else step
        carried = repeated(kept, carried, jnp.arange(steps, dtype=options.dtype))
        return carried, carried

    start = jax.tree.map(lambda x: jnp.asarray(x, options.dtype), start)
    first = carried_at(scheme, scene, times[0], (times[1] - times[0]) / steps, start)
    between = jnp.stack([times[:-1], times[1:]], axis=1)
    _, later = jax.lax.scan(jax.checkpoint(frame) if reverse else frame, first, between)
    later = jax.vmap(lambda t, carried: state_of(scene, t, carried))(times[1:], later)
    return jax.tree.map(lambda x, rest: jnp.concatenate([x[None], rest]), start, later)


def _divide(count: int) -> tuple[int, int]:
    """Two factors of `count` near its root; of the next number above it that has such, where it has none."""
    while True:
        root = int(np.sqrt(count))
        for small in range(root, root // 2, -1):
            if count % small == 0:
                return count // small, small
        count += 1

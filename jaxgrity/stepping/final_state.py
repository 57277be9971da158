"""Where a rollout ends, as a function that forward and reverse mode differentiate with respect to anything in it."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import Scalar, State, Times
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.complementarity import SWEPT
from jaxgrity.stepping.integrate import discretise, prepared
from jaxgrity.stepping.options import ResolvedOptions


def final_state(
    scene: Scene,
    duration: Scalar,
    options: ResolvedOptions,
    start: State | None = None,
    *,
    steps: int | None = None,
) -> State:
    """The state (q, v) after a rollout of fixed steps, differentiable in both modes.

    Every array of the scene, of its gait, and the start may carry derivatives. The page identification says which
    are those of a smooth function, and what is returned where a contact, a cable or friction switches.

    Args:
        scene: what moves.
        duration: s; the last step ends there, and all are as long, no longer than the options say.
        options: by `resolve`, with a step; not those of `as_inputs`, since reverse mode has to count steps.
        start: positions, m, and velocities, m/s, (nodes, 3) each; the structure as posed, at rest, where not given.
        steps: how many, or a few more; by the options where not given. Where it is, the duration may carry derivatives.

    Returns:
        Positions and velocities at the end, (nodes, 3) each.

    Raises:
        InputError: a method that adapts its step.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> options = jaxgrity.resolve(scene, 0.05)
        >>> def height(g):
        ...     there = eqx.tree_at(lambda s: s.gravity, scene, g)
        ...     return jaxgrity.final_state(there, 0.05, options)[0][:, 2].mean()
        >>> print(f"{jax.grad(height)(jnp.array(9.81)):.4f}")  # -t^2/2 in free fall, less what damping takes
        -0.0012
    """
    if options.dt is None:
        raise InputError(f"method = {options.method.name!r} adapts its step; expected a fixed one (dt)")
    q = jnp.asarray(scene.structure.nodes, options.dtype)
    begin = (q, jnp.zeros_like(q)) if start is None else jax.tree.map(lambda x: jnp.asarray(x, options.dtype), start)
    return stepped(prepared(scene), begin, duration, options, discretise(options), steps)


def stepped(
    scene: Scene,
    start: State,
    duration: Scalar,
    options: ResolvedOptions,
    problem: tuple[diffrax.AbstractTerm, diffrax.AbstractSolver],
    steps: int | None = None,
) -> State:
    """The state after `duration`, by the method of `problem`, stepped inside two nested scans.

    On the way back the inner scan is run again, stretch by stretch; a method that recomputes its stages then does so
    once more, any other is run again step by step, but for sweeps whose results are kept (`SWEPT`). Where the steps do
    not divide into two such scans there are a few more of them, as much smaller.
    """
    terms, solver = problem
    if steps is None:
        steps = max(1, int(np.ceil(float(duration) / float(options.dt) - 1e-6)))  # type: ignore[arg-type]
    stretches, steps = _divide(steps)
    h = duration / (stretches * steps)

    def step(carry, k):
        y, solver_state = carry
        y, _, _, solver_state, _ = solver.step(terms, k * h, (k + 1) * h, y, scene, solver_state, False)
        return (y, solver_state), None

    sweeps = jax.checkpoint_policies.save_only_these_names(SWEPT)
    kept = step if options.method.recomputes else jax.checkpoint(step, policy=sweeps)

    def stretch(carry, k):
        return jax.lax.scan(kept, carry, k)

    numbers = jnp.arange(stretches * steps, dtype=options.dtype).reshape(stretches, steps)
    first = (start, solver.init(terms, 0.0, h, start, scene))
    (end, _), _ = jax.lax.scan(jax.checkpoint(stretch), first, numbers)
    return end


def states_at(scene: Scene, start: State, times: Times, steps: int, options: ResolvedOptions) -> State:
    """(q, v) at all of `times` (s), (frames, nodes, 3) each, by so many fixed steps from each frame to the next.

    A bare scan: for the derivatives of one rollout by many numbers in forward mode, which identification needs, it
    costs two thirds of a `diffeqsolve` with saved frames, and compiles in less than half of the time.
    """
    scene, (terms, solver) = prepared(scene), discretise(options)
    times = jnp.asarray(times, options.dtype)

    def frame(carry, ends):
        h = (ends[1] - ends[0]) / steps

        def step(carry, k):
            y, solver_state = carry
            t = ends[0] + k * h
            y, _, _, solver_state, _ = solver.step(terms, t, t + h, y, scene, solver_state, False)
            return (y, solver_state), None

        carry, _ = jax.lax.scan(step, carry, jnp.arange(steps, dtype=options.dtype))
        return carry, carry[0]

    start = jax.tree.map(lambda x: jnp.asarray(x, options.dtype), start)
    first = (start, solver.init(terms, times[0], times[1], start, scene))
    _, later = jax.lax.scan(frame, first, jnp.stack([times[:-1], times[1:]], axis=1))
    return jax.tree.map(lambda x, rest: jnp.concatenate([x[None], rest]), start, later)


def _divide(count: int) -> tuple[int, int]:
    """Two factors of `count` near its root; of the next number above it that has such, where it has none."""
    while True:
        root = int(np.sqrt(count))
        for small in range(root, root // 2, -1):
            if count % small == 0:
                return count // small, small
        count += 1

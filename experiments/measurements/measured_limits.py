"""The largest stable step of a method on a scene, measured: small motions grow beyond it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity import Scene, SolverOptions, as_dtype, simulate
from jaxgrity.statics import resting_shape
from jaxgrity.stepping import Method, discretise, resolve, standing
from jaxgrity.stepping.loop import advance, carried_at

State = tuple[np.ndarray, np.ndarray]
"""positions q (nodes, 3), m, and velocities v (nodes, 3), m/s"""

FACTORS = np.concatenate([np.linspace(0.5, 0.84, 4), np.arange(0.86, 1.16, 0.02), np.linspace(1.2, 2.0, 5)])
"""steps tried, as multiples of the prediction"""
SMALL = 1e-10
"""m, of the motion that may grow: far less than the ground is pressed in"""
SMALL_CONSTRAINED = 1e-6
"""m, with constraints, which sweeps meet to about 1e-9 m"""
STEPS = 7000


def at_rest(scene: Scene) -> State:
    """The equilibrium near the pose in which the scene stands."""
    start, _ = standing(scene)
    if not scene.constrained:
        q = resting_shape(scene, start).q
        return q, 0 * q
    heavy = eqx.tree_at(
        lambda s: s.node_damping, scene, np.asarray(scene.structure.node_mass) * 5.0, is_leaf=lambda x: x is None
    )
    options = SolverOptions(dt=2e-3, any_step=True)
    q = np.asarray(simulate(heavy, 60.0, options=options, positions=start, frame_rate=1.0).positions[-1])
    return q, 0 * q


def measure(scene: Scene, state: State, method: Method, predicted: float, factors: np.ndarray = FACTORS) -> float:
    """The smallest step, s, at which a small motion grows; infinite where none of those tried does.

    Those are `factors` times the prediction, in ascending order.
    """
    small = SMALL_CONSTRAINED if scene.constrained else SMALL
    draw = np.random.default_rng(0).normal(size=state[0].shape) * small
    if scene.ground is not None and scene.ground.impulsive:
        draw = draw * (state[0] @ np.array(scene.ground.normal) > 1e-6)[:, None]
    options = resolve(scene, 1.0, SolverOptions(method.name, predicted, "float64", any_step=True)).as_inputs()
    largest = np.asarray(spread(as_dtype(scene, "float64"), state, draw, predicted * factors, options))
    grown = ~(largest < 1e3 * small)
    return float(predicted * factors[np.argmax(grown)]) if grown.any() else np.inf


@eqx.filter_jit
def spread(scene: Scene, state: State, draw, steps, options):
    """For each step size the largest distance, m, that a node gets from equilibrium in `STEPS` steps."""
    scheme = discretise(options)
    q, v = (jnp.asarray(x) for x in state)

    def one(h):
        def watched(carry, k):
            before, largest = carry
            after = advance(scheme, scene, (0 * h, h), before)
            return (after, jnp.maximum(largest, jnp.max(jnp.abs(after.motion[0] - q)))), None

        first = carried_at(scheme, scene, 0 * h, h, (q + draw, v)), jnp.zeros(())
        return jax.lax.scan(watched, first, jnp.arange(STEPS))[0][1]

    return jax.vmap(one)(jnp.asarray(steps))

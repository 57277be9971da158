"""What supports exert on the nodes that they hold."""

import jax
import jax.numpy as jnp

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import NodeHistory
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.stepping.dynamics import support_forces
from jaxgrity.stepping.handover import carried_from
from jaxgrity.stepping.integrate import discretise, prepared
from jaxgrity.stepping.methods import find_method
from jaxgrity.stepping.options import SolverOptions, resolve
from jaxgrity.stepping.power import Step, support_impulses
from jaxgrity.stepping.simulate import Trajectory


def reactions(scene: Scene, trajectory: Trajectory) -> NodeHistory:
    """The forces of the supports along a trajectory, M a - F at the coordinates that are fixed, 0 elsewhere.

    With rigid struts or exact contact they are means over the step after each frame, impacts included.

    Args:
        scene: what moved.
        trajectory: how, as `simulate` gave it for this scene.

    Returns:
        (frames, nodes, 3), N.

    Raises:
        InputError: where the scene has no supports.

    Example:
        >>> rod = jaxgrity.Members(((0, 1),), None, [1.0], mass=[2.0])
        >>> structure = jaxgrity.Structure([[0, 0, 0], [0, 0, -1]], [0.0, 0.0], rod, fixed=((0, "xyz"),))
        >>> scene = jaxgrity.Scene(structure, gravity=9.81)
        >>> motion = jaxgrity.simulate(scene, 0.1, options=jaxgrity.SolverOptions(dt=0.01))
        >>> round(float(jaxgrity.reactions(scene, motion)[-1, 0, 2]), 6)  # N: it carries the rod that hangs from it
        19.62
    """
    if not scene.structure.fixed:
        raise InputError("structure.fixed: nothing is fixed; expected a scene with supports")
    dtype = str(trajectory.positions.dtype)
    scene = prepared(as_dtype(scene, dtype))
    frames = (jnp.asarray(trajectory.times), jnp.asarray(trajectory.positions), jnp.asarray(trajectory.velocities))
    if not find_method(trajectory.method).constrained:
        return jax.vmap(lambda t, q, v: support_forces(scene, t, q, v))(*frames)
    options = SolverOptions(trajectory.method, trajectory.dt, dtype, any_step=True)
    terms, solver = problem = discretise(resolve(scene, 1.0, options))
    h = jnp.asarray(trajectory.dt, dtype)

    def during(t, q, v):
        start, before = carried_from(problem, scene, t, h, (q, v))
        # a whole kick also for a robot at rest, so that it is a mean over the step
        before = before._replace(step_size=h)
        end, _, _, after, _ = solver.step(terms, t, t + h, start, scene, before, False)
        return support_impulses(scene, Step(t, h, start, end, before, after)) / h

    return jax.vmap(during)(*frames)

"""Forces along a finished motion: in every member, and of ground and supports on every node."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import edge_vectors, length
from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeHistory, NodeVectors, Scalar
from jaxgrity.model.rigidity import linked
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.model.strut_contact import exact_strut_contact, without_strut_contact
from jaxgrity.populations.step_impulses import impulses_along
from jaxgrity.stepping.constraints import rigid_struts
from jaxgrity.stepping.discretisation import with_scales_and_mobility
from jaxgrity.stepping.dynamics import acceleration, member_tensions, support_forces, total_force
from jaxgrity.stepping.methods import find_method
from jaxgrity.stepping.rigid_multipliers import rigid_forces, rigid_pulls
from jaxgrity.stepping.simulate import Trajectory, check_frames, driven, velocities_midway, with_room


class Forces(NamedTuple):
    """Forces of a motion in each frame."""

    tension: np.ndarray
    """(frames, members), tension of springs and dampers, N, struts first; negative if a member pushes. For a rod with
    mass it is the mean along the rod. A taut cable that shortens fast may push by a few newtons, because of its
    damper"""
    ground: np.ndarray
    """(frames, nodes, 3), force of the ground on each node, N"""
    supports: np.ndarray
    """(frames, nodes, 3), force of the supports on each node, N"""
    between: np.ndarray
    """(frames, nodes, 3), force of other struts on each node of a strut, N, by contact between struts"""


@typed
def forces_along(scene: Scene, trajectory: Trajectory) -> Forces:
    """Forces in members, of the ground and of supports along a motion.

    Forces of springs, dampers and penalty contact follow from q and v by the scene's U and R. Methods without impulses
    have multipliers, which give the forces of rigid struts and bodies at the frames. Complementarity stepping acts by
    impulses: the motion is stepped again from frame to frame, and its impulses are divided by the time. So rigid
    struts, exact contact and supports have mean forces from each frame to the next (in the last frame, over one more
    step). These mean forces of ground and supports agree with the change of momentum. Forces of penalty contact are
    those at the frames: their sum approaches the change of momentum as frames become dense.

    If the ground holds both ends of a rigid strut, its force and the friction are not unique: they are those of the
    step. Forces of contact along struts act on the ends of the struts.

    Args:
        scene: the scene of the motion.
        trajectory: the motion, with at least two frames for complementarity stepping. Rigid struts take their lengths
            from its frames.

    Returns:
        Tension of every member, and the forces of ground, supports and other struts on every node, in every frame.

    Raises:
        InputError: too few frames.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> forces = jaxgrity.forces_along(scene, jaxgrity.simulate(scene, 0.5))
        >>> forces.tension.shape, forces.ground.shape
        ((51, 30), (51, 12, 3))
    """
    refuse_traced((scene, trajectory), "forces_along")
    check_frames(scene, trajectory)
    dtype = str(trajectory.positions.dtype)
    scene = as_dtype(driven(scene, trajectory), dtype)
    v = velocities_midway(scene, trajectory)
    frames = (with_room(np.asarray(x, dtype), v.shape[1]) for x in (trajectory.times, trajectory.positions, v))
    rigid = linked(scene) and not find_method(trajectory.method).constrained
    found = Forces(*(np.asarray(x, float)[: len(v)] for x in _by_forces(scene, rigid, *frames)))
    if not find_method(trajectory.method).constrained:
        return found
    if len(trajectory.times) < 2:
        raise InputError("the trajectory has 1 frame; expected at least two, since forces are means between them")
    impulses = impulses_along(scene, trajectory)
    tension = found.tension
    if impulses.struts.size:
        tension = np.concatenate([impulses.struts, tension[:, scene.structure.first_cable :]], axis=1)
    # penalty contact acts by forces beside rigid struts and bodies too
    by_forces = scene.ground is not None and not scene.ground.impulsive
    ground = found.ground if by_forces else np.asarray(impulses.ground)
    between = np.asarray(impulses.between) if exact_strut_contact(scene) is not None else found.between
    return Forces(tension, ground, np.asarray(impulses.supports), between)


@typed
def reactions(scene: Scene, trajectory: Trajectory) -> NodeHistory:
    """Forces of the supports along a motion, from `forces_along`.

    Args:
        scene: the scene of the motion.
        trajectory: a motion of this scene.

    Returns:
        (frames, nodes, 3), force of the supports on each node, N.

    Raises:
        InputError: a scene without supports.

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
    return forces_along(scene, trajectory).supports


@eqx.filter_jit
def _by_forces(scene: Scene, rigid: bool, t: AnyArray, q: AnyArray, v: AnyArray) -> tuple[AnyArray, ...]:
    """Forces that follow from the state in each frame: tensions, and forces of ground, supports and struts on nodes.

    `rigid`: whether those of rigid struts and bodies do too, since the method has multipliers for them.
    """
    scene = with_scales_and_mobility(scene)
    alone = without_strut_contact(scene)
    aloft = eqx.tree_at(lambda s: (s.ground, s.friction), alone, (None, None), is_leaf=lambda x: x is None)

    def frame(t: Scalar, q: NodeVectors, v: NodeVectors):
        ground = total_force(alone, t, q, v) - total_force(aloft, t, q, v) if scene.ground is not None else 0 * q
        between = total_force(scene, t, q, v) - total_force(alone, t, q, v) if alone is not scene else 0 * q
        pulled = rigid_forces(scene, t, (q, v)) if rigid else 0.0
        supports = support_forces(scene, t, q, v, pulled) if scene.structure.fixed else 0 * q
        return _tension(scene, t, q, v, rigid), ground, supports, between

    return jax.vmap(frame)(t, q, v)


def _tension(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors, rigid: bool) -> AnyArray:
    """(members,), tension of springs and dampers, N, and of rigid struts by their multipliers; else 0 for these."""
    found, struts = member_tensions(scene, t, q, v), rigid_struts(scene)
    if rigid and struts is not None:
        pulls = rigid_pulls(scene, t, (q, v), acceleration(scene, t, q, v))[: len(struts.edges)]
        found = found | {"struts": found.get("struts", 0.0) + pulls * length(edge_vectors(q, struts.edges))}
    parts = [found.get(name, jnp.zeros(len(members.edges))) for name, members, _ in scene.structure.numbered]
    return jnp.concatenate([jnp.zeros(0, q.dtype), *parts])

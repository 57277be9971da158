"""Forces along a finished trajectory: the tension of every member, and what the ground does to every node."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.primitives import dot, inverse, length
from jaxgrity.core.types import AnyArray, NodeHistory, NodeVectors, Scalar
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members
from jaxgrity.stepping.constraints import rigid_struts
from jaxgrity.stepping.dynamics import acceleration, member_pull
from jaxgrity.stepping.simulate import Trajectory, velocities_midway, with_room

SMALL = 1e-6
"""weight of the ground's forces beside what is not balanced: next to none"""


class Forces(NamedTuple):
    """The forces of one motion, frame by frame."""

    tension: np.ndarray
    """(frames, members), N, struts first; what pushes is negative"""
    ground: np.ndarray
    """(frames, nodes, 3), N, of the ground on each node"""


def forces_along(scene: Scene, trajectory: Trajectory) -> Forces:
    """The forces in the members and from the ground along a trajectory.

    Springs and dampers, penalty contact and its friction follow from q and v by the scene's own U and R. The impulses
    of rigid struts and exact contact are what the motion leaves over: between two frames M dv/dt, less all other
    forces, is C tau + F_ground with the struts' directions C, by least squares, where F_ground acts on those nodes
    alone that touch the ground. Such forces are means from one frame to the next. Where both ends of a rigid strut
    touch the ground, its force cannot be told apart from the ground's: it is the one with which these are smallest.

    Arguments:
        scene: what moved.
        trajectory: how it moved; at least two frames.

    Returns:
        Tension of every member, and the force of the ground on every node, in every frame.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> forces = jaxgrity.forces_along(scene, jaxgrity.simulate(scene, 0.5))
        >>> forces.tension.shape, forces.ground.shape
        ((51, 30), (51, 12, 3))
    """
    v = velocities_midway(scene, trajectory)
    q, t = (np.asarray(x, float) for x in (trajectory.positions, trajectory.times))
    known = _known(scene, *(with_room(x, q.shape[1]) for x in (t, q, v)))
    pull, given, contact = (np.asarray(x)[: len(t)] for x in known)
    struts, exact = rigid_struts(scene), scene.ground is not None and scene.ground.impulsive
    if struts is None and not exact:
        return Forces(pull, contact)
    mean = lambda x: np.concatenate([(x[1:] + x[:-1]) / 2, x[-1:]])  # noqa: E731
    change = np.diff(v, axis=0) / np.diff(t)[:, None, None]
    left = np.asarray(scene.structure.node_mass)[:, None] * np.concatenate([change, change[-1:]]) - mean(given)
    touching = np.zeros(q.shape[:2], bool)
    if scene.ground is not None:
        near = q @ np.array(scene.ground.normal) < scene.ground.touched_below * float(length_scale(scene))
        touching = near | np.concatenate([near[1:], near[-1:]])
    if struts is not None:
        tau, left = _strut_forces(struts, mean(q), left, touching)
        pull = np.concatenate([pull[:, : len(struts.edges)] + tau, pull[:, len(struts.edges) :]], axis=1)
    return Forces(pull, np.where(touching[..., None], left, 0) if exact else contact)


def _strut_forces(
    struts: Members, q: NodeHistory, left: np.ndarray, touching: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Tension of rigid struts, (frames, struts), N, and what they leave of the forces on the nodes."""
    i, j = np.array(struts.edges).T
    direction = q[:, i] - q[:, j]
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    columns = np.zeros((*left.shape, len(i)))
    columns[:, i, :, np.arange(len(i))] -= direction.swapaxes(0, 1)
    columns[:, j, :, np.arange(len(i))] += direction.swapaxes(0, 1)
    weighted = columns * np.where(touching, SMALL, 1.0)[..., None, None]
    tau = np.linalg.solve(
        np.einsum("fnxs,fnxk->fsk", weighted, columns), np.einsum("fnxs,fnx->fs", weighted, left)[..., None]
    )[..., 0]
    return tau, left - np.einsum("fnxs,fs->fnx", columns, tau)


@eqx.filter_jit
def _known(scene: Scene, t: AnyArray, q: AnyArray, v: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
    """What follows from the state, by frames: tension of members, force on nodes, and the ground's part of it."""
    aloft = dataclasses.replace(scene, ground=None, friction=None)

    def frame(t: Scalar, q: NodeVectors, v: NodeVectors):
        mass = scene.structure.node_mass[:, None]
        force = mass * acceleration(scene, t, q, v)
        return _tension(scene, t, q, v), force, force - mass * acceleration(aloft, t, q, v)

    return jax.vmap(frame)(t, q, v)


def _tension(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors) -> AnyArray:
    """Of every member, N, by springs and dampers; none of rigid members."""
    pulls = member_pull(scene, t, q, v)
    parts = []
    for name, members in (("struts", scene.structure.struts), ("cables", scene.structure.cables)):
        if members is not None:
            i, j = np.array(members.edges).T
            d = q[i] - q[j]
            along = dot(pulls[name], d) * inverse(length(d)) if name in pulls else jnp.zeros(len(members.edges))
            parts.append(along)
    return jnp.concatenate([jnp.zeros(0, q.dtype), *parts])

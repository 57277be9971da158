"""Depth of rods in uneven ground between their nodes, where contact does not act."""

import dataclasses

import numpy as np

from jaxgrity.core.arguments import check_count
from jaxgrity.core.typed import typed
from jaxgrity.core.types import PerMember
from jaxgrity.model.rod_contact import radii_along_struts
from jaxgrity.model.rods import rods_of
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.simulate import Trajectory, check_frames


@typed
def rod_depths(scene: Scene, trajectory: Trajectory, points: int = 15) -> PerMember:
    """Largest depth of each strut, and rod of a body, in the ground between its nodes, along a motion.

    A rod that touches the ground between its ends has the radius with which it does; any other is a line.

    Args:
        scene: the scene of the motion.
        trajectory: the motion; its saved frames are checked.
        points: number of checked points per rod, evenly spaced between its nodes.

    Returns:
        (rods,), m, struts first, then the `rods` of bodies; 0 for a rod that stays above the ground.

    Raises:
        InputError: less than one point.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> depths = jaxgrity.populations.rod_depths(scene, jaxgrity.simulate(scene, 0.1))
        >>> bool(depths.max() < 1e-9)  # m: no rod enters a plane that no node enters
        True
    """
    check_count("points", points, 1)
    check_frames(scene, trajectory)
    rods, ground = rods_of(scene.structure), scene.ground
    if not rods or ground is None:
        return np.zeros(len(rods))
    i, j = np.array(rods).T
    q = np.asarray(trajectory.positions, float)[:, :, None]
    if ground.offset is not None:
        q = q - np.asarray(ground.offset, float)
    ground = dataclasses.replace(ground, offset=None, balls=None)  # balls are at nodes
    share = np.linspace(0, 1, points + 2)[1:-1, None]
    along = (1 - share) * q[:, i] + share * q[:, j]
    distance = ground.measured(along.reshape(len(q), -1, 3)).distance.reshape(along.shape[:-1])
    radii = radii_along_struts(scene)
    return np.maximum(0.0, np.array([radii.get(k, 0.0) for k in range(len(i))]) - distance.min(axis=(0, 2)))

"""Boxes, balls and cylinders of a MuJoCo model's world, as the ground of a scene."""

import dataclasses
import itertools
from typing import Any

import lazy_loader
import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrity.formats.foreign import Losses
from jaxgrity.formats.mjcf_losses import SMALL, name_of
from jaxgrity.model.rod_contact import lifted
from jaxgrity.model.scene import Scene
from jaxgrity.model.solids import CORNERS, Box, Cylinder, Sphere
from jaxgrity.model.surface import Slope, Surface
from jaxgrity.model.unions import TOUCHING, Union

mujoco: Any = lazy_loader.load("mujoco")

UPRIGHT = 1e-9
"""Largest component of a unit vector that counts as 0."""
DEPTHS = 0.5 ** np.arange(8)
"""Shares of its size by which a box may reach into what it lies on, tried one after the other."""


def solid_of(model: Any, data: Any, geom: int) -> Surface:
    """A box, sphere, cylinder or capsule of the model, where it stands."""
    kind, size, types = model.geom_type[geom], model.geom_size[geom], mujoco.mjtGeom
    at, axes = data.geom_xpos[geom].copy(), data.geom_xmat[geom].reshape(3, 3).T
    if kind == types.mjGEOM_BOX:
        return _box(at, 2 * size, axes)
    if kind == types.mjGEOM_SPHERE:
        return Sphere(at, size[0])
    round_ends = size[0] if kind == types.mjGEOM_CAPSULE else 0.0
    half = (size[1] + round_ends) * axes[2]
    return Cylinder(at - half, at + half, size[0], round_ends)


def _box(centre: np.ndarray, size: np.ndarray, axes: np.ndarray) -> Box:
    """With its axes in rows. It is an upright one, turned about z alone, where one of its axes is vertical."""
    vertical = np.flatnonzero(np.abs(axes[:, 2]) > 1 - UPRIGHT)
    if not len(vertical):
        return Box(centre, size, Rotation.from_matrix(axes.T).as_rotvec())
    order = [*({0, 1, 2} - {int(vertical[0])}), int(vertical[0])]
    x, y = axes[order[0], :2]
    turn = float(np.arctan2(y, x)) if abs(y) > UPRIGHT else 0.0
    return Box(centre, size[order], turn)


def moved(solid: Surface, way: np.ndarray, turn: np.ndarray) -> Surface:
    """A solid, shifted by a `way`, m, and then turned about the origin by a rotation (3, 3)."""
    if isinstance(solid, Box):
        return _box(turn @ (solid.centre + way), np.asarray(solid.size), np.asarray(solid.axes) @ turn.T)
    if isinstance(solid, Sphere):
        return dataclasses.replace(solid, centre=turn @ (solid.centre + way))
    assert isinstance(solid, Cylinder), "of the three kinds"
    return dataclasses.replace(solid, start=turn @ (solid.start + way), end=turn @ (solid.end + way))


def surface_of(plane: Slope | None, solids: list[Surface]) -> Surface:
    """The plane, if any, and solids as one surface.

    A box that stands on the plane, or lies against another box, reaches into it here, so that no wall is between them.
    The union keeps its shape. Raises `InputError` where two solids still have a part of a face in common.
    """
    parts = solids if plane is None else [plane, *(_into(solid, plane) for solid in solids)]
    for k in range(len(parts)):
        for other in parts[:k] + parts[k + 1 :]:
            parts[k] = _into(parts[k], other)
    return parts[0] if len(parts) == 1 else Union(tuple(parts))


def _into(box: Surface, other: Surface) -> Surface:
    """A box, longer where one of its faces lies on another solid, as far as it stays within that one."""
    if not isinstance(box, Box):
        return box
    size, axes = np.asarray(box.size, float), np.asarray(box.axes, float)
    for axis, side in itertools.product(range(3), (-1.0, 1.0)):
        centre, out = np.asarray(box.centre, float), side * axes[axis]
        face = np.asarray(box.corners, float)[CORNERS[:, axis] == side]
        within = TOUCHING * float(size.max())
        if _outside(other, face).max() > within or _outside(other, face.mean(0)[None])[0] < -within:
            continue
        for deep in size[axis] * DEPTHS:
            if _outside(other, face + deep * out).max() <= within:
                size[axis] += deep
                box = dataclasses.replace(box, centre=centre + deep / 2 * out, size=size.copy())
                break
    return box


def _outside(solid: Surface, x: np.ndarray) -> np.ndarray:
    """How far places (places, 3) are outside of a plane or a box, m, along its normals; infinite for others."""
    if isinstance(solid, Slope):
        return x @ [np.sin(solid.incline), 0.0, np.cos(solid.incline)]
    if isinstance(solid, Box):
        along = (x - np.asarray(solid.centre)) @ np.asarray(solid.axes).T
        return np.max(np.abs(along) - np.asarray(solid.size) / 2, axis=1)
    return np.full(len(x), np.inf)


def set_outside(scene: Scene, losses: Losses) -> Scene:
    """The scene, raised where it starts in its ground by little. Loses a start that is deeper."""
    assert scene.ground is not None, "with solids"
    q = np.asarray(scene.structure.nodes, float)
    size, up = float(np.ptp(q, axis=0).max()), np.array([0.0, 0.0, 1.0])
    raised = q + max(0.0, -float(scene.ground.measured(q).distance.min())) * up
    raised = np.asarray(lifted(scene, raised, 0.0))
    deep = float((raised - q)[:, 2].max())
    if deep > SMALL * size:
        losses.lose("contact", f"the robot starts {deep:.4g} m inside a solid of the world, and is pushed out of it")
    elif deep > UPRIGHT * size:
        losses.note(f"the robot starts {deep:.4g} m inside a solid of the world; here it starts on it")
    structure = dataclasses.replace(scene.structure, nodes=raised if deep > 0 else q)
    return dataclasses.replace(scene, structure=structure)


def lose_length(model: Any, geom: int, losses: Losses) -> None:
    """Loses the length of a capsule that touches more than a plane, where no rod runs between two nodes."""
    name = name_of(model, "geom", geom)
    losses.lose("contact", f"geom {name}: touches edges along its length, and its body has no site at its ends")

"""Boxes, balls and cylinders of a MuJoCo model's world, as the ground of a scene."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import jax
import lazy_loader
import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import Losses
from jaxgrity.formats.mjcf_losses import SMALL, name_of
from jaxgrity.model.placing import down
from jaxgrity.model.rod_contact import lifted, set_above, strut_distances
from jaxgrity.model.scene import Scene
from jaxgrity.model.solids import CORNERS, Box, Cylinder, Sphere
from jaxgrity.model.surface import Slope, Surface
from jaxgrity.model.unions import TOUCHING, Union

mujoco: Any = lazy_loader.load("mujoco")

UPRIGHT = 1e-9
"""Largest component of a unit vector that counts as 0. An axis is vertical if its level part is smaller."""
DEPTHS = 0.5 ** np.arange(8)
"""Shares of its length by which a solid may reach into what it lies on, tried one after the other."""


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
    vertical = np.flatnonzero(np.hypot(axes[:, 0], axes[:, 1]) < UPRIGHT)
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

    A box or a cylinder that stands on the plane or on a box reaches into it here, so that no wall is between them. So
    does a box beside another box. The union keeps its shape.

    Raises `InputError` where two solids still have a part of a face in common.
    """
    parts = solids if plane is None else [plane, *(_into(solid, plane) for solid in solids)]
    for k in range(len(parts)):
        for other in parts[:k] + parts[k + 1 :]:
            parts[k] = _into(parts[k], other)
    return parts[0] if len(parts) == 1 else Union(tuple(parts))


def _into(solid: Surface, other: Surface) -> Surface:
    """A solid, longer where one of its flat faces lies on another solid, as far as it stays within that one."""
    for axis, side in itertools.product(range(3), (-1.0, 1.0)):
        flat = _face(solid, axis, side, other)
        if flat is None:
            continue
        face, out, length, within = flat
        if _outside(other, face).max() > within or _outside(other, face.mean(0)[None])[0] < -within:
            continue
        for deep in length * DEPTHS:
            if _outside(other, face + deep * out).max() <= within:
                solid = _longer(solid, axis, side, deep * out)
                break
    return solid


def _face(solid: Surface, axis: int, side: float, other: Surface) -> tuple[np.ndarray, np.ndarray, float, float] | None:
    """A flat face: places on its rim (places, 3), m, that are the farthest outside of another solid; its outward
    normal; the solid's length along it, m; and the gap that counts as touching, m. None where there is no such face.

    Axis 2 of a cylinder is its own, and it has no faces on the others.
    """
    if isinstance(solid, Box):
        size, axes = np.asarray(solid.size, float), np.asarray(solid.axes, float)
        face = np.asarray(solid.corners, float)[CORNERS[:, axis] == side]
        return face, side * axes[axis], size[axis], TOUCHING * float(size.max())
    if not isinstance(solid, Cylinder) or float(solid.rounding) or axis != 2:
        return None
    away, end = (np.asarray(x, float) for x in (solid.start, solid.end)[:: int(side)])
    length = float(np.linalg.norm(end - away))
    out = (end - away) / length
    # a disc reaches farthest along a normal of a plane where that normal points to within the disc
    across = np.concatenate([_normals(other), np.eye(3)])
    across -= np.outer(across @ out, out)
    across = across[np.linalg.norm(across, axis=1) > UPRIGHT]
    rim = float(solid.radius) * across / np.linalg.norm(across, axis=1)[:, None]
    return end + np.concatenate([rim, -rim]), out, length, TOUCHING * length


def _longer(solid: Surface, axis: int, side: float, way: np.ndarray) -> Surface:
    """The box or cylinder of which the face of `_face` is moved by a `way`, m, outward."""
    if isinstance(solid, Box):
        size = np.asarray(solid.size, float) + np.linalg.norm(way) * np.eye(3)[axis]
        return dataclasses.replace(solid, centre=np.asarray(solid.centre, float) + way / 2, size=size)
    assert isinstance(solid, Cylinder), "the other kind with flat faces"
    end = "end" if side > 0 else "start"
    return dataclasses.replace(solid, **{end: np.asarray(getattr(solid, end), float) + way})


def _normals(solid: Surface) -> np.ndarray:
    """(k, 3), normals of a plane or, one for each axis, of a box; none of others."""
    if isinstance(solid, Slope):
        return np.array([[np.sin(solid.incline), 0.0, np.cos(solid.incline)]])
    return np.asarray(solid.axes, float) if isinstance(solid, Box) else np.zeros((0, 3))


def _outside(solid: Surface, x: np.ndarray) -> np.ndarray:
    """How far places (places, 3) are outside of a plane or a box, m, along its normals; infinite for others."""
    if isinstance(solid, Slope):
        return x @ _normals(solid)[0]
    if isinstance(solid, Box):
        along = (x - np.asarray(solid.centre)) @ _normals(solid).T
        return np.max(np.abs(along) - np.asarray(solid.size) / 2, axis=1)
    return np.full(len(x), np.inf)


def set_outside(scene: Scene, names: Sequence[str], losses: Losses) -> Scene:
    """The scene, pushed out of its ground where it starts in it by little.

    Loses a start that is deeper, and one that no push along normals of the ground ends: that is set on top. `names` are
    those of the parts of the ground.
    """
    assert scene.ground is not None, "with solids"
    q = np.asarray(scene.structure.nodes, float)
    size = float(np.ptp(q, axis=0).max())
    outside = _pushed_out(scene, q, UPRIGHT * size)
    if outside is None:
        inside = ", ".join(name for name, part in zip(names, _parts(scene)) if _nearest(part, q) < 0)
        losses.lose("contact", f"the robot starts inside {inside}, cannot be pushed out, and is set on top of it")
        with jax.enable_x64(True):
            outside = np.asarray(set_above(scene, jax.numpy.asarray(q), 0.0))
    elif (deep := float(np.linalg.norm(outside[0] - q[0]))) > SMALL * size:
        losses.lose("contact", f"the robot starts {deep:.4g} m inside a solid of the world, and is pushed out of it")
    elif deep > UPRIGHT * size:
        losses.note(f"the robot starts {deep:.4g} m inside a solid of the world; here it starts on it")
    return dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, nodes=outside))


def _pushed_out(scene: Scene, q: np.ndarray, within: float) -> np.ndarray | None:
    """Positions q, m, moved until no node or rod is deeper than `within`, m, in the ground; None if that fails."""
    assert scene.ground is not None, "with solids"
    try:
        if scene.ground.measured(q).distance.min() < 0:
            q, _ = down(q, 0.0, within, scene.ground.measured, plane=False)
        q = np.asarray(lifted(scene, q, 0.0))
    except InputError:
        return None
    return q if scene.ground.measured(q).distance.min() >= -within else None


def _parts(scene: Scene) -> list[Scene]:
    """The scene on each part of its ground alone."""
    assert scene.ground is not None, "with solids"
    assert scene.ground.surface is not None, "with solids"
    grounds = [dataclasses.replace(scene.ground, surface=part) for part in scene.ground.surface.solids]
    return [dataclasses.replace(scene, ground=ground) for ground in grounds]


def _nearest(scene: Scene, q: np.ndarray) -> float:
    """Distance of the nearest node or rod from the ground, m."""
    assert scene.ground is not None, "with solids"
    with jax.enable_x64(True):
        rods = float(strut_distances(scene, jax.numpy.asarray(q)).min())
    return min(rods, float(scene.ground.measured(q).distance.min()))


def lose_length(model: Any, geom: int, losses: Losses) -> None:
    """Loses the length of a capsule that touches more than a plane, where no rod runs between two nodes."""
    name = name_of(model, "geom", geom)
    losses.lose("contact", f"geom {name}: touches edges along its length, and its body has no site at its ends")

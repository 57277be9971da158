"""MuJoCo models whose gravity leans, or whose plane falls along another axis than x: turned into scenes."""

import dataclasses
import re
from typing import Any

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import Losses
from jaxgrity.formats.mjcf_contact import GroundFound
from jaxgrity.formats.mjcf_losses import gravity_of, name_of
from jaxgrity.formats.mjcf_solids import UPRIGHT, moved, set_outside, surface_of
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.scene import Scene
from jaxgrity.model.surface import Slope

Z = np.array([0.0, 0.0, 1.0])
PART = re.compile(r"part (\d+) \(\w+\)")
"""A part of a union, as errors say it."""


def turned_upright(model: Any, scene: Scene, found: GroundFound, losses: Losses) -> Scene:
    """The scene, turned so that gravity is along -z and the plane that was `found`, if any, falls along x.

    What else stands is turned, too, and becomes part of the ground.

    Raises `InputError` where gravity does not press on the plane, or a node slides along axes that would turn too.
    """
    g = gravity_of(model)
    up = -np.asarray(model.opt.gravity, float) / g if g else Z
    turn, normal = _onto(up, Z), Z
    if scene.ground is not None and found.normal is not None:
        normal = turn @ found.normal
        if normal[2] <= UPRIGHT:
            raise InputError(f"the plane's normal is {normal.round(4).tolist()}, z against gravity; expected z > 0")
        if abs(normal[1]) > UPRIGHT:
            level = np.array([*normal[:2], 0.0]) / np.hypot(*normal[:2])
            x = np.array([1.0, 0.0, 0.0])
            turn, normal = _onto(level, x) @ turn, _onto(level, x) @ normal
    if scene.ground is not None and not np.allclose(turn, np.eye(3), rtol=0, atol=UPRIGHT):
        losses.note("robot and plane are turned: gravity is along -z here, and the plane's normal in the x-z plane")
    elif not np.allclose(turn, np.eye(3), rtol=0, atol=UPRIGHT):
        losses.note("the robot is turned: gravity is along -z here")
    scene = _turned(scene, turn, normal)
    if not found.solids or not isinstance(scene.ground, ExactGround):
        return scene
    plane = None if found.normal is None else Slope(scene.ground.incline)
    names = ["the plane"] * bool(plane) + [f"geom {name_of(model, 'geom', geom)}" for geom in found.solids]
    try:
        surface = surface_of(plane, [moved(solid, -found.lift, turn) for solid in found.solids.values()])
    except InputError as error:
        what = PART.sub(lambda part: names[int(part[1])], str(error).removeprefix("union: "))
        losses.lose("contact", f"the world: {what}")
        return scene if plane else dataclasses.replace(scene, ground=None, friction=None)
    losses.note(f"{len(found.solids)} solids of the world (boxes, balls, cylinders) are parts of the ground")
    ground = dataclasses.replace(scene.ground, incline=0.0, surface=surface)
    return set_outside(dataclasses.replace(scene, ground=ground), names, losses)


def _onto(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(3, 3): the shortest rotation of one unit vector onto another."""
    axis, cosine = np.cross(start, end), float(start @ end)
    if cosine < UPRIGHT - 1:
        across = np.eye(3)[np.argmin(np.abs(start))]
        half = np.cross(start, across) / np.linalg.norm(np.cross(start, across))
        return 2 * np.outer(half, half) - np.eye(3)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + cosine)


def _turned(scene: Scene, turn: np.ndarray, normal: np.ndarray) -> Scene:
    structure = scene.structure
    if not np.allclose(turn, np.eye(3), rtol=0, atol=UPRIGHT):
        held = [node for node, axes in structure.fixed if set(axes) != set("xyz")]
        if held:
            raise InputError(
                f"gravity is along -z only after a turn, but node {held[0]} slides along fixed axes; expected gravity "
                "along -z, and a plane that falls along x"
            )
        nodes = np.asarray(structure.nodes) @ turn.T
        scene = dataclasses.replace(scene, structure=dataclasses.replace(structure, nodes=nodes))
    if scene.ground is None:
        return scene
    assert isinstance(scene.ground, ExactGround), "of a plane"
    incline = float(np.arctan2(normal[0], normal[2]))
    return dataclasses.replace(scene, ground=dataclasses.replace(scene.ground, incline=incline))

"""The ground of a scene as geoms of a MuJoCo model: a plane, boxes, balls, cylinders and stairs."""

from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import add_element
from jaxgrity.formats.mjcf_losses import CONTACT_TIME, contact_spring
from jaxgrity.formats.mjcf_plan import Plan
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.solids import Box, Cylinder, Sphere, Stairs
from jaxgrity.model.surface import Slope, Surface
from jaxgrity.model.unions import Union

ENDLESS = 100.0
"""Length and width of stairs in MuJoCo, m for a body of one metre. Here they have no end."""


def parts_of_ground(scene: Scene) -> list[Surface]:
    """The planes and solids of a scene's ground, stairs as boxes; none where it has other parts, or is not there."""
    if scene.ground is None:
        return []
    surface = scene.ground.surface
    parts = [Slope(scene.ground.incline)] if surface is None else [surface]
    while any(isinstance(part, Union) for part in parts):
        parts = [each for part in parts for each in (part.parts if isinstance(part, Union) else (part,))]
    size = ENDLESS * float(length_scale(scene))
    parts = [each for part in parts for each in (_blocks(part, size) if isinstance(part, Stairs) else [part])]
    known = all(isinstance(part, Slope | Box | Cylinder | Sphere) and not getattr(part, "hollow", 0) for part in parts)
    return parts if known else []


def add_ground(world: ElementTree.Element, scene: Scene, plan: Plan, time: float) -> list[str]:
    """Writes the ground, whose contact has this `time` constant, s; returns notes."""
    if scene.ground is None:
        return []
    parts = parts_of_ground(scene)
    if not parts:
        return ["the ground is neither a plane nor made of boxes, balls and cylinders, and is left out"]
    mu = min(plan.friction.values(), default=largest_friction(scene))
    bounce, own = getattr(scene.ground, "restitution", None), time != CONTACT_TIME
    flags: dict[str, Any] = {"contype": 0, "conaffinity": 1, "priority": 1, "friction": [mu, 0.0, 0.0]}
    if own or bounce is not None:
        flags["solref"] = [time, 1.0] if bounce is None else contact_spring(float(bounce), time)
    shift = np.zeros(3) if scene.ground.offset is None else np.asarray(scene.ground.offset, float)
    names = ["ground", *(f"ground{k}" for k in range(1, len(parts)))]
    for name, part in zip(names, parts):
        add_element(world, "geom", name=name, **_geom(part, plan.larger, shift), **flags)
    which = "the friction coefficients of the nodes" if plan.friction else "the friction coefficient of the scene"
    stiffness = "the time constant of its default at the robot's size" if own else "its default stiffness"
    notes = [f"contact is MuJoCo's own: soft, with {stiffness}, and with {which}"]
    if any(_rounded(part) for part in parts):
        notes.append("rounded edges of the ground are sharp there")
    if isinstance(scene.ground.surface, Stairs):
        notes.append(f"stairs are boxes there, {ENDLESS * float(length_scale(scene)):.4g} m wide and long")
    return notes


def largest_friction(scene: Scene) -> float:
    """The largest coefficient of all nodes; 0 without friction."""
    return 0.0 if scene.friction is None else float(np.max(scene.friction.sliding_mu))


def _rounded(part: Surface) -> bool:
    return float(getattr(part, "rounding", 0.0)) > 0 and not _is_capsule(part)


def _is_capsule(part: Surface) -> bool:
    return isinstance(part, Cylinder) and float(part.rounding) == float(part.radius)


def _blocks(stairs: Stairs, size: float) -> list[Surface]:
    """A level plane, and a box for each step, as long and wide as `size` (m); each reaches into the next."""
    found: list[Surface] = [Slope(0.0)]
    turn, rise = float(stairs.turn), float(stairs.rise)
    for k in range(stairs.steps):
        top, near = (k + 1) * rise, float(stairs.start) + k * float(stairs.run)
        at = (near + size / 2) * np.array([np.cos(turn), np.sin(turn), 0.0]) + [0.0, 0.0, top - rise]
        found.append(Box(at, np.array([size, size, 2 * rise]), turn, stairs.rounding))
    return found


def _geom(part: Surface, larger: float, shift: np.ndarray) -> dict[str, Any]:
    """Attributes of a geom, smaller by what balls are `larger`, m. Raises `InputError` where nothing is left of it."""
    if isinstance(part, Slope):
        n = np.array([np.sin(part.incline), 0.0, np.cos(part.incline)])
        at = (shift - larger * n + 0.0).tolist()
        return {"type": "plane", "size": [0, 0, 1], "zaxis": n.tolist(), "pos": at}
    smallest = min(np.min(getattr(part, key, np.inf)) for key in ("size", "radius"))
    if smallest <= 2 * larger:
        kind = type(part).__name__.lower()
        raise InputError(f"ground: a {kind} is {smallest:.3g} m thin; expected more than {2 * larger:.3g} m")
    if isinstance(part, Box):
        x, y, z, w = Rotation.from_matrix(np.asarray(part.axes, float).T).as_quat().tolist()
        half = np.asarray(part.size, float) / 2 - larger
        return {"type": "box", "size": half, "pos": shift + np.asarray(part.centre), "quat": [w, x, y, z]}
    if isinstance(part, Sphere):
        size = [float(part.radius) - larger]
        return {"type": "sphere", "size": size, "pos": shift + np.asarray(part.centre)}
    assert isinstance(part, Cylinder), "of the kinds of `parts_of_ground`"
    start, end = np.asarray(part.start, float) + shift, np.asarray(part.end, float) + shift
    round_end = float(part.radius) if _is_capsule(part) else larger
    into = round_end * (end - start) / np.linalg.norm(end - start)
    kind = "capsule" if _is_capsule(part) else "cylinder"
    return {"type": kind, "size": [float(part.radius) - larger], "fromto": np.r_[start + into, end - into]}

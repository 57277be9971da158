"""Files from the page: each is sent to the browser, which asks for its place."""

import dataclasses
import json
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrity.explorer.session import Rolled
from jaxgrity.io.files import plain
from jaxgrity.io.gait_library import gait_facts
from jaxgrity.io.scene_writing import scene_toml
from jaxgrity.model.external import Push, Wind
from jaxgrity.model.scene import Scene
from jaxgrity.model.shaking import Shaking
from jaxgrity.report.animation import animate
from jaxgrity.report.view import replay

Export = Callable[[Rolled, str], bytes]
"""Function that makes the contents of a file from what is shown and the name of its scene."""


def gait_file(rolled: Rolled, scene: str) -> bytes:
    """The gait, for `--gait gait.json` of every command."""
    assert rolled.scene.gait is not None, "the explorer's scenes have a gait"
    return json.dumps(
        plain({"scene": scene, **gait_facts(rolled.scene.gait, rolled.scene.structure)}), indent=1
    ).encode()


def scene_text_of(rolled: Rolled, scene: str) -> bytes:
    """The robot, its ground and its gait. Raises `InputError` for a part without keys in scene files."""
    return scene_toml(upright(rolled.scene)).encode()


def upright(scene: Scene) -> Scene:
    """The scene turned about the y axis until up is z again; its plane is inclined by as much more.

    Winds, pushes and shaking turn with it. A scene whose gravity leans another way, whose ground is no plane, or with
    supports along some axes alone, is left as it is where it leans at all.
    """
    if scene.up is None:
        return scene
    x, y, z = np.asarray(scene.up, float)
    lean = math.atan2(-x, z)
    if lean == 0 and y == 0:
        return dataclasses.replace(scene, up=None)
    free = scene.structure.free
    if y or scene.ground is None or scene.ground.surface is not None or np.any(free.any(1) & ~free.all(1)):
        return scene
    turn = np.array([[math.cos(lean), 0, math.sin(lean)], [0, 1, 0], [-math.sin(lean), 0, math.cos(lean)]])
    structure = dataclasses.replace(scene.structure, nodes=np.asarray(scene.structure.nodes) @ turn.T)
    inclined: dict[str, Any] = {"incline": scene.ground.incline + lean}
    ground = dataclasses.replace(scene.ground, **inclined)
    terms = tuple(_turned(term, turn) for term in scene.terms)
    shaking = _turned(scene.shaking, turn)
    return dataclasses.replace(scene, structure=structure, ground=ground, up=None, terms=terms, shaking=shaking)


def _turned(part: Any, turn: np.ndarray) -> Any:
    """A law, or the motion of supports, with its direction turned."""
    for kind, name in ((Wind, "velocity"), (Push, "force"), (Shaking, "amplitude")):
        if isinstance(part, kind):
            return dataclasses.replace(part, **{name: np.asarray(getattr(part, name)) @ turn.T})
    return part


def replay_file(rolled: Rolled, scene: str) -> bytes:
    """The motion in 3D."""
    return replay(rolled.scene, rolled.trajectory, title=scene).page.encode()


def animation_file(rolled: Rolled, scene: str) -> bytes:
    """The motion as a GIF."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "animation.gif"
        animate(rolled.scene, rolled.trajectory, path, camera="follow")
        return path.read_bytes()


EXPORTS: dict[str, Export] = {
    "gait.json": gait_file,
    "scene.toml": scene_text_of,
    "replay.html": replay_file,
    "animation.gif": animation_file,
}
"""The functions that make files, by the names of the files."""

"""Structures as meshes (GLB, OBJ), for pictures and for printing. Extra: `view`."""

import importlib.util
from pathlib import Path
from typing import Any

import lazy_loader
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.io.files import write_whole
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import edge_lengths

trimesh: Any = lazy_loader.load("trimesh")

STRUT, CABLE = 0.012, 0.004
"""Radii of struts and cables, as shares of the length of the longest strut."""
COLOURS = {"struts": (52, 73, 94, 255), "cables": (192, 57, 43, 255)}
"""Red, green, blue and opacity of struts and cables, from 0 to 255."""
SIDES = 16
"""Number of sides of the prisms that stand for round struts and cables."""


@typed
def save_mesh(scene: Scene, path: str | Path) -> tuple[str, ...]:
    """Write a structure in its initial shape as a mesh: struts and cables are round bars, struts thicker.

    GLB files have y up, as glTF asks; OBJ files z up, as scenes do. Lengths are in metres. Returns sentences on what
    such a file does not hold. Raises `InputError` for another ending, without trimesh or without members.
    """
    path = Path(path)
    if path.suffix not in (".glb", ".obj"):
        raise InputError(f"{path}: unknown ending of a mesh; expected .glb or .obj")
    if importlib.util.find_spec("trimesh") is None:
        raise InputError(f"{path}: meshes need trimesh; expected: pip install 'jaxgrity[view]'")
    structure, x = scene.structure, np.asarray(scene.structure.nodes, float)
    longest = structure.struts or structure.cables
    if longest is None:
        raise InputError(f"{path}: the structure has no members; expected some to draw")
    size = float(edge_lengths(x, longest.edges).max())
    content = trimesh.Scene()
    for kind, members, _ in structure.numbered:
        share = STRUT if kind == "struts" else CABLE
        bars = [trimesh.creation.cylinder(share * size, segment=x[list(e)], sections=SIDES) for e in members.edges]
        mesh = trimesh.util.concatenate(bars)
        mesh.visual.face_colors = COLOURS[kind]
        content.add_geometry(mesh, geom_name=kind)
    if path.suffix == ".glb":
        content.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
        data = content.export(file_type="glb")
    else:
        data = content.to_mesh().export(file_type="obj", include_color=False).encode()
    write_whole(path, lambda file: file.write(data))
    return ("a mesh holds the shape alone: no masses, springs or motion",)

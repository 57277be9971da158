"""A robot and its ground in a 3D scene of viser: parts are made once, and moved from frame to frame."""

from typing import Any

import lazy_loader
import matplotlib
import numpy as np

from jaxgrity.model.scene import Scene
from jaxgrity.model.solids import Box, Cylinder, Sphere
from jaxgrity.report.poses import NODE_RADIUS, RobotPoses, Rods, robot_size
from jaxgrity.report.style import FORCE, GROUND, PATH, STRUT, SUPPORT

trimesh = lazy_loader.load("trimesh")

WORLD = "/world"
"""Name of the frame of all that is shown. A camera that follows is a world that moves the other way."""
WAY = "#3b5bdb"
"""Colour of lines that are shown beside a robot."""
ABOVE = 4e-3
"""Height of the path above the ground, in robot sizes: a line within it would flicker."""
ABOUT, CELL, MOST_CELLS = 3.0, 0.1, 160
"""Margin of uneven ground about a path and size of its cells, in robot sizes, and most cells along a side."""
SIDES = 12
"""Number of sides with which round bodies are drawn."""


def colour(name: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255."""
    red, green, blue = (round(255 * x) for x in matplotlib.colors.to_rgb(name))
    return red, green, blue


def turn_to_z(direction: np.ndarray) -> np.ndarray:
    """The quaternion (w, x, y, z) of the turn of a unit vector to z; not of one straight down."""
    turn = np.array([1 + direction[2], direction[1], -direction[0], 0.0])
    return turn / np.linalg.norm(turn)


class World:
    """The frame in which robots and their ground stand."""

    def __init__(self, scene_api: Any, scene: Scene):
        self._api, self._size = scene_api, robot_size(scene)
        self._frame = scene_api.add_frame(WORLD, show_axes=False)
        # where the ground leans more than its file says, gravity leans in the scene: here the world does
        up = np.array([0.0, 0.0, 1.0]) if scene.up is None else np.asarray(scene.up, float)
        self.lean(up)
        if scene.ground is not None and scene.ground.surface is None:
            tilt = turn_to_z(np.array(scene.ground.normal)) * np.array([1, -1, -1, -1])
            scene_api.add_grid(
                f"{WORLD}/ground",
                wxyz=tilt,
                infinite_grid=True,
                cell_size=self._size / 2,
                section_size=self._size,
                cell_color=colour("#bdb7a8"),
                section_color=colour("#989180"),
                plane_color=colour(GROUND),
                plane_opacity=0.9,
                shadow_opacity=0.35,
                fade_distance=25 * self._size,
            )

    def draw_ground(self, scene: Scene, places: np.ndarray) -> None:
        """Uneven ground about `places`, (places, 3), m, out to a robot's horizon; a plane is there already."""
        if scene.ground is None or scene.ground.surface is None:
            return
        size = robot_size(scene)
        low, high = places[:, :2].min(0) - ABOUT * size, places[:, :2].max(0) + ABOUT * size
        counts = np.clip(np.ceil((high - low) / (CELL * size)).astype(int), 2, MOST_CELLS)
        sides = [np.linspace(low[k], high[k], counts[k] + 1) for k in (0, 1)]
        x, y = np.meshgrid(sides[0], sides[1], indexing="ij")
        z = scene.ground.height(x.ravel(), y.ravel())
        first = np.arange(x.size).reshape(x.shape)[:-1, :-1].ravel()
        beside = x.shape[1]
        faces = np.concatenate([first[:, None] + [0, beside, 1], first[:, None] + [1, beside, beside + 1]])
        there = np.isfinite(z)
        self._api.add_mesh_simple(
            f"{WORLD}/ground",
            np.stack([x.ravel(), y.ravel(), np.where(there, z, 0.0)], axis=1).astype(np.float32),
            faces[there[faces].all(1)],
            color=colour(GROUND),
            flat_shading=True,
            side="double",
        )

    def draw_solid(self, name: str, solid: Box | Cylinder | Sphere) -> None:
        """An obstacle."""
        mesh = _solid(solid)
        self._api.add_mesh_simple(
            f"{WORLD}/{name}", mesh.vertices, mesh.faces, color=colour("#8d8674"), flat_shading=True
        )

    def draw_way(self, name: str, points: np.ndarray) -> None:
        """A line through `points`, (points, 3), m."""
        pieces = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        self._api.add_line_segments(f"{WORLD}/{name}", pieces, colors=colour(WAY), thickness=0.02 * self._size)

    def lean(self, up: np.ndarray) -> None:
        """Turn the world so that this unit vector points up."""
        self._frame.wxyz = turn_to_z(up)
        w, x, y, z = turn_to_z(up)
        vector = np.array([x, y, z])
        self._rotate = lambda p: p + 2 * np.cross(vector, np.cross(vector, p) + w * p)

    def look_at(self, point: np.ndarray) -> None:
        """Move this point of the world to the camera's aim."""
        self._frame.position = -self._rotate(np.asarray(point, float))


class RobotDrawing:
    """One robot's parts in a 3D scene, by a name of its own."""

    def __init__(self, scene_api: Any, name: str, scene: Scene, first: RobotPoses, opacity: float = 1.0):
        self._api, self._root, self._opacity = scene_api, f"{WORLD}/{name}", None if opacity == 1 else opacity
        size, struts = robot_size(scene), scene.structure.first_cable
        self._size = size
        rod = trimesh.creation.cylinder(1.0, segment=[[0, 0, 0], [0, 0, 1]], sections=SIDES)
        ball = trimesh.creation.icosphere(subdivisions=2, radius=NODE_RADIUS * size)
        self._kinds = {"struts": slice(0, struts), "cables": slice(struts, None)}
        self._members = {
            kind: self._rods(kind, rod, _some(first.members, rows), first.colours[0, rows])
            for kind, rows in self._kinds.items()
            if first.colours[0, rows].size
        }
        red = colour(STRUT)
        self._bodies = self._rods("rigid bodies", rod, first.bodies, red) if scene.structure.bodies else None
        sliding = first.sleeves.position.shape[1] > 0
        self._sleeves = self._rods("sliding nodes", rod, first.sleeves, colour("#111111")) if sliding else None
        self._nodes = self._batch("nodes", ball, first.nodes[0], colour("#111111"))
        self._centre = self._batch("centre of mass", ball, first.centre[:1], colour(PATH))
        self._forces = self._rods("ground forces", _arrow(), first.ground_forces, colour(FORCE))
        corners = first.support[0]
        fan = [(0, k, k + 1) for k in range(1, len(corners) - 1)]
        self._support = scene_api.add_mesh_simple(
            f"{self._root}/support polygon",
            corners,
            np.array(fan or [(0, 0, 0)]),
            color=colour(SUPPORT),
            opacity=0.45,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        self._path: Any = None
        self.draw_path(first)

    def draw_path(self, poses: RobotPoses) -> None:
        """The path of the centre of mass, on the ground."""
        points = np.stack([poses.below[:-1], poses.below[1:]], axis=1).astype(np.float32)
        points[..., 2] += ABOVE * self._size
        self._path = self._api.add_line_segments(
            f"{self._root}/path of the centre of mass", points, colors=colour(PATH), thickness=0.012 * self._size
        )

    def show(self, poses: RobotPoses, frame: int) -> None:
        """Move everything to its place in this frame."""
        for kind, handle in self._members.items():
            rows = self._kinds[kind]
            _place(handle, _some(poses.members, rows), frame)
            if kind == "cables":
                handle.batched_colors = poses.colours[frame, rows]
        for handle, parts in ((self._bodies, poses.bodies), (self._sleeves, poses.sleeves)):
            if handle is not None:
                _place(handle, parts, frame)
        self._nodes.batched_positions = _single(poses.nodes[frame])
        self._centre.batched_positions = _single(poses.centre[frame][None])
        _place(self._forces, poses.ground_forces, frame)
        self._support.vertices = _single(poses.support[frame])

    def _rods(self, name: str, mesh: Any, rods: Rods, colours: Any) -> Any:
        return self._batch(name, mesh, rods.position[0], colours, turn=rods.turn[0], scale=rods.scale[0])

    def _batch(self, name: str, mesh: Any, position: np.ndarray, colours: Any, **posed: np.ndarray) -> Any:
        upright = np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (len(position), 1))
        return self._api.add_batched_meshes_simple(
            f"{self._root}/{name}",
            mesh.vertices,
            mesh.faces,
            batched_positions=position,
            batched_wxyzs=posed.get("turn", upright),
            batched_scales=posed.get("scale", np.ones_like(position)),
            batched_colors=colours,
            opacity=self._opacity,
            lod="off",
            flat_shading=False,
        )


def _solid(part: Box | Cylinder | Sphere) -> Any:
    """The mesh of an obstacle."""
    if isinstance(part, Cylinder):
        ends = [np.asarray(part.start, float), np.asarray(part.end, float)]
        return trimesh.creation.cylinder(float(part.radius), segment=ends, sections=4 * SIDES)
    if isinstance(part, Sphere):
        ball = trimesh.creation.icosphere(subdivisions=3, radius=float(part.radius))
        return ball.apply_translation(np.asarray(part.centre, float))
    turned = np.eye(4)
    turned[:3, :3], turned[:3, 3] = np.asarray(part.axes, float).T, np.asarray(part.centre, float)
    return trimesh.creation.box(np.asarray(part.size, float), transform=turned)


def _arrow() -> Any:
    """One unit long, its shaft one unit thick."""
    shaft = trimesh.creation.cylinder(1.0, segment=[[0, 0, 0], [0, 0, 0.75]], sections=SIDES)
    head = trimesh.creation.cone(2.4, 0.25, sections=SIDES)
    return trimesh.util.concatenate([shaft, head.apply_translation([0, 0, 0.75])])


def _some(rods: Rods, rows: slice) -> Rods:
    return Rods(*(x[:, rows] for x in rods))


def _place(handle: Any, rods: Rods, frame: int) -> None:
    handle.batched_positions = _single(rods.position[frame])
    handle.batched_wxyzs = _single(rods.turn[frame])
    handle.batched_scales = _single(rods.scale[frame])


def _single(x: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(x, np.float32)

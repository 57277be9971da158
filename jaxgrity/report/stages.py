"""Drawing of a motion, picture by picture: all of it between axes, or before a camera that follows."""

from abc import ABC, abstractmethod

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from PIL import Image

from jaxgrity.core.display import significant
from jaxgrity.model.scene import Scene
from jaxgrity.report.poses import robot_size
from jaxgrity.report.robot_plot import draw_robot, drawn_lines, side_view
from jaxgrity.report.style import GROUND, PATH, styled
from jaxgrity.stepping.simulate import Trajectory, centre_path

PATCHES = 60
"""Number of patches along each side of uneven ground."""
VIEW = 4.5
"""Distance to which the following camera sees the lines on the ground, in robot sizes."""
SHADOW, LINES = "#00000030", "#8a8371"
"""Colours of the shadow, which lets the ground through, and of the lines on the ground."""


class Stage(ABC):
    """Draws one saved frame after the other."""

    @abstractmethod
    def picture(self, k: int) -> Image.Image:
        """The saved frame `k`."""


class WholeStage(Stage):
    """A figure with only its moving parts drawn anew for each picture: axes and ground take most of the time."""

    @styled
    def __init__(self, scene: Scene, trajectory: Trajectory, width: int):
        self._positions, self._times = np.asarray(trajectory.positions), np.asarray(trajectory.times)
        self._centre = centre_path(scene, trajectory)
        self._ground = scene.ground
        self._edges = [edges for edges, *_ in drawn_lines(scene.structure)]
        figure = Figure(figsize=(6, 4.2), dpi=width / 6, layout="constrained")
        self._canvas = FigureCanvasAgg(figure)
        self._axes = self._empty_axes(figure)
        self._trail = self._axes.plot([], [], [], color=PATH, linewidth=1.5)[0]
        *self._members, self._nodes = draw_robot(self._axes, scene, self._positions[0])
        self._title = self._axes.set_title(caption(self._times, self._centre, 0))
        # Artists that are drawn one by one have to be put into Matplotlib's order, back to front, beforehand.
        self._moving = sorted([self._trail, self._nodes, *self._members, self._title], key=Artist.get_zorder)
        for artist in self._moving:
            artist.set(animated=True, clip_on=False)
        self._canvas.draw()
        figure.set_layout_engine("none")
        self._background = self._canvas.copy_from_bbox(figure.bbox)

    def _empty_axes(self, figure: Figure) -> Axes3D:
        """Axes around the whole motion, and the ground."""
        # Sorted by their depths, the ground could hide the robot that stands on it.
        axes = figure.add_subplot(projection="3d", computed_zorder=False)
        q, centre = self._positions, self._centre
        size = np.ptp(q[0], axis=0).max()
        low, high = centre[:, :2].min(0) - 0.8 * size, centre[:, :2].max(0) + 0.8 * size
        bottom, top = min(0.0, float(q[..., 2].min())), float(q[..., 2].max())
        if self._ground is not None:
            uneven = self._ground.surface is not None
            x, y = np.meshgrid(*np.linspace(low, high, PATCHES if uneven else 2).T)
            z = self._ground.height(x, y)
            z[~np.isfinite(z)] = np.nan
            ground = axes.plot_surface(
                x, y, z, color=GROUND, alpha=0.6, shade=uneven, rcount=PATCHES, ccount=PATCHES, linewidth=0
            )
            # Zoomed, the axes reach beyond their rectangle, which would cut off the ground's corners and the robot.
            ground.set_clip_on(False)
            if uneven:
                bottom, top = min(bottom, float(np.nanmin(z))), max(top, float(np.nanmax(z)))
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(bottom, top), xlabel="x (m)", ylabel="y (m)")
        axes.set_box_aspect((*(high - low), top - bottom), zoom=1.2)
        axes.view_init(elev=28, azim=side_view(centre))
        return axes

    def picture(self, k: int) -> Image.Image:
        """The saved frame `k`."""
        q, (x, y, _) = self._positions[k], self._centre[: k + 1].T
        for lines, edges in zip(self._members, self._edges):
            lines.set_segments(q[edges])
        self._nodes._offsets3d = tuple(q.T)  # Matplotlib has no public way to move 3D markers
        for artist in (*self._members, self._nodes):
            artist.do_3d_projection()
        z = 0 * x if self._ground is None else self._ground.height(x, y)
        self._trail.set_data_3d(x, y, np.where(np.isfinite(z), z, np.nan))
        self._title.set_text(caption(self._times, self._centre, k))
        self._canvas.restore_region(self._background)
        for artist in self._moving:
            self._axes.draw_artist(artist)
        return Image.fromarray(np.asarray(self._canvas.buffer_rgba())).convert("RGB")


class FollowingStage(Stage):
    """The robot large in the middle, its shadow, its path and lines on the ground, from a camera that follows."""

    @styled
    def __init__(self, scene: Scene, trajectory: Trajectory, width: int):
        self._scene, self._size = scene, robot_size(scene)
        self.follow(trajectory)
        self._lines = drawn_lines(scene.structure)
        figure = Figure(figsize=(6, 3.4), dpi=width / 6)
        self._canvas = FigureCanvasAgg(figure)
        axes = figure.add_subplot(projection="3d", computed_zorder=False, position=(0, 0, 1, 1))
        half, middle = 0.9 * self._size, 0.5 * self._size
        axes.set(xlim=(-half, half), ylim=(-half, half), zlim=(middle - half, middle + half))
        axes.set_box_aspect((1, 1, 1), zoom=1.6)
        axes.set_proj_type("persp", focal_length=0.8)
        axes.view_init(elev=16, azim=side_view(self._centre))
        axes.set_axis_off()
        nowhere = np.zeros((1, 2, 3))
        self._grid, self._shadow = Line3DCollection(nowhere, linewidths=0.8), Line3DCollection(nowhere, colors=SHADOW)
        for order, lines in enumerate((self._grid, self._shadow)):
            axes.add_collection3d(lines)
            lines.set_zorder(order)
        self._trail = axes.plot([], [], [], color=PATH, linewidth=2, zorder=2)[0]
        *self._members, self._nodes = draw_robot(axes, scene, self._positions[0])
        for order, artist in enumerate((*reversed(self._members), self._nodes), start=3):
            artist.set_zorder(order)
        # Matplotlib draws 3D axes as a square, to which all would be cut off
        for artist in (self._grid, self._shadow, self._trail, *self._members, self._nodes):
            artist.set_clip_on(False)
        self._title = figure.text(0.5, 0.95, "", ha="center", va="top", fontsize=12)

    def follow(self, trajectory: Trajectory) -> None:
        """Show this motion from now on, from the same side as before."""
        self._positions, self._times = np.asarray(trajectory.positions), np.asarray(trajectory.times)
        self._centre = centre_path(self._scene, trajectory)

    def picture(self, k: int) -> Image.Image:
        """The saved frame `k`."""
        here = self._on_ground(self._centre[k : k + 1])[0]
        q = self._positions[k] - here
        for artist, (edges, *_) in zip(self._members, self._lines):
            artist.set_segments(q[edges])
        self._nodes._offsets3d = tuple(q.T)  # Matplotlib has no public way to move 3D markers
        if self._scene.ground is not None:
            self._show_ground(here)
            below = self._on_ground(self._positions[k]) - here
            self._shadow.set_segments(np.concatenate([below[edges] for edges, *_ in self._lines]))
            self._shadow.set_linewidth(np.concatenate([np.full(len(edges), w) for edges, _, w in self._lines]))
        self._trail.set_data_3d(*(self._on_ground(self._centre[: k + 1]) - here).T)
        self._title.set_text(caption(self._times, self._centre, k))
        self._canvas.draw()
        return Image.fromarray(np.asarray(self._canvas.buffer_rgba())).convert("RGB")

    def _on_ground(self, points: np.ndarray) -> np.ndarray:
        """The points of the ground below; where there is none, of a plane below all of the motion."""
        x, y, ground = points[:, 0], points[:, 1], self._scene.ground
        z = np.full(len(x), -np.inf) if ground is None else ground.height(x, y)
        return np.stack([x, y, np.where(np.isfinite(z), z, self._positions[..., 2].min())], axis=-1)

    def _show_ground(self, here: np.ndarray) -> None:
        """Fixed lines half a robot apart; they fade with their distance from the camera's aim."""
        spacing, reach = self._size / 2, VIEW * self._size
        along = np.linspace(-reach, reach, 37)
        pieces = []
        for axis in (0, 1):
            first, last = np.ceil((here[axis] - reach) / spacing), np.floor((here[axis] + reach) / spacing)
            for across in spacing * np.arange(first, last + 1):
                points = np.empty((len(along), 2))
                points[:, axis], points[:, 1 - axis] = across, here[1 - axis] + along
                line = self._on_ground(points) - here
                pieces.append(np.stack([line[:-1], line[1:]], axis=1))
        segments = np.concatenate(pieces)
        away = np.linalg.norm(segments.mean(1)[:, :2], axis=-1) / reach
        colours = np.tile(to_rgba(LINES), (len(segments), 1))
        colours[:, 3] = np.clip(1 - away, 0, 1) ** 1.5
        self._grid.set_segments(segments)
        self._grid.set_color(colours)


def caption(times: np.ndarray, centre: np.ndarray, k: int) -> str:
    """Time and horizontal distance from the start, in saved frame `k`."""
    distance = np.hypot(*(centre[k] - centre[0])[:2])
    return f"t = {significant(float(times[k]), 1, 2)} s, {significant(float(distance), 2)} m from the start"

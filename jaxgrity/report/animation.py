"""An animated picture of a motion: the robot on its ground and the path of its centre of mass, as a GIF."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path as FilePath
from typing import IO

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from PIL import Image

from jaxgrity.core.errors import InputError
from jaxgrity.io.files import write_whole
from jaxgrity.model.scene import Scene
from jaxgrity.report.plot import GROUND, PATH, draw_robot
from jaxgrity.stepping.simulate import Trajectory, centre_path

TICK = 0.01
"""s; the unit in which a GIF counts how long a frame is shown"""
COLOURS = 255
"""in the one palette of all frames; the last of its 256 places stands for what did not change since the frame before"""


def animate(
    scene: Scene,
    trajectory: Trajectory,
    path: str | FilePath,
    frame_rate: float = 12.5,
    on_frame: Callable[[int, int], object] | None = None,
) -> None:
    """Write a GIF of the motion in real time, over and over, seen from the side with the motion to the right.

    It shows struts (red, thick), cables (dark, thin), nodes, ground and the path of the centre of mass as it grows,
    projected onto the ground, between axes in metres; the title gives time (s) and horizontal distance (m) from the
    start. The file appears whole or not at all.

    Arguments:
        scene: what moves; the ground is drawn where the scene has one.
        trajectory: how it moves.
        path: the file to write; its folder is made where there is none.
        frame_rate: frames a second, of those that the trajectory saved the nearest. Beyond 100 it changes nothing,
            since a GIF counts time in hundredths of a second.
        on_frame: called with how many frames have been drawn, and how many there are: at first, and after each.

    Returns:
        Nothing: the result is the file.

    Raises:
        InputError: where `frame_rate` is not a positive, finite number, or a position is not finite.
    """
    if not (math.isfinite(frame_rate) and frame_rate > 0):
        raise InputError(f"frame_rate = {frame_rate:g}: expected a positive, finite number of frames a second")
    times = np.asarray(trajectory.times, float)
    finite = np.isfinite(np.asarray(trajectory.positions)).all((1, 2))
    if not finite.all():
        raise InputError(f"the motion is not finite from t = {times[finite.argmin()]:g} s on: expected one that is")
    shown, durations = _shown_frames(times, frame_rate)
    stage = _Stage(scene, trajectory)
    palette = _shared_palette([stage.picture(k) for k in (shown[0], shown[len(shown) // 2], shown[-1])])

    def frames() -> Iterator[Image.Image]:
        for drawn, k in enumerate(shown):
            if on_frame is not None:
                on_frame(drawn, len(shown))
            yield stage.picture(k).quantize(palette=palette, dither=Image.Dither.NONE)
        if on_frame is not None:
            on_frame(len(shown), len(shown))

    write_whole(path, lambda file: _write_gif(file, frames(), durations))


def _shown_frames(times: np.ndarray, frame_rate: float) -> tuple[list[int], list[int]]:
    """The saved frames nearest to those asked for, by their indices, and how long each is shown, ms.

    Durations are differences of rounded times, so that they add up to that of the motion, whatever the rate.
    """
    duration = times[-1] - times[0]
    interval = max(min(1 / frame_rate, duration), TICK)
    # Single precision may put the end a little late, which must not add a frame.
    wanted = interval * np.arange(max(1, math.ceil(duration / interval - 1e-3)))
    nearest = np.searchsorted((times[1:] + times[:-1]) / 2 - times[0], wanted)
    # Where fewer frames were saved than are asked for, each is shown once, for longer.
    shown, first = np.unique(nearest, return_index=True)
    ticks = np.diff(np.round(np.append(wanted[first], duration) / TICK))
    return shown.tolist(), [10 * max(1, int(n)) for n in ticks]


class _Stage:
    """A figure of which only what moves is drawn anew for each picture: axes and ground take most of the time."""

    def __init__(self, scene: Scene, trajectory: Trajectory):
        self._positions, self._times = np.asarray(trajectory.positions), np.asarray(trajectory.times)
        self._centre = centre_path(scene, trajectory)
        self._slope = 0.0 if scene.ground is None else math.tan(scene.ground.incline)
        self._edges = [np.asarray(m.edges) for m in (scene.structure.struts, scene.structure.cables) if m is not None]
        figure = Figure(figsize=(6, 4.2), dpi=80, layout="constrained")
        self._canvas = FigureCanvasAgg(figure)
        self._axes = self._empty_axes(figure, has_ground=scene.ground is not None)
        self._trail = self._axes.plot([], [], [], color=PATH, linewidth=1.5)[0]
        *self._members, self._nodes = draw_robot(self._axes, scene, self._positions[0])
        self._title = self._axes.set_title(self._caption(0))
        # Artists that are drawn one by one have to be put into Matplotlib's order, back to front, beforehand.
        self._moving = sorted([self._trail, self._nodes, *self._members, self._title], key=Artist.get_zorder)
        for artist in self._moving:
            artist.set(animated=True, clip_on=False)
        self._canvas.draw()
        figure.set_layout_engine("none")
        self._background = self._canvas.copy_from_bbox(figure.bbox)

    def _empty_axes(self, figure: Figure, has_ground: bool) -> Axes3D:
        """Axes that hold the whole motion, and the ground."""
        # Sorted by their depths, the ground could hide the robot that stands on it.
        axes = figure.add_subplot(projection="3d", computed_zorder=False)
        q, centre = self._positions, self._centre
        size = np.ptp(q[0], axis=0).max()
        low, high = centre[:, :2].min(0) - 0.8 * size, centre[:, :2].max(0) + 0.8 * size
        if has_ground:
            x, y = np.meshgrid(*np.stack([low, high]).T)
            ground = axes.plot_surface(x, y, -self._slope * x, color=GROUND, alpha=0.6, shade=False)
            # Zoomed, the axes reach beyond their rectangle, which would cut off the ground's corners and the robot.
            ground.set_clip_on(False)
        bottom, top = min(0.0, float(q[..., 2].min())), float(q[..., 2].max())
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(bottom, top), xlabel="x (m)", ylabel="y (m)")
        axes.set_box_aspect((*(high - low), top - bottom), zoom=1.2)
        axes.view_init(elev=28, azim=_side_view(centre))
        return axes

    def _caption(self, k: int) -> str:
        """Time and horizontal distance from the start, in saved frame `k`."""
        distance = np.hypot(*(self._centre[k] - self._centre[0])[:2])
        return f"t = {self._times[k]:.1f} s, {distance:.2f} m from the start"

    def picture(self, k: int) -> Image.Image:
        """The saved frame `k`."""
        q, (x, y, _) = self._positions[k], self._centre[: k + 1].T
        for lines, edges in zip(self._members, self._edges):
            lines.set_segments(q[edges])
        self._nodes._offsets3d = tuple(q.T)  # Matplotlib has no public way to move 3D markers
        for artist in (*self._members, self._nodes):
            artist.do_3d_projection()
        self._trail.set_data_3d(x, y, -self._slope * x)
        self._title.set_text(self._caption(k))
        self._canvas.restore_region(self._background)
        for artist in self._moving:
            self._axes.draw_artist(artist)
        return Image.fromarray(np.asarray(self._canvas.buffer_rgba())).convert("RGB")


def _side_view(centre: np.ndarray) -> float:
    """The azimuth, in degrees, from which the motion runs across the picture."""
    x, y = (centre[-1] - centre[0])[:2]
    return float(np.degrees(np.arctan2(y, x))) - 75


def _shared_palette(pictures: list[Image.Image]) -> Image.Image:
    """A picture whose palette fits those given."""
    together = Image.fromarray(np.concatenate([np.asarray(picture) for picture in pictures]))
    return together.quantize(COLOURS, Image.Quantize.MAXCOVERAGE)


def _write_gif(file: IO[bytes], frames: Iterator[Image.Image], durations: list[int]) -> None:
    """Write frames that have one palette, each as what changed since the one before; durations in ms."""
    first = next(frames)
    first.save(
        file,
        format="GIF",
        save_all=True,
        append_images=frames,
        duration=durations,
        loop=0,
        palette=first.getpalette(),
        transparency=COLOURS,
        optimize=True,
    )

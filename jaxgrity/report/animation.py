"""An animated picture of a motion: the robot on its ground and the path of its centre of mass, as a GIF or MP4."""

import importlib.util
import math
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path as FilePath
from typing import IO

import lazy_loader
import numpy as np
from PIL import Image

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.io.files import check_file, write_whole
from jaxgrity.model.scene import Scene
from jaxgrity.report.poses import check_motion
from jaxgrity.report.stages import FollowingStage, Stage, WholeStage
from jaxgrity.stepping.simulate import Trajectory

imageio_ffmpeg = lazy_loader.load("imageio_ffmpeg")

TICK = 0.01
"""Unit in which a GIF counts how long a frame is shown, s."""
PALETTES = {"whole": 255, "follow": 63}
"""Number of colours in the palette of a GIF, by its camera. Pictures in which everything moves are large, so that they
get fewer; one further place stands for what did not change."""


@typed
def animate(
    scene: Scene,
    trajectory: Trajectory,
    path: str | FilePath,
    frame_rate: float = 12.5,
    on_frame: Callable[[int, int], object] | None = None,
    width: int = 480,
    camera: str = "whole",
) -> None:
    """Write a film of the motion in real time, from the side, with the motion to the right.

    A GIF in a loop, or an MP4 for a file name with that ending, with imageio-ffmpeg installed.

    It shows struts (red, thick), cables (dark, thin), nodes and ground, between axes in metres. The path of the centre
    of mass grows on the ground. The title gives time (s) and horizontal distance (m) from the start. The file appears
    whole or not at all.

    Args:
        scene: the robot, and its ground where it has one.
        trajectory: the motion.
        path: the file to write; a missing folder is made.
        frame_rate: frames per second; the nearest saved frames are shown. Above 100 it has no effect, since a GIF
            counts time in hundredths of a second.
        on_frame: called with the numbers of drawn frames and of all frames, at first and after each frame.
        width: pixels; the height is 0.7 of it, or 0.57 for a camera that follows.
        camera: "whole" shows all of the crossed ground, between axes. "follow" moves with the robot, and shows it
            larger, with its shadow, over lines half a robot apart.

    Raises:
        InputError: a `frame_rate` that is not positive and finite, a `width` that is not from 100 to 4000, or another
            `camera`. A position that is not finite. An MP4 without imageio-ffmpeg installed. A path that is a folder.
    """
    film = check_film(path, frame_rate, width, camera)
    check_motion(trajectory)
    times = np.asarray(trajectory.times, float)
    stage = (FollowingStage if camera == "follow" else WholeStage)(scene, trajectory, width)
    if film:
        _write_film(path, (stage, times), frame_rate, on_frame)
        return
    shown, durations = _shown_frames(times, frame_rate)
    palette = _shared_palette(
        [stage.picture(k) for k in (shown[0], shown[len(shown) // 2], shown[-1])], PALETTES[camera]
    )

    def frames() -> Iterator[Image.Image]:
        for drawn, k in enumerate(shown):
            if on_frame is not None:
                on_frame(drawn, len(shown))
            yield stage.picture(k).quantize(palette=palette, dither=Image.Dither.NONE)
        if on_frame is not None:
            on_frame(len(shown), len(shown))

    write_whole(path, lambda file: _write_gif(file, frames(), durations, PALETTES[camera]))


def check_film(path: str | FilePath, frame_rate: float, width: int, camera: str) -> bool:
    """Whether a film is asked for, not a GIF. Raises `InputError` as `animate` says."""
    if not (math.isfinite(frame_rate) and frame_rate > 0):
        raise InputError(f"frame_rate = {frame_rate:g}: expected a positive, finite number of frames a second")
    if not 100 <= width <= 4000:
        raise InputError(f"width = {width}: expected 100 to 4000 pixels")
    if camera not in PALETTES:
        raise InputError(f"camera = {camera!r}: expected {' or '.join(PALETTES)}")
    check_file(path)
    film = FilePath(path).suffix.lower() == ".mp4"
    if film and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise InputError(
            f"{path}: MP4 needs imageio-ffmpeg, which is not installed; expected: pip install 'jaxgrity[video]'"
        )
    return film


def _write_film(
    path: str | FilePath,
    motion: tuple[Stage, np.ndarray],
    frame_rate: float,
    on_frame: Callable[[int, int], object] | None,
) -> None:
    """An MP4 at a steady rate: of the saved frames each time the nearest."""
    stage, times = motion
    middle = (times[1:] + times[:-1]) / 2
    shown = np.searchsorted(middle, np.arange(times[0], times[-1], 1 / frame_rate)).tolist()
    width, height = (2 * (side // 2) for side in stage.picture(0).size)  # H.264 counts pixels in pairs
    with tempfile.TemporaryDirectory() as folder:
        file = FilePath(folder) / "film.mp4"
        raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{frame_rate}", "-i", "-"]
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", *raw, "-pix_fmt", "yuv420p", str(file)]
        encoder = subprocess.Popen(command, stdin=subprocess.PIPE)
        assert encoder.stdin is not None, "a pipe was asked for"
        for drawn, k in enumerate(shown):
            if on_frame is not None:
                on_frame(drawn, len(shown))
            encoder.stdin.write(np.ascontiguousarray(np.asarray(stage.picture(k))[:height, :width]).tobytes())
        encoder.stdin.close()
        if encoder.wait():
            raise InputError(f"{path}: ffmpeg could not write the film at {frame_rate:g} frames a second")
        if on_frame is not None:
            on_frame(len(shown), len(shown))
        write_whole(path, lambda out: out.write(file.read_bytes()))


def _shown_frames(times: np.ndarray, frame_rate: float) -> tuple[list[int], list[int]]:
    """The indices of the saved frames nearest to those shown, and the duration of each, ms.

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


def _shared_palette(pictures: list[Image.Image], colours: int) -> Image.Image:
    """A picture with a common palette of the given ones."""
    together = Image.fromarray(np.concatenate([np.asarray(picture) for picture in pictures]))
    return together.quantize(colours, Image.Quantize.MAXCOVERAGE)


def _write_gif(file: IO[bytes], frames: Iterator[Image.Image], durations: list[int], colours: int) -> None:
    """Write frames with one palette, each as its change from the one before; durations in ms."""
    first = next(frames)
    first.save(
        file,
        format="GIF",
        save_all=True,
        append_images=frames,
        duration=durations,
        loop=0,
        palette=first.getpalette(),
        transparency=colours,
        optimize=True,
    )

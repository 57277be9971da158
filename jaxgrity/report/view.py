"""3D replays: a motion as one HTML file for any browser, from disk, without a network."""

import contextlib
import html
import importlib.util
import io
import tempfile
import webbrowser
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import lazy_loader
import matplotlib
import numpy as np

from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.io.files import check_file, write_whole
from jaxgrity.model.scene import Scene
from jaxgrity.model.solids import Box, Cylinder, Sphere
from jaxgrity.report.drawing import RobotDrawing, World
from jaxgrity.report.poses import RobotPoses, robot_poses, robot_size
from jaxgrity.report.style import FORCE, PATH, SLACK, STRUT, SUPPORT, TENSION
from jaxgrity.stepping.simulate import Trajectory

viser = lazy_loader.load("viser")

__all__ = ["Props", "Replay", "Robot", "available", "keep_html", "replay", "save_html"]

LOOPBACK = "127.0.0.1"
"""Address that this machine alone can reach."""
FIELD_OF_VIEW = 0.75
"""Angle from the upper to the lower edge of the picture, rad."""
LEGEND_STYLE = (
    "#jaxgrity{position:fixed;top:12px;right:12px;z-index:5;font:13px/1.6 sans-serif;color:#222;pointer-events:none;"
    "background:rgba(255,255,255,.82);border-radius:6px;padding:8px 12px;max-width:22rem}"
    "#jaxgrity b{font-size:15px}#jaxgrity span{white-space:nowrap;margin-right:12px}"
    "#jaxgrity i{display:inline-block;width:22px;height:9px;margin-right:7px;border-radius:2px}"
    "@media(max-height:360px),(max-width:480px){#jaxgrity{display:none}}"
)
"""CSS of the legend, which small windows do without."""


class Robot(NamedTuple):
    """One more robot of a replay."""

    scene: Scene
    trajectory: Trajectory
    name: str
    """under which the replay lists it"""
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """m, shift, for a place beside the others"""
    opacity: float = 1.0
    """less than 1: it can be seen through, as a ghost of the first"""


class Props(NamedTuple):
    """Further objects of a replay."""

    solids: tuple[Box | Cylinder | Sphere, ...] = ()
    """obstacles"""
    ways: Mapping[str, np.ndarray] = MappingProxyType({})
    """lines by their names, (points, 3), m"""


class Replay:
    """A motion in 3D: a page for Jupyter, a file or a browser."""

    def __init__(self, page: str):
        self.page = page

    def save(self, path: str | Path) -> None:
        """Write the page, whole or not at all."""
        write_whole(path, lambda file: file.write(self.page.encode()))

    def open(self) -> Path:
        """Show the page in the computer's browser; returns its temporary file."""
        path = Path(tempfile.mkdtemp(prefix="jaxgrity-")) / "replay.html"
        self.save(path)
        webbrowser.open(path.as_uri())
        return path

    def _repr_html_(self) -> str:
        frame = 'style="width:100%;height:480px;border:0"'
        return f'<iframe title="3D replay" {frame} srcdoc="{html.escape(self.page)}"></iframe>'


def available() -> bool:
    """Whether the library for replays is installed."""
    return importlib.util.find_spec("viser") is not None


def replay(
    scene: Scene,
    trajectory: Trajectory,
    *,
    others: Sequence[Robot] = (),
    frame_rate: float = 50.0,
    follow: bool = True,
    title: str = "",
    props: Props | None = None,
) -> Replay:
    """A motion in 3D, in real time, with buttons to play, pause, scrub and change the speed.

    Struts are red; cables have the colour of their tension, slack ones are thin and pale. Arrows are the ground's
    forces on touching nodes (see `forces_along`). The green polygon is the convex hull of these nodes. The line on the
    ground is the path of the centre of mass. The list of parts, at the lower right, hides each of them.

    Args:
        scene: the scene to simulate.
        trajectory: the motion.
        others: further robots, beside the first or over it.
        frame_rate: frames a second, at most; the nearest saved frames are shown.
        follow: whether the camera follows the first robot.
        title: the title above the legend.
        props: obstacles and lines for show, such as a plan, without an effect on the robot.

    Returns:
        The replay: Jupyter displays it, `save` writes it, `open` shows it in a browser.

    Raises:
        InputError: without viser, or for a `frame_rate` or a position that is not finite, or a rate that is not
            positive.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> page = jaxgrity.report.view.replay(scene, jaxgrity.simulate(scene, 0.2), title="it settles").page
        >>> "it settles" in page, len(page) < 3e6
        (True, True)
    """
    if not available():
        raise InputError("3D replays need viser, which is not installed; expected: pip install 'jaxgrity[view]'")
    robots = [Robot(scene, trajectory, "robot"), *others]
    names = [robot.name for robot in robots]
    if len(set(names)) < len(names):
        raise InputError(f"names of robots: {names}; expected each once")
    poses = [robot_poses(each.scene, each.trajectory, frame_rate, each.offset) for each in robots]
    with quiet_server() as server:
        page = _record(server, robots, poses, follow, props or Props())
    return Replay(_with_legend(page, title, poses[0]))


def save_html(scene: Scene, trajectory: Trajectory, path: str | Path, **how: Any) -> None:
    """Write a replay as one HTML file, without need of a network or other files.

    Args:
        scene: the scene to simulate.
        trajectory: the motion.
        path: the file to write; it appears whole or not at all.
        how: further arguments of `replay`: `others`, `frame_rate`, `follow`, `title`, `props`.

    Raises:
        InputError: as `replay` does, and for a path that is a folder.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> jaxgrity.report.view.save_html(scene, jaxgrity.simulate(scene, 0.2), "replay.html", follow=False)
    """
    check_file(path)
    replay(scene, trajectory, **how).save(path)


def keep_html(scene: Scene, trajectory: Trajectory, path: str | Path, **how: Any) -> bool:
    """`save_html` with viser installed, and whether it is; an earlier file is removed in any case."""
    Path(path).unlink(missing_ok=True)
    if available():
        save_html(scene, trajectory, path, **how)
    return available()


@contextlib.contextmanager
def quiet_server() -> Iterator[Any]:
    """A silent viser server for one recording, reachable from this machine alone."""
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=LOOPBACK, port=0, verbose=False)
    try:
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def _record(server: Any, robots: list[Robot], poses: list[RobotPoses], follow: bool, props: Props) -> str:
    """The page of all frames, one after the other."""
    first = robots[0].scene
    world = World(server.scene, first)
    world.draw_ground(first, np.concatenate([each.below for each in poses]))
    for number, solid in enumerate(props.solids):
        world.draw_solid(f"obstacle {number}", solid)
    for name, points in props.ways.items():
        world.draw_way(name, points)
    drawings = [
        RobotDrawing(server.scene, robot.name, robot.scene, each, robot.opacity) for robot, each in zip(robots, poses)
    ]
    aim = np.array([0.0, 0.0, 0.4 * robot_size(first)])
    watched = poses[0].below if follow else np.mean([each.below.mean(0) for each in poses], axis=0)[None]
    reach = 1.0 if follow else max(1.0, 0.5 * float(np.ptp(poses[0].below[:, :2], axis=0).max()) / robot_size(first))
    set_camera(server, aim, poses[0], reach * robot_size(first))
    recording = server.get_scene_serializer()
    times = max((each.times for each in poses), key=len)
    for frame, length in enumerate(np.diff(times, append=times[-1])):
        world.look_at(watched[min(frame, len(watched) - 1)])
        for drawing, each in zip(drawings, poses):
            drawing.show(each, min(frame, len(each.times) - 1))
        recording.insert_sleep(float(length))
    return recording.as_html()


def camera_place(aim: np.ndarray, poses: RobotPoses, distance: float) -> np.ndarray:
    """The camera's place, with the motion to the right of `aim`."""
    heading = poses.centre[-1] - poses.centre[0]
    angle = np.arctan2(heading[1], heading[0]) if np.hypot(*heading[:2]) > 0.1 * distance else 0.0
    side = angle - np.radians(65)
    return aim + 2.6 * distance * np.array([np.cos(side), np.sin(side), 0.4])


def set_camera(server: Any, aim: np.ndarray, poses: RobotPoses, distance: float) -> None:
    """Look at `aim`, from the side."""
    server.initial_camera.position = camera_place(aim, poses, distance)
    server.initial_camera.look_at = aim
    server.initial_camera.up = (0.0, 0.0, 1.0)
    server.initial_camera.fov = FIELD_OF_VIEW


def _with_legend(page: str, title: str, poses: RobotPoses) -> str:
    """The page with the meanings of its colours."""
    shades = matplotlib.colormaps[TENSION](np.linspace(0, 1, 8))
    ramp = "linear-gradient(90deg," + ",".join(matplotlib.colors.to_hex(shade) for shade in shades) + ")"
    marks = [
        (STRUT, "struts, rigid bodies"),
        (ramp, f"cables, 0 to {in_digits(poses.largest_tension)} N"),
        (SLACK, "slack cables"),
        (FORCE, "forces of the ground"),
        (SUPPORT, "support polygon"),
        (PATH, "centre of mass, its path"),
    ]
    rows = "".join(f'<span><i style="background:{look}"></i>{html.escape(name)}</span><br>' for look, name in marks)
    heading = f"<b>{html.escape(title)}</b><br>" if title else ""
    legend = f'<style>{LEGEND_STYLE}</style><div id="jaxgrity">{heading}{rows}</div>'
    head, body, tail = page.rpartition("</body>")
    return head + legend + body + tail

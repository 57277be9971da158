"""The figure of an orbit: one cycle of it, in a frame that moves with the robot."""

import numpy as np
import scipy
from jaxtyping import Complex
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull, QhullError

from jaxgrity.core.display import significant
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import NodeHistory, Times
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.orbits.cycles import plane_of
from jaxgrity.report.style import CABLE, PATH, STRUT, SUPPORT, styled
from jaxgrity.stepping.simulate import Trajectory

FRAMES, POLYGONS = 240, 60
"""Frames of a cycle that are computed, and frames for which the support polygon is drawn."""


@styled
def orbit_figure(scene: Scene, trajectory: Trajectory, cycle: float, turning: float = 0.0) -> Figure:
    """The last cycle of a motion in a frame of constant speed and turning rate.

    In the cycle the frame goes as far as the centre of mass, along a line, or a circle where the robot turns. In that
    frame the path of an orbit is closed. On the left it is seen from above, with the polygons between the nodes on the
    ground; on the right it is drawn against time, with the height. On a slope, all this is along the plane and its
    normal, as in `Orbit`.

    Args:
        scene: the robot, on a ground.
        trajectory: of a cycle or more, with a few dozen frames in each cycle.
        cycle: s, as `Orbit.period` times `Orbit.periods`.
        turning: rad/s about the ground's normal, positive to the left, as `Orbit.turning`.

    Raises:
        InputError: no ground, or a trajectory shorter than a cycle.

    Example:
        >>> scene = jaxgrity.with_gait(jaxgrity.load_scene("exact"), jaxgrity.load_gait("lasting"))
        >>> trajectory = jaxgrity.simulate(scene, 4.0, frame_rate=50.0)
        >>> figure = jaxgrity.report.plot.orbit_figure(scene, trajectory, 2 * jaxgrity.period_of(scene.gait))
        >>> len(figure.axes)
        2
    """
    if scene.ground is None:
        raise InputError("this scene has no ground to touch; expected [ground]")
    times, history = _last_cycle(trajectory, cycle)
    touching = scene.ground.measured(np.asarray(history))[0] < scene.ground.touched_below * length_scale(scene)
    nodes = np.asarray(history) @ (plane_of(scene).axes if scene.ground.surface is None else np.eye(3))
    share = np.asarray(scene.structure.lumped_mass, float) / float(scene.structure.mass)
    centre = np.einsum("n,fnx->fx", share, nodes)
    origin, heading = _moving_frame(_flat(centre), turning * cycle)
    seen = (_flat(centre) - origin) / heading
    corners = (_flat(nodes) - origin[:, None]) / heading[:, None]
    figure = Figure(figsize=(10, 4.8), layout="constrained")
    above, against = figure.subplots(1, 2)
    every = FRAMES // POLYGONS
    _draw_above(above, seen, [_outline(row[on]) for row, on in zip(corners[::every], touching[::every])])
    height = centre[:, 2] - centre[:, 2].mean()
    for name, values, colour in (("ahead", seen.real, PATH), ("to the left", seen.imag, STRUT), ("up", height, CABLE)):
        against.plot(times - times[0], values, color=colour, label=name)
    arc_of_chord = 1 / np.sinc(turning * cycle / (2 * np.pi))
    speed = abs(origin[-1] - origin[0]) * arc_of_chord / cycle
    title = f"about a frame that goes at {significant(float(speed))} m/s"
    against.set(xlabel="time in the cycle (s)", ylabel="centre of mass about its mean (m)", title=title)
    against.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3)
    return figure


def _last_cycle(trajectory: Trajectory, cycle: float) -> tuple[Times, NodeHistory]:
    """`FRAMES` times of the last cycle, s, both its ends among them, and the nodes there."""
    times = np.asarray(trajectory.times, float)
    if not 0 < cycle <= times[-1] - times[0]:
        raise InputError(
            f"cycle = {cycle:g} s: expected more than 0 and at most the motion's {times[-1] - times[0]:g} s"
        )
    wanted = np.linspace(times[-1] - cycle, times[-1], FRAMES + 1)
    return wanted, scipy.interpolate.make_interp_spline(times, np.asarray(trajectory.positions, float))(wanted)


def _flat(x: np.ndarray) -> Complex[np.ndarray, "..."]:
    """x + i y of the last axis, m."""
    return x[..., 0] + 1j * x[..., 1]


def _moving_frame(
    path: Complex[np.ndarray, " frames"], angle: float
) -> tuple[Complex[np.ndarray, " frames"], Complex[np.ndarray, " frames"]]:
    """Origin, m, and heading, of length 1, of a frame that goes as far as a path, and turns by `angle`.

    At constant speeds p(s) = p(0) + d (exp(i s a) - 1)/(exp(i a) - 1), for s from 0 to 1, so that p(1) = p(0) + d. The
    frame is shifted so that the path's mean is at its origin.
    """
    share, way = np.linspace(0, 1, len(path)), path[-1] - path[0]
    gone = share if abs(angle) < 1e-9 else np.expm1(1j * angle * share) / np.expm1(1j * angle)
    mean = way / abs(way) if abs(way) > 0 else 1.0
    origin, heading = path[0] + way * gone, mean * np.exp(1j * angle * (share - 0.5))
    return origin + heading * np.mean((path - origin) / heading), heading


def _outline(points: Complex[np.ndarray, " nodes"]) -> np.ndarray:
    """(corners, 2), m: the convex hull; of points on a line, themselves."""
    flat = np.column_stack([points.real, points.imag])
    try:
        return flat[ConvexHull(flat).vertices]
    except (QhullError, ValueError):
        return flat if len(flat) else np.full((1, 2), np.nan)


def _draw_above(axes: Axes, path: Complex[np.ndarray, " frames"], polygons: list[np.ndarray]) -> None:
    shade = PolyCollection(polygons, facecolor=SUPPORT, edgecolor="none", alpha=0.04)
    edges = PolyCollection(polygons, facecolor="none", edgecolor=SUPPORT, linewidth=0.8, alpha=0.5, label="support")
    for collection in (shade, edges):
        axes.add_collection(collection)
    axes.plot(path.real, path.imag, color=PATH, linewidth=2.2, label="centre of mass")
    axes.plot(path[0].real, path[0].imag, "o", color="black", label="start of the cycle")
    axes.set(xlabel="ahead of the frame (m)", ylabel="to its left (m)", title="one cycle from above")
    axes.axis("equal")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3, columnspacing=1)

"""A robot in a 3D replay, frame by frame: places, turns, sizes and colours of its parts."""

from collections.abc import Sequence
from typing import NamedTuple

import matplotlib
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import Times
from jaxgrity.model.rigidity import lines_between_points
from jaxgrity.model.rod_contact import radii_along_struts
from jaxgrity.model.rods import rods_of
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import slides_of
from jaxgrity.populations.forces import forces_along
from jaxgrity.report.style import SLACK, STRUT, TENSION
from jaxgrity.statics.stiffness import all_edges
from jaxgrity.stepping.simulate import Trajectory, centre_path, frame_times, some_frames

STRUT_RADIUS, CABLE_RADIUS, NODE_RADIUS, FORCE_RADIUS = 0.014, 0.006, 0.022, 0.012
"""Radii with which parts are drawn, as shares of the robot's size."""
SLEEVE_RADIUS, SLEEVE_LENGTH = 0.026, 0.08
"""Radius and length of the sleeve drawn about a sliding node, likewise."""
WEIGHT_LENGTH = 0.5
"""Length of the arrow of a force equal to the robot's weight, as a share of the robot's size."""
LIFTED = 2e-3
"""Height above the ground at which the support polygon is drawn, m for a body of one metre."""
SLACK_TENSION = 1e-3
"""Cables with less than this share of the largest tension are drawn as slack."""


class Rods(NamedTuple):
    """Straight parts: a body from (0, 0, 0) to (0, 0, 1), turned and stretched."""

    position: np.ndarray
    """(frames, rods, 3), m, where they begin"""
    turn: np.ndarray
    """(frames, rods, 4), quaternions w, x, y, z"""
    scale: np.ndarray
    """(frames, rods, 3), m: radius, radius, length"""


class RobotPoses(NamedTuple):
    """One robot in every shown frame."""

    times: Times
    members: Rods
    """struts first"""
    bodies: Rods
    """lines between all points of each rigid body"""
    sleeves: Rods
    """about the line along which a node slides, at each such node"""
    colours: np.ndarray
    """(frames, members, 3), 0 to 255: struts red, cables by their tension, slack ones pale"""
    nodes: np.ndarray
    """(frames, nodes, 3), m"""
    ground_forces: Rods
    support: np.ndarray
    """(frames, nodes, 3), m: corners of the convex hull of the nodes that touch the ground, the last one repeated"""
    centre: np.ndarray
    """(frames, 3), m, the centre of mass"""
    below: np.ndarray
    """(frames, 3), m, the point of the ground below it"""
    tension: np.ndarray
    """(frames, members), N"""
    largest_tension: float
    """N, of any cable"""


def robot_size(scene: Scene) -> float:
    """The longest side of the box around the built structure, m."""
    return float(np.ptp(np.asarray(scene.structure.nodes), axis=0).max()) or 1.0


def rods(start: np.ndarray, end: np.ndarray, radius: np.ndarray | float) -> Rods:
    """Rods between points, (frames, rods, 3), with a `radius`, m."""
    d = end - start
    length = np.linalg.norm(d, axis=-1)
    unit = d / np.maximum(length, 1e-12)[..., None]
    # half the turn from z to d: the quaternion (1 + z·d, cross product z, d); straight down it is any half turn
    turn = np.stack([1 + unit[..., 2], -unit[..., 1], unit[..., 0], np.zeros_like(length)], axis=-1)
    turn = np.where(turn[..., :1] < 1e-9, np.array([0.0, 1.0, 0.0, 0.0]), turn)
    thick = np.broadcast_to(radius, length.shape)
    return Rods(start, turn / np.linalg.norm(turn, axis=-1, keepdims=True), np.stack([thick, thick, length], axis=-1))


def robot_poses(scene: Scene, trajectory: Trajectory, frame_rate: float, offset: tuple = (0.0, 0.0, 0.0)) -> RobotPoses:
    """A trajectory's saved frames, at most `frame_rate` a second, moved by `offset` (m).

    Raises `InputError` where the frame rate is not positive and finite, or the motion is not finite.
    """
    check_motion(trajectory)
    times = np.asarray(trajectory.times, float)
    wanted = times[0] + frame_times(times[-1] - times[0], frame_rate)
    trajectory = some_frames(trajectory, np.unique(np.searchsorted((times[1:] + times[:-1]) / 2, wanted)))
    forces, size, moved = forces_along(scene, trajectory), robot_size(scene), np.asarray(offset, float)
    q = np.asarray(trajectory.positions, float) + moved
    centre = centre_path(scene, trajectory) + moved
    below = on_ground(scene, centre - moved) + moved
    weight = float(scene.structure.mass) * float(scene.gravity or 9.81)
    arrows = forces.ground * (WEIGHT_LENGTH * size / weight)
    shown = np.linalg.norm(arrows, axis=-1) > 0.01 * size
    radius, colours, largest = _member_looks(scene, forces.tension, size)
    return RobotPoses(
        np.asarray(trajectory.times, float),
        _bars(all_edges(scene.structure), q, radius),
        _bars(lines_between_points(scene.structure.bodies), q, _body_radii(scene, size)),
        _sleeves(scene, q, size),
        colours,
        q,
        rods(q, q + np.where(shown[..., None], arrows, [0, 0, 1e-6]), np.where(shown, FORCE_RADIUS * size, 1e-6)),
        _support(scene, q, moved),
        centre,
        below,
        forces.tension,
        largest,
    )


def on_ground(scene: Scene, places: np.ndarray) -> np.ndarray:
    """The ground below (or above) places (places, 3), m; z = 0 where there is none."""
    x, y = places[:, 0], places[:, 1]
    z = np.zeros(len(x)) if scene.ground is None else scene.ground.height(x, y)
    return np.stack([x, y, np.where(np.isfinite(z), z, 0.0)], axis=-1)


def check_motion(trajectory: Trajectory) -> None:
    """Raises `InputError` for a position that is not finite: nothing can be shown from there on."""
    finite = np.isfinite(np.asarray(trajectory.positions)).all((1, 2))
    if not finite.all():
        since = float(trajectory.times[finite.argmin()])
        raise InputError(f"the motion is not finite from t = {since:g} s on: expected one that is")


def _bars(edges: Sequence[tuple[int, int]], q: np.ndarray, radius: np.ndarray | float) -> Rods:
    i, j = np.array(edges, int).reshape(-1, 2).T
    return rods(q[:, i], q[:, j], radius)


def _sleeves(scene: Scene, q: np.ndarray, size: float) -> Rods:
    slides = slides_of(scene)
    nodes, along = ((), ()) if slides is None else (slides.nodes, slides.along)
    first, last = np.array(along, int).reshape(-1, 2).T
    line, here = q[:, last] - q[:, first], q[:, np.array(nodes, int)]
    half = SLEEVE_LENGTH / 2 * size * line / np.linalg.norm(line, axis=-1, keepdims=True)
    return rods(here - half, here + half, SLEEVE_RADIUS * size)


def _member_looks(scene: Scene, tension: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Radius (m) and colour of every member in every frame, and the cables' largest tension, N."""
    struts = scene.structure.first_cable
    pull = tension[:, struts:]
    largest = float(np.abs(pull).max(initial=0.0))
    share = np.clip(pull / (largest or 1.0), 0, 1)
    slack = share < SLACK_TENSION
    red, pale = (np.array(matplotlib.colors.to_rgb(name)) for name in (STRUT, SLACK))
    cables = np.where(slack[..., None], pale, matplotlib.colormaps[TENSION](share)[..., :3])
    colours = np.concatenate([np.broadcast_to(red, (len(pull), struts, 3)), cables], axis=1)
    thin = np.where(slack, 0.5 * CABLE_RADIUS, CABLE_RADIUS) * size
    own = radii_along_struts(scene)
    thick = [own.get(k, 0.0) or STRUT_RADIUS * size for k in range(struts)]
    radius = np.concatenate([np.broadcast_to(thick, (len(pull), struts)), thin], axis=1)
    return radius, np.round(255 * colours).astype(np.uint8), largest


def _body_radii(scene: Scene, size: float) -> np.ndarray:
    """Radius, m, of each line between points of a body: that with which it touches, if it does."""
    own, rods = radii_along_struts(scene), rods_of(scene.structure)
    thick = {frozenset(rods[k]): radius for k, radius in own.items()}
    lines = lines_between_points(scene.structure.bodies)
    return np.array([thick.get(frozenset(line), 0.0) or STRUT_RADIUS * size for line in lines])


def _support(scene: Scene, q: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """The support polygon, just above the ground; without one, a point."""
    if scene.ground is None:
        return np.repeat(q[:, :1], q.shape[1], axis=1)
    size = float(length_scale(scene))
    height, axes = scene.ground.measured(q - moved)
    lift = np.where(np.isfinite(height), height, 0) - LIFTED * size
    flat = q - lift[..., None] * axes[..., 0, :]
    corners = np.empty_like(q)
    for frame, (points, touches) in enumerate(zip(flat, height < scene.ground.touched_below * size)):
        standing = points[touches] if touches.any() else points[:1]
        try:
            standing = standing[ConvexHull(standing[:, :2]).vertices]
        except (QhullError, ValueError):  # fewer than three, or all on one line
            standing = standing[:1]
        corners[frame] = standing[np.minimum(np.arange(q.shape[1]), len(standing) - 1)]
    return corners

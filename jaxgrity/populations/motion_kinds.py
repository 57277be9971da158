"""Classification of a finished trajectory: the support faces in turn; the name of the motion."""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist

from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.model.balls import touching_velocities
from jaxgrity.model.ground import Ground
from jaxgrity.model.rod_contact import radii_along_struts, strut_distances
from jaxgrity.model.scales import length_scale, speed_scale, time_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Structure
from jaxgrity.populations.metrics import SLIPPING
from jaxgrity.stepping.discretisation import FAILURES
from jaxgrity.stepping.simulate import Trajectory, centre_path, check_frames, velocities_midway

LASTING = 0.1
"""Time for which a face must stay the lowest before the robot stands on it, s for a body of one metre."""
HOPPING = 0.1
"""A robot hops if it is in the air for more than this fraction of the time."""
STAYING = 0.1
"""A robot stays if its path is less wide than this share of its diameter."""
GOES_ROUND = 0.5
"""A robot goes round if its centre sweeps, on balance in one direction, over this share of the disc about its path."""
COMING_BACK = 0.25
"""A robot comes and goes if the end and the mean of the later half of its path are within this share of its width."""
GRIP = 0.5
"""A robot on balls rolls if they slip for less than this share of the contact time, however often its faces change."""
FLAT = 1e-6
"""Share of the structure's size: nodes of a flat face are no further off its plane, lower faces lower by more."""
ANGLES = 36
"""Number of directions in which a path's width is measured."""
TIME_ROUNDING = 1e-4
"""Largest rounding of times in float32, s for a body of one metre."""


class Rolling(NamedTuple):
    """How a robot moved, as `rolling` finds it: its support faces, slip and flight, and the kind of its motion.

    All are counted from the gait's start on; without a gait, from t = 0 on.
    """

    supports: tuple[tuple[int, ...], ...]
    """the faces it stood on, in turn, by their nodes"""
    since: np.ndarray
    """(supports,), when each of them became the lowest, s"""
    rolls: int
    """changes of support"""
    slip_share: float
    """share of the contact time, summed over nodes, with slip; 0 without contact"""
    airborne_share: float
    """of the time, that in which nothing touches the ground"""
    straightness: float
    """horizontal displacement / horizontal path length of the centre of mass; 0 where it does not move"""
    path_length: float
    """horizontal, of the centre of mass, m"""
    kind: str
    """ "rolls", "rocks", "turns on the spot", "slides", "hops" or "stays": see `rolling`"""
    duration: float
    """s, for which all this was watched"""

    def summary(self) -> dict[str, Any]:
        """The numbers for a JSON file; SI units."""
        faces = [list(face) for face in self.supports]
        return self._asdict() | {"supports": faces, "since": self.since.tolist()}

    def sentence(self) -> str:
        """The numbers, in a line for people."""
        shown = ["-".join(map(str, face)) for face in self.supports[:2]] + ["..."] * (len(self.supports) > 2)
        return (
            f"{self.kind}: {self.rolls} change{'s' * (self.rolls != 1)} of support in {in_digits(self.duration)} s "
            f"({', '.join(shown) or 'none lasts'}), slips {100 * self.slip_share:.0f} % of contact time, "
            f"airborne {100 * self.airborne_share:.0f} %, straightness {self.straightness:.2f}"
        )


def faces(structure: Structure) -> tuple[tuple[int, ...], ...]:
    """The flat faces of the built nodes' convex hull, each sorted, all sorted; 20 of the six-strut icosahedron.

    Triangles that lie in one plane, to `FLAT` of the structure's size, are one face. Raises `InputError` where all
    nodes lie in a plane.
    """
    nodes = np.asarray(structure.nodes, float)
    try:
        hull = ConvexHull(nodes)
    except QhullError as error:
        raise InputError(
            f"the structure's {len(nodes)} nodes lie in a plane: there are no faces to stand on; expected at "
            "least 4 nodes that do not"
        ) from error
    off = np.abs(nodes[hull.vertices] @ hull.equations[:, :3].T + hull.equations[:, 3])
    near = off <= FLAT * np.ptp(nodes, axis=0).max()
    return tuple(sorted({tuple(sorted(hull.vertices[each].tolist())) for each in near.T}))


@typed
def rolling(scene: Scene, trajectory: Trajectory) -> Rolling:
    """The support faces, the shares of time with slip and in the air, and the kind of the motion.

    A diameter is the longest distance between two nodes as built. The `kind` is the first of these that applies:

    - "hops": the robot is in the air for more than `HOPPING` of the time.
    - "stays": its path is less than `STAYING` diameters wide.
    - "turns on the spot": its path is less than a diameter wide and goes round (`GOES_ROUND`), over more than one face.
    - "rocks": its path is less than a diameter wide. It returns to an earlier face or place (`COMING_BACK`).
    - "slides": it turns over less than once for each diameter of its way (not counting changes of face that take back
      the one before), without balls that grip.
    - "rolls": all else, straight on or in circles.

    The support is the lowest face of the convex hull, by mean signed distance, once it has been so in every frame for
    `LASTING`. Frames further apart miss changes of face. If a robot rattles, more frames show fewer changes. Nodes
    touch the ground if phi < `Ground.touched_below`, and balls slip at the point where they touch. Contact and slip are
    measured along the ground and its normal, displacement and path in x and y. Limits scale with the body. Raises
    `InputError` as `faces` does, without ground, and for a failed trajectory. At least two frames have to follow the
    gait's start, no further apart than twice the time for which a face has to last.
    """
    ground = scene.ground
    if ground is None:
        raise InputError("this scene has no ground to roll on; expected [ground]")
    if trajectory.failed:
        raise InputError(f"the trajectory failed: {FAILURES[int(trajectory.failure)]}; expected one that succeeded")
    check_frames(scene, trajectory)
    times = np.asarray(trajectory.times, float)
    start = 0.0 if scene.gait is None else float(scene.gait.start)
    size, speed, time = (float(each(scene)) for each in (length_scale, speed_scale, time_scale))
    moving = times >= start - TIME_ROUNDING * time
    if moving.sum() < 2:
        raise InputError(f"the trajectory ends at {times[-1]:g} s; expected at least two frames from {start:g} s on")
    times = times[moving]
    apart, longest = float(np.diff(times).max()), 2 * LASTING * time
    if apart > longest + TIME_ROUNDING * time:
        raise InputError(
            f"the trajectory's frames are up to {apart:.3g} s apart, and miss changes of face; expected "
            f"a frame_rate of at least {1 / longest:.4g}"
        )
    phi, heights, axes = _distances(ground, np.asarray(trajectory.positions, float)[moving])
    touching = phi < ground.touched_below * size
    along = np.einsum("fnk,fnak->fna", _at_ground(scene, trajectory)[moving], axes[..., 1:, :])
    slipping = touching & (np.linalg.norm(along, axis=-1) > SLIPPING * speed)
    contact = np.trapezoid(touching.sum(1), times)
    slip_share = float(np.trapezoid(slipping.sum(1), times) / contact) if contact > 0 else 0.0
    supported, duration = touching.any(1) | _on_struts(scene, trajectory)[moving], float(times[-1] - times[0])
    airborne_share = float(np.trapezoid(~supported * 1.0, times)) / duration
    path = centre_path(scene, trajectory)[moving, :2]
    path_length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    straightness = float(np.linalg.norm(path[-1] - path[0])) / path_length if path_length > 0 else 0.0
    hull = faces(scene.structure)
    diameter = float(pdist(np.asarray(scene.structure.nodes, float)).max())
    lowest = _lowest(np.stack([heights[:, list(face)].mean(1) for face in hull], 1), FLAT * size)
    begins = _changes(lowest, times / time)
    supports = tuple(hull[face] for face in lowest[begins])
    rolls = max(0, len(supports) - 1)
    kind = name_of_motion(path / diameter, supports, airborne_share, ground.balls is not None and slip_share < GRIP)
    return Rolling(
        supports, times[begins], rolls, slip_share, airborne_share, straightness, path_length, kind, duration
    )


def _distances(ground: Ground, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(frames, nodes), m: distances of what touches the ground, infinite where a node passes it, and of all nodes of
    faces; and the ground's axes there."""
    phi, axes = ground.measured(q)
    if ground.balls is None:
        return phi, phi, axes
    nodes = dataclasses.replace(ground, balls=None).measured(q).distance
    return phi, np.where(np.isfinite(phi), phi, nodes), axes


def _at_ground(scene: Scene, trajectory: Trajectory) -> np.ndarray:
    """Velocities (frames, nodes, 3), m/s, of what touches the ground: a ball that rolls does not slip."""
    v, ground, bodies = velocities_midway(scene, trajectory), scene.ground, scene.structure.bodies
    if ground is None or ground.balls is None:
        return v
    with jax.enable_x64(True):
        at_ground = jax.jit(jax.vmap(lambda q, v: touching_velocities(ground, bodies, q, v)))
        return np.asarray(at_ground(np.asarray(trajectory.positions, float), v))


def _on_struts(scene: Scene, trajectory: Trajectory) -> np.ndarray:
    """(frames,): whether a strut touches the ground between its ends."""
    q, ground = np.asarray(trajectory.positions, float), scene.ground
    if ground is None or not radii_along_struts(scene):
        return np.zeros(len(q), bool)
    with jax.enable_x64(True):
        within = ground.touched_below * float(length_scale(scene))
        return np.asarray(jax.jit(jax.vmap(lambda q: jnp.any(strut_distances(scene, q) < within)))(q))


def _lowest(heights: np.ndarray, margin: float) -> np.ndarray:
    """The lowest of the faces (frames, faces) in each frame, (frames,); a new one only if lower by the margin, m."""
    lowest = heights.argmin(1)
    for k in range(1, len(lowest)):
        # of faces that are equally low the earlier one stays, or rounding would look like rolling
        if heights[k, lowest[k - 1]] <= heights[k, lowest[k]] + margin:
            lowest[k] = lowest[k - 1]
    return lowest


def _changes(lowest: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The frames in which a new lasting face becomes the lowest.

    `times` are those of a body of one metre.
    """
    begins = np.flatnonzero(np.diff(lowest, prepend=-1))
    ends = np.append(begins[1:], len(lowest)) - 1
    lasting = begins[times[ends] - times[begins] >= LASTING - TIME_ROUNDING]
    return lasting[np.diff(lowest[lasting], prepend=-1) != 0]


def name_of_motion(
    path: np.ndarray, supports: tuple[tuple[int, ...], ...], airborne_share: float, grips: bool = False
) -> str:
    """The kind by the thresholds of `rolling`, from a path (frames, 2) in diameters of the robot, and the faces in
    turn; `grips`: whether balls touch the ground, and mostly do not slip."""
    wide = width(path)
    if airborne_share > HOPPING:
        return "hops"
    if wide < STAYING:
        return "stays"
    goes_round = _swept(path) > GOES_ROUND * np.pi * wide**2 / 4
    if wide < 1 and len(supports) > 1 and goes_round:
        return "turns on the spot"
    if wide < 1 and (len(set(supports)) < len(supports) or (_further(path) < COMING_BACK * wide and not goes_round)):
        return "rocks"
    return "slides" if _turned_over(supports) < _way(path) and not grips else "rolls"


def _turned_over(supports: tuple[tuple[int, ...], ...]) -> int:
    """The number of changes of face that do not take the change before back, as from A to B to A."""
    back = sum(after == before for before, after in zip(supports, supports[2:]))
    return max(0, len(supports) - 1 - back)


def width(path: np.ndarray) -> float:
    """The largest extent of a path (frames, 2) in any direction."""
    angles = np.pi * np.arange(ANGLES) / ANGLES
    return float(np.ptp(path @ np.stack([np.cos(angles), np.sin(angles)]), axis=0).max())


def _swept(path: np.ndarray) -> float:
    """The area swept by the line from a path's middle to its end, to the left less to the right."""
    # about its middle: about another point a straight path would sweep an area, too
    (x, y), (dx, dy) = (path[:-1] - (path.min(0) + path.max(0)) / 2).T, np.diff(path, axis=0).T
    return abs(float(np.sum(x * dy - y * dx))) / 2


def _further(path: np.ndarray) -> float:
    """The advance of a path's end beyond its start, or of its later half beyond its first in the mean."""
    first, later = np.array_split(path, 2)
    return float(max(np.linalg.norm(later.mean(0) - first.mean(0)), np.linalg.norm(path[-1] - path[0])))


def _way(path: np.ndarray) -> float:
    """The length of a path in straight stretches of 1, which ignore its wobble, and of the rest."""
    length, begun = 0.0, 0
    while True:
        away = np.linalg.norm(path[begun:] - path[begun], axis=1)
        beyond = int(np.argmax(away >= 1))
        if not beyond:
            return length + float(away[-1])
        length, begun = length + float(away[beyond]), begun + beyond

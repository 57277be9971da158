"""The kind of motion of a rollout, and whether and when it settles."""

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.distance import pdist

from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.orbits.cycles import MOST_PERIODS, plane_of, shape
from jaxgrity.orbits.finding import SETTLED, period_of
from jaxgrity.populations.motion_kinds import STAYING, Rolling, rolling, width
from jaxgrity.stepping.simulate import Trajectory, centre_path


class MotionReport(NamedTuple):
    """Kind of motion of a rollout, and when it settles."""

    kind: str
    """kind from `rolling`; "stands" or "fell over" if the robot stays in the later half"""
    settled_after: float
    """time from which shapes return after each cycle, or the robot rests, s; infinite if the motion does not settle"""
    periods: int
    """number of periods of actuation per cycle; 0 without a cycle"""
    watched: float
    """simulated time, s"""
    rolling: Rolling
    """support faces, slip and flight"""

    def summary(self) -> dict[str, Any]:
        """The numbers, as they go into a JSON file; SI units."""
        settled = self.settled_after if np.isfinite(self.settled_after) else None
        found = {"kind": self.kind, "settled_after": settled, "periods": self.periods}
        return self.rolling.summary() | found

    def sentence(self) -> str:
        """The report in one sentence."""
        if not np.isfinite(self.settled_after):
            return f"the robot {self.kind}; its motion has not settled after {in_digits(self.watched)} s"
        since = in_digits(self.settled_after, 2)
        if not self.periods:
            return f"the robot {self.kind}; it is at rest after {since} s"
        again = "each period" if self.periods == 1 else f"every {self.periods} periods"
        return f"the robot {self.kind}; its motion has settled after {since} s, and repeats {again}"


def motion_report(scene: Scene, trajectory: Trajectory) -> MotionReport | None:
    """The report on a finished rollout; None if it failed, has no ground, or is too short."""
    try:
        seen = rolling(scene, trajectory)
    except InputError:
        return None
    times, path = np.asarray(trajectory.times, float), centre_path(scene, trajectory)
    half = times >= times[-1] / 2
    at_rest = width(path[half][:, :2]) < STAYING * float(pdist(np.asarray(scene.structure.nodes, float)).max())
    still = at_rest and seen.kind != "hops" and not (seen.since[1:] > times[-1] / 2).any()
    kind = ("fell over" if seen.rolls else "stands") if still else seen.kind
    since, periods = _settled(scene, trajectory)
    return MotionReport(kind, since, periods, float(times[-1]), seen)


def _settled(scene: Scene, trajectory: Trajectory) -> tuple[float, int]:
    """Time from which shapes return, s, and the number of periods per cycle; infinite and 0 if they do not return."""
    times, q = np.asarray(trajectory.times, float), np.asarray(trajectory.positions, float)
    size = SETTLED * float(length_scale(scene))
    try:
        gait = scene.gait
        period, start = (0.0, 0.0) if gait is None else (period_of(gait), float(gait.start + gait.ramp))
        plane = plane_of(scene) if period else None
    except InputError:  # no plane, or several frequencies: nothing that returns
        return np.inf, 0
    if plane is None:  # a robot that slides or rolls on keeps its shape, and does not rest
        off = np.abs(q - q[-1]).max((1, 2)) > size
        last = int(np.flatnonzero(off)[-1]) + 1 if off.any() else 0
        return (float(times[last]), 0) if times[last] < times[-1] / 2 else (np.inf, 0)
    moving = times >= start
    if not moving.any():  # the rollout ends before the gait is in full swing
        return np.inf, 0
    times, levelled = times[moving], q[moving] @ plane.axes
    shapes = np.array([shape(x, plane) for x in levelled])
    for periods in range(1, MOST_PERIODS + 1):
        cycle = periods * period
        again = times[times + 2 * cycle <= times[-1]]
        if not len(again):  # a motion has settled once it was seen to repeat itself for a cycle
            break
        compared = times[times + cycle <= times[-1]]
        changed = np.abs(_at(compared + cycle, times, shapes) - shapes[: len(compared)]).max(1) > size
        first = int(np.flatnonzero(changed)[-1]) + 1 if changed.any() else 0
        if first < len(again):
            return float(times[first]), periods
    return np.inf, 0


def _at(moments: np.ndarray, times: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Shapes at moments between frames, m."""
    k = np.clip(np.searchsorted(times, moments), 1, len(times) - 1)
    share = ((moments - times[k - 1]) / (times[k] - times[k - 1]))[:, None]
    return shapes[k - 1] + share * (shapes[k] - shapes[k - 1])

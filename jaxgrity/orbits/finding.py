"""The orbit that a rolling robot settles on: how fast it goes, how it turns, and whether it comes back when disturbed.

A gait that lasts rolls on a relative periodic orbit: after some periods of actuation the robot is where it was, but for
a planar motion, a shift along the ground and a turn about the vertical. Speed and turning of the orbit do not depend on
where the robot started, and converge with the step where the positions of a long rollout do not.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import State
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import Scene, body_length, with_gait
from jaxgrity.orbits.cycles import MOST_PERIODS, Plane, cycle, moved_onto, plane_of, shape, way_along
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve
from jaxgrity.stepping.simulate import Trajectory, centre_path, simulate

FRAMES = 20
"""Number of frames saved in each period of actuation."""
SETTLED = 0.1
"""Largest change of shape over a cycle, in body lengths. A robot has settled once no later cycle exceeds it."""
HEADING = 0.2
"""Largest turn of a robot on a slope since it settled, rad. A motion that goes on turning does not repeat itself
there."""
WINDOW = 10.0
"""Length of the windows over which the speed is averaged, s for a body of one metre."""


class Orbit(NamedTuple):
    """What a robot settled on, in the mean over the later half of the cycles since it settled."""

    period: float
    """s, of actuation"""
    periods: int
    """of actuation in a cycle"""
    speed: float
    """m/s, of the centre of mass along its line, or about the centre that the motion turns about (`way_along`)"""
    standard_error: float
    """m/s, of the speed, from its scatter over cycles that do not overlap"""
    turning: float
    """rad/s about the ground's normal, positive to the left; on a slope, where no motion that turns repeats itself,
    `HEADING` at most over all of the time"""
    velocity: tuple[float, float]
    """(along x, along y), m/s, horizontal displacement over time: less than the speed where the path bends"""
    residual: float
    """m, by which the `shape` changes over a cycle at most; the median over cycles"""
    settled_after: float
    """s, from which on shapes returned to `SETTLED` body lengths after each cycle; infinite where that was never so, or
    too late for two of the longest cycles"""
    windows: np.ndarray
    """(windows,), m/s, the mean over the cycles that begin in each `window` since the robot settled"""
    verified_for: float
    """s, for which all this was watched, settling included; 0 where the rollout failed"""
    state: State
    """(q, v), in float64, at the end, a whole number of periods after t = 0"""
    body_length: float
    """m"""
    window: float = WINDOW
    """s, `WINDOW` of this body"""

    @property
    def cycle(self) -> float:
        """The time of a cycle, s."""
        return self.periods * self.period

    @property
    def settled(self) -> bool:
        """Whether the robot is on an orbit. One that bounces on the spot is too, on one of speed 0."""
        return bool(np.isfinite(self.settled_after))

    def summary(self) -> dict[str, Any]:
        """The numbers, as they go into a JSON file; SI units."""
        found = {name: value for name, value in self._asdict().items() if name not in ("state", "windows")}
        slowest = float(self.windows.min()) if self.windows.size else None
        lengths = self.speed / self.body_length
        return found | {"slowest_window": slowest, "body_lengths_per_second": lengths, "settled": self.settled}


def period_of(gait: Gait | None) -> float:
    """The period of actuation, s. Raises `InputError` where actuators have none in common."""
    frequencies = np.unique(np.asarray(gait.frequency, float)) if gait is not None else np.zeros(0)
    if frequencies.size != 1 or not frequencies[0] > 0:
        raise InputError(f"frequencies {frequencies.tolist()} Hz: expected one that all actuators share, for an orbit")
    return float(1 / frequencies[0])


def shortest_watch(gait: Gait | None) -> float:
    """The shortest duration, s, that leaves two cycles of `MOST_PERIODS` in the later half of the gait's full swing.

    Raises `InputError` as `period_of` does.
    """
    return (_first_period(gait) + 4 * MOST_PERIODS) * period_of(gait)


@typed
def find_orbit(
    scene: Scene, duration: float = 120.0, *, options: Options = None, beginning: Orbit | None = None
) -> Orbit:
    """Roll the scene's gait out, and find the orbit that the robot settles on.

    Shapes are compared once a period: heights of nodes above the plane and distances between them, which no planar
    motion changes; on a slope, which a turn does not leave as it is, what no shift along it changes. The cycle is the
    smallest number of periods after which they return nearly as closely as after any
    other. Speed and turning are those of the planar motions that fit cycles best.

    Args:
        scene: a scene with a gait whose actuators share one frequency.
        duration: s, settling included.
        options: how to integrate, at a fixed step, which is shortened so that steps divide the period; where not given,
            the scene decides. The precision is float64 in any case.
        beginning: an orbit to begin on, its state and with the gait in full swing, in place of the scene's own pose at
            rest: that of a scene that differs a little, to follow the orbit from one to the other.

    Returns:
        The orbit. `Orbit.settled` says whether there is one.

    Raises:
        InputError: bad options (see `resolve`), no frequency that all actuators share, a ground that is no plane, or a
            duration that leaves no two cycles to compare.

    Example:
        >>> scene = jaxgrity.with_gait(jaxgrity.load_scene("exact"), jaxgrity.load_gait("lasting"))
        >>> orbit = jaxgrity.orbits.find_orbit(scene, 80.0)
        >>> orbit.settled, orbit.speed > 0.5  # m/s
        (True, True)
    """
    refuse_traced((scene, duration), "find_orbit")
    period = period_of(scene.gait)
    if duration < (least := shortest_watch(scene.gait)):
        raise InputError(f"duration = {duration:g} s: expected at least {least:.4g} s, to see cycles of this gait")
    count, plane, first = int(duration / period + 1e-9), plane_of(scene), _first_period(scene.gait)
    here, v = (scene, None) if beginning is None else (restarted(scene, beginning), beginning.state[1])
    chosen = in_step(scene, period, options)
    trajectory = simulate(here, count * period, options=chosen, frame_rate=FRAMES / period, velocities=v)
    return _orbit(scene, trajectory, period, plane, first if beginning is None else 0)


@typed
def restarted(scene: Scene, orbit: Orbit) -> Scene:
    """The scene with nodes as they are on the orbit, `Orbit.state`, and with the gait at full amplitude at once.

    The state is a whole number of periods after t = 0, so that the gait goes on as it did.
    """
    assert scene.gait is not None, "an orbit has a gait"
    # the ramp ends nine periods before t = 0, so that all of the rollout is at full amplitude
    running = replace(scene.gait, start=np.array(-10.0 * orbit.period), ramp=np.array(orbit.period))
    return with_gait(eqx.tree_at(lambda s: s.structure.nodes, with_gait(scene, None), orbit.state[0]), running)


def _first_period(gait: Gait | None) -> int:
    """The number of the first period that begins at full amplitude."""
    assert gait is not None, "`period_of` refuses a scene without a gait"
    return int(np.ceil(float(gait.start + gait.ramp) / period_of(gait) - 1e-9))


def in_step(scene: Scene, period: float, options: Options) -> ResolvedOptions:
    """The options, in float64, with a step of which each frame of the period has a whole number.

    The scene is as it is before it is on an orbit: a step that is fine there is taken on the orbit too.
    """
    resolved = resolve(scene, period, options, dtype="float64")
    if resolved.dt is None:
        raise InputError(f"method = {resolved.method.name!r} adapts its step; expected a fixed one (dt), for an orbit")
    # a whole number of steps in a frame: shapes are compared at one phase of actuation, and never interpolated
    steps = int(np.ceil(period / FRAMES / float(resolved.dt) - 1e-9))
    return replace(resolved, dt=float(period / FRAMES / steps))


def _orbit(scene: Scene, trajectory: Trajectory, period: float, plane: Plane, first: int) -> Orbit:
    """From a trajectory with `FRAMES` frames in each period, at full amplitude after the `first` periods."""
    q, v = (np.asarray(x, float) for x in (trajectory.positions, trajectory.velocities))
    size, mass = float(body_length(scene)), np.asarray(scene.structure.lumped_mass, float)
    if trajectory.failed:
        none = (0.0, 0.0)
        return Orbit(period, 1, 0.0, np.inf, 0.0, none, np.inf, np.inf, np.zeros(0), 0.0, (q[0], v[0]), size)
    once = q[::FRAMES][first:] @ plane.axes
    path = centre_path(scene, trajectory)[first * FRAMES :]
    places, path = path[::FRAMES], (path @ plane.axes)[:, :2]
    shapes, half = np.array([shape(x, plane) for x in once]), len(once) // 2
    periods = cycle(shapes[half:], (places @ plane.axes)[half:, :2])
    changes = np.abs(shapes[periods:] - shapes[:-periods]).max(1)
    beyond = np.flatnonzero(changes > SETTLED * size)
    since = int(beyond[-1]) + 1 if beyond.size else 0
    settled = len(once) - since >= 2 * MOST_PERIODS
    since = since if settled else half
    later, time = (len(changes) - since) // 2, periods * period
    # on a slope too: that the robot keeps its heading there is what is to be seen
    turning = plane._replace(turns=True)
    back = [moved_onto(mass, once[k + periods], once[k], turning)[2] for k in range(since + later, len(changes))]
    turned, frames = -float(np.mean(back)), periods * FRAMES
    watched = (len(once) - 1 - since) * period
    settled = settled and (plane.turns or abs(turned) / time * watched <= HEADING)
    cycles = (path[k * FRAMES :][: frames + 1] for k in range(since, len(changes)))
    every = np.array([way_along(each, turned / frames) * FRAMES / period for each in cycles])
    seconds = WINDOW * float(time_scale(scene))
    speeds, window = every[later:], max(1, round(seconds / period))
    # cycles that overlap have frames in common, and their scatter would make too small an error
    apart = speeds[::periods]
    error = float(apart.std(ddof=1) / np.sqrt(len(apart))) if len(apart) > 1 else np.inf
    whole = len(every) // window * window
    way = (places[-1] - places[since + later])[:2] / (len(places) - 1 - since - later) / period
    return Orbit(
        period=period,
        periods=periods,
        speed=float(speeds.mean()),
        standard_error=error,
        turning=turned / time,
        velocity=(float(way[0]), float(way[1])),
        residual=float(np.median(changes[since + later :]) if settled else changes[half:].max()),
        settled_after=(first + since) * period if settled else np.inf,
        windows=every[:whole].reshape(-1, window).mean(1),
        verified_for=float(trajectory.times[-1]),
        state=(q[-1], v[-1]),
        body_length=size,
        window=seconds,
    )

"""The orbit that a rolling robot settles on: its speed, turning and period.

A gait that lasts rolls on a relative periodic orbit. After some periods of actuation the robot has the same shape
again, apart from a planar motion (a shift along the ground and a turn about the vertical). Speed and turning of the
orbit do not depend on the start. They converge with the step, unlike the positions of a long rollout.
"""

from dataclasses import replace
from operator import attrgetter
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxgrity.core.arguments import check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import State
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import Scene, body_length, with_gait
from jaxgrity.orbits.cycles import MOST_PERIODS, Plane, cycle, plane_of, shape, turned_by, way_along
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve
from jaxgrity.stepping.simulate import Trajectory, centre_path, simulate

FRAMES = 20
"""Number of saved frames per period of actuation."""
SETTLED = 0.1
"""Largest change of shape over a cycle, in body lengths. A robot has settled once no later cycle exceeds it."""
HEADING = 0.2
"""Largest turn of a robot on a slope since it settled, rad. A motion that keeps turning does not repeat there."""
FEWEST_PERIODS = 4 * MOST_PERIODS
"""Number of periods of actuation in full swing of `shortest_watch`. In it, a robot that settles later than half of
them does not count as settled."""
IN_TIME = f"in the first half of {FEWEST_PERIODS} periods of actuation"
"""When such a robot has to settle, in words."""
WINDOW = 10.0
"""Length of the windows over which the speed is averaged, s for a body of one metre."""


class Orbit(NamedTuple):
    """An orbit: means over the later half of the cycles since the robot settled."""

    period: float
    """period of actuation, s"""
    periods: int
    """number of periods of actuation per cycle"""
    speed: float
    """speed of the centre of mass along its mean path, m/s (`way_along`)"""
    standard_error: float
    """standard error of the speed from its scatter over separate cycles, m/s"""
    turning: float
    """turning about the ground's normal, rad/s, positive to the left; on a slope, at most `HEADING` over all of the
    time"""
    velocity: tuple[float, float]
    """horizontal displacement over time along x and y, m/s; less than the speed if the path bends"""
    residual: float
    """largest change of the `shape` over a cycle, m; median over cycles"""
    settled_after: float
    """time from which shapes return to `SETTLED` body lengths after each cycle, s; infinite if never, or too late for
    two of the longest cycles"""
    windows: np.ndarray
    """(windows,), mean speed over the cycles that begin in each `window` since the robot settled, m/s"""
    verified_for: float
    """simulated time, with settling, s; 0 if the rollout failed"""
    state: State
    """(q, v) in float64 at the end, a whole number of periods after t = 0"""
    body_length: float
    """body length, m"""
    window: float = WINDOW
    """length of a window for this body, s"""
    scene_time: float = 0.0
    """time of `state` on the scene's clock, s: with the time before, where the robot started on another orbit"""

    @property
    def cycle(self) -> float:
        """The time of a cycle, s."""
        return self.periods * self.period

    @property
    def settled(self) -> bool:
        """Whether the robot is on an orbit. A robot that bounces on the spot is on an orbit of speed 0."""
        return bool(np.isfinite(self.settled_after))

    def summary(self) -> dict[str, Any]:
        """The numbers for a JSON file, in SI units."""
        found = {
            name: value for name, value in self._asdict().items() if name not in ("state", "windows", "scene_time")
        }
        slowest = float(self.windows.min()) if self.windows.size else None
        lengths = self.speed / self.body_length
        return found | {"slowest_window": slowest, "body_lengths_per_second": lengths, "settled": self.settled}


def _given(gait: Gait | None) -> Gait:
    if gait is None:
        raise InputError("the scene has no gait, and so no orbit; pass jaxgrity.with_gait(scene, gait)")
    return gait


def period_of(gait: Gait | None) -> float:
    """Period of actuation, s. Raises `InputError` without a gait, or if actuators do not share one."""
    frequencies = np.unique(np.asarray(_given(gait).frequency, float))
    if frequencies.size != 1 or not frequencies[0] > 0:
        raise InputError(f"frequencies {frequencies.tolist()} Hz: expected one that all actuators share, for an orbit")
    return float(1 / frequencies[0])


def shortest_watch(gait: Gait | None) -> float:
    """Shortest duration with two cycles of `MOST_PERIODS` in the later half of the gait's full swing, s.

    Raises `InputError` as `period_of` does.
    """
    return period_of(gait) * (_first_period(gait) + FEWEST_PERIODS)


@typed
def find_orbit(
    scene: Scene, duration: float = 120.0, *, options: Options = None, beginning: Orbit | None = None
) -> Orbit:
    """Simulate the scene's gait, and find the orbit that the robot settles on.

    Shapes are compared once per period: the heights of nodes above the plane and the distances between them, which no
    planar motion changes. On a slope and in wind only shifts are allowed. The cycle is the smallest number of periods
    after which the shape returns: to 0.0001 body lengths, or nearly as closely as after any other. Speed and turning
    are those of the planar motions that fit the cycles best.

    Args:
        scene: a scene with a gait whose actuators share one frequency.
        duration: simulated time, with settling, s.
        options: solver options with a fixed step; by default the scene decides. The step is shortened to divide the
            period. The precision is float64.
        beginning: an orbit of a slightly different scene whose state is the start, with the gait in full swing; by
            default the robot starts from its pose at rest.

    Returns:
        The orbit. `Orbit.settled` says whether there is one.

    Raises:
        InputError: bad options (see `resolve`), no gait, actuators without a common frequency, a ground that is no
            plane, supports that move, or a duration too short for two cycles.

    Example:
        >>> scene = jaxgrity.with_gait(jaxgrity.load_scene("exact"), jaxgrity.load_gait("lasting"))
        >>> orbit = jaxgrity.orbits.find_orbit(scene, 80.0)
        >>> orbit.settled, orbit.speed > 0.5  # m/s
        (True, True)
    """
    refuse_traced((scene, duration), "find_orbit")
    plane, period = check_periodic(scene, duration), period_of(scene.gait)
    count, first = int(duration / period + 1e-9), _first_period(scene.gait)
    here, v = (scene, None) if beginning is None else (restarted(scene, beginning), beginning.state[1])
    chosen = in_step(scene, period, options)
    trajectory = simulate(here, count * period, options=chosen, frame_rate=FRAMES / period, velocities=v)
    before = 0.0 if beginning is None else beginning.scene_time
    return _orbit(scene, trajectory, period, plane, first if beginning is None else 0, before)


def check_periodic(scene: Scene, duration: float) -> Plane:
    """The plane of a scene whose motion can repeat itself in that time, s. Raises `InputError` as `find_orbit` does."""
    period_of(scene.gait)
    if scene.shaking is not None:
        raise InputError("shaking: supports that move keep no time with the gait; expected none, for an orbit")
    if check_number("duration", duration, above=0.0, unit="s") < (least := shortest_watch(scene.gait)):
        raise InputError(f"duration = {duration:g} s: expected at least {least:.4g} s, to see cycles of this gait")
    return plane_of(scene)


def check_orbit(scene: Scene, orbit: Orbit) -> Gait:
    """The scene's gait. Raises `InputError` without one, and for an orbit that failed, or that of another robot."""
    if not orbit.verified_for:
        raise InputError("orbit: its rollout failed; expected one that was watched to the end")
    if (shape := np.shape(orbit.state[0])) != np.shape(scene.structure.nodes):
        raise InputError(f"orbit: it has {shape[0]} nodes; expected {len(scene.structure.nodes)}, those of the scene")
    return _given(scene.gait)


@typed
def restarted(scene: Scene, orbit: Orbit) -> Scene:
    """The scene with the nodes of `Orbit.state`, and with the gait at full amplitude from the start.

    The state is a whole number of periods after t = 0, so the gait continues as before. So do motors and pushes, and
    laws of your own that say what they do `later`. Raises `InputError` without a gait, and for an orbit that failed, or
    that of another robot.
    """
    gait, scene = check_orbit(scene, orbit), _later(scene, orbit.scene_time)
    # the ramp ends nine periods before t = 0, so that all of the rollout is at full amplitude
    running = replace(gait, start=np.array(-10.0 * orbit.period), ramp=np.array(orbit.period))
    return with_gait(eqx.tree_at(lambda s: s.structure.nodes, with_gait(scene, None), orbit.state[0]), running)


def _later(scene: Scene, seconds: float) -> Scene:
    """The scene whose motors and terms do at time t what those of the given one do at t + `seconds`."""
    for kind, members, _ in scene.structure.numbered:
        if members.motors:
            motors = tuple(replace(motor, times=motor.times - seconds) for motor in members.motors)
            scene = eqx.tree_at(attrgetter(f"structure.{kind}.motors"), scene, motors)
    return replace(scene, terms=tuple(term.later(seconds) for term in scene.terms)) if scene.terms else scene


def _first_period(gait: Gait | None) -> int:
    """The number of the first period that begins at full amplitude."""
    gait = _given(gait)
    return int(np.ceil(float(gait.start + gait.ramp) / period_of(gait) - 1e-9))


def in_step(scene: Scene, period: float, options: Options) -> ResolvedOptions:
    """The options in float64, with a step that divides the time between frames.

    The scene is the one before the orbit: a step that is stable there is used on the orbit too.
    """
    resolved = resolve(scene, period, options, dtype="float64")
    if resolved.dt is None:
        raise InputError(f"method = {resolved.method.name!r} adapts its step; expected a fixed one (dt), for an orbit")
    # a whole number of steps in a frame: shapes are compared at one phase of actuation, and never interpolated
    steps = int(np.ceil(period / FRAMES / float(resolved.dt) - 1e-9))
    return replace(resolved, dt=float(period / FRAMES / steps))


def _orbit(scene: Scene, trajectory: Trajectory, period: float, plane: Plane, first: int, before: float = 0.0) -> Orbit:
    """The orbit of a trajectory with `FRAMES` frames per period and full amplitude after `first` periods.

    The trajectory begins at the time `before` of the scene, s.
    """
    q, v = (np.asarray(x, float) for x in (trajectory.positions, trajectory.velocities))
    size, mass = float(body_length(scene)), np.asarray(scene.structure.lumped_mass, float)
    if trajectory.failed:
        none = (0.0, 0.0)
        return Orbit(period, 1, 0.0, np.inf, 0.0, none, np.inf, np.inf, np.zeros(0), 0.0, (q[0], v[0]), size)
    once = q[::FRAMES][first:] @ plane.axes
    path = centre_path(scene, trajectory)[first * FRAMES :]
    places, path = path[::FRAMES], (path @ plane.axes)[:, :2]
    shapes, half = np.array([shape(x, plane) for x in once]), len(once) // 2
    periods = cycle(shapes[half:], (places @ plane.axes)[half:, :2], size)
    changes = np.abs(shapes[periods:] - shapes[:-periods]).max(1)
    beyond = np.flatnonzero(changes > SETTLED * size)
    since = int(beyond[-1]) + 1 if beyond.size else 0
    settled = len(once) - since >= 2 * MOST_PERIODS
    since = since if settled else half
    later, time = (len(changes) - since) // 2, periods * period
    # on a slope too: that the robot keeps its heading there is what is to be seen
    angles = [turned_by(mass / mass.sum(), once[k], once[k + periods]) for k in range(since + later, len(changes))]
    turned, frames = float(np.mean(np.array(angles))), periods * FRAMES
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
        scene_time=before + float(trajectory.times[-1]),
    )

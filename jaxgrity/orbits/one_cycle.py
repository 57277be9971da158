"""Energy, actuators and supports in one cycle of an orbit."""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from jaxgrity.core.typed import typed
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import Scene
from jaxgrity.orbits.finding import Orbit, in_step, restarted
from jaxgrity.populations.metrics import cost_of_transport
from jaxgrity.populations.motion_kinds import LASTING, rolling
from jaxgrity.populations.population import as_population, simulate_population
from jaxgrity.populations.uncertainty import Differences
from jaxgrity.stepping.options import Options, ResolvedOptions
from jaxgrity.stepping.simulate import simulate

FRAME_RATE = 50.0
"""Number of frames per second at which the faces are determined, for a body of one metre."""


class OrbitCycle(NamedTuple):
    """One cycle. Peaks are those of the most loaded actuator; forces are moving means, as in `Metrics`."""

    duration: float
    """s"""
    distance: float
    """m, of the centre of mass, along the line or the arc of `Orbit.speed`"""
    work: float
    """J, done by the actuators less done on them: on an orbit, the loss to friction and damping"""
    effort: float
    """J, done by the actuators, each by itself, without recovery of work done on them"""
    cost_of_transport: float
    """effort / (m g distance); infinite without gravity or where the robot stays"""
    peak_force: float
    """N"""
    peak_rate: float
    """m/s"""
    peak_power: float
    """W"""
    supports: tuple[tuple[int, ...], ...]
    """the faces that the robot stands on, in turn, by their nodes (`rolling`); empty without ground"""

    def summary(self) -> dict[str, Any]:
        """The numbers, as they go into a JSON file; SI units."""
        return self._asdict() | {"supports": [list(face) for face in self.supports]}


@typed
def orbit_cycle(scene: Scene, orbit: Orbit, *, options: Options = None) -> OrbitCycle:
    """Follow the robot for two cycles after `Orbit.state`, of which the second counts.

    The first fills the moving means of forces.

    Args:
        scene: with the gait of the orbit.
        orbit: as from `find_orbit`, by the same options.
        options: solver options; by default the scene's.

    Raises:
        InputError: bad options (see `resolve`).

    Example:
        >>> scene = jaxgrity.with_gait(jaxgrity.load_scene("exact"), jaxgrity.load_gait("lasting"))
        >>> orbit = jaxgrity.orbits.find_orbit(scene, 80.0)
        >>> cycle = jaxgrity.orbits.orbit_cycle(scene, orbit)
        >>> cycle.distance > 2, cycle.effort > cycle.work > 0
        (True, True)
    """
    here, chosen = restarted(scene, orbit), in_step(scene, orbit.period, options)
    start = Differences(velocities=np.asarray(orbit.state[1])[None])
    assert here.gait is not None, "an orbit has a gait"
    gaits = as_population(here.gait)
    twice, since = 2 * orbit.cycle, orbit.cycle
    found = simulate_population(here, gaits, twice, options=chosen, differences=start, with_metrics=since)
    metrics, distance = found.metrics, orbit.speed * orbit.cycle
    assert metrics is not None, "they were asked for"
    effort = float(np.asarray(metrics.effort)[0])
    cost = float(cost_of_transport(scene, effort, distance))
    force, rate, power = (float(np.max(each)) for each in (metrics.peak_force, metrics.peak_rate, metrics.peak_power))
    work = float(np.asarray(metrics.work)[0])
    return OrbitCycle(
        orbit.cycle, distance, work, effort, cost, force, rate, power, _supports(scene, here, orbit, chosen)
    )


def _supports(scene: Scene, here: Scene, orbit: Orbit, options: ResolvedOptions) -> tuple[tuple[int, ...], ...]:
    """The faces to which the built robot changes in a cycle after the orbit's state, where `here` begins.

    A cycle ends on the face on which it begins, which so counts once. As a face has to last, the cycle ends before the
    motion does. All cycles have frames at the same moments.
    """
    if scene.ground is None:
        return ()
    scale = float(time_scale(scene))
    lasting, frames = 2 * LASTING * scale, math.ceil(orbit.cycle * FRAME_RATE / scale)
    rate = frames / orbit.cycle
    watched = (1 + math.ceil((lasting + 2 / rate) / orbit.cycle)) * orbit.cycle
    trajectory = simulate(here, watched, options=options, frame_rate=rate, velocities=orbit.state[1])
    if trajectory.failed:
        return ()
    built = replace(here, structure=scene.structure)  # the pose of the moment may be flat
    seen, ends = rolling(built, trajectory), watched - (math.ceil(lasting * rate) + 0.5) / rate
    told = [face for face, since in zip(seen.supports, seen.since) if ends - orbit.cycle < since < ends]
    return tuple(told) or seen.supports[-1:]

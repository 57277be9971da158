"""The explorer's computations: one rollout at a time, by programs compiled once for a robot."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from jaxgrity.core.display import known_words, significant
from jaxgrity.core.errors import InputError
from jaxgrity.explorer.controls import Knob, adjusted, knobs
from jaxgrity.io.gait_library import gait_names, load_gait
from jaxgrity.io.scene_files import load_scene
from jaxgrity.model.contact_twin import contact_twin
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.orbits.finding import find_orbit, period_of
from jaxgrity.populations.population import as_population, simulate_population
from jaxgrity.report.poses import RobotPoses, robot_poses
from jaxgrity.search.objectives import CostOfTransport
from jaxgrity.search.paths import stays, stays_within
from jaxgrity.stepping.discretisation import FAILURES
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve
from jaxgrity.stepping.simulate import Trajectory, centre_path, simulate
from jaxgrity.trust.error_bars import refinement_bar, timing_bar

OWN = "the scene's own"
"""Choice of a gait that stands for the one in the scene."""
OTHER = "the other"
"""Choice of a contact model that stands for the scene's contact twin."""
WATCHED_PERIODS = 56
"""Number of periods of actuation in which the robot has to settle on an orbit."""
FRAME_RATE = 25.0
"""Number of saved frames per second."""


class Rolled(NamedTuple):
    """One rollout, ready for display."""

    scene: Scene
    trajectory: Trajectory
    poses: RobotPoses | None
    """None where it failed"""
    distance: float
    """m, horizontal, of the centre of mass"""
    cost_of_transport: float
    """of `CostOfTransport`: since the gait began; NaN where the robot has no weight, or stays where it is
    (`stays_within`), or the method has no fixed step"""

    def words(self, error_bar: float | None, orbit: str = "") -> str:
        """The facts, as Markdown; `orbit`: the robot's orbit in words."""
        if self.poses is None:
            return f"**failed**: {FAILURES[int(self.trajectory.failure)]}"
        duration = float(self.trajectory.times[-1])
        moved = significant(self.distance)
        told = f"{moved} ± … m" if error_bar is None else known_words(self.distance, error_bar, " m", ".2g")
        cost = significant(self.cost_of_transport, 2, 2) if np.isfinite(self.cost_of_transport) else "not known"
        return (
            f"**{told}** in {duration:g} s  \n"
            f"speed {significant(self.distance / duration)} m/s  \n"
            f"cost of transport {cost}" + (f"  \n{orbit}" if orbit else "")
        )


class Robot3D(NamedTuple):
    """The page's robot, with everything constant while sliders move."""

    scene: Scene
    knobs: tuple[Knob, ...]
    duration: float
    roll: Callable[[dict[str, float]], Rolled]
    """by the values of the knobs"""
    error_bar: Callable[[Rolled, Callable[[], bool]], float | None]
    """m, of the centre of mass at the end; None where it was told to give up"""
    orbit: Callable[[Rolled], str]
    """what the robot settles on, in words"""


def gaits_for(scene: Scene) -> tuple[str, ...]:
    """The scene's own gait, and the library's gaits for its members."""
    fitting = [name for name in gait_names() if max(load_gait(name).members) < scene.structure.member_count]
    return (OWN, *fitting)


def chosen_robot(scene: str, contact: str, gait: str, duration: float) -> Robot3D:
    """The robot of a scene's name or file, on one of the contact models, with a gait of the library.

    Raises `InputError` where the scene has no gait, or has no twin on the other contact model.
    """
    found = load_scene(scene)
    if gait != OWN:
        found = with_gait(found, load_gait(gait))
    if contact == OTHER:
        found = contact_twin(found)
    known = knobs(found)
    # one step for all settings: that of the stiffest
    stiffest = {knob.name: knob.high for knob in known if knob.name == "cable stiffness"}
    options = resolve(adjusted(found, stiffest), duration)

    def roll(values: dict[str, float]) -> Rolled:
        scene = adjusted(found, values)
        trajectory = simulate(scene, duration, options=options, frame_rate=FRAME_RATE)
        return _rolled(scene, jax.block_until_ready(trajectory), options)

    def error_bar(rolled: Rolled, give_up: Callable[[], bool]) -> float | None:
        paths = [centre_path(rolled.scene, rolled.trajectory)]
        for finer in options.refined()[1:]:
            if give_up():
                return None
            trajectory = simulate(rolled.scene, duration, options=finer, frame_rate=FRAME_RATE)
            paths.append(centre_path(rolled.scene, trajectory))
        return float(refinement_bar(*(path[-1:] for path in paths))[0]) + timing_bar(rolled.scene, options)

    def orbit(rolled: Rolled) -> str:
        return watched_words(rolled.scene, options)

    return Robot3D(found, known, duration, roll, error_bar, orbit)


def watched_words(scene: Scene, options: ResolvedOptions) -> str:
    """The robot's long-run motion; the same number of periods for all gaits, so that none needs its own program."""
    try:
        period = period_of(scene.gait)
        found = find_orbit(scene, (WATCHED_PERIODS + 0.5) * period, options=options)
    except InputError as error:
        return f"orbit: {error}"
    watched = significant(found.verified_for, 0, 2)
    if not found.settled:
        return f"no orbit after {watched} s"
    if stays(scene, found.speed):
        return f"settles on an orbit: the robot stays where it is, seen for {watched} s"
    turning = np.degrees(found.turning)
    speed = f"{significant(found.speed)} m/s"
    return f"settles on an orbit: {speed}, turning by {significant(turning, 1, 2)}°/s, seen for {watched} s"


def _rolled(scene: Scene, trajectory: Trajectory, options: Options) -> Rolled:
    if trajectory.failed:
        return Rolled(scene, trajectory, None, np.nan, np.nan)
    poses = robot_poses(scene, trajectory, FRAME_RATE)
    moved = poses.centre[-1] - poses.centre[0]
    distance, duration = float(np.hypot(*moved[:2])), float(trajectory.times[-1])
    cost = np.nan if stays_within(scene, distance, duration) else _cost_of_transport(scene, duration, options)
    return Rolled(scene, trajectory, poses, distance, cost)


def _cost_of_transport(scene: Scene, duration: float, options: Options) -> float:
    """As in searches, from the steps and not from the frames; NaN without one."""
    assert scene.gait is not None, "the explorer's scenes have a gait"
    try:
        outcomes = simulate_population(scene, as_population(scene.gait), duration, options=options, with_metrics=True)
        return -float(CostOfTransport().worth(scene, outcomes, duration)[0])
    except InputError:  # no weight, or a method whose steps are not fixed
        return np.nan

"""What becomes of robots that are disturbed on an orbit: by how much deviations grow in a cycle, and who returns."""

from typing import NamedTuple

import numpy as np

from jaxgrity.core.typed import typed
from jaxgrity.model.scales import speed_scale
from jaxgrity.model.scene import Scene
from jaxgrity.orbits.cycles import moved_onto, plane_of
from jaxgrity.orbits.finding import SETTLED, Orbit, in_step, period_of, restarted
from jaxgrity.populations.population import gaits_of, simulate_population
from jaxgrity.populations.uncertainty import Differences
from jaxgrity.stepping.options import Options

DISTURBANCE = 0.1
"""Standard deviation of the disturbance of each coordinate of the nodes' velocities, m/s for a body of one metre."""
MINOR = 0.1
"""Share of the largest spread of disturbed robots. Directions in which they spread by less are not looked at."""
DIRECTIONS = 3
"""Most directions in which the spread of disturbed robots is looked at."""


class Stability(NamedTuple):
    """What becomes of robots that are disturbed on an orbit."""

    multipliers: np.ndarray
    """(directions,), by which deviations grow in a cycle, complex, largest first; the neutral ones, of a shift along
    the ground and a turn about the vertical, are taken out"""
    returned: float
    """share of the robots of which no coordinate is more than 2 `SETTLED` body lengths off the orbit, after one cycle
    and after two"""
    spread: float
    """m, root mean square deviation of a node after one cycle, of those that returned"""

    @property
    def largest(self) -> float:
        """The largest multiplier's size; infinite where no more than half of the robots returned."""
        return float(np.abs(self.multipliers).max()) if self.returned > 0.5 else np.inf


@typed
def stability(scene: Scene, orbit: Orbit, *, options: Options = None, robots: int = 128, seed: int = 0) -> Stability:
    """Disturb robots on the orbit, and see what becomes of their deviations.

    The velocities of all nodes get normal deviates of `DISTURBANCE`. After one cycle robots differ by d1 from the
    undisturbed one, after another by d2, planar motions taken out. The multipliers are the eigenvalues of the matrix A
    for which d2 = A d1 holds best, in those few directions in which robots spread at all. They are
    about positions, and about disturbances of that size. The derivative of a step-by-step method's own map is no such
    thing: where impacts fall on whole steps, it describes by how much a touch-down moves within its step
    (docs/gaits.md).

    Args:
        scene: with the gait of the orbit.
        orbit: as from `find_orbit`, by the same options.
        options: solver options; by default the scene decides.
        robots: how many are disturbed.
        seed: seed of the disturbances.

    Returns:
        Multipliers, and how many robots returned.

    Raises:
        InputError: bad options (see `resolve`), a scene without a gait.
    """
    period_of(scene.gait)
    here, v = restarted(scene, orbit), orbit.state[1]
    size = DISTURBANCE * float(speed_scale(scene))
    deviates = np.random.default_rng(seed).normal(0, size, (robots, *v.shape))
    # the first robot is the undisturbed one, with which all others are compared
    deviates[0] = 0
    differences = Differences(velocities=v + deviates)
    assert here.gait is not None, "an orbit has a gait"
    gaits = gaits_of(here.gait, np.repeat(np.asarray(here.gait.phase)[None], robots, axis=0))
    chosen, ends = in_step(scene, orbit.period, options), []
    # each from the start: a population returns no velocities from which to go on for a second cycle
    for cycles in (1, 2):
        outcomes = simulate_population(here, gaits, cycles * orbit.cycle, options=chosen, differences=differences)
        ends.append(np.where((np.asarray(outcomes.failure) == 0)[:, None, None], outcomes.positions, np.nan))
    mass, plane = np.asarray(scene.structure.lumped_mass, float), plane_of(scene)
    levelled = (end @ plane.axes for end in ends)
    d1, d2 = (np.array([moved_onto(mass, x, end[0], plane)[0] - end[0] for x in end]) for end in levelled)
    return _stability(d1[1:], d2[1:], orbit.body_length)


def _stability(d1: np.ndarray, d2: np.ndarray, size: float) -> Stability:
    """Of deviations (robots, nodes, 3), m, after one cycle and after two, of a robot so long."""
    near = np.nan_to_num(np.abs(d1), nan=np.inf).max((1, 2)) <= 2 * SETTLED * size
    back = near & (np.nan_to_num(np.abs(d2), nan=np.inf).max((1, 2)) <= 2 * SETTLED * size)
    # too few robots to fit a matrix between so many directions to
    if back.sum() <= 2 * DIRECTIONS:
        return Stability(np.array([np.inf]), float(back.mean()), np.inf)
    a, b = d1[back].reshape(back.sum(), -1), d2[back].reshape(back.sum(), -1)
    _, sizes, directions = np.linalg.svd(a, full_matrices=False)
    kept = directions[: max(1, int((sizes[:DIRECTIONS] > MINOR * sizes[0]).sum()))]
    fitted = np.linalg.lstsq(a @ kept.T, b @ kept.T, rcond=None)[0]
    found = np.linalg.eigvals(fitted)
    spread = float(np.sqrt(np.mean(np.sum(d1[back] ** 2, axis=2))))
    return Stability(found[np.argsort(-np.abs(found))], float(back.mean()), spread)

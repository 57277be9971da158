"""Stability of an orbit: growth of deviations per cycle, and the share of disturbed robots that return."""

from typing import NamedTuple

import numpy as np

from jaxgrity.core.arguments import check_count
from jaxgrity.core.typed import typed
from jaxgrity.model.scales import speed_scale
from jaxgrity.model.scene import Scene
from jaxgrity.orbits.cycles import moved_onto, plane_of
from jaxgrity.orbits.finding import SETTLED, Orbit, in_step, period_of, restarted
from jaxgrity.populations.population import gaits_of, simulate_population
from jaxgrity.populations.uncertainty import Differences
from jaxgrity.statics.stiffness import free_motions
from jaxgrity.stepping.options import Options

DISTURBANCE = 0.1
"""Standard deviation of the disturbance of each coordinate of the nodes' velocities, m/s for a body of one metre."""
MINOR = 0.1
"""Smallest spread of disturbed robots in a direction that counts, as a fraction of the largest spread."""
DIRECTIONS = 3
"""Largest number of directions in which the spread of disturbed robots is examined."""


class Stability(NamedTuple):
    """Floquet multipliers from disturbed robots, and the share that returns."""

    multipliers: np.ndarray
    """(directions,), complex Floquet multipliers per cycle, largest first; translation and yaw are excluded"""
    returned: float
    """share of robots that are within 2 `SETTLED` body lengths of the orbit in every coordinate, after one cycle and
    after two"""
    spread: float
    """root mean square deviation of a node after one cycle, for robots that return, m"""

    @property
    def largest(self) -> float:
        """Size of the largest multiplier; infinite if at most half of the robots return."""
        return float(np.abs(self.multipliers).max()) if self.returned > 0.5 else np.inf


@typed
def stability(scene: Scene, orbit: Orbit, *, options: Options = None, robots: int = 128, seed: int = 0) -> Stability:
    """Disturb robots on the orbit, and measure how their deviations grow.

    Velocities of all nodes get normal random numbers with the standard deviation `DISTURBANCE`. After one cycle robots
    deviate by d1 from the undisturbed robot, after two by d2, without planar motions. The multipliers are the
    eigenvalues of the matrix A that fits d2 = A d1 best, in the few directions in which robots spread. They describe
    positions, for disturbances of this size. The derivative of the stepped map differs: impacts fall on whole steps, so
    it describes how a touch-down moves within its step (docs/gait_records.md).

    Args:
        scene: the scene with the gait of the orbit.
        orbit: an orbit from `find_orbit` with the same options.
        options: solver options; by default the scene decides.
        robots: number of robots, the undisturbed one included.
        seed: seed of the disturbances.

    Returns:
        Multipliers, and the share of robots that return.

    Raises:
        InputError: bad options (see `resolve`), fewer than two robots, a negative seed, an orbit as for `restarted`, or
            a ground that is no plane.
    """
    period_of(scene.gait)
    check_count("robots", robots, 2)
    plane = plane_of(scene)
    here, v = restarted(scene, orbit), orbit.state[1]
    size = DISTURBANCE * float(speed_scale(scene))
    deviates = np.random.default_rng(check_count("seed", seed, 0)).normal(0, size, (robots, *v.shape))
    # the first robot is the undisturbed one, with which all others are compared
    deviates[0] = 0
    differences = Differences(velocities=v + _allowed(here, deviates))
    assert here.gait is not None, "an orbit has a gait"
    gaits = gaits_of(here.gait, np.repeat(np.asarray(here.gait.phase)[None], robots, axis=0))
    chosen, ends = in_step(scene, orbit.period, options), []
    # each from the start: a population returns no velocities from which to go on for a second cycle
    for cycles in (1, 2):
        outcomes = simulate_population(here, gaits, cycles * orbit.cycle, options=chosen, differences=differences)
        ends.append(np.where((np.asarray(outcomes.failure) == 0)[:, None, None], outcomes.positions, np.nan))
    mass = np.asarray(scene.structure.lumped_mass, float)
    levelled = (end @ plane.axes for end in ends)
    d1, d2 = (np.array([moved_onto(mass, x, end[0], plane)[0] - end[0] for x in end]) for end in levelled)
    return _stability(d1[1:], d2[1:], orbit.body_length)


def _allowed(scene: Scene, velocities: np.ndarray) -> np.ndarray:
    """The nearest velocities (robots, nodes, 3), m/s, that supports and rigid bodies allow."""
    structure = scene.structure
    if not (structure.fixed or structure.bodies):
        return velocities
    ways = free_motions(np.asarray(structure.nodes, float), structure.supported, structure.bodies)
    rows = velocities.reshape(len(velocities), -1)
    return (ways @ (ways.T @ rows.T)).T.reshape(velocities.shape)


def _stability(d1: np.ndarray, d2: np.ndarray, size: float) -> Stability:
    """Stability from deviations (robots, nodes, 3), m, after one cycle and after two; `size` is the body length."""
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

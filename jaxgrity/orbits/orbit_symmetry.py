"""The symmetry of an orbit: the shortest time after which the motion repeats itself with permuted nodes."""

from fractions import Fraction
from math import lcm
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene
from jaxgrity.model.symmetry import gene_permutations, symmetries
from jaxgrity.orbits.cycles import RETURNED, Plane, plane_of, shape
from jaxgrity.orbits.finding import Orbit, check_orbit, in_step, restarted
from jaxgrity.stepping.options import Options
from jaxgrity.stepping.simulate import simulate

LARGEST_PART = 12
"""Largest number of equal parts into which a symmetry may divide a period."""
SAME_SHAPE = 1e-6
"""Difference of shapes, in body lengths, that always counts as none, however closely the orbit returns."""
MOMENTS = 100
"""Number of moments per period at which robots' shapes are compared with the orbit's."""
SETTLING_CYCLES = 4
"""Number of cycles in which the robot settles at the step that the comparison needs."""


class Repetition(NamedTuple):
    """The time of a repetition, up to a planar motion and a common symmetry of robot and gait."""

    time: float
    """s; that of the whole cycle where no symmetry makes it shorter"""
    nodes: tuple[int, ...]
    """(nodes,): after that time node nodes[i] moves as node i did"""
    residual: float
    """m, largest difference then of heights of nodes and distances between them"""


@typed
def repetition(scene: Scene, orbit: Orbit, *, options: Options = None) -> Repetition:
    """The shortest time after which the motion repeats itself with permuted nodes.

    A symmetry g of the structure takes node i to g(i). Let a gait's phases satisfy p_g(k) = p_k - 2 pi s. Then member
    g(k) repeats member k after the time s T, with T the period. The motion may do so too: x_g(i)(t + (m + s) T) = G
    x_i(t), with m whole periods and G a planar motion, or its mirror image for a mirror g. Shapes over a whole cycle
    decide, as in `find_orbit`.

    Args:
        scene: with the gait of the orbit; its structure's own nodes decide the symmetries.
        orbit: as from `find_orbit`, by the same options.
        options: solver options; by default the scene's. The step is shortened until it divides the compared times.

    Returns:
        The repetition; the whole cycle where there is none sooner, or where the rollout failed.

    Raises:
        InputError: bad options (see `resolve`), positions that do not decide the symmetries (see `symmetries`).

    Example:
        >>> scene = jaxgrity.with_gait(jaxgrity.load_scene("exact"), jaxgrity.load_gait("lasting"))
        >>> orbit = jaxgrity.orbits.find_orbit(scene, 80.0)
        >>> found = jaxgrity.orbits.repetition(scene, orbit)
        >>> round(orbit.cycle / found.time)  # times in a cycle
        6
    """
    gait, plane = check_orbit(scene, orbit), plane_of(scene)
    found = [
        (share, symmetry.nodes)
        for symmetry in symmetries(scene.structure)
        if (share := _shift(gait, gene_permutations(gait.members, (symmetry,)))) is not None
    ]
    frames = 4 * lcm(*(share.denominator for share, _ in found))
    here = restarted(scene, orbit)
    chosen = in_step(scene, orbit.period / frames, options)
    duration = (SETTLING_CYCLES + 2) * orbit.cycle
    trajectory = simulate(here, duration, options=chosen, frame_rate=frames / orbit.period, velocities=orbit.state[1])
    whole = Repetition(orbit.cycle, tuple(range(len(scene.structure.nodes))), orbit.residual)
    if trajectory.failed:
        return whole
    long = frames * orbit.periods
    q = np.asarray(trajectory.positions, float)[-2 * long :] @ plane.axes
    limit = RETURNED * _change(q, plane, long, whole.nodes) + SAME_SHAPE * orbit.body_length
    lags = [(m * frames + int(share * frames), nodes) for share, nodes in found for m in range(orbit.periods)]
    for lag, nodes in sorted(lags):
        if 0 < lag < long and (change := _change(q, plane, lag, nodes)) <= limit:
            return Repetition(lag * orbit.period / frames, nodes, change)
    return whole


@typed
def distance_from_orbit(
    scene: Scene, orbit: Orbit, positions: AnyArray, *, options: Options = None
) -> Float[np.ndarray, " robots"]:
    """The distance of robots' shapes from the nearest shape on the orbit, or a symmetric image of it.

    Shapes are heights of nodes and distances between them: no planar motion changes them. Images are permutations of
    the nodes by the structure's symmetries. The orbit is sampled `MOMENTS` times in a period: a robot on it may be off
    by as much as shapes change in half of the time between samples.

    Args:
        scene: with the gait of the orbit; its structure's own nodes decide the symmetries.
        orbit: as from `find_orbit`, by the same options.
        positions: (robots, nodes, 3), m.
        options: solver options; by default the scene decides.

    Returns:
        (robots,), m, the largest difference of a height or a distance.

    Raises:
        InputError: positions of another shape, bad options (see `resolve`), nodes that do not decide the symmetries
            (see `symmetries`).
    """
    nodes = np.shape(scene.structure.nodes)
    if np.ndim(positions) != 3 or np.shape(positions)[1:] != nodes or not len(positions):
        raise InputError(
            f"positions have shape {np.shape(positions)}; expected (robots, {nodes[0]}, 3), at least one robot"
        )
    here, plane = restarted(scene, orbit), plane_of(scene)
    chosen, rate = in_step(scene, orbit.period / MOMENTS, options), MOMENTS / orbit.period
    trajectory = simulate(here, orbit.cycle, options=chosen, frame_rate=rate, velocities=orbit.state[1])
    through = np.array([shape(x, plane) for x in np.asarray(trajectory.positions, float) @ plane.axes])
    images = [list(symmetry.nodes) for symmetry in symmetries(scene.structure)]
    least = [
        min(np.abs(through - shape(x[image], plane)).max(1).min() for image in images)
        for x in np.asarray(positions, float) @ plane.axes
    ]
    return np.array(least)


def _change(q: np.ndarray, plane: Plane, lag: int, nodes: tuple[int, ...]) -> float:
    """m: the difference of the shapes in the first half of (frames, nodes, 3) from those a lag later, with node
    nodes[i] for i.
    """
    before = np.array([shape(x, plane) for x in q[: len(q) // 2]])
    after = np.array([shape(x[list(nodes)], plane) for x in q[lag : lag + len(before)]])
    return float(np.abs(after - before).max())


def _shift(gait: Gait, places: tuple[tuple[int, ...], ...]) -> Fraction | None:
    """The s in [0, 1) of a gait that follows a symmetry, from its phases; None of one that does not."""
    if not places:
        return None
    phase, amplitude, image = np.asarray(gait.phase, float), np.asarray(gait.amplitude, float), list(places[0])
    # overtones are not looked at: where they do not follow, neither do the shapes
    turns = (phase[image] - phase) / (2 * np.pi)
    share = Fraction(float(turns[0] % 1)).limit_denominator(LARGEST_PART)
    off = np.abs((turns - float(share) + 0.5) % 1 - 0.5)
    alike = off.max() < 1e-6 and np.allclose(amplitude[image], amplitude)
    return share % 1 if alike else None

"""What may be chosen of a six-strut robot and its gait, and how a choice rolls: for design_study.py."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity import Differences, Scene, SolverOptions, differing, forces_along, gaits_of, simulate, simulate_population
from jaxgrity.orbits import find_orbit, orbit_cycle

NAMES = (
    "cable stiffness",
    "cable rest length",
    "first pair of struts",
    "second pair",
    "third pair",
    "mass",
    "swing",
    "frequency",
)
"""factors of what scene and gait say: of lengths, the pairs' are those of the parallel struts as built, and rest
lengths are in proportion to the distances that the pairs leave between the nodes"""
LOWEST = np.log([0.5, 0.8, 0.75, 0.75, 0.75, 0.75, 0.2, 0.4])
HIGHEST = np.log([4.0, 1.15, 1.3, 1.3, 1.3, 1.5, 1.5, 2.0])
GAIT_ALONE = np.array([0, 0, 0, 0, 0, 0, 1, 1], float)
"""which of them are free where the robot stays as it is"""
FRICTIONS = (0.85, 1.0, 1.15)
"""times the scene's: each design is tried on so many robots"""
WATCHED = 100.0
"""s, for an orbit"""


class Limits(NamedTuple):
    """What a robot is built of."""

    strut_force: float
    """N, at which a strut of the scene's length buckles; Euler's load falls as the square of the length"""
    cable_force: float
    """N"""


class Tried(NamedTuple):
    """Designs that were tried, as logarithms of factors, and what they did: means over robots, peaks of the worst."""

    x: np.ndarray
    speed: np.ndarray
    force: np.ndarray
    """N, for a strut of the scene's length"""
    power: np.ndarray

    def joined(self, other: "Tried") -> "Tried":
        return Tried(*(np.concatenate(both) for both in zip(self, other)))

    def worth(self, limits: Limits, power: float) -> np.ndarray:
        """The speed; below zero, the farther the more, where a limit is passed."""
        beyond = np.maximum(self.force / limits.strut_force, 1) + np.maximum(self.power / power, 1) - 2
        return np.where(beyond > 0, -beyond, self.speed)


def difference(scene: Scene, x: Any) -> Differences:
    """How the robot of a design differs from the scene's."""
    stiffness, slack, pairs, mass = jnp.exp(x[0]), jnp.exp(x[1]), jnp.repeat(jnp.exp(x[2:5]), 2), jnp.exp(x[5])
    nodes, cables = jnp.asarray(scene.structure.nodes), np.array(scene.structure.cables.edges)
    ends = np.array(scene.structure.struts.edges)
    middle = jnp.zeros_like(nodes).at[ends].set(nodes[ends].mean(1, keepdims=True))
    placed = middle + (nodes - middle) * jnp.zeros_like(nodes).at[ends].set(pairs[:, None, None])
    placed = placed.at[:, 2].add(nodes[:, 2].min() - placed[:, 2].min())
    lengths = [jnp.linalg.norm(at[cables[:, 0]] - at[cables[:, 1]], axis=1) for at in (nodes, placed)]
    ones = jnp.ones(len(cables))
    return Differences(
        cable_stiffness=stiffness * ones,
        cable_rest_length=slack * lengths[1] / lengths[0],
        strut_rest_length=pairs,
        node_mass=mass * jnp.ones(len(nodes)),
        positions=placed,
    )


def designed(scene: Scene, x: Any) -> Scene:
    """The scene with one design."""
    scene = differing(scene, difference(scene, x))
    for place, factor in ((lambda s: s.gait.amplitude, jnp.exp(x[6])), (lambda s: s.gait.frequency, jnp.exp(x[7]))):
        scene = eqx.tree_at(place, scene, place(scene) * factor)
    return scene


def longest(x: np.ndarray) -> np.ndarray:
    """The longest strut, times the scene's."""
    return np.exp(x[..., 2:5]).max(-1)


def tried(scene: Scene, x: np.ndarray, duration: float) -> Tried:
    """All designs at once, each on robots with several frictions, from rest, in float32."""
    count, robots, gait = len(x), len(FRICTIONS), scene.gait
    every = np.repeat(x, robots, axis=0)
    differences = jax.vmap(lambda each: difference(scene, each))(jnp.asarray(every))
    differences = eqx.tree_at(
        lambda d: d.friction, differences, np.tile(FRICTIONS, count), is_leaf=lambda leaf: leaf is None
    )
    ones = np.ones((len(every), len(gait.phase)))
    swing, frequency = np.exp(every[:, 6:7]), np.exp(every[:, 7:8])
    gaits = gaits_of(gait, ones * gait.phase, ones * gait.amplitude * swing, ones * gait.frequency * frequency)
    found = simulate_population(
        scene,
        gaits,
        duration,
        options=SolverOptions(dtype="float32"),
        differences=differences,
        with_metrics=True,
        parts=4,
    )
    path, metrics = np.asarray(found.com_path, float), found.metrics
    speed = np.hypot(*(path[:, 4] - path[:, 1])[:, :2].T) / (0.75 * duration)
    failed = np.asarray(found.failure) != 0
    peaks = [np.where(failed, np.inf, np.asarray(peak).max(1)) for peak in (metrics.peak_force, metrics.peak_power)]
    force, power = (peak.reshape(count, robots).max(1) for peak in peaks)
    return Tried(x, np.where(failed, 0, speed).reshape(count, robots).mean(1), force * longest(x) ** 2, power)


def on_orbit(scene: Scene, x: np.ndarray) -> dict[str, Any]:
    """What a design does in a cycle of the orbit that it settles on."""
    robot = designed(scene, x)
    orbit = find_orbit(robot, max(WATCHED, 60 / float(robot.gait.frequency[0])))
    cycle = orbit_cycle(robot, orbit)
    trajectory = simulate(robot, 20.0, frame_rate=100.0)
    cables = np.asarray(forces_along(robot, trajectory).tension)[len(trajectory.times) // 2 :, len(robot.gait.phase) :]
    return {
        "speed": orbit.speed,
        "settled": orbit.settled,
        "strut_force": cycle.peak_force * float(longest(x)) ** 2,
        "cable_force": float(np.max(cables)),
        "peak_power": cycle.peak_power,
        "cost_of_transport": cycle.cost_of_transport,
        "factors": dict(zip(NAMES, np.exp(x))),
    }


def keeps(found: dict[str, Any], limits: Limits, power: float) -> bool:
    """Whether an orbit is one, within all limits."""
    forces = found["strut_force"] <= limits.strut_force and found["cable_force"] <= limits.cable_force
    return found["settled"] and forces and found["peak_power"] <= power

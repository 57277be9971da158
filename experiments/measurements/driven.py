"""What measurements of feedback share: the robot of the gait "lasting" with motors, and how robots are dropped."""

import math

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrity import Scene, SolverOptions, as_dtype, load_gait, load_scene
from jaxgrity.control import (
    Loop,
    MotorLimits,
    PhaseLocked,
    Plant,
    Policy,
    Steered,
    centre_offsets,
    loop_start,
    plant_of,
)
from jaxgrity.model import body_length

RATE = 1.2
"""m/s, of the motors"""
PART = 5.0
"""s, over each of which speeds are measured"""
ENOUGH = 0.85
"""share of the orbit's speed from which on a robot counts as rolling"""
SPEED, SPIN = 1.0, 2.0
"""m/s and rad/s, standard deviations of the components of the velocity and of the spin at the start"""


def bounded(scene: Scene, rate: float = RATE) -> Plant:
    """A plant in single precision, at a coarse step where struts are rigid; its motors have a rate, m/s."""
    options = SolverOptions(dt=0.01 if scene.constrained else None, dtype="float32")
    motors = MotorLimits(rate=rate if math.isfinite(rate) else None)
    return plant_of(scene, load_gait("lasting").members, motors=motors, options=options)


def straight_on() -> Steered:
    """The gait with feedback, which keeps its direction."""
    scene, gait = load_scene("exact"), load_gait("lasting")
    return as_dtype(Steered(PhaseLocked(gait), np.array(0.0), centre_offsets(scene.structure, gait.members)), "float32")


def drops(scene: Scene, robots: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions, m, and velocities, m/s, (robots, nodes, 3), of robots in the air: rigid motions, any way up."""
    draw = np.random.default_rng(seed)
    mass, x = np.asarray(scene.structure.lumped_mass, float), np.asarray(scene.structure.nodes, float)
    body = x - mass @ x / mass.sum()
    turned = np.einsum("rij,nj->rni", Rotation.random(robots, rng=draw).as_matrix(), body)
    height = draw.uniform(0, float(body_length(scene)), robots)
    q = turned - turned[:, :, 2].min(1)[:, None, None] * [0, 0, 1] + height[:, None, None] * [0, 0, 1]
    spin = draw.normal(0, SPIN, (robots, 1, 3))
    return q, draw.normal(0, SPEED, (robots, 1, 3)) + np.cross(spin, turned)


def dropped_loop(
    many: Plant, policy: Policy, start: tuple[np.ndarray, np.ndarray], groups: int = 1, seed: int = 0
) -> Loop:
    """The loop of robots side by side, each with a policy of its own, from where robots are dropped; every one of the
    groups from the same drops."""
    placed = tuple(np.moveaxis(np.tile(x, (groups, 1, 1)), 0, -1) for x in start)
    return loop_start(many, policy, jax.random.key(seed), placed, each=True)

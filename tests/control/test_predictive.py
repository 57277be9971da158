"""Model-predictive control: what makes a sample good, and that a robot follows the best."""

import jax
import numpy as np
import pytest

import jaxgrity
from jaxgrity import PhaseLocked, Sampling, SolverOptions, Steered, centre_offsets


def test_costs_prefer_early_arrivals_and_refuse_failures():
    """Of samples that end 2 m away, arrive at the third look, at the second, and fail on the spot."""
    x = np.array([[3.0, 3.0, 3.0, 0.0], [2.5, 1.0, 0.1, 0.0], [2.0, 0.1, 4.0, 0.0]])
    path = np.stack([x, np.zeros_like(x)], axis=1)
    found = jaxgrity.costs(path, np.array([0, 0, 0, 1]), np.zeros(2))
    np.testing.assert_array_equal(np.argsort(found), [2, 1, 0, 3])
    assert found[0] == 2.0
    assert found[3] == np.inf


@pytest.mark.slow
def test_a_robot_that_is_led_to_a_goal_comes_closer_than_one_that_is_not():
    """The goal is behind where the open loop rolls to; the model is the robot itself."""
    scene, gait = jaxgrity.load_scene("exact"), jaxgrity.load_gait("lasting")
    plant = jaxgrity.plant_of(scene, gait.members, options=SolverOptions(dt=0.01, dtype="float32"))
    policy = jaxgrity.as_dtype(
        Steered(PhaseLocked(gait), np.array(0.0), centre_offsets(scene.structure, gait.members)), "float32"
    )
    loop = jaxgrity.loop_start(plant, policy, jax.random.key(0))
    alone = np.asarray(jaxgrity.drive(plant, policy, loop, 10, 100).path)[:, :2]
    goal = -alone[-1]
    led = jaxgrity.lead_to(plant, plant, policy, goal, sampling=Sampling(samples=16, patience=10.0))
    away = lambda path: np.linalg.norm(path[:, :2] - goal, axis=1).min()  # noqa: E731
    assert away(led.path) < away(alone) - 2
    assert len(led.bends) == led.seconds / 0.5
    assert np.abs(led.bends).max() <= 0.6

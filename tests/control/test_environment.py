"""Environments: the same seed is the same episode, numbers stay finite, and Gymnasium's own check passes."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import jaxgrity
from jaxgrity import InputError, SolverOptions

QUICK = SolverOptions(dt=0.01, dtype="float32")


@pytest.fixture(scope="module")
def scene():
    return jaxgrity.load_scene("exact")


@pytest.fixture(scope="module")
def goal(scene):
    """With 0.2 s for the goal."""
    return jaxgrity.environment("goal", scene, options=QUICK, seconds=0.2)


def test_many_episodes_under_a_random_policy(goal):
    """Mapped and jitted: they differ, are over in time, can be repeated, and hold no number that is not finite."""
    keys = jax.random.split(jax.random.key(0), 4)

    @jax.jit
    def episodes(keys):
        def step(state, key):
            actions = jax.random.uniform(key, (4, goal.action_size), minval=-1.5, maxval=1.5)
            state = jax.vmap(goal.step)(state, actions)
            return state, (state.obs, state.reward, state.done)

        return jax.lax.scan(step, jax.vmap(goal.reset)(keys), jax.random.split(keys[0], 20))

    _, (obs, reward, done) = episodes(keys)
    assert obs.shape == (20, 4, goal.observation_size)
    assert np.all(np.isfinite(obs))
    assert np.all(np.isfinite(reward))
    assert np.ptp(reward[-1]) > 0
    np.testing.assert_array_equal(done.sum(0), 1)
    np.testing.assert_array_equal(done[-1], 1)
    np.testing.assert_array_equal(episodes(keys)[1][1], reward)


def test_an_episode_is_over_at_the_goal_and_where_the_rollout_fails(goal):
    """A failed one has an observation and a reward of zero."""
    state = jax.jit(goal.reset)(jax.random.key(0))
    step = jax.jit(goal.step)
    place = jaxgrity.centre_of_mass(goal.plant.scene, state.plant.motion[0])[:2]
    there = step(replace(state, aim=place), jnp.zeros(6))
    assert there.done == there.metrics["reached"] == 1
    q, v = state.plant.motion
    lost = step(replace(state, plant=state.plant._replace(motion=(q * jnp.nan, v))), jnp.zeros(6))
    assert lost.done == lost.metrics["failed"] == 1
    assert lost.reward == 0
    assert not lost.obs.any()


@pytest.mark.slow
@pytest.mark.parametrize("task", ["heading", "slope", "bumps", "recover"])
def test_starts_stand_just_above_their_ground(task, scene):
    """Within a body length where the robot has fallen, and within a few centimetres else; seeds draw other starts."""
    env = jaxgrity.environment(task, scene, options=QUICK)
    ground = env.plant.scene.ground

    @jax.jit
    @jax.vmap
    def starts(key):
        q, v = jaxgrity.task_start(env.task, env.plant.scene, key)
        return q, v, jnp.min(ground.signed_distance(q))

    q, v, gaps = starts(jax.random.split(jax.random.key(0), 3))
    assert 0 < gaps.min() <= gaps.max() < (1.1 if env.task.fallen else 0.05)
    assert np.abs(q[0] - q[1]).max() > 0.1
    assert np.any(v) == env.task.fallen


@pytest.mark.slow
def test_gymnasium_accepts_the_adapter(goal):
    """By its own check, warnings being errors; time that is up truncates an episode."""
    env = jaxgrity.GymnasiumEnvironment(goal)
    check_env(env, skip_render_check=True)
    env.reset(seed=1)
    ends = [env.step(np.zeros(6, np.float32))[2:4] for _ in range(20)]
    assert ends == [(False, False)] * 19 + [(False, True)]


def test_bad_input_is_refused(scene):
    """In one line, before anything compiles."""
    with pytest.raises(InputError, match="task = 'fly': unknown"):
        jaxgrity.environment("fly", scene)
    with pytest.raises(InputError, match="the scene has no gait"):
        jaxgrity.environment("speed", jaxgrity.with_gait(scene, None))
    env = jaxgrity.environment("speed", scene)
    with pytest.raises(InputError, match="key = 0: expected a key"):
        env.reset(0)
    with pytest.raises(InputError, match=r"action has shape \(\); expected \(6,\)"):
        env.step(jax.eval_shape(env.reset, jax.random.key(0)), np.zeros(()))

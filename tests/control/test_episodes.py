"""Episodes as learners use them: begun anew by wrappers, cut by their time, and with actions that are not numbers."""

from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrity
from jaxgrity import InputError, SolverOptions, control

QUICK = SolverOptions(dt=0.01, dtype="float32")
LENGTH = 4
"""control periods of an episode"""


@pytest.fixture(scope="module")
def goal():
    """With an episode of `LENGTH` for the goal."""
    return control.environment("goal", jaxgrity.load_scene("exact"), options=QUICK, seconds=LENGTH * 0.01)


class Restarting:
    """What Brax's wrappers promise: episodes of equal length, of which the next one starts as the first one did.

    A wrapper knows the pipeline's state, the observation and what it keeps in `info`, and nothing else.
    """

    def __init__(self, env, length: int):
        self.env, self.length = env, length

    def reset(self, key) -> Any:
        state = self.env.reset(key)
        state.info.update(steps=jnp.zeros(()), truncation=jnp.zeros(()), first=(state.pipeline_state, state.obs))
        return state

    def step(self, state, action) -> Any:
        before = jnp.where(state.done > 0, 0.0, state.info["steps"])
        state = state.replace(info=state.info | {"steps": before}, done=jnp.zeros_like(state.done))
        state = self.env.step(state, action)
        late = before + 1 >= self.length
        cut = jnp.where(late, 1 - state.done, 0.0)
        done = jnp.where(late, jnp.ones_like(state.done), state.done)
        new = jax.tree.map(
            lambda x, y: jnp.where(done > 0, x, y), state.info["first"], (state.pipeline_state, state.obs)
        )
        info = state.info | {"steps": before + 1, "truncation": cut}
        return state.replace(pipeline_state=new[0], obs=new[1], done=done, info=info)


def rolled(env, state, actions):
    """What is told after each of some actions."""

    def step(state, action):
        state = env.step(state, action)
        return state, (
            state.done,
            state.info["truncation"],
            state.metrics["failed"],
            state.metrics["reached"],
            state.obs,
        )

    return jax.jit(lambda state, actions: jax.lax.scan(step, state, actions)[1])(state, actions)


def test_a_robot_that_failed_once_has_not_failed_in_the_next_episode(goal):
    """Where both time limits are equal, episodes that fail are terminated, and those that do not are cut."""
    env = Restarting(goal, LENGTH)
    actions = np.zeros((3 * LENGTH, goal.action_size), np.float32)
    actions[1, 2] = np.nan
    start = jax.jit(env.reset)(jax.random.key(0))
    done, cut, failed, reached, obs = rolled(env, start, actions)
    ends = np.array([1, 1 + LENGTH, 1 + 2 * LENGTH])
    np.testing.assert_array_equal(np.flatnonzero(done), ends)
    np.testing.assert_array_equal(np.flatnonzero(failed), ends[:1])
    np.testing.assert_array_equal(np.flatnonzero(cut), ends[1:])
    assert not reached.any()
    for end in ends:
        np.testing.assert_array_equal(obs[end], start.obs)
    assert np.isfinite(obs).all()


def test_a_goal_that_is_reached_is_to_be_reached_again(goal):
    """An episode that starts at its goal is over at once, and so is the next one: no earlier, and not by its time."""
    env = Restarting(goal, LENGTH)
    start = jax.jit(env.reset)(jax.random.key(0))
    here = start.pipeline_state._replace(aim=jnp.zeros(2, jnp.float32))
    start = start.replace(pipeline_state=here, info=start.info | {"first": (here, start.obs)})
    done, cut, failed, reached, _ = rolled(env, start, np.zeros((3, goal.action_size), np.float32))
    np.testing.assert_array_equal(done, 1)
    np.testing.assert_array_equal(reached, 1)
    assert not cut.any()
    assert not failed.any()


def test_an_episode_that_is_over_stays_as_it_ended(goal):
    """After a failure as after the time that is up; nothing that is told changes but the reward, which is 0."""
    for broken in (False, True):
        actions = np.ones((LENGTH + 2, goal.action_size), np.float32)
        if broken:
            actions[1] = np.nan
        state, seen = goal.reset(jax.random.key(1)), []
        step = jax.jit(goal.step)
        for action in actions:
            state = step(state, action)
            seen.append(state)
        end = seen[1 if broken else LENGTH - 1]
        assert end.done == 1
        assert end.info["truncation"] == 1 - broken
        for later in seen[LENGTH:]:
            assert (later.done, later.reward, later.info["truncation"]) == (1, 0, 1 - broken)
            assert later.metrics["failed"] == broken
            jax.tree.map(np.testing.assert_array_equal, later.obs, end.obs)
            np.testing.assert_array_equal(later.pipeline_state.plant.motion[0], end.pipeline_state.plant.motion[0])
            assert later.pipeline_state.plant.tick == end.pipeline_state.plant.tick


def test_an_action_that_is_not_a_number_is_refused_where_it_is_known(goal):
    state = jax.eval_shape(goal.reset, jax.random.key(0))
    action = np.zeros(goal.action_size)
    action[3] = np.nan
    with pytest.raises(InputError, match=r"action = \[0.0, 0.0, 0.0, nan, 0.0, 0.0\]: expected numbers from -1 to 1"):
        goal.step(state, action)


def damaged(key, shape: tuple[int, ...]):
    """Random actions, of which one number in 60 is none, or infinite."""
    actions = np.asarray(jax.random.normal(key, shape), np.float32)
    draws = np.asarray(jax.random.uniform(jax.random.fold_in(key, 1), shape))
    for bad, part in ((np.nan, 0.005), (np.inf, 0.01), (-np.inf, 0.015)):
        actions = np.where((draws < part) & (draws >= part - 0.005), bad, actions).astype(np.float32)
    return actions


@pytest.mark.parametrize(
    ("task", "name", "robots", "ticks"),
    [
        pytest.param("heading", "exact", 8, 12, marks=pytest.mark.slow),
        *[
            pytest.param(task, name, 100, 100, marks=pytest.mark.campaign)
            for task in control.TASKS
            for name in ("exact", "reference")
        ],
    ],
)
def test_all_that_is_told_is_finite_under_actions_that_are_not(task, name, robots, ticks):
    """And every robot with an action that is not a number has failed from then on; infinite ones count as 1 or -1."""
    options = SolverOptions(dtype="float32", dt=0.01) if name == "exact" else SolverOptions(dtype="float32")
    env = control.environment(task, jaxgrity.load_scene(name), options=options)
    actions = damaged(jax.random.key(5), (ticks, robots, env.action_size))

    def step(state, action):
        state = jax.vmap(env.step)(state, action)
        return state, (state.obs, state.reward, state.metrics, state.done)

    states = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(4), robots))
    _, (obs, reward, metrics, done) = jax.jit(lambda s, a: jax.lax.scan(step, s, a))(states, actions)
    for told in (obs, reward, *metrics.values()):
        assert np.isfinite(told).all()
    lost = np.maximum.accumulate(np.isnan(actions).any(2), axis=0)
    assert 0 < lost[-1].sum() < robots or robots > 50
    np.testing.assert_array_equal(np.asarray(metrics["failed"]) > 0, lost)
    np.testing.assert_array_equal(np.asarray(done)[lost], 1)


@pytest.mark.slow
def test_training_wrappers_of_gymnasium(goal):
    """Its time limit, its statistics, and robots in a vector, whose episodes begin anew after failures and in time."""

    def made():
        limited = gymnasium.wrappers.TimeLimit(control.GymnasiumEnvironment(goal), 3)
        return gymnasium.wrappers.RecordEpisodeStatistics(limited)

    envs = gymnasium.vector.SyncVectorEnv([made, made])
    envs.reset(seed=[1, 2])
    bad = np.zeros((2, goal.action_size), np.float32)
    bad[1] = np.nan
    told = []
    for k in range(8):
        obs, reward, terminated, truncated, _ = envs.step(bad if k == 1 else 0 * np.nan_to_num(bad))
        assert np.isfinite(obs).all()
        assert np.isfinite(reward).all()
        told.append((terminated.tolist(), truncated.tolist()))
    # each episode takes three steps, and one to begin anew
    assert [k for k, (over, _) in enumerate(told) if over[0]] == []
    assert [k for k, (_, cut) in enumerate(told) if cut[0]] == [2, 6]
    assert [k for k, (over, _) in enumerate(told) if over[1]] == [1]
    assert [k for k, (_, cut) in enumerate(told) if cut[1]] == [5]

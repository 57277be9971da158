"""Environments by Gymnasium's names: one robot with pictures, and many in one call whose episodes begin anew."""

import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from jaxgrity import InputError, SolverOptions, control, load_scene

SETTINGS = {"options": SolverOptions(dt=0.01, dtype="float32"), "seconds": 0.03}
"""cheap, and episodes of three control periods"""


@pytest.mark.slow
def test_an_environment_is_made_by_its_name_and_drawn():
    """Gymnasium's own check passes, pictures included; a robot that moves looks another, before the same camera."""
    env = gymnasium.make("jaxgrity.control.gym:jaxgrity/Goal-v0", render_mode="rgb_array", **SETTINGS)
    check_env(env.unwrapped)
    env.reset(seed=3)
    first = env.render()
    ends = [env.unwrapped.step(env.action_space.sample())[2:4] for _ in range(4)]
    assert ends == [(False, False)] * 2 + [(False, True)] * 2
    later = env.render()
    assert first.shape == later.shape == (272, 480, 3)
    assert np.ptp(first) > 100
    assert (first != later).any()
    assert gymnasium.make("jaxgrity/Goal-v0", **SETTINGS).unwrapped.reset(seed=3)[0].shape == (104,)
    with pytest.raises(gymnasium.error.ResetNeeded, match="expected a reset"):
        control.GymnasiumEnvironment(env.unwrapped.environment).step(np.zeros(6, np.float32))
    with pytest.raises(InputError, match="render_mode = 'human'"):
        control.GymnasiumEnvironment(env.unwrapped.environment, "human")


@pytest.mark.campaign
def test_many_robots_are_one_call_and_begin_anew():
    """After failures and in time, each by itself; the robot that goes on moves as one alone does."""
    envs = gymnasium.make_vec("jaxgrity.control.gym:jaxgrity/Heading-v0", num_envs=3, **SETTINGS)
    assert isinstance(envs, control.GymnasiumVectorEnvironment)
    with pytest.raises(gymnasium.error.ResetNeeded):
        envs.step(np.zeros((3, 6), np.float32))
    first, _ = envs.reset(seed=1)
    assert first.shape == envs.observation_space.shape == (3, 104)
    assert np.abs(first[0] - first[1]).max() > 0.1
    again, _ = envs.reset(seed=1)
    np.testing.assert_array_equal(first, again)
    alone = envs.environment.step(jax.tree.map(lambda x: x[2], envs._state), np.full(6, 0.5, np.float32))
    bad = np.full((3, 6), 0.5, np.float32)
    bad[1] = np.nan
    told = [envs.step(bad if k == 0 else np.nan_to_num(bad)) for k in range(7)]
    np.testing.assert_allclose(told[0][0][2], alone.obs, atol=1e-5)
    for obs, reward, *_ in told:
        assert np.isfinite(obs).all()
        assert np.isfinite(reward).all()
    over, cut = (np.array([step[k] for step in told]) for k in (2, 3))
    assert np.flatnonzero(over[:, 1]).tolist() == [0]  # which begins anew in the step after that
    assert np.flatnonzero(cut[:, 1]).tolist() == [4]
    assert np.flatnonzero(cut[:, 0]).tolist() == [2, 6]
    assert not over[:, 0].any()
    np.testing.assert_array_equal(told[3][1][[0, 2]], 0.0)
    assert np.abs(told[3][0][0] - told[2][0][0]).max() > 0.1


def test_actions_for_other_robots_are_refused():
    """In one line, before anything compiles."""
    envs = control.GymnasiumVectorEnvironment(control.environment("speed", load_scene("exact"), **SETTINGS), 3)
    for shape in ((2, 6), (3, 5), (6,)):
        with pytest.raises(InputError, match=r"actions have shape .*; expected \(3, 6\)"):
            envs.step(np.zeros(shape, np.float32))

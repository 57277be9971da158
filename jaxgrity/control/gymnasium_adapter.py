"""Environments as Gymnasium knows them (the extra `gym`): one robot, NumPy in and out."""

from typing import Any

import jax
import numpy as np

from jaxgrity.control.environments import Environment, EnvironmentState
from jaxgrity.core.errors import InputError

try:
    import gymnasium
except ImportError as error:
    raise InputError("Gymnasium is not installed; expected it, as by: pip install 'jaxgrity[gym]'") from error


class GymnasiumEnvironment(gymnasium.Env):
    """An `Environment` with Gymnasium's interface.

    The time that is up truncates an episode; a goal that is reached, or a rollout that failed, terminates it.

    Example:
        >>> goal = jaxgrity.control.environment("goal", jaxgrity.load_scene("exact"))
        >>> env = jaxgrity.control.GymnasiumEnvironment(goal)
        >>> observation, info = env.reset(seed=0)
        >>> env.action_space.shape
        (6,)
    """

    def __init__(self, environment: Environment):
        self.environment = environment
        self.action_space = gymnasium.spaces.Box(-1, 1, (environment.action_size,), np.float32)
        # numbers are always finite
        most = np.finfo(np.float32).max
        self.observation_space = gymnasium.spaces.Box(-most, most, (environment.observation_size,), np.float32)
        self._reset, self._step = jax.jit(environment.reset), jax.jit(environment.step)
        self._state: EnvironmentState | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """The first observation of an episode that `seed`, or else the last one's random numbers, draw."""
        super().reset(seed=seed)
        self._state = self._reset(jax.random.key(int(self.np_random.integers(2**31))))
        return np.asarray(self._state.obs, np.float32), self._told()

    def step(self, action):
        """Observation, reward, whether the episode terminated, whether it was truncated, and the metrics.

        Raises Gymnasium's `ResetNeeded` before the first reset.
        """
        if self._state is None:
            raise gymnasium.error.ResetNeeded("step: expected a reset before it")
        self._state = self._step(self._state, action)
        told = self._told()
        over = bool(told["reached"] or told["failed"])
        truncated = bool(self._state.done) and not over
        return np.asarray(self._state.obs, np.float32), float(self._state.reward), over, truncated, told

    def _told(self) -> dict[str, float]:
        assert self._state is not None, "an episode has begun"
        return {name: float(value) for name, value in self._state.metrics.items()}

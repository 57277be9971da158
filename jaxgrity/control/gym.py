"""Environments as Gymnasium knows them (the extra `gym`): NumPy in and out, one robot or many side by side.

Importing this module registers `jaxgrity/Speed-v0` and those of the other `TASKS`, so that
`gymnasium.make("jaxgrity.control.gym:jaxgrity/Speed-v0")` finds them, and `gymnasium.make_vec` likewise.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.environments import Environment, EnvironmentState, environment
from jaxgrity.control.tasks import TASKS
from jaxgrity.core.arguments import check_count
from jaxgrity.core.display import of_report
from jaxgrity.core.errors import InputError, unknown
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray
from jaxgrity.io.scene_files import load_scene
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.simulate import Trajectory

try:
    import gymnasium
except ImportError as error:
    raise InputError("Gymnasium is not installed; expected it, as by: pip install 'jaxgrity[gym]'") from error

FRAME_RATE = 100
"""Control periods in a second, and so pictures in a second of a film."""
WIDTH = 480
"""Width of a picture, pixels."""


def _spaces(environment: Environment) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    """Of an observation, whose numbers are always finite, and of an action."""
    most = np.finfo(np.float32).max
    seen = gymnasium.spaces.Box(-most, most, (environment.observation_size,), np.float32)
    return seen, gymnasium.spaces.Box(-1, 1, (environment.action_size,), np.float32)


class GymnasiumEnvironment(gymnasium.Env):
    """An `Environment` with Gymnasium's interface.

    The time that is up truncates an episode; a goal that is reached, or a rollout that failed, terminates it. With the
    render mode "rgb_array" `render` has a picture of the robot, from a camera that goes along.

    Raises `InputError` for another render mode.

    Example:
        >>> goal = jaxgrity.control.environment("goal", jaxgrity.load_scene("exact"))
        >>> env = jaxgrity.control.GymnasiumEnvironment(goal)
        >>> observation, info = env.reset(seed=0)
        >>> env.action_space.shape
        (6,)
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": FRAME_RATE}

    @typed
    def __init__(self, environment: Environment, render_mode: str | None = None):
        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            raise InputError(f"render_mode = {render_mode!r}: {unknown(render_mode, modes)}; expected one of {modes}")
        self.environment, self.render_mode = environment, render_mode
        self.observation_space, self.action_space = _spaces(environment)
        self._reset, self._step = jax.jit(environment.reset), jax.jit(environment.step)
        self._state: EnvironmentState | None = None
        self._places: list[np.ndarray] = []
        self._stage: Any = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """The first observation of an episode that `seed`, or else the last one's random numbers, draw."""
        super().reset(seed=seed)
        self._places, self._stage = [], None
        return self._entered(self._reset(jax.random.key(int(self.np_random.integers(2**31)))))

    def step(self, action):
        """Observation, reward, whether the episode terminated, whether it was truncated, and the metrics.

        Raises Gymnasium's `ResetNeeded` before the first reset.
        """
        state = self._step(self._begun("step"), action)
        observation, told = self._entered(state)
        over = bool(told["reached"] or told["failed"])
        return observation, float(state.reward), over, bool(state.done) and not over, told

    def render(self) -> np.ndarray | None:
        """A picture, (height, width, 3), in bytes; None without a render mode.

        Raises Gymnasium's `ResetNeeded` before the first reset.
        """
        self._begun("render")
        if self.render_mode is None:
            return None
        motion = _moved(self.environment, self._places)
        if self._stage is None:
            self._stage = of_report("stages", "FollowingStage")(self.environment.plant.scene, motion, WIDTH)
        self._stage.follow(motion)
        return np.asarray(self._stage.picture(len(self._places) - 1))

    def _begun(self, method: str) -> EnvironmentState:
        if self._state is None:
            raise gymnasium.error.ResetNeeded(f"{method}: expected a reset before it")
        return self._state

    def _entered(self, state: EnvironmentState) -> tuple[np.ndarray, dict[str, float]]:
        """The observation and the metrics of a state, which is the present one from now on."""
        self._state = state
        if self.render_mode is not None:
            self._places.append(np.asarray(state.pipeline_state.plant.motion[0]))
        return np.asarray(state.obs, np.float32), {name: float(value) for name, value in state.metrics.items()}


class GymnasiumVectorEnvironment(gymnasium.vector.VectorEnv):
    """Many robots in an `Environment`, side by side in one compiled call, with Gymnasium's interface.

    Where an episode is over, the next step begins another, whatever the action (Gymnasium's `NEXT_STEP`). Robots start
    and are disturbed by random numbers of their own.

    Raises `InputError` for no robots.
    """

    metadata = {"autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP}

    @typed
    def __init__(self, environment: Environment, num_envs: int = 64):
        self.environment, self.num_envs = environment, check_count("num_envs", num_envs, 1)
        self.single_observation_space, self.single_action_space = _spaces(environment)
        self.observation_space, self.action_space = (
            gymnasium.vector.utils.batch_space(space, num_envs)
            for space in (self.single_observation_space, self.single_action_space)
        )
        self._reset = jax.jit(jax.vmap(environment.reset))
        self._step = jax.jit(partial(_stepped_or_begun, environment))
        self._state: EnvironmentState | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """The first observations (num_envs, observation_size), and the metrics."""
        super().reset(seed=seed)
        self._state = self._reset(self._keys())
        return np.asarray(self._state.obs, np.float32), self._told()

    def step(self, actions):
        """Of `actions` (num_envs, action_size): observations, rewards, terminations, truncations, and the metrics.

        Raises Gymnasium's `ResetNeeded` before the first reset, and `InputError` for actions of another shape.
        """
        if np.shape(actions) != self.action_space.shape:
            raise InputError(f"actions have shape {np.shape(actions)}; expected {self.action_space.shape}")
        if self._state is None:
            raise gymnasium.error.ResetNeeded("step: expected a reset before it")
        self._state = self._step(self._state, jnp.asarray(actions), self._keys())
        told = self._told()
        over = (told["reached"] > 0) | (told["failed"] > 0)
        truncated = (np.asarray(self._state.done) > 0) & ~over
        return np.asarray(self._state.obs, np.float32), np.asarray(self._state.reward), over, truncated, told

    def _keys(self) -> AnyArray:
        return jax.random.split(jax.random.key(int(self.np_random.integers(2**31))), self.num_envs)

    def _told(self) -> dict[str, np.ndarray]:
        assert self._state is not None, "episodes have begun"
        return {name: np.asarray(value) for name, value in self._state.metrics.items()}


def _stepped_or_begun(environment: Environment, states: EnvironmentState, actions: AnyArray, keys: AnyArray):
    """The states one control period later, and the starts of new episodes in place of those that are over."""
    return environment.reset_where(states.done > 0, jax.vmap(environment.step)(states, actions), keys)


def _moved(environment: Environment, places: list[np.ndarray]) -> Trajectory:
    """The motion through these places, (nodes, 3), m, one a control period, of which nothing else is known."""
    q = np.stack(places)
    times = environment.plant.period * np.arange(len(q))
    none = jnp.zeros((), int)
    return Trajectory(times, q, np.zeros_like(q), none, none, none, method="", dt=None)


def _named(task: str, scene: Scene | str, settings: dict[str, Any]) -> Environment:
    """The environment of a task, with a scene or the name of one."""
    return environment(task, load_scene(scene) if isinstance(scene, str) else scene, **settings)


def _one(task: str, scene: Scene | str = "exact", render_mode: str | None = None, **settings: Any):
    return GymnasiumEnvironment(_named(task, scene, settings), render_mode)


def _many(task: str, num_envs: int = 64, scene: Scene | str = "exact", **settings: Any):
    return GymnasiumVectorEnvironment(_named(task, scene, settings), num_envs)


for _name in TASKS:
    gymnasium.register(
        f"jaxgrity/{_name.title()}-v0",
        entry_point=partial(_one, _name),
        vector_entry_point=partial(_many, _name),
    )

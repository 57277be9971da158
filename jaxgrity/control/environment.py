"""Environments for reinforcement learning: pure `reset` and `step`, to be mapped, jitted and differentiated.

They have the shape of those of Brax: a state goes in and a state comes out, with observation, reward and done in it.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxgrity.control.motors import Motors
from jaxgrity.control.plant import PERFECT, Plant, PlantState, actuate, observe, plant_of, plant_start
from jaxgrity.control.sensors import Observation, Sensors
from jaxgrity.control.tasks import Task, drawn_aim, find_task, ground_of, task_start, wanted_direction
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.dynamics import centre_of_mass
from jaxgrity.stepping.integrate import state_failure
from jaxgrity.stepping.options import Options

METRE_A_SECOND = Motors(rate=1.0)
"""motors as fast as gaits of the library ask for"""


class EnvironmentState(eqx.Module):
    """One robot in one episode."""

    plant: PlantState
    obs: AnyArray
    """(observation_size,), what the policy sees: see `Environment.sensed`"""
    reward: AnyArray
    """v·d, m/s, less what effort costs"""
    done: AnyArray
    """1 where the episode is over: the goal reached, the time up, or the rollout failed; else 0"""
    aim: AnyArray
    """(2,), the heading or the goal's place, m"""
    metrics: dict[str, AnyArray]
    """"progress", m/s; "effort", 1/s^2; "reached" and "failed", 1 or 0"""


@dataclass(frozen=True, eq=False)
class Environment:
    """A robot with a task. Made by `environment`; its robot's numbers are constants of what is compiled of it."""

    plant: Plant
    task: Task
    contraction: float
    """by which fraction of its length an action of 1 shortens a member; one of -1 does not"""
    effort_cost: float
    """by which the mean square rate of the contractions, 1/s^2, counts against the reward, m/s"""
    episode: int
    """control periods, after which an episode is over"""

    @property
    def action_size(self) -> int:
        """How many members are actuated."""
        return len(self.plant.members)

    @property
    def observation_size(self) -> int:
        """How many numbers a policy sees."""
        return jax.eval_shape(self.reset, jax.random.key(0)).obs.shape[0]

    def reset(self, key: Any) -> EnvironmentState:
        """The start of an episode, drawn by `key`, such as `jax.random.key(0)`; `InputError` where it is no key."""
        if not (jnp.issubdtype(getattr(key, "dtype", int), jax.dtypes.prng_key) or jnp.shape(key) == (2,)):
            raise InputError(f"key = {key!r}: expected a key, such as jax.random.key(0)")
        starts, aims, noise = jax.random.split(key, 3)
        state = plant_start(self.plant, noise, task_start(self.task, self.plant.scene, starts))
        place = centre_of_mass(self.plant.scene, state.motion[0])
        aim = drawn_aim(self.task, place, aims)
        seen, state = observe(self.plant, state)
        obs = self.sensed(state, seen, aim, jnp.zeros_like(place))
        zero = jnp.zeros_like(place[0])
        metrics: dict[str, AnyArray] = dict.fromkeys(("progress", "effort", "reached", "failed"), zero)
        return EnvironmentState(state, obs, zero, zero, aim, metrics)

    def step(self, state: EnvironmentState, action: AnyArray) -> EnvironmentState:
        """One control period later; of an `action` (action_size,), what is beyond -1 and 1 does not count.

        A rollout that fails is done, with observation and reward of zero: numbers are always finite. Raises
        `InputError` for an action of another shape.
        """
        if jnp.shape(action) != (self.action_size,):
            raise InputError(f"action has shape {jnp.shape(action)}; expected ({self.action_size},), one a member")
        dtype = self.plant.options.dtype
        wanted = self.contraction * (1 + jnp.clip(jnp.asarray(action, dtype), -1, 1)) / 2
        after = actuate(self.plant, state.plant, wanted)
        before, place = (centre_of_mass(self.plant.scene, s.motion[0]) for s in (state.plant, after))
        velocity = (place - before) / self.plant.period
        towards = wanted_direction(self.task, state.aim, before, velocity)
        progress = jnp.dot(velocity[:2], towards)
        effort = jnp.mean(((after.contraction - state.plant.contraction) / self.plant.period) ** 2)
        seen, after = observe(self.plant, after)
        failed = state_failure(self.plant.scene, *after.motion) != 0
        near = jnp.sum((state.aim - place[:2]) ** 2) < self.task.reached**2
        reached = (self.task.towards == "goal") & near
        done = failed | reached | (after.tick >= self.episode)
        told = lambda x: jnp.where(failed, 0, x).astype(dtype)  # noqa: E731
        obs, reward = told(self.sensed(after, seen, state.aim, velocity)), told(progress - self.effort_cost * effort)
        metrics: dict[str, AnyArray] = {
            "progress": told(progress),
            "effort": told(effort),
            "reached": reached,
            "failed": failed,
        }
        metrics = {name: jnp.asarray(value, dtype) for name, value in metrics.items()}
        return EnvironmentState(after, obs, reward, done.astype(dtype), state.aim, metrics)

    def sensed(self, state: PlantState, seen: Observation, aim: AnyArray, velocity: AnyArray) -> AnyArray:
        """All sensors' readings in the order of `Observation`, but for the place, then d, (2,), as the place that was
        read says, and the contractions."""
        towards = wanted_direction(self.task, aim, seen.place, velocity)
        known = [*seen._replace(place=towards), state.contraction]
        return jnp.concatenate([jnp.ravel(part) for part in known])


def environment(
    task: str,
    scene: Scene,
    *,
    sensors: Sensors = PERFECT,
    motors: Motors = METRE_A_SECOND,
    options: Options = None,
    seconds: float = 10.0,
    effort_cost: float = 0.02,
) -> Environment:
    """An environment of one robot, commanded 100 times a second.

    Args:
        task: one of `TASKS`: speed, heading, goal, slope, bumps or recover.
        scene: the robot, its ground and friction; its gait does not count, but for the members that it actuates.
        sensors: how they err; where not given, they do not.
        motors: what they can do; where not given, 1 m/s.
        options: how to integrate; where not given, the scene decides.
        seconds: of an episode.
        effort_cost: m s: times the mean square rate of the contractions, what effort costs.

    Returns:
        The environment, whose `reset` and `step` are pure.

    Raises:
        InputError: an unknown task, a scene without a ground or without a gait, bad options (see `resolve`).

    Example:
        >>> import jax
        >>> env = jaxgrity.environment("heading", jaxgrity.load_scene("exact"))
        >>> state = jax.jit(env.reset)(jax.random.key(0))
        >>> env.action_size, state.obs.shape
        (6, (104,))
    """
    asked = find_task(task)
    if scene.gait is None:
        raise InputError("the scene has no gait; expected one, whose members are those that actions move")
    plant = plant_of(
        ground_of(asked, scene, seed=0), scene.gait.members, sensors=sensors, motors=motors, options=options
    )
    return Environment(plant, asked, 0.4, effort_cost, round(seconds / plant.period))

"""Environments for reinforcement learning: pure `reset` and `step`, for `vmap`, `jit` and `grad`.

The interface is that of Brax: a state goes in and a state comes out, with observation, reward and done in it.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.motor_limits import MotorLimits
from jaxgrity.control.plant import (
    PERFECT,
    Plant,
    PlantState,
    actuate,
    observe,
    plant_of,
    plant_start,
    whole_number,
)
from jaxgrity.control.sensors import Observation, Sensors, moving
from jaxgrity.control.tasks import Task, drawn_aim, find_task, ground_of, task_start
from jaxgrity.core.arguments import check_key, check_number
from jaxgrity.core.elementwise import rows_where
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.stepping.discretisation import state_failure
from jaxgrity.stepping.dynamics import centre_of_mass
from jaxgrity.stepping.options import Options
from jaxgrity.stepping.starts import check_start

METRE_A_SECOND = MotorLimits(rate=1.0, stroke=0.5)
"""Default limits of an environment's motors, m/s and share of a length: the library's gaits fit in, but for "fast" and
"uphill"."""


ENDS = "", "reached", "failed", "late"
"""The ways in which an episode ends: at the goal, with a rollout that fails, or as its time is over. The first: it goes
on."""


class Situation(NamedTuple):
    """The carry from one step to the next: wrappers that begin episodes anew restore it."""

    plant: PlantState
    aim: AnyArray
    """(2,), the heading or the goal's place, m"""
    average: AnyArray
    """(2,), m/s, the averaged velocity of the task's progress"""
    ended: AnyArray
    """index into `ENDS`, the end of the episode; 0: none yet"""


class EnvironmentState(eqx.Module):
    """One robot in one episode, with the fields of Brax's `State`."""

    pipeline_state: Situation
    obs: AnyArray
    """(observation_size,), the policy's input: see `sensed`"""
    reward: AnyArray
    """the task's progress, m/s, less the cost of effort"""
    done: AnyArray
    """1 from where the episode is over: the goal reached, the time up, or the rollout failed; else 0"""
    metrics: dict[str, AnyArray]
    """"progress", m/s; "effort", 1/s^2; "reached" and "failed", 1 from where that happened, else 0"""
    info: dict[str, Any]
    """"truncation", 1 if only the time ended the episode; and entries of wrappers. A wrapper that counts "steps" here,
    as Brax's does, ends the episode in the environment's place"""

    def replace(self, **changes: Any) -> "EnvironmentState":
        """The state with other values of some fields."""
        return replace(self, **changes)


@dataclass(frozen=True, eq=False)
class Environment:
    """A robot with a task. Made by `environment`; the robot's numbers are constants of the compiled program."""

    plant: Plant
    task: Task
    effort_cost: float
    """factor of the mean square rate of the contractions, 1/s^2, in the reward, m/s"""
    episode: int
    """control periods, after which an episode is over where no wrapper counts them"""
    scene: Scene
    """the robot on the task's ground as given, before it is rounded to the precision of the plant"""

    @property
    def action_size(self) -> int:
        """The number of actuated members."""
        return len(self.plant.members)

    @property
    def observation_size(self) -> int:
        """The number of observed values."""
        return jax.eval_shape(self.reset, jax.random.key(0)).obs.shape[0]

    def reset(self, key: Any) -> EnvironmentState:
        """The start of an episode, drawn by `key`, such as `jax.random.key(0)`. Raises `InputError` without a key."""
        check_key(key)
        starts, aims, noise = jax.random.split(key, 3)
        state = plant_start(self.plant, noise, task_start(self.task, self.plant.scene, starts))
        place = centre_of_mass(self.plant.scene, state.motion[0])
        aim = drawn_aim(self.task, place, aims)
        seen, state = observe(self.plant, state)
        zero = jnp.zeros(())
        metrics: dict[str, AnyArray] = dict.fromkeys(("progress", "effort", "reached", "failed"), zero)
        situation = Situation(state, aim, jnp.zeros_like(place[:2]), jnp.zeros((), jnp.int32))
        info = {"truncation": zero}
        obs = sensed(seen, self.task.wanted_direction(aim, seen.place))
        return EnvironmentState(situation, obs, zero, zero, metrics, info)

    def step(self, state: EnvironmentState, action: AnyArray) -> EnvironmentState:
        """The state one control period later. In `action` (action_size,) -1 is a member's built length, 1 its
        contraction by the motors' `stroke`; values beyond are cut.

        A failed rollout is done, with observation and reward of zero: its numbers are finite, its derivatives are not.
        An action of NaN fails at once. A finished episode stays as it is, with rewards of zero. Raises `InputError` for
        an action of another shape, and for a known one that is not a number.
        """
        if np.shape(action) != (self.action_size,):
            raise InputError(f"action has shape {np.shape(action)}; expected ({self.action_size},), one a member")
        if not traced(action) and np.isnan(action).any():
            raise InputError(f"action = {np.asarray(action).tolist()}: expected numbers from -1 to 1, one a member")
        old, aim, remembered, ended = state.pipeline_state
        after = actuate(self.plant, old, self.commanded(jnp.asarray(action, self.plant.options.dtype)))
        before, place = (centre_of_mass(self.plant.scene, s.motion[0]) for s in (old, after))
        progress, average = self.task.progressed(aim, before, place, self.plant.period, remembered)
        effort = self._effort(after.contraction - old.contraction)
        seen, after = observe(self.plant, after)
        obs = sensed(seen, self.task.wanted_direction(aim, seen.place))
        reward = progress - self.effort_cost * effort
        finite = jnp.isfinite(reward) & jnp.all(jnp.isfinite(obs))
        failed = (state_failure(self.plant.scene, *after.motion) != 0) | ~finite
        reached = (self.task.towards == "goal") & (jnp.sum((aim - place[:2]) ** 2) < self.task.reached**2)
        # a wrapper that counts steps tells its own truncation from ours only where we leave the time to it
        late = (after.tick >= self.episode) & ("steps" not in state.info)
        over = (state.done > 0) | (ended > 0)
        codes = [ENDS.index(name) for name in ("failed", "reached", "late")]
        now = jnp.select([failed, reached, late], codes, 0).astype(ended.dtype)
        # a task of one's own may compute in another precision
        kept = Situation(after, aim, jnp.asarray(average, remembered.dtype), now)
        new = kept, jnp.where(failed, 0, obs)
        situation, obs = jax.tree.map(partial(jnp.where, over), (state.pipeline_state, state.obs), new)
        counts = lambda x: jnp.where(failed | over, 0, x).astype(float)  # noqa: E731
        which = {name: (situation.ended == code).astype(float) for code, name in enumerate(ENDS)}
        told = {"progress": counts(progress), "effort": counts(effort)}
        return EnvironmentState(
            pipeline_state=situation,
            obs=obs,
            reward=counts(reward),
            done=(over | (now > 0)).astype(float),
            metrics=state.metrics | told | {name: which[name] for name in ("reached", "failed")},
            info=state.info | {"truncation": which["late"]},
        )

    def _effort(self, change: AnyArray) -> AnyArray:
        """The mean square rate of the contractions, 1/s^2, by their change in a control period; 0 of stuck members."""
        works = moving(self.plant.scene.structure, self.plant.members)
        if not works.all():
            change = jnp.where(works, change, 0)
        return jnp.mean((change / self.plant.period) ** 2)

    def commanded(self, action: AnyArray) -> AnyArray:
        """The contraction of each member that an action commands, (action_size,)."""
        return self.plant.motors.stroke * (1 + jnp.clip(action, -1, 1)) / 2

    def reset_where(self, over: AnyArray, states: EnvironmentState, keys: Any) -> EnvironmentState:
        """The states of many episodes, with the start of a new one, drawn by its key, in place of each that is `over`.

        `over`, such as `states.done > 0`, and `keys` have the shape (episodes,). States are of `reset` and `step`, with
        episodes in front. Raises `InputError` where shapes differ.
        """
        over, episodes = jnp.asarray(over), np.shape(states.done)
        if over.shape != episodes or np.shape(keys)[:1] != episodes or len(episodes) != 1:
            found = f"over, keys: shapes {over.shape} and {np.shape(keys)}"
            raise InputError(f"{found}; expected one of each for the {episodes} states, of many episodes")
        fresh = jax.lax.cond(over.any(), jax.vmap(self.reset), lambda _: states, keys)
        return rows_where(over, fresh, states)


def sensed(seen: Observation, direction: AnyArray) -> AnyArray:
    """The observation of an environment: all readings in their order, with the wanted direction d, (2,), for the
    place."""
    told = seen._replace(place=jnp.asarray(direction, seen.place.dtype))
    return jnp.concatenate([jnp.ravel(part) for part in told])


@typed
def environment(
    task: str | Task,
    scene: Scene,
    *,
    sensors: Sensors = PERFECT,
    motors: MotorLimits = METRE_A_SECOND,
    options: Options = None,
    seconds: float = 10.0,
    effort_cost: float = 0.02,
) -> Environment:
    """An environment of one robot, commanded 100 times a second.

    Args:
        task: one of `TASKS`: speed, heading, goal, slope, bumps or recover, scaled to the robot; or a `Task` as it is.
        scene: the robot, its ground and friction; of its gait only the actuated members count.
        sensors: their errors; by default none.
        motors: their limits; by default 1 m/s, and contraction by half.
        options: solver options; by default the scene's.
        seconds: s, the length of an episode, a multiple of 0.01.
        effort_cost: m s, the cost of effort over the mean square rate of the contractions; a stuck member has none.

    Returns:
        The environment, whose `reset` and `step` are pure.

    Raises:
        InputError: an unknown task, or a scene without ground or gait. Uneven ground for a task with its own ground.
            Bad options (see `resolve`). Seconds that are no multiple of 0.01. An effort cost that is negative or not
            finite.

    Example:
        >>> import jax
        >>> env = jaxgrity.control.environment("heading", jaxgrity.load_scene("exact"))
        >>> state = jax.jit(env.reset)(jax.random.key(0))
        >>> env.action_size, state.obs.shape
        (6, (104,))
    """
    asked = find_task(task, scene)
    if scene.gait is None:
        raise InputError("the scene has no gait; expected one, whose members are those that actions move")
    effort_cost = check_number("effort_cost", effort_cost, least=0.0, unit="m s")
    placed = ground_of(asked, scene, seed=0)
    check_start(with_gait(placed, None))
    plant = plant_of(placed, scene.gait.members, sensors=sensors, motors=motors, options=options)
    return Environment(plant, asked, effort_cost, whole_number("seconds", seconds, plant.period), placed)

"""Policies that were learned: a small network from what an environment tells to what motors shall do."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.control.canonical import CanonicalPose
from jaxgrity.control.closed_loop import frame, trajectory_of
from jaxgrity.control.environments import ENDS, Environment, sensed
from jaxgrity.control.policies import Memory, Policy
from jaxgrity.control.sensors import Observation
from jaxgrity.core.arguments import check_count, check_key
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import traced
from jaxgrity.core.typed import check_fields, typed
from jaxgrity.core.types import AnyArray, PerActuator, Scalar, as_float_or_none
from jaxgrity.io.files import found_file, shipped, write_whole
from jaxgrity.stepping.discretisation import state_failure
from jaxgrity.stepping.simulate import Trajectory

LARGEST_SEEN = 5.0
"""Largest observation that a network sees, in standard deviations of training: one bad reading drowns no other."""

Acting = Callable[[AnyArray], AnyArray]
"""From an observation of an environment to an action; a `Learned`, or any function in JAX."""


class Learned(eqx.Module):
    """A policy: action = tanh(network((observation - mean)/deviation)), held for some control periods.

    The observation is that of the robot in its canonical `pose`, if the policy has one. `Deployed` makes it the
    controller of a plant.
    """

    network: eqx.nn.MLP
    mean: AnyArray
    """(observation_size,), of the observations in training"""
    deviation: AnyArray
    """(observation_size,), their standard deviations; 0: never another number"""
    held: int = eqx.field(static=True)
    """number of control periods for which an action is held"""
    pose: CanonicalPose | None = None
    """in which the network sees the robot; None: it sees each observation as it is"""

    def __call__(self, observation: AnyArray) -> AnyArray:
        """The action, (action_size,), each from -1 to 1."""
        seen, which = self.seen(observation)
        return self.placed(jnp.tanh(self.network(standardised(self, seen))), which)

    def seen(self, observation: AnyArray) -> tuple[AnyArray, AnyArray | None]:
        """What the network sees before it is standardised, and by which symmetry: see `CanonicalPose.seen`."""
        return (observation, None) if self.pose is None else self.pose.seen(observation)

    def placed(self, action: AnyArray, which: AnyArray | None) -> AnyArray:
        """The network's action, given to the motors that it is for: see `CanonicalPose.placed`."""
        return action if self.pose is None or which is None else self.pose.placed(action, which)


def standardised(policy: Learned, observation: AnyArray) -> jax.Array:
    """What the network sees of an observation."""
    # what was always 0 in training has no unit
    unit = jnp.where(policy.deviation > 0, policy.deviation, 1)
    seen = jnp.clip((observation - policy.mean) / unit, -LARGEST_SEEN, LARGEST_SEEN)
    return seen.astype(policy.mean.dtype)


def untrained(
    environment: Environment, key: Any, width: int, depth: int, held: int, pose: CanonicalPose | None = None
) -> Learned:
    """A policy that knows nothing yet, in float32; its actions are near 0."""
    size = environment.observation_size
    network = eqx.nn.MLP(size, environment.action_size, width, depth, jax.nn.tanh, dtype=jnp.float32, key=key)
    last = lambda net: net.layers[-1].weight  # noqa: E731
    network = eqx.tree_at(last, network, 0.01 * last(network))
    return Learned(network, jnp.zeros(size, jnp.float32), jnp.ones(size, jnp.float32), held, pose)


@typed
def save_policy(policy: Learned, path: str | Path) -> None:
    """Write a policy: a line of JSON with its sizes, then its arrays. The file appears whole or not at all."""
    network = policy.network
    sizes = {name: getattr(network, name) for name in ("in_size", "out_size", "width_size", "depth")}

    pose = {} if policy.pose is None else {"pose": policy.pose.shape}

    def write(file) -> None:
        file.write((json.dumps(sizes | {"held": policy.held} | pose) + "\n").encode())
        eqx.tree_serialise_leaves(file, policy)

    write_whole(path, write)


def policy_names() -> tuple[str, ...]:
    """The policies that come with the library: a task each, for the scene `exact`."""
    return tuple(shipped("policies"))


@typed
def load_policy(name: str | Path) -> Learned:
    """A policy of the library by its name, or one that `save_policy` wrote.

    Raises `InputError` for a file that is not there, or is none.

    Example:
        >>> env = jaxgrity.control.environment("speed", jaxgrity.load_scene("exact"), seconds=0.1)
        >>> policy = jaxgrity.control.load_policy("speed")
        >>> jaxgrity.control.trials(env, policy, jax.random.key(0), episodes=2).shape
        (2,)
    """
    path = found_file("policy", "policies", name)
    try:
        with open(path, "rb") as file:
            head = json.loads(file.readline())
            held, pose, sizes = head.pop("held"), head.pop("pose", None), head
            network = eqx.nn.MLP(**sizes, activation=jax.nn.tanh, dtype=jnp.float32, key=jax.random.key(0))
            nothing = jnp.zeros(sizes["in_size"], jnp.float32)
            empty = None if pose is None else CanonicalPose.empty(**pose)
            return eqx.tree_deserialise_leaves(file, Learned(network, nothing, nothing, held, empty))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, EOFError, RuntimeError) as error:
        raise InputError(f"{path}: not a policy; expected a file that save_policy wrote") from error


@typed
def episode(environment: Environment, policy: Acting, key: Any) -> Trajectory:
    """One robot's motion through an episode, with a frame for each control period: `trajectory.show()` replays it.

    Args:
        environment: of `environment`.
        policy: a `Learned`, or any function in JAX from an observation to an action.
        key: draws the start, the aim and the sensors' noise.

    Returns:
        The motion until the episode ends, with the contractions that the motors reached.

    Raises:
        InputError: no key, or a policy whose actions do not fit the environment.

    Example:
        >>> env = jaxgrity.control.environment("speed", jaxgrity.load_scene("exact"), seconds=0.1)
        >>> jaxgrity.control.episode(env, lambda seen: seen[:6], jax.random.key(0)).positions.shape
        (11, 12, 3)
    """
    check_acting(environment, policy)
    check_key(key)
    first, (later, ended), failure = _episode(environment, policy, key)
    over = np.flatnonzero(np.asarray(ended))
    count = len(ended) if not len(over) else int(over[0]) + 1
    return trajectory_of(environment.plant, first, jax.tree.map(lambda x: x[:count], later), failure)


@typed
def trials(environment: Environment, policy: Acting, key: Any, episodes: int = 64) -> Float[np.ndarray, " episodes"]:
    """Mean progress, m/s, of a policy in each of some new episodes, from their starts to their ends.

    Raises `InputError` as `episode` does, or for no episodes.
    """
    check_acting(environment, policy)
    check_key(key)
    keys = jax.random.split(key, check_count("episodes", episodes, 1))
    return np.asarray(_trials(environment, policy, keys))


class Deployed(Policy):
    """A learned policy as the controller of a plant, for `simulate_policy`, `roll_on` and `drive`.

    The policy gets what an environment observes, with the direction that you want. Each action is held for as long as
    in learning, to the nearest control period of the plant, and commands contractions up to the `stroke` of the
    environment's motors.

    Raises `InputError` for a policy that does not fit the environment. A task with a direction needs `heading` or
    `goal`, and another task refuses both. The rollout refuses a plant whose sensors tell other numbers, before anything
    compiles.

    Example:
        >>> env = jaxgrity.control.environment("heading", jaxgrity.load_scene("exact"))
        >>> policy = jaxgrity.control.Deployed(env, jaxgrity.control.load_policy("heading"), goal=[3.0, 1.0])
        >>> jaxgrity.control.simulate_policy(env.plant, policy, 0.1).positions.shape
        (11, 12, 3)
    """

    environment: Environment = eqx.field(static=True)
    """of the task that was learned; the plant may have other ground, contact, sensors, motors and control periods"""
    policy: Acting
    """a `Learned`, or any function in JAX from an observation to an action"""
    heading: AnyArray | None = eqx.field(converter=as_float_or_none, default=None)
    """(2,), the wanted direction, of any length"""
    goal: AnyArray | None = eqx.field(converter=as_float_or_none, default=None)
    """(2,), m, the place that is wanted, in place of a heading"""

    def __check_init__(self):
        check_fields(self)
        check_acting(self.environment, self.policy)
        given = {name: x for name in ("heading", "goal") if (x := getattr(self, name)) is not None}
        for name, x in given.items():
            if np.shape(x)[:1] != (2,):
                raise InputError(f"{name} has the shape {np.shape(x)}: expected (2,), x and y")
            if not traced(x) and not (np.isfinite(x).all() and (name == "goal" or np.any(x, axis=0).all())):
                raise InputError(f"{name} = {np.asarray(x).tolist()}: expected finite numbers, for a heading not all 0")
        wants = self.environment.task.towards != "anywhere"
        if len(given) != wants:
            expected = "one of heading and goal" if wants else "neither"
            found = " and ".join(given) or "neither heading nor goal"
            words = f"the environment's task wants {'a' if wants else 'no'} direction"
            raise InputError(f"Deployed: {found} given; expected {expected}, since {words}")

    @property
    def members(self) -> tuple[int, ...]:
        return self.environment.plant.members

    def first(self) -> Memory:
        """The last action, the number of actions so far, and the time, s."""
        return jnp.zeros(len(self.members)), jnp.zeros((), jnp.int32), jnp.zeros(())

    def __call__(self, observation: Observation, t: Scalar, memory: Memory) -> tuple[PerActuator, Memory]:
        action, count, begins = memory
        seen = sensed(observation, self._direction(observation.place))
        if len(seen) != self.environment.observation_size:
            expected = f"{self.environment.observation_size}, as in the policy's environment"
            raise InputError(f"plant: its sensors tell {len(seen)} numbers; expected {expected}")
        wanted = count * getattr(self.policy, "held", 1) * self.environment.plant.period
        due = begins >= wanted - (t - begins) / 2
        action = jnp.where(due, self.policy(seen).astype(action.dtype), action)
        return self.environment.commanded(action), (action, count + due, t)

    def _direction(self, place: AnyArray) -> AnyArray:
        """d, (2,), as in an environment whose episode has drawn this heading or goal."""
        task = self.environment.task
        if self.goal is not None:
            return task._replace(towards="goal").wanted_direction(self.goal, place)
        if self.heading is not None:
            heading = self.heading / jnp.linalg.norm(self.heading)
            return task._replace(towards="heading").wanted_direction(heading, place)
        return task.wanted_direction(jnp.zeros_like(place[:2]), place)


def check_acting(environment: Environment, policy: Acting) -> None:
    """Raise `InputError` for a policy that takes no such observations, whose actions are of another number, or that is
    of another robot or kind of task (`CanonicalPose.misfit`)."""
    if not callable(policy):
        raise InputError(f"policy = {policy!r}: expected a function of observations, as load_policy makes one")
    if (pose := getattr(policy, "pose", None)) is not None and (misfit := pose.misfit(environment)) is not None:
        raise InputError(f"policy: {misfit}; expected one that learned in such an environment")
    sees, size = getattr(getattr(policy, "network", None), "in_size", None), environment.observation_size
    if sees not in (None, size):
        raise InputError(f"policy: takes observations of {sees} numbers; expected {size}, those of the environment")
    found = jax.eval_shape(policy, jnp.zeros(size, environment.plant.options.dtype))
    if getattr(found, "shape", None) != (environment.action_size,):
        raise InputError(f"policy: {found}; expected actions of shape ({environment.action_size},)")


def _run(environment: Environment, policy: Acting, state: Any, keep: Callable[[Any], Any]) -> tuple[Any, Any]:
    """An episode from `state` on: its end, and what `keep` takes of each control period."""
    held = getattr(policy, "held", 1)

    def tick(carry, k):
        state, action = carry
        action = jnp.where(k % held == 0, policy(state.obs), action)
        state = environment.step(state, action)
        return (state, action), keep(state)

    nothing = jnp.zeros(environment.action_size, jax.eval_shape(policy, state.obs).dtype)
    (end, _), kept = jax.lax.scan(tick, (state, nothing), jnp.arange(environment.episode))
    return end, kept


@eqx.filter_jit
def _episode(environment: Environment, policy: Acting, key: Any):
    plant, state = environment.plant, environment.reset(key)
    keep = lambda state: (frame(plant, state.pipeline_state.plant), state.done)  # noqa: E731
    end, kept = _run(environment, policy, state, keep)
    # where the motion is fine, what was observed or rewarded is not finite
    code = jnp.maximum(state_failure(plant.scene, *end.pipeline_state.plant.motion), 1)
    failed = end.pipeline_state.ended == ENDS.index("failed")
    return frame(plant, state.pipeline_state.plant), kept, jnp.where(failed, code, 0)


@eqx.filter_jit
def _trials(environment: Environment, policy: Acting, keys: Any) -> AnyArray:
    starts = jax.vmap(environment.reset)(keys)
    counted = lambda state: (state.metrics["progress"], state.done == 0)  # noqa: E731
    _, (progress, goes_on) = jax.vmap(partial(_run, environment, policy, keep=counted))(starts)
    return progress.sum(1) / jnp.minimum(goes_on.sum(1) + 1, environment.episode)

"""Reinforcement learning of policies: robots try on every device, and each update is one compiled call (`ppo.py`)."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxgrity.control.canonical import canonical_pose
from jaxgrity.control.environments import Environment
from jaxgrity.control.learned import standardised, untrained
from jaxgrity.control.ppo import (
    AXIS,
    Learner,
    LearningConfig,
    Tried,
    advantages,
    improved,
    likelihood,
    optimiser,
    with_observations,
)
from jaxgrity.core.arguments import check_count, check_key
from jaxgrity.core.elementwise import rows_where
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray

AS_MEASURED = LearningConfig()
"""The way of learning with which the numbers of the docs were measured."""


@typed
def learner(environment: Environment, key: Any, config: LearningConfig = AS_MEASURED) -> Learner:
    """The start of learning. Raises `InputError` for what is no key, and for robots that devices cannot share."""
    check_key(key)
    if config.robots % jax.device_count():
        raise InputError(f"robots = {config.robots}: expected a multiple of the {jax.device_count()} devices")
    tries = config.robots // jax.device_count() * config.decisions
    if config.batches > tries:
        raise InputError(f"batches = {config.batches}: expected at most {tries}, an update's decisions on a device")
    if jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        key = jax.random.key_data(key)  # which files take
    of_policy, of_critic, of_states, of_ages, key = jax.random.split(key, 5)
    pose = canonical_pose(environment) if config.symmetric else None
    policy = untrained(environment, of_policy, config.width, config.depth, config.held, pose)
    size = environment.observation_size
    critic = eqx.nn.MLP(size, "scalar", config.width, config.depth, jax.nn.tanh, dtype=jnp.float32, key=of_critic)
    spread = jnp.full(environment.action_size, np.log(0.6), jnp.float32)
    states = jax.jit(lambda keys: _begun(environment, keys))(jax.random.split(of_states, config.robots))
    # episodes that all begin and end together would make updates of all starts, and of none
    ages = jax.random.randint(of_ages, (config.robots,), 0, _longest(environment, config))
    moments = optimiser().init(eqx.filter((policy.network, spread, critic), eqx.is_array))
    rate, seen = jnp.asarray(1e-3, jnp.float32), jnp.zeros((), jnp.float32)
    return Learner(policy, spread, critic, moments, rate, seen, states, ages, key)


@typed
def learn(
    environment: Environment,
    start: Learner,
    updates: int,
    config: LearningConfig = AS_MEASURED,
    hear: Callable[[int, dict[str, float]], None] = lambda done, facts: None,
) -> Learner:
    """Learn for some updates, each of `decisions` x `held` control periods of all robots.

    Args:
        environment: of `environment`, best in float32.
        start: from `learner`, or from an earlier call.
        updates: their number.
        config: that of the start.
        hear: called with the number of updates and facts: "progress", m/s, the mean over all robots and decisions.

    Returns:
        The new state of learning; its `policy` is the learned one.

    Example:
        >>> env = jaxgrity.control.environment("speed", jaxgrity.load_scene("exact"), seconds=0.4)
        >>> config = jaxgrity.control.LearningConfig(robots=8, decisions=2, batches=1)
        >>> first = jaxgrity.control.learner(env, jax.random.key(0), config)
        >>> jaxgrity.control.learn(env, first, 1, config).policy(first.states.obs[0]).shape
        (6,)
    """
    start = _placed(start)
    for done in range(check_count("updates", updates, 0)):
        start, facts = _update(environment, config, start)
        hear(done + 1, {name: float(value) for name, value in facts.items()})
    return start


def _begun(environment: Environment, keys: Any) -> Any:
    """New episodes; their time is kept here, as in wrappers of environments (`EnvironmentState.info`)."""
    states = jax.vmap(environment.reset)(keys)
    return states.replace(info=states.info | {"steps": jnp.zeros(len(keys))})


def _longest(environment: Environment, config: LearningConfig) -> int:
    """The number of decisions of an episode."""
    return max(1, environment.episode // config.held)


@eqx.filter_jit
def _update(environment: Environment, config: LearningConfig, now: Learner) -> tuple[Learner, dict]:
    """One update: try, judge, learn; every device has its own robots, and the gradients are averaged."""

    def update(now: Learner) -> tuple[Learner, dict]:
        key, of_all = jax.random.split(now.key)
        of_tries, of_epochs = jax.random.split(jax.random.fold_in(of_all, jax.lax.axis_index(AXIS)))
        states, ages, tried = _tries(environment, config, now, of_tries)
        gains, values = advantages(config, now, tried)
        after, facts = improved(config, now, (tried, gains, values), of_epochs)
        facts["progress"] = jax.lax.pmean(tried.reward.mean(), AXIS)
        return with_observations(after, tried.seen)._replace(states=states, ages=ages, key=key), facts

    arrays, rest = eqx.partition(now, eqx.is_array)
    run = lambda arrays: _arrays_of(update(eqx.combine(arrays, rest)))  # noqa: E731
    mesh, parts = _dealt()
    shared = jax.shard_map(run, mesh=mesh, in_specs=(parts,), out_specs=(parts, PartitionSpec()), check_vma=False)
    after, facts = shared(arrays)
    return eqx.combine(after, rest), facts


def _dealt() -> tuple[Mesh, Any]:
    """The devices, and the sharding of each part of a learner."""
    parts: Any = dict.fromkeys(Learner._fields, PartitionSpec()) | dict.fromkeys(
        ("states", "ages"), PartitionSpec(AXIS)
    )
    return Mesh(np.array(jax.devices()), (AXIS,)), Learner(**parts)


def _placed(now: Learner) -> Learner:
    """The learner on the updates' devices, so that the first update compiles no program of its own."""
    mesh, parts = _dealt()
    arrays, rest = eqx.partition(now, eqx.is_array)
    there: Any = (jax.device_put(x, NamedSharding(mesh, part)) for x, part in zip(arrays, parts, strict=True))
    return eqx.combine(Learner(*there), rest)


def _arrays_of(result: tuple[Learner, dict]) -> tuple[Learner, dict]:
    return eqx.filter(result[0], eqx.is_array), result[1]


def _tries(environment: Environment, config: LearningConfig, now: Learner, key: Any) -> tuple[Any, AnyArray, Tried]:
    """Decisions of all robots; finished episodes begin anew."""
    of_starts, of_decisions = jax.random.split(key)
    fresh = _begun(environment, jax.random.split(of_starts, len(now.ages)))

    def decide(carry, key):
        states, ages = carry
        seen, which = jax.vmap(now.policy.seen)(states.obs)
        middle = jax.vmap(lambda seen: now.policy.network(standardised(now.policy, seen)))(seen)
        action = middle + jnp.exp(now.spread) * jax.random.normal(key, middle.shape, middle.dtype)
        commanded = jax.vmap(now.policy.placed)(jnp.tanh(action), which)
        hold = lambda states, _: (lambda s: (s, s.reward))(jax.vmap(environment.step)(states, commanded))  # noqa: E731
        after, rewards = jax.lax.scan(hold, states, length=config.held)
        ended = after.done > 0
        over = ended | (ages + 1 >= _longest(environment, config))
        likely = likelihood(middle, now.spread, action)
        later, _ = jax.vmap(now.policy.seen)(after.obs)
        told = Tried(seen, action, likely, rewards.mean(0).astype(jnp.float32), later, ended, over)
        return (rows_where(over, fresh, after), jnp.where(over, 0, ages + 1)), told

    (states, ages), tried = jax.lax.scan(
        decide, (now.states, now.ages), jax.random.split(of_decisions, config.decisions)
    )
    return states, ages, tried

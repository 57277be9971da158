"""Proximal policy optimisation (PPO): updates of policy and critic from the robots' decisions.

Schulman et al. 2017, arXiv:1707.06347, with generalised advantages (arXiv:1506.02438), and a learning rate adapted to
the policy's change in an update (Rudin et al. 2021, arXiv:2109.11978).
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxgrity.control.learned import Learned, standardised
from jaxgrity.core.arguments import check_count, check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray

AXIS = "robots"
"""Name of the devices' axis, over which robots are dealt and gradients averaged."""
RATES = 1e-4, 3e-3
"""Range in which the learning rate follows the policy's change."""
ALIKE = 1e-4
"""Smallest standard deviation of an observation that counts, as a share of its mean."""
LARGEST_GRADIENT = 1.0
"""Norm to which gradients are cut, in the loss's own unit."""


@dataclass(frozen=True)
class LearningConfig:
    """Settings of learning. Times are in decisions; each holds for `held` control periods."""

    robots: int = 512
    """side by side, a multiple of the number of devices"""
    held: int = 4
    """control periods from one decision to the next"""
    decisions: int = 32
    """of each robot, between two updates"""
    epochs: int = 4
    """passes of an update over them"""
    batches: int = 4
    """into which they are dealt, anew in each epoch"""
    discount: float = 0.97
    """of the reward one decision later"""
    trace: float = 0.95
    """lambda of generalised advantages"""
    clip: float = 0.2
    """largest counted difference of the ratio of probabilities from 1"""
    entropy: float = 1e-3
    """weight of the policy's entropy, against growing sure too early"""
    divergence: float = 0.015
    """Kullback-Leibler divergence that the learning rate aims at, of the policies before and after an update"""
    width: int = 64
    """of hidden layers"""
    depth: int = 2
    """number of hidden layers"""
    symmetric: bool = True
    """whether policies use the robot's symmetries: see `canonical.py`"""

    def __post_init__(self):
        for name in ("robots", "held", "decisions", "epochs", "batches", "width"):
            check_count(name, getattr(self, name), 1)
        check_count("depth", self.depth, 0)
        for name in ("discount", "trace", "entropy"):
            check_number(name, getattr(self, name), least=0.0, most=1.0)
        if not isinstance(self.symmetric, bool | np.bool_):
            raise InputError(f"symmetric = {self.symmetric!r}: expected True or False")
        for name in ("clip", "divergence"):
            check_number(name, getattr(self, name), above=0.0)


class Learner(NamedTuple):
    """The state of learning: saved and loaded with `equinox.tree_serialise_leaves`."""

    policy: Learned
    spread: AnyArray
    """(action_size,), logarithm of the standard deviation with which actions are tried, before their tanh"""
    critic: eqx.nn.MLP
    """the value of an observation: the discounted mean of the rewards to come, m/s"""
    moments: optax.OptState
    rate: AnyArray
    """learning rate"""
    seen: AnyArray
    """number of observations in `Learned.mean`"""
    states: Any
    """of the environments, with robots in front"""
    ages: AnyArray
    """(robots,), decisions since each episode began"""
    key: Any


class Tried(NamedTuple):
    """One decision of all robots, with observations and actions in the policy's canonical pose."""

    seen: AnyArray
    action: AnyArray
    """before its tanh"""
    likely: AnyArray
    """logarithm of its probability density"""
    reward: AnyArray
    """m/s, the mean while it was held"""
    later: AnyArray
    """the observation at its end, before an episode begins anew"""
    ended: AnyArray
    """the episode ended at the goal or in a failure"""
    over: AnyArray
    """or for its time"""


def optimiser() -> optax.GradientTransformation:
    """Adam on clipped gradients, without its learning rate."""
    return optax.chain(optax.clip_by_global_norm(LARGEST_GRADIENT), optax.scale_by_adam())


def likelihood(middle: AnyArray, spread: AnyArray, action: AnyArray) -> AnyArray:
    """Logarithm of the normal density of an action before its tanh, without the constant."""
    return -jnp.sum(((action - middle) / jnp.exp(spread)) ** 2 / 2 + spread, axis=-1)


def advantages(config: LearningConfig, now: Learner, tried: Tried) -> tuple[AnyArray, AnyArray]:
    """The advantage of each decision, and the critic's targets: (decisions, robots), m/s."""
    value = jax.vmap(jax.vmap(lambda seen: now.critic(standardised(now.policy, seen))))
    here, later = value(tried.seen), value(tried.later)
    better = (1 - config.discount) * tried.reward + config.discount * jnp.where(tried.ended, 0, later) - here

    def back(gain, at):
        better, over = at
        gain = better + config.discount * config.trace * jnp.where(over, 0, gain)
        return gain, gain

    _, gains = jax.lax.scan(back, jnp.zeros_like(better[0]), (better, tried.over), reverse=True)
    return gains, gains + here


def improved(config: LearningConfig, now: Learner, known: tuple, key: Any) -> tuple[Learner, dict]:
    """Several passes over the robots' decisions, in batches, with a learning rate adapted to the divergence."""
    rows = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), known)
    count = rows[1].shape[0] // config.batches

    def batch(carry, chosen):
        (network, spread, critic), moments, rate = carry
        mine = jax.tree.map(lambda x: x[chosen], rows)
        parameters = network, spread, critic
        (loss, moved), slope = eqx.filter_value_and_grad(_loss, has_aux=True)(parameters, config, now.policy, mine)
        slope, moved, loss = jax.lax.pmean((slope, moved, loss), AXIS)
        step, moments = optimiser().update(slope, moments)
        parameters = eqx.apply_updates(parameters, jax.tree.map(lambda x: -rate * x, step))
        rate = jnp.where(
            moved > 2 * config.divergence, rate / 1.5, jnp.where(moved < config.divergence / 2, rate * 1.5, rate)
        )
        return (parameters, moments, jnp.clip(rate, *RATES)), (loss, moved)

    orders = jax.vmap(lambda k: jax.random.permutation(k, count * config.batches))(jax.random.split(key, config.epochs))
    arrays, rest = eqx.partition((now.policy.network, now.spread, now.critic), eqx.is_array)

    def whole(carry, chosen):
        arrays, *others = carry
        (parameters, *others), told = batch((eqx.combine(arrays, rest), *others), chosen)
        return (eqx.filter(parameters, eqx.is_array), *others), told

    (arrays, moments, rate), (loss, moved) = jax.lax.scan(
        whole, (arrays, now.moments, now.rate), orders.reshape(-1, count)
    )
    network, spread, critic = eqx.combine(arrays, rest)
    policy = eqx.tree_at(lambda p: p.network, now.policy, network)
    facts = {"loss": loss.mean(), "divergence": moved.mean(), "rate": rate, "tried": jnp.exp(spread).mean()}
    return now._replace(policy=policy, spread=spread, critic=critic, moments=moments, rate=rate), facts


def _loss(parameters: tuple, config: LearningConfig, policy: Learned, known: tuple) -> tuple[AnyArray, AnyArray]:
    """PPO's clipped loss, the critic's loss and the entropy; and the divergence from the earlier policy."""
    (network, spread, critic), (tried, gains, values) = parameters, known
    seen = jax.vmap(lambda x: standardised(policy, x))(tried.seen)
    likely = likelihood(jax.vmap(network)(seen), spread, tried.action)
    ratio = jnp.exp(likely - tried.likely)
    gains = (gains - gains.mean()) / (gains.std() + 1e-8)
    better = jnp.minimum(ratio * gains, jnp.clip(ratio, 1 - config.clip, 1 + config.clip) * gains)
    missed = jnp.mean((jax.vmap(critic)(seen) - values) ** 2) / (jnp.var(values) + 1e-8)
    loss = -better.mean() + missed / 2 - config.entropy * spread.sum()
    # an estimate that is never negative, and of little variance: E(r - 1 - log r)
    return loss, jnp.mean(ratio - 1 - (likely - tried.likely))


def with_observations(now: Learner, seen: AnyArray) -> Learner:
    """Mean and standard deviation of all observations so far (Chan et al. 1983), for the updates to come."""
    seen = seen.reshape(-1, seen.shape[-1]).astype(jnp.float32)
    mean = jax.lax.pmean(seen.mean(0), AXIS)
    variance = jax.lax.pmean(((seen - mean) ** 2).mean(0), AXIS)
    count = jax.lax.psum(jnp.asarray(len(seen), jnp.float32), AXIS)
    share, off = count / (now.seen + count), mean - now.policy.mean
    known = jnp.where(now.seen > 0, now.policy.deviation**2, 0.0)
    spread = jnp.sqrt((1 - share) * known + share * variance + share * (1 - share) * off**2)
    places = lambda p: (p.mean, p.deviation)  # noqa: E731
    mean = now.policy.mean + share * off
    # what stays the same is known to rounding, in any unit
    policy = eqx.tree_at(places, now.policy, (mean, jnp.maximum(spread, ALIKE * jnp.abs(mean))))
    return now._replace(policy=policy, seen=now.seen + count)

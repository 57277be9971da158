"""Learning by gradients through the robot's motion: short-horizon actor-critic (SHAC).

Xu et al. 2022, arXiv:2204.07137: the policy climbs the reward of a short rollout and the critic's value of its end, by
reverse mode through every control period. The critic alone sees the averaged velocity, from which the task `speed`
makes its reward (only its size, where the policy sees the robot in a canonical pose). Three things differ from the
paper. Commands stay within the reach of the motors, the gradient by each decision of each robot is cut to the median
norm, and entropy keeps the policy trying.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.sharding import Mesh, PartitionSpec

from jaxgrity.control import Environment, Learner, LearningConfig, learn
from jaxgrity.control.learned import Learned, standardised
from jaxgrity.control.ppo import AXIS, LARGEST_GRADIENT, Tried, advantages, optimiser, with_observations

RATE = 2e-3
"""Learning rate of policy and critic."""
TINY = 1e-12
"""m/s, so that gradients of which most are zero stay finite."""
ENTROPY = 0.02
"""Weight of the entropy of tried actions, against gradients of at most one for each decision."""
FITS = 16
"""Steps of the critic in an update."""


class Reaching(eqx.Module):
    """A policy for motors with a bounded rate: the command is never out of their reach.

    A motor that moves as fast as it can does not depend on its command: that derivative is zero, in most periods of a
    policy that commands any contraction. Here the change is r tanh(2 (wanted - now)/stroke), with r, the share of its
    length by which a motor moves at most while an action is held. `wanted` is what the network's tanh asks for.
    """

    policy: Learned
    reach: tuple[float, ...] = eqx.field(static=True)
    """r of each actuated member"""
    stroke: float = eqx.field(static=True)

    @property
    def held(self) -> int:
        """Number of control periods for which an action is held."""
        return self.policy.held

    def __call__(self, observation: Any) -> Any:
        """The action, (action_size,)."""
        seen, which = self.policy.seen(observation)
        return self.policy.placed(self.action(seen, self.policy.network(standardised(self.policy, seen))), which)

    def action(self, seen: Any, output: Any) -> Any:
        """That of the network's output, in the policy's pose; what it sees ends with the present contractions."""
        now, half = seen[..., -len(self.reach) :], jnp.asarray(self.stroke / 2, output.dtype)
        change = jnp.asarray(self.reach, output.dtype) * jnp.tanh((half * (1 + jnp.tanh(output)) - now) / half)
        return (now + change) / half - 1


def reaching(env: Environment, policy: Learned) -> Reaching:
    """The policy for the environment's motors, all of them at struts."""
    structure, motors = env.plant.scene.structure, env.plant.motors
    nodes, edges = np.asarray(structure.nodes), np.array(structure.struts.edges)[list(env.plant.members)]
    lengths = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    reach = motors.rate * env.plant.period * policy.held / lengths
    return Reaching(policy, tuple(reach.tolist()), motors.stroke)


def with_short_horizon(env: Environment, now: Learner, config: LearningConfig) -> tuple[Learner, Callable]:
    """A start for SHAC, from that of PPO, and its update: every device has its own robots, as in PPO."""
    size = env.observation_size + 2
    critic = eqx.nn.MLP(size, "scalar", config.width, config.depth, jax.nn.tanh, dtype=jnp.float32, key=now.key)
    ways = (quick_adam(), actor_of(now)), (optimiser(), critic)
    moments = tuple(way.init(eqx.filter(part, eqx.is_array)) for way, part in ways)
    arrays, rest = eqx.partition(now._replace(critic=critic, moments=moments), eqx.is_array)
    parts = Learner(*(PartitionSpec(AXIS) if name in ("states", "ages") else PartitionSpec() for name in now._fields))
    mesh = Mesh(np.array(jax.devices()), (AXIS,))

    @jax.jit
    def update(arrays: Learner) -> tuple[Learner, dict]:
        def own(arrays: Learner) -> tuple[Learner, dict]:
            after, facts = improved(env, config, eqx.combine(arrays, rest))
            return eqx.filter(after, eqx.is_array), facts

        return jax.shard_map(own, mesh=mesh, in_specs=(parts,), out_specs=(parts, PartitionSpec()), check_vma=False)(
            arrays
        )

    def updated(now: Learner) -> tuple[Learner, dict]:
        after, facts = update(eqx.filter(now, eqx.is_array))
        return eqx.combine(after, rest), facts

    return learn(env, eqx.combine(arrays, rest), 0, config), updated  # on the devices, so that all compiles once


def quick_adam() -> optax.GradientTransformation:
    """PPO's optimiser with shorter memories, as SHAC's authors have it."""
    return optax.chain(optax.clip_by_global_norm(LARGEST_GRADIENT), optax.scale_by_adam(0.7, 0.95))


class Actor(NamedTuple):
    """What the short rollouts teach."""

    network: eqx.nn.MLP
    spread: Any


def actor_of(now: Learner) -> Actor:
    return Actor(now.policy.network, now.spread)


def wide(policy: Learned) -> Learned:
    """The policy with the statistics of what the critic sees: the averaged velocity is not scaled."""
    mean, deviation = jnp.pad(policy.mean, (0, 2)), jnp.pad(policy.deviation, (0, 2), constant_values=1.0)
    return eqx.tree_at(lambda p: (p.mean, p.deviation), policy, (mean, deviation))


def of_critic(policy: Learned, seen: jax.Array, states: Any) -> jax.Array:
    """What the critic sees of states: what the policy does, and the averaged velocity."""
    average = states.pipeline_state.average
    if policy.pose is not None:
        speed = jnp.sqrt(jnp.sum(average**2, -1) + TINY)
        average = jnp.stack([speed, jnp.zeros_like(speed)], -1)
    return jnp.concatenate([seen, average], -1)


def improved(env: Environment, config: LearningConfig, now: Learner) -> tuple[Learner, dict]:
    """One update: short rollouts, a step of the policy along their gradient, then steps of the critic."""
    key, of_all = jax.random.split(now.key)
    mine = jax.random.fold_in(of_all, jax.lax.axis_index(AXIS))
    nudges = jnp.zeros((config.decisions, len(now.ages), env.action_size), jnp.float32)
    climb = jax.value_and_grad(rolled, has_aux=True)
    (_, (states, ages, seen, tried)), slope = climb(nudges, env, config, now, mine)
    slope, norms = evened(slope)
    of_actor, of_values = now.moments
    arrays, rest = eqx.partition(actor_of(now), eqx.is_array)

    def along(arrays):
        actor = eqx.combine(arrays, rest)
        middle = jax.vmap(jax.vmap(lambda x: actor.network(standardised(now.policy, x))))(seen)
        lost = (slope * (middle + jnp.exp(actor.spread) * tried.action)).sum(-1).mean()
        return lost - ENTROPY * actor.spread.sum()

    step, of_actor = quick_adam().update(jax.lax.pmean(jax.grad(along)(arrays), AXIS), of_actor)
    actor = eqx.combine(eqx.apply_updates(arrays, jax.tree.map(lambda x: -RATE * x, step)), rest)
    _, targets = advantages(config, now._replace(policy=wide(now.policy)), tried)
    critic, of_values = fitted(now, tried.seen, targets, of_values)
    policy = eqx.tree_at(lambda p: p.network, now.policy, actor.network)
    after = now._replace(policy=policy, spread=actor.spread, critic=critic, moments=(of_actor, of_values))
    after = with_observations(after, seen)._replace(states=states, ages=ages, key=key)
    return after, {"progress": jax.lax.pmean(tried.reward.mean(), AXIS)} | norms


def evened(slope: jax.Array) -> tuple[jax.Array, dict]:
    """Gradients by each robot's decisions, (decisions, robots, action_size), of which none counts more than the median:
    they are cut to the median norm, and told in it. Norms over all decisions, m/s: the median and the largest.

    Derivatives of a failed rollout are not finite: they count nothing.
    """
    norm = jnp.linalg.norm(slope, axis=-1, keepdims=True)
    fine = jnp.isfinite(norm)
    median = jax.lax.pmean(jnp.nanmedian(jnp.where(fine, norm, jnp.nan)), AXIS)
    largest = jax.lax.pmax(jnp.max(norm, where=fine, initial=0.0), AXIS)
    cut = jnp.where(fine, slope, 0) / jnp.maximum(jnp.where(fine, norm, 1), median + TINY)
    return cut, {"median": median, "largest": largest}


def rolled(nudges: jax.Array, env: Environment, config: LearningConfig, now: Learner, key: Any):
    """Minus the discounted reward of all robots' short rollouts and of the critic's values at their ends, m/s; where
    they end, what the policy saw, and what the critic needs. Nudges are added to the network's outputs."""
    of_starts, of_decisions = jax.random.split(key)
    fresh = jax.vmap(env.reset)(jax.random.split(of_starts, len(now.ages)))
    fresh = fresh.replace(info=fresh.info | {"steps": jnp.zeros(len(now.ages))})  # which leaves the time to us
    critic = jax.vmap(lambda seen: now.critic(standardised(wide(now.policy), seen)))
    told_of = lambda states: of_critic(now.policy, jax.vmap(now.policy.seen)(states.obs)[0], states)  # noqa: E731
    step, policy = jax.checkpoint(jax.vmap(env.step)), reaching(env, now.policy)

    def decide(carry, at):
        (states, ages, share), (key, nudge) = carry, at
        seen, which = jax.vmap(now.policy.seen)(states.obs)
        middle = jax.vmap(lambda seen: now.policy.network(standardised(now.policy, seen)))(seen)
        noise = jax.random.normal(key, middle.shape, middle.dtype)
        action = policy.action(seen, middle + jnp.exp(now.spread) * noise + nudge)
        action = jax.vmap(now.policy.placed)(action, which)
        hold = lambda states, _: (lambda s: (s, s.reward))(step(states, action))  # noqa: E731
        after, rewards = jax.lax.scan(hold, states, length=config.held)
        ended, reward = after.done > 0, rewards.mean(0)
        over = ended | (ages + 1 >= env.episode // config.held)
        gained = share * (1 - config.discount) * reward
        share = share * config.discount
        later = told_of(after)
        gained += jnp.where(over & ~ended, share * critic(later), 0)
        told = Tried(of_critic(now.policy, seen, states), noise, share, reward, later, ended, over)
        anew = lambda new, old: jnp.where(over.reshape(-1, *[1] * (old.ndim - 1)), new, old)  # noqa: E731
        ages, share = jnp.where(over, 0, ages + 1), jnp.where(over, 1.0, share)
        return (jax.tree.map(anew, fresh, after), ages, share), (gained.sum(), seen, told)

    first = now.states, now.ages, jnp.ones(len(now.ages), jnp.float32)
    (states, ages, share), (gained, *known) = jax.lax.scan(
        decide, first, (jax.random.split(of_decisions, config.decisions), nudges)
    )
    return -gained.sum() - (share * critic(told_of(states))).sum(), (states, ages, *jax.lax.stop_gradient(known))


def fitted(now: Learner, seen: Any, targets: Any, moments: Any) -> tuple[eqx.nn.MLP, Any]:
    """The critic, fitted to its targets in some steps, each on all robots at one decision."""
    arrays, rest = eqx.partition(now.critic, eqx.is_array)

    def missed(arrays, seen, targets):
        critic = eqx.combine(arrays, rest)
        values = jax.vmap(lambda x: critic(standardised(wide(now.policy), x)))(seen)
        return jnp.mean((values - targets) ** 2) / (jnp.var(targets) + 1e-8)

    def step(carry, k):
        arrays, moments = carry
        slope = jax.lax.pmean(jax.grad(missed)(arrays, seen[k], targets[k]), AXIS)
        move, moments = optimiser().update(slope, moments)
        return (eqx.apply_updates(arrays, jax.tree.map(lambda x: -RATE * x, move)), moments), None

    (arrays, moments), _ = jax.lax.scan(step, (arrays, moments), jnp.arange(FITS) % len(seen))
    return eqx.combine(arrays, rest), moments

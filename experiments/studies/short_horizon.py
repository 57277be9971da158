"""Whether gradients through the robot's motion teach a policy faster than PPO does, at equal processor time.

Short-horizon actor-critic (SHAC, Xu et al. 2022, arXiv:2204.07137): the policy climbs the reward of a short rollout and
the critic's value of its end, by reverse mode through every control period. The critic alone sees the averaged
velocity, from which the task `speed` makes its reward.
"""

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.sharding import Mesh, PartitionSpec
from measurements.measurement import Figure, Record, check_names, measurement
from measurements.pages import columns

from jaxgrity import InputError, SolverOptions, contact_twin, load_scene, with_error
from jaxgrity.control import Environment, Learner, LearningConfig, environment, learn, learner, trials
from jaxgrity.control.learned import Learned, standardised
from jaxgrity.control.ppo import AXIS, Tried, advantages, optimiser, with_observations
from jaxgrity.io.files import read_text
from jaxgrity.report import plot

PPO, SHAC = "PPO", "short-horizon"
CONTACTS = {"exact": 0.01, "penalty": 0.001}
"""Time step for each contact model, s. Penalty contact is unstable at 1.4 ms."""
RATE = 2e-3
"""Learning rate of policy and critic; both gradients are clipped as PPO's."""
CASES = (
    *("exact PPO 128 0", "exact short-horizon 128 0", "exact short-horizon 512 0", "exact short-horizon 512 1"),
    *("penalty PPO 128 0", "penalty short-horizon 128 0"),
)
"""Some minutes of processor time in all."""
POINTS = 50
"""Points of a learning curve in the record, at least."""
FITS = 16
"""Steps of the critic in an update."""


@measurement(
    page="environments.md",
    quick={"seconds": 0.1, "cases": ("exact PPO 8 0", "exact short-horizon 8 0"), "horizon": 2, "episodes": 2},
)
def short_horizon(
    cases: tuple[str, ...] = CASES,
    seconds: float = 60.0,
    horizon: int = 8,
    episodes: int = 64,
    earlier: Path | None = None,
) -> Iterator[Record]:
    """A row for each case.

    Args:
        cases: contact model, method, number of robots side by side, and seed
        seconds: of processor time for each policy, without compilation
        horizon: decisions of a short rollout, of four control periods each
        episodes: new ones, by which a policy is judged
        earlier: a record of the same settings, whose cases are not measured again
    """
    known = {} if earlier is None else {case_of(row): row for row in json.loads(read_text(earlier))["rows"]}
    for case in cases:
        yield known.get(case) or measured_case(case, seconds, horizon, episodes)
    return {"seconds": seconds, "horizon": horizon, "episodes": episodes}


def case_of(row: Record) -> str:
    """The name of a row's case."""
    return " ".join(str(row[name]) for name in ("contact", "method", "robots", "seed"))


def measured_case(case: str, seconds: float, horizon: int, episodes: int) -> Record:
    """What a policy reaches in new episodes after some processor time. Raises `InputError` for what is no case."""
    try:
        contact, method, robots, seed = case.split()
        check_names("contact", [contact], CONTACTS)
        check_names("method", [method], (PPO, SHAC))
        config = LearningConfig(robots=int(robots), **({"decisions": horizon} if method == SHAC else {}))
        key = jax.random.key(1000 + int(seed))
    except ValueError as error:
        raise InputError(f"cases = {case!r}: {error}; expected such as {CASES[0]!r}") from error
    scene = load_scene("exact") if contact == "exact" else contact_twin(load_scene("exact"))
    env = environment("speed", scene, options=SolverOptions(dt=CONTACTS[contact], dtype="float32"))
    policy, curve, norms = learned(method, env, config, int(seed), seconds)
    found = trials(env, policy, key, episodes)
    return {
        "contact": contact,
        "method": method,
        "robots": config.robots,
        "seed": int(seed),
        "periods": len(curve) * config.robots * config.decisions * config.held,
        "updates": len(curve),
        "progress": float(found.mean()),
        "error": 2 * float(found.std(ddof=1)) / episodes**0.5,
        "norms": norms,
        "curve": curve[:: max(1, len(curve) // POINTS)],
    }


def learned(
    method: str, env: Environment, config: LearningConfig, seed: int, seconds: float
) -> tuple[Learned, list[tuple[float, float]], list[float] | None]:
    """The policy after some processor time; progress of the tries, m/s, against that time, s; and of gradients through
    the motion the median norm and the largest."""
    now = learner(env, jax.random.key(seed), config)
    if method == PPO:
        facts: dict[str, float] = {}
        update = lambda now: (learn(env, now, 1, config, lambda _, told: facts.update(told)), facts)  # noqa: E731
    else:
        now, update = with_short_horizon(env, now, config)
    update(now)  # compiles
    curve, norms, spent = [], [], 0.0
    while spent < seconds:
        began = time.process_time()
        now, told = jax.block_until_ready(update(now))
        spent += time.process_time() - began
        curve.append((spent, float(told["progress"])))
        norms.append(float(told.get("norm", np.nan)))
    return now.policy, curve, None if method == PPO else [float(np.nanmedian(norms)), float(np.nanmax(norms))]


def with_short_horizon(env: Environment, now: Learner, config: LearningConfig) -> tuple[Learner, Callable]:
    """A start for SHAC, from that of PPO, and its update: every device has its own robots, as in PPO."""
    size = env.observation_size + 2
    critic = eqx.nn.MLP(size, "scalar", config.width, config.depth, jax.nn.tanh, dtype=jnp.float32, key=now.key)
    moments = tuple(optimiser().init(eqx.filter(part, eqx.is_array)) for part in (actor_of(now), critic))
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


def of_critic(states: Any) -> jax.Array:
    """What the critic sees of states."""
    return jnp.concatenate([states.obs, states.pipeline_state.average], -1)


def improved(env: Environment, config: LearningConfig, now: Learner) -> tuple[Learner, dict]:
    """One update: short rollouts, a step of the policy along their gradient, then steps of the critic."""
    key, of_all = jax.random.split(now.key)
    mine = jax.random.fold_in(of_all, jax.lax.axis_index(AXIS))
    climb = eqx.filter_value_and_grad(rolled, has_aux=True)
    (_, (states, ages, tried)), slope = climb(actor_of(now), env, config, now, mine)
    slope = jax.lax.pmean(slope, AXIS)
    norm = optax.global_norm(slope)
    of_actor, of_values = now.moments
    step, moved = optimiser().update(slope, of_actor)
    climbed = eqx.apply_updates(actor_of(now), jax.tree.map(lambda x: -RATE * x, step)), moved
    # derivatives of a failed rollout are not finite: such an update leaves the policy as it is
    kept, rest = eqx.partition((actor_of(now), of_actor), eqx.is_array)
    chosen = jax.tree.map(lambda a, b: jnp.where(jnp.isfinite(norm), a, b), eqx.filter(climbed, eqx.is_array), kept)
    actor, of_actor = eqx.combine(chosen, rest)
    _, targets = advantages(config, now._replace(policy=wide(now.policy)), tried)
    critic, of_values = fitted(now, tried.seen, targets, of_values)
    policy = eqx.tree_at(lambda p: p.network, now.policy, actor.network)
    after = now._replace(policy=policy, spread=actor.spread, critic=critic, moments=(of_actor, of_values))
    after = with_observations(after, tried.seen[..., :-2])._replace(states=states, ages=ages, key=key)
    return after, {
        "progress": jax.lax.pmean(tried.reward.mean(), AXIS),
        "norm": jnp.where(jnp.isfinite(norm), norm, jnp.nan),
    }


def rolled(actor: Actor, env: Environment, config: LearningConfig, now: Learner, key: Any):
    """Minus the discounted reward of short rollouts and of the critic's values at their ends, m/s; where they end."""
    of_starts, of_decisions = jax.random.split(key)
    fresh = jax.vmap(env.reset)(jax.random.split(of_starts, len(now.ages)))
    fresh = fresh.replace(info=fresh.info | {"steps": jnp.zeros(len(now.ages))})  # which leaves the time to us
    critic = jax.vmap(lambda states: now.critic(standardised(wide(now.policy), of_critic(states))))
    step = jax.checkpoint(jax.vmap(env.step))

    def decide(carry, key):
        states, ages, share = carry
        middle = jax.vmap(lambda seen: actor.network(standardised(now.policy, seen)))(states.obs)
        action = middle + jnp.exp(actor.spread) * jax.random.normal(key, middle.shape, middle.dtype)
        hold = lambda states, _: (lambda s: (s, s.reward))(step(states, jnp.tanh(action)))  # noqa: E731
        after, rewards = jax.lax.scan(hold, states, length=config.held)
        ended, reward = after.done > 0, rewards.mean(0)
        over = ended | (ages + 1 >= env.episode // config.held)
        gained = share * (1 - config.discount) * reward
        share = share * config.discount
        gained += jnp.where(over & ~ended, share * critic(after), 0)
        told = Tried(of_critic(states), action, share, reward, of_critic(after), ended, over)
        anew = lambda new, old: jnp.where(over.reshape(-1, *[1] * (old.ndim - 1)), new, old)  # noqa: E731
        ages, share = jnp.where(over, 0, ages + 1), jnp.where(over, 1.0, share)
        return (jax.tree.map(anew, fresh, after), ages, share), (gained.mean(), told)

    first = now.states, now.ages, jnp.ones(len(now.ages), jnp.float32)
    (states, ages, share), (gained, tried) = jax.lax.scan(
        decide, first, jax.random.split(of_decisions, config.decisions)
    )
    return -gained.sum() - (share * critic(states)).mean(), (states, ages, jax.lax.stop_gradient(tried))


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


@short_horizon.table
def words(record: Record) -> str:
    """What each method reaches; whatever is the same in all rows is left out."""
    told = {"contact": "{contact}", "method": "{method}", "robots": "{robots}", "seed": "{seed}"}
    cells = {name: cell for name, cell in told.items() if len({row[name] for row in record["rows"]}) > 1}
    cells |= {
        "progress, m/s": lambda row: with_error(row["progress"], row["error"], decimals=2),
        "updates": "{updates}",
        "control periods": lambda row: f"{row['periods'] / 1e6:.2f} million",
        "norm of gradients, median and largest": lambda row: (
            "-" if row["norms"] is None else " and ".join(f"{x:.2g}" for x in row["norms"])
        ),
    }
    return columns(record["rows"], cells)


@short_horizon.figure(4.2)
def figure(record: Record, chart: Figure) -> None:
    """Progress of the policies that are tried, against processor time, for each contact model."""
    contacts = list(dict.fromkeys(row["contact"] for row in record["rows"]))
    for axes, contact in zip(np.ravel(chart.subplots(1, len(contacts), sharey=True, squeeze=False)), contacts):
        mine = (row for row in record["rows"] if row["contact"] == contact)
        for row, marker in zip(mine, plot.MARKERS):
            time, progress = np.array(row["curve"]).T
            look = {"marker": marker, "markevery": 0.1, "markersize": 5}
            axes.plot(time, progress, **look, label=f"{row['method']}, {row['robots']} robots, seed {row['seed']}")
        axes.set(title=f"{contact} contact", xlabel="processor time (s)")
        axes.set_xlim(0, None)
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.08), ncols=2)
    chart.axes[0].set_ylabel("progress with exploration (m/s)")

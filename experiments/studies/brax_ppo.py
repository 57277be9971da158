"""Whether another library's learner makes progress in our environments: Brax's own PPO, with its auto-reset.

Brax is in the extra `brax`. Its wrappers hold each action for four control periods, count the steps of an episode, and
begin a finished one again from its own start.
"""

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns

from jaxgrity import InputError, SolverOptions, load_scene, with_error
from jaxgrity.control import TASKS, LearningConfig, environment, trials

LIKE_OURS = LearningConfig()
"""Settings of our own PPO, which Brax's gets as far as it has them."""


class Acting(eqx.Module):
    """Brax's policy without its random tries, as `trials` takes it."""

    act: Callable = eqx.field(static=True)
    """Brax's, from its parameters to a policy"""
    parameters: Any
    held: int = eqx.field(static=True, default=LIKE_OURS.held)

    def __call__(self, seen):
        action, _ = self.act(self.parameters, deterministic=True)(seen, jax.random.key(0))
        return action


@measurement(
    page="environments.md",
    quick={"seeds": (0,), "million_periods": 0.02, "robots": 8, "episodes": 2, "seconds": 0.4},
    drawn=("curve",),
)
def brax_ppo(
    task: str = "goal",
    seeds: tuple[int, ...] = (0, 1),
    million_periods: float = 13.0,
    robots: int = 512,
    episodes: int = 64,
    seconds: float = 10.0,
) -> Iterator[Record]:
    """A row for each seed.

    Args:
        task: of the environments
        seeds: of starts, networks and tries
        million_periods: control periods of all robots together, at least, in millions
        robots: side by side
        episodes: new ones, by which a policy is judged
        seconds: s, of an episode
    """
    if task not in TASKS:
        raise InputError(f"task = {task!r}: unknown here; expected one of {', '.join(TASKS)}")
    env = environment(task, load_scene("exact"), options=SolverOptions(dt=0.01, dtype="float32"), seconds=seconds)
    for seed in seeds:
        judged = partial(trials, env, key=jax.random.key(1000 + seed), episodes=episodes)
        curve, first, last, spent = learned(env, seed, int(1e6 * million_periods), robots)
        before, after = judged(first), judged(last)
        yield {
            "task": task,
            "seed": seed,
            "seconds": spent,
            "periods": curve[-1][0],
            "curve": curve,
            "before": float(before.mean()),
            "before_error": 2 * float(before.std(ddof=1)) / episodes**0.5,
            "after": float(after.mean()),
            "after_error": 2 * float(after.std(ddof=1)) / episodes**0.5,
            "better": int((after > before).sum()),
        }
    return {"robots": robots, "episodes": episodes}


def learned(env: Any, seed: int, periods: int, robots: int) -> tuple[list[tuple[int, float]], Acting, Acting, float]:
    """The reward of each evaluation by Brax, m/s, against control periods; the policy before and after; and the
    processor time that learning took, s, compilation and evaluations included. Raises `InputError` without Brax."""
    try:
        from brax.training.agents.ppo import networks, train
    except ImportError as error:
        raise InputError("Brax is not installed; expected it, as by: pip install 'jaxgrity[brax]'") from error
    if not hasattr(jax, "device_put_replicated"):
        jax.device_put_replicated = replicated  # which Brax 0.14 calls, and JAX 0.10 has no longer
    sizes = (LIKE_OURS.width,) * LIKE_OURS.depth
    curve: list[tuple[int, float]] = []
    policies: list[Acting] = []
    began = time.process_time()
    train.train(
        env,
        num_timesteps=periods,
        num_envs=robots,
        episode_length=env.episode,
        action_repeat=LIKE_OURS.held,
        unroll_length=min(LIKE_OURS.decisions, env.episode // LIKE_OURS.held),
        batch_size=robots // LIKE_OURS.batches,
        num_minibatches=LIKE_OURS.batches,
        num_updates_per_batch=LIKE_OURS.epochs,
        normalize_observations=True,
        # as our own learner's: the mean reward while an action is held, and values in m/s
        reward_scaling=(1 - LIKE_OURS.discount) / LIKE_OURS.held,
        discounting=LIKE_OURS.discount,
        gae_lambda=LIKE_OURS.trace,
        clipping_epsilon=LIKE_OURS.clip,
        entropy_cost=LIKE_OURS.entropy,
        learning_rate=1e-3,
        max_grad_norm=1.0,
        network_factory=partial(
            networks.make_ppo_networks, policy_hidden_layer_sizes=sizes, value_hidden_layer_sizes=sizes
        ),
        num_evals=8,
        num_eval_envs=robots // 4,
        seed=seed,
        progress_fn=lambda done, told: curve.append((done, float(told["eval/episode_reward"]) / env.episode)),
        policy_params_fn=lambda _, make, parameters: policies.append(Acting(make, parameters)),
    )
    return curve, policies[0], policies[-1], time.process_time() - began


def replicated(tree: Any, devices: list) -> Any:
    """The tree's arrays once on each device, with an axis for the devices in front."""
    there = NamedSharding(Mesh(np.array(devices), ("devices",)), PartitionSpec("devices"))
    return jax.tree.map(lambda x: jax.device_put(jnp.stack([x] * len(devices)), there), tree)


@brax_ppo.table
def words(record: Record) -> str:
    """What the policies reach before and after."""
    cells = {
        "task": "{task}",
        "seed": "{seed}",
        "progress before, m/s": lambda row: with_error(row["before"], row["before_error"], decimals=3),
        "progress after, m/s": lambda row: with_error(row["after"], row["after_error"], decimals=3),
        "episodes with more progress": lambda row: f"{row['better']} of {record['episodes']}",
        "control periods": lambda row: f"{row['periods'] / 1e6:.1f} million",
        "processor time": lambda row: f"{row['seconds'] / 60:.1f} minutes",
    }
    return columns(record["rows"], cells)


@brax_ppo.figure(4)
def figure(record: Record, chart: Figure) -> None:
    """Reward in Brax's own evaluations, against control periods."""
    axes = chart.subplots()
    for row in record["rows"]:
        done, reward = np.array(row["curve"]).T
        axes.plot(done / 1e6, reward, marker="o", label=f"{row['task']}, seed {row['seed']}")
    axes.set(xlabel="control periods (millions)", ylabel="reward in evaluations (m/s)")
    axes.set_xlim(0, None)
    axes.legend(loc="lower right")

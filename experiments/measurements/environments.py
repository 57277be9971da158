"""How fast environments are, and whether a random policy ever gets a number that is not finite."""

import time
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from measurements.measurement import Record, check_names, measurement
from measurements.pages import columns

from jaxgrity import SolverOptions, load_scene
from jaxgrity.control import TASKS, Environment, environment

DEFAULTS = "double precision, 5 ms"
"""what `environment` takes where nothing else is said"""


@measurement(page="environments.md", quick={"tasks": ("heading",), "steps": 800, "robots": 8})
def environments(
    tasks: tuple[str, ...] = tuple(TASKS), steps: int = 10_000_000, robots: int = 256, seed: int = 0
) -> Iterator[Record]:
    """A row for each task, and one for the first with all defaults.

    Args:
        tasks: names of tasks
        steps: of each environment, in all
        robots: side by side
        seed: of starts and actions
    """
    check_names("tasks", tasks, TASKS)
    for task in tasks:
        options = SolverOptions(dt=0.01, dtype="float32")
        yield {"task": task} | timed(environment(task, load_scene("exact"), options=options), steps, robots, seed)
    defaults = environment(tasks[0], load_scene("exact"))
    yield {"task": f"{tasks[0]}, {DEFAULTS}"} | timed(defaults, max(robots, steps // 10), robots, seed)


def timed(env: Environment, steps: int, robots: int, seed: int) -> dict[str, Any]:
    """Episodes of a random policy, begun anew when all are over; compiled before they are timed, and repeated."""
    ticks = min(env.episode, steps // robots)
    count = -(-steps // (ticks * robots))

    @jax.jit
    def episodes(key):
        starts, actions = jax.random.split(key)

        def step(carry, key):
            state, bad = carry
            chosen = jax.random.uniform(key, (robots, env.action_size), minval=-1)
            state = jax.vmap(env.step)(state, chosen)
            bad += jnp.sum(~jnp.isfinite(state.obs)) + jnp.sum(~jnp.isfinite(state.reward))
            return (state, bad), state.reward

        first = jax.vmap(env.reset)(jax.random.split(starts, robots))
        (end, bad), reward = jax.lax.scan(step, (first, jnp.asarray(0)), jax.random.split(actions, ticks))
        return bad, jnp.sum(end.metrics["failed"]), jnp.mean(reward, axis=0)

    keys = jax.random.split(jax.random.key(seed), count)
    first = jax.block_until_ready(episodes(keys[0]))
    began = time.process_time()
    found = [jax.block_until_ready(episodes(key)) for key in keys]
    used = time.process_time() - began
    return {
        "steps": count * ticks * robots,
        "episodes": count * robots,
        "processor_seconds": used,
        "not_finite": int(sum(bad for bad, _, _ in found)),
        "failed": int(sum(failed for _, failed, _ in found)),
        "repeated": bool(np.array_equal(first[2], found[0][2])),
    }


@environments.table
def words(record: Record) -> str:
    """How fast each environment was, and how many episodes failed."""
    cells = {
        "task": "{task}",
        "control periods": "{steps:,}",
        "periods per second on a core": lambda row: f"{round(row['steps'] / row['processor_seconds'], -3):,.0f}",
        "episodes": "{episodes:,}",
        "failed": "{failed}",
    }
    return columns(record["rows"], cells)

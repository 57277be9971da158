"""How fast environments are, and whether a random policy ever gets a number that is not finite."""

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import InputError, SolverOptions, load_scene
from jaxgrity.control import TASKS, Environment, environment
from jaxgrity.io.files import save_json
from jaxgrity.report import plot

DEFAULTS = "double precision, 5 ms"
"""what `environment` takes where nothing else is said"""


@dataclass
class Settings:
    tasks: tuple[str, ...] = tuple(TASKS)
    steps: int = 10_000_000
    """of each environment, in all"""
    robots: int = 256
    """side by side"""
    seed: int = 0
    """of starts and actions"""
    out: Path = Path("results/environments")
    """folder for environments.json and its figure"""
    quick: bool = False
    """one task, 8 robots, 800 steps"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.tasks, settings.steps, settings.robots = ("heading",), 800, 8
    unknown = sorted(set(settings.tasks) - set(TASKS))
    if unknown:
        raise InputError(f"tasks = {unknown}: unknown; expected some of {', '.join(TASKS)}")
    rows: list[dict[str, Any]] = []
    for task in tqdm(settings.tasks, unit="task"):
        options = SolverOptions(dt=0.01, dtype="float32")
        rows.append({"task": task} | timed(environment(task, load_scene("exact"), options=options), settings))
        save_json(settings.out / "environments.json", {**measured(), "robots": settings.robots, "rows": rows})
    defaults = environment(settings.tasks[0], load_scene("exact"))
    fewer = dataclasses.replace(settings, steps=max(settings.robots, settings.steps // 10))
    rows.append({"task": f"{settings.tasks[0]}, {DEFAULTS}"} | timed(defaults, fewer))
    save_json(settings.out / "environments.json", {**measured(), "robots": settings.robots, "rows": rows})
    plot.save(figure(rows), settings.out / "environments.png")
    for row in rows:
        print(f"{row['task']}: {row['steps']} steps in {row['seconds']:.1f} s, {row['not_finite']} numbers not finite")


def timed(env: Environment, settings: Settings) -> dict[str, Any]:
    """Episodes of a random policy, begun anew when all are over; compiled before they are timed, and repeated."""
    ticks = min(env.episode, settings.steps // settings.robots)
    count = -(-settings.steps // (ticks * settings.robots))

    @jax.jit
    def episodes(key):
        starts, actions = jax.random.split(key)

        def step(carry, key):
            state, bad = carry
            chosen = jax.random.uniform(key, (settings.robots, env.action_size), minval=-1)
            state = jax.vmap(env.step)(state, chosen)
            bad += jnp.sum(~jnp.isfinite(state.obs)) + jnp.sum(~jnp.isfinite(state.reward))
            return (state, bad), state.reward

        first = jax.vmap(env.reset)(jax.random.split(starts, settings.robots))
        (end, bad), reward = jax.lax.scan(step, (first, jnp.asarray(0)), jax.random.split(actions, ticks))
        return bad, jnp.sum(end.metrics["failed"]), jnp.mean(reward, axis=0)

    keys = jax.random.split(jax.random.key(settings.seed), count)
    first = jax.block_until_ready(episodes(keys[0]))
    began, used = time.perf_counter(), time.process_time()
    found = [jax.block_until_ready(episodes(key)) for key in keys]
    spent, used = time.perf_counter() - began, time.process_time() - used
    return {
        "steps": count * ticks * settings.robots,
        "episodes": count * settings.robots,
        "seconds": spent,
        "processor_seconds": used,
        "not_finite": int(sum(bad for bad, _, _ in found)),
        "failed": int(sum(failed for _, failed, _ in found)),
        "repeated": bool(np.array_equal(first[2], found[0][2])),
        "reward": float(np.mean([reward for _, _, reward in found])),
    }


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """Steps a second for each task."""
    chart = Figure(figsize=(5, 0.5 * len(rows) + 1.5), layout="constrained")
    axes = chart.subplots()
    axes.barh([row["task"] for row in rows], [row["steps"] / row["seconds"] / 1000 for row in rows], height=0.6)
    axes.set(xlabel="environment steps a second (thousands)")
    axes.grid(axis="y", visible=False)
    axes.invert_yaxis()
    return chart


if __name__ == "__main__":
    run(main, Settings)

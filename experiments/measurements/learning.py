"""How fast policies are learned, how well they do in new episodes, and on the contact model that they never saw."""

import time
from collections.abc import Iterator

import jax
import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns

from jaxgrity import SolverOptions, contact_twin, load_scene, with_error
from jaxgrity.control import LearningConfig, environment, learn, learner, trials
from jaxgrity.report import plot


@measurement(page="environments.md", quick={"updates": 2, "robots": 8, "episodes": 2}, drawn=("curve",))
def learning(
    seeds: tuple[int, ...] = (0, 1, 2),
    updates: int = 300,
    robots: int = 512,
    episodes: int = 64,
) -> Iterator[Record]:
    """A row for each seed.

    Args:
        seeds: of starts, networks and tries
        updates: of each policy
        robots: side by side
        episodes: new ones, by which a policy is judged
    """
    config = LearningConfig(robots=robots)
    scene, options = load_scene("exact"), SolverOptions(dt=0.01, dtype="float32")
    env, finer = environment("speed", scene, options=options), environment("speed", scene)
    other = environment("speed", contact_twin(scene))
    for seed in seeds:
        curve: list[float] = []
        now = learner(env, jax.random.key(seed), config)
        began = time.perf_counter()
        policy = learn(env, now, updates, config, lambda _, told, c=curve: c.append(told["progress"])).policy
        spent = time.perf_counter() - began
        judged = {
            name: trials(each, policy, jax.random.key(1000 + seed), episodes)
            for name, each in {"progress": env, "finer": finer, "other": other}.items()
        }
        yield {
            "task": "speed",
            "seed": seed,
            "seconds": spent,
            **{name: float(found.mean()) for name, found in judged.items()},
            "error": 2 * float(judged["progress"].std(ddof=1)) / episodes**0.5,
            "curve": curve,
        }
    periods = robots * config.decisions * config.held
    return {"updates": updates, "robots": robots, "episodes": episodes, "periods": periods}


@learning.table
def words(record: Record) -> str:
    """What each policy reaches."""
    cells = {
        "task": "{task}",
        "seed": "{seed}",
        "progress, m/s": lambda row: with_error(row["progress"], row["error"], decimals=3),
        "with steps of 5 ms, float64": "{finer:.2f}",
        "other contact model": "{other:.2f}",
        "control periods": lambda _: f"{record['updates'] * record['periods'] / 1e6:.1f} million",
        "wall time, s": "{seconds:.0f}",
    }
    return columns(record["rows"], cells)


@learning.figure(4.2)
def figure(record: Record, chart: Figure) -> None:
    """Progress of the policies that are tried, against control periods."""
    axes = chart.subplots()
    for row, marker in zip(record["rows"], plot.MARKERS):
        at = np.arange(1, len(row["curve"]) + 1) * record["periods"] / 1e6
        axes.plot(
            at, row["curve"], marker=marker, markevery=0.08, markersize=5, label=f"{row['task']}, seed {row['seed']}"
        )
    axes.set(xlabel="control periods (millions)", ylabel="progress with exploration (m/s)")
    axes.set_xlim(0, None)
    chart.legend(loc="outside upper center", ncols=3)

"""Feedback for bumps of 2 cm: gains, amplitude and frequency, by the cross-entropy method as in tune_feedback.py.

Each robot of a candidate is dropped at another place of the bumps, and the speed over the last 5 s of 15 s counts.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import jax
import jax.numpy as jnp
import numpy as np
from basin import drops
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import (
    Differences,
    PhaseLocked,
    Plant,
    SolverOptions,
    Task,
    as_dtype,
    drive,
    ground_of,
    load_gait,
    load_scene,
    loop_start,
    plant_of,
    plot,
    side_by_side,
)
from jaxgrity.io.files import save_json

BUMPS, BUMPS_SEED, FAR = 0.02, 10, 30.0
"""m, standard deviation of the height; which ground, another one than where results are measured; m, how far from its
middle robots are dropped"""
START = np.array([0.2, 0.29, -0.15, 0.17, 0.0, 0.0, 0.0, 0.0, 1.05, 1.03])
SPREAD = np.array([0.15] * 4 + [0.1] * 4 + [0.07, 0.08])
"""gains, gains of swings, and the factors of amplitude and frequency: where the search starts, and how wide"""
LOW, HIGH = np.array([-3.0] * 8 + [0.5] * 2), np.array([3.0] * 8 + [1.4, 1.8])
BEST, MOVED, LEAST_SPREAD = 5, 0.4, 0.008
"""candidates towards which the distribution moves, how far, and what is added to its spread"""


@dataclass
class Settings:
    generations: int = 24
    candidates: int = 20
    robots: int = 24
    """dropped under each candidate"""
    seed: int = 0
    """of candidates and drops"""
    out: Path = Path("results/tune_on_bumps")
    """folder for tune_on_bumps.json and its figure"""
    quick: bool = False
    """2 generations of 6 candidates and 2 robots"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.generations, settings.candidates, settings.robots = 2, 6, 2
    scene, gait = load_scene("exact"), load_gait("lasting")
    rough = ground_of(Task("heading", bumps=BUMPS), scene, seed=BUMPS_SEED)
    plant = plant_of(rough, gait.members, options=SolverOptions(dt=0.01, dtype="float32"))
    draw, mean, spread = np.random.default_rng(settings.seed), START, SPREAD
    rows: list[dict[str, Any]] = []
    for number in tqdm(range(settings.generations), unit="generation"):
        tried = np.clip(mean + spread * draw.standard_normal((settings.candidates, len(mean))), LOW, HIGH)
        tried[0], tried[1] = START, mean
        speeds = dropped(plant, settings, tried, 1000 + number)
        best = np.argsort(-speeds)[:BEST]
        rows.append({"start": speeds[0], "mean": speeds[1], "best": speeds[best[0]], "parameters": mean})
        mean = (1 - MOVED) * mean + MOVED * tried[best].mean(0)
        spread = (1 - MOVED) * spread + MOVED * tried[best].std(0) + LEAST_SPREAD
        told = {"gains": mean[:4].reshape(2, 2), "swings": mean[4:8].reshape(2, 2)}
        told |= {"amplitude": mean[8], "frequency": mean[9]}
        save_json(settings.out / "tune_on_bumps.json", {**measured(), **told, "rows": rows})
    plot.save(figure(rows), settings.out / "tune_on_bumps.png")
    print(f"gains, swings, amplitude, frequency {mean.round(2).tolist()}; wrote {settings.out}/")


def dropped(plant: Plant, settings: Settings, tried: np.ndarray, seed: int) -> np.ndarray:
    """(candidates,): the mean speed of the robots under each, m/s; 0 for those whose rollouts failed."""
    each, count = settings.robots, settings.robots * len(tried)
    places = np.random.default_rng(seed).uniform(-FAR, FAR, (each, 3)) * [1, 1, 0]
    many = side_by_side(plant, count, Differences(terrain=np.tile(places, (len(tried), 1))))
    rows = np.moveaxis(np.repeat(tried, each, axis=0), 0, -1)
    locked = PhaseLocked(load_gait("lasting"))
    policy = jax.tree.map(lambda x: jnp.repeat(jnp.asarray(x)[..., None], count, axis=-1), locked)
    gait = replace(policy.gait, amplitude=policy.gait.amplitude * rows[8], frequency=policy.gait.frequency * rows[9])
    gains, swings = (rows[k : k + 4].reshape(2, 2, count) for k in (0, 4))
    policy = as_dtype(replace(policy, gait=gait, gains=gains, swings=swings), "float32")
    q, v = drops(load_scene("exact"), each, seed)
    start = tuple(np.moveaxis(np.tile(x, (len(tried), 1, 1)), 0, -1) for x in (q + np.array([0, 0, 4 * BUMPS]), v))
    there = drive(many, policy, loop_start(many, policy, jax.random.key(0), start, each=True), 500, 3, each=True)
    moved = np.asarray(there.path)[-2:, :2]
    speeds = np.where(np.asarray(there.failure) == 0, np.linalg.norm(moved[1] - moved[0], axis=0) / 5, 0)
    return speeds.reshape(len(tried), each).mean(1)


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """The mean speed on bumps, generation by generation."""
    chart = Figure(figsize=(5, 3.2), layout="constrained")
    axes = chart.subplots()
    for name, label in (("best", "best candidate"), ("mean", "mean of the distribution"), ("start", "where it began")):
        axes.plot([row[name] for row in rows], label=label)
    axes.set(xlabel="generation", ylabel="speed on bumps (m/s)", ylim=(0, None))
    axes.legend()
    return chart


if __name__ == "__main__":
    run(main, Settings)

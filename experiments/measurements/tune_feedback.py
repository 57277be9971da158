"""Gains of phase-locked feedback, by the cross-entropy method: from which drops robots soon roll, and how fast.

Each generation draws gains from normal distributions, drops the same robots under each of them, and moves the
distributions towards the best (Rubinstein 1999, doi:10.1023/A:1010091220143).
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import jax
import jax.numpy as jnp
import numpy as np
from basin import ENOUGH, drops
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import (
    PhaseLocked,
    SolverOptions,
    as_dtype,
    drive,
    gait_record,
    load_gait,
    load_scene,
    loop_start,
    plant_of,
    plot,
    side_by_side,
)
from jaxgrity.io.files import save_json

SPREAD, LEAST_SPREAD = 0.6, 0.02
"""standard deviation of the gains at first, and what is added to it in every generation"""
BEST = 5
"""candidates towards which the distributions move"""
COUNTED = 1.1
"""times the orbit's speed, beyond which being faster does not count"""


@dataclass
class Settings:
    gait: str = "lasting"
    """one of the library's, of struts"""
    generations: int = 14
    candidates: int = 16
    robots: int = 24
    """dropped under each candidate"""
    seed: int = 0
    """of gains and drops"""
    out: Path = Path("results/tune_feedback")
    """folder for tune_feedback.json and its figure"""
    quick: bool = False
    """2 generations of 4 candidates and 4 robots"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.generations, settings.candidates, settings.robots = 2, 6, 4
    draw = np.random.default_rng(settings.seed)
    mean, spread = np.zeros(4), np.full(4, SPREAD)
    rows: list[dict[str, Any]] = []
    for number in tqdm(range(settings.generations), unit="generation"):
        gains = mean + spread * draw.standard_normal((settings.candidates, 4))
        # the open loop and the mean, each in every other generation, to compare with
        gains[0] = 0 if number % 2 == 0 else mean
        rolling, worth = dropped(settings, gains, 100 + number)
        best = np.argsort(-(rolling + worth))[:BEST]
        rows.append({"open_loop": number % 2 == 0, "rolling": rolling[0], "best": rolling[best[0]], "mean": mean})
        mean = (mean + gains[best].mean(0)) / 2
        spread = 0.3 * spread + 0.7 * gains[best].std(0) + LEAST_SPREAD
    save_json(settings.out / "tune_feedback.json", {**measured(), "gains": mean.reshape(2, 2), "rows": rows})
    plot.save(figure(rows), settings.out / "tune_feedback.png")
    print(f"gains {mean.reshape(2, 2).round(3).tolist()}; wrote {settings.out}/")


def dropped(settings: Settings, gains: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(candidates,): the share of robots that roll after 15 s, and their mean speed over the orbit's."""
    scene, gait, each = load_scene("exact"), load_gait(settings.gait), settings.robots
    speed = float(gait_record(settings.gait)["steady"]["speed"])
    plant = plant_of(scene, gait.members, options=SolverOptions(dt=0.01, dtype="float32"))
    count = len(gains) * each
    policy = jax.tree.map(lambda x: jnp.repeat(jnp.asarray(x)[..., None], count, axis=-1), PhaseLocked(gait))
    rows = np.moveaxis(np.repeat(gains, each, axis=0).reshape(count, 2, 2), 0, -1)
    policy = as_dtype(replace(policy, gains=rows), "float32")
    start = tuple(np.moveaxis(np.tile(x, (len(gains), 1, 1)), 0, -1) for x in drops(scene, each, seed))
    many = side_by_side(plant, count)
    there = drive(many, policy, loop_start(many, policy, jax.random.key(0), start, each=True), 500, 3, each=True)
    moved = np.asarray(there.path)[-2:, :2]
    share = np.where(np.asarray(there.failure) == 0, np.linalg.norm(moved[1] - moved[0], axis=0) / 5 / speed, 0)
    share = share.reshape(len(gains), each)
    return (share >= ENOUGH).mean(1), np.minimum(share, COUNTED).mean(1)


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """The share of robots that roll, generation by generation."""
    chart = Figure(figsize=(5, 3.2), layout="constrained")
    axes = chart.subplots()
    axes.plot([100 * row["best"] for row in rows], label="best candidate")
    for label, chosen in (("open loop", True), ("mean of the distribution", False)):
        own = [(k, 100 * row["rolling"]) for k, row in enumerate(rows) if row["open_loop"] == chosen]
        axes.plot(*zip(*own), "o", markersize=4, label=label)
    axes.set(xlabel="generation", ylabel="robots that roll after 15 s (%)", ylim=(0, 103))
    axes.legend()
    return chart


if __name__ == "__main__":
    run(main, Settings)

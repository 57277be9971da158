"""A repertoire of gaits: speeds and turnings by MAP-Elites, and the orbits of some of its elites.

Of what is asked for, the nearest elites are watched one after the other, until one settles on an orbit that attracts.
Gaits are waves about one axis of the robot, which lets it turn. Of the repertoire a straight, a left, a right, a slow
and a fast gait are rolled out until they settle, and disturbed; each is left as a file.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import jax
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import (
    Repertoire,
    RepertoireConfig,
    Scene,
    SearchConfig,
    SearchProblem,
    SolverOptions,
    body_length,
    find_orbit,
    gait_facts,
    load_scene,
    one_gait,
    plot,
    repertoire,
    search_problem,
    stability,
    with_gait,
)
from jaxgrity.io.files import save_json

ASKED = {"straight": (0.6, 0.0), "left": (0.5, 0.6), "right": (0.5, -0.6), "slow": (0.25, 0.0), "fast": (1.2, 0.0)}
"""speed, body lengths/s, and bend, rad per body length"""
WEIGHTS = (1.0, 2.0)
"""of differences in speed and in bend"""


@dataclass
class Settings:
    drawn: int = 256
    """gaits at random"""
    batch: int = 64
    """gaits in a round"""
    rounds: int = 12
    robots: int = 4
    """that each gait is tried on, which differ as in a search"""
    duration: float = 40.0
    """s"""
    watch: float = 120.0
    """s, for which elites are watched"""
    tries: int = 6
    """elites that are watched for each gait that is asked for, at most"""
    seed: int = 0
    out: Path = Path("results/repertoire")
    """folder for repertoire.json, its figure and, in gaits/, a file for each gait"""
    quick: bool = False
    """few gaits, 10 s"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.drawn, settings.batch, settings.rounds, settings.duration = 48, 16, 1, 10.0
        settings.tries = 1
    scene = load_scene("exact")
    problem = search_problem(scene, SearchConfig(settings.duration, waves="axis", robots=settings.robots))
    config = RepertoireConfig(drawn=settings.drawn, batch=settings.batch, rounds=settings.rounds)
    with tqdm(total=settings.rounds + 1, unit="round") as bar:
        options = SolverOptions(dt=0.01, dtype="float32")
        found = repertoire(problem, config, seed=settings.seed, options=options, on_round=lambda _: bar.update())
    rows = []
    for name, asked in tqdm(ASKED.items(), unit="gait"):
        rows.append({"gait": name, **verified(problem, scene, found, asked, settings, name)})
    cells = {part: np.where(np.isfinite(x), x, None).tolist() for part, x in zip(("speed", "bend"), found[1:3])}
    facts = {**measured(), "rollouts": found.rollouts, "filled": list(found.filled), "cells": list(config.cells)}
    save_json(settings.out / "repertoire.json", {**facts, **cells, "rows": rows})
    plot.save(figure(found, config, rows), settings.out / "repertoire.png")
    print(f"{found.filled[-1]} of {np.prod(config.cells)} cells; wrote {settings.out}/")


def verified(
    problem: SearchProblem, scene: Scene, found: Repertoire, asked: tuple[float, float], settings: Settings, name: str
) -> dict[str, Any]:
    """The orbit of the nearest elite that has one which attracts, in body lengths; its gait goes to a file."""
    row: dict[str, Any] = {}
    for number, genes in enumerate(found.nearest(*asked, settings.tries, WEIGHTS)):
        gait = jax.tree.map(np.asarray, one_gait(problem.genome.gaits(scene.gait, genes[None]), 0))
        cell = tuple(np.argwhere((found.genes == genes).all(-1))[0])
        row = {"elite_speed": float(found.speed[cell]), "elite_bend": float(found.bend[cell]), "watched": number + 1}
        row |= watched(with_gait(scene, gait), settings)
        if row["settled"] and row["multiplier"] is not None and row["multiplier"] < 1:
            save_json(settings.out / "gaits" / f"{name}.json", gait_facts(gait))
            break
    return row


def watched(scene: Scene, settings: Settings) -> dict[str, Any]:
    """What the robot settles on, and what becomes of disturbances."""
    size, least = float(body_length(scene)), 55 / float(scene.gait.frequency[0])
    orbit = find_orbit(scene, max(least, settings.watch))
    held = stability(scene, orbit, robots=64) if orbit.settled else None
    return {
        "settled": orbit.settled,
        "speed": orbit.speed / size,
        "bend": orbit.turning / max(orbit.speed / size, 1e-9),
        "multiplier": held.largest if held is not None and np.isfinite(held.largest) else None,
        "returned": held.returned if held is not None else None,
        "verified_for": orbit.verified_for,
    }


@plot.styled
def figure(found: Repertoire, config: RepertoireConfig, rows: list[dict[str, Any]]) -> Figure:
    """The elites' spread in every cell, where they are, and the orbits of some."""
    chart = Figure(figsize=(7, 4.5), layout="constrained")
    axes = chart.subplots()
    shown = axes.imshow(
        -found.quality, origin="lower", aspect="auto", extent=(*config.bend, *config.speed), cmap="viridis", alpha=0.7
    )
    chart.colorbar(shown, label="spread of speed and bend over robots, added up")
    full = np.isfinite(found.speed)
    axes.plot(found.bend[full], found.speed[full], "k.", markersize=3)
    for k, row in enumerate(row for row in rows if row["settled"]):
        axes.plot(row["bend"], row["speed"], "o", color=f"C{k}", markersize=8, markeredgecolor="k", label=row["gait"])
    axes.set(xlabel="bend (rad per body length, to the left)", ylabel="speed (body lengths/s)")
    axes.set(xlim=config.bend, ylim=config.speed)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(title="orbits", loc="upper right")
    return chart


if __name__ == "__main__":
    run(main, Settings)

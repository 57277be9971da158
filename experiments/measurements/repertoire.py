"""A repertoire of gaits: speeds and turnings by MAP-Elites, and the orbits of some of its elites.

Gaits are waves about one axis of the robot, which lets it turn. A straight, a left, a right, a slow and a fast gait are
asked for: the nearest elites, and mirror images of those that are nearest with the other hand, are rolled out until
they settle, and disturbed. The orbit that attracts and comes nearest to what was asked is told, and its gait left as a
file; no cell of the repertoire is told twice, but as its own mirror image.
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
    Gait,
    Scene,
    SearchConfig,
    SearchProblem,
    SolverOptions,
    gait_facts,
    load_scene,
    one_gait,
    with_gait,
)
from jaxgrity.io.files import save_json
from jaxgrity.model import body_length, image, symmetries
from jaxgrity.orbits import find_orbit, stability
from jaxgrity.report import plot
from jaxgrity.search import Repertoire, RepertoireConfig, repertoire, search_problem

ASKED = {"straight": (0.6, 0.0), "left": (0.5, 0.6), "right": (0.5, -0.6), "slow": (0.25, 0.0), "fast": (1.2, 0.0)}
"""speed, body lengths/s, and bend, rad per body length"""
WEIGHTS = (1.0, 2.0)
"""of differences in speed and in bend"""


RETURN = 0.9
"""share of the robots that are disturbed which come back to an orbit that attracts"""


@dataclass
class Settings:
    drawn: int = 256
    """gaits at random"""
    batch: int = 64
    """gaits in a round"""
    rounds: int = 12
    robots: int = 4
    """that each gait is tried on, which differ as in a search"""
    duration: float = 60.0
    """s"""
    watch: float = 120.0
    """s, for which elites are watched"""
    tries: int = 8
    """elites, and as many mirror images, that are watched for each gait that is asked for, at most"""
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
    rows: list[dict[str, Any]] = []
    for name, asked in tqdm(ASKED.items(), unit="gait"):
        rows.append({"gait": name, **verified(problem, scene, found, asked, settings, name, rows)})
    cells = {part: np.where(np.isfinite(x), x, None).tolist() for part, x in zip(("speed", "bend"), found[1:3])}
    facts = {**measured(), "rollouts": found.rollouts, "filled": list(found.filled), "cells": list(config.cells)}
    save_json(settings.out / "repertoire.json", {**facts, **cells, "rows": rows})
    plot.save(figure(found, config, rows), settings.out / "repertoire.png")
    print(f"{found.filled[-1]} of {np.prod(config.cells)} cells; wrote {settings.out}/")


def verified(
    problem: SearchProblem,
    scene: Scene,
    found: Repertoire,
    asked: tuple[float, float],
    settings: Settings,
    name: str,
    others: list[dict[str, Any]],
) -> dict[str, Any]:
    """Of the elites that were watched: the orbit, in body lengths, that attracts and comes nearest to what was asked.

    One attracts if its multipliers are below 1 and `RETURN` of the robots that are disturbed come back. Its gait, which
    is none of the others', goes to a file. Where none attracts, the first elite that was watched.
    """
    tried = [
        (gait, about | watched(with_gait(scene, gait), settings))
        for gait, about in candidates(problem, scene, found, asked, settings.tries)
    ]
    held = [
        (gait, row)
        for gait, row in tried
        if row["settled"]
        and (row["multiplier"] or 1.0) < 1
        and row["returned"] >= RETURN
        and not any(row["cell"] == other["cell"] and row["mirrored"] == other["mirrored"] for other in others)
    ]
    count = {"watched": len(tried), "attracting": len(held)}
    if not held:
        return tried[0][1] | count
    off = lambda row: WEIGHTS[0] * abs(row["speed"] - asked[0]) + WEIGHTS[1] * abs(row["bend"] - asked[1])  # noqa: E731
    gait, row = min(held, key=lambda each: off(each[1]))
    save_json(settings.out / "gaits" / f"{name}.json", gait_facts(gait))
    return row | count


def candidates(
    problem: SearchProblem, scene: Scene, found: Repertoire, asked: tuple[float, float], tries: int
) -> list[tuple[Gait, dict[str, Any]]]:
    """The nearest elites, and the mirror images of those that come nearest with the other hand."""
    speed, bend = asked
    mirror = next(one for one in symmetries(scene.structure) if np.linalg.det(one.matrix) < 0)
    gaits = []
    for hand in (1, -1):
        for genes in found.nearest(speed, hand * bend, tries, WEIGHTS):
            gait = jax.tree.map(np.asarray, one_gait(problem.genome.gaits(scene.gait, genes[None]), 0))
            cell = tuple(np.argwhere((found.genes == genes).all(-1))[0])
            about = {"elite_speed": float(found.speed[cell]), "elite_bend": hand * float(found.bend[cell])}
            about |= {"mirrored": hand < 0, "cell": [int(k) for k in cell]}
            gaits.append((gait if hand > 0 else image(gait, mirror), about))
    return gaits


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

"""A repertoire of gaits: speeds and turnings by MAP-Elites, and the orbits of some of its elites.

Gaits are waves about one axis of the robot, which lets it turn. A straight, a left, a right, a slow and a fast gait are
asked for: the nearest elites, and mirror images of those that are nearest with the other hand, are rolled out until
they settle, and disturbed. The orbit that attracts and comes nearest to what was asked is told; no cell of the
repertoire is told twice, but as its own mirror image.
"""

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table
from tqdm import tqdm

from jaxgrity import (
    Gait,
    Scene,
    SearchConfig,
    SearchProblem,
    SolverOptions,
    load_scene,
    one_gait,
    with_gait,
)
from jaxgrity.model import body_length, image, symmetries
from jaxgrity.orbits import find_orbit, stability
from jaxgrity.report import plot
from jaxgrity.search import EvaluationConfig, Repertoire, RepertoireConfig, SearchSpace, search_problem
from jaxgrity.search import repertoire as fill_cells

ASKED = {"straight": (0.6, 0.0), "left": (0.5, 0.6), "right": (0.5, -0.6), "slow": (0.25, 0.0), "fast": (1.2, 0.0)}
"""speed, body lengths/s, and bend, rad per body length"""
WEIGHTS = (1.0, 2.0)
"""of differences in speed and in bend"""
RETURN = 0.9
"""share of the robots that are disturbed which come back to an orbit that attracts"""
ROBOTS = 4
"""Robots that each gait is tried on, which differ as in a search."""
WATCH = 120.0
"""Time for which elites are watched at least, s."""


@measurement(
    page="gait_records.md",
    quick={"drawn": 48, "batch": 16, "rounds": 1, "duration": 10.0, "tries": 1},
    drawn=("elites", "ranges"),
)
def repertoire(
    drawn: int = 256,
    batch: int = 64,
    rounds: int = 12,
    duration: float = 60.0,
    tries: int = 8,
    seed: int = 0,
) -> Iterator[Record]:
    """A row for each gait that is asked for.

    Args:
        drawn: gaits at random
        batch: gaits in a round
        rounds: of the search
        duration: s
        tries: elites, and as many mirror images, that are watched for each gait that is asked for, at most
        seed: of all draws
    """
    scene = load_scene("exact")
    space, evaluation = SearchSpace(waves="axis"), EvaluationConfig(robots=ROBOTS)
    problem = search_problem(scene, SearchConfig(duration, space=space, evaluation=evaluation))
    config = RepertoireConfig(drawn=drawn, batch=batch, rounds=rounds)
    with tqdm(total=rounds + 1, unit="round") as bar:
        options = SolverOptions(dt=0.01, dtype="float32")
        found = fill_cells(problem, config, seed=seed, options=options, on_round=lambda _: bar.update())
    rows: list[Record] = []
    for name, asked in ASKED.items():
        rows.append({"gait": name} | verified(problem, found, asked, tries, rows))
        yield rows[-1]
    elites = {name: getattr(found, name).tolist() for name in ("speed", "bend", "quality")}
    return {
        "filled": found.filled[-1],
        "cells": int(np.prod(config.cells)),
        "rollouts": found.rollouts,
        "elites": elites,
        "ranges": {"bend": config.bend, "speed": config.speed},
    }


@repertoire.table
def words(record: Record) -> str:
    """What was asked for, and the orbits that were found; how many cells were filled."""
    rows = [
        [
            row["gait"] + (", a mirror image" if row["mirrored"] else ""),
            f"{row['attracting']} of {row['watched']}",
            f"{row['elite_speed']:.2f}, {row['elite_bend']:+.2f}",
            *([f"{row['speed']:.3f}", f"{row['bend']:+.3f}"] if row["settled"] else ["no orbit", "-"]),
            "-" if row["multiplier"] is None else f"{row['multiplier']:.2g} ({row['periods']})",
            "-" if row["returned"] is None else f"{row['returned']:.0%}",
        ]
        for row in record["rows"]
    ]
    head = ["asked for", "elites that attract", "elite: speed, bend", "orbit: speed", "orbit: bend"]
    head += ["Floquet multiplier (periods per cycle)", "robots that return"]
    about = [f"{record['filled']} of {record['cells']}", str(record["rollouts"])]
    return f"{table(head, rows)}\n\n{table(['cells with a gait', 'rollouts'], [about])}"


def verified(
    problem: SearchProblem,
    found: Repertoire,
    asked: tuple[float, float],
    tries: int,
    others: list[Record],
) -> Record:
    """Of the elites that were watched: the orbit, in body lengths, that attracts and comes nearest to what was asked.

    One attracts if its multipliers are below 1 and `RETURN` of the robots that are disturbed come back. None of
    the others is told again. Where none attracts, the first elite that was watched.
    """
    tried = [
        about | watched(with_gait(problem.scene, gait)) for gait, about in candidates(problem, found, asked, tries)
    ]
    attracting = [
        row for row in tried if row["settled"] and (row["multiplier"] or 1.0) < 1 and row["returned"] >= RETURN
    ]
    count = {"watched": len(tried), "attracting": len(attracting)}
    told = [(other["cell"], other["mirrored"]) for other in others]
    held = [row for row in attracting if (row["cell"], row["mirrored"]) not in told]
    if not held:
        return tried[0] | count
    off = lambda row: WEIGHTS[0] * abs(row["speed"] - asked[0]) + WEIGHTS[1] * abs(row["bend"] - asked[1])  # noqa: E731
    return min(held, key=off) | count


def candidates(
    problem: SearchProblem, found: Repertoire, asked: tuple[float, float], tries: int
) -> list[tuple[Gait, dict[str, Any]]]:
    """The nearest elites, and the mirror images of those that come nearest with the other hand."""
    (speed, bend), scene = asked, problem.scene
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


def watched(scene: Scene) -> dict[str, Any]:
    """What the robot settles on, and what becomes of disturbances."""
    size, least = float(body_length(scene)), 55 / float(scene.gait.frequency[0])
    orbit = find_orbit(scene, max(least, WATCH))
    held = stability(scene, orbit, robots=64) if orbit.settled else None
    return {
        "settled": orbit.settled,
        "speed": orbit.speed / size,
        "bend": orbit.turning / max(orbit.speed / size, 1e-9),
        "periods": orbit.periods,
        "multiplier": held.largest if held is not None and np.isfinite(held.largest) else None,
        "returned": held.returned if held is not None else None,
    }


@repertoire.figure(5)
def figure(record: Record, chart: Figure) -> None:
    """The elites' spread in every cell, where they are, and the orbits of some."""
    ranges, elites = record["ranges"], {name: np.array(values, float) for name, values in record["elites"].items()}
    axes = chart.subplots()
    extent = (*ranges["bend"], *ranges["speed"])
    shown = axes.imshow(-elites["quality"], extent=extent, origin="lower", aspect="auto", cmap="Blues", alpha=0.8)
    chart.colorbar(shown, label="spread over robots: of speed plus of bend")
    full = np.isfinite(elites["speed"])
    axes.plot(elites["bend"][full], elites["speed"][full], "k.", markersize=3, label="elite of a cell")
    for k, row in enumerate(row for row in record["rows"] if row["settled"]):
        look = {"color": f"C{k + 1}", "marker": plot.MARKERS[k], "markersize": 9, "markeredgecolor": "black"}
        axes.plot(row["bend"], row["speed"], linestyle="", label=f"orbit: {row['gait']}", **look)
    axes.set(xlabel="bend (rad per body length, to the left)", ylabel="speed (body lengths/s)")
    axes.set(xlim=ranges["bend"], ylim=ranges["speed"])
    chart.legend(loc="outside lower center", ncols=3)

"""Speed against power: a Pareto front of gaits that roll, for the robot of the scene `exact` and for a softer one.

Each front is that of one population (`pareto_front`), by rough rollouts. Some gaits from along it are then judged on
the scene's own model: by robots that differ on both contact models, and by the power of each actuator.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns

from jaxgrity import GAConfig, SearchConfig, SearchProblem, contact_twin, load_scene, simulate_population
from jaxgrity.report import plot
from jaxgrity.search import (
    SearchSpace,
    fidelity_levels,
    judge_at,
    pareto_front,
    search_problem,
    with_robots,
    without_force_bounds,
)

LEAST_SPEED = 0.1
"""Least fitness of a front, body lengths/s: slower gaits hardly travel."""
ROBOTS = {"standard": "exact", "softer": "softer"}
"""Scenes of the robots, by their names here. The softer one is described in its file."""
OVERTONES = 2
"""Overtones of each wave."""


@measurement(
    page="gait_records.md",
    drawn=("fronts",),
    quick={"population": 12, "generations": 2, "duration": 4.0, "chosen": 2, "robots": 4},
)
def trade_off(
    population: int = 128,
    generations: int = 32,
    duration: float = SearchConfig().duration,
    chosen: int = 6,
    robots: int = 64,
    seed: int = 0,
) -> Iterator[Record]:
    """A row for each gait that is judged.

    Args:
        population: gaits per generation; the first has four times as many
        generations: of each front
        duration: s, of a rollout
        chosen: gaits of each front that are judged
        robots: that differ, by which they are judged
        seed: of the searches
    """
    fronts = {}
    for name, scene in ROBOTS.items():
        problem = search_problem(
            load_scene(scene), SearchConfig(duration, population, space=SearchSpace(overtones=OVERTONES))
        )
        best = max(1, population // 4)
        ga = GAConfig(
            population,
            generations,
            best,
            mutation_rate=1.0,
            mutation_size=(0.1, 0.01),
            parents=2 * best,
            drawn=4 * population,
        )
        found = pareto_front(
            problem, ga, least=LEAST_SPEED, seed=seed, options=fidelity_levels(problem.scene).screening.options
        )
        fronts[name] = {"power": found.need.tolist(), "fitness": found.fitness.tolist()}
        count = len(found.need)
        along = np.unique(np.linspace(0, count - 1, min(chosen, count)).round().astype(int))
        for row in judged(problem, found.genes[along], robots):
            yield {"robot": name} | row
    return {"fronts": fronts, "robots": robots}


def judged(problem: SearchProblem, genes: np.ndarray, robots: int) -> list[dict[str, Any]]:
    """Of each gait: steady speeds on both contact models, and the largest power at the start and once settled."""
    if not len(genes):
        return []
    gaits = problem.genome.gaits(problem.scene.gait, genes)
    here = problem._replace(fitness=with_robots(without_force_bounds(problem.fitness), robots))
    own, other = (
        judge_at(fidelity_levels(scene).own, gaits, here, seed=0)
        for scene in (problem.scene, contact_twin(problem.scene))
    )
    settled_by = problem.duration / 4
    powers = {
        name: np.asarray(
            simulate_population(problem.scene, gaits, problem.duration, with_metrics=since).metrics.peak_power
        ).max(-1)
        for name, since in (("power", True), ("settled_power", settled_by))
    }
    return [
        {
            "own": float(own.mean[k]),
            "own_deviation": float(own.spread[k]),
            "other": float(other.mean[k]),
            "other_deviation": float(other.spread[k]),
            **{name: float(found[k]) for name, found in powers.items()},
            "frequency": float(np.max(np.asarray(gaits.frequency)[k])),
        }
        for k in range(len(genes))
    ]


@trade_off.table
def words(record: Record) -> str:
    """Speed and power of gaits from along both fronts."""
    cells = {
        "robot": "{robot}",
        "peak power, W": "{power:.0f}",
        "once settled, W": "{settled_power:.0f}",
        "speed of perturbed robots, body lengths/s": "{own:.2f} ({own_deviation:.2f})",
        "on penalty contact": "{other:.2f} ({other_deviation:.2f})",
        "frequency, Hz": "{frequency:.2f}",
    }
    return columns(record["rows"], cells)


@trade_off.figure(4)
def figure(record: Record, chart: Figure) -> None:
    """Each robot's front, and the gaits that were judged."""
    panes = chart.subplots(1, len(record["fronts"]), sharey=True, squeeze=False)[0]
    for axes, (name, front) in zip(panes, reversed(record["fronts"].items())):
        axes.plot(front["power"], front["fitness"], "-", color="C0", alpha=0.5, label="front, rough model")
        rows = [row for row in record["rows"] if row["robot"] == name]
        for k, (contact, each) in enumerate((("exact", "own"), ("penalty", "other"))):
            speeds, spread = [row[each] for row in rows], [row[f"{each}_deviation"] for row in rows]
            look = {"color": f"C{k}", "marker": plot.MARKERS[k], "markersize": 5, "linestyle": "", "capsize": 3}
            label = f"{record['robots']} perturbed robots, {contact} contact"
            axes.errorbar([row["power"] for row in rows], speeds, spread, label=label, **look)
        axes.set(title=f"{name} robot", xlabel="largest power of any motor (W)", ylim=(0, None))
    panes[0].set_ylabel("speed (body lengths/s)")
    chart.legend(*panes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)

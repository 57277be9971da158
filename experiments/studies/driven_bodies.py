"""What rigid bodies cost beside struts, and a hinged column that gaits drive, as ratios that one run measures."""

import dataclasses
from collections.abc import Iterator
from functools import partial

import numpy as np
from measurements.measurement import Record, measurement
from measurements.pages import columns
from measurements.scaling_costs import process
from studies.body_costs import DT, processor_time, scene_of

from jaxgrity import (
    Gait,
    Scene,
    SolverOptions,
    Structure,
    gaits_of,
    load_scene,
    random_phases,
    simulate,
    simulate_population,
    with_gait,
)
from jaxgrity.model import rigid_body

AMPLITUDE, FREQUENCY = 0.1, 1.0
"""Largest contraction of the cables, and Hz, of the gaits that drive a column."""
OPTIONS = SolverOptions(dt=DT, any_step=True)


@measurement(page="scaling.md", quick={"steps": 50, "gaits": 2, "repeats": 1})
def driven_bodies(steps: int = 500, gaits: int = 8, repeats: int = 3) -> Iterator[Record]:
    """A row for six rods as bodies and as struts, and one for a column with hinges; all on one core.

    Args:
        steps: number of steps that are timed
        gaits: of the column, with random phases
        repeats: number of timed calls, of which the median counts, after one that compiles
    """
    with process(1) as pool:
        yield pool.apply(cost_of_bars, (steps, repeats))
        yield pool.apply(cost_of_driven, (steps, gaits, repeats))


def cost_of_bars(steps: int, repeats: int) -> Record:
    """Processor time of a step, s, of six thin rods as struts and as bodies of two points, moved by the same gait.

    Beside them six struts whose mass is at their ends, which sweeps solve.
    """
    scenes = {"ends": bars("ends"), "struts": bars("struts"), "bodies": bars("bodies")}
    runs = {name: partial(simulate, scene, steps * DT, options=OPTIONS) for name, scene in scenes.items()}
    places = [np.asarray(runs[name]().positions[-1]) for name in ("struts", "bodies")]
    # in turns, since other work on the machine changes
    times = [[processor_time(run, 1) / steps for run in runs.values()] for _ in range(repeats)]
    found = dict(zip(runs, np.median(times, axis=0).tolist()))
    return {"kind": "bars", **found, "apart": float(np.abs(places[0] - places[1]).max())}


def bars(mass: str) -> Scene:
    """The scene `exact`, whose cables move, with the mass of its nodes there ("ends"), in its struts, or in bodies."""
    scene = load_scene("exact")
    structure, x = scene.structure, np.asarray(scene.structure.nodes, float)
    struts, cables = structure.struts, structure.cables
    assert struts is not None, "it has six"
    none, each = np.zeros(len(x)), [float(structure.node_mass[[i, j]].sum()) for i, j in struts.edges]
    if mass == "struts":
        structure = Structure(x, none, dataclasses.replace(struts, mass=np.array(each)), cables)
    if mass == "bodies":
        ends = [(x[j] - x[i], m) for (i, j), m in zip(struts.edges, each)]
        moments = [m / 12 * (along @ along * np.eye(3) - np.outer(along, along)) for along, m in ends]
        rods = tuple(rigid_body(x, *rod) for rod in zip(struts.edges, each, moments))
        structure = Structure(x, none, cables=cables, bodies=rods)
    members = tuple(range(structure.first_cable, structure.member_count))
    return with_gait(dataclasses.replace(scene, structure=structure, gait=None), gait_of(members))


def gait_of(members: tuple[int, ...]) -> Gait:
    """All of them in step."""
    each = np.ones(len(members))
    return Gait(members, 0 * each, AMPLITUDE * each, FREQUENCY * each, start=0.0, ramp=0.1)


def cost_of_driven(steps: int, gaits: int, repeats: int) -> Record:
    """Processor time of a step, s, of a column of three vertebrae with hinges: the mean of gaits alone, and side by
    side for each."""
    still = scene_of("hinged", 3)
    members = tuple(range(still.structure.member_count))
    phases, gait = random_phases(gaits, len(members), seed=0), gait_of(members)
    scene = with_gait(still, gait)
    alone = []
    for phase in phases:
        driven = with_gait(still, dataclasses.replace(gait, phase=phase))
        alone.append(processor_time(partial(simulate, driven, steps * DT, options=OPTIONS), repeats) / steps)
    crowd = partial(simulate_population, scene, gaits_of(gait, phases), steps * DT, options=OPTIONS)
    side_by_side = processor_time(crowd, repeats) / gaits / steps
    resting = processor_time(partial(simulate, still, steps * DT, options=OPTIONS), repeats) / steps
    one = {"alone": float(np.mean(alone)), "slowest": float(np.max(alone))}
    return {"kind": "driven", "gaits": gaits, "still": resting, **one, "each": side_by_side}


@driven_bodies.table
def words(record: Record) -> str:
    """Bodies against struts, and driven columns against one that stands."""
    rods, driven = (next(row for row in record["rows"] if row["kind"] == kind) for kind in ("bars", "driven"))
    column, still = "column of 3 vertebrae with hinges", driven["still"]
    rows = [
        ("six thin rods as struts", rods["struts"], 1.0),
        ("the same as bodies of two points", rods["bodies"], rods["bodies"] / rods["struts"]),
        ("the same with the mass at their ends, by sweeps", rods["ends"], rods["ends"] / rods["struts"]),
        (f"{column} that stands", still, 1.0),
        (f"the same, mean of {driven['gaits']} gaits", driven["alone"], driven["alone"] / still),
        ("the same, slowest of these gaits", driven["slowest"], driven["slowest"] / still),
        (f"the same, each of {driven['gaits']} in a population", driven["each"], driven["each"] / still),
    ]
    cells = {
        "robot": lambda row: row["robot"],
        "step, µs": lambda row: f"{1e6 * row['step']:.0f}",
        "times the first": lambda row: f"{row['share']:.2f}",
    }
    return columns([{"robot": name, "step": step, "share": share} for name, step, share in rows], cells)

"""What a step of rigid bodies costs on exact contact: spines of more and more vertebrae, and robots side by side."""

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import numpy as np
from measurements.conformance_statics import DATA
from measurements.measurement import Record, measurement
from measurements.pages import columns
from measurements.scaling_costs import process

from jaxgrity import (
    ConeFriction,
    ExactGround,
    Gait,
    Members,
    Scene,
    SolverOptions,
    Structure,
    edge_lengths,
    gaits_of,
    parse_scene,
    random_phases,
    simulate,
    simulate_population,
    with_gait,
)
from jaxgrity.formats import read_mjcf
from jaxgrity.model import rigid_body
from jaxgrity.structures import tetrahedral_spine

STANDING = """
[structure]
kind = "{kind}"
{more}
[cables]
stiffness = 2000.0
damping = 20.0
[gravity]
[damping]
node = 0.05
[ground]
contact = "complementarity"
[friction]
kind = "cone"
mu = 0.5
"""
SIX_RODS = STANDING.format(kind="superball", more='prestress = 200.0\npose = "face"')
DT, STEPS = 2e-3, 100
"""s, and number of steps that are timed"""
KINDS = {
    "spine": "spine of {bodies} vertebrae that lies on the ground",
    "hinged": "column of {bodies} vertebrae with hinges",
    "caps": "three rods with end caps (`three_rods.xml`)",
}
ROBOTS = {"superball": "six rods with end caps (`superball`)", "hinged": "column of 3 vertebrae with hinges"}


@measurement(page="scaling.md", quick={"vertebrae": (2, 3), "hinged": (), "crowds": (), "repeats": 1})
def body_costs(
    vertebrae: tuple[int, ...] = (6, 12, 20, 48),
    hinged: tuple[int, ...] = (20,),
    crowds: tuple[str, ...] = ("superball",),
    robots: int = 64,
    repeats: int = 5,
) -> Iterator[Record]:
    """A row for each structure, and one for each robot in a population; all on one core.

    Args:
        vertebrae: of spines that lie on the ground
        hinged: of columns with hinges
        crowds: robots in populations, "superball" and "hinged"
        robots: of a population
        repeats: number of timed calls, of which the median counts, after one that compiles
    """
    alone = [*(("spine", n) for n in vertebrae), *(("hinged", n) for n in hinged), ("caps", 3)]
    with process(1) as pool:
        for kind, bodies in alone:
            yield pool.apply(step_cost, (kind, bodies, repeats))
        for kind in crowds:
            cost = partial(pool.apply, crowd_cost)
            one, many = (cost((kind, count, repeats)) for count in (1, robots))
            yield {"kind": kind, "robots": robots, "one": one, "each": many}


def step_cost(kind: str, bodies: int, repeats: int) -> Record:
    """Processor time of a step, s, of one robot in float64."""
    scene = scene_of(kind, bodies)
    options = SolverOptions(dt=DT, any_step=True)
    motion = lambda: simulate(scene, STEPS * DT, options=options, frame_rate=1 / (STEPS * DT))  # noqa: E731
    assert not bool(motion().failed)
    return {
        "kind": kind,
        "bodies": bodies,
        "members": scene.structure.member_count,
        "step": processor_time(motion, repeats) / STEPS,
    }


def crowd_cost(kind: str, count: int, repeats: int) -> float:
    """Processor time of a step for each of so many robots with random gaits, s, in float64."""
    scene = scene_of(kind, 3)
    members = tuple(range(scene.structure.member_count))
    each = np.ones(len(members))
    scene = with_gait(scene, Gait(members, 0 * each, amplitude=0.1 * each, frequency=each, start=0.0, ramp=0.1))
    rows = gaits_of(scene.gait, random_phases(count, len(members), seed=0))
    options = SolverOptions(dt=DT, any_step=True)
    seconds = processor_time(lambda: simulate_population(scene, rows, STEPS * DT, options=options), repeats)
    return seconds / count / STEPS


def processor_time(function: Callable[[], Any], repeats: int) -> float:
    """Median processor time of a call, s, after one that compiles. Other work on the machine changes it less than time
    on the clock."""
    seconds: list[float] = []
    for _ in range(repeats + 1):
        start = time.process_time()
        jax.block_until_ready(function())
        seconds.append(time.process_time() - start)
    return float(np.median(seconds[1:]))


def scene_of(kind: str, bodies: int) -> Scene:
    """A robot of so many bodies on exact contact, without a gait."""
    if kind == "caps":
        return read_mjcf(DATA / "mjcf" / "three_rods.xml").scene
    if kind == "superball":
        return parse_scene(SIX_RODS)
    if kind == "hinged":
        return parse_scene(STANDING.format(kind="hinged_spine", more=f"vertebrae = {bodies}\nprestress = 30.0"))
    return lying(bodies)


def lying(vertebrae: int, mass: float = 0.3, width: float = 0.3) -> Scene:
    """A spine along x, all of whose nodes may touch the ground; vertebrae weigh `mass` kg and are `width` m long."""
    upright, _, edges = tetrahedral_spine(vertebrae, width, width)
    nodes = upright[:, ::-1] - np.array([0.0, 0.0, upright[:, 0].min()])
    inertia = mass * width**2 / 12 * np.eye(3)
    bodies = tuple(rigid_body(nodes, range(4 * k, 4 * k + 4), mass, inertia) for k in range(vertebrae))
    each = np.ones(len(edges))
    cables = Members(edges, 2000.0 * each, 0.9 * edge_lengths(nodes, edges), damping=5.0 * each)
    structure = Structure(nodes, np.zeros(len(nodes)), cables=cables, bodies=bodies)
    drag = np.full(len(nodes), 0.05)
    return Scene(structure, 9.81, drag, ExactGround(), ConeFriction(np.array(0.5)))


@body_costs.table
def words(record: Record) -> str:
    """The cost of a step, and by which power of the members it grows."""
    cells = {
        "structure": lambda row: KINDS[row["kind"]].format(**row),
        "cables": "{members}",
        "step, µs": lambda row: f"{1e6 * row['step']:.0f}",
    }
    rows = [row for row in record["rows"] if "step" in row]
    spines = [(row["members"], row["step"]) for row in rows if row["kind"] == "spine"]
    exponents = [np.polyfit(*np.log(some).T, 1)[0] for some in (spines, spines[-2:])]
    fitted = "; ".join(f"{each:.2f}" for each in exponents)
    return f"{columns(rows, cells)}\n| exponent of spines by cables: of all; of the last two | | {fitted} |"


@partial(body_costs.table, part="crowds")
def words_of_crowds(record: Record) -> str:
    """Robots alone, and side by side."""
    cells = {
        "robot": lambda row: ROBOTS[row["kind"]],
        "step of one robot alone, µs": lambda row: f"{1e6 * row['one']:.0f}",
        "robots": "{robots}",
        "step of each, µs": lambda row: f"{1e6 * row['each']:.0f}",
    }
    return columns([row for row in record["rows"] if "each" in row], cells)

"""Random robots, written for MuJoCo, read back, and moved by both programs: in the air, and driven on the ground."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from measurements.measurement import Record, measurement
from measurements.pages import columns

from jaxgrity import Gait, Members, PenaltyGround, Scene, SolverOptions, Structure, edge_lengths, simulate
from jaxgrity.formats import read_mjcf, save_mjcf
from jaxgrity.structures import random_tensegrity

STIFF = (1e4, 2e4)
"""N/m, of struts that are springs; rods have mass, and are rigid"""
NAMES = {"springs": "springs", "rods": "rigid rods"}
CABLES = (200.0, 1000.0)
"""N/m"""
STRETCHED = (0.75, 0.95)
"""rest lengths of cables, as shares of their lengths in the start"""
GROUND = 1e4
"""N/m"""
DRAG = 5.0
"""N s/m, at nodes: without friction and dissipation robots would bounce for long"""
FLIGHT, DRIVEN = 0.5, 2.0
"""s"""
STEP = 1e-4
"""s, of both programs; their errors follow from twice this step"""
FINER = 4
"""Steps here for one of MuJoCo's while rods fly: stepping rigid rods is of second order, and RK4 of fourth."""


@measurement(page="conformance.md", quick={"robots": 1, "struts": (3,)})
def random_in_mujoco(robots: int = 5, struts: tuple[int, ...] = (3, 5)) -> Iterator[Record]:
    """A row for each robot.

    Args:
        robots: of each kind and size
        struts: sizes
    """
    for kind in NAMES:
        for count in struts:
            for seed in range(robots):
                yield {"struts": kind, "number": count, "seed": seed} | compared(kind, count, seed)


def compared(kind: str, count: int, seed: int) -> Record:
    """Largest differences of a coordinate, m: in the air, and driven on the ground beside the errors of both steps."""
    from measurements.mujoco_peer import run_once, with_spring_contact, without_contact

    given = robot(kind, count, seed)
    with TemporaryDirectory() as folder:
        save_mjcf(given, Path(folder) / "robot.xml")
        read = read_mjcf(Path(folder) / "robot.xml").scene
    air = dataclasses.replace(read, ground=None, friction=None)
    method = "rk4" if kind == "springs" else None
    flown = ended(air, FLIGHT, method, STEP if method else STEP / FINER)
    still = dataclasses.replace(given, gait=None)
    found = {"flight": apart(flown, run_once(still, FLIGHT, STEP, without_contact)[0])}
    driven = dataclasses.replace(read, ground=given.ground, friction=None, gait=given.gait)
    ours = [ended(driven, DRIVEN, method, dt) for dt in (2 * STEP, STEP)]
    theirs = [run_once(given, DRIVEN, dt, with_spring_contact(GROUND))[0] for dt in (2 * STEP, STEP)]
    return found | {"ours": apart(*ours), "theirs": apart(*theirs), "driven": apart(ours[1], theirs[1])}


def robot(kind: str, count: int, seed: int) -> Scene:
    """A random robot that stands or falls over on penalty ground, with a gait that moves three cables."""
    shape, random = random_tensegrity(count, seed), np.random.default_rng(seed)
    draw = lambda edges, K, L: Members(  # noqa: E731
        edges, random.uniform(*K, len(edges)), edge_lengths(shape.nodes, edges) * random.uniform(*L, len(edges))
    )
    struts, cables = draw(shape.struts, STIFF, (1.0, 1.0)), draw(shape.cables, CABLES, STRETCHED)
    if kind == "rods":
        struts = Members(shape.struts, None, struts.rest_length, mass=np.full(count, 0.5))
    nodes = shape.nodes - [0, 0, shape.nodes[:, 2].min()]
    structure = Structure(nodes, random.uniform(0.1, 0.5, len(nodes)), struts, cables)
    moved = tuple(count + k for k in range(3))
    gait = Gait(moved, np.arange(3.0), amplitude=np.full(3, 0.15), frequency=np.ones(3), start=0.0, ramp=1.0)
    return Scene(
        structure, gravity=9.81, node_damping=np.full(len(nodes), DRAG), ground=PenaltyGround(GROUND), gait=gait
    )


def ended(scene: Scene, duration: float, method: str | None, dt: float) -> np.ndarray:
    """Where the nodes end, m."""
    options = SolverOptions(dt=dt) if method is None else SolverOptions(method=method, dt=dt)
    return np.asarray(simulate(scene, duration, options=options, frame_rate=1 / duration).positions[-1])


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Largest difference of a coordinate, m."""
    return float(np.abs(one - other).max())


@random_in_mujoco.table
def words(record: Record) -> str:
    """The largest of the differences and errors of robots of a kind."""
    kinds: dict[tuple[str, int], list[Record]] = {}
    for row in record["rows"]:
        kinds.setdefault((row["struts"], row["number"]), []).append(row)
    cells = {
        "struts": lambda rows: f"{rows[0]['number']} {NAMES[rows[0]['struts']]}",
        "robots": lambda rows: str(len(rows)),
        "difference in the air, mm": largest("flight"),
        "driven: our error, mm": largest("ours"),
        "MuJoCo's error, mm": largest("theirs"),
        "difference, mm": largest("driven"),
        "difference, largest share of both errors": lambda rows: f"{max(map(share, rows)):.2f}",
    }
    return columns(list(kinds.values()), cells)


def largest(name: str) -> Callable[[list[Record]], str]:
    """What says the largest value of rows, m, in mm."""
    return lambda rows: f"{float(f'{1e3 * max(row[name] for row in rows):.2g}'):g}"


def share(row: Record) -> float:
    """The difference of a driven robot as a share of the sum of both errors."""
    return row["driven"] / (row["ours"] + row["theirs"])

"""Every published or foreign answer that is known, beside ours: closed forms, other programs, MuJoCo if installed.

Those of statics are in conformance_statics.py, conformance_loads.py and conformance_rib.py. Those of motions follow.
"""

import dataclasses
import importlib.util
import json
from collections.abc import Iterator
from itertools import chain

import numpy as np
from measurements.conformance_loads import load_cases
from measurements.conformance_rib import rib
from measurements.conformance_statics import CLOSED, DATA, RODS, Case, statics_cases
from measurements.measurement import Record, measurement
from measurements.pages import columns
from scipy.special import ellipk

from jaxgrity import (
    ConeFriction,
    ExactGround,
    Members,
    Scene,
    SolverOptions,
    Structure,
    edge_lengths,
    gaits_of,
    load_gait,
    load_scene,
    parse_scene,
    simulate,
    simulate_population,
    with_gait,
)
from jaxgrity.model import penalty_twin


@measurement(page="conformance.md", quick={"few": True})
def conformance(few: bool = False) -> Iterator[Record]:
    """A row for each case.

    Args:
        few: fewer of each kind, at coarser steps
    """
    for case in chain(statics_cases(few), load_cases(), rib(), dynamics_cases(few)):
        yield {**case._asdict(), "difference": case.ours - case.theirs}


ALIKE = ("prism of ", "tower of two prisms, natural frequency")
"""Beginnings of the names of many cases that are much alike, which have a table of their own."""


@conformance.table
def words(record: Record) -> str:
    """Both answers, and their difference, of all cases but those that are much alike."""
    return compared([row for row in record["rows"] if not row["case"].startswith(ALIKE)])


@conformance.table(part="prisms")
def words_of_prisms(record: Record) -> str:
    """The same of prisms and of natural frequencies."""
    return compared([row for row in record["rows"] if row["case"].startswith(ALIKE)])


def compared(rows: list[Record]) -> str:
    """A row for each case."""
    cells = {
        "case": "{case}",
        "source": "{source}",
        "theirs": lambda row: f"{row['theirs']:.6g} {row['unit']}".strip(),
        "ours": lambda row: f"{row['ours']:.6g} {row['unit']}".strip(),
        "ours - theirs": lambda row: "0" if row["difference"] == 0 else f"{row['difference']:.0e}",
    }
    return columns(rows, cells)


G = 9.81
C_PROGRAM = "C program for this scene alone"
FLYING = """
[structure]
kind = "{kind}"
mass = 2.0
prestress = {prestress}
{pose}
[struts]
{struts}
[cables]
stiffness = 2e3
[gravity]
[damping]
node = {drag}
"""
RESTING = """
[ground]
contact = "complementarity"
[friction]
kind = "cone"
mu = {mu}
"""
SPRINGS, RODS_WITH_MASS = "stiffness = 2e4\ndamping = 20", "rigid = true\nmass = 0.4"
KINDS = ("icosahedron", "prism", "tower", "ball", "tetrahedral_spine", "planar_spine")
RESTING_KINDS = ("icosahedron", "prism", "ball")


def dynamics_cases(quick: bool) -> Iterator[Case]:
    """All of them; those of MuJoCo where it is installed."""
    peer = mujoco_cases(quick) if importlib.util.find_spec("mujoco") else iter(())
    return chain(pendulums(quick), slide(), c_programs(quick), peer)


def hanging(*theta: float) -> Structure:
    """Rods of 1 m and 1 kg in a chain from a support, at angles from the vertical, rad."""
    steps = [[np.sin(a), 0, -np.cos(a)] for a in theta]
    nodes = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    edges = tuple((k, k + 1) for k in range(len(theta)))
    rods = Members(edges, None, edge_lengths(nodes, edges), mass=np.ones(len(edges)))
    return Structure(nodes, np.zeros(len(nodes)), rods, fixed=((0, "xyz"),))


def angles(positions) -> np.ndarray:
    """(frames, rods), rad."""
    d = np.diff(np.asarray(positions), axis=1)
    return np.arctan2(d[..., 0], -d[..., 2])


def pendulums(quick: bool) -> Iterator[Case]:
    """A rod about its end after a period, and MOTES' double pendulum at its last time."""
    for amplitude in (0.1, 2.5):
        period = 4 * np.sqrt(2 / (3 * G)) * ellipk(np.sin(amplitude / 2) ** 2)
        options = SolverOptions(dt=period / 4000)
        motion = simulate(Scene(hanging(amplitude), G), period, frame_rate=1 / period, options=options)
        after = float(angles(motion.positions)[-1, 0])
        yield Case(f"rod about its end, {amplitude:g} rad, after a period", CLOSED, amplitude, after, "rad")
    rows = np.array(RODS["double_pendulum"]["rows"])
    options = SolverOptions(dt=1e-3 if quick else 2.5e-4)
    motion = simulate(Scene(hanging(*rows[0, 1:3]), 9.8), 5.0, frame_rate=2.0, options=options)
    found = angles(motion.positions)
    for time in (5, 10):
        for rod in (0, 1):
            name = f"double pendulum of rods, angle {rod + 1} after {rows[time, 0]:g} s"
            yield Case(name, "MOTES (MPL-2.0)", rows[time, 1 + rod], float(found[time, rod]), "rad")


def slide() -> Iterator[Case]:
    """A point slides down a slope: x = (g sin theta - mu g cos theta) t^2/2 along it."""
    incline, mu, duration = 0.5, 0.3, 1.0
    point = Structure(np.zeros((1, 3)), np.ones(1))
    scene = Scene(point, G, ground=ExactGround(incline), friction=ConeFriction(mu))
    motion = simulate(scene, duration, frame_rate=1.0, options=SolverOptions(dt=1e-3))
    theirs = (np.sin(incline) - mu * np.cos(incline)) * G * duration**2 / 2
    ours = np.linalg.norm(np.asarray(motion.positions)[-1, 0])
    yield Case("slope of 0.5 rad, mu = 0.3, displacement of a point after 1 s", CLOSED, theirs, float(ours), "m")


def c_programs(quick: bool) -> Iterator[Case]:
    """Final centres of mass of random gaits, as programs in C have them that were written for nothing else."""
    for name, step in (("reference", 5e-4), ("exact", 1e-3 if quick else 1e-4)):
        answers = json.loads((DATA / f"{name}_answers.json").read_text(encoding="utf-8"))
        scene, gaits = load_scene(name), answers["gaits"]
        phases = np.array([gait["phase"] for gait in gaits])
        found = simulate_population(
            scene, gaits_of(scene.gait, phases), answers["duration"], options=SolverOptions(dt=step)
        )
        theirs, ours = np.array([gait["com_end"] for gait in gaits]), np.asarray(found.com_end)
        k, axis = np.unravel_index(np.abs(theirs - ours).argmax(), theirs.shape)
        what = f"scene {name}, {len(gaits)} gaits after 2 s: the coordinate of a centre of mass that differs most"
        yield Case(what, C_PROGRAM, float(theirs[k, axis]), float(ours[k, axis]), "m")


def mujoco_cases(quick: bool) -> Iterator[Case]:
    """Free flight, standing and rolling in MuJoCo."""
    for kind in KINDS[:2] if quick else KINDS:
        for struts, dt, what in ((SPRINGS, 1e-4, "spring struts"), (RODS_WITH_MASS, 5e-5, "rods with mass")):
            theirs, ours, _ = by_both(flying(kind, struts), 0.5, 1e-4, SolverOptions(dt=dt))
            k, axis = np.unravel_index(np.abs(theirs - ours).argmax(), theirs.shape)
            name = f"{kind} with {what}, free flight of 0.5 s: the coordinate of a node that differs most"
            yield Case(name, "MuJoCo, RK4 at 1e-4 s", float(theirs[k, axis]), float(ours[k, axis]), "m")
    if quick:
        return
    for kind in RESTING_KINDS:
        theirs, ours, depth = by_both(resting(kind), 3.0, 5e-4)
        name = f"{kind} at rest, mean height of its nodes (MuJoCo's lets them {1e3 * depth:.2g} mm into the ground)"
        yield Case(name, "MuJoCo", float(theirs[:, 2].mean()), float(ours[:, 2].mean()), "m")
    scene, duration = penalty_twin(with_gait(load_scene("exact"), load_gait("lasting"))), 20.0
    speeds = [mean_speed(scene, end, duration) for end in by_both(scene, duration, 5e-4)[:2]]
    yield Case("the gait `lasting`, speed over 20 s (contact differs)", "MuJoCo", *speeds, "m/s")


def flying(kind: str, struts: str) -> Scene:
    """A structure of the catalogue, in the air, with rest lengths that are up to 1 % shorter, so that it moves."""
    scene = parse_scene(FLYING.format(kind=kind, struts=struts, drag=0.2, prestress=50.0, pose=""))
    rest = scene.structure.cables.rest_length
    spoilt = rest * (1 - 0.01 * np.random.default_rng(0).random(len(rest)))
    cables = dataclasses.replace(scene.structure.cables, rest_length=spoilt)
    return dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, cables=cables))


def resting(kind: str, mu: float = 0.5) -> Scene:
    """A structure of rods with mass just above the ground, on which it comes to rest."""
    pose = "height = 0.01" + ("" if kind == "prism" else '\npose = "face"')
    text = FLYING.format(kind=kind, struts=RODS_WITH_MASS, drag=2.0, prestress=200.0, pose=pose)
    return parse_scene(text + RESTING.format(mu=mu))


def by_both(
    scene: Scene, duration: float, their_dt: float, options: SolverOptions | None = None
) -> tuple[np.ndarray, np.ndarray, float]:
    """Where the nodes end by MuJoCo and here, (nodes, 3), m, and how deep in its ground MuJoCo's deepest is."""
    from measurements.mujoco_peer import run_once

    theirs, depth = run_once(scene, duration, their_dt)
    ours = simulate(scene, duration, frame_rate=1 / duration, options=options)
    return theirs, np.asarray(ours.positions[-1]), depth


def mean_speed(scene: Scene, end: np.ndarray, duration: float) -> float:
    """m/s, of the middle of the nodes along the ground, from how the scene is built to where they end."""
    return float(np.hypot(*(end - scene.structure.nodes).mean(0)[:2])) / duration

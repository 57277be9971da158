"""Milliseconds a step of structures whose struts share nodes: by the library's dense systems, and by LAPACK's threads.

Each is measured on an idle machine and beside a busy process on each core, with as many BLAS threads as there are
cores, as a user's program has them.
"""

import contextlib
import multiprocessing
import os
import time
from collections.abc import Iterator
from itertools import product
from unittest import mock

from jaxgrity.cli.script import cores

import jax.numpy as jnp
import numpy as np
from measurements.measurement import Record, measurement
from measurements.pages import table
from studies.random_structures import random_scene

from jaxgrity import ConeFriction, ExactGround, Members, Scene, SolverOptions, Structure, edge_lengths, simulate
from jaxgrity.structures import tetrahedral_spine

STEP = 2e-3
"""s"""
VERTEBRAE, STRUTS = 12, 26
SOLVERS = {
    "in blocks": {},
    "by LAPACK": {
        "jaxgrity.stepping.coupled_contacts.solution": jnp.linalg.solve,
        "jaxgrity.stepping.coupled_problem.inverse_of": jnp.linalg.inv,
        "jaxgrity.model.inertia.inverse_of": jnp.linalg.inv,
    },
}
"""what takes the place of what"""


@measurement(page="performance.md", quick={"scenes": ("spine",), "steps": 10})
def threads(scenes: tuple[str, ...] = ("spine", "random"), steps: int = 100) -> Iterator[Record]:
    """A row for each structure and solver, on an idle and on a busy machine.

    Args:
        scenes: a spine, and the first random structure of its size
        steps: of each rollout, the fastest of three of which counts
    """
    os.environ["OPENBLAS_NUM_THREADS"] = str(cores())
    for scene, solver, busy in product(scenes, SOLVERS, (False, True)):
        with contextlib.ExitStack() as running:
            for _ in range(cores() if busy else 0):
                other = multiprocessing.get_context("spawn").Process(target=spin, daemon=True)
                other.start()
                running.callback(other.kill)
            pool = running.enter_context(multiprocessing.get_context("spawn").Pool(1))
            found = pool.apply(milliseconds, (scene, solver, steps))
        yield {"scene": scene, "solver": solver, "busy": busy, **found}


def spin() -> None:
    """Keep a core busy, as another program does."""
    while True:
        pass


def milliseconds(name: str, solver: str, steps: int) -> dict:
    """A step of a structure, compiled before."""
    scene = spine() if name == "spine" else scattered()
    with contextlib.ExitStack() as changed:
        for place, other in SOLVERS[solver].items():
            changed.enter_context(mock.patch(place, other))
        options, seconds = SolverOptions(dt=STEP, any_step=True), []
        for _ in range(4):
            start = time.perf_counter()
            motion = simulate(scene, steps * STEP, options=options, frame_rate=1 / (steps * STEP))
            np.asarray(motion.positions)
            seconds.append(time.perf_counter() - start)
    return {"milliseconds": 1e3 * min(seconds[1:]) / steps, "struts": len(scene.structure.struts.edges)}


def spine() -> Scene:
    """Tetrahedra with rigid struts that stands on the ground, its cables shortened."""
    nodes, struts, cables = tetrahedral_spine(VERTEBRAE)
    lengths = edge_lengths(nodes, cables)
    held = Members(cables, np.full(len(cables), 500.0), 0.9 * lengths, damping=np.full(len(cables), 2.0))
    structure = Structure(nodes, np.full(len(nodes), 0.1), Members(struts, None, edge_lengths(nodes, struts)), held)
    return Scene(structure, 9.81, np.full(len(nodes), 0.05), ExactGround(), ConeFriction(0.5))


def scattered() -> Scene:
    """The first of the random structures with so many struts."""
    return next(s for s in map(random_scene, range(1000)) if len(s.structure.struts.edges) == STRUTS)


@threads.table
def words(record: Record) -> str:
    """What a step costs beside other work."""
    said = {"spine": "spine of tetrahedra", "random": "random structure"}
    rows = []
    for scene, solver in dict.fromkeys((row["scene"], row["solver"]) for row in record["rows"]):
        mine = [row for row in record["rows"] if (row["scene"], row["solver"]) == (scene, solver)]
        size = f"{said[scene]}, {mine[0]['struts']} struts"
        rows.append([size, solver, *(f"{row['milliseconds']:.2f}" for row in mine)])
    beside = f"beside {record['cores']} busy processes, ms/step"
    return table(["structure", "systems solved", "idle machine, ms/step", beside], rows)

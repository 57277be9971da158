"""Milliseconds a step of structures whose struts share nodes: by the library's dense systems, and by LAPACK's threads.

Each is measured on an idle machine and beside a busy process on each core, with as many BLAS threads as there are
cores, as a user's program has them.
"""

import contextlib
import multiprocessing
import os
import time
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from jaxgrity.cli.script import cores, measured, run

import jax.numpy as jnp
import numpy as np
from random_structures import random_scene
from tqdm import tqdm

from jaxgrity import ConeFriction, ExactGround, Members, Scene, SolverOptions, Structure, edge_lengths, simulate
from jaxgrity.io.files import save_json
from jaxgrity.structures import tetrahedral_spine

STEP = 2e-3
"""s"""
VERTEBRAE, STRUTS = 12, 26
SOLVERS = {
    "in blocks": {},
    "by LAPACK": {
        "jaxgrity.stepping.contact_problem.solution": jnp.linalg.solve,
        "jaxgrity.stepping.coupled_problem.inverse_of": jnp.linalg.inv,
        "jaxgrity.model.inertia.inverse_of": jnp.linalg.inv,
    },
}
"""what takes the place of what"""


@dataclass
class Settings:
    steps: int = 100
    """of each rollout, the fastest of three of which counts"""
    out: Path = Path("results/threads")
    """folder for threads.json"""
    quick: bool = False
    """ten steps of the spine alone"""


def main(settings: Settings) -> None:
    os.environ["OPENBLAS_NUM_THREADS"] = str(cores())
    scenes, steps = (["spine"], 10) if settings.quick else (["spine", "random"], settings.steps)
    rows = []
    for scene, solver, busy in tqdm(
        [(s, how, b) for s in scenes for how in SOLVERS for b in (False, True)], unit="run"
    ):
        with contextlib.ExitStack() as running:
            for _ in range(cores() if busy else 0):
                other = multiprocessing.get_context("spawn").Process(target=spin, daemon=True)
                other.start()
                running.callback(other.kill)
            pool = running.enter_context(multiprocessing.get_context("spawn").Pool(1))
            found = pool.apply(milliseconds, (scene, solver, steps))
        rows.append({"scene": scene, "solver": solver, "busy": busy, **found})
        tqdm.write(f"{scene} {solver}{' beside others' if busy else ''}: {found['milliseconds']:.3g} ms a step")
    save_json(settings.out / "threads.json", {**measured(), "steps": steps, "rows": rows})
    print(f"wrote {settings.out}/threads.json")


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
    nodes, struts = len(scene.structure.nodes), len(scene.structure.struts.edges)
    return {"milliseconds": 1e3 * min(seconds[1:]) / steps, "nodes": nodes, "struts": struts, "failed": motion.failed}


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


if __name__ == "__main__":
    run(main, Settings)

"""What the benchmark compares: the library's methods, hand-written C and MuJoCo, each as a function of the step."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import limit
import numpy as np

from jaxgrity import Scene, SolverOptions, gaits_of, simulate_population

C_SWEEPS = 8
AT_LEAST = 0.2
"""s, for which an engine is timed in each of its turns, at most `MOST` times over"""
MOST = 100
FEW = 16
"""gaits for MuJoCo, as many as its two threads take in a sensible time; costs are given per gait"""


class Engine(NamedTuple):
    """Something that rolls out the gaits."""

    name: str
    dtype: str
    roll: Callable[[float], tuple[np.ndarray, float]]
    """step, s, to the centres of mass at the end, (gaits, 3), m, and the wall time, s"""
    gaits: int


def engines(scenes: dict[str, Scene], phases: np.ndarray, duration: float, mujoco: bool) -> list[Engine]:
    """All that can run here, MuJoCo if it is asked for."""
    found, count = [], len(phases)
    for dtype in ("float32", "float64"):
        for method, scene in (("rk4", scenes["reference"]), ("complementarity", scenes["exact"])):
            found.append(Engine(method, dtype, partial(ours, scene, phases, duration, method, dtype), count))
        if (programs := limit.programs()) is not None:
            for name, scene, sweeps in (("limit", scenes["reference"], None), ("exact", scenes["exact"], C_SWEEPS)):
                program = programs / f"{name}{dtype[-2:]}"
                roll = partial(theirs, program, scene, phases, duration, sweeps)
                found.append(Engine(name, dtype, roll, count))
    if mujoco:
        for integrator in ("Euler", "RK4"):
            roll = partial(mujoco_roll, scenes["reference"], phases[:FEW], duration, integrator)
            found.append(Engine(f"mujoco {integrator}", "float64", roll, min(FEW, count)))
    return found


def seconds_of(engine: Engine, dt: float) -> float:
    """Wall time of a rollout, s: the median of as many as take `AT_LEAST`.

    One alone, of some milliseconds, would be as slow as the engine before has left caches and the processor's clock.
    """
    seconds: list[float] = []
    while sum(seconds) < AT_LEAST and len(seconds) < MOST:
        seconds.append(engine.roll(dt)[1])
    return float(np.median(seconds))


def ours(scene: Scene, phases, duration: float, method: str, dtype: str, dt: float) -> tuple[np.ndarray, float]:
    options = SolverOptions(method=method, dt=dt, dtype=dtype, any_step=True)
    gaits = gaits_of(scene.gait, phases)
    seconds, outcomes = clock(lambda: simulate_population(scene, gaits, duration, options=options))
    return np.asarray(outcomes.com_end, float), seconds


def theirs(program: Path, scene: Scene, phases, duration: float, sweeps, dt: float) -> tuple[np.ndarray, float]:
    return limit.roll(program, scene, phases, round(duration / dt), dt, jax.device_count(), sweeps)


def mujoco_roll(scene: Scene, phases, duration: float, integrator: str, dt: float) -> tuple[np.ndarray, float]:
    from mujoco_peer import roll

    positions, seconds = roll(scene, phases, duration, dt, integrator, threads=jax.device_count())
    mass = np.asarray(scene.structure.node_mass)
    return np.einsum("n,gnk->gk", mass / mass.sum(), positions), seconds


def clock(function: Callable) -> tuple[float, object]:
    """Wall time of one call, s, and its result."""
    start = time.perf_counter()
    result = jax.block_until_ready(function())
    return time.perf_counter() - start, result

"""What the benchmark compares: the library's methods, hand-written C, MuJoCo and a plain NumPy loop."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from measurements import limit

from jaxgrity import Scene, SolverOptions, gaits_of, simulate_population

SAME_MODEL = {"rk4": "limit", "complementarity": "exact"}
"""the C program that does the same as a method"""
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


def engines(scenes: dict[str, Scene], phases: np.ndarray, duration: float, mujoco: bool, mjx: bool) -> list[Engine]:
    """All that can run here, MuJoCo and MJX if they are asked for."""
    found, count = [], len(phases)
    for dtype in ("float32", "float64"):
        contacts = (("rk4", "reference"), ("complementarity", "exact"), ("complementarity2", "exact"))
        for method, scene in ((method, scenes[name]) for method, name in contacts):
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
    if mjx:
        roll = partial(mujoco_roll, scenes["reference"], phases[:FEW], duration, "MJX Euler")
        found.append(Engine("mujoco MJX Euler", "float32", roll, min(FEW, count)))
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
    from measurements.mujoco_peer import roll, roll_mjx

    if integrator.startswith("MJX"):
        positions, seconds = roll_mjx(scene, phases, duration, dt, integrator.split()[1])
    else:
        positions, seconds = roll(scene, phases, duration, dt, integrator, threads=jax.device_count())
    mass = np.asarray(scene.structure.lumped_mass)
    return np.einsum("n,gnk->gk", mass / mass.sum(), positions), seconds


def clock(function: Callable[[], Any]) -> tuple[float, Any]:
    """Wall time of one call, s, and its result."""
    start = time.perf_counter()
    result = jax.block_until_ready(function())
    return time.perf_counter() - start, result


def numpy_roll(scene: Scene, phase: np.ndarray, duration: float, dt: float) -> np.ndarray:
    """Centre of mass at the end, (3,), m, by RK4 on the scene "reference", one robot at a time.

    So such a simulator is usually first written. Its answer is independent: no energies, no automatic differentiation.
    """
    structure, gait, ground, friction = scene.structure, scene.gait, scene.ground, scene.friction
    mass, drag = np.asarray(structure.node_mass), np.asarray(scene.node_damping)
    members = []
    for kind in (structure.struts, structure.cables):
        rows = zip(kind.edges, np.asarray(kind.stiffness), np.asarray(kind.rest_length), np.asarray(kind.damping))
        members += [(i, j, K, L, c, kind is structure.cables) for (i, j), K, L, c in rows]
    actuated = {k: a for a, k in enumerate(gait.members)}
    k_n, alpha = float(ground.stiffness), float(ground.dissipation)
    mu, eps, g = float(friction.mu), float(friction.slip_speed), float(scene.gravity)
    delta, frequency = np.asarray(gait.amplitude), np.asarray(gait.frequency)

    def acceleration(t, x, v):
        force = -drag[:, None] * v
        force[:, 2] -= mass * g
        ramp = min(max((t - float(gait.start)) / float(gait.ramp), 0.0), 1.0)
        for number, (i, j, K, L, c, cable) in enumerate(members):
            if number in actuated:
                a = actuated[number]
                L = L * (1 - delta[a] / 2 * ramp * (1 + np.sin(2 * np.pi * frequency[a] * t + phase[a])))
            d = x[i] - x[j]
            length = np.sqrt(d @ d)
            if cable and length <= L:
                continue
            d = d / length
            pull = (K * (length - L) + c * (d @ (v[i] - v[j]))) * d
            force[i] -= pull
            force[j] += pull
        for n in range(len(x)):
            if x[n, 2] < 0:
                normal = -k_n * x[n, 2] * max(0.0, 1 - alpha * v[n, 2])
                slip = v[n, :2]
                force[n, 2] += normal
                force[n, :2] -= mu * normal * slip / np.sqrt(slip @ slip + eps * eps)
        return force / mass[:, None]

    x = np.array(structure.nodes, float)
    v = np.zeros_like(x)
    for n in range(round(duration / dt)):
        t = n * dt
        a1 = acceleration(t, x, v)
        v2 = v + dt / 2 * a1
        a2 = acceleration(t + dt / 2, x + dt / 2 * v, v2)
        v3 = v + dt / 2 * a2
        a3 = acceleration(t + dt / 2, x + dt / 2 * v2, v3)
        v4 = v + dt * a3
        a4 = acceleration(t + dt, x + dt * v3, v4)
        x = x + dt / 6 * (v + 2 * v2 + 2 * v3 + v4)
        v = v + dt / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return mass @ x / mass.sum()

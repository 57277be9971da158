"""Costs that `scaling.py` tables: each is measured in a process of its own, with as many cores as devices."""

import multiprocessing
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from multiprocessing.pool import Pool
from pathlib import Path

from jaxgrity.cli.script import configure

import jax
import numpy as np
from measurements import limit as hand_written
from measurements.engines import AT_LEAST, C_SWEEPS, clock

from jaxgrity import Scene, SolverOptions, gaits_of, load_scene, random_phases, simulate, simulate_population
from jaxgrity.structures import prism_tower

METHODS = {"rk4": ("reference", 5e-4), "complementarity": ("exact", 5e-3)}
"""the scene that each is measured on, and its step, s"""
DURATION = 4.0
"""s, that populations are rolled out for: much longer than it takes to wake a core up"""
TOWER_STEPS = {"rk4": 2e-4, "complementarity": 2e-3}
"""s"""
IN_C = {"rk4": ("limit32", None), "complementarity": ("exact32", C_SWEEPS)}
"""the C program that does the same in float32, and its sweeps"""


def in_process(devices: int, function: Callable, arguments: tuple) -> dict:
    """What the function returns in a fresh process with so many devices, on as many cores."""
    with process(devices) as pool:
        return pool.apply(function, arguments)


def process(devices: int) -> Pool:
    """A fresh process with so many devices, on as many cores."""
    return multiprocessing.get_context("spawn").Pool(1, confine, (devices,))


def confine(devices: int) -> None:
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:devices])
    configure()
    jax.config.update("jax_num_cpu_devices", devices)


def median_time(function: Callable, repeats: int) -> float:
    """Median wall time of a call, s, of so many or as many as take `AT_LEAST`, after one that compiles."""
    seconds: list[float] = []
    while len(seconds) < repeats + 1 or sum(seconds[1:]) < AT_LEAST:
        seconds.append(clock(function)[0])
    return float(np.median(seconds[1:]))


def population_cost(method: str, gaits: int, repeats: int) -> dict:
    """Of `gaits` random gaits over `DURATION`, in float32."""
    name, dt = METHODS[method]
    scene = load_scene(name)
    return cost(scene, method, gaits, DURATION, dt, repeats)


def tower_cost(method: str, struts: int, repeats: int) -> dict:
    """Of 128 gaits of a tower, in float32, over 100 steps."""
    scene = prism_tower(struts, exact=method == "complementarity")
    dt = TOWER_STEPS[method]
    return {"struts": struts, **cost(scene, method, 128, 100 * dt, dt, repeats)}


def cost(scene: Scene, method: str, gaits: int, duration: float, dt: float, repeats: int) -> dict:
    rows = gaits_of(scene.gait, random_phases(gaits, len(scene.gait.members), seed=0))
    options = SolverOptions(method=method, dt=dt, dtype="float32", any_step=True)
    seconds = median_time(lambda: simulate_population(scene, rows, duration, options=options), repeats)
    step = seconds / gaits / round(duration / dt)
    return {
        "method": method,
        "gaits": gaits,
        "seconds": seconds,
        "per_gait_and_simulated_second": step / dt,
        "per_gait_and_step": step,
    }


def cost_in_c(folder: Path, method: str, gaits: int, threads: int, repeats: int) -> dict:
    """As `population_cost`, of the C program that does the same."""
    (name, dt), (program, sweeps) = METHODS[method], IN_C[method]
    scene, phases = load_scene(name), random_phases(gaits, 6, seed=0)
    seconds = [
        hand_written.roll(folder / program, scene, phases, round(DURATION / dt), dt, threads, sweeps)[1]
        for _ in range(repeats)
    ]
    each = float(np.median(seconds)) / gaits / DURATION
    return {"method": method, "gaits": gaits, "per_gait_and_simulated_second": each}


def single_cost(method: str, dtype: str, repeats: int) -> dict:
    """One rollout of 10 s, 100 frames a second saved."""
    name, dt = METHODS[method]
    scene = load_scene(name)
    options = SolverOptions(method=method, dt=dt, dtype=dtype)
    seconds = median_time(lambda: simulate(scene, 10.0, options=options), repeats)
    return {"method": method, "dtype": dtype, "times_real_time": 10.0 / seconds}


def exponents(rows: list[dict]) -> dict[str, float]:
    """p in cost ~ struts^p, from the smallest tower to the largest."""
    found = {}
    for method in dict.fromkeys(row["method"] for row in rows):
        ours = [row for row in rows if row["method"] == method]
        growth = ours[-1]["per_gait_and_step"] / ours[0]["per_gait_and_step"]
        found[method] = float(np.log(growth) / np.log(ours[-1]["struts"] / ours[0]["struts"]))
    return found


SCRIPT = """
from jaxgrity.cli.script import configure
configure()
from jaxgrity import describe, load_scene, simulate
scene = load_scene("reference")
describe(scene)
simulate(scene, 1e-3)
"""
"""what a script that simulates does until its first steps are taken"""


def start_up(repeats: int, warm: bool = True) -> dict[str, float]:
    """Seconds: of the imports, and of a script until its first steps, with nothing compiled before, and with the
    compiled programs of a run before where these are to be warm."""

    def took(code: str, **variables: str) -> float:
        code = f"import time; start = time.perf_counter(); {code}\nprint(time.perf_counter() - start)"
        known = os.environ | variables
        done = subprocess.run([sys.executable, "-c", code], env=known, capture_output=True, text=True, check=True)
        return float(done.stdout)

    def took_cold(code: str) -> float:
        with tempfile.TemporaryDirectory() as empty:
            return took(code, JAX_COMPILATION_CACHE_DIR=empty)

    codes = {
        "jax and diffrax": "import jax, diffrax",
        "jaxgrity": "from jaxgrity import load_scene, simulate, simulate_population",
        "first steps": SCRIPT,
    }
    for code in codes.values() if warm else ():
        took(code)
    found = {name: float(np.median([took(code) for _ in range(repeats)])) for name, code in codes.items()}
    return found | {"first steps, cold": float(np.median([took_cold(SCRIPT) for _ in range(repeats)]))}

"""How cost grows: with the number of devices, of gaits and of struts; what one rollout costs, and what starting does.

Every part runs in processes of its own, which may use as many cores as they have devices; with --quick all parts for as
many devices share one.
"""

import contextlib
import functools
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from multiprocessing.pool import Pool
from pathlib import Path

from jaxgrity.cli.script import configure
from measurement import Record, measurement

import jax
import limit as hand_written
import numpy as np
from engines import AT_LEAST, C_SWEEPS
from matplotlib.figure import Figure
from pages import table
from tqdm import tqdm

from jaxgrity import Scene, SolverOptions, as_dtype, gaits_of, load_scene, random_phases, simulate, simulate_population
from jaxgrity.populations import roll_out
from jaxgrity.stepping import resolve
from jaxgrity.structures import prism_tower

METHODS = {"rk4": ("reference", 5e-4), "complementarity": ("exact", 5e-3)}
"""the scene that each is measured on, and its step, s"""
DURATION = 4.0
"""s, that populations are rolled out for: much longer than it takes to wake a core up"""
TOWER_STEPS = {"rk4": 2e-4, "complementarity": 2e-3}
"""s"""
IN_C = {"rk4": ("limit32", None), "complementarity": ("exact32", C_SWEEPS)}
"""the C program that does the same in float32, and its sweeps"""


LARGEST = 1024
"""Gaits at most with which numbers of devices are compared."""
SEARCHED = 256
"""Population between the smallest and the largest that is quoted too."""
PARTS = ("devices", "population", "struts", "single", "compiled", "C")


@measurement(
    page="scaling.md",
    quick={"methods": ("complementarity",), "sizes": (16,), "struts": (6, 12), "repeats": 1, "shared": True},
    raw=tuple(part for part in PARTS if part != "compiled"),
    listed=False,
)
def scaling(
    methods: tuple[str, ...] = tuple(METHODS),
    sizes: tuple[int, ...] = (64, 128, 256, 1024, 4096),
    struts: tuple[int, ...] = (6, 18, 60, 180, 600),
    repeats: int = 5,
    shared: bool = False,
) -> Record:
    """All parts, and what the pages quote of them.

    Args:
        methods: names of those that are measured
        sizes: gaits of populations
        struts: of towers
        repeats: timed calls, of which the median counts, after one that compiles
        shared: all parts for as many devices share a process, and nothing is warmed up
    """
    cores, most = len(os.sched_getaffinity(0)), min(LARGEST, sizes[-1])
    tasks: list[tuple] = [("devices", d, population_cost, (m, most, repeats)) for m in methods for d in (1, cores)]
    tasks += [("population", cores, population_cost, (m, n, repeats)) for m in methods for n in sizes]
    tasks += [("struts", cores, tower_cost, (m, n, repeats)) for m in methods for n in struts]
    tasks += [("single", 1, single_cost, (m, dtype, repeats)) for m in methods for dtype in ("float32", "float64")]
    tasks += [("compiled", 1, compiled, (m,)) for m in methods]
    if (folder := hand_written.programs()) is not None:
        tasks += [("C", 1, cost_in_c, (folder, m, most, 1, repeats)) for m in methods]
        tasks += [("C", cores, cost_in_c, (folder, m, n, cores, repeats)) for m in methods for n in sizes]
    parts: dict[str, list[Record]] = {part: [] for part in PARTS}
    with contextlib.ExitStack() as running:
        pools = functools.cache(lambda devices: running.enter_context(process(devices)))
        for name, devices, function, arguments in tqdm(tasks, unit="run"):
            found = pools(devices).apply(function, arguments) if shared else in_process(devices, function, arguments)
            parts[name].append(found if name == "compiled" else {"devices": devices, **found})
    start = start_up(min(3, repeats), warm=not shared)
    return {"methods": quoted(parts), "start": start, **parts}


def quoted(parts: dict[str, list[Record]]) -> list[Record]:
    """Of each method what the table has of it."""
    rows = []
    for method, exponent in exponents(parts["struts"]).items():
        mine = {name: [row for row in parts[name] if row["method"] == method] for name in PARTS}
        one, several = mine["devices"]
        struts, sizes = mine["struts"], mine["population"]
        told = {row["gaits"]: row for row in (sizes[0], *(row for row in sizes if row["gaits"] == SEARCHED), sizes[-1])}
        rows.append(
            {
                "method": method,
                "devices": several["devices"],
                "gaits": several["gaits"],
                "speed_up": one["seconds"] / several["seconds"],
                "populations": list(told),
                "per_gait_and_simulated_second": [row["per_gait_and_simulated_second"] for row in told.values()],
                "struts": [struts[0]["struts"], struts[-1]["struts"]],
                "per_gait_and_step": [struts[0]["per_gait_and_step"], struts[-1]["per_gait_and_step"]],
                "exponent": exponent,
                "times_real_time": [row["times_real_time"] for row in mine["single"]],
                "in_C": in_c(mine["C"], list(told)) if mine["C"] else None,
            }
        )
    return rows


def in_c(mine: list[Record], sizes: list[int]) -> Record:
    """Of the C program that does the same as a method: its speed-up, and its cost in populations of the sizes."""
    cost = {(row["devices"], row["gaits"]): row["per_gait_and_simulated_second"] for row in mine}
    several = max(threads for threads, _ in cost)
    shared = next(gaits for threads, gaits in cost if threads == 1)
    return {
        "speed_up": cost[1, shared] / cost[several, shared],
        "per_gait_and_simulated_second": [cost[several, size] for size in sizes],
    }


def microseconds(seconds: float) -> str:
    return f"{1e6 * seconds:.0f} us"


@scaling.table
def words(record: Record) -> str:
    """What each method costs, and the C program that does the same."""
    rows = [
        [
            row["method"],
            f"{row['speed_up']:.2f} times as fast as one",
            ", ".join(microseconds(cost) for cost in row["per_gait_and_simulated_second"]),
            f"{1e6 * row['per_gait_and_step'][0]:.2f} and {1e6 * row['per_gait_and_step'][1]:.0f} us",
            f"{row['exponent']:.2f}",
            " and ".join(f"{times:.0f}" for times in row["times_real_time"]),
        ]
        for row in record["methods"]
    ]
    rows += [
        [
            f"hand-written C, as {row['method']}",
            f"{row['in_C']['speed_up']:.2f} times",
            ", ".join(microseconds(cost) for cost in row["in_C"]["per_gait_and_simulated_second"]),
            *3 * ["-"],
        ]
        for row in record["methods"]
        if row["in_C"]
    ]
    first = record["methods"][0]
    populations, struts = (", ".join(str(size) for size in first[name]) for name in ("populations", "struts"))
    head = [
        "method",
        f"{first['devices']} devices, {first['gaits']} gaits",
        f"{populations} gaits, a gait and simulated second",
        f"{struts} struts, a step",
        "cost ~ struts^",
        "one rollout, float32 and float64: times real time",
    ]
    return table(head, rows)


@partial(scaling.table, part="million")
def million(record: Record) -> str:
    """What a search of 10^6 gaits costs, by arithmetic on the largest population."""
    rows = []
    for row in record["methods"]:
        cost = row["per_gait_and_simulated_second"][-1]
        rows.append([row["method"], microseconds(cost), f"{1e6 * 10 * cost / 60:.0f} minutes"])
    head = ["method", "a gait and simulated second, float32", f"10^6 rollouts of 10 s on {record['cores']} cores"]
    return table(head, rows)


@partial(scaling.table, part="compiled", page="performance.md")
def loops(record: Record) -> str:
    """What a step compiles to."""
    rows = []
    for found in record["compiled"]:
        counts = [", ".join(f"{n} {kind}" for kind, n in loop["instructions"].items()) for loop in found["loops"]]
        rows.append([found["method"], "; ".join(counts), "; ".join(str(loop["roots"]) for loop in found["loops"])])
    head = ["method", "instructions in the body of each loop, innermost first", "roots in one pass, of one gait"]
    return table(head, rows)


@partial(scaling.table, part="start", page="performance.md")
def starting(record: Record) -> str:
    """What a user waits for."""
    start = record["start"]
    script = "a script that loads, describes and simulates a scene: its first steps, with what an earlier run compiled"
    rows = [
        ["importing JAX and diffrax", f"{start['jax and diffrax']:.2f} s"],
        ["importing jaxgrity, with JAX and diffrax", f"{start['jaxgrity']:.2f} s"],
        [script, f"{start['first steps']:.1f} s"],
        ["the same with nothing compiled before", f"{start['first steps, cold']:.1f} s"],
    ]
    return table(["from the start of the process", "wall time"], rows)


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


def median_time(function: Callable, repeats: int) -> tuple[float, float]:
    """Median wall time of a call, s, of so many or as many as take `AT_LEAST`; and what the first call took longer."""
    seconds: list[float] = []
    while len(seconds) < repeats + 1 or sum(seconds[1:]) < AT_LEAST:
        start = time.perf_counter()
        jax.block_until_ready(function())
        seconds.append(time.perf_counter() - start)
    warm = float(np.median(seconds[1:]))
    return warm, seconds[0] - warm


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
    seconds, compilation = median_time(lambda: simulate_population(scene, rows, duration, options=options), repeats)
    step = seconds / gaits / round(duration / dt)
    return {
        "method": method,
        "gaits": gaits,
        "seconds": seconds,
        "per_gait_and_simulated_second": step / dt,
        "per_gait_and_step": step,
        "compile_seconds": compilation,
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
    seconds, compilation = median_time(lambda: simulate(scene, 10.0, options=options), repeats)
    return {"method": method, "dtype": dtype, "times_real_time": 10.0 / seconds, "compile_seconds": compilation}


def compiled(method: str) -> dict:
    """Of each loop's body, for 128 gaits, innermost loops first: its instructions, and the roots that a gait takes.

    Instructions are a kernel each, unless loops are compiled whole. A root inside of a fusion is computed once for each
    number that comes out of it: if lengths were computed anew for each use, these would be more than there are lengths.
    """
    name, dt = METHODS[method]
    scene = load_scene(name)
    rows = gaits_of(scene.gait, random_phases(128, 6, seed=0))
    options = resolve(scene, 1.0, SolverOptions(method=method, dt=dt, dtype="float32", any_step=True)).as_inputs()
    program = roll_out.lower(as_dtype(scene, "float32"), rows, np.asarray(1.0), options).compile().compiled
    text = program.as_text()
    bodies = dict(re.findall(r"^%?([\w.\-]+) .*?\{\n(.*?)^\}", text, re.MULTILINE | re.DOTALL))
    names = re.findall(r" while\(.*?body=%?([\w.\-]+)", text)
    return {
        "method": method,
        "loops": [{"instructions": instructions(bodies[b]), "roots": roots(bodies, b)} for b in names],
    }


def instructions(body: str) -> dict[str, int]:
    """How many of each kind, but for those that cost nothing."""
    free = ("parameter", "constant", "tuple", "get-tuple-element", "bitcast")
    return dict(Counter(kind for kind in re.findall(r" = .*? ([a-z][a-z-]*)\(", body) if kind not in free))


def roots(bodies: dict[str, str], body: str) -> int:
    """Square roots taken in one pass, of one gait, not in loops inside; in a fusion one for each number out."""
    found = 0
    for shape, fused in re.findall(r" = \w+\[([\d,]+)\]\S* (?:sqrt|fusion\(.*?calls=%?([\w.\-]+))", bodies[body]):
        *rows, _ = map(int, shape.split(","))  # the robots are last
        found += int(np.prod(rows)) * (len(re.findall(r" sqrt\(", bodies[fused])) if fused else 1)
    return found


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


@scaling.figure
def figure(record: Record) -> Figure:
    """Cost per gait against the size of the population, and cost per step against the number of struts."""
    chart = Figure(figsize=(10, 4), layout="constrained")
    left, right = chart.subplots(1, 2)
    for method in dict.fromkeys(row["method"] for row in record["population"]):
        ours = [row for row in record["population"] if row["method"] == method]
        x, y = ([row[key] for row in ours] for key in ("gaits", "per_gait_and_simulated_second"))
        left.loglog(x, 1e6 * np.array(y), "o-", label=method)
        ours = [row for row in record["struts"] if row["method"] == method]
        x, y = ([row[key] for row in ours] for key in ("struts", "per_gait_and_step"))
        line = right.loglog(x, 1e6 * np.array(y), "o-", label=method)[0]
        right.loglog(x, 1e6 * y[0] * np.array(x) / x[0], ":", color=line.get_color(), lw=1)
    left.set(xlabel="gaits", ylabel="us per gait and simulated second", title="size of the population")
    right.set(xlabel="struts", ylabel="us per gait and step", title="size of the structure (dotted: linear)")
    for axes in (left, right):
        axes.grid(alpha=0.3, which="both")
        axes.legend()
    return chart


if __name__ == "__main__":
    scaling.run()

"""Speed against error, everything side by side in one run: the library's methods, a plain NumPy loop, and, where they
are there, hand-written C (if there is a compiler) and MuJoCo (--mujoco, the extra `peer`; --mjx, the extra `mjx`).

Each engine takes the same gaits on the same cores, in turn, round after round; the median counts. Each is measured
against its own converged answer: the median over the gaits of the distance of the centres of mass at the end.
"""

import time
from itertools import chain
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from measurements.engines import SAME_MODEL, Engine, clock, engines, numpy_roll, ours, seconds_of
from measurements.measurement import Figure, Record, measurement
from measurements.pages import by_name, table
from tqdm import tqdm

from jaxgrity import InputError, Scene, SolverOptions, as_dtype, gaits_of, load_scene, random_phases
from jaxgrity.populations import lanes_last, roll_out_lanes
from jaxgrity.report import plot
from jaxgrity.search import distance_and_gradient
from jaxgrity.stepping import resolve

STEPS = {
    "rk4": (1e-3, 5e-4, 2e-4),
    "complementarity": (3e-2, 2e-2, 1.4e-2, 1e-2, 8e-3, 5e-3, 2e-3, 1e-3),
    "complementarity2": (3e-2, 2e-2, 1.4e-2, 1e-2, 8e-3, 5e-3, 2e-3, 1e-3),
    "limit": (1e-3, 5e-4, 2e-4),
    "exact": (3e-2, 2e-2, 1.4e-2, 1e-2, 8e-3, 5e-3, 2e-3, 1e-3),
    "mujoco Euler": (4e-3, 3e-3, 2e-3, 1e-3, 8e-4, 5e-4, 2e-4),
    "mujoco RK4": (1.4e-3, 1e-3, 5e-4, 2e-4),
    "mujoco MJX Euler": (1e-3,),
}
"""s"""
CONVERGED = {
    "rk4": 5e-5,
    "complementarity": 1e-4,
    "complementarity2": 1e-4,
    "limit": 5e-5,
    "exact": 5e-5,
    "mujoco": 5e-5,
}
"""s"""
TARGETS = (1e-2, 2e-3)
"""m, at which rollouts per second are compared"""
NUMPY_DURATION = 0.1
"""s"""
RK4 = SolverOptions(method="rk4", dt=5e-4)
"""of the gradients"""
QUOTED = {"rk4": 5e-4, "complementarity": 5e-3}
"""Steps at which methods are quoted, s."""
WRITTEN = {
    "limit": "hand-written C, RK4",
    "exact": "hand-written C, exact contact",
    "mujoco Euler": "MuJoCo, Euler's method",
    "mujoco RK4": "MuJoCo, RK4",
}
"""What engines of others are called in tables."""
DRAWN = {"rk4": "RK4", "complementarity": "exact contact", "complementarity2": "complementarity2"}
"""What the library's methods are called in the figure."""


class Point(NamedTuple):
    """One engine at one step."""

    engine: str
    dtype: str
    dt: float
    seconds: float
    """wall time per gait and simulated second"""
    error: float
    """m"""


@measurement(
    page="performance.md",
    quick={"duration": 0.5, "repeats": 2, "steps": 1},
    raw=("points", "numpy_off"),
    drawn=("lines",),
    options="--mujoco",
)
def benchmark(
    gaits: int = 256,
    duration: float = 4.0,
    repeats: int = 5,
    steps: int | None = None,
    mujoco: bool = False,
    mjx: bool = False,
) -> Record:
    """Cost and error of every engine at every step.

    Args:
        gaits: size of the population
        duration: simulated time, s
        repeats: rounds after a first that compiles; the median of them counts
        steps: how many of each engine's steps are measured, largest first; all where not given
        mujoco: measure MuJoCo too
        mjx: measure MJX, MuJoCo written in JAX, beside it, on one core; goes with --mujoco
    """
    if mjx and not mujoco:
        raise InputError("--mjx goes beside --mujoco, whose converged answer it is measured against; expected both")
    scenes = {name: load_scene(name) for name in ("reference", "exact")}
    phases = random_phases(gaits, 6, seed=0)
    chosen = engines(scenes, phases, duration, mujoco, mjx)
    tasks = [(engine, dt) for engine in chosen for dt in STEPS[engine.name][:steps]]
    # a few steps are a look at whether all of it works, for which coarser answers do
    truths = converged(chosen, 1 if steps is None else 4)
    points, agreement = measure(tasks, truths, duration, repeats)
    over_c, quoted = ratios(points), [point for point in points if QUOTED.get(point.engine) == point.dt]
    numpy_seconds, numpy_off = numpy_cost(scenes["reference"], phases[0])
    gradient = gradient_cost(scenes["reference"], phases[:64], duration / 2, repeats)
    return {
        "gaits": gaits,
        "duration": duration,
        "repeats": repeats,
        "largest_difference_from_C": agreement,
        "costs": [
            {"engine": p.engine, "dtype": p.dtype, "dt": p.dt, "seconds": p.seconds, "over_C": over_c.get(p[:3])}
            for p in quoted
        ],
        "numpy_seconds": numpy_seconds,
        "gradient": gradient,
        "rollouts_per_second": [{"error": target, "rates": rates(points, target, duration)} for target in TARGETS],
        "points": [point._asdict() for point in points],
        "lines": lines_of(points),
        "numpy_off": numpy_off,
    }


@benchmark.table
def words(record: Record) -> str:
    """Costs of one gait, rollouts a second within errors, and what was measured."""
    return "\n\n".join([costs_table(record), rates_table(record), about_table(record)])


@benchmark.table(part="short", page="README.md")
def short(record: Record) -> str:
    """Rollouts a second beside the others', each with its precision and step, and steps a second of all robots."""
    near, ours, duration = record["rollouts_per_second"][0], "complementarity", record["duration"]
    chosen = [
        (written, near["rates"][name])
        for name, written in {ours: "jaxgrity, exact contact", **WRITTEN}.items()
        if name in near["rates"] and name in (ours, "exact", "mujoco Euler")
    ]
    chosen += [
        ("jaxgrity, exact contact, default step", cost | {"rate": 1 / (cost["seconds"] * duration)})
        for cost in [cost for cost in record["costs"] if cost["engine"] == ours][:1]
    ]
    rows = [
        [
            name,
            found["dtype"],
            f"{1e3 * found['dt']:g}",
            f"{found['rate']:,.0f}",
            f"{1e-6 * found['rate'] * duration / found['dt']:.2g}",
        ]
        for name, found in chosen
    ]
    head = f"program ({record['gaits']} robots at once on {record['cores']} cores, {duration:g} s of motion each)"
    return table([head, "precision", "step, ms", "simulations per second", "million steps per second"], rows)


def costs_table(record: Record) -> str:
    """Of one gait, each method in both precisions."""
    rows = []
    for engine in dict.fromkeys(cost["engine"] for cost in record["costs"]):
        mine = [cost for cost in record["costs"] if cost["engine"] == engine]
        over = ("-" if cost["over_C"] is None else f"{cost['over_C']:.1f}" for cost in mine)
        rows.append([engine, f"{1e3 * mine[0]['dt']:g}", *(f"{1e6 * cost['seconds']:.0f}" for cost in mine), *over])
    rows.append(["`rk4` as a NumPy loop", "0.5", "-", f"{round(1e6 * record['numpy_seconds'], -5):.0f}", "-", "-"])
    return table(["method", "step, ms", "float32, µs", "float64, µs", "float32/C", "float64/C"], rows)


def rates_table(record: Record) -> str:
    """Rollouts a second of each engine, with its cheapest step that has an error below each of the bounds."""
    bounds = record["rollouts_per_second"]
    names = dict.fromkeys(name for bound in bounds for name in bound["rates"])
    rows = []
    for name in names:
        found = (b["rates"].get(name) for b in bounds)
        cells = (("-", "-") if rate is None else (f"{rate['rate']:.0f}", f"{1e3 * rate['dt']:g}") for rate in found)
        rows.append([WRITTEN.get(name, f"jaxgrity, {name}"), *chain.from_iterable(cells)])
    heads = ((f"rollouts/s within {1e3 * b['error']:g} mm", "its step, ms") for b in bounds)
    return table(["engine", *chain.from_iterable(heads)], rows)


def about_table(record: Record) -> str:
    """What was measured, and what else came out."""
    off, gradient = record["largest_difference_from_C"], record["gradient"]
    cells = {
        "population": f"{record['gaits']} gaits, {record['duration']:g} s",
        "largest difference of `rk4` from C, m": "-" if off is None else f"{off:.0e}",
        f"gradient in {gradient['phases']} phases costs, rollouts": f"{gradient['reverse']:.1f}",
    }
    return table(list(cells), [list(cells.values())])


def converged(chosen: list[Engine], coarser: int) -> dict[str, np.ndarray]:
    """Where the gaits of each family of engines end, by the converged answer."""
    truths: dict[str, np.ndarray] = {}
    for engine in reversed(chosen):  # in float64 MuJoCo's RK4 comes last, and converges faster than its Euler
        family = engine.name.split()[0]
        if family not in truths and engine.dtype == "float64":
            truths[family] = engine.roll(CONVERGED[family] * coarser)[0]
    return truths


def measure(
    tasks: list[tuple[Engine, float]], truths: dict[str, np.ndarray], duration: float, repeats: int
) -> tuple[list[Point], float | None]:
    """Every engine at every step, in turn, `repeats` times over; how far RK4 ends from the C program's answer, m."""
    first = {(e.name, e.dtype, dt): e.roll(dt) for e, dt in tqdm(tasks, desc="first", unit="run")}
    seconds: dict[tuple, list[float]] = {key: [] for key in first}
    for _ in tqdm(range(repeats), desc="rounds", unit="round"):
        for engine, dt in tasks:
            seconds[engine.name, engine.dtype, dt].append(seconds_of(engine, dt))
    points = []
    for engine, dt in tasks:
        key = (engine.name, engine.dtype, dt)
        off = np.linalg.norm(first[key][0] - truths[engine.name.split()[0]], axis=1)
        error = float(np.median(np.where(np.isfinite(off), off, np.inf)))
        points.append(Point(*key, float(np.median(seconds[key])) / (engine.gaits * duration), error))
    same = [first.get((name, "float64", STEPS["rk4"][1])) for name in ("rk4", "limit")]
    return points, float(np.abs(same[0][0] - same[1][0]).max()) if all(same) else None


def numpy_cost(scene: Scene, phase: np.ndarray) -> tuple[float, float]:
    """Wall time per simulated second of the plain loop, s, and how far it ends from the library's answer, m."""
    start = time.perf_counter()
    end = numpy_roll(scene, phase, NUMPY_DURATION, 5e-4)
    seconds = time.perf_counter() - start
    answer = ours(scene, phase[None], NUMPY_DURATION, "rk4", "float64", 5e-4)[0][0]
    return seconds / NUMPY_DURATION, float(np.abs(end - answer).max())


def ratios(points: list[Point]) -> dict[tuple[str, str, float], float]:
    """Wall time over that of the C program with the same model, step and precision."""
    known = {(p.engine, p.dtype, p.dt): p.seconds for p in points}
    return {
        p[:3]: p.seconds / known[SAME_MODEL[p.engine], p.dtype, p.dt]
        for p in points
        if p.engine in SAME_MODEL and (SAME_MODEL[p.engine], p.dtype, p.dt) in known
    }


def rates(points: list[Point], target: float, duration: float) -> dict[str, Record]:
    """Rollouts a second of each engine, at its cheapest precision and step with an error of at most `target`."""
    cheapest: dict[str, Point] = {}
    for p in sorted(points, key=lambda p: p.seconds):
        if p.error <= target:
            cheapest.setdefault(p.engine, p)
    return {name: {"rate": 1 / (p.seconds * duration), "dtype": p.dtype, "dt": p.dt} for name, p in cheapest.items()}


def gradient_cost(scene: Scene, phases: np.ndarray, horizon: float, repeats: int) -> Record:
    """Time of the distance's gradient in all phases, by reverse mode, over that of the rollout alone."""
    options = resolve(scene, horizon, RK4, dtype="float64")
    scene = as_dtype(scene, "float64")
    gaits = jax.tree.map(jnp.asarray, gaits_of(scene.gait, phases))

    def ends():
        com_path, *_ = roll_out_lanes(scene, lanes_last(gaits), None, jnp.asarray(horizon), options)
        return jnp.hypot(*(com_path[-1] - com_path[0])[:2])

    programs = jax.jit(ends), jax.jit(lambda: distance_and_gradient(scene, gaits, horizon, options)[1])
    alone, reverse = (np.median([clock(each)[0] for _ in range(repeats + 1)][1:]) for each in programs)
    return {"phases": phases.shape[1], "reverse": float(reverse / alone)}


def lines_of(points: list[Point]) -> Record:
    """Costs and errors of each engine in each precision, where its error is a number."""
    found: dict[str, list[Record]] = {}
    for point in points:
        if np.isfinite(point.error):
            found.setdefault(f"{point.engine} {point.dtype}", []).append(point._asdict())
    return {name: by_name(mine, "seconds", "error") for name, mine in found.items()}


@benchmark.figure(6.4)
def figure(record: Record, chart: Figure) -> None:
    """Error against wall time, a line for each engine and precision."""
    axes = chart.subplots()
    looks = {name: (f"C{k}", marker) for k, (name, marker) in enumerate(zip(STEPS, plot.MARKERS))}
    names = {name: f"jaxgrity, {words}" for name, words in DRAWN.items()} | WRITTEN
    for line, found in record["lines"].items():
        name, _, dtype = line.rpartition(" ")
        colour, marker = looks[name]
        style = {"color": colour, "marker": marker, "ms": 6}
        style |= {} if dtype == "float64" else {"mfc": "white", "ls": ":"}
        axes.loglog(found["seconds"], found["error"], label=f"{names.get(name, name)}, {dtype}", **style)
    for at, colour, label in ((record["numpy_seconds"], "0.5", "NumPy loop, RK4 at 0.5 ms"), (1, "black", "real time")):
        axes.axvline(at, color=colour, lw=1.2, label=label)
    axes.set(xlabel="wall time per robot and simulated second (s)")
    axes.set(ylabel="median error of the final centre of mass (m)")
    errors = [error for found in record["lines"].values() for error in found["error"]]
    axes.set_ylim(min(errors) / 2, min(2 * max(errors), 1.0))  # a body length: larger steps are of no use
    chart.legend(loc="outside lower center", ncols=2)

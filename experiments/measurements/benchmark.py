"""Speed against error, everything side by side in one run: the library's methods, a plain NumPy loop, and, where they
are there, hand-written C (--limit FOLDER) and MuJoCo (--mujoco, the extra `peer`; --mjx, the extra `mjx`).

Each engine takes the same gaits on the same cores, in turn, round after round; the median counts. Each is measured
against its own converged answer: the median over the gaits of the distance of the centres of mass at the end.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from jaxgrity.cli.script import measured, run

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy_loop
from engines import C_SWEEPS, Engine, Others, clock, engines, ours, seconds_of
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import InputError, Scene, SolverOptions, as_dtype, diagnose, gaits_of, load_scene, random_phases
from jaxgrity.io.files import save_json
from jaxgrity.populations import lanes_last, roll_out_lanes
from jaxgrity.report import plot
from jaxgrity.search import distance_and_gradient
from jaxgrity.stepping import resolve

STEPS = {
    "rk4": (1e-3, 5e-4, 2e-4),
    "complementarity": (3e-2, 2e-2, 1.4e-2, 1e-2, 8e-3, 5e-3, 2e-3, 1e-3),
    "limit": (1e-3, 5e-4, 2e-4),
    "exact": (2e-2, 1.4e-2, 1e-2, 5e-3, 2e-3, 1e-3),
    "mujoco Euler": (4e-3, 3e-3, 2e-3, 1e-3, 8e-4, 5e-4, 2e-4),
    "mujoco RK4": (1.4e-3, 1e-3, 5e-4, 2e-4),
    "mujoco MJX Euler": (1e-3,),
}
"""s"""
CONVERGED = {"rk4": 5e-5, "complementarity": 1e-4, "limit": 5e-5, "exact": 5e-5, "mujoco": 5e-5}
"""s"""
TARGETS = (1e-2, 2e-3)
"""m, at which rollouts per second are compared"""
NUMPY_DURATION = 0.1
"""s"""
RK4 = SolverOptions(method="rk4", dt=5e-4)
"""of the gradients, and of the report on how far to trust one of the rollouts"""


@dataclass
class Settings:
    gaits: int = 256
    """size of the population"""
    duration: float = 4.0
    """simulated time, s"""
    repeats: int = 5
    """rounds after a first that compiles; the median of them counts"""
    limit: Path | None = None
    """folder with the programs limit32, limit64, exact32 and exact64"""
    mujoco: bool = False
    """measure MuJoCo too"""
    mjx: bool = False
    """measure MJX, MuJoCo written in JAX, beside it, on one core; goes with --mujoco"""
    out: Path = Path("results/benchmark")
    """folder for benchmark.json and benchmark.png"""
    quick: bool = False
    """an eighth of the time, two rounds, one step of each engine, no trust report"""


class Point(NamedTuple):
    """One engine at one step."""

    engine: str
    dtype: str
    dt: float
    seconds: float
    """wall time per gait and simulated second"""
    error: float
    """m"""
    compile_seconds: float


def main(settings: Settings) -> None:
    if settings.mjx and not settings.mujoco:
        raise InputError("--mjx goes beside --mujoco, whose converged answer it is measured against; expected both")
    if settings.quick:
        settings.duration, settings.repeats = settings.duration / 8, 2
    scenes = {name: load_scene(name) for name in ("reference", "exact")}
    phases = random_phases(settings.gaits, 6, seed=0)
    others = Others(settings.limit, settings.mujoco, settings.mjx)
    chosen = engines(scenes, phases, settings.duration, others)
    points, agreement = measure(chosen, settings)
    numpy_seconds, numpy_off = numpy_cost(scenes["reference"], phases[0])
    facts = {
        **measured(),
        "gaits": settings.gaits,
        "duration": settings.duration,
        "repeats": settings.repeats,
        "C_sweeps": C_SWEEPS,
        "points": [point._asdict() for point in points],
        "ratios_to_C": ratios(points),
        "largest_difference_from_C": agreement,
        "rollouts_per_second": {f"{target:g}": rates(points, target, settings.duration) for target in TARGETS},
        "numpy": {"dt": 5e-4, "seconds": numpy_seconds, "difference": numpy_off},
        "gradient": gradient_cost(scenes["reference"], phases[:64], settings),
    }
    if not settings.quick:
        facts["trust_report"] = diagnose(scenes["reference"], settings.duration, options=RK4).summary()
    save_json(settings.out / "benchmark.json", facts)
    plot.save(figure(points, numpy_seconds), settings.out / "benchmark.png")
    report(facts, points)
    print(f"wrote {settings.out}/benchmark.json and benchmark.png")


def measure(chosen: list[Engine], settings: Settings) -> tuple[list[Point], float | None]:
    """Every engine at every step, in turn, `repeats` times over; how far RK4 ends from the C program's answer, m."""
    tasks = [(engine, dt) for engine in chosen for dt in STEPS[engine.name][: 1 if settings.quick else None]]
    truths: dict[str, np.ndarray] = {}
    for engine in reversed(chosen):  # in float64 MuJoCo's RK4 comes last, and converges faster than its Euler
        family = engine.name.split()[0]
        if family not in truths and engine.dtype == "float64":
            truths[family] = engine.roll(CONVERGED[family] * (4 if settings.quick else 1))[0]
    first = {(e.name, e.dtype, dt): e.roll(dt) for e, dt in tqdm(tasks, desc="first", unit="run")}
    seconds: dict[tuple, list[float]] = {key: [] for key in first}
    for _ in tqdm(range(settings.repeats), desc="rounds", unit="round"):
        for engine, dt in tasks:
            seconds[engine.name, engine.dtype, dt].append(seconds_of(engine, dt))
    points = []
    for engine, dt in tasks:
        key = (engine.name, engine.dtype, dt)
        off = np.linalg.norm(first[key][0] - truths[engine.name.split()[0]], axis=1)
        error = float(np.median(np.where(np.isfinite(off), off, np.inf)))
        median = float(np.median(seconds[key]))
        per = engine.gaits * settings.duration
        points.append(Point(*key, median / per, error, max(0.0, first[key][1] - median)))
    same = [first.get((name, "float64", STEPS["rk4"][1])) for name in ("rk4", "limit")]
    return points, float(np.abs(same[0][0] - same[1][0]).max()) if all(same) else None


def numpy_cost(scene: Scene, phase: np.ndarray) -> tuple[float, float]:
    """Wall time per simulated second of the plain loop, s, and how far it ends from the library's answer, m."""
    start = time.perf_counter()
    end = numpy_loop.roll(scene, phase, NUMPY_DURATION, 5e-4)
    seconds = time.perf_counter() - start
    answer = ours(scene, phase[None], NUMPY_DURATION, "rk4", "float64", 5e-4)[0][0]
    return seconds / NUMPY_DURATION, float(np.abs(end - answer).max())


def ratios(points: list[Point]) -> dict[str, float]:
    """Wall time over that of the C program with the same model, step and precision."""
    known = {(p.engine, p.dtype, p.dt): p.seconds for p in points}
    pairs = {"rk4": "limit", "complementarity": "exact"}
    return {
        f"{p.engine} {p.dtype} {p.dt:g}": p.seconds / known[pairs[p.engine], p.dtype, p.dt]
        for p in points
        if p.engine in pairs and (pairs[p.engine], p.dtype, p.dt) in known
    }


def rates(points: list[Point], target: float, duration: float) -> dict[str, float]:
    """Rollouts a second of each engine at its cheapest step with an error of at most `target`."""
    found: dict[str, float] = {}
    for p in points:
        if p.error <= target:
            found[p.engine] = max(found.get(p.engine, 0.0), 1 / (p.seconds * duration))
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def gradient_cost(scene: Scene, phases: np.ndarray, settings: Settings) -> dict:
    """Time of the distance's gradient in all phases, by reverse and by forward mode, over that of the rollout alone."""
    horizon = settings.duration / 2
    options = resolve(scene, horizon, RK4, dtype="float64")
    scene = as_dtype(scene, "float64")
    gaits = jax.tree.map(jnp.asarray, gaits_of(scene.gait, phases))
    count = phases.shape[1]

    def ends(phase):
        varied = eqx.tree_at(lambda g: g.phase, lanes_last(gaits), phase)
        com_path, *_ = roll_out_lanes(scene, varied, None, jnp.asarray(horizon), options)
        return jnp.hypot(*(com_path[-1] - com_path[0])[:2])

    def forward(phase):
        tangents = jnp.broadcast_to(jnp.eye(count)[:, :, None], (count, *phase.shape))
        return jax.lax.map(lambda tangent: jax.jvp(ends, (phase,), (tangent,))[1], tangents)

    rollout = jax.jit(lambda: ends(gaits.phase.T))
    modes = {
        "reverse": jax.jit(lambda: distance_and_gradient(scene, gaits, horizon, options)[1]),
        "forward": jax.jit(lambda: forward(gaits.phase.T).T),
    }
    values = {name: jax.block_until_ready(mode()) for name, mode in modes.items()}
    alone = np.median([clock(rollout)[0] for _ in range(settings.repeats + 1)][1:])
    costs = {n: float(np.median([clock(m)[0] for _ in range(settings.repeats)]) / alone) for n, m in modes.items()}
    difference = float(jnp.abs(values["reverse"] - values["forward"]).max())
    return {"gaits": len(phases), "phases": count, "horizon": horizon, "largest_difference": difference, **costs}


def report(facts: dict, points: list[Point]) -> None:
    """The numbers for people."""
    print("engine                      step (s)   us per gait and simulated second   error (m)   compiled in (s)")
    for p in points:
        name = f"{p.engine} {p.dtype}"
        print(f"{name:26s} {p.dt:9.0e} {1e6 * p.seconds:26.1f} {p.error:17.1e} {p.compile_seconds:15.1f}")
    for name, ratio in facts["ratios_to_C"].items():
        print(f"{name}: {ratio:.1f} times the C program")
    for target, found in facts["rollouts_per_second"].items():
        print(f"rollouts a second at {target} m: " + ", ".join(f"{name} {rate:.0f}" for name, rate in found.items()))
    print(
        f"NumPy loop: {facts['numpy']['seconds']:.0f} s per simulated second, {facts['numpy']['difference']:.0e} m off"
    )
    gradient = facts["gradient"]
    print(
        f"gradient in {gradient['phases']} phases: {gradient['reverse']:.1f} rollouts, forward "
        f"{gradient['forward']:.1f}"
    )


@plot.styled
def figure(points: list[Point], numpy_seconds: float) -> Figure:
    """Error against wall time, a line for each engine and precision."""
    chart = Figure(figsize=(9, 4.8), layout="constrained")
    axes = chart.subplots()
    colours = {name: f"C{k}" for k, name in enumerate(STEPS)}
    for name, dtype in dict.fromkeys((p.engine, p.dtype) for p in points):
        line = [p for p in points if (p.engine, p.dtype) == (name, dtype) and np.isfinite(p.error)]
        style = {"color": colours[name], "ls": "-" if dtype == "float64" else ":", "marker": "o", "ms": 4}
        label = {"limit": "hand-written C, RK4", "exact": "hand-written C, exact"}.get(name, name)
        axes.loglog([p.seconds for p in line], [p.error for p in line], label=f"{label}, {dtype}", **style)
    axes.axvline(numpy_seconds, color="k", ls="--", lw=0.8, label="NumPy loop, RK4 at 5e-4 s")
    axes.axvline(1, color="k", ls=":", lw=0.8, label="real time")
    axes.set(xlabel="wall time per gait and simulated second (s)", ylabel="median error after the rollout (m)")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1, 0.5))
    return chart


if __name__ == "__main__":
    run(main, Settings)

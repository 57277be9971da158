"""Error against wall time, and against force evaluations, of every method on four scenes.

Free flight (smooth), drop and settle, a roll at 0.5 Hz and one at 1 Hz, as populations on every core, in float32 and
float64 (the implicit methods, whose equations float32 cannot solve to any use, in float64). Each method is measured
against the converged answer of its own model: the penalty model, or the same robot with rigid struts and exact contact.
The distance between the two models is drawn beside them.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from common import SCENES, measured, run
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import Gait, Outcomes, Scene, gaits_of, load_scene, plot, random_phases, simulate_population
from jaxgrity.files import save_json
from jaxgrity.methods import METHODS

STEPS = {
    "rk4": (2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5),
    "symplectic": (5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4),
    "complementarity": (2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4),
}
"""fixed steps, s"""
TOLERANCES = {
    "tsit5": (1e-3, 1e-4, 1e-5, 1e-6, 1e-7),
    "dopri8": (1e-3, 1e-4, 1e-5, 1e-6, 1e-7),
    "kvaerno3": (1e-2, 3e-3, 1e-3, 3e-4, 1e-4),
    "kvaerno5": (1e-2, 1e-3, 1e-4, 1e-5, 1e-6),
}
"""of adaptive methods"""
SINGLE_TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 2e-6)
"""of adaptive methods in float32"""
EVALUATIONS = {"rk4": 4, "tsit5": 6, "dopri8": 13, "kvaerno3": 3, "kvaerno5": 6, "symplectic": 1, "complementarity": 2}
"""of the forces in a step; of Kvaerno's methods the implicit equations, each of which takes several"""
FEW = 4
"""gaits for the implicit methods, whose steps are dear; costs are given per gait"""
TARGET = 5e-3
"""m, at which the cost of methods is compared"""
COLOURS = {name: f"C{k}" for k, name in enumerate((*EVALUATIONS, "mujoco Euler", "mujoco RK4"))}


@dataclass
class Settings:
    gaits: int = 64
    """population"""
    repeats: int = 3
    """timed runs after a warm-up, of which the median counts; one of implicit methods"""
    mujoco: bool = False
    """measure MuJoCo on the same robot too (needs the extra `peer`)"""
    seed: int = 3
    """of the gaits"""
    out: Path = Path("results/work_precision")
    """folder for work_precision.json and its figure"""
    quick: bool = False
    """free flight alone, RK4 and complementarity in float64"""


class Task(NamedTuple):
    """One scene, as both models see it."""

    name: str
    penalty: Scene
    exact: Scene
    gaits: Gait
    duration: float
    undamped: bool = False


class Point(NamedTuple):
    """One method at one step or tolerance."""

    scene: str
    method: str
    dtype: str
    setting: float
    """step, s, or tolerance"""
    error: float | None
    """median distance of the centres of mass from the model's converged answer, m; None where most gaits failed"""
    failed: int
    seconds: float
    """wall time per gait and simulated second"""
    evaluations: float
    """of the forces, per gait and simulated second"""


def main(settings: Settings) -> None:
    points, apart = [], {}
    chosen = tasks(settings)
    with tqdm(total=len(chosen), desc="scenes", unit="scene") as bar:
        for task in chosen:
            bar.set_postfix(scene=task.name, refresh=True)
            truths = converged(task)
            apart[task.name] = float(np.median(np.linalg.norm(truths[False] - truths[True], axis=1)))
            for method, dtype, options in settings_to_try(task, settings):
                points.append(measure(task, method, dtype, options, truths, settings.repeats))
                bar.set_postfix(scene=task.name, method=method, refresh=True)
            if settings.mujoco:
                points += mujoco_points(task, settings.repeats)
            bar.update()
    costs = cost_at_target(points)
    facts = {
        **measured(),
        "gaits": settings.gaits,
        "models_apart": apart,
        "target": TARGET,
        "cost_at_target": costs,
        "points": [point._asdict() for point in points],
    }
    save_json(settings.out / "work_precision.json", facts)
    plot.save(figure(points, apart), settings.out / "work_precision.png")
    for scene, rows in costs.items():
        print(f"{scene}: microseconds per gait and simulated second at {TARGET:g} m")
        for name, seconds in sorted(rows.items(), key=lambda row: row[1]):
            print(f"    {name:26s} {1e6 * seconds:10.1f}")
    print(f"wrote {settings.out}/work_precision.json and work_precision.png")


def tasks(settings: Settings) -> list[Task]:
    """The four scenes."""
    reference, exact = (load_scene(SCENES / f"{name}.toml") for name in ("reference", "exact"))
    phases = random_phases(settings.gaits, len(reference.gait.members), settings.seed)

    def gaits(frequency: float, amplitude: float) -> Gait:
        ones = np.ones_like(phases)
        return gaits_of(reference.gait, phases, amplitude * ones, frequency * ones)

    flying = [undamped(scene) for scene in (reference, exact)]
    all_tasks = [
        Task("free flight", *flying, gaits(0.5, 0.1), 2.0, undamped=True),
        Task("drop and settle", reference, exact, gaits(0.5, 0.0), 2.0),
        Task("0.5 Hz roll", reference, exact, gaits(0.5, 0.3), 4.0),
        Task("1 Hz roll", reference, exact, gaits(1.0, 0.3), 4.0),
    ]
    return all_tasks[:1] if settings.quick else all_tasks


def undamped(scene: Scene) -> Scene:
    """The robot in the air, with nothing that dissipates, its gait from the start."""
    struts, cables = scene.structure.struts, scene.structure.cables
    members = [eqx.tree_at(lambda m: m.damping, m, None, is_leaf=lambda x: x is None) for m in (struts, cables)]
    structure = eqx.tree_at(lambda s: (s.struts, s.cables), scene.structure, tuple(members))
    gait = eqx.tree_at(lambda g: g.start, scene.gait, np.asarray(0.0))
    return Scene(structure, gravity=scene.gravity, gait=gait)


def converged(task: Task) -> dict[bool, np.ndarray]:
    """Centres of mass at the end, (gaits, 3), m, of the penalty model (False) and the exact one (True)."""
    soft = simulate_population(task.penalty, task.gaits, task.duration, method="dopri8", rtol=1e-10, atol=1e-10)
    hard = simulate_population(task.exact, task.gaits, task.duration, dt=5e-5)
    return {False: np.asarray(soft.com_end), True: np.asarray(hard.com_end)}


def settings_to_try(task: Task, settings: Settings) -> Iterator[tuple[str, str, dict]]:
    """Method, precision and step or tolerance."""
    for name, method in METHODS.items():
        if (method.symplectic and not task.undamped) or (settings.quick and name not in ("rk4", "complementarity")):
            continue
        for dtype in ("float64",) if settings.quick or method.implicit else ("float32", "float64"):
            tolerances = SINGLE_TOLERANCES if dtype == "float32" else TOLERANCES.get(name, ())
            for value in STEPS.get(name, tolerances):
                yield name, dtype, {"dt": value} if name in STEPS else {"rtol": value, "atol": value}


def measure(task: Task, method: str, dtype: str, options: dict, truths: dict, repeats: int) -> Point:
    """Error and cost of one setting."""
    kind = METHODS[method]
    scene, truth = (task.exact if kind.constrained else task.penalty), truths[kind.constrained]
    gaits = task.gaits if not kind.implicit else jax.tree.map(lambda x: x[:FEW] if np.ndim(x) else x, task.gaits)

    def roll() -> Outcomes:
        outcomes = simulate_population(
            scene, gaits, task.duration, method=method, dtype=dtype, any_step=True, **options
        )
        return jax.block_until_ready(outcomes)

    outcomes, seconds = roll(), []
    for _ in range(1 if kind.implicit else repeats):
        start = time.perf_counter()
        outcomes = roll()
        seconds.append(time.perf_counter() - start)
    count = len(outcomes.com_end)
    off = np.linalg.norm(np.asarray(outcomes.com_end, float) - truth[:count], axis=1)
    failed = np.asarray(outcomes.failure) != 0
    per = count * task.duration
    tried = float(np.sum(np.asarray(outcomes.steps) + np.asarray(outcomes.rejected)))
    error = float(np.median(np.where(failed, np.inf, off)))
    return Point(
        task.name,
        method,
        dtype,
        next(iter(options.values())),
        error if np.isfinite(error) else None,
        int(failed.sum()),
        float(np.median(seconds)) / per,
        EVALUATIONS[method] * tried / per,
    )


def mujoco_points(task: Task, repeats: int) -> list[Point]:
    """MuJoCo against itself at a far smaller step: the same masses and springs, its own contacts."""
    from peer import roll

    phases = np.asarray(task.gaits.phase)[:16]
    scene = eqx.tree_at(
        lambda s: (s.gait.amplitude, s.gait.frequency),
        task.penalty,
        (np.asarray(task.gaits.amplitude)[0], np.asarray(task.gaits.frequency)[0]),
    )
    truth, _ = roll(scene, phases, task.duration, 5e-5, "RK4")
    points = []
    for integrator, evaluations in (("Euler", 1), ("RK4", 4)):
        for dt in (3e-3, 2e-3, 1e-3, 5e-4, 2e-4):
            runs = [roll(scene, phases, task.duration, dt, integrator) for _ in range(repeats)]
            off = np.linalg.norm(runs[0][0] - truth, axis=1)
            error = float(np.median(np.where(np.isfinite(off), off, np.inf)))
            seconds = float(np.median([wall for _, wall in runs])) / (len(phases) * task.duration)
            usable = error if np.isfinite(error) and error < 10 else None
            points.append(Point(task.name, f"mujoco {integrator}", "float64", dt, usable, 0, seconds, evaluations / dt))
    return points


def cost_at_target(points: list[Point]) -> dict[str, dict[str, float]]:
    """Wall time, s per gait and simulated second, of the cheapest setting whose error is at most `TARGET`."""
    costs: dict[str, dict[str, float]] = {}
    for point in points:
        row, name = costs.setdefault(point.scene, {}), f"{point.method} {point.dtype}"
        if point.error is not None and point.error <= TARGET:
            row[name] = min(point.seconds, row.get(name, np.inf))
    return costs


def figure(points: list[Point], apart: dict[str, float]) -> Figure:
    """A column for each scene; above: against wall time, below: against force evaluations."""
    scenes = list(dict.fromkeys(point.scene for point in points))
    chart = Figure(figsize=(4.6 * len(scenes), 8), layout="constrained")
    panels = chart.subplots(2, len(scenes), squeeze=False)
    for column, scene in enumerate(scenes):
        for (method, dtype), line in lines(points, scene).items():
            style = {"color": COLOURS[method], "ls": "-" if dtype == "float64" else ":", "marker": "o", "ms": 3.5}
            for axes, cost in ((panels[0, column], "seconds"), (panels[1, column], "evaluations")):
                axes.loglog(
                    [getattr(p, cost) for p in line], [p.error for p in line], label=f"{method} {dtype}", **style
                )
        for axes in panels[:, column]:
            axes.axhline(apart[scene], color="k", ls="--", lw=0.8)
            axes.text(0.02, apart[scene], "models apart", transform=axes.get_yaxis_transform(), va="bottom", fontsize=8)
            axes.set_ylabel("median error, m")
        panels[0, column].set(title=scene, xlabel="wall time per gait and simulated second, s")
        panels[1, column].set(xlabel="force evaluations per gait and simulated second")
    panels[0, 0].legend(fontsize=7)
    return chart


def lines(points: list[Point], scene: str) -> dict[tuple[str, str], list[Point]]:
    """The points of a scene by method and precision, those without an error left out."""
    found: dict[tuple[str, str], list[Point]] = {}
    for point in points:
        if point.scene == scene and point.error is not None:
            found.setdefault((point.method, point.dtype), []).append(point)
    return found


if __name__ == "__main__":
    run(main, Settings)

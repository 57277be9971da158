"""Error against wall time, and against force evaluations, of every method on four scenes.

Free flight (smooth), drop and settle, a roll at 0.5 Hz and one at 1 Hz, as populations on every core, in float32 and
float64 (the implicit methods, whose equations float32 cannot solve to any use, in float64). Each method is measured
against the converged answer of its own model: the penalty model, or the same robot with rigid struts and exact contact.
The distance between the two models is drawn beside them.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from jaxgrity.cli.script import measured, run

import equinox as eqx
import jax
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm
from work_precision_tasks import Task, tasks

from jaxgrity import METHODS, InputError, Outcomes, SolverOptions, simulate_population
from jaxgrity.io.files import save_json
from jaxgrity.report import plot

STEPS = {
    "rk4": (2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5),
    "verlet": (5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4),
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
EVALUATIONS = {"rk4": 4, "tsit5": 6, "dopri8": 13, "kvaerno3": 3, "kvaerno5": 6, "verlet": 1, "complementarity": 2}
"""of the forces in a step; of Kvaerno's methods the implicit equations, each of which takes several"""
FEW = 4
"""gaits for the implicit methods, whose steps cost much; costs are given per gait"""
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
    """folder for a JSON and a figure of each scene"""
    scenes: tuple[str, ...] = ()
    """those to measure, by name; all, where none are given"""
    quick: bool = False
    """free flight alone, RK4 and complementarity in float64"""


class Point(NamedTuple):
    """One method at one step or tolerance."""

    method: str
    dtype: str
    setting: float
    """step, s, or tolerance"""
    error: float | None
    """median distance from the model's converged answer, m; None where most gaits failed"""
    failed: int
    seconds: float
    """wall time per gait and simulated second"""
    evaluations: float
    """of the forces, per gait and simulated second"""


def main(settings: Settings) -> None:
    known = tasks(settings.gaits, settings.seed)[: 1 if settings.quick else None]
    chosen = [task for task in known if not settings.scenes or task.name in settings.scenes]
    if not chosen:
        raise InputError(f"scenes = {settings.scenes}: expected some of {[task.name for task in known]}")
    with tqdm(total=len(chosen), desc="scenes", unit="scene") as bar:
        for task in chosen:
            points, truths = [], converged(task)
            for options in options_to_try(task, settings):
                bar.set_postfix(scene=task.name, method=options.method, refresh=True)
                points.append(measure(task, options, truths, settings.repeats))
            if settings.mujoco:
                points += mujoco_points(task, settings.repeats)
            leave(task, points, float(np.median(distance(truths[False], truths[True]))), settings, bar.write)
            bar.update()


def leave(task: Task, points: list[Point], apart: float, settings: Settings, say: Callable) -> None:
    """The scene's JSON and figure, and the cheapest settings for people."""
    costs, name = cost_at_target(points), task.name.replace(" ", "_")
    facts = {
        **measured(),
        "scene": task.name,
        "error_of": "all nodes, root mean square" if task.nodes else "the centre of mass",
        "gaits": settings.gaits,
        "models_apart": apart,
        "target": TARGET,
        "cost_at_target": costs,
        "points": [point._asdict() for point in points],
    }
    save_json(settings.out / f"{name}.json", facts)
    plot.save(figure(points, facts), settings.out / f"{name}.png")
    say(f"{task.name}: microseconds per gait and simulated second at {TARGET:g} m; wrote {settings.out}/{name}.json")
    for method, seconds in costs.items():
        say(f"    {method:26s} {1e6 * seconds:10.1f}")


def converged(task: Task) -> dict[bool, np.ndarray]:
    """Where the penalty model's robots (False) and the exact one's (True) end: `ends`."""
    tight = SolverOptions("dopri8", rtol=1e-10, atol=1e-10)
    soft = simulate_population(task.penalty, task.gaits, task.duration, options=tight)
    hard = simulate_population(task.exact, task.gaits, task.duration, options=SolverOptions(dt=5e-5))
    return {False: ends(task, soft.positions), True: ends(task, hard.positions)}


def ends(task: Task, positions) -> np.ndarray:
    """(gaits, points, 3), m: of all nodes, or of the centre of mass alone."""
    q = np.asarray(positions, float)
    mass = np.asarray(task.penalty.structure.node_mass)
    return q if task.nodes else np.einsum("n,gnk->gk", mass / mass.sum(), q)[:, None]


def distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(gaits,), m, root mean square over the points."""
    return np.sqrt(np.mean(np.sum((a - b) ** 2, axis=-1), axis=-1))


def options_to_try(task: Task, settings: Settings) -> Iterator[SolverOptions]:
    """Every method in every precision at every step or tolerance."""
    for name, method in METHODS.items():
        if (method.symplectic and not task.undamped) or (settings.quick and name not in ("rk4", "complementarity")):
            continue
        for dtype in ("float64",) if settings.quick or method.implicit else ("float32", "float64"):
            tolerances = SINGLE_TOLERANCES if dtype == "float32" else TOLERANCES.get(name, ())
            for value in STEPS.get(name, tolerances):
                size = {"dt": value} if name in STEPS else {"rtol": value, "atol": value}
                yield SolverOptions(name, dtype=dtype, any_step=True, **size)


def measure(task: Task, options: SolverOptions, truths: dict, repeats: int) -> Point:
    """Error and cost of one setting."""
    kind = METHODS[options.method]
    scene, truth = (task.exact if kind.constrained else task.penalty), truths[kind.constrained]
    gaits = task.gaits if not kind.implicit else jax.tree.map(lambda x: x[:FEW] if np.ndim(x) else x, task.gaits)

    def roll() -> Outcomes:
        return jax.block_until_ready(simulate_population(scene, gaits, task.duration, options=options))

    outcomes, seconds = roll(), []
    for _ in range(1 if kind.implicit else repeats):
        start = time.perf_counter()
        outcomes = roll()
        seconds.append(time.perf_counter() - start)
    count = len(outcomes.com_end)
    off = distance(ends(task, outcomes.positions), truth[:count])
    failed = np.asarray(outcomes.failure) != 0
    per = count * task.duration
    tried = float(np.sum(np.asarray(outcomes.steps) + np.asarray(outcomes.rejected)))
    error = float(np.median(np.where(failed, np.inf, off)))
    return Point(
        options.method,
        options.dtype,
        options.rtol if options.dt is None else options.dt,
        error if np.isfinite(error) else None,
        int(failed.sum()),
        float(np.median(seconds)) / per,
        EVALUATIONS[options.method] * tried / per,
    )


def mujoco_points(task: Task, repeats: int) -> list[Point]:
    """MuJoCo against itself at a far smaller step: the same masses and springs, its own contacts."""
    from mujoco_peer import roll

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
            off = distance(ends(task, runs[0][0]), ends(task, truth))
            error = float(np.median(np.where(np.isfinite(off), off, np.inf)))
            seconds = float(np.median([wall for _, wall in runs])) / (len(phases) * task.duration)
            usable = error if np.isfinite(error) and error < 10 else None
            points.append(Point(f"mujoco {integrator}", "float64", dt, usable, 0, seconds, evaluations / dt))
    return points


def cost_at_target(points: list[Point]) -> dict[str, float]:
    """Wall time, s per gait and simulated second, of each method's cheapest setting with an error of at most `TARGET`,
    cheapest first."""
    costs: dict[str, float] = {}
    for point in points:
        name = f"{point.method} {point.dtype}"
        if point.error is not None and point.error <= TARGET:
            costs[name] = min(point.seconds, costs.get(name, np.inf))
    return dict(sorted(costs.items(), key=lambda item: item[1]))


@plot.styled
def figure(points: list[Point], facts: dict) -> Figure:
    """Error against wall time, and against force evaluations."""
    chart = Figure(figsize=(12.5, 5.2), layout="constrained")
    panels = chart.subplots(1, 2, sharey=True)
    for (method, dtype), line in lines(points).items():
        style = {"color": COLOURS[method], "ls": "-" if dtype == "float64" else ":", "marker": "o", "ms": 3.5}
        for axes, cost in zip(panels, ("seconds", "evaluations")):
            axes.loglog([getattr(p, cost) for p in line], [p.error for p in line], label=f"{method} {dtype}", **style)
    for axes in panels:
        axes.axhline(facts["models_apart"], color="k", ls="--", lw=0.8)
        place = (0.02, facts["models_apart"])
        axes.text(*place, "models apart", transform=axes.get_yaxis_transform(), va="bottom", fontsize=8)
        axes.grid(alpha=0.3)
    panels[0].set(
        xlabel="wall time per gait and simulated second (s)", ylabel=f"median error of {facts['error_of']} (m)"
    )
    panels[1].set(xlabel="force evaluations per gait and simulated second")
    panels[1].legend(fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5))
    chart.suptitle(facts["scene"])
    return chart


def lines(points: list[Point]) -> dict[tuple[str, str], list[Point]]:
    """The points by method and precision, those without an error left out."""
    found: dict[tuple[str, str], list[Point]] = {}
    for point in points:
        if point.error is not None:
            found.setdefault((point.method, point.dtype), []).append(point)
    return found


if __name__ == "__main__":
    run(main, Settings)

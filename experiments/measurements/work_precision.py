"""Error against wall time, and against force evaluations, of every method on four scenes.

Free flight (smooth), drop and settle, a roll at 0.5 Hz and one at 1 Hz, as populations on every core, in float32 and
float64 (the implicit methods, whose equations float32 cannot solve to any use, in float64). Each method is measured
against the converged answer of its own model: the penalty model, or the same robot with rigid struts and exact contact.
The distance between the two models is drawn beside them.
"""

from collections.abc import Iterator
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np
from measurements.engines import clock
from measurements.measurement import Figure, Record, measurement
from measurements.pages import by_name, short, table

from jaxgrity import (
    METHODS,
    Gait,
    Scene,
    SolverOptions,
    gaits_of,
    load_scene,
    random_phases,
    simulate_population,
)

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
LOOKS = {
    name: {"color": colour, "marker": marker}
    for name, colour, marker in zip(
        (*EVALUATIONS, "mujoco Euler", "mujoco RK4"),
        ("C0", "C1", "C2", "C3", "C4", "C5", "C6", "C7", "saddlebrown"),
        "os^Dv<>PX",
    )
}
"""of the lines"""


@measurement(
    page="accuracy.md",
    quick={
        "scene": ("free flight",), "methods": ("rk4", "complementarity"), "precisions": ("float64",), "mujoco": False,
    },
    raw=("rows",),
    drawn=("lines",),
)  # fmt: skip
def work_precision(
    scene: Literal["free flight", "drop and settle", "0.5 Hz roll", "1 Hz roll"],
    gaits: int = 64,
    repeats: int = 3,
    mujoco: bool = True,
    methods: tuple[str, ...] = tuple(METHODS),
    precisions: tuple[Literal["float32", "float64"], ...] = ("float32", "float64"),
    seed: int = 3,
) -> Iterator[Record]:
    """A row for each method at each step or tolerance.

    Args:
        scene: what moves
        gaits: population
        repeats: timed runs after a warm-up, of which the median counts; one of implicit methods
        mujoco: measure MuJoCo on the same robot too (needs the extra `peer`)
        methods: by name
        precisions: of explicit methods
        seed: of the gaits
    """
    task = next(task for task in tasks(gaits, seed) if task.name == scene)
    rows, truths = [], converged(task)
    for options in options_to_try(task, methods, precisions):
        rows.append(measure(task, options, truths, repeats))
        yield rows[-1]
    for row in mujoco_rows(task, repeats) if mujoco else ():
        rows.append(row)
        yield row
    return {
        "scene": scene,
        "error_of": "all nodes, root mean square" if task.nodes else "the centre of mass",
        "models_apart": float(np.median(distance(truths[False], truths[True]))),
        "target": TARGET,
        "cost_at_target": cost_at_target(rows),
        "lines": lines_of([row for row in rows if row["error"] is not None]),
    }


@work_precision.table
def words(record: Record) -> str:
    """What was allowed, and the cheapest setting of each method within that."""
    costs = record["cost_at_target"]
    cheapest = min(costs.values())
    head = ["error of", "largest median allowed, mm", "distance of the two models, mm"]
    about = [record["error_of"], f"{1e3 * record['target']:g}", short(1e3 * record["models_apart"])]
    rows = []
    for method in dict.fromkeys(name.rpartition(" ")[0] for name in costs):
        found = [costs.get(f"{method} {dtype}") for dtype in ("float32", "float64")]
        best = min(cost for cost in found if cost is not None) / cheapest
        rows.append([method, *("-" if cost is None else short(1e3 * cost) for cost in found), short(best)])
    costs_head = ["method", "float32, ms", "float64, ms", "times the cheapest"]
    return f"{table(head, [about])}\n\n{table(costs_head, rows)}"


class Task(NamedTuple):
    """One scene, as both models see it."""

    name: str
    penalty: Scene
    exact: Scene
    gaits: Gait
    duration: float
    undamped: bool = False
    nodes: bool = False
    """the error is that of all nodes: in the air a centre of mass falls as it must, however wrong the robot's shape"""


def tasks(count: int, seed: int) -> list[Task]:
    """The four scenes, with so many random gaits."""
    reference, exact = (load_scene(name) for name in ("reference", "exact"))
    phases = random_phases(count, len(reference.gait.members), seed)

    def gaits(frequency: float, amplitude: float) -> Gait:
        ones = np.ones_like(phases)
        return gaits_of(reference.gait, phases, amplitude * ones, frequency * ones)

    flying = [undamped(scene) for scene in (reference, exact)]
    return [
        Task("free flight", *flying, gaits(0.5, 0.1), 2.0, undamped=True, nodes=True),
        Task("drop and settle", reference, exact, gaits(0.5, 0.0), 2.0),
        Task("0.5 Hz roll", reference, exact, gaits(0.5, 0.3), 4.0),
        Task("1 Hz roll", reference, exact, gaits(1.0, 0.3), 4.0),
    ]


def undamped(scene: Scene) -> Scene:
    """The robot in the air, with nothing that dissipates, its gait from the start."""
    struts, cables = scene.structure.struts, scene.structure.cables
    members = [eqx.tree_at(lambda m: m.damping, m, None, is_leaf=lambda x: x is None) for m in (struts, cables)]
    structure = eqx.tree_at(lambda s: (s.struts, s.cables), scene.structure, tuple(members))
    gait = eqx.tree_at(lambda g: g.start, scene.gait, np.asarray(0.0))
    return Scene(structure, gravity=scene.gravity, gait=gait)


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


def options_to_try(task: Task, methods: tuple[str, ...], precisions: tuple[str, ...]) -> Iterator[SolverOptions]:
    """Every method in every precision at every step or tolerance."""
    for name in methods:
        if METHODS[name].symplectic and not task.undamped:
            continue
        for dtype in ("float64",) if METHODS[name].implicit else precisions:
            tolerances = SINGLE_TOLERANCES if dtype == "float32" else TOLERANCES.get(name, ())
            for value in STEPS.get(name, tolerances):
                size = {"dt": value} if name in STEPS else {"rtol": value, "atol": value}
                yield SolverOptions(name, dtype=dtype, any_step=True, **size)


def row_of(method: str, dtype: str, setting: float, error: float | None, **cost: float) -> Record:
    """One method at one step (s) or tolerance.

    Its error is the median distance from the model's converged answer, m; None where most gaits failed. `seconds` of
    wall time and `evaluations` of the forces are per gait and simulated second.
    """
    return {"method": method, "dtype": dtype, "setting": setting, "error": error, **cost}


def measure(task: Task, options: SolverOptions, truths: dict, repeats: int) -> Record:
    """Error and cost of one setting."""
    kind = METHODS[options.method]
    scene, truth = (task.exact if kind.constrained else task.penalty), truths[kind.constrained]
    gaits = task.gaits if not kind.implicit else jax.tree.map(lambda x: x[:FEW] if np.ndim(x) else x, task.gaits)
    roll = lambda: simulate_population(scene, gaits, task.duration, options=options)  # noqa: E731
    _, outcomes = clock(roll)
    seconds = [clock(roll)[0] for _ in range(1 if kind.implicit else repeats)]
    count = len(outcomes.com_end)
    off = distance(ends(task, outcomes.positions), truth[:count])
    failed = np.asarray(outcomes.failure) != 0
    per = count * task.duration
    tried = float(np.sum(np.asarray(outcomes.steps) + np.asarray(outcomes.rejected)))
    error = float(np.median(np.where(failed, np.inf, off)))
    return row_of(
        options.method,
        options.dtype,
        options.rtol if options.dt is None else options.dt,
        error if np.isfinite(error) else None,
        failed=int(failed.sum()),
        seconds=float(np.median(seconds)) / per,
        evaluations=EVALUATIONS[options.method] * tried / per,
    )


def mujoco_rows(task: Task, repeats: int) -> Iterator[Record]:
    """MuJoCo against itself at a far smaller step: the same masses and springs, its own contacts."""
    from measurements.mujoco_peer import roll

    phases = np.asarray(task.gaits.phase)[:16]
    scene = eqx.tree_at(
        lambda s: (s.gait.amplitude, s.gait.frequency),
        task.penalty,
        (np.asarray(task.gaits.amplitude)[0], np.asarray(task.gaits.frequency)[0]),
    )
    truth, _ = roll(scene, phases, task.duration, 5e-5, "RK4")
    for integrator, evaluations in (("Euler", 1), ("RK4", 4)):
        for dt in (3e-3, 2e-3, 1e-3, 5e-4, 2e-4):
            runs = [roll(scene, phases, task.duration, dt, integrator) for _ in range(repeats)]
            off = distance(ends(task, runs[0][0]), ends(task, truth))
            error = float(np.median(np.where(np.isfinite(off), off, np.inf)))
            seconds = float(np.median([wall for _, wall in runs])) / (len(phases) * task.duration)
            usable = error if np.isfinite(error) and error < 10 else None
            cost = {"seconds": seconds, "evaluations": evaluations / dt}
            yield row_of(f"mujoco {integrator}", "float64", dt, usable, failed=0, **cost)


def cost_at_target(rows: list[Record]) -> dict[str, float]:
    """Wall time, s per gait and simulated second, of each method's cheapest setting with an error of at most `TARGET`,
    cheapest first."""
    costs: dict[str, float] = {}
    for row in rows:
        name = f"{row['method']} {row['dtype']}"
        if row["error"] is not None and row["error"] <= TARGET:
            costs[name] = min(row["seconds"], costs.get(name, np.inf))
    return dict(sorted(costs.items(), key=lambda item: item[1]))


def lines_of(rows: list[Record]) -> Record:
    """Errors and costs of each method in each precision."""
    found: dict[str, list[Record]] = {}
    for row in rows:
        found.setdefault(f"{row['method']} {row['dtype']}", []).append(row)
    return {name: by_name(mine, "error", "seconds", "evaluations") for name, mine in found.items()}


@work_precision.figure(9)
def figure(record: Record, chart: Figure) -> None:
    """Error against wall time, and against force evaluations."""
    panels, apart = chart.subplots(2), record["models_apart"]
    for name, line in record["lines"].items():
        method, _, dtype = name.rpartition(" ")
        style = LOOKS[method] | {"ms": 5} | ({} if dtype == "float64" else {"mfc": "white", "ls": ":"})
        for axes, cost in zip(panels, ("seconds", "evaluations")):
            axes.loglog(line[cost], line["error"], label=f"{method}, {dtype}", **style)
    for axes in panels:
        axes.axhline(apart, color="black", ls="--", lw=1.2, label="distance of the two models")
        axes.set(ylabel=f"median error of {record['error_of']} (m)")
    panels[0].set(xlabel="wall time per gait and simulated second (s)", title=record["scene"])
    panels[1].set(xlabel="force evaluations per gait and simulated second")
    chart.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)

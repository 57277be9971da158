"""Every method on every hard case: right, refused, or flagged. Never a silent NaN, never a silently wrong number.

A cell is right where the error bar, from smaller steps or tolerances, covers the true error; the truth is the method's
own model at a far smaller step or tolerance. Rollouts whose bar is wider than 1 cm are flagged by it. Complementarity
stepping gets the case with rigid struts and exact contact, where that makes sense; all others the penalty model.
"""

import multiprocessing
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from jaxgrity.cli.script import configure, measured, run

import numpy as np
from cases import CASES, Case
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from tqdm import tqdm

from jaxgrity import FAILURES, METHODS, InputError, SolverOptions, Trajectory, refinement_bar, simulate
from jaxgrity.io.files import save_json
from jaxgrity.report import plot
from jaxgrity.stepping import ResolvedOptions, find_method, resolve

USEFUL = 1e-2
"""m: a wider error bar says that the number is of no use"""
MOST_IMPLICIT_STEPS = 1_500
"""of which each takes milliseconds"""
TOLERANCE = {"float64": 1e-6, "float32": 1e-5}
"""of adaptive methods"""
COLOURS = {"right": "#cfe8cf", "flagged": "#fbe7b2", "refused": "#dddddd", "WRONG": "#f4a6a6"}


@dataclass
class Settings:
    methods: tuple[str, ...] = tuple(METHODS)
    """which methods"""
    cases: tuple[str, ...] = ()
    """which cases, by their names; all, where not given"""
    out: Path = Path("results/hard_cases")
    """folder for hard_cases.json and hard_cases.png"""
    quick: bool = False
    """three cases, three methods"""


class Cell(NamedTuple):
    """What became of one method on one case."""

    verdict: str
    """right, flagged, refused or WRONG"""
    error: float | None
    """true error of the nodes at the end, root mean square, m"""
    bar: float | None
    """the error bar that was reported, m"""
    reason: str


def main(settings: Settings) -> None:
    names, methods = settings.cases or tuple(CASES), settings.methods
    if settings.quick:
        names, methods = (
            ("start 5 cm below ground", "incline 0.1 % above", "spinning at 50 rad/s"),
            methods[:1] + methods[-2:],
        )
    for name in names:
        if name not in CASES:
            raise InputError(f"cases = {name!r}: unknown; expected some of {', '.join(CASES)}")
    for method in methods:
        find_method(method)
    rows: dict[str, dict[str, dict[str, Cell]]] = {name: {"float64": {}, "float32": {}} for name in names}
    pairs = [(name, method) for name in names for method in methods]
    # a few in each process: a thousand compiled programs do not fit into one
    most = None if settings.quick else 4
    pool = multiprocessing.get_context("spawn").Pool(len(os.sched_getaffinity(0)), configure, maxtasksperchild=most)
    with pool, tqdm(total=len(pairs), desc="cases", unit="cell") as progress:
        for name, method, cells in pool.imap_unordered(one, pairs):
            for dtype, cell in cells.items():
                rows[name][dtype][method] = cell
            progress.update()
    cells = [cell for row in rows.values() for kind in row.values() for cell in kind.values()]
    counts = {verdict: sum(cell.verdict == verdict for cell in cells) for verdict in COLOURS}
    table = {
        name: {dtype: {method: kind[method]._asdict() for method in methods} for dtype, kind in row.items()}
        for name, row in rows.items()
    }
    facts = {**measured(), "most_implicit_steps": MOST_IMPLICIT_STEPS, "counts": counts, "table": table}
    save_json(settings.out / "hard_cases.json", facts)
    plot.save(figure(rows, methods), settings.out / "hard_cases.png")
    print(", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
    print(f"wrote {settings.out}/hard_cases.json and hard_cases.png")
    if counts["WRONG"]:
        sys.exit(1)


def one(pair: tuple[str, str]) -> tuple[str, str, dict[str, Cell]]:
    """`both`, by the names of case and method."""
    return *pair, both(CASES[pair[0]](), pair[1])


def both(case: Case, method: str) -> dict[str, Cell]:
    """The cells of float64 and float32, which share their refinements and their truth."""
    chosen = find_method(method)
    scene = case.exact if chosen.constrained and case.exact is not None else case.scene
    duration = case.short if case.short and chosen.implicit else case.duration
    start = {"velocities": case.velocities} if case.velocities is not None else {}

    def roll(options: ResolvedOptions, precision: str) -> Trajectory:
        most = MOST_IMPLICIT_STEPS if options.method.implicit else 10**6
        options = replace(options, dtype=precision, max_steps=most)
        return simulate(scene, duration, options=options, frame_rate=1 / duration, **start)

    found, cache = {}, {}
    for dtype in ("float64", "float32"):
        try:
            tolerances = (TOLERANCE[dtype],) * 2 if chosen.adaptive else (None, None)
            steps = resolve(scene, duration, SolverOptions(method, None, dtype, *tolerances)).refined()
        except InputError as error:
            found[dtype] = Cell("refused", None, None, str(error))
            continue
        trajectory = roll(steps[0], dtype)
        finer = []
        for options in steps[1:]:
            key = (options.dt, options.rtol, options.atol)
            cache[key] = cache.get(key) or roll(options, "float64")
            finer.append(cache[key])
        if "truth" not in cache:
            cache["truth"] = roll(finest(case, steps[0]), "float64")
        found[dtype] = judge([trajectory, *finer], cache["truth"])
    return found


def finest(case: Case, options: ResolvedOptions) -> ResolvedOptions:
    """The options that give the model's own converged answer."""
    if options.method.constrained:
        return replace(options, dt=options.dt / 16)
    return resolve(case.scene, case.duration, SolverOptions("dopri8", dtype="float64", rtol=1e-11, atol=1e-11))


def judge(runs: list[Trajectory], true: Trajectory) -> Cell:
    """Right, flagged or WRONG."""
    if runs[0].failed:
        return Cell("flagged", None, None, FAILURES[int(runs[0].failure)])
    ends = [np.asarray(run.positions[-1], float) for run in runs]
    if any(run.failed for run in runs):
        return Cell("flagged", None, np.inf, "its refinement failed: no error bar")
    size = np.sqrt(len(ends[0]))
    bar = float(refinement_bar(*(end.ravel() for end in ends))) / size + 1e-15
    if true.failed:
        return Cell("flagged", None, bar, "no converged answer to compare with")
    error = float(np.linalg.norm(ends[0] - np.asarray(true.positions[-1], float))) / size
    if error > max(bar, 1e-12):
        return Cell("WRONG", error, bar, "the error bar does not cover the error")
    if bar > USEFUL:
        return Cell("flagged", error, bar, "its error bar is wider than 1 cm")
    return Cell("right", error, bar, "")


def text(cell: Cell) -> str:
    """A cell in a few words."""
    if cell.verdict == "refused":
        return "refused"
    if cell.error is None:
        return f"{cell.verdict}: {cell.reason}"
    return f"{cell.error:.0e} (bar {cell.bar:.0e})"


@plot.styled
def figure(rows: dict, methods: tuple[str, ...]) -> Figure:
    """The table as a picture: green is right, yellow flagged, grey refused, red silently wrong."""
    chart = Figure(figsize=(2.2 + 2.2 * len(methods), 1.2 + 0.55 * len(rows)), layout="constrained")
    axes = chart.subplots()
    axes.set(xlim=(0, len(methods)), ylim=(len(rows), 0), xticks=np.arange(len(methods)) + 0.5)
    axes.set_xticklabels(methods)
    axes.set_yticks(np.arange(len(rows)) + 0.5, list(rows))
    axes.xaxis.tick_top()
    for y, row in enumerate(rows.values()):
        for x, method in enumerate(methods):
            for part, dtype in enumerate(("float64", "float32")):
                cell = row[dtype][method]
                place = (x, y + part / 2)
                axes.add_patch(Rectangle(place, 1, 0.5, facecolor=COLOURS[cell.verdict], edgecolor="white"))
                label = text(cell) if cell.error is not None else cell.verdict
                axes.text(x + 0.5, y + part / 2 + 0.25, label, ha="center", va="center", fontsize=6.5)
    axes.set_title("top: float64, bottom: float32; true error (error bar), m")
    return chart


if __name__ == "__main__":
    run(main, Settings)

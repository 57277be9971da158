"""Every method on every hard case: right, refused, or flagged. Never a silent NaN, never a silently wrong number.

A cell is right where the error bar, from smaller steps or tolerances, covers the true error; the truth is the method's
own model at a far smaller step or tolerance. Rollouts whose bar is wider than 1 cm are flagged by it. Complementarity
stepping gets the case with rigid struts and exact contact, where that makes sense; all others the penalty model.
"""

import multiprocessing
import os
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from jaxgrity.cli.script import configure

import numpy as np
from matplotlib.patches import Rectangle
from measurements.measurement import Figure, Record, check_names, measurement
from measurements.pages import table
from studies.cases import CASES, Case

from jaxgrity import FAILURES, METHODS, InputError, SolverOptions, Trajectory, refinement_bar, simulate
from jaxgrity.stepping import ResolvedOptions, find_method, resolve

USEFUL = 1e-2
"""m: a wider error bar says that the number is of no use"""
MOST_IMPLICIT_STEPS = 1_500
"""of which each takes milliseconds"""
TOLERANCE = {"float64": 1e-6, "float32": 1e-5}
"""of adaptive methods"""
COLOURS = {"right": "#cfe8cf", "flagged": "#fbe7b2", "refused": "#dddddd", "WRONG": "#f4a6a6"}


class Cell(NamedTuple):
    """What became of one method on one case."""

    verdict: str
    """right, flagged, refused or WRONG"""
    error: float | None
    """true error of the nodes at the end, root mean square, m"""
    bar: float | None
    """the error bar that was reported, m"""
    reason: str

    def told(self) -> Record | str:
        """Error and error bar, m, with the verdict where it is not "right"; or what became of the rollout."""
        if self.verdict == "refused":
            return "refused"
        if self.error is None:
            return f"{self.verdict}: {self.reason}"
        found = {"error": self.error, "bar": self.bar}
        return found if self.verdict == "right" else found | {"verdict": self.verdict}


@measurement(
    page="accuracy.md",
    quick={
        "methods": ("rk4", "verlet", "complementarity"),
        "cases": ("start 5 cm below ground", "incline 0.1 % above", "spinning at 50 rad/s"),
    },
)
def hard_cases(methods: tuple[str, ...] = tuple(METHODS), cases: tuple[str, ...] = ()) -> Iterator[Record]:
    """A row for each case and precision; why a method refuses some cases stands once.

    Args:
        methods: which methods
        cases: which cases, by their names; all, where not given
    """
    check_names("cases", cases, CASES)
    for method in methods:
        find_method(method)
    counts, refused = dict.fromkeys(COLOURS, 0), set()
    pairs = [(name, method) for name in cases or CASES for method in methods]
    # a few in each process: a thousand compiled programs do not fit into one
    pool = multiprocessing.get_context("spawn").Pool(len(os.sched_getaffinity(0)), configure, maxtasksperchild=4)
    with pool:
        found = pool.imap(one, pairs)
        for name in cases or CASES:
            row = {method: next(found) for method in methods}
            for dtype in ("float64", "float32"):
                yield {"case": name, "dtype": dtype} | {method: cells[dtype].told() for method, cells in row.items()}
            for method, cells in row.items():
                for cell in cells.values():
                    counts[cell.verdict] += 1
                    refused |= {(method, cell.reason)} if cell.verdict == "refused" else set()
    reasons = [{"method": method, "reason": reason} for method, reason in sorted(refused)]
    return {"counts": counts, "refused": reasons}


@hard_cases.table
def words(record: Record) -> str:
    """How many rollouts have which verdict."""
    counts = {name.lower(): count for name, count in record["counts"].items()}
    return table(list(counts), [[str(count) for count in counts.values()]])


@hard_cases.table(part="all")
def every(record: Record) -> str:
    """Every rollout, and why some cases are refused."""
    found, methods = [], methods_of(record)
    for dtype in ("float64", "float32"):
        rows = [row for row in record["rows"] if row["dtype"] == dtype]
        for step, some in steps_of(methods).items():
            cells = [[row["case"], *(text(row[method]) for method in some)] for row in rows]
            found.append(f"**{dtype}, {step}**, error in m\n\n{table(['case', *some], cells)}")
    found.append(table(["method", "why it refuses"], [[row["method"], row["reason"]] for row in record["refused"]]))
    return "\n\n".join(found)


def steps_of(methods: list[str]) -> dict[str, list[str]]:
    """Methods whose step is fixed, and those that adapt it; only kinds that there are."""
    adapted = [each for each in methods if find_method(each).adaptive is not None]
    found = {"fixed step": [each for each in methods if each not in adapted], "adapted step": adapted}
    return {kind: some for kind, some in found.items() if some}


def methods_of(record: Record) -> list[str]:
    """The methods of a record."""
    return [name for name in record["rows"][0] if name not in ("case", "dtype")]


def text(cell: Record | str) -> str:
    """A cell in a few words."""
    if isinstance(cell, str):
        return cell
    verdict = f"{cell['verdict']}: " if "verdict" in cell else ""
    return f"{verdict}{cell['error']:.0e} (bar {cell['bar']:.0e})"


def one(pair: tuple[str, str]) -> dict[str, Cell]:
    """`both`, by the names of case and method."""
    return both(CASES[pair[0]](), pair[1])


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


@hard_cases.figure()
def figure(record: Record, chart: Figure) -> None:
    """The verdicts of the table as colours, float64 above float32."""
    rows, methods = record["rows"], methods_of(record)
    names = list(dict.fromkeys(row["case"] for row in rows))
    chart.set_figheight(1.3 + 0.26 * len(names))
    axes = chart.subplots()
    axes.set(xlim=(0, len(methods)), ylim=(len(names), 0), title="top half: float64, bottom half: float32")
    axes.set_xticks(np.arange(len(methods)) + 0.5, methods, rotation=20, ha="right")
    axes.set_yticks(np.arange(len(names)) + 0.5, names)
    axes.grid(False)
    for row in rows:
        y = names.index(row["case"]) + (row["dtype"] == "float32") / 2
        for x, method in enumerate(methods):
            cell = row[method]
            verdict = cell.partition(":")[0] if isinstance(cell, str) else cell.get("verdict", "right")
            axes.add_patch(Rectangle((x, y), 1, 0.5, facecolor=COLOURS[verdict], edgecolor="white"))
    verdicts = [Rectangle((0, 0), 1, 1, facecolor=colour, label=verdict) for verdict, colour in COLOURS.items()]
    chart.legend(handles=verdicts, loc="outside lower center", ncols=len(verdicts))

"""How well a rolling robot's parameters are identified from what a motion capture system would see of it.

The six-strut robot is thrown over the ground, with stiffnesses, dampings, a mass and a friction that differ from the
scene's, and all nodes are seen 100 times a second with 2 mm of noise. Where it starts, and how fast, is not known.
"""

import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from measurements.measurement import Figure, Record, check_names, measurement
from measurements.pages import table

from jaxgrity import InputError, SolverOptions, load_scene, simulate, with_gait
from jaxgrity.identification import Parameter, SeenPositions, Starts, changed, identify, measured_motion

FOUR = (
    Parameter("structure.cables.stiffness", 0.3),
    Parameter("structure.cables.damping", 0.3),
    Parameter("structure.node_mass", 0.3),
    Parameter("friction.mu", 0.3),
)
TEN = (
    *FOUR[:2],
    FOUR[3],
    Parameter("structure.struts.stiffness", 0.3),
    Parameter("structure.struts.damping", 0.3),
    Parameter("structure.cables.rest_length", 0.02),
    Parameter("node_damping", 0.3),
    Parameter("ground.stiffness", 0.3),
    Parameter("ground.dissipation", 0.3),
    Parameter("structure.node_mass", 0.005),  # on scales: masses and all forces alike leave motions as they are
)
WRONG_BY = 2 / 3
"""of its plausible spread is each parameter, at most: uniform in the logarithm"""
FRAME_RATE, NOISE = 100.0, 2e-3
"""1/s; m"""
SETTLING = 3.0
"""s, in which the robot comes to rest before it is thrown"""
JITTER = {False: 0.2, True: 0.5}
"""m/s, of single nodes at the start, without and with a gait"""
JUMP = (3e-5, 3e-4)
"""m and m/s, by which windows may miss each other: the data come from the same laws"""

INTERVAL = 1.96
"""standard errors in half of a 95 % interval"""


STEP = 5e-4
"""Step of the model that is fitted, s; the data are simulated at half of it."""


class Case(NamedTuple):
    """One kind of throw."""

    parameters: tuple[Parameter, ...]
    rolls: bool
    """whether its gait runs"""
    height: float
    """m, from which it is dropped"""
    duration: float
    """s, for which it is seen"""
    windows: int
    share: float
    """of the trials asked for"""
    words: str
    """what the robot does"""


CASES = {
    "rolling": Case(FOUR, True, 0.0, 3.0, 6, 0.2, "rolls by its gait"),
    "ten": Case(TEN, True, 0.0, 3.0, 6, 0.1, "rolls, ten unknown"),
    "dropped": Case(FOUR, False, 0.2, 0.6, 1, 1.0, "is dropped and slides"),
}


@measurement(
    page="identification.md",
    quick={"cases": ("dropped",), "trials": 1, "duration": 0.2, "height": 0.0},
    raw=("rows",),
    drawn=("throws",),
)
def identification(
    cases: tuple[str, ...] = tuple(CASES),
    trials: int = 100,
    speed: float = 1.5,
    duration: float | None = None,
    height: float | None = None,
    seed: int = 0,
) -> Iterator[Record]:
    """A row for each throw, then what those of a case say together.

    Args:
        cases: kinds of throws
        trials: of a throw with a drop; a fifth of them roll for 3 s, and a tenth have ten unknown parameters
        speed: m/s, of the throw
        duration: s, for which a robot is seen; of each case its own, where not given
        height: m, from which it is dropped, likewise
        seed: of all draws
    """
    if trials < 1:
        raise InputError(f"trials = {trials}: expected at least 1")
    check_names("cases", cases, CASES)
    asked = {name: each for name, each in (("duration", duration), ("height", height)) if each is not None}
    resting = np.asarray(simulate(with_gait(load_scene("reference"), None), SETTLING, frame_rate=1.0).positions[-1])
    found, throws = {}, {}
    for name in cases:
        case, rows = CASES[name]._replace(**asked), []
        for trial in range(max(1, round(case.share * trials))):
            rows.append(one_throw(case, resting, speed, np.random.default_rng([seed, trial])))
            yield {"case": name} | rows[-1]
        found[name] = facts_of(case, rows)
        if case.parameters == FOUR:
            throws[name] = thrown(rows)
    return {"cases": found, "throws": throws}


def thrown(rows: list[Record]) -> Record:
    """What the figure shows, (throws, parameters) each: errors and half of the intervals, in % of what is true."""
    true, found, error = (
        np.array([row[key] for row in rows], float) for key in ("true", "identified", "standard_error")
    )
    inside = [row["inside"] for row in rows]
    return {"off": 100 * (found / true - 1), "half": 100 * INTERVAL * error / true, "inside": inside}


@identification.table
def words(record: Record) -> str:
    """The fits of each case, and how far estimates are off, parameter by parameter."""
    fits, rows = [], []
    for name, case in record["cases"].items():
        about, count = CASES[name].words, case["trials"]
        numbers = [f"{case[key]:{form}}" for key, form in (("duration", "g"), ("windows", ""))]
        times = [f"{case[key]:.0f}" for key in ("seconds", "longest")]
        fits.append([about, *numbers, f"{case['converged']} of {count}", *times])
        for each in case["parameters"]:
            cells = ["not determined", *4 * [""]]
            if each["told"]:
                shares = [f"{100 * each[key]:.2f}" for key in ("standard_error", "median", "largest")]
                cells = [*shares, *(f"{each[key]} of {count}" for key in ("within_2_percent", "covered"))]
            rows.append([about, f"`{each['name']}`", *cells])
            about = ""
    head = ["the robot", "seen for, s", "windows", "fits that converged", "median time of a fit, s", "longest time, s"]
    errors = ["median standard error, %", "median error, %", "largest error, %"]
    shares = ["errors below 2 %", "truth in the interval"]
    return "\n\n".join([table(head, fits), table(["the robot", "parameter", *errors, *shares], rows)])


def facts_of(case: Case, rows: list[Record]) -> Record:
    """What the trials of a case say."""
    return {
        "duration": case.duration,
        "windows": case.windows,
        "trials": len(rows),
        "converged": sum(row["converged"] for row in rows),
        "seconds": float(np.median([row["seconds"] for row in rows])),
        "longest": float(np.max([row["seconds"] for row in rows])),
        "parameters": [summary(rows, k, parameter) for k, parameter in enumerate(case.parameters)],
    }


def one_throw(case: Case, resting: np.ndarray, speed: float, random: np.random.Generator) -> dict[str, Any]:
    """Simulate a robot that differs, add noise, identify it."""
    scene = load_scene("reference")
    scene = scene if case.rolls else with_gait(scene, None)
    z = random.uniform(-WRONG_BY, WRONG_BY, len(case.parameters))
    true = np.array([parameter.value(each) for parameter, each in zip(case.parameters, z)])
    resting = resting + np.array([0, 0, case.height])
    heading, spin = random.uniform(0, 2 * np.pi), random.normal(0, 1, 3)
    start = speed * np.array([np.cos(heading), np.sin(heading), 0])
    start = start + np.cross(spin, resting - resting.mean(0)) + random.normal(0, JITTER[case.rolls], resting.shape)
    moved = simulate(
        changed(scene, case.parameters, z),
        case.duration,
        options=SolverOptions("rk4", dt=STEP / 2),
        frame_rate=FRAME_RATE,
        positions=resting,
        velocities=start,
    )
    seen = np.asarray(moved.positions) + random.normal(0, NOISE, moved.positions.shape)
    began = time.perf_counter()
    motion = measured_motion(
        scene,
        np.asarray(moved.times),
        seen.reshape(len(seen), -1),
        NOISE,
        SeenPositions(),
        Starts(seen, case.windows, spread=(5e-3, 0.5), jump=JUMP),
        options=SolverOptions("rk4", dt=STEP),
    )
    found = identify(scene, case.parameters, motion)
    return {
        "true": true,
        "identified": [each.value for each in found.estimates],
        "standard_error": [each.standard_error for each in found.estimates],
        "inside": [each.interval is not None and bool(each.interval[0] < t < each.interval[1])
                   for each, t in zip(found.estimates, true)],
        "converged": found.converged,
        "seconds": time.perf_counter() - began,
    }  # fmt: skip


def summary(rows: list[dict], k: int, parameter: Parameter) -> dict[str, Any]:
    """Of one parameter over all trials."""
    told = [row for row in rows if row["identified"][k] is not None]
    errors = [abs(row["identified"][k] / row["true"][k] - 1) for row in told]
    return {
        "name": parameter.name,
        "told": len(told),
        "median": float(np.median(errors)) if errors else None,
        "largest": max(errors, default=None),
        "within_2_percent": sum(error < 0.02 for error in errors),
        "covered": sum(row["inside"][k] for row in told),
        "standard_error": float(np.median([row["standard_error"][k] for row in rows])),
    }


@identification.figure()
def figure(record: Record, chart: Figure) -> None:
    """Identified less true, with 95 % intervals, trial by trial, of the throws with four unknown parameters."""
    chart.set_figheight(3.4 * len(record["throws"]) + 0.6)
    looks = {
        True: ("C0", "o", "95 % interval contains the truth"),
        False: ("C1", "X", "95 % interval misses the truth"),
    }
    grid = chart.subplots(len(record["throws"]), len(FOUR), squeeze=False)
    for line, (name, throws) in zip(grid, record["throws"].items()):
        off, half = (np.array(throws[key], float) for key in ("off", "half"))
        inside, trial = np.array(throws["inside"]), np.arange(1, len(off) + 1)
        for k, axes in enumerate(line):
            for covered, (colour, marker, label) in looks.items():
                some = (inside[:, k] == covered) & np.isfinite(off[:, k])
                bars = {"xerr": half[some, k], "color": colour, "fmt": marker, "markersize": 3, "linewidth": 1}
                axes.errorbar(off[some, k], trial[some], **bars, label=label)
            axes.axvline(0, color="black", linewidth=0.8)
            title = FOUR[k].path.removeprefix("structure.").replace(".", " ").replace("_", " ")
            axes.set(
                title=title,
                xlabel="error (%)",
                ylabel=f"number of the throw\n(robot {CASES[name].words})" if k == 0 else "",
            )
            axes.yaxis.get_major_locator().set_params(integer=True)
    chart.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)

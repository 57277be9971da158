"""Figure 2: how the error falls with the step, and what stops it."""

from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from paper_claims.report import (
    PROGRAM,
    REFERENCE,
    TEXT,
    Report,
    Row,
    hardened,
    scenes,
    significant,
    thinned,
    verdict,
    without,
)

from jaxgrity import Scene, SolverOptions, simulate
from jaxgrity.report import plot

DURATION = 3.0
NEARBY = 1e-11
"""m, by which a neighbour starts elsewhere: a second rollout, to see how fast motions part"""
ROUNDING = 1e-12
"""m, below which errors are not those of steps"""
LOST = 1e-3
"""m: a neighbour that gets this far away says that no step small enough exists for the motion to be the true one"""


class Case(NamedTuple):
    """One motion."""

    scene: Scene
    label: str
    method: str
    early: float
    """s, when forces have already had kinks, and motions have not had time to part"""


DRAWN = "steps", "error_at_end", "error_early", "times", "neighbours"
"""what the figure shows of each motion"""


def check(quick: bool) -> Report:
    """Errors of the nodes at 3 s and early on, for halved steps, with and without what is not smooth."""
    cases = all_cases()
    if quick:
        cases = {key: cases[key] for key in (PROGRAM, "smooth flight")}
    facts = {name: study(case, quick) for name, case in cases.items()}
    rows = [slope_row(name, cases[name], found) for name, found in facts.items()]
    rows += [blame_row(name, found) for name, found in facts.items() if name in (PROGRAM, TEXT, REFERENCE)]
    rows += [gain_row(name, found) for name, found in facts.items() if name in (PROGRAM, TEXT, REFERENCE)]
    lines = {cases[name].label: {part: found[part] for part in DRAWN} for name, found in facts.items()}
    return Report("Mesh refinement", rows, "refinement", {"lines": lines})


def all_cases() -> dict[str, Case]:
    known = scenes()
    program, text, reference = known[PROGRAM], known[TEXT], known[REFERENCE]
    smooth = without(reference, "ground", "friction")
    return {
        PROGRAM: Case(program, "program: switch, elastic contact", "rk4", 0.1),
        TEXT: Case(text, "text: switch, elastic contact", "rk4", 0.34),
        REFERENCE: Case(reference, "reference", "rk4", 0.5),
        "program, no friction": Case(without(program, "friction"), "program without friction", "rk4", 0.1),
        "program, no ground": Case(without(program, "ground", "friction"), "program in the air", "rk4", 0.1),
        "smooth flight": Case(smooth, "reference in the air (smooth)", "rk4", 0.5),
        "program, exact": Case(hardened(program), "program, complementarity", "complementarity", 0.1),
        "reference, exact": Case(hardened(reference), "reference, complementarity", "complementarity", 0.5),
    }


def study(case: Case, quick: bool) -> dict:
    """Errors in m against a rollout at half the smallest step, and the distance of its neighbour."""
    halvings = 4 if quick else 8 if case.method == "complementarity" else 9
    steps = [1e-3 / 2**k for k in range(halvings)]
    duration = 0.6 if quick else DURATION
    paths = [roll(case, duration, dt) for dt in (*steps, steps[-1] / 2)]
    errors = np.array([np.abs(path - paths[-1]).max((1, 2)) for path in paths[:-1]])
    neighbour = np.abs(roll(case, duration, steps[2], NEARBY) - paths[2]).max((1, 2))
    early = round(100 * case.early)
    return {
        "steps": steps,
        "error_at_end": errors[:, -1],
        "error_early": errors[:, early],
        "slope_at_end": slope(steps, errors[:, -1]),
        "slope_early": slope(steps, errors[:, early]),
        "times": thinned(np.linspace(0, duration, len(neighbour))),
        "neighbours": thinned(neighbour),
        "neighbours_apart": float(neighbour[-1]),
        "gain": float(errors[0, -1] / errors[2, -1]),
    }


def roll(case: Case, duration: float, dt: float, off: float = 0.0) -> np.ndarray:
    """(frames, nodes, 3), m; from positions that are `off` at one node."""
    start = np.array(case.scene.structure.nodes, float)
    start[0, 0] += off
    options = SolverOptions(case.method, dt, any_step=True)
    trajectory = simulate(case.scene, duration, options=options, positions=start)
    return np.asarray(trajectory.positions)


def slope(steps: list[float], errors: np.ndarray) -> float:
    """Of log error against log step, where the error is more than rounding."""
    use = errors > ROUNDING
    return float(np.polyfit(np.log(np.array(steps)[use]), np.log(errors[use]), 1)[0]) if use.sum() > 1 else np.nan


def slope_row(name: str, case: Case, found: dict) -> Row:
    order = 4 if case.method == "rk4" else 1
    measured = f"slope {found['slope_early']:.1f} early on, {found['slope_at_end']:.1f} at the end; {digits(found)}"
    near = abs(found["slope_at_end"] - order) < 0.5
    if near:
        why = "the error falls at the order of the method to the end"
    elif found["neighbours_apart"] > LOST:
        why = "chaos leaves no slope at the end; early on, the slope depends on how smooth the forces are"
    else:
        why = "kinks and jumps of the forces lower the order; without chaos the error goes on falling"
    return Row(f"the error falls with slope {order} ({case.method})", "5.2, Fig. 2", name, measured, verdict(near), why)


def digits(found: dict) -> str:
    first, last = found["error_at_end"][0], found["error_at_end"][-1]
    return (
        f"error at the end {significant(first, 'm')} at {found['steps'][0]:g} s, {significant(last, 'm')} at "
        f"{found['steps'][-1]:.2g} s"
    )


def blame_row(name: str, found: dict) -> Row:
    """Does the error saturate, and is it non-smoothness that makes it so?"""
    small = np.array(found["steps"]) < 3e-4
    late = found["error_at_end"][small]
    saturates = bool(late.min() > late.max() / 10) if small.sum() > 2 else False
    parted = found["neighbours_apart"] > LOST
    measured = (
        f"below 3e-4 s errors from {significant(late.max(), 'm')} to {significant(late.min(), 'm')}; slope early on "
        f"{found['slope_early']:.1f}; neighbours {NEARBY:g} m apart end "
        f"{significant(found['neighbours_apart'], 'm')} apart"
    )
    if saturates and parted:
        why = (
            "chaos saturates it: any error grows until it is as large as the motion. Non-smooth forces only lower the "
            "order: early on the error goes on falling"
        )
    elif saturates:
        why = "it saturates while neighbours stay close: the forces' jumps do it"
    else:
        why = "the error goes on falling: neither non-smoothness nor chaos stops it here"
    return Row(
        "the error saturates below 3e-4 s, because forces are not smooth",
        "5.2, Fig. 2",
        name,
        measured,
        verdict(saturates and not parted),
        why,
    )


def gain_row(name: str, found: dict) -> Row:
    gain = found["gain"]
    parted = found["neighbours_apart"] > LOST
    near = 3.5 <= gain <= 14
    why = (
        "in chaos, the ratio of two errors is chance"
        if parted
        else f"a method of order 4 would gain a factor of {4**4}, one of order 1 a factor of {4}"
    )
    measured = f"errors at the end {significant(found['error_at_end'][0], 'm')} and "
    measured += f"{significant(found['error_at_end'][2], 'm')}: a factor of {gain:.3g}"
    holds = verdict(near and not parted, near)
    return Row("2.5e-4 s is seven times as accurate as 1e-3 s", "5.2", name, measured, holds, why)


@plot.styled
def figure(lines: dict[str, dict]) -> Figure:
    chart = Figure(figsize=(plot.WIDTH, 5.6), layout="constrained")
    end, early, apart = chart.subplots(1, 3)
    for (name, line), marker in zip(lines.items(), plot.MARKERS):
        look = {"marker": marker, "markersize": 5}
        end.loglog(line["steps"], line["error_at_end"], **look, label=name)
        early.loglog(line["steps"], line["error_early"], **look)
        apart.semilogy(line["times"], np.array(line["neighbours"]) + 1e-18, **look, markevery=0.1)
    fourth = "half the step, 1/16 of the error"
    for axes, title in ((end, "at the end"), (early, "early on (0.1 to 0.5 s)")):
        h = np.array([1e-4, 1e-3])
        axes.loglog(h, 1e-6 * (h / 1e-3) ** 4, color="black", lw=1.2, ls="--", label=fourth if axes is end else None)
        axes.set(xlabel="step (s)", title=title, ylim=(1e-16, 10))
    end.set_ylabel("largest error of a node (m)")
    chart.legend(loc="outside lower center", ncols=2)
    apart.set(xlabel="time (s)", ylabel="distance of neighbours (m)", ylim=(1e-14, 10))
    apart.set_title(f"neighbours {NEARBY:g} m apart")
    return chart

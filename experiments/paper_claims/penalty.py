"""Section 6.1: what a quadratic penalty leaves of the constraint, against exact contact."""

import numpy as np
from matplotlib.figure import Figure
from paper_claims.report import (
    CALLED,
    PROGRAM,
    REFERENCE,
    TEXT,
    Report,
    Row,
    grounded,
    hardened,
    scenes,
    significant,
    verdict,
    without,
)

from jaxgrity import PenaltyGround, Scene, SolverOptions, Structure, simulate
from jaxgrity.report import plot

STIFFNESSES = (1e3, 1e4, 1e5, 1e6, 1e7)
"""k_n, N/m"""
PAPER_STIFFNESS, PAPER_STEP, PAPER_BAR = 1e5, 1e-3, 0.5e-3
STEPS = (1e-3, 5e-4, 1e-4)
FINE = 2e-5
"""s, stable on all these grounds"""
LANDING = 1.0
"""s, in which every robot has landed"""


def check(quick: bool) -> Report:
    """Penetration against k_n and the step: of a block at rest, and of each robot that lands."""
    known = scenes()
    values = STIFFNESSES[2:4] if quick else STIFFNESSES
    names = (REFERENCE,) if quick else (PROGRAM, TEXT, REFERENCE)
    # every step makes a program of its own, of as many frames
    steps, fine = ((STEPS[0], STEPS[-1]), STEPS[-1]) if quick else (STEPS, FINE)
    resting = {f"{k_n:g}": rest(k_n) for k_n in values}
    landing = {name: {f"{k_n:g}": deepest(grounded(known[name], k_n), fine) for k_n in values} for name in names}
    by_step = {name: {f"{dt:g}": deepest(grounded(known[name], PAPER_STIFFNESS), dt) for dt in steps} for name in names}
    exact = {name: deepest(hardened(known[name]), PAPER_STEP) for name in names}
    weights = {name: float(scene.structure.mass) * float(scene.gravity) for name, scene in known.items()}
    rows = [exactness_row(resting)]
    rows += [half_millimetre_row(name, by_step[name], weights[name]) for name in names]
    rows += [weight_row(name, weights[name]) for name in names if name != REFERENCE or quick]
    rows += [kkt_row(name, landing[name], exact[name]) for name in names]
    drawn = {"rest": resting, "landing": landing, "by_step": by_step}
    return Report("Penalty against KKT", rows, "penalty", drawn)


def rest(k_n: float) -> float:
    """m, of a 1 kg block after it has come to rest."""
    damping = np.array([2 * np.sqrt(k_n)])
    scene = Scene(Structure(np.zeros((1, 3)), np.ones(1)), 9.81, damping, ground=PenaltyGround(k_n))
    return float(-simulate(scene, 1.0, options=SolverOptions("rk4", FINE)).positions[-1, 0, 2])


def deepest(scene: Scene, dt: float) -> float:
    """m, in the first second, without the gait; NaN where the motion blows up."""
    options = SolverOptions(dt=dt, any_step=True)
    motion = simulate(without(scene, "gait"), LANDING, options=options, frame_rate=1 / dt)
    depth = -(np.asarray(motion.positions) @ np.array(scene.ground.normal)).min()
    return float(max(0.0, depth)) if not motion.failed else float("nan")


def exactness_row(resting: dict[str, float]) -> Row:
    weight = 9.81
    measured = "at rest " + ", ".join(f"{significant(d, 'm')} (k_n = {k})" for k, d in resting.items())
    beyond = [depth for k, depth in resting.items() if float(k) > weight]
    off = max(abs(depth * float(k) / weight - 1) for k, depth in resting.items())
    why = (
        f"every k_n exceeds the multiplier m g = {weight} N, yet every block is pressed in by m g/k_n, to a relative "
        f"error of {off:.0e}. The theorem is about exact penalties k |g|, which have a kink. A quadratic penalty is "
        "exact only in the limit of infinite k_n"
    )
    exact = max(beyond) < 1e-12
    claim = "with k_n > max |mu| the penalty is exact"
    return Row(claim, "6.1", "1 kg block", measured, verdict(exact), why)


def half_millimetre_row(name: str, found: dict[str, float], weight: float) -> Row:
    """`found` has the deepest penetration (m) of a landing for each step."""
    coarse, fine = found[f"{PAPER_STEP:g}"], found[f"{min(STEPS):g}"]
    still = weight / PAPER_STIFFNESS / 3
    measured = (
        f"deepest in the landing {significant(coarse, 'm')} at 1e-3 s, {significant(fine, 'm')} at 1e-4 s; at rest on "
    )
    measured += f"three nodes m g/(3 k_n) = {significant(still, 'm')}"
    holds, at_some_step = coarse < PAPER_BAR, any(depth < PAPER_BAR for depth in found.values())
    why = "the impact sets the depth, about v sqrt(m/k_n). The weight over k_n and the step do not"
    if not at_some_step:
        why = f"every landing goes deeper, at every step: {why}. Only the depth at rest is less"
    claim = "penetration stays below 0.5 mm at k_n = 1e5, dt = 1e-3 s"
    return Row(claim, "6.1", name, measured, verdict(holds, at_some_step), why)


def weight_row(name: str, weight: float) -> Row:
    near = 5e3 < weight < 7e3
    why = "6e3 fits the program's robot in millinewtons; in newtons k_n exceeds the weight by far, which proves nothing"
    return Row("m g is about 6e3 N", "6.1", name, f"m g = {weight:.2f} N", verdict(near), why)


def kkt_row(name: str, landing: dict[str, float], exact: float) -> Row:
    depths = np.array(list(landing.values()))
    values = np.array([float(k) for k in landing])
    slope = float(np.polyfit(np.log(values), np.log(depths), 1)[0])
    measured = (
        f"deepest {significant(depths[0], 'm')} to {significant(depths[-1], 'm')} as k_n grows from {values[0]:g} to "
    )
    measured += f"{values[-1]:g}, slope {slope:.2f}; exact contact {significant(exact, 'm')}"
    why = "an elastic impact presses in by v sqrt(m/k_n): slope -1/2; at rest it is -1"
    claim = "for large k_n nodes cannot penetrate far, and KKT is approached"
    return Row(claim, "6.1", name, measured, verdict(slope < -0.4 and exact < 1e-12), why)


@plot.styled
def figure(rest: dict, landing: dict, by_step: dict) -> Figure:
    chart = Figure(figsize=(plot.WIDTH, 5), layout="constrained")
    against, steps = chart.subplots(1, 2)
    k_n = np.array([float(k) for k in rest])
    for (name, found), marker in zip(landing.items(), plot.MARKERS):
        against.loglog(k_n, 1e3 * np.array(list(found.values()), float), f"{marker}-", label=f"{CALLED[name]}, landing")
    against.loglog(k_n, 1e3 * np.array(list(rest.values())), "ko", label="block at rest")
    against.loglog(k_n, 1e3 * 9.81 / k_n, color="0.6", lw=0.8, zorder=0, label="weight / stiffness, of the block")
    for (_, found), marker in zip(by_step.items(), plot.MARKERS):
        milliseconds = [1e3 * float(dt) for dt in found]
        steps.loglog(milliseconds, 1e3 * np.array(list(found.values()), float), f"{marker}-")
    steps.axhline(1e3 * PAPER_BAR, color="C4", lw=1.2, label="0.5 mm, as the paper says")
    against.set(xlabel="stiffness of the ground (N/m)", ylabel="deepest penetration (mm)")
    steps.set(xlabel="step (ms)", ylabel="deepest penetration (mm)", title="stiffness 1e5 N/m")
    steps.set_xticks(milliseconds, [f"{each:g}" for each in milliseconds])
    steps.set_yticks(ticks := (0.5, 1, 2, 3), [f"{each:g}" for each in ticks])
    steps.minorticks_off()
    chart.legend(loc="outside lower center", ncols=3)
    return chart

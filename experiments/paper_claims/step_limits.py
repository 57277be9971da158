"""Section 6.6: the largest stable step, predicted and measured, and what halving it does to the energy."""

import numpy as np
from matplotlib.figure import Figure
from paper_claims.report import (
    CALLED,
    PROGRAM,
    REFERENCE,
    TEXT,
    Report,
    Row,
    scenes,
    significant,
    stiffened,
    verdict,
    without,
)
from studies.stability import at_rest, measure

from jaxgrity import METHODS, Scene, SolverOptions, energy_audit, stable_step
from jaxgrity.report import plot

STIFFNESSES = (1e5, 2e5, 5e5, 1e6)
"""K of the struts, N/m"""
STEP = 1e-3
RK4 = METHODS["rk4"]


def check(quick: bool) -> Report:
    """RK4's limit on each robot in free flight as struts stiffen; energy residuals at 1e-3 s and half of it."""
    known = scenes()
    names = (PROGRAM,) if quick else (PROGRAM, TEXT, REFERENCE)
    values = STIFFNESSES[:1] if quick else STIFFNESSES
    limits = {name: [limit(known[name], K) for K in values] for name in names}
    duration = 1.0 if quick else 4.0
    rows = [edge_row(name, found, values) for name, found in limits.items()]
    rows += [halving_row(name, [residual(known[name], dt, duration) for dt in (STEP, STEP / 2)]) for name in names]
    return Report("Stability", rows, "stability", {"values": values, "limits": limits})


def limit(scene: Scene, K: float) -> dict:
    """Predicted and measured, s, about the robot's rest in free flight, with its cables just taut."""
    free = stiffened(without(scene, "ground", "friction", "gait", "gravity"), K)
    cables = free.structure.cables
    taut = type(cables)(cables.edges, cables.stiffness, 0.999 * np.asarray(cables.rest_length), cables.damping)
    free = type(free)(type(free.structure)(free.structure.nodes, free.structure.node_mass, free.structure.struts, taut))
    state = at_rest(free)
    predicted = stable_step(free, state, RK4)
    return {"predicted": predicted, "measured": measure(free, state, RK4, predicted)}


def residual(scene: Scene, dt: float, duration: float) -> float:
    """J, what the energy balance lacks."""
    options = SolverOptions("rk4", dt, any_step=True)
    return float(np.abs(energy_audit(scene, duration, options=options).residual).max())


def edge_row(name: str, found: list[dict], values: tuple[float, ...]) -> Row:
    measured = "; ".join(
        f"K = {K:.0e}: {1e3 * f['predicted']:.2f} ms predicted, {1e3 * f['measured']:.2f} measured"
        for K, f in zip(values, found)
    )
    steps = np.array([f["measured"] for f in found])
    on_edge = (steps > 0.8 * STEP) & (steps < 1.5 * STEP)
    why = "the limit falls as 1/sqrt(K): 1e-3 s is on the edge only where the limit is 0.8 to 1.5 ms"
    if steps.min() > 1.5 * STEP:
        why = "heavier nodes vibrate more slowly: here 1e-3 s is far from the struts' limit"
    claim = "RK4 with 1e-3 s is on the edge of stability for stiffnesses of 1e5 to 1e6"
    return Row(claim, "6.6", name, measured, verdict(bool(on_edge.all()), bool(on_edge.any())), why)


def halving_row(name: str, found: list[float]) -> Row:
    ratio = found[0] / found[1]
    measured = (
        f"residual of the energy balance {significant(found[0], 'J')} at 1e-3 s, {significant(found[1], 'J')} at half"
    )
    why = f"a factor of {ratio:.3g}; 2^4 = 16 where forces are smooth, 2 to 4 where contacts begin and end"
    return Row("halving dt reduces the drift of energy", "6.6", name, measured, verdict(ratio > 1.2), why)


@plot.styled
def figure(values: tuple[float, ...], limits: dict) -> Figure:
    chart = Figure(figsize=(plot.WIDTH, 5.5), layout="constrained")
    axes = chart.subplots()
    for k, ((name, found), marker) in enumerate(zip(limits.items(), plot.MARKERS)):
        predicted, measured = (
            1e3 * np.array([each[key] for each in found], float) for key in ("predicted", "measured")
        )
        axes.loglog(values, predicted, color=f"C{k}", label=f"{CALLED[name]}, predicted")
        axes.loglog(values, measured, marker, color=f"C{k}", label=f"{CALLED[name]}, measured")
    axes.axhline(1e3 * STEP, color="black", lw=1.2, label="the paper's step")
    axes.set(xlabel="stiffness of the struts (N/m)", ylabel="largest stable step (ms)")
    chart.legend(loc="outside lower center", ncols=2)
    return chart

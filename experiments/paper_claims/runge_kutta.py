"""Section 4: the Runge-Kutta step as it is printed, against the one by which this project integrates."""

import jax
import numpy as np
from matplotlib.figure import Figure
from paper_claims.report import CALLED, PROGRAM, REFERENCE, TEXT, Report, Row, scenes, significant, verdict

from jaxgrity import Scene, SolverOptions, simulate
from jaxgrity.report import plot
from jaxgrity.stepping import vector_field

STEP = 5e-4


def check(quick: bool) -> Report:
    """Both from the same start, for 1, 10, ... steps."""
    known = scenes()
    names = (REFERENCE,) if quick else (PROGRAM, TEXT, REFERENCE)
    counts = (1, 10, 100) if quick else (1, 10, 100, 300, 600, 1000, 2000)
    facts = {name: {"steps": counts, "apart": compare(known[name], counts)} for name in names}
    rows = [row(name, found) for name, found in facts.items()]
    return Report("RK4 as printed", rows, "runge_kutta", {"facts": facts})


def compare(scene: Scene, counts: tuple[int, ...]) -> list[float]:
    """m, largest difference of a coordinate after each count of steps."""
    options = SolverOptions("rk4", STEP, any_step=True)
    motion = simulate(scene, counts[-1] * STEP, options=options, frame_rate=1 / STEP)
    ours = np.asarray(motion.positions)
    y = np.asarray(scene.structure.nodes, float), np.zeros(scene.structure.nodes.shape)
    step = jax.jit(lambda t, y: printed_step(scene, t, y))
    apart, times = [], np.asarray(motion.times)
    for n in range(counts[-1]):
        y = step(times[n], y)
        if n + 1 in counts:
            apart.append(float(np.abs(np.asarray(y[0]) - ours[n + 1]).max()))
    return apart


def printed_step(scene: Scene, t, y):
    """The five lines of section 4, k = (k^q, k^v)."""

    def f(q, v, t):
        return vector_field(t, (q, v), scene)

    (q, v), dt = y, STEP
    k1 = f(q, v, t)
    k2 = f(q + dt / 2 * k1[0], v + dt / 2 * k1[1], t + dt / 2)
    k3 = f(q + dt / 2 * k2[0], v + dt / 2 * k2[1], t + dt / 2)
    k4 = f(q + dt * k3[0], v + dt * k3[1], t + dt)
    return tuple(x + dt / 6 * (a + 2 * b + 2 * c + d) for x, a, b, c, d in zip(y, k1, k2, k3, k4))


def row(name: str, found: dict) -> Row:
    first, last = found["apart"][0], found["apart"][-1]
    measured = (
        f"largest difference {significant(first, 'm')} after {found['steps'][0]} step, {significant(last, 'm')} after "
    )
    measured += f"{found['steps'][-1]}"
    equal = max(found["apart"]) == 0
    why = (
        "bit for bit the same" if equal else "the same weights summed in another order: equal to rounding, step by step"
    )
    return Row("the printed RK4 step", "4", name, measured, verdict(first < 1e-14), why)


@plot.styled
def figure(facts: dict) -> Figure:
    chart = Figure(figsize=(plot.WIDTH, 4.2), layout="constrained")
    axes = chart.subplots()
    for (name, found), marker in zip(facts.items(), plot.MARKERS):
        axes.loglog(found["steps"], np.maximum(found["apart"], 1e-18), f"{marker}-", label=CALLED.get(name, name))
    axes.axhline(np.finfo(float).eps, color="black", lw=1.2, label="rounding of 1 m")
    axes.set(xlabel="steps of 5e-4 s", ylabel="largest difference (m)")
    chart.legend(loc="outside lower center", ncols=4)
    return chart

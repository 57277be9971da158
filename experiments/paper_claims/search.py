"""Section 6.7: the genetic algorithm that the paper announces, on phases and amplitudes, of struts and of cables."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from paper_claims.report import CALLED, PROGRAM, REFERENCE, TEXT, Report, Row, scenes, significant, verdict

from jaxgrity import Fitness, GAConfig, Gait, Genome, Scene, SearchProblem, SolverOptions, evolve, verify, with_gait
from jaxgrity.report import plot
from jaxgrity.search import distinct

STEP = 1e-3
FINALISTS = 4


def check(quick: bool) -> Report:
    """One search for each actuation of each scene; the best few verified at a half and a quarter of its step."""
    known = scenes()
    names = (REFERENCE,) if quick else (REFERENCE, TEXT, PROGRAM)
    kinds = ("struts",) if quick else ("struts", "cables")
    facts = {f"{name}, {kind}": hunt(known[name], kind, quick) for name in names for kind in kinds}
    rows = [row(name, found) for name, found in facts.items()]
    return Report("The genetic algorithm", rows, "search", {"facts": facts})


def hunt(scene: Scene, kind: str, quick: bool) -> dict:
    """What the search found in 8 s rollouts, and what of it is real."""
    struts, cables = len(scene.structure.struts.edges), len(scene.structure.cables.edges)
    members = range(struts) if kind == "struts" else range(struts, struts + cables)
    size, duration = len(members), 3.0 if quick else 8.0
    largest = float(np.max(scene.gait.amplitude))
    frequency = np.full(size, float(np.max(scene.gait.frequency)))
    start, ramp = max(0.0, float(scene.gait.start)), 1.0
    changed = with_gait(scene, Gait(tuple(members), np.zeros(size), np.full(size, largest), frequency, start, ramp))
    genome = Genome(size, amplitude=(0.0, largest))
    config = GAConfig(population=16, generations=2, elites=2) if quick else GAConfig(population=64, generations=12)
    search = evolve(SearchProblem(changed, genome, duration, Fitness()), config, options=SolverOptions("rk4", STEP))
    finalists = genome.gaits(changed.gait, distinct(search.last, genome, FINALISTS))
    checked = verify(changed, finalists, duration, options=SolverOptions("rk4", STEP / 2))
    usable = np.isfinite(checked.error_bar)
    worth = np.where(usable, np.nan_to_num(checked.distance) - np.where(usable, checked.error_bar, 0), -np.inf)
    best = int(np.argmax(worth))
    return {
        "best": search.best,
        "median": search.median,
        "claimed": float(search.best[-1]),
        "distance": float(checked.distance[best]),
        "error_bar": float(checked.error_bar[best]),
        "size": float(np.ptp(np.asarray(scene.structure.nodes), axis=0).max()),
    }


def row(name: str, found: dict) -> Row:
    measured = (
        f"{significant(found['best'][0], 'm')} (best of the first generation) to "
        f"{significant(found['claimed'], 'm')} (last); verified {significant(found['distance'], 'm')} ± "
        f"{significant(found['error_bar'], 'm')}"
    )
    real = found["distance"] - found["error_bar"] > found["size"]
    better = found["claimed"] > found["best"][0]
    why = (
        f"the verified gait goes {found['distance'] / found['size']:.1f} body sizes, and the bar is small against that"
        if real
        else "the error bar is as large as the distance: the motion cannot be integrated to 8 s, the search ranks noise"
        if found["error_bar"] > 0.5 * found["distance"]
        else "what is found is real, but less than one body size"
    )
    claim = "a genetic algorithm over phases and amplitudes finds gaits that roll"
    return Row(claim, "5.2, 6.7", name, measured, verdict(real and better), why)


@plot.styled
def figure(facts: dict) -> Figure:
    chart = Figure(figsize=(plot.WIDTH, 6.5), layout="constrained")
    axes = chart.subplots()
    for k, (name, found) in enumerate(facts.items()):
        generations = np.arange(1, len(found["best"]) + 1)
        scene, kind = name.split(", ")
        look = {"color": f"C{k}", "marker": plot.MARKERS[k], "markersize": 4}
        axes.plot(generations, found["best"], **look, label=f"{CALLED[scene]}, {kind}: best")
        axes.plot(generations, found["median"], "--", **look, lw=0.8, mfc="white", label="median")
        bar = found["error_bar"] or 0.0  # none where it is not finite
        axes.errorbar(
            generations[-1] + 0.5 + 0.15 * k,
            found["distance"],
            bar,
            fmt=plot.MARKERS[k],
            color=f"C{k}",
            capsize=3,
            label="the best, verified",
        )
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="generation", ylabel="distance in a rollout (m)", ylim=(0, None))
    chart.legend(loc="outside lower center", ncols=3)
    return chart

"""Figures: of motions (`robot_plot`), of structures at rest (`statics_plot`), of searches and of populations."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxgrity.core.display import in_digits, significant
from jaxgrity.io.files import write_whole
from jaxgrity.model.actuation import Gait, contraction
from jaxgrity.report.orbit_plot import orbit_figure
from jaxgrity.report.recorded_plot import recorded_figure
from jaxgrity.report.robot_plot import (
    draw_robot,
    energy_figure,
    force_figure,
    gait_figure,
    member_figure,
    path_figure,
    still_figure,
    structure_figure,
)
from jaxgrity.report.statics_plot import geometry_figure, resting_force_figure
from jaxgrity.report.style import CABLE, GROUND, MARKERS, PATH, STRUT, WIDTH, styled
from jaxgrity.search.genetic_algorithm import Evolution

__all__ = [
    "CABLE",
    "GROUND",
    "MARKERS",
    "PATH",
    "STRUT",
    "WIDTH",
    "convergence_figure",
    "draw_robot",
    "drawn",
    "energy_figure",
    "fidelity_figure",
    "force_figure",
    "gait_figure",
    "geometry_figure",
    "member_figure",
    "orbit_figure",
    "outcomes_figure",
    "path_figure",
    "polish_figure",
    "recorded_figure",
    "resting_force_figure",
    "robust_figure",
    "save",
    "still_figure",
    "structure_figure",
    "styled",
]


Result = TypeVar("Result")


def drawn(name: str, draw: Callable[[], Result]) -> Result | None:
    """The result of `draw`; None, after a line with the reason, where it fails: one part of a report is missing
    then."""
    try:
        return draw()
    except Exception as error:
        print(f"no {name}: {type(error).__name__}: {error}".splitlines()[0], flush=True)
        return None


@styled
def save(figure: Figure, path: str | Path) -> None:
    """Write a figure, whole or not at all: as SVG for a file name with that ending, else as PNG."""
    kind = "svg" if Path(path).suffix.lower() == ".svg" else "png"
    same = {"Date": None} if kind == "svg" else {}  # so that equal figures make equal files
    write_whole(path, lambda file: figure.savefig(file, format=kind, metadata=same))


@styled
def convergence_figure(searches: list[Evolution], names: tuple[str, ...] = (), unit: str = "m") -> Figure:
    """Best and median fitness of each generation of consecutive searches, with their `names`.

    Hollow where no gait kept the bounds on actuators on all its robots: the best then has the least excess.
    """
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    first = 1
    for number, search in enumerate(searches):
        numbers = np.arange(first, first + len(search.best))
        for values, colour, kind in ((search.best, STRUT, "best"), (search.median, PATH, "median")):
            axes.plot(numbers, values, "o-", markersize=3, color=colour, label=None if number else kind)
            beyond = search.within == 0
            axes.plot(numbers[beyond], values[beyond], "o", markersize=3, color=colour, markerfacecolor="white")
        if len(searches) > 1:
            axes.axvspan(numbers[0] - 0.5, numbers[-1] + 0.5, color=GROUND, alpha=0.6 if number % 2 else 0.2, lw=0)
            axes.text(numbers.mean(), 0.02, names[number], ha="center", transform=axes.get_xaxis_transform())
        first += len(search.best)
    rollouts = sum(search.rollouts for search in searches)
    title = f"{rollouts} rollouts; each by the draws that chose it, on fresh ones the best is worth less"
    axes.set(xlabel="generation", ylabel=_in("fitness", unit))
    axes.set_title(title)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if any((search.within == 0).any() for search in searches):
        axes.plot([], [], "o", markersize=3, color=STRUT, markerfacecolor="white", label="every gait beyond a bound")
    axes.legend()
    return figure


def _in(name: str, unit: str) -> str:
    """The name of an axis, with its unit, where it has one."""
    return f"{name} ({unit})" if unit else name


def ranked(correlation: float | None) -> str:
    """A rank correlation in words."""
    return "too few gaits differ" if correlation is None or not np.isfinite(correlation) else f"{correlation:.2f}"


@styled
def polish_figure(
    before: Gait, after: Gait, fitness: list[float], unit: str = "m", horizons: tuple[float, ...] = ()
) -> Figure:
    """An actuator's length over a period before and after polishing, and the fitness around each of its steps.

    The actuator is the first of `after`. Periods begin where it is longest. `horizons` are the durations (s) of the
    rollouts in which steps have their fitness.
    """
    figure = Figure(figsize=(8, 3.4), layout="constrained")
    wave, steps = figure.subplots(1, 2)
    share = np.linspace(0, 1, 241)
    for gait, name, colour in ((before, "before", PATH), (after, "polished", STRUT)):
        row = gait.members.index(after.members[0])
        period = 1 / float(gait.frequency[row])
        times = float(gait.start + gait.ramp) + period * share[:-1]
        lengths = np.array([1 - float(contraction(gait, t)[row]) for t in times])
        lengths = np.roll(lengths, -int(np.argmax(lengths)))
        wave.plot(share, np.append(lengths, lengths[0]), color=colour, label=f"{name}, {period:.3g} s")
    wave.set(xlabel="share of a period", ylabel="share of the full rest length")
    wave.legend()
    steps.plot(np.arange(1, len(fitness) + 1), fitness, "o-", markersize=3, color=STRUT)
    steps.set(xlabel="step of polishing", ylabel=_in("fitness", unit))
    if horizons:
        steps.set_title(f"in rollouts of {', then '.join(f'{in_digits(each)} s' for each in horizons)}")
    steps.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


@styled
def fidelity_figure(
    names: tuple[str, ...], fitness: np.ndarray, evolved: int, correlations: tuple, unit: str
) -> Figure:
    """Fitness of the same gaits on every fidelity level but the last, against the last; the first `evolved` columns
    evolved.

    Gaits beyond the bounds on actuators, NaN, and gaits that failed, -inf, are counted and not shown.
    `correlations` are the levels' rank correlations over all gaits, and over the evolved ones: two square arrays.
    """
    figure = Figure(figsize=(4.2 * (len(names) - 1), 4.4), layout="constrained")
    every, among = correlations
    beyond = np.isnan(fitness).any(0)
    failed = ~beyond & np.isneginf(fitness).any(0)
    fitness = np.where(beyond | failed, np.nan, fitness)
    hidden = {"beyond the actuators' bounds": beyond, "of which a robot failed": failed}
    counts = {why: int(each.sum()) for why, each in hidden.items() if each.any()}
    if counts:
        told = ", ".join(f"{count} gait{'s' * (count != 1)} {why}" for why, count in counts.items())
        figure.supxlabel(f"not shown: {told}")
    for k, axes in enumerate(figure.subplots(1, len(names) - 1, squeeze=False)[0]):
        axes.plot(fitness[-1, evolved:], fitness[k, evolved:], "o", color=CABLE, alpha=0.7, label="random gaits")
        axes.plot(fitness[-1, :evolved], fitness[k, :evolved], "o", color=PATH, alpha=0.7, label="evolved gaits")
        both = fitness[[k, -1]][:, np.isfinite(fitness[[k, -1]]).all(0)]
        if not both.size:
            both = np.zeros((2, 1))
        axes.plot(*[[both.min(), both.max()]] * 2, color=CABLE, linewidth=0.8, label="equal")
        axes.set(xlabel=_in(names[-1], unit), ylabel=_in(names[k], unit))
        # two lines, since one of its own width would run into the next title
        known = f"rank correlation: {ranked(every[k, -1])}\namong evolved gaits: {ranked(among[k, -1])}"
        axes.set_title(known)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


@styled
def robust_figure(gaits: dict[str, np.ndarray], unit: str) -> Figure:
    """The objective of every robot of an ensemble, as shares, one histogram for each of the gaits."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    every = np.concatenate(list(gaits.values()))
    edges = np.linspace(every.min(), every.max() + 1e-9, 30)
    for (name, each), colour in zip(gaits.items(), (STRUT, PATH, CABLE)):
        axes.hist(
            each,
            list(edges),
            weights=np.full(each.size, 1 / each.size),
            histtype="step",
            linewidth=1.6,
            color=colour,
            label=f"{name}: {' '.join([significant(float(each.mean())), *unit.split()])}, standard deviation "
            f"{in_digits(each.std(), 2)}",
        )
        axes.axvline(each.mean(), color=colour, linestyle=":")
    axes.set(
        xlabel=_in("objective", unit),
        ylabel="share of the robots",
        title="what perturbed robots reach",
    )
    figure.legend(loc="outside lower center")
    return figure


@styled
def outcomes_figure(com_start: np.ndarray, com_end: np.ndarray, failed: np.ndarray) -> Figure:
    """The end of each robot of a population, from above."""
    figure = Figure(figsize=(5.5, 5), layout="constrained")
    axes = figure.subplots()
    moved = (com_end - com_start)[~failed]
    axes.plot(0, 0, "o", color="black", label="start")
    axes.scatter(moved[:, 0], moved[:, 1], s=18, color=PATH, label=f"end of {len(moved)} gaits")
    title = f"{int(failed.sum())} of {len(failed)} rollouts failed" if failed.any() else "displacement of each gait"
    axes.set(xlabel="x (m)", ylabel="y (m)", title=title)
    axes.axis("equal")
    axes.legend()
    return figure

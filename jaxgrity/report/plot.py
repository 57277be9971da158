"""Figures: the robot, its path, its member lengths, a search's convergence."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from jaxgrity.io.files import write_whole
from jaxgrity.model.actuation import rest_length
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import edge_lengths
from jaxgrity.search.genetic_algorithm import Evolution
from jaxgrity.stepping.simulate import Trajectory, centre_path

STRUT, CABLE, GROUND, PATH = "#c1272d", "#444444", "#d9d4c7", "#0b5fa5"


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    write_whole(path, lambda file: figure.savefig(file, format="png", dpi=130))


def draw_robot(axes: Axes3D, scene: Scene, q: np.ndarray, number: bool = False) -> list:
    """Struts (red, thick), cables (dark, thin) and nodes at positions `q` (nodes, 3); node numbers where asked."""
    artists = []
    for members, colour, width in ((scene.structure.struts, STRUT, 3.5), (scene.structure.cables, CABLE, 1.0)):
        if members is not None:
            lines = Line3DCollection(q[np.asarray(members.edges)], colors=colour, linewidths=width)
            artists.append(axes.add_collection3d(lines))
    artists.append(axes.scatter(*q.T, color="black", s=12, depthshade=False))
    if number:
        artists += [axes.text(*(1.1 * (x - q.mean(0)) + q.mean(0)), str(k)) for k, x in enumerate(q)]
    return artists


def structure_figure(scene: Scene) -> Figure:
    """The structure as it starts, its nodes numbered."""
    figure = Figure(figsize=(5, 5), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    q = np.asarray(scene.structure.nodes)
    draw_robot(axes, scene, q, number=True)
    _frame(axes, q.mean(0), np.ptp(q, axis=0).max() / 1.7)
    return figure


def path_figure(scene: Scene, trajectory: Trajectory, error_bar: float | None = None) -> Figure:
    """Where the centre of mass goes, from above, and its distance from the start against time."""
    path, times = centre_path(scene, trajectory), np.asarray(trajectory.times)
    figure = Figure(figsize=(10, 4.5), layout="constrained")
    above, against = figure.subplots(1, 2)
    above.plot(path[:, 0], path[:, 1], color=PATH)
    above.plot(*path[0, :2], "o", color="black", label=f"start, t = {times[0]:g} s")
    above.plot(*path[-1, :2], "s", color=STRUT, label=f"end, t = {times[-1]:g} s")
    above.set(xlabel="x (m)", ylabel="y (m)", title="path of the centre of mass, from above")
    above.axis("equal")
    above.grid(alpha=0.3)
    above.legend()
    distance = np.hypot(*(path - path[0])[:, :2].T)
    against.plot(times, distance, color=PATH, label="horizontal distance")
    if error_bar is not None and np.isfinite(error_bar):
        against.errorbar(
            times[-1], distance[-1], error_bar, color=STRUT, capsize=5, fmt="s", label=f"end, ± {error_bar:.2g} m"
        )
    against.plot(times, path[:, 2], color=CABLE, linewidth=1, label="height")
    against.set(xlabel="time (s)", ylabel="centre of mass (m)", title="distance from the start, and height")
    against.grid(alpha=0.3)
    against.legend()
    return figure


def convergence_figure(searches: list[Evolution], names: tuple[str, ...] = (), unit: str = "m") -> Figure:
    """Best and median fitness of each generation of the searches that followed each other, with their `names`."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    first = 1
    for number, search in enumerate(searches):
        numbers = np.arange(first, first + len(search.best))
        for values, colour, kind in ((search.best, STRUT, "best"), (search.median, PATH, "median")):
            axes.plot(numbers, values, "o-", markersize=3, color=colour, label=None if number else kind)
        if len(searches) > 1:
            axes.axvspan(numbers[0] - 0.5, numbers[-1] + 0.5, color=GROUND, alpha=0.6 if number % 2 else 0.2, lw=0)
            axes.text(numbers.mean(), 0.02, names[number], ha="center", transform=axes.get_xaxis_transform())
        first += len(search.best)
    rollouts = sum(search.rollouts for search in searches)
    title = f"{rollouts} rollouts, not yet verified"
    axes.set(xlabel="generation", ylabel=f"fitness ({unit})" if unit else "fitness", title=title)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def fidelity_figure(
    names: tuple[str, ...], fitness: np.ndarray, evolved: int, correlations: tuple, unit: str
) -> Figure:
    """Fitness of the same gaits on every fidelity level but the last, against the last; the first `evolved` columns
    evolved.

    `correlations` are the levels' rank correlations over all gaits, and over the evolved ones: two square arrays.
    """
    figure = Figure(figsize=(4.2 * (len(names) - 1), 4.4), layout="constrained")
    every, among = correlations
    for k, axes in enumerate(figure.subplots(1, len(names) - 1, squeeze=False)[0]):
        axes.plot(fitness[-1, evolved:], fitness[k, evolved:], "o", color=CABLE, alpha=0.7, label="random gaits")
        axes.plot(fitness[-1, :evolved], fitness[k, :evolved], "o", color=PATH, alpha=0.7, label="evolved gaits")
        both = fitness[[k, -1]][:, np.isfinite(fitness[[k, -1]]).all(0)]
        axes.plot(*[[both.min(), both.max()]] * 2, color=CABLE, linewidth=0.8, label="equal")
        axes.set(xlabel=f"{names[-1]} ({unit})", ylabel=f"{names[k]} ({unit})")
        axes.set_title(f"rank correlation {every[k, -1]:.2f}, of the evolved {among[k, -1]:.2f}", fontsize="medium")
        axes.legend(fontsize="small")
        axes.grid(alpha=0.3)
    return figure


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
            label=f"{name}: {each.mean():.3f} {unit}, standard deviation {each.std():.2g}",
        )
        axes.axvline(each.mean(), color=colour, linestyle=":")
    axes.set(
        xlabel=f"objective ({unit})" if unit else "objective",
        ylabel="share of the robots",
        title="what perturbed robots reach",
    )
    axes.legend(fontsize="small", loc="upper left")
    return figure


def member_figure(scene: Scene, trajectory: Trajectory) -> Figure:
    """Length of every member against time, with the actuated members' rest lengths as dashed lines."""
    q, times = np.asarray(trajectory.positions), np.asarray(trajectory.times)
    kinds = [(n, m) for n, m in (("struts", scene.structure.struts), ("cables", scene.structure.cables)) if m]
    figure = Figure(figsize=(9, 3.2 * len(kinds)), layout="constrained")
    first = 0
    for axes, (name, members) in zip(figure.subplots(len(kinds), 1, squeeze=False)[:, 0], kinds):
        lengths = np.array([edge_lengths(x, members.edges) for x in q])
        rest = np.array([rest_length(members, scene.gait, t, first) for t in times])
        many, dashed = len(members.edges) > 8, ""
        for k, edge in enumerate(members.edges):
            actuated = scene.gait is not None and first + k in scene.gait.members
            line = axes.plot(times, lengths[:, k], linewidth=1, label=None if many else f"{edge[0]}-{edge[1]}")[0]
            if actuated:
                dashed = ", dashed: rest length"
                axes.plot(times, rest[:, k], "--", linewidth=1, color=line.get_color(), alpha=0.7)
        axes.set(xlabel="time (s)", ylabel="length (m)", title=f"{name}{dashed}")
        axes.grid(alpha=0.3)
        if not many:
            axes.legend(title="nodes", loc="center left", bbox_to_anchor=(1, 0.5))
        first += len(members.edges)
    return figure


def outcomes_figure(com_start: np.ndarray, com_end: np.ndarray, failed: np.ndarray) -> Figure:
    """Where each robot of a population got to, from above."""
    figure = Figure(figsize=(5.5, 5), layout="constrained")
    axes = figure.subplots()
    moved = (com_end - com_start)[~failed]
    axes.plot(0, 0, "o", color="black", label="start")
    axes.scatter(moved[:, 0], moved[:, 1], s=18, color=PATH, label=f"end of {len(moved)} gaits")
    title = f"{int(failed.sum())} of {len(failed)} rollouts failed" if failed.any() else "displacement of each gait"
    axes.set(xlabel="x (m)", ylabel="y (m)", title=title)
    axes.axis("equal")
    axes.grid(alpha=0.3)
    axes.legend()
    return figure


def _frame(axes: Axes3D | Axes, centre: np.ndarray, half: float) -> None:
    """Equal axes about `centre`, with units."""
    for name, middle in zip("xyz", centre):
        axes.set(**{f"{name}lim": (middle - half, middle + half), f"{name}label": f"{name} (m)"})

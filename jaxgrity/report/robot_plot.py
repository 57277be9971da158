"""Figures of a robot and its motion: its structure, path, members, gait and energy."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform

from jaxgrity.core.display import in_digits, significant
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.model.actuation import Gait, contraction, rest_lengths_along
from jaxgrity.model.pulleys import built_lengths
from jaxgrity.model.rigidity import lines_between_points
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure
from jaxgrity.populations.forces import forces_along
from jaxgrity.populations.motion_kinds import Rolling
from jaxgrity.report.poses import on_ground
from jaxgrity.report.style import CABLE, GROUND, PATH, STRUT, styled
from jaxgrity.stepping.simulate import Trajectory, centre_path, driven, with_room
from jaxgrity.trust.energy_audit import EnergyAudit

SLACK_UP_TO = 1e-9
"""Share of the largest force up to which a cable's tension is rounding: it counts as slack."""
VISIBLE = 2e-3
"""Share of a length below which its distance to the rest length cannot be seen in a figure."""
COLOURS = 8
"""Number of colours of the style sheet, and so the most members with a colour each."""


def drawn_lines(structure: Structure) -> list[tuple[np.ndarray, str, float]]:
    """Nodes of the lines (lines, 2) that show a robot, their colour and width: of struts and bodies, and of cables."""
    struts, cables = (() if members is None else members.edges for members in (structure.struts, structure.cables))
    bars = (*struts, *lines_between_points(structure.bodies))
    shown = (bars, STRUT, 3.5), (cables, CABLE, 1.0)
    return [(np.asarray(lines), colour, width) for lines, colour, width in shown if lines]


def draw_robot(axes: Axes3D, scene: Scene, q: np.ndarray, number: bool = False) -> list:
    """Struts and rigid bodies (red, thick), cables (dark, thin) and nodes at positions `q` (nodes, 3), with node
    numbers on request."""
    artists = []
    for edges, colour, width in drawn_lines(scene.structure):
        artists.append(axes.add_collection3d(Line3DCollection(q[edges], colors=colour, linewidths=width)))
    artists.append(axes.scatter(*q.T, color="black", s=12, depthshade=False))
    if number:
        rim = [withStroke(linewidth=2, foreground="white")]  # where a member is behind it
        places = beside(q, np.radians(axes.azim), np.radians(axes.elev))
        for k, place in enumerate(places):
            artists.append(axes.text(*place, str(k), ha="center", va="center", zorder=10, path_effects=rim))
    return artists


def beside(q: np.ndarray, azimuth: float, elevation: float) -> np.ndarray:
    """(nodes, 3), m: places outward of the nodes as one sees them, so that no number hides the node that it names.

    Args:
        q: (nodes, 3), m
        azimuth: of the view, rad
        elevation: of the view, rad
    """
    across = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    upward = np.array([*(-np.sin(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])), np.cos(elevation)])
    seen = np.stack([across, upward])
    flat = (q - q.mean(0)) @ seen.T
    far = np.linalg.norm(flat, axis=1, keepdims=True)
    return q + 0.11 * far.max() * (flat / np.where(far > 0, far, 1.0)) @ seen


@styled
def structure_figure(scene: Scene) -> Figure:
    """The structure at its start, with node numbers."""
    figure = Figure(figsize=(5, 5), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    q = np.asarray(scene.structure.nodes)
    draw_robot(axes, scene, q, number=True)
    _frame(axes, q.mean(0), np.ptp(q, axis=0).max() / 1.7)
    return figure


@styled
def path_figure(scene: Scene, trajectory: Trajectory, error_bar: float | None = None) -> Figure:
    """The path of the centre of mass, from above, and its distance from the start against time."""
    path, times = centre_path(scene, trajectory), np.asarray(trajectory.times)
    figure = Figure(figsize=(10, 4.5), layout="constrained")
    above, against = figure.subplots(1, 2)
    above.plot(path[:, 0], path[:, 1], color=PATH)
    above.plot(*path[0, :2], "o", color="black", label=f"start, t = {times[0]:g} s")
    above.plot(*path[-1, :2], "s", color=STRUT, label=f"end, t = {times[-1]:g} s")
    above.set(xlabel="x (m)", ylabel="y (m)", title="path of the centre of mass, from above")
    above.axis("equal")
    above.legend()
    distance = np.hypot(*(path - path[0])[:, :2].T)
    against.plot(times, distance, color=PATH, label="horizontal distance")
    if error_bar is not None:
        # a bar longer than the distance says no more than that the end cannot be predicted
        known = error_bar <= distance[-1]
        label = f"end, ± {in_digits(error_bar, 2)} m" if known else "end, which depends on the time step"
        bar = error_bar if known else None
        against.errorbar(times[-1], distance[-1], bar, color=STRUT, capsize=5, fmt="s", label=label)
    against.plot(times, path[:, 2], color=CABLE, linewidth=1, label="height")
    against.set(xlabel="time (s)", ylabel="centre of mass (m)", title="distance from the start, and height")
    against.legend()
    return figure


@styled
def still_figure(scene: Scene, trajectory: Trajectory) -> Figure:
    """The robot at its start (pale) and at its end, and the path of its centre of mass on the ground between."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.add_subplot(projection="3d", computed_zorder=False)
    q, path = np.asarray(trajectory.positions), centre_path(scene, trajectory)
    trail = axes.plot(*on_ground(scene, path).T, color=PATH)
    first, last = draw_robot(axes, scene, q[0]), draw_robot(axes, scene, q[-1])
    for artist in first:
        artist.set_alpha(0.25)
    for artist in (*trail, *first, *last):
        artist.set_clip_on(False)  # Matplotlib draws 3D axes as a square, narrower than the figure
        artist.set_in_layout(False)
    shown = np.concatenate([q[0], q[-1], path])
    low, high = shown.min(0), shown.max(0)
    low[2] = min(0.0, low[2])
    flat = np.maximum(0.1 * np.max(high - low) - (high - low), 0)  # a box without depth cannot be drawn
    low, high = low - flat / 2, high + flat / 2
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.view_init(elev=25, azim=side_view(path))
    axes.set_axis_off()
    moved = significant(float(np.hypot(*(path[-1] - path[0])[:2])), 2)
    axes.set_title(f"{float(trajectory.times[0]):g} s (pale) to {float(trajectory.times[-1]):g} s: {moved} m")
    axes.set_box_aspect(high - low, zoom=_zoom_that_fits(axes, high - low, shown))
    return figure


def side_view(centre: np.ndarray) -> float:
    """The azimuth, in degrees, with the motion of a centre (frames, 3) across the picture."""
    x, y = (centre[-1] - centre[0])[:2]
    return float(np.degrees(np.arctan2(y, x))) - 75


def _zoom_that_fits(axes: Axes3D, sides: np.ndarray, points: np.ndarray) -> float:
    """The zoom with which a 3D picture of these points fills its figure, with a box of these sides around them."""
    axes.set_box_aspect(sides)
    axes.figure.draw_without_rendering()  # lays the figure out
    around, zoom = axes.bbox, 1.0
    middle = np.array([(around.x0 + around.x1) / 2, (around.y0 + around.y1) / 2])
    room = np.minimum(middle - axes.figure.bbox.min, np.array([axes.figure.bbox.x1, around.y1]) - middle)
    for _ in range(4):  # what is nearer grows faster
        axes.set_box_aspect(sides, zoom=zoom)
        across = np.stack(proj_transform(*points.T, axes.get_proj())[:2], axis=-1)
        reach = np.abs(axes.transData.transform(across) - middle).max(0)
        zoom *= float(0.95 * np.min(room / np.maximum(reach, 1e-9)))
    return zoom


def _panels_of_members(structure: Structure) -> tuple[Figure, list[tuple[Axes, str, Members, int]]]:
    """A figure with a panel for struts and one for cables: their names, members, and number of the first member.

    Raises `InputError` where there are neither.
    """
    kinds = structure.numbered
    if not kinds:
        raise InputError("the structure has no members; expected some, to draw a figure of")
    figure = Figure(figsize=(9, 3.2 * len(kinds)), layout="constrained")
    panels = figure.subplots(len(kinds), 1, squeeze=False)[:, 0]
    return figure, [(axes, *kind) for axes, kind in zip(panels, kinds)]


def _lines_of_members(axes: Axes, times: np.ndarray, rows: np.ndarray, members: Members) -> list[Line2D]:
    """A line for each member, of the columns of (frames, members). Many are grey: their colours would repeat."""
    if len(members.edges) > COLOURS:
        return axes.plot(times, rows, linewidth=0.8, color=CABLE, alpha=0.5)
    lines = axes.plot(times, rows, linewidth=1, label=[f"{i}-{j}" for i, j in members.edges])
    axes.legend(title="nodes", loc="center left", bbox_to_anchor=(1, 0.5))
    return lines


@styled
def member_figure(scene: Scene, trajectory: Trajectory) -> Figure:
    """Length of every member against time, with the actuated members' rest lengths as dashed lines."""
    scene = driven(scene, trajectory)
    q, times = np.asarray(trajectory.positions), np.asarray(trajectory.times)
    figure, panels = _panels_of_members(scene.structure)
    for axes, name, members, first in panels:
        lengths = np.array([built_lengths(members, x) for x in q])
        rest = np.asarray(rest_lengths_along(members, scene.gait, with_room(times, q.shape[1]), first))[: len(times)]
        lines, dashed = _lines_of_members(axes, times, lengths, members), ""
        for k, line in enumerate(lines):
            actuated = scene.gait is not None and first + k in scene.gait.members
            if actuated and not np.allclose(rest[:, k], lengths[:, k], rtol=VISIBLE, atol=0):
                dashed = ", dashed: rest length"
                axes.plot(times, rest[:, k], "--", linewidth=1, color=line.get_color(), alpha=0.7)
        low, high = axes.get_ylim()
        if high - low < VISIBLE * high:  # rigid struts: only rounding is left of their motion
            axes.set_ylim(low * (1 - VISIBLE), high * (1 + VISIBLE))
        axes.set(xlabel="time (s)", ylabel="length (m)", title=f"{name}{dashed}")
    return figure


@styled
def force_figure(scene: Scene, trajectory: Trajectory) -> Figure:
    """Force in every member against time, N, tension positive; slack cables are those at zero."""
    forces, times = forces_along(scene, trajectory).tension, np.asarray(trajectory.times)
    figure, panels = _panels_of_members(scene.structure)
    for axes, name, members, first in panels:
        rows = forces[:, first : first + len(members.edges)]
        _lines_of_members(axes, times, rows, members)
        pulls = rows > SLACK_UP_TO * np.abs(forces).max(initial=0)
        slack = f", {np.mean(~pulls):.0%} of the time slack" if name == "cables" else ""
        axes.set(xlabel="time (s)", ylabel="tension (N)", title=f"{name}{slack}")
    return figure


@styled
def energy_figure(audit: EnergyAudit) -> Figure:
    """The uses of the actuators' work, as stacked areas against time, J: potential, kinetic, lost by each cause.

    Potential energy counts from its lowest value. So the areas add up to the energy at the start plus the actuators'
    work since (the line); a gap between the areas and the line is the error of the time steps.
    """
    figure = Figure(figsize=(8, 4.4), layout="constrained")
    axes = figure.subplots()
    lowest = audit.potential.min()
    parts = {"potential": audit.potential - lowest, "kinetic": audit.kinetic}
    parts |= {f"lost by {cause}": lost for cause, lost in audit.dissipated.items()}
    axes.stackplot(audit.times, list(parts.values()), labels=list(parts), alpha=0.8)
    given = audit.potential[0] - lowest + audit.kinetic[0] + audit.actuation
    axes.plot(audit.times, given, color="black", label="at the start, and\nwork of the actuators")
    axes.set(xlabel="time (s)", ylabel="energy (J)", title="where the actuators' work goes")
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


@styled
@typed
def gait_figure(gait: Gait, duration: float | None = None, motion: Rolling | None = None, begin: float = 0.0) -> Figure:
    """Rest lengths of the actuated members over time, as shares of the full ones; below, the support faces.

    Two periods from the gait's full amplitude on, or all from `begin` to `duration`, s, where given; `motion`, with the
    names of the faces, belongs to that.
    """
    full = float(gait.start + gait.ramp)
    begin, end = (full, full + 2 / float(np.min(gait.frequency))) if duration is None else (begin, duration)
    times = np.linspace(begin, end, 400)
    lengths = np.array([1 - np.asarray(contraction(gait, t)) for t in times]).T
    rows = len(gait.members)
    strips = [max(1.6, 0.28 * rows), 0.7] if motion is not None else [max(1.6, 0.28 * rows)]
    figure = Figure(figsize=(8, sum(strips) + 1.3), layout="constrained")
    panels = figure.subplots(len(strips), 1, squeeze=False, sharex=True, height_ratios=strips)[:, 0]
    extent = (begin, end, rows - 0.5, -0.5)
    picture = panels[0].imshow(lengths, aspect="auto", extent=extent, cmap="cividis", interpolation="nearest")
    every = 1 if rows <= 12 else 4
    panels[0].set(
        ylabel="member", yticks=range(0, rows, every), yticklabels=gait.members[::every], title="rest lengths"
    )
    panels[0].grid(False)
    figure.colorbar(picture, ax=list(panels), label="share of the full rest length")
    if motion is not None:
        _draw_supports(panels[1], motion, begin, end)
    panels[-1].set(xlabel="time (s)", xlim=(begin, end))
    return figure


def _draw_supports(axes: Axes, motion: Rolling, begin: float, end: float) -> None:
    """A strip of the support faces in turn, with names where there is room."""
    until = [*motion.since[1:], end]
    for k, (face, since, to) in enumerate(zip(motion.supports, np.maximum(motion.since, begin), until)):
        share = (to - since) / (end - begin)
        if share > 0:
            axes.axvspan(since, to, color=GROUND if k % 2 else "#bdb7a8", lw=0)
        if share > 0.03:
            angle = 0 if share > 0.1 else 90
            name = "-".join(map(str, face))
            axes.text((since + to) / 2, 0.5, name, ha="center", va="center", fontsize=10, rotation=angle)
    axes.set(ylim=(0, 1), yticks=[], ylabel="face")
    axes.grid(False)


def _frame(axes: Axes3D | Axes, centre: np.ndarray, half: float) -> None:
    """Equal axes about `centre`, with units."""
    for name, middle in zip("xyz", centre):
        axes.set(**{f"{name}lim": (middle - half, middle + half), f"{name}label": f"{name} (m)"})

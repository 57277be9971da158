"""Pictures of structures at rest: the catalogue, and the forces in members."""

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from scipy.spatial import ConvexHull

from jaxgrity.report.style import CABLE, STRUT, styled
from jaxgrity.statics.inspection import StructureReport
from jaxgrity.statics.stiffness import all_edges
from jaxgrity.structures.geometry import RobotGeometry

COLOUR_MAP = "coolwarm_r"
"""Name of Matplotlib's colour map that shows compression red and tension blue."""


@styled
def geometry_figure(structures: dict[str, RobotGeometry]) -> Figure:
    """Struts and bodies (red) and cables (dark) of one structure, or of many beside each other, by their names."""
    columns = min(len(structures), 5)
    rows = -(-len(structures) // columns)
    apart = ConstrainedLayoutEngine(h_pad=0.1)  # inches
    figure = Figure(figsize=(2.2 * columns, 2.7 * rows), layout=apart)
    for number, (name, geometry) in enumerate(structures.items(), start=1):
        axes = figure.add_subplot(rows, columns, number, projection="3d")
        q = np.asarray(geometry.nodes)
        for edges, colour, width in ((geometry.struts, STRUT, 2.5), (geometry.cables, CABLE, 0.9)):
            if edges:
                axes.add_collection3d(Line3DCollection(q[np.asarray(edges)], colors=colour, linewidths=width))
        for body in geometry.bodies:
            points = q[list(body.points)]
            hull = points[ConvexHull(points).simplices]
            axes.add_collection3d(Poly3DCollection(hull, facecolors=STRUT, edgecolors=STRUT, linewidths=0.6, alpha=0.3))
        _fit(axes, q)
        axes.set_axis_off()
        rigid = f"{len(geometry.bodies)} bodies" if geometry.bodies else f"{len(geometry.struts)} struts"
        counts = f"{len(q)} nodes,\n{rigid}, {len(geometry.cables)} cables"
        axes.set_title(f"{name}\n{counts}", fontsize=11)
    return figure


@styled
def resting_force_figure(report: StructureReport) -> Figure:
    """The forces in all members, in the shape at rest by colour and, one bar each, by size."""
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    axes, bars = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    forces, q = np.asarray(report.forces), np.asarray(report.shape)
    size = max(float(np.abs(forces).max()), 1e-12)
    norm = TwoSlopeNorm(0, -size, size)
    edges, first = np.asarray(all_edges(report.structure)), report.structure.first_cable
    widths = np.r_[np.full(first, 3.5), np.full(len(edges) - first, 1.5)]
    axes.add_collection3d(Line3DCollection(q[edges], array=forces, cmap=COLOUR_MAP, norm=norm, linewidths=widths))
    _fit(axes, q)
    axes.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(4))
        axis.labelpad = 8
    axes.set_title("at rest" if report.at_rest else "as given: no equilibrium found")
    shown = ScalarMappable(norm, COLOUR_MAP)
    figure.colorbar(shown, ax=axes, label="force (N), tension positive", shrink=0.7, pad=0.1)
    bars.bar(np.arange(len(forces)), forces, color=shown.to_rgba(forces), edgecolor=CABLE, linewidth=0.4)
    bars.axhline(0, color=CABLE, linewidth=0.8)
    if 0 < first < len(forces):
        bars.axvline(first - 0.5, color=CABLE, linestyle=":", label=f"struts left, cables from {first} on")
        bars.legend()
    bars.set(xlabel="member", ylabel="force (N)")
    bars.set_title("member forces")
    bars.grid(visible=False, axis="x")
    return figure


def _fit(axes, q: np.ndarray) -> None:
    """All of the structure, at one scale."""
    centre, half = (q.max(0) + q.min(0)) / 2, max(float(np.ptp(q, axis=0).max()) / 2, 1e-9)
    axes.set(**{f"{name}lim": (c - half, c + half) for name, c in zip("xyz", centre)})
    axes.set_box_aspect((1, 1, 1), zoom=1.1)

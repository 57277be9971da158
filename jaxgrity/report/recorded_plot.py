"""The figure of recorded motions beside their simulations."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from jaxgrity.identification.recorded_motions import Compared
from jaxgrity.model.scene import Scene
from jaxgrity.report.style import CABLE, PATH, STRUT, WIDTH, styled

LOOKS = ((STRUT, "--"), (PATH, "-"))
"""Colour and line of simulations: of the scene as it is, and after identification."""


@styled
def recorded_figure(scene: Scene, parts: Mapping[str, Mapping[str, Compared]], share: float) -> Figure:
    """Centre of mass and error over time, recorded and simulated; a row for each part, whose simulations have names.

    Gaps: nodes were not seen. A thin line is at `share`, m, within which a simulation counts as close.
    """
    figure = Figure(figsize=(WIDTH, 2.8 * len(parts) + 0.6), layout="constrained")
    mass = np.asarray(scene.structure.lumped_mass, float)
    mass = mass / mass.sum()
    for (title, simulations), (centre, error) in zip(parts.items(), figure.subplots(len(parts), 2, squeeze=False)):
        some = next(iter(simulations.values()))
        recorded = np.where(scene.structure.free, some.recorded, scene.structure.nodes)
        path = np.einsum("n,fnk->fk", mass, recorded)
        for axis, way in zip("xyz", path.T - path[:1].T):
            centre.plot(some.times, way, ".", color=CABLE, markersize=3, label="recorded" if axis == "x" else None)
        error.plot(some.times, some.moved(), ":", color=CABLE, label="as if it had not moved")
        for (name, each), (colour, line) in zip(simulations.items(), LOOKS):
            ways = np.einsum("n,fnk->fk", mass, np.asarray(each.simulated)) - path[:1]
            for k, (axis, way) in enumerate(zip("xyz", ways.T)):
                centre.plot(some.times, way, line, color=colour, label=name if axis == "x" else None)
                last = np.flatnonzero(np.isfinite(way))
                if last.size and each is some:
                    centre.annotate(
                        axis, (some.times[last[-1]], way[last[-1]]), (4 + 9 * k, 0), textcoords="offset points"
                    )
            error.plot(some.times, each.errors(), line, color=colour)
        error.axhline(share, color=CABLE, linewidth=0.8)
        centre.set(title=title, xlabel="time (s)", ylabel="centre of mass moved by (m)")
        error.set(title="distance from where nodes were seen", xlabel="time (s)", ylabel="root mean square (m)")
        error.set_ylim(bottom=0.0)
    both = [a + b for a, b in zip(centre.get_legend_handles_labels(), error.get_legend_handles_labels())]
    figure.legend(*both, loc="outside lower center", ncols=4)
    return figure

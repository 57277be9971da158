"""Figure 1: the enumerated six-strut icosahedron."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from paper_claims.report import CALLED, PROGRAM, REFERENCE, Report, Row, scenes, significant, verdict

from jaxgrity import Scene
from jaxgrity.report import plot


def check(quick: bool) -> Report:
    """Counts, how close struts come to each other, and how many cables meet at a node; the drawing."""
    known = scenes()
    facts = {name: geometry(scene) for name, scene in known.items()}
    rows = []
    for name, found in facts.items():
        apart = found["strut_gap"] > 1e-6
        holds = (found["struts"], found["cables"]) == (6, 24) and apart
        rows.append(
            Row(
                "six struts that do not touch, in a net of 24 cables",
                "2.1, Fig. 1",
                name,
                f"{found['struts']} struts, {found['cables']} cables, {found['cables_per_node']} at each node; struts "
                f"pass each other at {significant(1e3 * found['strut_gap'], 'mm')}",
                verdict(holds),
                "the orthogonal icosahedron, three pairs of parallel struts"
                if holds
                else "opposite vertices joined: all struts cross in one point, which nobody can build, and all 30 "
                "edges are cables",
            )
        )
    return Report("The structure", rows, "structure", {"facts": facts})


@plot.styled
def figure(facts: dict) -> Figure:
    known, chart = scenes(), Figure(figsize=(plot.WIDTH, 5))
    for place, name in enumerate((REFERENCE, PROGRAM)):
        axes = chart.add_subplot(1, 2, place + 1, projection="3d")
        q = np.asarray(known[name].structure.nodes)
        plot.draw_robot(axes, known[name], q, number=True)
        half = np.ptp(q, axis=0).max() / 1.7
        for axis, middle in zip("xyz", q.mean(0)):
            axes.set(**{f"{axis}lim": (middle - half, middle + half), f"{axis}label": f"{axis} (m)"})
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.set_major_locator(MaxNLocator(5))
            axis.labelpad = 8
        axes.set_title(f"{CALLED[name]}: {facts[name]['struts']} struts (red), {facts[name]['cables']} cables (dark)")
    chart.subplots_adjust(left=0.0, right=0.95, bottom=0.06, top=0.93, wspace=0.1)  # 3D labels count in no layout
    return chart


def geometry(scene: Scene) -> dict:
    """Numbers of members, and the smallest distance between two struts, m."""
    q, struts, cables = np.asarray(scene.structure.nodes), scene.structure.struts, scene.structure.cables
    axes = q[np.asarray(struts.edges)]
    gaps = [segment_gap(*axes[a], *axes[b]) for a in range(len(axes)) for b in range(a)]
    degree = np.bincount(np.ravel(cables.edges))
    return {
        "struts": len(struts.edges),
        "cables": len(cables.edges),
        "cables_per_node": int(degree.max()) if np.ptp(degree) == 0 else degree.tolist(),
        "strut_gap": min(gaps),
    }


def segment_gap(a, b, c, d) -> float:
    """Smallest distance between the segments a-b and c-d whose middles are nearest: on a fine grid of both, m."""
    s = np.linspace(0, 1, 201)
    first, second = a + s[:, None] * (b - a), c + s[:, None] * (d - c)
    return float(np.linalg.norm(first[:, None] - second[None], axis=-1).min())

"""Implicit against explicit on stiff scenes: steps that Kvaerno's methods and Tsit5 take to the same tolerance.

The robot of the scene "reference", with struts, ground or friction made far stiffer, rolls for two seconds.
"""

from collections.abc import Iterator
from itertools import product

import equinox as eqx
import numpy as np
from measurements.engines import clock
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns

from jaxgrity import FAILURES, Scene, SolverOptions, centre_path, load_scene, simulate

METHODS = ("tsit5", "kvaerno3", "kvaerno5")


@measurement(page="accuracy.md", quick={"duration": 0.5, "tolerances": (1e-4,)}, raw=("outcome",))
def stiff(duration: float = 2.0, tolerances: tuple[float, ...] = (1e-4, 1e-6)) -> Iterator[Record]:
    """A row for each scene, tolerance and method.

    Args:
        duration: s
        tolerances: relative, and absolute in m and m/s
    """
    for name, scene in stiff_scenes(load_scene("reference")).items():
        truth = simulate(scene, duration, options=SolverOptions("dopri8", rtol=1e-10, atol=1e-10))
        for tolerance, method in product(tolerances, METHODS):
            yield {"scene": name, **cost(scene, duration, method, tolerance, truth)}


def stiff_scenes(scene: Scene) -> dict[str, Scene]:
    """Struts of 1e6 N/m, ground of 1e6 N/m, a slip speed of 1e-3 m/s, and all three at once."""
    parts = {
        "K = 1e6": (lambda s: s.structure.struts.stiffness, np.full(6, 1e6)),
        "k_n = 1e6": (lambda s: s.ground.stiffness, np.asarray(1e6)),
        "eps = 1e-3": (lambda s: s.friction.slip_speed, np.asarray(1e-3)),
    }
    scenes, together = {"as it is": scene}, scene
    for name, (part, value) in parts.items():
        scenes[name] = eqx.tree_at(part, scene, value)
        together = eqx.tree_at(part, together, value)
    return scenes | {"all three": together}


def cost(scene: Scene, duration: float, method: str, tolerance: float, truth) -> dict:
    """Steps, wall time of a warm rollout, s, and error of the centre of mass at the end, m."""

    options = SolverOptions(method, rtol=tolerance, atol=tolerance)
    roll = lambda: simulate(scene, duration, options=options)  # noqa: E731
    clock(roll)  # compiles
    seconds, trajectory = clock(roll)
    error = np.linalg.norm(centre_path(scene, trajectory)[-1] - centre_path(scene, truth)[-1])
    return {
        "tolerance": tolerance,
        "method": method,
        "steps": int(trajectory.steps),
        "rejected": int(trajectory.rejected),
        "seconds": seconds,
        "error": float(error),
        "outcome": FAILURES[int(trajectory.failure)],
    }


@stiff.table
def words(record: Record) -> str:
    """All rows."""
    return columns(
        record["rows"],
        {
            "scene": "{scene}",
            "tolerance": "{tolerance:.0e}",
            "method": "{method}",
            "steps": "{steps}",
            "rejected": "{rejected}",
            "wall time, s": "{seconds:.2f}",
            "error, m": "{error:.0e}",
        },
    )


@stiff.figure(4)
def figure(record: Record, chart: Figure) -> None:
    """Steps, rejected ones included, a panel for each tolerance."""
    rows = record["rows"]
    tolerances = list(dict.fromkeys(row["tolerance"] for row in rows))
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    for axes, tolerance in zip(np.atleast_1d(chart.subplots(1, len(tolerances), sharey=True)), tolerances):
        for k, method in enumerate(METHODS):
            mine = [row for row in rows if row["method"] == method and row["tolerance"] == tolerance]
            axes.bar(np.arange(len(scenes)) + 0.27 * k, [r["steps"] + r["rejected"] for r in mine], 0.25, label=method)
        axes.set_xticks(np.arange(len(scenes)) + 0.27, scenes, rotation=30)
        axes.set(yscale="log", ylabel="steps, accepted and rejected", title=f"tolerance {tolerance:g}")
    chart.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=len(METHODS))

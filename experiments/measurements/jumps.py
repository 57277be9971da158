"""How high the six-strut robot jumps: searches for the height, for several bounds on the rate of its struts.

Every strut moves as it likes, at one frequency. The height is that of the centre of mass over its place when the gait
begins, the highest of the whole time. Robots that differ judge each answer on both contact models.
"""

from collections.abc import Iterator

import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns

from jaxgrity import ActuatorBounds, SearchConfig, centre_path, load_scene, search_gaits, simulate
from jaxgrity.report import plot
from jaxgrity.search import EvaluationConfig, JumpHeight, SearchSpace
from jaxgrity.stepping import resolve

RATES = (1.0, 2.0, 4.0)
"""Bounds on the rates of struts, m/s."""
SHOWN = 200
"""Frames per second of the path that shows a jump."""


@measurement(
    page="gait_records.md",
    drawn=("times", "heights"),
    quick={"rates": (2.0,), "duration": 2.5, "population": 8, "generations": (1, 1)},
)
def jumps(
    rates: tuple[float, ...] = RATES,
    duration: float = 5.0,
    population: int = 64,
    generations: tuple[int, int] = (12, 2),
    seed: int = 0,
) -> Iterator[Record]:
    """A row for each bound: the height of the best gait, on robots that differ, and what its actuators need.

    Args:
        rates: bounds on the rates of struts, m/s
        duration: s
        population: gaits per generation
        generations: of screening, and on the scene's own model
        seed: of the searches
    """
    scene = load_scene("exact")
    for rate in rates:
        config = SearchConfig(
            duration=duration,
            population=population,
            generations=generations,
            seed=seed,
            space=SearchSpace(waves="none", frequency=(0.3, 4.0)),
            evaluation=EvaluationConfig(JumpHeight(), ActuatorBounds(rate=rate), both_models=False, attracting=False),
            polish=None,
        )
        found = search_gaits(scene, config)
        summary, gait = found.verdict.summary(), found.gait
        motion = simulate(found.scene, duration, frame_rate=SHOWN, options=resolve(found.scene, duration))
        heights = centre_path(found.scene, motion)[:, 2]
        yield {
            "rate": rate,
            "frequency": float(np.max(gait.frequency)),
            "stroke": float(np.max(gait.amplitude)),
            **{name: summary[name] for name in ("robust", "other_contact_model")},
            "times": np.asarray(motion.times).tolist(),
            "heights": heights.tolist(),
        }
    return {"duration": duration, "begins": float(scene.gait.start), "robots": summary["robust"]["robots"]}


@jumps.table
def words(record: Record) -> str:
    """Heights by the bound on rates."""
    cells = {
        "largest rate, m/s": "{rate:g}",
        "height of the jump, m": lambda row: _with_spread(row["robust"]),
        "on penalty contact, m": lambda row: _with_spread(row["other_contact_model"]),
        "frequency, Hz": "{frequency:.2f}",
        "largest stroke": "{stroke:.0%}",
    }
    return columns(record["rows"], cells)


def _with_spread(robots: Record) -> str:
    return f"{robots['mean']:.3f} ({robots['standard_deviation']:.2g})"


@jumps.figure(4)
def figure(record: Record, chart: Figure) -> None:
    """Heights of the centre of mass over time."""
    axes = chart.subplots()
    for row, marker in zip(record["rows"], plot.MARKERS):
        start = np.interp(record["begins"], row["times"], row["heights"])
        look = {"marker": marker, "markevery": 0.08, "markersize": 5}
        axes.plot(row["times"], np.array(row["heights"]) - start, **look, label=f"{row['rate']:g} m/s")
    axes.axvline(record["begins"], color="0.6", linewidth=1, linestyle=":")
    axes.set(xlabel="time (s)", ylabel="rise of the centre of mass (m)")
    chart.legend(loc="outside right upper", title="largest rate")

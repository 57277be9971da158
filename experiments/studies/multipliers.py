"""Floquet multipliers of orbits by the derivative of the map over a cycle, beside robots that are really disturbed.

Of the library's gait `straight` on both contact models, and of the first gait that was found to last, at three steps:
the derivative says that it repels, and yet it stays within millimetres. The figure shows how disturbances of several
sizes go on, and the map over a cycle along its most unstable direction, close up.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns
from tqdm import tqdm

from jaxgrity import (
    Differences,
    Scene,
    SolverOptions,
    contact_twin,
    gaits_of,
    load_gait,
    load_scene,
    simulate,
    simulate_population,
    with_gait,
)
from jaxgrity.orbits import FloquetMultipliers, Orbit, find_orbit, floquet_multipliers, restarted, stability
from jaxgrity.report import plot
from jaxgrity.stepping import resolve

FIRST = Path(__file__).with_name("first_lasting.json")
"""the first gait that was found to last"""
SIZES = (1e-6, 1e-4, 1e-2)
"""m/s, standard deviations of every coordinate of the velocities of robots that are disturbed"""
SETTLING = 10
"""cycles, after which a watch begins to count"""
FRAMES = 20
"""saved in each period where an orbit is looked for"""
PENALTY_STEP = 2e-4
"""s, on penalty contact: the default one is too long for some moments of a cycle, at which it may begin"""
NEAR = 2e-3
"""m, by which nodes are moved along the most unstable direction, at most"""


class Case(NamedTuple):
    """A gait on one contact model, at one step."""

    gait: str
    scene: Scene
    part: int = 1
    """of the scene's own step"""

    @property
    def contact(self) -> str:
        return "exact" if self.scene.constrained else "penalty"


@measurement(
    page="gait_records.md",
    quick={"duration": 80.0, "cycles": 20, "moments": 2, "robots": 2, "followed": 10, "close": 51, "finer": False},
    drawn=("curves", "map"),
)
def multipliers(
    duration: float = 120.0,
    cycles: int = 100,
    moments: int = 8,
    robots: int = 6,
    followed: int = 40,
    close: int = 801,
    finer: bool = True,
) -> Iterator[Record]:
    """A row for each gait, contact model and step.

    Args:
        duration: s, for which orbits are looked for
        cycles: number of cycles for which each orbit is watched then
        moments: beginnings of cycles at which multipliers are taken; on penalty contact, which takes long, a quarter
        robots: number of robots that are disturbed, of each size
        followed: number of cycles for which they are followed
        close: number of robots by which the map is drawn
        finer: with penalty contact and finer steps, beside exact contact at its own step
    """
    periods: dict[tuple[str, str], int] = {}
    for case in cases(finer):
        options = step_of(case)
        orbit = find_orbit(case.scene, duration, options=options)
        # finer steps may return more closely after twice as many periods; all of one gait are told of as many
        orbit = orbit._replace(periods=periods.setdefault((case.gait, case.contact), orbit.periods))
        found, facts = largest(case, orbit, options, moments)
        row = {"gait": case.gait, "contact": case.contact, "part": case.part, "periods": orbit.periods}
        row |= watched(case.scene, orbit, options, cycles) | facts | {"disturbed": None}
        if case.contact == "exact":
            curves = np.median(deviations(case.scene, orbit, options, robots, followed), axis=1)
            row["curves"] = curves.tolist()
            row["disturbed"] = {f"{size:g}": float(curve[-1]) for size, curve in zip(SIZES, curves)}
        if case.gait != "straight" and case.part in (1, 4):
            row["map"] = close_up(case.scene, orbit, options, found, close)
        yield row
    return {"followed": followed}


@multipliers.table
def words(record: Record) -> str:
    """Multipliers by the derivative, beside those by disturbed robots."""
    cells = {
        "gait, contact": lambda row: (
            f"{row['gait']}, {row['contact']}" + ("" if row["part"] == 1 else f", 1/{row['part']} of the step")
        ),
        "cycle, periods": "{periods}",
        "residual, mm": lambda row: f"{1e3 * row['residual']:.2g}",
        "cycles examined": "{moments}",
        "largest multiplier by the derivative": lambda row: span(row["derivative"]),
        "by disturbed robots": lambda row: "-" if row["by_disturbance"] is None else span(row["by_disturbance"]),
    }
    return columns(record["rows"], cells)


def span(values: list[float]) -> str:
    """From the least to the largest, with two digits."""
    low, high = f"{min(values):.2g}", f"{max(values):.2g}"
    return low if low == high else f"{low} to {high}"


def cases(finer: bool) -> list[Case]:
    """The rows of the table."""
    exact = load_scene("exact")
    straight, first = (with_gait(exact, load_gait(name)) for name in ("straight", FIRST))
    few = [Case("straight", straight), Case("first lasting", first)]
    rest = [Case("straight", contact_twin(straight)), *(Case("first lasting", first, part) for part in (2, 4))]
    return [few[0], rest[0], few[1], *rest[1:]] if finer else few


def step_of(case: Case) -> SolverOptions:
    """The scene's own step, a little shorter, so that each frame of a period has a whole number; or a part of it."""
    own, period = resolve(case.scene, 1.0), 1 / float(case.scene.gait.frequency[0])
    dt = float(own.dt) if case.scene.constrained else PENALTY_STEP
    steps = FRAMES * int(np.ceil(period / FRAMES / dt)) * case.part
    return SolverOptions(own.method.name, dt=period / steps, dtype="float64")


def largest(case: Case, orbit: Orbit, options: SolverOptions, moments: int) -> tuple[FloquetMultipliers, Record]:
    """Those of the first moment, and the least and largest of all: by the derivative, and by robots off by 0.1 m/s."""
    found, disturbed = [], []
    if case.contact != "exact":
        moments = max(1, moments // 4)
    for k in tqdm(range(moments), desc=f"{case.gait}, {case.contact}, dt / {case.part}", leave=False):
        found.append(floquet_multipliers(case.scene, orbit, options=options, after=(SETTLING + k) * orbit.periods))
        there = orbit._replace(state=found[-1].state)
        disturbed.append(stability(case.scene, there, options=options).largest)
    derivative = [each.largest for each in found]
    known = [value for value in disturbed if np.isfinite(value)]
    return found[0], {
        "moments": moments,
        "neutral_off": max(abs(value - 1) for each in found for value in each.neutral.values()),
        "derivative": [min(derivative), max(derivative)],
        "by_disturbance": [min(known), max(known)] if known else None,
    }


def shapes(positions: np.ndarray) -> np.ndarray:
    """(frames, numbers), m, of nodes (frames, nodes, 3): heights, and distances between nodes."""
    q = np.asarray(positions, float)
    i, j = np.triu_indices(q.shape[1], 1)
    return np.concatenate([q[..., 2], np.linalg.norm(q[:, i] - q[:, j], axis=2)], axis=1)


def rolled(scene: Scene, orbit: Orbit, options: SolverOptions, cycles: int, more: Any = 0.0) -> np.ndarray:
    """(cycles + 1, numbers), shapes at the beginning of each cycle, of a robot that begins so much faster, m/s."""
    here, v = restarted(scene, orbit), orbit.state[1] + more
    trajectory = simulate(here, cycles * orbit.cycle, options=options, frame_rate=1 / orbit.cycle, velocities=v)
    return shapes(trajectory.positions)


def watched(scene: Scene, orbit: Orbit, options: SolverOptions, cycles: int) -> dict[str, float]:
    """By how much shapes miss themselves after a cycle, in the median, and stray from their mean, at most; m."""
    seen = rolled(scene, orbit, options, SETTLING + cycles)[SETTLING:]
    return {
        "residual": float(np.median(np.abs(np.diff(seen, axis=0)).max(1))),
        "strays": float(np.abs(seen - seen.mean(0)).max()),
    }


def deviations(scene: Scene, orbit: Orbit, options: SolverOptions, robots: int, followed: int) -> np.ndarray:
    """(sizes, robots, cycles), m, by which the shape of a disturbed robot differs from that of one that is not."""
    alone = rolled(scene, orbit, options, followed)
    draws = [np.random.default_rng(seed).normal(size=orbit.state[1].shape) for seed in range(robots)]
    found = [[rolled(scene, orbit, options, followed, size * draw) for draw in draws] for size in SIZES]
    return np.abs(np.array(found) - alone).max(-1)[:, :, 1:]


def close_up(scene: Scene, orbit: Orbit, options: SolverOptions, found: FloquetMultipliers, robots: int) -> np.ndarray:
    """The shape's main coordinate a cycle after robots are moved along the most unstable direction, by up to `NEAR`.

    That coordinate, m, is along the direction in which the shapes then differ most: how much that height or distance
    changes that changes most.
    """
    way = np.real(found.directions[0])
    moved = np.linspace(-NEAR, NEAR, robots)
    q, v = (x + moved[:, None, None] * way[k] / np.abs(way[0]).max() for k, x in enumerate(found.state))
    here = restarted(scene, orbit._replace(state=found.state))
    gaits = gaits_of(here.gait, np.repeat(np.asarray(here.gait.phase)[None], robots, axis=0))
    start = Differences(positions=q, velocities=v)
    outcomes = simulate_population(here, gaits, orbit.cycle, options=options, differences=start)
    ends = shapes(outcomes.positions)
    ends = ends - ends[robots // 2]
    main = np.linalg.svd(ends - ends.mean(0), full_matrices=False)[2][0]
    return ends @ main * main[np.abs(main).argmax()]


@multipliers.figure(7.5)
def figure(record: Record, chart: Figure) -> None:
    """Deviations over cycles, and the map over a cycle, close up; by gait and part of the step."""
    own = [row for row in record["rows"] if row["contact"] == "exact" and row["part"] == 1]
    curves = [row["curves"] for row in own]
    mapped = [row for row in record["rows"] if "map" in row]
    above, *others = chart.subplot_mosaic([["above"] * len(mapped), [str(k) for k in range(len(mapped))]]).values()
    for row, each, first in zip(own, curves, (0, len(SIZES)), strict=True):
        for k, (size, curve) in enumerate(zip(SIZES, each, strict=True), first):
            look = {"color": f"C{k}", "marker": plot.MARKERS[k], "markevery": 4, "markersize": 5}
            middle = 1e3 * np.maximum(curve, 1e-13)
            above.semilogy(np.arange(1, len(middle) + 1), middle, **look, label=f"{row['gait']}, {1e3 * size:g} mm/s")
    above.set(xlabel="cycles since the disturbance", ylabel="difference of shape (mm)")
    title = "gait and size of a random velocity that disturbs the robot"
    above.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, title=title)
    for axes, row in zip(others, mapped, strict=True):
        after = 1e3 * np.array(row["map"])
        axes.plot(1e3 * np.linspace(-NEAR, NEAR, len(after)), after, ".", markersize=2)
        axes.set(xlabel="moved in the unstable direction (mm)", ylabel="shape a cycle later (mm)")
        axes.set_title(f"{row['gait']}, {'own step' if row['part'] == 1 else '1/{part} of the step'.format(**row)}")

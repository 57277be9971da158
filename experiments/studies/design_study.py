"""How fast can a six-strut robot roll for given actuators?

Stiffness and prestress of its cables, lengths of its struts, its mass, and swing and frequency of its gait are chosen
for the largest steady speed at each limit of power, with struts that may buckle and cables that may tear; beside it,
the gait alone, on the robot of the scene as it is. What is reported was verified on the orbit, not by the search.
"""

import time
from collections.abc import Iterator
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table
from studies.design_space import GAIT_ALONE, HIGHEST, LOWEST, NAMES, Limits, Tried, keeps, on_orbit, tried
from tqdm import tqdm

from jaxgrity import InputError, Scene, load_gait, load_scene, with_gait
from jaxgrity.report import plot

KINDS = {"gait alone": GAIT_ALONE, "robot and gait": np.ones(len(NAMES))}
"""what is free"""
FIRST_STEP, ELITE = 0.25, 0.25
"""of the ranges, the first standard deviation of draws; share of the draws that the next ones are drawn around"""
VERIFIED = 12
"""designs of a search, its best first, of which the first that keeps all limits on its orbit is reported"""
ROLLS = 0.1
"""m/s, below which a robot counts as staying where it is"""


class Size(NamedTuple):
    """What each search shares."""

    limits: Limits
    designs: int
    """in a generation"""
    duration: float
    """s, of a rollout"""


@measurement(page="gait_records.md", quick={"powers": (160.0,), "designs": 6, "generations": (1, 1)})
def design_study(
    powers: tuple[float, ...] = (10.0, 20.0, 40.0, 80.0, 160.0),
    strut_force: float = 300.0,
    cable_force: float = 150.0,
    designs: int = 128,
    generations: tuple[int, int] = (16, 8),
    duration: float = 40.0,
    seed: int = 0,
) -> Iterator[Record]:
    """A row for each limit of power, for the gait alone, and for robot and gait.

    Args:
        powers: W, that each actuator may give
        strut_force: N, at which a strut of the scene's length buckles, and the most that its actuator holds
        cable_force: N, that each cable may bear
        designs: in a generation
        generations: for each limit: from the designs of the same kind, then from those of both
        duration: s, of which the last three quarters count
        seed: of all draws
    """
    if min(*powers, strut_force, cable_force) <= 0:
        raise InputError("powers, strut_force or cable_force: not positive; expected positive limits")
    began, size = time.perf_counter(), Size(Limits(strut_force, cable_force), designs, duration)
    scene, random = with_gait(load_scene("exact"), load_gait("lasting")), np.random.default_rng(seed)
    as_built, found = tried(scene, np.zeros((1, len(NAMES))), duration), {}
    for kind, free in KINDS.items():
        found[kind] = as_built
        for power in tqdm(sorted(powers), desc=kind, unit="limit"):
            found[kind] = searched(scene, found[kind], free, size, power, generations[0], random)
    # what may change less is part of what may change more: its designs are tried too, and searched around
    every = found["gait alone"].joined(found["robot and gait"])
    for power in tqdm(sorted(powers), desc="both", unit="limit"):
        every = searched(scene, every, KINDS["robot and gait"], size, power, generations[1], random)
    found["robot and gait"] = every
    for kind, power in product(KINDS, sorted(powers)):
        yield {"kind": kind, "power": power} | first_verified(scene, found[kind], size.limits, power)
    # the second does not count what other processes took of the machine
    took = {"minutes": (time.perf_counter() - began) / 60, "processor_minutes": time.process_time() / 60}
    return {"limits": list(size.limits), "designs": len(every.x), **took}


def searched(
    scene: Scene,
    archive: Tried,
    free: np.ndarray,
    size: Size,
    power: float,
    generations: int,
    random: np.random.Generator,
) -> Tried:
    """An evolution strategy: draws around the mean of the best so far, as wide as these differ; all are kept."""
    spread, limits = FIRST_STEP * (HIGHEST - LOWEST), size.limits
    for _ in tqdm(range(generations), unit="generation", leave=False):
        best = np.argsort(-archive.worth(limits, power))[: max(2, round(ELITE * size.designs))]
        elite = archive.x[best]
        wide = np.maximum(1.2 * elite.std(0), 0.1 * spread) if len(elite) > size.designs / 8 else spread
        x = elite.mean(0) + wide * random.normal(size=(size.designs, len(NAMES)))
        archive = archive.joined(tried(scene, free * np.clip(x, LOWEST, HIGHEST), size.duration))
    return archive


def first_verified(scene: Scene, archive: Tried, limits: Limits, power: float) -> dict[str, Any]:
    """The fastest design that keeps all limits on the orbit on which it settles."""
    worth = archive.worth(limits, power)
    for k in np.argsort(-worth)[:VERIFIED]:
        if worth[k] <= ROLLS:
            break
        found = on_orbit(scene, archive.x[k])
        if keeps(found, limits, power):
            return found
    return {"speed": None}


def rolls(row: dict[str, Any]) -> bool:
    return row["speed"] is not None and row["speed"] >= ROLLS


@design_study.table
def words(record: Record) -> str:
    """The fastest design at each limit, what it needs, and its numbers as multiples of the scene's."""
    rows, designs = [], []
    for row in record["rows"]:
        about = [row["kind"], f"{row['power']:g} W"]
        if not rolls(row):
            rows.append([*about, "none rolls", *[""] * 4])
            continue
        factors = [f"{factor:.2f}" for factor in row["factors"].values()]
        asked = [f"{row[name]:.0f}" for name in ("peak_power", "strut_force", "cable_force")]
        asked.append(f"{row['cost_of_transport']:.2f}")
        rows.append([*about, f"**{row['speed']:.3f}**", *asked])
        designs.append([*about, *factors[:2], ", ".join(factors[2:5]), factors[5], ", ".join(factors[6:])])
    needed = ["power needed, W", "force of struts, N", "of cables, N", "cost of transport"]
    head = ["chosen", "power allowed", "steady speed, m/s", *needed]
    numbers = [*head[:2], "cable stiffness", "cable rest length", "pairs of struts", "mass", "swing, frequency"]
    minutes = f"{record['designs']} designs, {record['minutes']:.0f} minutes on {record['cores']} cores"
    took = f"{minutes}, {record['processor_minutes']:.0f} minutes of processor time"
    limits = f"{record['limits'][0]:g} N for struts, {record['limits'][1]:g} N for cables"
    about = table(["the study", "measured"], [["both searches", took], ["limits besides power", limits]])
    return "\n\n".join([table(head, rows), table(numbers, designs), about])


@design_study.figure(6.4)
def figure(record: Record, chart: Figure) -> None:
    """Speed and cost of transport over the power that an actuator may give, and the designs."""
    rows = record["rows"]
    (speed, cost), (design, beside) = chart.subplots(2, 2)
    beside.set_axis_off()
    found = [row for row in rows if rolls(row)]
    for kind, look in zip(KINDS, ("s", "o-")):
        own = [row for row in found if row["kind"] == kind]
        power = [row["power"] for row in own]
        # squares are larger and empty: a point of both kinds shows as both
        mark: dict[str, Any] = {"markersize": 10, "markerfacecolor": "none"} if look == "s" else {}
        speed.plot(power, [row["speed"] for row in own], look, label=kind, zorder=3, **mark)
        cost.plot(power, [row["cost_of_transport"] for row in own], look, label=kind, zorder=3, **mark)
    for name, marker in zip(NAMES, plot.MARKERS + "X"):
        built = [row for row in found if row["kind"] == "robot and gait"]
        design.plot([row["power"] for row in built], [row["factors"][name] for row in built], f"{marker}-", label=name)
    limits = sorted({row["power"] for row in rows})
    for axes in (speed, cost, design):
        axes.set(xscale="log", xlabel="power allowed per actuator (W)")
        axes.set_xticks(limits, [f"{limit:g}" for limit in limits])
        axes.set_xticks([], minor=True)
    speed.set(ylabel="steady speed (m/s)", title="How fast")
    cost.set(ylabel="cost of transport", title="At what cost")
    design.set(ylabel="multiple of the scene's number", title="Design of robot and gait")
    for axes in (speed, cost, design):
        axes.set_ylim(0, 1.08 * axes.get_ylim()[1])  # room for a mark at the top
    beside.legend(*design.get_legend_handles_labels(), loc="upper left")
    chart.legend(*speed.get_legend_handles_labels(), loc="outside upper center", ncols=2)

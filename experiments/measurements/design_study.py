"""How fast can a six-strut robot roll for given actuators?

Stiffness and prestress of its cables, lengths of its struts, its mass, and swing and frequency of its gait are chosen
for the largest steady speed at each limit of power, with struts that may buckle and cables that may tear; beside it,
the gait alone, on the robot of the scene as it is. What is reported was verified on the orbit, not by the search.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import numpy as np
from design_space import GAIT_ALONE, HIGHEST, LOWEST, NAMES, Limits, Tried, keeps, on_orbit, tried
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import InputError, Scene, load_gait, load_scene, with_gait
from jaxgrity.io.files import save_json
from jaxgrity.report import plot

KINDS = {"gait alone": GAIT_ALONE, "robot and gait": np.ones(len(NAMES))}
"""what is free"""
FIRST_STEP, ELITE = 0.25, 0.25
"""of the ranges, the first standard deviation of draws; share of the draws that the next ones are drawn around"""
VERIFIED = 12
"""designs of a search, its best first, of which the first that keeps all limits on its orbit is reported"""
ROLLS = 0.1
"""m/s, below which a robot counts as staying where it is"""


@dataclass
class Settings:
    powers: tuple[float, ...] = (10.0, 20.0, 40.0, 80.0, 160.0)
    """W, that each actuator may give"""
    strut_force: float = 300.0
    """N, at which a strut of the scene's length buckles, and the most that its actuator holds"""
    cable_force: float = 150.0
    """N, that each cable may bear"""
    designs: int = 128
    """in a generation"""
    generations: tuple[int, int] = (16, 8)
    """for each limit: from the designs of the same kind, then from those of both"""
    duration: float = 40.0
    """s, of which the last three quarters count"""
    seed: int = 0
    out: Path = Path("results/design_study")
    """folder for design_study.json and the figure"""
    quick: bool = False
    """one limit, 6 designs, 2 generations"""


def main(settings: Settings) -> None:
    """Search and verify, limit by limit. Raises `InputError` for limits that are not positive."""
    if settings.quick:
        settings.powers, settings.designs, settings.generations = settings.powers[-1:], 6, (1, 1)
    if min(*settings.powers, settings.strut_force, settings.cable_force) <= 0:
        raise InputError("powers, strut_force or cable_force: not positive; expected positive limits")
    began, limits = time.perf_counter(), Limits(settings.strut_force, settings.cable_force)
    scene, random = with_gait(load_scene("exact"), load_gait("lasting")), np.random.default_rng(settings.seed)
    as_built, powers, found = tried(scene, np.zeros((1, len(NAMES))), settings.duration), sorted(settings.powers), {}
    for kind, free in KINDS.items():
        found[kind] = as_built
        for power in tqdm(powers, desc=kind, unit="limit"):
            found[kind] = searched(scene, found[kind], free, settings, power, settings.generations[0], random)
    # what may change less is part of what may change more: its designs are tried too, and searched around
    every = found["gait alone"].joined(found["robot and gait"])
    for power in tqdm(powers, desc="both", unit="limit"):
        every = searched(scene, every, KINDS["robot and gait"], settings, power, settings.generations[1], random)
    found["robot and gait"] = every
    cases = [(kind, power) for kind in KINDS for power in powers]
    rows = [
        {"kind": kind, "power": power} | first_verified(scene, found[kind], limits, power)
        for kind, power in tqdm(cases, desc="orbits", unit="design")
    ]
    facts = {"limits": list(limits), "designs": len(every.x), "rows": rows}
    # the second does not count what other processes took of the machine
    facts |= {"minutes": (time.perf_counter() - began) / 60, "processor_minutes": time.process_time() / 60}
    save_json(settings.out / "design_study.json", {**measured(), **facts})
    plot.save(figure(rows), settings.out / "design_study.png")
    for row in rows:
        what = f"{row['speed']:.3f} m/s" if rolls(row) else "nothing that keeps all limits rolls"
        print(f"{row['kind']}, {row['power']:g} W: {what}")
    print(f"{settings.out}/design_study.json, design_study.png")


def searched(
    scene: Scene,
    archive: Tried,
    free: np.ndarray,
    settings: Settings,
    power: float,
    generations: int,
    random: np.random.Generator,
) -> Tried:
    """An evolution strategy: draws around the mean of the best so far, as wide as these differ; all are kept."""
    spread, limits = FIRST_STEP * (HIGHEST - LOWEST), Limits(settings.strut_force, settings.cable_force)
    for _ in tqdm(range(generations), unit="generation", leave=False):
        best = np.argsort(-archive.worth(limits, power))[: max(2, round(ELITE * settings.designs))]
        elite = archive.x[best]
        wide = np.maximum(1.2 * elite.std(0), 0.1 * spread) if len(elite) > settings.designs / 8 else spread
        x = elite.mean(0) + wide * random.normal(size=(settings.designs, len(NAMES)))
        archive = archive.joined(tried(scene, free * np.clip(x, LOWEST, HIGHEST), settings.duration))
    return archive


def first_verified(scene: Scene, archive: Tried, limits: Limits, power: float) -> dict[str, Any]:
    """The fastest design that keeps all limits on the orbit on which it settles."""
    worth = archive.worth(limits, power)
    for k in np.argsort(-worth)[:VERIFIED]:
        if worth[k] <= ROLLS:
            break
        found = on_orbit(scene, archive.x[k])
        if keeps(found, limits, power):
            return found | {"searched": float(archive.speed[k])}
    return {"speed": None}


def rolls(row: dict[str, Any]) -> bool:
    return row["speed"] is not None and row["speed"] >= ROLLS


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """Speed and cost of transport over the power that an actuator may give, and the designs."""
    chart = Figure(figsize=(12, 3.4), layout="constrained")
    speed, cost, design = chart.subplots(1, 3)
    found = [row for row in rows if rolls(row)]
    for kind, look in zip(KINDS, ("s", "o-")):
        own = [row for row in found if row["kind"] == kind]
        power = [row["power"] for row in own]
        # squares are larger and empty: a point of both kinds shows as both
        mark: dict[str, Any] = {"markersize": 10, "markerfacecolor": "none"} if look == "s" else {}
        speed.plot(power, [row["speed"] for row in own], look, label=kind, zorder=3, **mark)
        cost.plot(power, [row["cost_of_transport"] for row in own], look, label=kind, zorder=3, **mark)
    for name in NAMES:
        built = [row for row in found if row["kind"] == "robot and gait"]
        design.plot([row["power"] for row in built], [row["factors"][name] for row in built], "o-", label=name)
    limits = sorted({row["power"] for row in rows})
    for axes in (speed, cost, design):
        axes.set(xscale="log", xlabel="power of an actuator, at most (W)")
        axes.set_xticks(limits, [f"{limit:g}" for limit in limits])
        axes.set_xticks([], minor=True)
    speed.set(ylabel="steady speed (m/s)", ylim=(0, None), title="How fast")
    cost.set(ylabel="cost of transport", ylim=(0, None), title="At what cost")
    design.set(ylabel="times the scene's", ylim=(0, None), title="Robot and gait")
    speed.legend()
    design.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")
    return chart


if __name__ == "__main__":
    run(main, Settings)

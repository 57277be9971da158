"""How fast can a six-strut robot roll for given actuators?

Stiffness and prestress of its cables, and swing and frequency of its gait, are chosen for the largest steady speed at
each limit of power, with struts that may buckle and cables that may tear; and, beside it, the gait alone, on the robot
of the scene as it is. What is reported was verified on the orbit, not by the search.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from jaxgrity.cli.script import measured, run

import equinox as eqx
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import (
    Differences,
    InputError,
    Scene,
    find_orbit,
    forces_along,
    gaits_of,
    load_gait,
    load_scene,
    orbit_cycle,
    plot,
    simulate,
    simulate_population,
    with_gait,
)
from jaxgrity.io.files import save_json

NAMES = ("cable stiffness", "cable rest length", "swing", "frequency")
"""factors of what scene and gait say"""
LOWEST, HIGHEST = np.log([0.5, 0.8, 0.2, 0.4]), np.log([4.0, 1.15, 1.5, 2.0])
GAIT_ALONE = np.array([0.0, 0.0, 1.0, 1.0])
"""which of them are free where the robot stays as it is"""
FIRST_STEP, ELITE = 0.25, 0.25
"""of the ranges, the first standard deviation of draws; share of the draws that the next ones are drawn around"""
FRICTIONS = (0.85, 1.0, 1.15)
"""times the scene's: each design is tried on so many robots"""
VERIFIED = 12
"""designs of a search, its best first, of which the first that keeps all limits on its orbit is reported"""
ROLLS = 0.1
"""m/s, below which a robot counts as staying where it is"""
WATCHED = 100.0
"""s, for an orbit"""


@dataclass
class Settings:
    powers: tuple[float, ...] = (10.0, 20.0, 40.0, 80.0, 160.0)
    """W, that each actuator may give"""
    strut_force: float = 300.0
    """N, at which a strut buckles, and the most that its actuator holds"""
    cable_force: float = 150.0
    """N, that each cable may bear"""
    designs: int = 48
    """in a generation"""
    generations: int = 14
    duration: float = 40.0
    """s, of which the last three quarters count"""
    seed: int = 0
    out: Path = Path("results/design_study")
    """folder for design_study.json and the figure"""
    quick: bool = False
    """one limit, 6 designs, 2 generations"""


class Archive(NamedTuple):
    """Designs that were tried, as logarithms of factors, and what they did: means over robots, peaks of the worst."""

    x: np.ndarray
    speed: np.ndarray
    force: np.ndarray
    power: np.ndarray

    def joined(self, other: "Archive") -> "Archive":
        return Archive(*(np.concatenate(both) for both in zip(self, other)))

    def worth(self, settings: Settings, power: float) -> np.ndarray:
        """The speed; below zero, the farther the more, where a limit is passed."""
        beyond = np.maximum(self.force / settings.strut_force, 1) + np.maximum(self.power / power, 1) - 2
        return np.where(beyond > 0, -beyond, self.speed)


def main(settings: Settings) -> None:
    """Search and verify, limit by limit. Raises `InputError` for limits that are not positive."""
    if settings.quick:
        settings.powers, settings.designs, settings.generations = settings.powers[-1:], 6, 2
    if min(*settings.powers, settings.strut_force, settings.cable_force) <= 0:
        raise InputError("powers, strut_force or cable_force: not positive; expected positive limits")
    began, scene, rows = time.perf_counter(), with_gait(load_scene("exact"), load_gait("lasting")), []
    for kind, free in (("gait alone", GAIT_ALONE), ("robot and gait", np.ones(4))):
        random, archive = np.random.default_rng(settings.seed), tried(scene, np.zeros((1, 4)), settings)
        for power in tqdm(sorted(settings.powers), desc=kind, unit="limit"):
            archive = searched(scene, archive, free, settings, power, random)
            rows.append({"kind": kind, "power": power} | first_verified(scene, archive, settings, power))
    facts = {"limits": [settings.strut_force, settings.cable_force], "designs": len(archive.x), "rows": rows}
    # the second does not count what other processes took of the machine
    facts |= {"minutes": (time.perf_counter() - began) / 60, "processor_minutes": time.process_time() / 60}
    save_json(settings.out / "design_study.json", {**measured(), **facts})
    plot.save(figure(rows), settings.out / "design_study.png")
    for row in rows:
        what = f"{row['speed']:.3f} m/s" if rolls(row) else "nothing that keeps all limits rolls"
        print(f"{row['kind']}, {row['power']:g} W: {what}")
    print(f"{settings.out}/design_study.json, design_study.png")


def designed(scene: Scene, x: np.ndarray) -> Scene:
    """The scene with one design."""
    stiffness, rest_length, swing, frequency = np.exp(x)
    places = (
        lambda s: s.structure.cables.stiffness,
        lambda s: s.structure.cables.rest_length,
        lambda s: s.gait.amplitude,
        lambda s: s.gait.frequency,
    )
    for place, factor in zip(places, (stiffness, rest_length, swing, frequency)):
        scene = eqx.tree_at(place, scene, place(scene) * factor)
    return scene


def tried(scene: Scene, x: np.ndarray, settings: Settings) -> Archive:
    """All designs at once, each on robots with several frictions, from rest."""
    count, robots, gait = len(x), len(FRICTIONS), scene.gait
    factors = np.exp(np.repeat(x, robots, axis=0))
    ones = np.ones((count * robots, len(gait.phase)))
    gaits = gaits_of(
        gait, ones * gait.phase, ones * gait.amplitude * factors[:, 2:3], ones * gait.frequency * factors[:, 3:]
    )
    cables = np.ones((count * robots, len(scene.structure.cables.edges)))
    differences = Differences(
        friction=np.tile(FRICTIONS, count),
        cable_stiffness=cables * factors[:, :1],
        cable_rest_length=cables * factors[:, 1:2],
    )
    found = simulate_population(scene, gaits, settings.duration, differences=differences, with_metrics=True, parts=4)
    path, metrics = np.asarray(found.com_path), found.metrics
    speed = np.hypot(*(path[:, 4] - path[:, 1])[:, :2].T) / (0.75 * settings.duration)
    failed = np.asarray(found.failure) != 0
    peaks = [np.where(failed, np.inf, np.asarray(peak).max(1)) for peak in (metrics.peak_force, metrics.peak_power)]
    by_design = np.where(failed, 0, speed).reshape(count, robots).mean(1)
    return Archive(x, by_design, *(peak.reshape(count, robots).max(1) for peak in peaks))


def searched(
    scene: Scene, archive: Archive, free: np.ndarray, settings: Settings, power: float, random: np.random.Generator
) -> Archive:
    """An evolution strategy: draws around the mean of the best so far, as wide as these differ; all are kept."""
    spread = FIRST_STEP * (HIGHEST - LOWEST)
    for _ in tqdm(range(settings.generations), unit="generation", leave=False):
        elite = archive.x[np.argsort(-archive.worth(settings, power))[: max(2, round(ELITE * settings.designs))]]
        wide = np.maximum(1.2 * elite.std(0), 0.1 * spread) if len(elite) > settings.designs / 8 else spread
        x = elite.mean(0) + wide * random.normal(size=(settings.designs, 4))
        archive = archive.joined(tried(scene, free * np.clip(x, LOWEST, HIGHEST), settings))
    return archive


def first_verified(scene: Scene, archive: Archive, settings: Settings, power: float) -> dict[str, Any]:
    """The fastest design that keeps all limits on the orbit on which it settles."""
    worth = archive.worth(settings, power)
    for k in np.argsort(-worth)[:VERIFIED]:
        if worth[k] <= 0:
            break
        found = on_orbit(designed(scene, archive.x[k]))
        kept = found["strut_force"] <= settings.strut_force and found["cable_force"] <= settings.cable_force
        if found["settled"] and kept and found["peak_power"] <= power:
            factors = dict(zip(NAMES, np.exp(archive.x[k])))
            return found | {"factors": factors, "searched": float(archive.speed[k])}
    return {"speed": None}


def on_orbit(scene: Scene) -> dict[str, Any]:
    """Speed, forces, power and cost of transport in a cycle."""
    orbit = find_orbit(scene, max(WATCHED, 60 / float(scene.gait.frequency[0])))
    cycle = orbit_cycle(scene, orbit)
    trajectory = simulate(scene, 20.0, frame_rate=100.0)
    cables = np.asarray(forces_along(scene, trajectory).tension)[len(trajectory.times) // 2 :, len(scene.gait.phase) :]
    return {
        "speed": orbit.speed,
        "settled": orbit.settled,
        "strut_force": cycle.peak_force,
        "cable_force": float(np.max(cables)),
        "peak_power": cycle.peak_power,
        "peak_rate": cycle.peak_rate,
        "cost_of_transport": cycle.cost_of_transport,
    }


def rolls(row: dict[str, Any]) -> bool:
    return row["speed"] is not None and row["speed"] >= ROLLS


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """Speed and cost of transport over the power that an actuator may give, and the designs."""
    chart = Figure(figsize=(11, 3.4), layout="constrained")
    speed, cost, design = chart.subplots(1, 3)
    found = [row for row in rows if rolls(row)]
    for kind in dict.fromkeys(row["kind"] for row in found):
        own = [row for row in found if row["kind"] == kind]
        power = [row["power"] for row in own]
        speed.plot(power, [row["speed"] for row in own], "o-", label=kind)
        cost.plot(power, [row["cost_of_transport"] for row in own], "o-", label=kind)
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
    design.legend()
    return chart


if __name__ == "__main__":
    run(main, Settings)

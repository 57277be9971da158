"""Steady speed of the library's gaits over robots that differ in all that a search takes as uncertain, for a minute, on
both contact models. Leaves robots_that_differ.json and a figure of every robot's speed.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import (
    ActuatorBounds,
    Fitness,
    InputError,
    Scene,
    SearchConfig,
    SteadySpeed,
    as_population,
    contact_twin,
    fidelity_levels,
    gait_names,
    gait_record,
    judge_at,
    load_gait,
    load_scene,
    plot,
    search_problem,
    with_gait,
)
from jaxgrity.io.files import save_json

SEED = 20_000_000
"""far from those of searches: by these draws no gait was chosen"""
ENOUGH = 0.85
"""share of the speed of the robot that is as the scene says, from which on a robot counts as rolling"""


@dataclass
class Settings:
    gaits: tuple[str, ...] = ("lasting", "fast", "cables")
    """names of the library's gaits"""
    robots: int = 64
    """that each gait is tried on"""
    duration: float = 60.0
    """s; the first quarter is left to settling"""
    out: Path = Path("results/robots_that_differ")
    """folder for robots_that_differ.json and its figure"""
    quick: bool = False
    """one gait on 8 robots for 20 s"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.gaits, settings.robots, settings.duration = settings.gaits[:1], 8, 20.0
    unknown = sorted(set(settings.gaits) - set(gait_names()))
    if unknown:
        raise InputError(f"gaits = {unknown}: unknown; expected some of {', '.join(gait_names())}")
    rows, every = [], {}
    for name in tqdm(settings.gaits, unit="gait"):
        own = with_gait(load_scene(gait_record(name)["scene"]), load_gait(name))
        nominal = speeds(own, settings, 1)[0]
        for scene in (own, contact_twin(own)):
            contact = "exact" if scene.constrained else "penalty"
            found = every[f"{name}, {contact}"] = speeds(scene, settings, settings.robots)
            rows.append(
                {"gait": name, "contact": contact, "own": scene is own, "nominal": nominal, **told(found, nominal)}
            )
    save_json(settings.out / "robots_that_differ.json", {**measured(), "robots": settings.robots, "rows": rows})
    plot.save(figure(every), settings.out / "robots_that_differ.png")
    for row in rows:
        print(f"{row['gait']}, {row['contact']}: {row['mean']:.3f} ± {row['standard_deviation']:.2g} body lengths/s")
    print(f"wrote {settings.out}/")


def speeds(scene: Scene, settings: Settings, robots: int) -> np.ndarray:
    """(robots,), body lengths/s, 0 where a rollout failed; one robot is as the scene says."""
    uncertain = SearchConfig().uncertainty
    fitness = Fitness(SteadySpeed(), uncertain, robots) if robots > 1 else Fitness(SteadySpeed())
    problem = search_problem(scene, SearchConfig(duration=settings.duration, bounds=ActuatorBounds()))
    level = fidelity_levels(scene)[1]
    found = judge_at(level, as_population(scene.gait), problem._replace(fitness=fitness), SEED)
    return np.nan_to_num(found.each[0])


def told(found: np.ndarray, nominal: float) -> dict[str, Any]:
    """Of all robots on one contact model."""
    return {
        "mean": found.mean(),
        "standard_deviation": found.std(),
        "rolling": float((found >= ENOUGH * nominal).mean()),
    }


@plot.styled
def figure(every: dict[str, np.ndarray]) -> Figure:
    """The speed of every robot, sorted."""
    chart = Figure(figsize=(6, 4), layout="constrained")
    axes = chart.subplots()
    for name, found in every.items():
        axes.plot(np.linspace(0, 100, len(found)), np.sort(found), "-" if name.endswith("exact") else "--", label=name)
    axes.set(xlabel="robots (%), slowest first", ylabel="steady speed (body lengths/s)", ylim=(0, None))
    axes.set_title("Robots that differ from the model")
    axes.legend()
    return chart


if __name__ == "__main__":
    run(main, Settings)

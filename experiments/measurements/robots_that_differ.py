"""The library's gaits on robots that differ in all that a search takes as uncertain, for a minute, on both contact
models. Leaves robots_that_differ.json and a figure of every robot's speed.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import (
    InputError,
    SearchConfig,
    SolverOptions,
    contact_twin,
    gait_names,
    gait_record,
    load_gait,
    load_scene,
    with_gait,
)
from jaxgrity.io.files import save_json
from jaxgrity.model import body_length
from jaxgrity.report import plot
from jaxgrity.search import RobotMotions, robot_motions

SEED = 20_000_000
"""far from those of searches: by these draws no gait was chosen"""
OPTIONS = SolverOptions(dtype="float32")
ENOUGH = 0.85
"""share of the speed of the gait's orbit, on its own contact model, from which on a robot counts as rolling"""


@dataclass
class Settings:
    gaits: tuple[str, ...] = ("straight", "lasting", "fast", "cables", "left", "right")
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
        record = gait_record(name)
        own, orbit = with_gait(load_scene(record["scene"]), load_gait(name)), record["steady"]["speed"]
        for scene in (own, contact_twin(own)):
            contact = "exact" if scene.constrained else "penalty"
            uncertain = SearchConfig().uncertainty
            found = robot_motions(
                scene, uncertain, robots=settings.robots, duration=settings.duration, seed=SEED, options=OPTIONS
            )
            size = float(body_length(scene))
            every[f"{name}, {contact}"] = found.speed / size
            known = {"gait": name, "contact": contact, "own": scene is own}
            rows.append(known | told(found, orbit, size))
    save_json(settings.out / "robots_that_differ.json", {**measured(), "robots": settings.robots, "rows": rows})
    plot.save(figure(every), settings.out / "robots_that_differ.png")
    for row in rows:
        speed = f"{row['mean']:.3f} body lengths/s (standard deviation {row['standard_deviation']:.2g})"
        print(f"{row['gait']}, {row['contact']}: {speed}")
    print(f"wrote {settings.out}/")


def told(found: RobotMotions, orbit: float, size: float) -> dict[str, Any]:
    """Of all robots on one contact model, in body lengths; `orbit` is the gait's speed, m/s."""
    facts = found.summary()
    return {
        "nominal": orbit / size,
        "mean": facts["speed"] / size,
        "standard_deviation": facts["standard_deviation"] / size,
        "displacement": facts["displacement"] / size,
        "displacement_standard_deviation": facts["displacement_standard_deviation"] / size,
        "bend": facts["bend"],
        "bend_quartiles": facts["bend_quartiles"],
        "rolling": float((found.speed >= ENOUGH * orbit).mean()),
    }


@plot.styled
def figure(every: dict[str, np.ndarray]) -> Figure:
    """The speed of every robot, sorted."""
    chart = Figure(figsize=(8, 4), layout="constrained")
    axes = chart.subplots()
    gaits = list(dict.fromkeys(name.split(", ")[0] for name in every))
    for name, found in every.items():
        gait, contact = name.split(", ")
        line = {"color": f"C{gaits.index(gait)}", "linestyle": "-" if contact == "exact" else "--"}
        axes.plot(np.linspace(0, 100, len(found)), np.sort(found), label=name, **line)
    axes.set(xlabel="robots (%), slowest first", ylabel="speed along the path (body lengths/s)", ylim=(0, None))
    axes.set_title("Robots that differ from the model")
    chart.legend(loc="outside right upper")
    return chart


if __name__ == "__main__":
    run(main, Settings)

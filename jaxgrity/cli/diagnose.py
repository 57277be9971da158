"""Say how far one rollout of a scene can be trusted: error bars, energy and momentum, sensitivity, penetration."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from jaxgrity.cli.simulate import chosen_scene, diagnosed, scene_name
from jaxgrity.io.files import save_json
from jaxgrity.report import plot
from jaxgrity.stepping.options import SolverOptions


@dataclass
class DiagnoseSettings:
    scene: Annotated[str, tyro.conf.Positional]
    """a scene of the library by its name (reference, exact, uphill), or a scene file (TOML)"""
    gait: str | None = None
    """a gait of the library by its name, or the gait.json of a search, in place of the scene's own"""
    duration: float = 10.0
    """s"""
    method: str | None = None
    """rk4, tsit5, dopri8, kvaerno3, kvaerno5, verlet or complementarity; without it, the scene decides"""
    dt: float | None = None
    """fixed step, s; without it, adaptive methods adapt theirs, others take a safe one"""
    dtype: Literal["float32", "float64"] = "float64"
    """precision of the rollout"""
    out: Path = Path("results/diagnose")
    """folder for diagnosis.json and path.png"""
    quick: bool = False
    """at most 2 s of motion"""


def main(settings: DiagnoseSettings) -> None:
    """Print the report on trust, and leave it as JSON with a figure."""
    scene = chosen_scene(settings.scene, settings.gait)
    print(scene.describe(), end="\n\n", flush=True)
    duration = min(settings.duration, 2.0) if settings.quick else settings.duration
    options = SolverOptions(method=settings.method, dt=settings.dt, dtype=settings.dtype)
    trust = diagnosed(scene, duration, options)
    step = "steps of its own choice" if trust.trajectory.dt is None else f"dt = {trust.trajectory.dt:g} s"
    print(f"{trust.trajectory.method}, {step}\n{trust.table()}")
    facts = {"scene": scene_name(settings.scene), "duration": duration, **trust.summary()}
    save_json(settings.out / "diagnosis.json", facts)
    if not trust.trajectory.failed:
        plot.save(plot.path_figure(scene, trust.trajectory, trust.error_bar), settings.out / "path.png")
    print(f"wrote {settings.out}/diagnosis.json")

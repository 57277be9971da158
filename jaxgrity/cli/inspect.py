"""Report on a structure's statics: self-stress, mechanisms, stability, member forces and natural frequencies."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from jaxgrity.cli.simulate import scene_name
from jaxgrity.io.files import save_json
from jaxgrity.io.scene_files import load_scene
from jaxgrity.model.inspection import inspect_structure
from jaxgrity.report import plot


@dataclass
class InspectSettings:
    scene: Annotated[str, tyro.conf.Positional]
    """a scene of the library by its name (reference, exact, uphill), or a scene file (TOML)"""
    out: Path = Path("results/inspect")
    """folder for inspection.json and forces.png"""
    quick: bool = False
    """it is quick anyway"""


def main(settings: InspectSettings) -> None:
    """Print the report, and leave it as JSON with a figure of the members' forces."""
    report = inspect_structure(load_scene(settings.scene))
    print(report.table())
    save_json(settings.out / "inspection.json", {"scene": scene_name(settings.scene), **report.summary()})
    plot.save(plot.resting_force_figure(report), settings.out / "forces.png")
    print(f"wrote {settings.out}/")

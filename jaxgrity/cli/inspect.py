"""Report on a structure's statics: self-stress, mechanisms, stability, member forces and natural frequencies."""

from jaxgrity.cli.settings import InspectSettings
from jaxgrity.cli.simulate import scene_name
from jaxgrity.io.files import save_json
from jaxgrity.io.scene_files import load_scene
from jaxgrity.report import plot
from jaxgrity.statics.inspection import inspect_structure


def main(settings: InspectSettings) -> None:
    """Print the report, and write it as JSON with a figure of the members' forces."""
    report = inspect_structure(load_scene(settings.scene))
    print(report.table())
    save_json(settings.out / "inspection.json", {"scene": scene_name(settings.scene), **report.summary()})
    plot.save(plot.resting_force_figure(report), settings.out / "forces.png")
    print(f"wrote {settings.out}/")

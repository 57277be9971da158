"""Report on a structure's statics: self-stress, mechanisms, stability, member forces and natural frequencies."""

from jaxgrity.cli.scenes import scene_name
from jaxgrity.cli.settings import InspectSettings
from jaxgrity.io.files import save_json
from jaxgrity.io.scene_files import load_scene
from jaxgrity.report import plot
from jaxgrity.statics.inspection import inspect_structure
from jaxgrity.statics.load_reports import load_report


def main(settings: InspectSettings) -> None:
    """Print the report, and write it as JSON with a figure of the members' forces."""
    scene = load_scene(settings.scene)
    report = inspect_structure(scene)
    print(report.table())
    loaded = [load_report(scene, case) for case in scene.loads]
    for each in loaded:
        print(f"\n{each.table()}")
    cases = [each.summary() for each in loaded]
    save_json(
        settings.out / "inspection.json", {"scene": scene_name(settings.scene), **report.summary(), "loads": cases}
    )
    plot.save(plot.resting_force_figure(report), settings.out / "forces.png")
    print(f"wrote {settings.out}/")

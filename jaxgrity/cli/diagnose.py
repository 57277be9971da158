"""Report how far you can trust a simulation: error bars, energy and momentum, sensitivity, penetration."""

from jaxgrity.cli.scenes import chosen_scene, scene_name
from jaxgrity.cli.settings import DiagnoseSettings
from jaxgrity.cli.simulate import diagnosed
from jaxgrity.io.files import save_json
from jaxgrity.report import plot
from jaxgrity.statics.describe import describe
from jaxgrity.stepping.options import SolverOptions, resolve


def main(settings: DiagnoseSettings) -> None:
    """Print the report on trust, and write it as JSON with a figure."""
    scene = chosen_scene(settings.scene, settings.gait)
    duration = min(settings.duration, 2.0) if settings.quick else settings.duration
    options = SolverOptions(method=settings.method, dt=settings.dt, dtype=settings.dtype)
    resolve(scene, duration, options)  # refuses before anything is said
    print(describe(scene), end="\n\n", flush=True)
    trust = diagnosed(scene, duration, options)
    step = "steps of its own choice" if trust.trajectory.dt is None else f"dt = {trust.trajectory.dt:g} s"
    print(f"{trust.trajectory.method}, {step}\n{trust.table()}")
    facts = {"scene": scene_name(settings.scene), "duration": duration, **trust.summary()}
    save_json(settings.out / "diagnosis.json", facts)
    if not trust.trajectory.failed:
        plot.save(plot.path_figure(scene, trust.trajectory, trust.error_bar), settings.out / "path.png")
    print(f"wrote {settings.out}/diagnosis.json")

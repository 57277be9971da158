"""The orbits of gaits of the library: how fast each goes once it has settled, how it turns, and whether it comes back.

Every gait is rolled out on its own scene and on the contact twin, each at three steps. The figure shows the path of the
centre of mass on both.
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
    Scene,
    centre_path,
    contact_twin,
    gait_names,
    gait_record,
    load_gait,
    load_scene,
    simulate,
    with_gait,
)
from jaxgrity.io.files import save_json
from jaxgrity.orbits import find_orbit, refined_orbit, stability
from jaxgrity.report import plot, view

SHOWN = 20.0
"""s, of each gait's replay"""
NEAR = 20.0
"""m, which the paths of gaits that turn do not leave"""


@dataclass
class Settings:
    gaits: tuple[str, ...] = ("straight", "lasting", "fast", "cables", "left", "right", "uphill")
    """names of the library's gaits"""
    duration: float = 120.0
    """s, for which each gait is watched"""
    out: Path = Path("results/orbits")
    """folder for orbits.json and its figure"""
    quick: bool = False
    """one gait, on the exact scene alone, at one step"""


def main(settings: Settings) -> None:
    unknown = sorted(set(settings.gaits) - set(gait_names()))
    if unknown:
        raise InputError(f"gaits = {unknown}: unknown; expected some of {', '.join(gait_names())}")
    names = settings.gaits[:1] if settings.quick else settings.gaits
    rows, paths = [], {}
    for name in tqdm(names, desc="gaits", unit="gait"):
        own = with_gait(load_scene(gait_record(name)["scene"]), load_gait(name))
        shown = simulate(own, SHOWN, frame_rate=50)
        view.keep_html(own, shown, settings.out / f"replay_{name}.html", title=name)
        for scene in (own,) if settings.quick else (own, contact_twin(own)):
            where = "exact" if scene.constrained else "penalty"
            known = {"gait": name, "contact": where, "own": scene is own}
            rows.append(known | row(scene, settings.duration, settings.quick))
            trajectory = simulate(scene, settings.duration, frame_rate=5)
            paths[f"{name}, {where}"] = np.asarray(centre_path(scene, trajectory))[:, :2]
    save_json(settings.out / "orbits.json", {**measured(), "rows": rows})
    plot.save(figure(paths), settings.out / "orbits.png")
    print(f"{settings.out}/orbits.json, orbits.png")


def row(scene: Scene, duration: float, quick: bool) -> dict[str, Any]:
    """The orbit of one gait on one scene."""
    orbit, bar = (find_orbit(scene, duration), None) if quick else refined_orbit(scene, duration)
    held = stability(scene, orbit) if orbit.verified_for else None
    return {
        **orbit.summary(),
        "speed_error_bar": bar,
        "multiplier": None if held is None else held.largest,
        "returned": None if held is None else held.returned,
    }


@plot.styled
def figure(paths: dict[str, np.ndarray]) -> Figure:
    """The paths of the centre of mass, seen from above; those that stay near in a pane of their own."""
    chart = Figure(figsize=(10, 4.5), layout="constrained")
    far, near = chart.subplots(1, 2)
    colours = {gait: f"C{k}" for k, gait in enumerate(dict.fromkeys(name.split(", ")[0] for name in paths))}
    for name, path in paths.items():
        gait, contact = name.split(", ")
        here = near if np.abs(path - path[0]).max() < NEAR else far
        style = {"color": colours[gait], "linestyle": "-" if contact == "exact" else "--", "linewidth": 1.0}
        here.plot(*(path - path[0]).T, label=name, **style)
    for axes, title in ((far, "centre of mass, from above"), (near, f"gaits that turn, within {NEAR:g} m")):
        axes.set(xlabel="x (m)", ylabel="y (m)", title=title)
        axes.set_aspect("equal", adjustable="datalim")
        if axes.lines:
            axes.legend(fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3)
    return chart


if __name__ == "__main__":
    run(main, Settings)

"""NASA's structure files: read, settled, and left to stand on both models of contact."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import numpy as np

from jaxgrity import FAILURES, Scene, contact_twin, simulate
from jaxgrity.formats import read_ntrt
from jaxgrity.io.files import save_json
from jaxgrity.report import view
from jaxgrity.statics import settled
from jaxgrity.stepping import velocities_midway

NASA = Path(__file__).parents[2] / "tests" / "data" / "ntrt" / "nasa"
FILES = ("3Prism", "3PrismSymmetric", "Double3Prism", "SuperBall", "Tetrahedron", "TetrahedralSpine")


@dataclass
class Settings:
    duration: float = 10.0
    """s, for which each is to stand"""
    out: Path = Path("results/ntrt")
    """folder for ntrt.json"""
    quick: bool = False
    """two files, for half a second each"""


def main(settings: Settings) -> None:
    files, duration = (FILES[:2], 0.5) if settings.quick else (FILES, settings.duration)
    rows = []
    for name in files:
        rows.append(row(name, duration, settings.out))
        print({key: value if isinstance(value, str | dict) else float(value) for key, value in rows[-1].items()})
        save_json(settings.out / "ntrt.json", {**measured(), "duration": duration, "rows": rows})


def row(name: str, duration: float, out: Path) -> dict[str, Any]:
    """What is said of a file; leaves a replay of it on exact contact."""
    scene = read_ntrt(NASA / f"{name}.yaml").scene
    structure, found = scene.structure, settled(scene)
    return {
        "file": name,
        "nodes": len(structure.nodes),
        "rods": 0 if structure.struts is None else int(np.sum(np.asarray(structure.struts.mass) > 0)),
        "strings": 0 if structure.cables is None else len(structure.cables.edges),
        "mass": float(structure.mass),
        "size": float(np.ptp(structure.nodes, axis=0).max()),
        "moved": found.moved,
        "exact": standing(found.scene, duration, out / f"replay_{name}.html"),
        "penalty": standing(contact_twin(found.scene), duration),
    }


def standing(scene: Scene, duration: float, replay: Path | None = None) -> dict[str, Any]:
    """Heights, m, at the start and in the end, and the largest speed, m/s, then."""
    motion = simulate(scene, duration, frame_rate=25.0)
    if replay is not None:
        view.keep_html(scene, motion, replay, title=replay.stem.removeprefix("replay_"), follow=False)
    q, v = np.asarray(motion.positions), velocities_midway(scene, motion)
    heights = np.ptp(q[:, :, 2], axis=1)
    outcome = FAILURES[int(motion.failure)]
    return {"outcome": outcome, "start": heights[0], "end": heights[-1], "speed": np.linalg.norm(v[-1], axis=1).max()}


if __name__ == "__main__":
    run(main, Settings)

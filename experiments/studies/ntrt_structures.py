"""NASA's structure files: read, settled, and left to stand on both models of contact."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from measurements.measurement import Record, measurement
from measurements.pages import columns

from jaxgrity import FAILURES, Scene, contact_twin, simulate
from jaxgrity.formats import read_ntrt
from jaxgrity.statics import settled

NASA = Path(__file__).parents[2] / "tests" / "data" / "ntrt" / "nasa"
FILES = ("3Prism", "3PrismSymmetric", "Double3Prism", "SuperBall", "TetrahedralSpine")


@measurement(page="files.md", quick={"files": FILES[:2], "duration": 0.5})
def ntrt(files: tuple[str, ...] = FILES, duration: float = 10.0) -> Iterator[Record]:
    """A row for each file.

    Args:
        files: names of NASA's structure files
        duration: s, for which each is to stand
    """
    for name in files:
        yield row(name, duration)
    return {"duration": duration}


def row(name: str, duration: float) -> dict[str, Any]:
    """What is said of a file, whose rods are thin."""
    scene = read_ntrt(NASA / f"{name}.yaml", drop=["radius"]).scene
    structure, found = scene.structure, settled(scene)
    return {
        "file": name,
        "nodes": len(structure.nodes),
        "rods": 0 if structure.struts is None else len(structure.struts.edges),
        "bodies": len(structure.bodies),
        "strings": 0 if structure.cables is None else len(structure.cables.edges),
        "mass": float(structure.mass),
        "moved": found.moved,
        "exact": standing(found.scene, duration),
        "penalty": standing(contact_twin(found.scene), duration),
    }


def standing(scene: Scene, duration: float) -> dict[str, Any]:
    """Heights, m, at the start and in the end, and what became of the rollout."""
    motion = simulate(scene, duration, frame_rate=25.0)
    heights = np.ptp(np.asarray(motion.positions)[:, :, 2], axis=1)
    return {"outcome": FAILURES[int(motion.failure)], "start": heights[0], "end": heights[-1]}


@ntrt.table
def words(record: Record) -> str:
    """What each structure is, and how high it stands on both models of contact."""
    cells = {
        "file": "{file}.yaml",
        "nodes, rods, bodies, strings": "{nodes}, {rods}, {bodies}, {strings}",
        "mass, kg": "{mass:.3f}",
        "settling moves nodes, mm": lambda row: f"{1e3 * row['moved']:.0f}",
        "height at rest without gravity, m": lambda row: f"{row['exact']['start']:.2f}",
        f"height after {record['duration']:g} s, exact contact, m": lambda row: ending(row["exact"]),
        f"after {record['duration']:g} s, penalty contact, m": lambda row: ending(row["penalty"]),
    }
    return columns(record["rows"], cells)


def ending(end: Record) -> str:
    """The height in the end, or what became of the rollout."""
    return f"{end['end']:.2f}" if end["outcome"] == "succeeded" else end["outcome"]

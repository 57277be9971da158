"""Keep the gait that a run of gait_search.py found in the library that comes with jaxgrity."""

import json
from dataclasses import dataclass
from pathlib import Path

from jaxgrity import InputError, load_gait
from jaxgrity.io.files import read_text, save_json

KEPT = (
    "scene", "robot", "members", "phase", "amplitude", "frequency", "start", "ramp", "overtones", "duration",
    "objective", "settings", "distance", "error_bar", "robust", "other_contact_model", "steady", "motion", "directions",
    "actuators", "command",
)  # fmt: skip


@dataclass
class Settings:
    run: Path
    """folder that gait_search.py left"""
    name: str
    """of the gait in the library"""
    library: Path = Path("jaxgrity/data/gaits")
    """folder of the library's records"""


def main(settings: Settings) -> None:
    path = settings.run / "gait.json"
    load_gait(path)
    record = json.loads(read_text(path))
    missing = [key for key in KEPT if key not in record and key != "steady"]
    if missing:
        raise InputError(f"{path}: has no {', '.join(missing)}; expected what gait_search.py leaves")
    save_json(settings.library / f"{settings.name}.json", {key: record[key] for key in KEPT if key in record})
    print(f"wrote {settings.library / settings.name}.json")

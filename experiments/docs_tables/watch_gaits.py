"""Watch gaits of the library that comes with jaxgrity anew, and write what they settle on into their records."""

import json
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from jaxgrity import InputError, gait_names, load_gait, load_scene, rolling, simulate, with_gait
from jaxgrity.io.files import read_text, save_json
from jaxgrity.report import steady_facts
from jaxgrity.search import EvaluationConfig

SEED = 10**6
"""of the draws of robots: as in the last judgement of a search"""
FRAME_RATE = 50.0
"""1/s, at which it is told whether a robot rolls, as in the report of a search"""


@dataclass
class Settings:
    gaits: tuple[str, ...] = gait_names()
    """names of the library's gaits"""
    duration: float = 300.0
    """s, for which each is watched"""
    library: Path = Path("jaxgrity/data/gaits")
    """folder of the library's records"""
    quick: bool = False
    """one gait, for as long as cycles of it need"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.gaits, settings.duration = settings.gaits[:1], 10.0
    missing = [name for name in settings.gaits if not (settings.library / f"{name}.json").exists()]
    if missing:
        raise InputError(f"{settings.library}: has no {', '.join(missing)}; expected records of the library")
    for name in tqdm(settings.gaits, unit="gait"):
        path = settings.library / f"{name}.json"
        record = json.loads(read_text(path))
        scene = with_gait(load_scene(record["scene"]), load_gait(path))
        asked = record["settings"]["objective"]
        heading = asked["heading"] if asked["kind"] == "steady direction" else None
        uncertain = EvaluationConfig().uncertainty
        steady = steady_facts(scene, uncertain, duration=settings.duration, seed=SEED, heading=heading)
        trajectory = simulate(scene, record["duration"], frame_rate=FRAME_RATE)
        save_json(path, record | {"steady": steady, "motion": rolling(scene, trajectory).summary()})
        tqdm.write(f"{name}: {steady['body_lengths_per_second']:.3f} body lengths/s")

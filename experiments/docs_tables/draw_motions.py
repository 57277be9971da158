"""Draw motions for README and docs, from gaits and a policy of the library: animations, and a replay in 3D."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import jax

import jaxgrity
from jaxgrity import control

ROOT = Path(__file__).parents[2]
LARGEST = 3e6
"""bytes; pages that show a larger picture load slowly"""


class Animation(NamedTuple):
    """One animated picture in docs/images."""

    gait: str
    """or the policy that drives the robot"""
    scene: str
    duration: float
    """s"""
    camera: str


ANIMATIONS = (
    Animation("straight", "exact", 7.0, "follow"),
    Animation("heading", "exact", 7.0, "follow"),
    Animation("fast", "exact", 7.0, "follow"),
)
REPLAYED, REPLAY_DURATION = ANIMATIONS[0], 12.0
"""the motion that the first page of the docs plays in 3D, and for how long, s"""


@dataclass
class Settings:
    docs: Path = ROOT / "docs"
    """folder with images/ and site/static/"""
    quick: bool = False
    """a second of each motion, in small pictures"""


def main(settings: Settings) -> None:
    """Write them all. Raises `InputError` where a picture is larger than a page should show."""
    for shown in ANIMATIONS:
        path = settings.docs / "images" / f"{shown.gait}.gif"
        scene, motion = rolled(shown, 1.0 if settings.quick else shown.duration)
        width = 160 if settings.quick else 640
        jaxgrity.report.animate(scene, motion, path, 20.0, width=width, camera=shown.camera)
        size = path.stat().st_size
        if size > LARGEST:
            raise jaxgrity.InputError(f"{path}: {size / 1e6:.1f} MB; expected at most {LARGEST / 1e6:g} MB")
        print(f"{path}: {size / 1e6:.2f} MB")
    scene, motion = rolled(REPLAYED, 1.0 if settings.quick else REPLAY_DURATION)
    path = settings.docs / "site" / "static" / f"{REPLAYED.gait}.html"
    jaxgrity.report.view.save_html(scene, motion, path, frame_rate=25.0, title=f"the gait {REPLAYED.gait}")
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")


def rolled(shown: Animation, duration: float) -> tuple[jaxgrity.Scene, jaxgrity.Trajectory]:
    """The scene with the gait, or as a policy drives it, and its motion."""
    if shown.gait in control.policy_names():
        env = control.environment(shown.gait, jaxgrity.load_scene(shown.scene), seconds=duration)
        motion = control.episode(env, control.load_policy(shown.gait), jax.random.key(0))
        return motion.scene, motion
    scene = jaxgrity.with_gait(jaxgrity.load_scene(shown.scene), jaxgrity.load_gait(shown.gait))
    return scene, jaxgrity.simulate(scene, duration, frame_rate=100.0)

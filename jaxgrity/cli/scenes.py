"""The scene that a command is given, by its name or its file, and the files of an earlier run that it replaces."""

from pathlib import Path

from jaxgrity.io.gait_library import gait_record, load_gait
from jaxgrity.io.scene_files import load_scene
from jaxgrity.model.scene import Scene, with_gait


def scene_name(scene: str) -> str:
    """The name of a scene in results: its own, or that of its file."""
    return Path(scene).name


def chosen_scene(scene: str, gait: str | None) -> Scene:
    """The scene, with a gait of the library or of a search on request."""
    found = load_scene(scene)
    if gait is None:
        return found
    found = with_gait(found, load_gait(gait))
    home = gait_record(gait).get("scene")
    if home is not None and Path(home).stem != Path(scene).stem:
        print(f"note: the gait {gait} was found on the scene {home}")
    return found


def replaced_files(earlier: list[Path], folder: Path) -> str:
    """That a command will remove or replace files of an earlier run in its folder, in words; none if there are none."""
    if not earlier:
        return ""
    count = len(earlier) - 1
    others = f" and {count} more file{'s' if count > 1 else ''} there" if count else ""
    return f"{earlier[0]}{others} will be removed or replaced; set another --out to keep what {folder}/ holds."

"""Commands of `jaxgrity` on a scene's file: what they say and leave."""

import contextlib
import io
import json
import tempfile
from collections.abc import Callable
from pathlib import Path

from matrix_uses import Case, same

from jaxgrity import load_scene, save_scene
from jaxgrity.cli import convert, diagnose, inspect, search, simulate
from jaxgrity.cli.settings import ConvertSettings, DiagnoseSettings, InspectSettings, SearchSettings, SimulateSettings
from jaxgrity.explorer.session import OWN, chosen_robot
from jaxgrity.report import view


def command(run: Callable[[str, Path, Case], None]) -> Callable[[Case], None]:
    """A use that gives `run` the path of the scene's file, and a folder; what is printed is kept from the terminal."""

    def use(case: Case) -> None:
        with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()) as said:
            save_scene(case.scene, Path(folder) / "robot.toml")
            run(str(Path(folder) / "robot.toml"), Path(folder) / "out", case)
        missing = [line for line in said.getvalue().splitlines() if line.startswith("no ") and "Error" in line]
        assert not missing, missing

    return use


def simulated(scene: str, out: Path, case: Case) -> None:
    """All files, and a summary that says where the robot got to."""
    simulate.main(
        SimulateSettings(scene=scene, out=out, duration=case.duration, dtype=case.row["dtype"], diagnose=False)
    )
    facts = json.loads((out / "summary.json").read_text())
    assert facts["outcome"] == ["succeeded"]
    expected = {"summary.json", "trajectory.npz", "path.png", "members.png", "forces.png"}
    expected |= {"replay.html"} if view.available() else set()
    assert {path.name for path in out.iterdir()} == expected, sorted(path.name for path in out.iterdir())


def diagnosed(scene: str, out: Path, case: Case) -> None:
    """A balance of energy that is not far off."""
    diagnose.main(DiagnoseSettings(scene=scene, out=out, duration=case.duration))
    assert (out / "path.png").exists()
    facts = json.loads((out / "diagnosis.json").read_text())
    assert facts["outcome"] == "succeeded", facts["outcome"]


def inspected(scene: str, out: Path, case: Case) -> None:
    inspect.main(InspectSettings(scene=scene, out=out))
    assert (out / "forces.png").exists()


def converted(scene: str, out: Path, case: Case) -> None:
    """To a scene file, which is the same robot."""
    out.mkdir()
    convert.main(ConvertSettings(source=scene, target=out / "again.toml"))
    same(load_scene(str(out / "again.toml")).structure.nodes, case.scene.structure.nodes, 0.0, "nodes")


def explored(scene: str, out: Path, case: Case) -> None:
    """What the page shows first."""
    robot = chosen_robot(scene, OWN, OWN, case.duration)
    rolled = robot.roll({knob.name: knob.value for knob in robot.knobs})
    assert not rolled.trajectory.failed
    assert "nan" not in rolled.words(None)


def sought(scene: str, out: Path, case: Case) -> None:
    """A page, and a gait; some minutes."""
    search.main(SearchSettings(scene=scene, out=out, quick=True))
    assert (out / "index.html").exists()


COMMANDS: dict[str, Callable[[Case], None]] = {
    "jaxgrity simulate": command(simulated),
    "jaxgrity diagnose": command(diagnosed),
    "jaxgrity inspect": command(inspected),
    "jaxgrity convert": command(converted),
    "jaxgrity explore": command(explored),
    "jaxgrity search --quick": command(sought),
}

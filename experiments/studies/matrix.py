"""Everything with everything: every kind of scene with every other kind, and every use of the library on every kind.

Scenes of four nodes show every pair of kinds. What takes little time is done on all of them, every other use on so
many that it meets every kind. A use ends right, by its check, or refuses in one line; all else is a fault.
"""

import contextlib
import io
import itertools
import json
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
from measurements.measurement import Record, measurement
from measurements.pages import columns
from studies.matrix_calls import CALLS, reaching
from studies.matrix_scenes import IMPOSSIBLE, KINDS, LATER, Row, covering, pairs
from studies.matrix_uses import MOVING, STILL, Case, same, tried

from jaxgrity import load_scene, save_scene
from jaxgrity.cli import convert, diagnose, inspect, search, simulate
from jaxgrity.cli.search_settings import SearchSettings
from jaxgrity.cli.settings import ConvertSettings, DiagnoseSettings, InspectSettings, SimulateSettings
from jaxgrity.explorer.session import OWN, chosen_robot
from jaxgrity.io.files import read_text
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
    """A page, and a gait; some minutes. Settings are alike at all sizes but that none is longer than a quick search."""
    time = case.at.time
    settings = SearchSettings(scene=scene, out=out, quick=True, duration=8 * time, frequency=(0.3 / time, 1.6 / time))
    search.main(settings)
    assert (out / "index.html").exists()


COMMANDS: dict[str, Callable[[Case], None]] = {
    "jaxgrity simulate": command(simulated),
    "jaxgrity diagnose": command(diagnosed),
    "jaxgrity inspect": command(inspected),
    "jaxgrity convert": command(converted),
    "jaxgrity explore": command(explored),
    "jaxgrity search --quick": command(sought),
}
"""Commands of `jaxgrity` on a scene's file: what they say and leave."""

CALLED = {f"{name} (call)": reaching(call) for name, call in CALLS.items()}
USES = {**STILL, **CALLED, **MOVING, **COMMANDS}
"""All uses by their names."""
SEARCH = "jaxgrity search --quick"
"""The command that takes minutes on each scene."""
STAGES = {
    "still": tuple(STILL),
    "call": tuple(CALLED),
    "moving": tuple(MOVING),
    "command": tuple(name for name in COMMANDS if name != SEARCH),
    "search": (SEARCH,),
}


def jobs(rows: list[Row], uses: tuple[str, ...]) -> list[tuple[int, str]]:
    """Numbers of rows and uses: those that compile nothing on all rows, others on so many that they meet every kind.

    A row with a pair of kinds that came later meets all uses.
    """
    later = [k for k, row in enumerate(rows) if pairs(row) & LATER]
    first = [k for k in range(len(rows)) if k not in later]
    found = []
    for use in uses:
        todo = {part for k in first for part in rows[k].items()} if use not in STILL else set()
        found += [(k, use) for k in first if use in STILL]
        while todo:
            best = max(first, key=lambda k: (len(todo & set(rows[k].items())), (k * 31 + len(found)) % 57))
            found.append((best, use))
            todo -= set(rows[best].items())
    return sorted([*found, *itertools.product(later, uses)])


@measurement(page="matrix.md", quick={"stages": ("still",), "scenes": 4}, raw=("rows",))
def matrix(
    stages: tuple[str, ...] = tuple(STAGES), scenes: int = 10_000, known: Path | None = None
) -> Iterator[Record]:
    """A row for each use of a scene.

    Args:
        stages: which uses: "still" compiles little, "call" ends at the compiler, the others compile
        scenes: how many of the scenes, the first ones
        known: an earlier record, or the folder that `make verify` leaves (.cache/matrix), not tried again
    """
    rows = covering(KINDS)[:scenes]
    records = [] if known is None else sorted(known.glob("*.json")) if known.is_dir() else [known]
    done = [row for record in records for row in json.loads(read_text(record))["rows"]]
    yield from done
    tried_before = {(each["scene"], each["use"]) for each in done}
    last = -1
    for k, use in jobs(rows, tuple(use for stage in stages for use in STAGES[stage])):
        if (k, use) in tried_before:
            continue
        if k != last:
            last, case = k, Case(rows[k])
            jax.clear_caches()  # the programs of the scene before: together they fill the memory
        done.append({"scene": k, "use": use, **tried(USES[use], case)})
        yield done[-1]
    return {
        "scenes": len(rows),
        "pairs": len(set().union(*map(pairs, rows))),
        "jobs": len(done),
        "seconds": sum(each["seconds"] for each in done),
        "uses": [used(use, done) for use in USES if any(each["use"] == use for each in done)],
        "refusals": refusals([*impossible(), *done]),
        "commands": list(commanded(done, rows)),
    }


def used(use: str, done: list[Record]) -> Record:
    """How often a use ended how, and the seconds that it took in all."""
    own = [each for each in done if each["use"] == use]
    ends = Counter(each["end"] for each in own)
    counts = {"right": ends["right"], "refused": ends["refused"], "faults": ends["wrong"] + ends["raw"]}
    return {"use": use, "scenes": len(own), **counts, "seconds": sum(each["seconds"] for each in own)}


def commanded(done: list[Record], rows: list[Row]) -> Iterator[Record]:
    """How every command ended on every kind of scene, as "2 of 3": so many right, the others refused in one line."""
    for name in ("ground", "contact", "struts", "cables", "beside", "gait"):
        for kind in KINDS[name]:
            row = {"kind": f"{name}: {kind}"}
            for use in COMMANDS:
                ends = [each["end"] for each in done if each["use"] == use and rows[each["scene"]][name] == kind]
                told = f"{ends.count('right')} of {len(ends)}" if ends else "-"
                row[use] = told if set(ends) <= {"right", "refused"} else "wrong"
            yield row


def impossible() -> Iterator[Record]:
    """What is said where a scene with a pair of kinds that do not go together is made."""
    plain = {name: kinds[0] for name, kinds in KINDS.items()} | {"ground": "plane"}
    for pair in sorted(IMPOSSIBLE):
        yield {"use": "scene", **tried(lambda case: None, plain | dict(pair))}


def refusals(done: list[Record]) -> list[Record]:
    """Sentences, of those that differ in numbers alone the first, with the uses that they refused."""
    first: dict[str, str] = {}
    uses: dict[str, set[str]] = {}
    for each in done:
        if each["end"] == "refused":
            plain = re.sub(r"[\d.]+", "0", each["words"])
            first.setdefault(plain, each["words"])
            uses.setdefault(plain, set()).add(each["use"])
    return [{"sentence": words, "uses": sorted(uses[plain])} for plain, words in sorted(first.items())]


@matrix.table
def words(record: Record) -> str:
    """How much is covered."""
    faults = sum(each["faults"] for each in record["uses"])
    sums = {"scenes": "{scenes}", "pairs of kinds": "{pairs}", "uses tried": "{jobs}", "wrong": str(faults)}
    return columns([record], sums | {"time": "{seconds:.0f} s"})


@matrix.table(part="uses")
def words_of_uses(record: Record) -> str:
    """How every use ended."""
    cells = {
        "use": "{use}",
        "scenes": "{scenes}",
        "right": "{right}",
        "refused": "{refused}",
        "wrong": "{faults}",
        "time": "{seconds:.0f} s",
    }
    return columns(record["uses"], cells)


@matrix.table(part="refusals")
def words_of_refusals(record: Record) -> str:
    """All messages."""
    told = {"use": lambda row: ", ".join(row["uses"]), "refused in one line": "{sentence}"}
    return columns(record["refusals"], told)


@matrix.table(part="commands")
def words_of_commands(record: Record) -> str:
    """How every command ended on every kind of scene."""
    heads = {name.removeprefix("jaxgrity "): "{" + name + "}" for name in COMMANDS}
    return columns(record["commands"], {"kind": "{kind}"} | heads)

"""How long the first commands take, and how much of that is compilation.

Each command runs in a process of its own, with an empty folder for compiled programs (cold), and again with what the
first left there (warm).
"""

import json
import os
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Iterator
from pathlib import Path

from measurements.measurement import Record, check_names, measurement
from measurements.pages import table

from jaxgrity import InputError
from jaxgrity.io.files import read_text

HERE = Path(__file__).parent
COMMANDS = {
    "help": ("--help",),
    "simulate exact": ("simulate", "exact"),
    "simulate reference": ("simulate", "reference"),
    "diagnose exact": ("diagnose", "exact"),
    "search --quick": ("search", "--quick"),
    "explore": ("explore", "--no-browser", "--port", "0"),
    "README's gradient": (),
}
"""arguments of `jaxgrity`, by their names in the table; none: the first example of README.md"""
ENDLESS = {"explore": re.compile(rb"shown after|Ctrl-C to stop")}
"""what says that a command without an end has done what a user waits for; it is interrupted then"""


@measurement(page="performance.md", quick={"commands": ("help", "README's gradient")}, raw=("cpu", "tracing", "kept"))
def first_commands(commands: tuple[str, ...] = tuple(COMMANDS)) -> Iterator[Record]:
    """A row for each command, with nothing compiled before and then with what that left.

    Args:
        commands: names of those that are measured
    """
    check_names("commands", commands, COMMANDS)
    with tempfile.TemporaryDirectory() as folder:
        for name in commands:
            yield from cold_and_warm(name, Path(folder))


@first_commands.table
def words(record: Record) -> str:
    """Each command, cold and warm."""
    head = ["command", "cold, s", "of that compiling, s", "warm, s", "programs compiled"]
    found = {(row["name"], row["state"]): row for row in record["rows"]}
    rows = []
    for name in dict.fromkeys(row["name"] for row in record["rows"]):
        cold, warm = found[name, "cold"], found[name, "warm"]
        waited = cold["seconds"], cold["compiling"], warm["seconds"], cold["programs"]
        rows.append([name, *map(to_read, waited)])
    return table(head, rows)


def to_read(number: float) -> str:
    return f"{number:.0f}" if number >= 10 or number == int(number) else f"{number:.1f}"


def cold_and_warm(name: str, folder: Path) -> Iterator[Record]:
    """The rows of a command, with nothing compiled before and then with what that left."""
    place = folder / re.sub(r"\W+", "_", name)
    place.mkdir()
    for state in ("cold", "warm"):
        yield {"name": name, "state": state, **measure(name, place)}
    shutil.rmtree(place)


def measure(name: str, place: Path) -> dict:
    """What one run of a command needs, in the folder `place`, where compiled programs are kept too."""
    program = ["jaxgrity.cli.main", *COMMANDS[name]]
    if not COMMANDS[name]:
        (place / "example.py").write_text(readme_example())
        program = ["example.py"]
    report = place / "report.json"
    kept = {"JAX_COMPILATION_CACHE_DIR": str(place / "compiled"), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    began = time.perf_counter()
    terminal, inside = pty.openpty()  # as a user has it: what is printed comes out at once
    termios.tcsetwinsize(inside, (24, 100))  # without a width, no progress bar would be shown
    child = subprocess.Popen(
        [sys.executable, HERE / "compile_meter.py", report, *program],
        cwd=place,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE.parents[1]), *sys.path]), **kept},
        stdin=subprocess.DEVNULL,
        stdout=inside,
        stderr=inside,
    )
    os.close(inside)
    said = heard(terminal, ENDLESS.get(name), child)
    code = child.wait()
    seconds = time.perf_counter() - began
    if code != 0 and name not in ENDLESS:
        raise InputError(f"{name} ended with code {code}: {said.decode(errors='replace')[-500:]}")
    return {"seconds": seconds, **json.loads(report.read_text())}


def heard(terminal: int, enough: re.Pattern | None, child: subprocess.Popen) -> bytes:
    """What was said; a command that says `enough` is interrupted."""
    said = b""
    while True:
        ready, _, _ = select.select([terminal], [], [], 300.0)
        try:
            word = os.read(terminal, 65536) if ready else b""
        except OSError:  # on Linux that is how a terminal says that nobody is left on its other side
            word = b""
        if not word:
            break
        said += word
        if enough is not None and enough.search(said):
            child.send_signal(signal.SIGINT)
            enough = None
    os.close(terminal)
    return said


def readme_example() -> str:
    """The first example in Python of README.md."""
    found = re.search(r"```python\n(.*?)```", read_text(HERE.parents[1] / "README.md"), re.DOTALL)
    assert found, "README.md has an example"
    return found[1]

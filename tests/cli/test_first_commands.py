"""What a user waits for: imports before the first word, and programs that are compiled, never seconds."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import asdict, replace
from importlib import metadata
from pathlib import Path

import jax
import numpy as np
import pytest
from measurements.compile_meter import Counter
from small_scenes import swept

from jaxgrity import (
    Scene,
    SearchConfig,
    SolverOptions,
    Uncertainty,
    describe,
    diagnose,
    energy_audit,
    load_scene,
    sensitivity,
    simulate,
)
from jaxgrity.cli import command_line, main
from jaxgrity.cli.search import config_of
from jaxgrity.cli.search_settings import SearchSettings, UncertaintySettings
from jaxgrity.statics import resting_shape
from jaxgrity.structures import prism_tower

ROOT = Path(__file__).parents[2]
HEAVY = {"jax", "scipy", "matplotlib", "diffrax", "equinox", "optax"}
MOST_PROGRAMS = 17
"""that `simulate exact` makes, with its diagnosis and its figures; it was 32 before anybody counted"""


@pytest.fixture
def compiled():
    """`compiled(function)`: how many programs a call makes."""
    counter = Counter()
    counter.listen()

    def count(function) -> int:
        counter.reset()
        function()
        return counter.programs

    yield count
    jax.monitoring.unregister_event_duration_listener(counter._duration)
    jax.monitoring.unregister_event_listener(counter._event)


def of_own_process(code: str, *arguments: str, **how) -> str:
    """What a program prints that is run by itself."""
    words = [sys.executable, "-c", code, *arguments]
    return subprocess.run(words, capture_output=True, text=True, check=True, **how).stdout


@pytest.mark.slow
def test_python_runs_the_package_as_the_command():
    """`python -m jaxgrity` and `jaxgrity` say the same, and the first word comes before JAX."""
    code = (
        "import builtins, runpy, sys\nspeak = builtins.print\n"
        "def heard(*words, **how):\n    speak(*words, 'jax' in sys.modules, **how)\n"
        "builtins.print = heard\ntry:\n    runpy.run_module('jaxgrity', run_name='__main__')\n"
        "except SystemExit:\n    pass"
    )
    assert of_own_process(code, "simulate", "no such scene").startswith("simulate: loading JAX ... False\n")
    words = [sys.executable, "-m", "jaxgrity", "serach"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert (done.returncode, done.stderr.split(";")[1]) == (2, " perhaps you meant search")


@pytest.mark.parametrize("arguments", [("--help",), ("simulate", "--help"), ("search", "--help")])
def test_help_imports_nothing_that_takes_long(arguments):
    """Neither JAX nor what draws figures; the words stand there all the same."""
    code = (
        "import sys\nfrom jaxgrity.cli.main import main\ntry:\n    main()\n"
        "except SystemExit:\n    print('\\nIMPORTED', *{name.partition('.')[0] for name in sys.modules})"
    )
    said, _, imported = of_own_process(code, *arguments).partition("IMPORTED")
    assert "usage: jaxgrity" in said
    assert "tyro" in imported.split()
    assert not HEAVY & set(imported.split())


@pytest.mark.parametrize("words", [("--help",), ("search", "--help"), ("--version",)])
def test_a_reader_that_leaves_ends_the_command_silently(words):
    """As `| head` does: nothing on standard error, and the exit code of other programs."""
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as unread:
        words = [sys.executable, "-m", "jaxgrity", *words]
        done = subprocess.run(words, stdout=unread, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (command_line.UNREAD, "")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="the system has no device that is always full")
@pytest.mark.parametrize(
    ("output", "code", "errors"), [("&-", 0, ""), ("/dev/full", 2, "error: [Errno 28] No space left on device\n")]
)
def test_a_command_without_room_for_its_output_says_so(output, code, errors):
    """In one line; a closed standard output is no error."""
    done = subprocess.run(
        f"{sys.executable} -m jaxgrity --version >{output}", shell=True, stderr=subprocess.PIPE, text=True
    )
    assert (done.returncode, done.stderr) == (code, errors)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="the system has no device that is always full")
@pytest.mark.parametrize(("ends", "errors"), [(lambda: None, 1), (lambda: sys.exit(2), 0)])
def test_a_full_disk_is_told_once(capsys, monkeypatch, ends, errors):
    """Not again where the command has ended with an error of its own."""
    with open("/dev/full", "w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        full.write("loading JAX ...")
        with pytest.raises(SystemExit) as end:
            command_line.while_read()(ends)()
    assert end.value.code == 2
    assert capsys.readouterr().err.count("error: ") == errors


@pytest.mark.parametrize("body", ["deaf()", "threading.Thread(target=deaf).start(); time.sleep(600)"])
def test_ctrl_c_ends_a_command_that_cannot_hear_it(body):
    """While it runs compiled code, and while another thread does; else each would take many minutes."""
    code = (
        "import hashlib, signal, threading, time\nfrom jaxgrity.cli.interrupts import ended_by_interrupt\n"
        # what a shell starts in the background ignores it otherwise, and so do its children
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def deaf():\n    hashlib.pbkdf2_hmac('sha256', b'', b'', 2**31 - 1)\n"
        f"with ended_by_interrupt('; so'):\n    print('begun', flush=True)\n    {body}"
    )
    words = [sys.executable, "-c", code]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        assert child.stdout.readline() == "begun\n"
        child.send_signal(signal.SIGINT)
        try:
            said = child.communicate(timeout=120)[1]
        finally:
            child.kill()
        assert (said, child.returncode) == ("\ninterrupted; so\n", 130)


def test_the_version_is_that_of_the_package(capsys, monkeypatch):
    """In one line, and the help names the option."""
    monkeypatch.setattr(sys, "argv", ["jaxgrity", "--version"])
    main.main()
    assert capsys.readouterr().out == f"jaxgrity {metadata.version('jaxgrity')}\n"
    assert "--version" in main.__doc__


@pytest.mark.parametrize("command", [(), ("simulate",)])
def test_help_is_a_word_too(command, capsys, monkeypatch):
    """Before a command's name, or alone."""
    said = []
    for words in (("help", *command), (*command, "--help")):
        monkeypatch.setattr(sys, "argv", ["jaxgrity", *words])
        with pytest.raises(SystemExit):
            main.main()
        said.append(capsys.readouterr().out)
    assert said[0] == said[1] != ""


@pytest.mark.slow
def test_options_that_do_not_go_together_are_refused_before_anything_compiles():
    """In a process of its own, which has no programs yet."""
    code = """
import jax
from jaxgrity import InputError, SolverOptions, load_scene, simulate
made, scene = [], load_scene("reference")
jax.monitoring.register_event_duration_secs_listener(lambda name, *_, **__: made.append(name))
for given in ({"dt": 1e-4, "rtol": 1e-6}, {"method": "rk4", "atol": 1e-6}, {"method": "rk4", "coupled": True}):
    try:
        simulate(scene, 1.0, options=SolverOptions(**given))
    except InputError:
        print("/jax/core/compile/backend_compile_duration" in made)
"""
    assert of_own_process(code) == "False\nFalse\nFalse\n"


@pytest.mark.slow
def test_the_first_word_comes_before_jax():
    """A command says its name as soon as its settings are read; its modules are imported after that."""
    code = (
        "import builtins, sys\nspeak = builtins.print\n"
        "def heard(*words, **how):\n    speak(*words, 'jax' in sys.modules, **how)\n"
        "builtins.print = heard\nfrom jaxgrity.cli.main import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass"
    )
    assert of_own_process(code, "simulate", "no such scene").startswith("simulate: loading JAX ... False\n")


def test_settings_say_what_the_library_does_by_itself():
    """They repeat its numbers, since they are read before it is imported."""
    assert config_of(SearchSettings()) == SearchConfig()
    assert asdict(UncertaintySettings()).keys() == vars(Uncertainty()).keys()


def test_describing_again_compiles_nothing(compiled, exact):
    """Nor does another scene of the same kind."""
    describe(exact)
    softer = replace(exact, gravity=np.asarray(1.6))
    assert compiled(lambda: describe(exact)) == 0
    assert compiled(lambda: describe(load_scene("exact"))) == 0
    assert compiled(lambda: describe(softer)) == 0


def test_describing_takes_the_program_of_the_resting_shape(compiled):
    """Natural frequencies of rigid struts too: springs that bear differ from unstrained ones in numbers alone."""
    tower = prism_tower(15, exact=True)
    resting_shape(Scene(tower.structure))
    assert compiled(lambda: describe(tower)) == 0


@pytest.mark.campaign
def test_other_numbers_compile_nothing(compiled):
    """Of sweeps, tolerances, the precision of starts, and frames."""
    scene = swept()
    q = np.asarray(scene.structure.nodes)
    roll = lambda duration=0.05, **how: lambda: simulate(scene, duration, **how)  # noqa: E731
    roll()()
    assert compiled(roll(positions=q, velocities=np.zeros(q.shape, np.float32))) == 0
    assert compiled(roll(0.06, frame_rate=50.0)) == 0
    roll(options=SolverOptions(sweeps=4))()
    assert compiled(roll(options=SolverOptions(sweeps=7))) == 0
    roll(options=SolverOptions(strut_tolerance=1e-9))()
    assert compiled(roll(options=SolverOptions(strut_tolerance=1e-10, sweeps=30))) == 0
    springs = swept(stiff=False)
    adaptive = lambda rtol: simulate(springs, 0.02, options=SolverOptions("tsit5", rtol=rtol))  # noqa: E731
    adaptive(1e-4)
    assert compiled(lambda: adaptive(1e-5)) == 0


@pytest.mark.campaign
def test_diagnoses_of_other_durations_compile_nothing(compiled):
    """Nor at other steps, nor with other numbers of frames."""
    free = replace(swept(stiff=False, ground=False), gait=None)
    diagnose(free, 0.05)
    assert compiled(lambda: diagnose(free, 0.07, frame_rate=50.0, options=SolverOptions(dt=1e-4))) == 0


@pytest.mark.campaign
def test_simulate_makes_few_programs(tmp_path):
    """In a process of its own, with its diagnosis, its figures and its replay; some more than there are, for other
    versions of JAX."""
    meter = ROOT / "experiments" / "measurements" / "compile_meter.py"
    command = ("jaxgrity.cli.main", "simulate", "exact", "--duration", "0.2", "--out", str(tmp_path / "out"))
    subprocess.run(
        [sys.executable, meter, tmp_path / "report.json", *command],
        check=True,
        capture_output=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]), "JAX_NUM_CPU_DEVICES": "1"},
    )
    report = json.loads((tmp_path / "report.json").read_text())
    assert 0 < report["programs"] <= MOST_PROGRAMS
    assert (tmp_path / "out" / "forces.png").exists()


@pytest.mark.campaign
def test_frames_that_fill_a_program_are_not_among_the_results():
    """Of motions shorter than the room that programs have for them."""
    audit, growth = energy_audit(swept(), 0.05), sensitivity(swept(), 0.3)
    assert audit.times.shape == audit.kinetic.shape == audit.lost.shape == (6,)
    assert growth.times.shape == growth.norm.shape == (4,)
    assert np.ptp(audit.positions, axis=0).max() > 0

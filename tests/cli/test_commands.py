"""The command `jaxgrity`: what each subcommand leaves, and one clear line with exit code 2 on bad input."""

import dataclasses
import importlib
import io
import json
import os
import re
import subprocess
import sys
import threading
import warnings
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, is_dataclass, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import docstring_parser
import equinox as eqx
import numpy as np
import pytest

from jaxgrity import (
    ConeFriction,
    Distance,
    InputError,
    SearchConfig,
    Sensitivity,
    Uncertainty,
    load_gait,
    load_scene,
    random_phases,
    scene_text,
    with_gait,
)
from jaxgrity import simulate as roll_out
from jaxgrity.cli import command_line, progress, script, search_settings, simulate
from jaxgrity.cli import main as command
from jaxgrity.cli import settings as all_settings
from jaxgrity.cli.search import (
    changed_words,
    equal_mass_words,
    faster_words,
    make_quick,
    replaced_words,
    standstill_words,
    twin_words,
)
from jaxgrity.cli.search_settings import SearchSettings
from jaxgrity.cli.settings import SimulateSettings
from jaxgrity.formats import load_trajectory
from jaxgrity.model import rigid_body, with_contact_between_struts
from jaxgrity.search import EvaluationConfig, Progress, SearchSpace, robot_motions

ROOT = Path(__file__).parents[2]
ANSWERS = json.loads((ROOT / "tests" / "data" / "reference_answers.json").read_text())
SUBCOMMANDS = (
    *("demo", "simulate", "search", "compare", "diagnose", "validate", "train", "explore", "inspect"),
    "catalogue",
)
FREE = """
[structure]
kind = "custom"
nodes = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
struts = [[0, 1]]
cables = [[0, 2], [1, 2]]
mass = 6.0

[struts]
stiffness = 2e4

[cables]
stiffness = 600.0
prestrain = 0.3
"""
"""a scene in which nothing dissipates"""
DRIVEN = """
[gait]
members = "struts"
amplitude = 0.3
frequency = 0.5
phase = [0.0]
start = 0.0
ramp = 1.0
"""
"""a gait of its strut"""


class Done(NamedTuple):
    """What a command said, and how it ended."""

    code: int
    out: str
    errors: str


@pytest.fixture(scope="module")
def jaxgrity():
    """`jaxgrity(*arguments)`: the command, in this process, which has set up what the command would."""

    def call(*arguments: object) -> Done:
        out, errors, code = io.StringIO(), io.StringIO(), 0
        with pytest.MonkeyPatch.context() as patched, redirect_stdout(out), redirect_stderr(errors):
            patched.setattr(script, "configure", lambda: None)
            patched.setenv("JAX_NUM_CPU_DEVICES", "1")
            patched.setattr(sys, "argv", ["jaxgrity", *map(str, arguments)])
            try:
                command.main()
            except SystemExit as end:
                code = end.code
        return Done(code, out.getvalue(), errors.getvalue())

    return call


def in_its_own_process(*command: object, **environment: str) -> Done:
    """What a user gets who calls it."""
    words = [sys.executable, *map(str, command)]
    done = subprocess.run(words, capture_output=True, text=True, env=os.environ | environment)
    return Done(done.returncode, done.stdout, done.stderr)


def summary_in(folder: Path) -> dict:
    return json.loads((folder / "summary.json").read_text())


def write_gaits(path: Path, phases: np.ndarray) -> Path:
    np.savetxt(path, phases, delimiter=",", fmt="%.17g")
    return path


# simulate


@pytest.mark.campaign
def test_simulate_agrees_with_an_independent_program(jaxgrity, tmp_path):
    """16 gaits from a CSV: every component of every centre of mass within 1e-7 m."""
    gaits = write_gaits(tmp_path / "gaits.csv", np.array([row["phase"] for row in ANSWERS["gaits"]]))
    out = tmp_path / "out"
    done = jaxgrity("simulate", "reference", "--gaits", gaits, "--duration", 2, "--dt", 5e-4, "--out", out)
    assert done.code == 0, done.errors
    summary = summary_in(out)
    assert (summary["method"], summary["dt"], summary["dtype"], summary["duration"]) == ("rk4", 5e-4, "float64", 2.0)
    assert summary["scene"] == "reference"
    assert summary["steps"] == 4000
    assert len(summary["error_bar"]) == 16
    assert max(summary["error_bar"]) < 0.01
    assert summary["diagnosis_of_furthest"]["error_bar"] == pytest.approx(
        summary["error_bar"][int(np.argmax(summary["distance"]))], rel=0.2, abs=1e-9
    )
    assert summary["failed"] == []
    assert summary["wall_seconds"] > 0
    assert summary["compile_seconds"] >= 0
    expected = [row["com_end"] for row in ANSWERS["gaits"]]
    np.testing.assert_allclose(summary["com_end"], expected, rtol=0, atol=1e-7)
    assert (out / "outcomes.png").stat().st_size > 5000


@pytest.mark.slow
def test_simulate_one_rollout(jaxgrity, tmp_path):
    """With a gait of the library: it leaves its trajectory and its figures; what the scene chose is in the summary."""
    arguments = ("--gait", "lasting", "--duration", 2, "--dt", 5e-4, "--out", tmp_path)
    (tmp_path / "outcomes.png").write_bytes(b"of an earlier population")
    done = jaxgrity("simulate", "reference", *arguments)
    assert done.code == 0, done.errors
    assert "smooth friction" in done.out
    assert f"{tmp_path}/outcomes.png will be removed or replaced; set another --out " in done.out
    summary = summary_in(tmp_path)
    with np.load(tmp_path / "trajectory.npz") as saved:
        assert saved["positions"].shape == (201, 12, 3)
        assert saved["velocities"].shape == (201, 12, 3)
        np.testing.assert_allclose(saved["positions"][-1].mean(0), summary["com_end"][0], atol=1e-12)
    moved = load_trajectory(tmp_path / "trajectory.npz").scene
    np.testing.assert_array_equal(moved.gait.phase, load_gait("lasting").phase)
    assert (summary["method"], summary["dt"]) == ("rk4", 5e-4)
    assert 0 < summary["diagnosis"]["error_bar"] < 1e-3
    assert "energy residual" in done.out
    assert (tmp_path / "path.png").exists()
    assert (tmp_path / "members.png").exists()
    assert not (tmp_path / "outcomes.png").exists()


@pytest.mark.parametrize(
    "words",
    [
        ("simulate", "reference", "--method", "euler"),
        ("simulate", "reference", "--animation", "gif", "--fps", 0),
        ("simulate", "reference", "--gaits", "short.csv"),
        ("simulate", "reference", "--gaits", "short.csv", "--animation", "gif"),
        ("train", "speed", "--episodes", 1),
        ("train", "speed", "--updates", -1),
        ("train", "speed", "--seed", -1),
        ("diagnose", "reference", "--method", "verlet"),
        ("validate", "still.toml", "--data", "run.csv", "--method", "euler"),
        ("search", "--scene", "still.toml"),
        ("search", "--dt", 0.1),
    ],
    ids=lambda words: " ".join(map(str, words)),
)
def test_a_refused_command_says_and_changes_nothing_else(jaxgrity, tmp_path, monkeypatch, words):
    """No description of the scene comes before the refusal, and earlier results stay."""
    monkeypatch.chdir(tmp_path)
    Path("short.csv").write_text("0,1,2,3,4\n")
    Path("still.toml").write_text(FREE)
    seen = "".join(f"{k},0,0,0,1,0,0,0,1,0\n" for k in range(4))
    Path("run.csv").write_text(f"t,{','.join(f'{axis}{node}' for node in range(3) for axis in 'xyz')}\n{seen}")
    Path("summary.json").write_text("{}")
    done = jaxgrity(*words, "--out", tmp_path)
    assert (done.code, done.out) == (2, f"{words[0]}: loading JAX ...\n")
    assert done.errors.startswith("error: ")
    assert Path("summary.json").read_text() == "{}"


@pytest.mark.slow
def test_frames_of_small_robots_show_what_they_do():
    """Else the command says nothing of the motion: a robot of a millimetre changes its face within 3 ms."""
    scene = load_scene("exact")
    for size, rate in ((1.0, 100.0), (100.0, 100.0), (1e-4, 5000.0)):
        struts = dataclasses.replace(scene.structure.struts, rest_length=size * scene.structure.struts.rest_length)
        structure = dataclasses.replace(scene.structure, nodes=size * scene.structure.nodes, struts=struts)
        here = dataclasses.replace(scene, structure=structure)
        assert simulate.frame_rate_of(here) == pytest.approx(rate, rel=1e-6)
    assert simulate.frame_rate_of(dataclasses.replace(here, ground=None, friction=None)) == 100.0


def test_simulate_reports_a_failure_as_data(jaxgrity, tmp_path):
    """A gait that no step can follow ends in the summary's list of failures, with exit code 0."""
    (tmp_path / "scene.toml").write_text(FREE.replace("stiffness = 2e4", "stiffness = 1e12") + DRIVEN)
    gaits = write_gaits(tmp_path / "gaits.csv", random_phases(2, 1, seed=0))
    done = jaxgrity(
        "simulate", tmp_path / "scene.toml", "--gaits", gaits, "--duration", 0.05, "--method", "rk4",
        "--dt", 1e-3, "--any-step", "--out", tmp_path,
    )  # fmt: skip
    assert done.code == 0, done.errors
    summary = summary_in(tmp_path)
    assert summary["failed"] == [0, 1]
    assert summary["distance"] == [None, None]
    assert summary["outcome"][0] == "the motion is not finite, or misses its constraints"


def test_a_gait_of_the_library_takes_the_place_of_the_scenes_own(tmp_path, capsys):
    """By its name; where it was found on another scene, that is said."""
    (tmp_path / "exact.toml").write_text(scene_text("exact"))
    for scene, said in (
        ("exact", ""),
        (tmp_path / "exact.toml", ""),
        ("reference", "note: the gait lasting was found on the scene exact\n"),
    ):
        found = simulate.chosen_scene(str(scene), "lasting")
        assert eqx.tree_equal(found, with_gait(load_scene(scene), load_gait("lasting")))
        assert capsys.readouterr().out == said


@pytest.mark.campaign
def test_the_former_name_of_verlet_warns_once_and_works(jaxgrity, tmp_path):
    """However many rollouts the command makes."""
    (tmp_path / "free.toml").write_text(FREE)
    words = ("--method", "symplectic", "--duration", 0.05, "--no-replay", "--out", tmp_path)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("default")
        done = jaxgrity("simulate", tmp_path / "free.toml", *words)
    assert done.code == 0, done.errors
    assert summary_in(tmp_path)["method"] == "verlet"
    (warning,) = said
    assert warning.category is FutureWarning
    assert str(warning.message).startswith("method 'symplectic' is now called 'verlet'")


@pytest.mark.slow
def test_an_adaptive_method_has_no_step(jaxgrity, tmp_path):
    """None is given, and none is said."""
    (tmp_path / "free.toml").write_text(FREE)
    words = ("--method", "tsit5", "--duration", 0.05, "--no-diagnose", "--no-replay", "--out", tmp_path)
    assert jaxgrity("simulate", tmp_path / "free.toml", *words).code == 0
    summary = summary_in(tmp_path)
    assert (summary["method"], summary["dt"], summary["diagnosis"]) == ("tsit5", None, None)
    assert summary["steps"] > 1


# diagnose


@pytest.mark.slow
def test_diagnose_says_how_far_a_rollout_can_be_trusted(jaxgrity, tmp_path):
    """In a table, as JSON and as a figure; of a gait of the library too."""
    arguments = ("--gait", "lasting", "--duration", 2, "--dt", 5e-4, "--out", tmp_path)
    done = jaxgrity("diagnose", "reference", *arguments)
    assert done.code == 0, done.errors
    assert "rk4" in done.out
    for line in ("error bar", "energy residual", "penetration", "predictable"):
        assert line in done.out
    facts = json.loads((tmp_path / "diagnosis.json").read_text())
    assert (facts["scene"], facts["duration"], facts["outcome"]) == ("reference", 2.0, "succeeded")
    assert 0 < facts["error_bar"] < 1e-3
    assert (tmp_path / "path.png").stat().st_size > 5000


# bad input


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["simulate", "missing.toml"], ["scene 'missing.toml': unknown; expected a file, or one of exact,"]),
        (["simulate", "moon"], ["scene 'moon': unknown; expected a file, or one of exact,"]),
        (["simulate", "reference", "--method", "euler"], ["euler", "rk4, tsit5"]),
        (["simulate", "reference", "--duration", "-1"], ["duration = -1", "positive"]),
        (["simulate", "reference", "--dt", "0.02"], ["dt = 0.02", "largest stable step", "0.00136"]),
        (["simulate", "reference", "--method", "verlet"], ["verlet", "dissipation"]),
        (["simulate", "reference", "--gait", "fly"], ["gait 'fly': unknown", "lasting"]),
        (["simulate", "reference", "--gaits", "short.csv"], ["short.csv", "row 2 has 5 phases; expected 6"]),
        (["simulate", "still.toml", "--gaits", "short.csv"], ["--gaits short.csv: the scene has no gait"]),
        (["simulate", "stiff.toml"], ["stiff.toml", "struts.stiffness", "-1"]),
        (["diagnose", "moon"], ["scene 'moon': unknown; expected a file, or one of exact,"]),
        (["diagnose", "exact", "--method", "rk4"], ["rk4", "expected 'complementarity'"]),
        (["diagnose", "reference", "--gait", "fly"], ["gait 'fly': unknown", "lasting"]),
        (["validate", "moon", "--data", "short.csv"], ["scene 'moon': unknown; expected a file, or one of exact,"]),
        (["validate", "exact", "--data", "short.csv"], ["short.csv: has no column t; expected columns t, x0"]),
        (["search", "--scene", "moon"], ["scene 'moon': unknown; expected a file, or one of exact,"]),
        (["search", "--scene", "still.toml"], ["has no [gait]"]),
        (["search", "--dt", "0.1"], ["largest stable step"]),
        (["search", "--dt", "nan"], ["dt = nan"]),
        (["search", "--population", "1"], ["population = 1: expected a whole number, at least 2"]),
        (["search", "--polish-gaits", "17"], ["polish: gaits = 17; expected 1 to 16"]),
        (["search", "--polish-rollouts", "3"], ["3 rollouts of polish: expected 96 or more (climbs: 1)"]),
        (["search", "--objective.kind", "far"], ["objective = 'far': unknown; expected one of distance, direction"]),
        (["search", "--objective.heading", "1"], ["heading = 1.0: 'steady speed' has none"]),
        (["search", "--objective.largest-rate", "0"], ["(--objective.largest-rate) = 0: expected a positive number"]),
        (["search", "--caution", "1", "--robots", "1"], ["caution = 1.0: one robot has no spread"]),
        (["compare"], ["no runs: expected at least one result folder"]),
        (["compare", "missing"], ["missing/summary.json", "No such file"]),
        (["compare", "broken"], ["broken/summary.json: not JSON"]),
        (["compare", "other"], ["other/summary.json: has no error_bar, robust, other_contact_model"]),
        (["compare", "numbers"], ["numbers/summary.json: not what a gait search leaves in summary.json"]),
    ],
    ids=lambda words: " ".join(words) if words[0] in SUBCOMMANDS else "",
)
def test_bad_input_is_one_line(jaxgrity, tmp_path, monkeypatch, arguments, words):
    """What, where, the value received, what was expected; nothing is written that would have to be removed."""
    monkeypatch.chdir(tmp_path)
    Path("short.csv").write_text("0,1,2,3,4,5\n0,1,2,3,4\n")
    Path("stiff.toml").write_text(scene_text("reference").replace("stiffness = 2e4", "stiffness = -1.0"))
    Path("still.toml").write_text(scene_text("reference").split("[gait]")[0])
    needed = "distance error_bar robust other_contact_model steady actuators searches settings unit "
    needed += "within_bounds beyond_bounds"
    numbers = json.dumps(dict.fromkeys(needed.split(), 1.0))
    for name, text in (("broken", "{"), ("other", '{"distance": 1.0}'), ("numbers", numbers)):
        Path(name).mkdir()
        Path(name, "summary.json").write_text(text)
    done = jaxgrity(*arguments, "--out", "out")
    assert (done.code, done.out) == (2, f"{arguments[0]}: loading JAX ...\n")
    (line,) = done.errors.strip().splitlines()
    assert line.startswith("error: ")
    assert all(word in line for word in words), line
    assert not Path("out").exists()


@pytest.mark.parametrize("command", [("simulate", "exact"), ("catalogue",), ("search",)])
@pytest.mark.parametrize("out", ["taken", "taken/deeper"])
def test_a_file_in_the_place_of_the_folder_of_results_is_refused(jaxgrity, tmp_path, command, out):
    """Before anything is computed for it."""
    (tmp_path / "taken").write_text("mine")
    done = jaxgrity(*command, "--out", tmp_path / out)
    assert (done.code, done.out) == (2, f"{command[0]}: loading JAX ...\n")
    assert done.errors.startswith(f"error: --out {tmp_path / out}: {tmp_path / 'taken'} is a file; expected a folder")
    assert (tmp_path / "taken").read_text() == "mine"


def test_a_search_says_what_it_replaces(tmp_path):
    """Pictures of a report too; nothing where it goes on with what is there, or is refused."""
    settings = SearchSettings(out=tmp_path)
    assert replaced_words(settings) == ""
    (tmp_path / "notes.txt").write_text("mine")
    assert replaced_words(settings) == ""
    (tmp_path / "orbit.png").write_bytes(b"")
    assert replaced_words(settings).startswith(f"{tmp_path}/orbit.png will be removed or replaced; set another --out ")
    (tmp_path / "run.json").write_text('{"settings": {}, "done": false}')
    (tmp_path / "state_0.npz").write_bytes(b"")
    assert replaced_words(settings) == ""
    assert f"{tmp_path}/state_0.npz and 2 more files there" in replaced_words(replace(settings, restart=True))
    (tmp_path / "run.json").write_text('{"settings": {}, "done": true}')
    assert "and 2 more files there" in replaced_words(settings)
    assert replaced_words(replace(settings, resume=True)) == ""
    (tmp_path / "run.json").write_text("damaged")
    assert "and 2 more files there" in replaced_words(replace(settings, restart=True))


def test_a_search_says_before_it_begins_that_its_gaits_are_late():
    """Where a steady objective counts time before full swing; a quick search of a scene of the library does not."""
    scene = load_scene("exact")
    late = with_gait(scene, replace(scene.gait, start=10.0))
    assert standstill_words(late, SearchConfig(duration=20.0)) == (
        "The objective counts the time from 5 s on, but the gait is in full swing from 10.8 s on: search with a "
        "duration of 43 s or more.\n\n"
    )
    assert standstill_words(late, SearchConfig(duration=20.0, evaluation=EvaluationConfig(Distance()))) == ""
    assert standstill_words(late, SearchConfig(duration=43.0)) == ""
    for name in ("exact", "reference", "uphill"):
        assert standstill_words(load_scene(name), SearchConfig(duration=8.0)) == "", name


def test_a_search_says_that_perturbed_robots_weigh_the_same(exact):
    """Where only rods have mass, an uncertain mass of nodes changes nothing; that of bodies differs, too."""
    structure = exact.structure
    rods = replace(structure.struts, mass=np.ones(6))
    light = replace(exact, structure=replace(structure, node_mass=0 * structure.node_mass, struts=rods))
    known = SearchConfig(evaluation=EvaluationConfig(uncertainty=Uncertainty(friction=0.2)))
    assert equal_mass_words(light, SearchConfig()).startswith("Perturbed robots all weigh the same: ")
    assert equal_mass_words(light, known) == equal_mass_words(exact, SearchConfig()) == ""
    body = rigid_body(np.asarray(structure.nodes), range(12), 1.0, [0.1] * 3)
    bodies = replace(light, structure=replace(light.structure, bodies=(body,)))
    assert equal_mass_words(bodies, SearchConfig()) == ""


def test_a_search_says_how_it_changes_the_gait_to_begin_with():
    """Its ramp, and the strokes that the bound on the rate leaves; nothing if both stay."""
    scene = with_gait(load_scene("exact"), load_gait("straight"))
    assert changed_words(scene, SearchConfig(from_gait=True)) == (
        "The gait to begin with gets the ramp of the search, 0.75 s (--ramp None: its own, 1 s), and keeps 84% of its "
        "strokes, by the bound on the rate (--objective.largest-rate).\n\n"
    )
    assert changed_words(scene, SearchConfig(from_gait=True, space=SearchSpace(ramp=None))) == ""
    assert changed_words(scene, SearchConfig()) == ""


def test_a_search_says_how_it_would_be_faster():
    """Of rods with mass, and of friction that sweeps may not solve; on penalty ground too. Nothing where it is fast."""
    for name in ("exact", "reference"):
        scene = load_scene(name)
        assert faster_words(scene, "robot.toml") == "", name
        rods = replace(scene, structure=replace(scene.structure, struts=struts_of_mass(scene)))
        said = faster_words(rods, "robot.toml")
        assert said.count("\n") == 2
        assert "Faster: jaxgrity convert robot.toml light.toml --mass-at-ends (rods are then harder to turn).\n" in said
    rough = replace(load_scene("exact"), friction=ConeFriction(1.0))
    assert "Faster: [friction] mu below 1.\n" in faster_words(rough, "robot.toml")
    both = faster_words(replace(rough, structure=replace(rough.structure, struts=struts_of_mass(rough))), "robot.toml")
    assert "--mass-at-ends (rods are then harder to turn), and [friction] mu below 1.\n" in both
    meeting = with_contact_between_struts(load_scene("exact"), 0.01)
    thin = "no [touching], and no balls and along_struts in [ground] (nodes alone then touch it, and rods pass through)"
    assert f"Faster: {thin}" in faster_words(meeting, "robot.toml")
    meeting = replace(meeting, structure=replace(meeting.structure, struts=struts_of_mass(meeting)))
    assert f"--mass-at-ends (rods are then harder to turn), and {thin}" in faster_words(meeting, "robot.toml")
    spine = load_scene("exact")
    held = replace(spine, structure=replace(spine.structure, fixed=((0, "xyz"),)))
    assert faster_words(held, "robot.toml") == ""


def test_a_search_says_that_the_other_model_of_rigid_bodies_takes_most_of_the_time():
    """And which option leaves it out; nothing where it does, or where the robot has no bodies."""
    scene, alone = load_scene("exact"), SearchConfig(evaluation=EvaluationConfig(both_models=False))
    body = rigid_body(scene.structure.nodes, (0, 1, 4, 8), 0.5, [1e-2] * 3)
    bodies = replace(scene, structure=replace(scene.structure, struts=None, bodies=(body,)))
    said = twin_words(bodies, SearchConfig())
    assert said.startswith("The other contact model takes ")
    assert "With --no-both-models " in said
    assert [twin_words(scene, SearchConfig()), twin_words(bodies, alone)] == ["", ""]


def struts_of_mass(scene):
    """The struts, with 1 kg each."""
    return replace(scene.structure.struts, mass=np.ones(len(scene.structure.struts.edges)))


def test_a_quick_search_keeps_what_is_smaller():
    """A population of 16 stays 16, and the default becomes 64."""
    usual, small = SearchSettings(), SearchSettings(duration=5.0, population=16, generations=(1, 4), polish_rollouts=0)
    for settings in (usual, small):
        make_quick(settings)
    assert (usual.duration, usual.population, usual.generations, usual.polish_rollouts) == (16.0, 64, (3, 2), 256)
    assert (small.duration, small.population, small.generations, small.polish_rollouts) == (5.0, 16, (1, 2), 0)


def test_there_has_to_be_a_search_to_resume(jaxgrity, tmp_path):
    """The folder is made, for it is locked before it is looked at."""
    done = jaxgrity("search", "--scene", "exact", "--resume", "--out", tmp_path)
    assert done.code == 2
    (line,) = done.errors.strip().splitlines()
    assert line == f"error: {tmp_path}: has no run; expected one to resume"


@pytest.mark.slow
def test_a_refusal_ends_with_exit_code_2():
    """And its one line is all that is said, in a process of its own."""
    done = in_its_own_process("-m", "jaxgrity.cli.main", "simulate", "reference", "--duration", "0")
    assert done.code == 2
    assert done.errors.strip() == "error: duration = 0 s: expected a positive number"


@pytest.mark.campaign
def test_a_picture_that_fails_costs_this_picture(monkeypatch, tmp_path, capsys):
    """With a line; the others are there, and the summary follows."""

    def broken(scene, trajectory):
        raise ValueError("no such colour\nand more")

    monkeypatch.setattr(simulate.plot, "member_figure", broken)
    scene = load_scene("exact")
    motion = roll_out(scene, 0.1)
    settings = SimulateSettings(scene="exact", out=tmp_path, animation="none", replay=False)
    simulate.leave_pictures(scene, motion, settings)
    assert capsys.readouterr().out.splitlines() == ["no members.png: ValueError: no such colour"]
    assert [file.name for file in tmp_path.iterdir()] == ["forces.png"]


@pytest.mark.parametrize(("pieces", "failed", "calls"), [(6, False, 1), (6, True, 2), (1, False, 2)])
def test_a_long_motion_is_made_once(monkeypatch, pieces, failed, calls):
    """Its pieces say how long it takes: here the first of them compiles for 5 s, and each takes 2 s. Those of a motion
    that failed on the way do not."""
    now, made = [0.0], []
    monkeypatch.setattr(simulate.time, "perf_counter", lambda: now[0])

    def roll(heard):
        made.append(True)
        for done in range(pieces):
            heard(float(done), float(pieces))
            now[0] += 2.0 + 5.0 * (now[0] == 0)
        heard(float(pieces), float(pieces))
        return SimpleNamespace(failed=failed)

    _, wall, compilation = simulate.timed(roll, float(pieces), progress.Bars())
    assert (len(made), wall, compilation) == (calls, 2.0 * pieces, 5.0)


@pytest.mark.campaign
def test_the_replay_comes_before_the_diagnosis(monkeypatch, tmp_path, capsys):
    """So one sees the motion early; a diagnosis that fails costs itself alone, with a line."""
    pytest.importorskip("viser")
    there = []

    def failing(*_, **__):
        there.append((tmp_path / "replay.html").exists())
        raise MemoryError("no room\nand more")

    monkeypatch.setattr(simulate, "diagnose", failing)
    found = simulate.single(load_scene("exact"), 0.1, SimulateSettings(scene="exact", out=tmp_path))
    lines = capsys.readouterr().out.splitlines()
    watched = f"to watch the motion in 3D, open {tmp_path}/replay.html in a browser"
    assert there == [True]
    assert lines.index(watched) < lines.index("no diagnosis: MemoryError: no room")
    assert (found["diagnosis"], found["failed"]) == (None, [])
    assert (tmp_path / "path.png").exists()


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("resume", "interrupted; the same command with --resume continues from the saved state"),
        ("quick", "interrupted"),
    ],
)
def test_an_interruption_is_one_line(monkeypatch, capsys, setting, said):
    """Ctrl-C ends with exit code 130, and says how to go on where one can."""
    monkeypatch.setenv("JAX_NUM_CPU_DEVICES", "1")

    @dataclass
    class Settings:
        pass

    setattr(Settings, setting, False)

    def interrupt(settings):
        raise KeyboardInterrupt

    with pytest.raises(SystemExit) as end:
        script.execute(interrupt, Settings())
    assert end.value.code == 130
    assert capsys.readouterr().err.strip() == said


def test_processes_that_work_as_one_say_how_many_they_are(monkeypatch):
    """And which of them each is; without that there is one clear line."""
    joined = []
    monkeypatch.setattr("jax.distributed.initialize", lambda **how: joined.append(how))
    monkeypatch.delenv("SLURM_STEP_NUM_TASKS", raising=False)
    script.join_hosts()
    assert not joined
    for name, value in (("COORDINATOR_ADDRESS", "127.0.0.1:1"), ("NUM_PROCESSES", "2"), ("PROCESS_ID", "1")):
        monkeypatch.setenv(f"JAX_{name}", value)
    script.join_hosts()
    assert joined == [{"num_processes": 2, "process_id": 1}]
    monkeypatch.delenv("JAX_PROCESS_ID")
    with pytest.raises(InputError, match="JAX_NUM_PROCESSES = '2', JAX_PROCESS_ID = '': expected two numbers"):
        script.join_hosts()


# explore, inspect and catalogue


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("moon",), "scene 'moon': unknown"),
        (("exact", "--duration", 0), "duration = 0 s: expected a positive number"),
        (("exact", "--duration", "inf"), "duration = inf s: expected a positive number"),
    ],
)
def test_explore_refuses_bad_input_before_it_serves(jaxgrity, arguments, said):
    """In one line; nothing answers."""
    done = jaxgrity("explore", *arguments)
    assert done.code == 2
    assert said in done.errors
    assert "http" not in done.out


def test_inspect_leaves_the_report_and_a_figure(jaxgrity, tmp_path):
    """What is printed, as numbers: the six-strut robot's one self-stress and one mechanism."""
    done = jaxgrity("inspect", "exact", "--out", tmp_path)
    assert done.code == 0, done.errors
    assert "rank 29, 1 of self-stress, 1 mechanism\n" in done.out
    found = json.loads((tmp_path / "inspection.json").read_text())
    assert (found["scene"], found["rank"], len(found["forces"])) == ("exact", 29, 30)
    assert (tmp_path / "forces.png").stat().st_size > 5000


@pytest.mark.slow
def test_catalogue_lists_what_scene_files_can_name(jaxgrity, tmp_path):
    """Each kind with its keys; their pictures, unless it is to be quick."""
    done = jaxgrity("catalogue", "--out", tmp_path)
    assert done.code == 0, done.errors
    found = {entry["kind"]: entry for entry in json.loads((tmp_path / "catalogue.json").read_text())["structures"]}
    assert found["ball"]["keys"] == {"struts": 30, "strut_length": 1.0}
    assert all(name in done.out for name in found)
    assert {path.stem for path in tmp_path.glob("*.png")} == {*found, "catalogue"}
    assert jaxgrity("catalogue", "--quick", "--out", tmp_path / "quick").code == 0
    assert not list((tmp_path / "quick").glob("*.png"))


# help


@pytest.mark.campaign
def test_learning_goes_on_where_it_was_interrupted(jaxgrity, tmp_path):
    """The smallest size: files that a user opens, and a second run that has nothing left to do."""
    done = jaxgrity("train", "speed", "--quick", "--out", tmp_path)
    assert done.code == 0, done.errors
    left = {path.name for path in tmp_path.iterdir()}
    assert {"policy.eqx", "learner.eqx", "curve.json", "learning.png", "summary.json"} <= left
    first = json.loads((tmp_path / "summary.json").read_text())
    assert len(first["curve"]) == 2
    assert first["periods"] == 2 * 16 * 4 * 4
    again = jaxgrity("train", "speed", "--quick", "--resume", "--out", tmp_path)
    assert again.code == 0, again.errors
    assert json.loads((tmp_path / "summary.json").read_text()) == first
    other = jaxgrity("train", "speed", "--resume", "--out", tmp_path / "nothing")
    assert other.code == 2
    assert "nothing: nothing to resume" in other.errors


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_help_comes_from_the_settings(jaxgrity, name):
    """Every subcommand explains itself; those that end by themselves have a --quick size and a folder of results."""
    done = jaxgrity(name, "--help")
    assert done.code == 0
    expected = ("--host", "--port") if name == "explore" else ("--quick", "--out")
    assert all(option in done.out for option in expected)
    module = importlib.import_module(f"jaxgrity.cli.{name}")
    assert words(module.__doc__) in words(done.out)


def test_texts_of_options_have_one_line_each():
    """Of two, tyro would keep the line break, in the midst of a sentence."""
    kinds = [kind for module in (all_settings, search_settings) for kind in vars(module).values() if is_dataclass(kind)]
    told = [part for kind in kinds for part in docstring_parser.parse_from_object(kind).params]
    assert len(told) > 100
    assert not [part.arg_name for part in told if "\n" in part.description]


def words(text: str) -> str:
    """On one line, without the frame that help is printed in."""
    return " ".join(re.sub("[│╭╮╰╯─]", " ", text).split())


def test_help_names_the_subcommands(jaxgrity):
    done = jaxgrity("--help")
    assert done.code == 0
    assert all(name in done.out for name in SUBCOMMANDS)


@pytest.mark.parametrize(
    ("options", "browser", "says"),
    [((), True, "the page opens in your browser"), ((), False, "no browser opens"), (("--no-browser",), True, "")],
)
def test_the_demo_opens_the_replay_of_a_library_gait(jaxgrity, tmp_path, monkeypatch, options, browser, says):
    """In a browser, unless it is asked not to; without one, it says where the page is."""
    asked, pages = [], []
    monkeypatch.setattr(simulate, "main", lambda chosen: (asked.append(chosen), (tmp_path / "replay.html").touch()))
    monkeypatch.setattr("webbrowser.open", lambda page: (pages.append(page), browser)[1])
    done = jaxgrity("demo", "--out", tmp_path, *options)
    assert (done.code, done.errors) == (0, "")
    assert (asked[0].scene, asked[0].gait, asked[0].out) == ("exact", "straight", tmp_path)
    assert pages == [(tmp_path / "replay.html").as_uri()] * (not options)
    assert says in done.out
    assert (str(tmp_path / "replay.html") in done.out) == (not browser)


def test_no_subcommand_is_bad_input(jaxgrity):
    """As is one that there is not."""
    assert jaxgrity().code == 2
    assert jaxgrity("fly").code == 2


@pytest.mark.parametrize(
    ("program", "command"),
    [
        ("/somewhere/bin/jaxgrity", "jaxgrity search"),
        ("/somewhere/jaxgrity/__main__.py", "jaxgrity search"),
        ("/somewhere/gait_search.py", "python gait_search.py search"),
        ("experiments/gait_search.py", "python experiments/gait_search.py search"),
    ],
)
def test_results_say_the_command_to_repeat(monkeypatch, program, command):
    """Without folders, however the program was called."""
    monkeypatch.setattr(sys, "argv", [program, "search", "--out", "here", "--restart"])
    assert script.command_header()["command"] == command


def test_the_script_calls_the_command():
    """Records of gaits have its path."""
    assert importlib.import_module("gait_search").main is importlib.import_module("jaxgrity.cli.search").main


# search and compare


@pytest.fixture(
    scope="module",
    params=[
        pytest.param("command", marks=pytest.mark.slow),
        pytest.param("script on two devices", marks=pytest.mark.campaign),
    ],
)
def search_run(request, jaxgrity, tmp_path_factory):
    """The main job, quick, on the cheaper scene, and what it said."""
    folder = tmp_path_factory.mktemp("search")
    words = ("--quick", "--scene", "exact", "--out", folder)
    if request.param == "command":
        # a gait that settles soon is measured soon; a search of random ones is a campaign
        words += ("--gait", "straight", "--duration", 8, "--robots", 2, "--polish-rollouts", 96)
        # the longest program of all, of a number that commands on the reference scene show too
        known = Sensitivity(np.array([0.0, 8.0]), np.array([0.0, 5.0]))
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr("jaxgrity.trust.trust_report.sensitivity", lambda *arguments, **how: known)
            # and the longest rollouts: speeds of robots that differ
            patched.setattr("jaxgrity.report.steady.robot_motions", partial(robot_motions, robots=32, duration=15.0))
            # and the longest drawing: 190 frames
            patched.setattr("jaxgrity.report.gait_report.FILMED", 1.0)
            done = jaxgrity("search", *words)
    else:
        script = ROOT / "experiments" / "gait_search.py"
        done = in_its_own_process(script, *words, JAX_NUM_CPU_DEVICES="2")
    assert done.code == 0, done.errors
    return folder, done.out


def test_search_from_end_to_end(search_run):
    """A verified gait, and all that a search leaves; its numbers agree with each other."""
    folder, said = search_run
    assert "verified distance:" in said
    for name in ("convergence", "fidelity", "robust", "path", "members"):
        assert (folder / f"{name}.png").stat().st_size > 5000, name
    for name in ("animation.gif", "index.html"):
        assert (folder / name).stat().st_size > 500, name
    gait, summary = (json.loads((folder / name).read_text()) for name in ("gait.json", "summary.json"))
    assert gait["distance"] > 0.8
    assert gait["error_bar"] < 0.05 * gait["distance"]
    assert gait["steady"]["speed"] > 0.4
    assert gait["robust"]["mean"] == pytest.approx(gait["steady"]["body_lengths_per_second"], rel=0.2)
    assert [len(search["best"]) for search in summary["searches"]] == [3, 2]
    assert np.shape(summary["fidelity"]["rank_correlation"]) == (3, 3)
    assert set(summary["reporting_seconds"]) == {"motion", "animation", "diagnosis", "measuring"}
    assert 0 < max(summary["reporting_seconds"].values()) < summary["stage_seconds"]["reporting"]
    headings = sorted(one["heading"] for one in gait["directions"])
    np.testing.assert_allclose(np.diff(headings), 2 * np.pi / 3, atol=0.02)
    for one in gait["directions"]:
        assert abs(one["distance"] - gait["distance"]) <= one["error_bar"] + gait["error_bar"]
    with np.load(folder / "trajectory.npz") as saved:
        moved = saved["positions"][-1].mean(0) - saved["positions"][0].mean(0)
    assert np.hypot(*moved[:2]) == pytest.approx(gait["distance"], abs=1e-6)
    assert load_gait(folder / "gait.json").phase.tolist() == gait["phase"]


def test_every_stage_of_a_search_shows_how_far_it_is(search_run):
    """Its bar begins with nothing done and ends with everything done."""
    _, said = search_run
    lines = [line for line in re.split("[\r\n]+", said) if line]
    stages = ["evolving", "promoting", "polishing", "verifying", "reporting"]
    seen = [line.split(":")[0] for line in lines if re.match(r"[a-z]+: +[0-9].*\[\d\d:\d\d", line)]
    assert list(dict.fromkeys(seen)) == stages
    for stage, total in (("evolving", 5), ("promoting", 8), ("verifying", 4), ("reporting", 9)):
        shown = [line for line in lines if line.startswith(f"{stage}:")]
        assert f" 0/{total} [" in shown[0]
        assert f" {total}/{total} [" in shown[-1]
        assert shown[-1].startswith(f"{stage}: 100%")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "Expected one of {simulate, demo, search, "),
        (("simulat", "exact"), "command 'simulat': unknown; perhaps you meant simulate; expected one of simulate, "),
        (("sim",), "command 'sim': unknown; perhaps you meant simulate; expected one of simulate, demo, search, "),
        (("serach",), "command 'serach': unknown; perhaps you meant search; expected one of simulate, demo, search, "),
        (("fly",), "command 'fly': unknown; expected one of simulate, demo, search, "),
        (("simulate", "refrence"), "scene 'refrence': unknown; perhaps you meant reference; expected a file"),
        (("simulate", "exact", "--gait", "lastin"), "gait 'lastin': unknown; perhaps you meant lasting; expected"),
        (("simulate", "exact", "--method", "rk5"), "method = 'rk5': unknown; perhaps you meant rk4; expected one of"),
        (("simulate", "exact", "--duration", "soon"), "Error parsing --duration: could not convert string to float"),
        (("simulate", "exact", "--durations", "3"), "Unrecognized options: --durations, 3; perhaps you meant"),
        (("simulate", "exact", "--dtype", "float16"), "Expected one of ('float32', 'float64')"),
        (("explore", "--port", "99999"), "port = 99999: expected a number from 0 to 65535"),
        (("explore", "--host", "not.a.host"), "host = 'not.a.host': expected an address of this machine"),
    ],
)  # fmt: skip
def test_a_wrong_option_is_one_line(jaxgrity, words, said):
    """What is wrong, and what there is, without a box around it."""
    done = jaxgrity(*words)
    assert done.code == 2
    assert done.errors.startswith("error: ")
    assert done.errors.count("\n") == 1
    assert said in done.errors


def test_colours_and_lines_of_a_terminal_are_taken_away():
    """And the advice below the first paragraph, but for the option that is most like the one that was given."""
    red, plain = "\x1b[31m", "\x1b[0m"
    rows = ["Unrecognized options:", "--durations", "─" * 20, "Perhaps you meant:", "    --duration FLOAT", "        s"]
    lines = [f"{red}╭─ Title ─╮{plain}", *(f"{red}│{plain} {row} {red}│{plain}" for row in rows), f"{red}╰─╯{plain}"]
    assert (
        command_line.in_one_line("\n".join(lines))
        == "Unrecognized options: --durations; perhaps you meant --duration FLOAT"
    )


def test_a_step_that_takes_long_is_not_silent(monkeypatch, capsys):
    """The bar is shown again, with the time that has passed, while nothing is heard of the search. One line says that
    this is normal, before XLA prints an alarm."""
    assert progress.TICK <= 5
    assert progress.SLOW < 120
    monkeypatch.setattr(progress, "TICK", 0.01)
    monkeypatch.setattr(progress, "SLOW", 0.0)
    shown, again = [], threading.Event()

    class Watched(progress.tqdm):
        def refresh(self, *arguments, **how):
            shown.append(getattr(self, "desc", ""))
            if shown.count("verifying") >= 4:
                again.set()
            return super().refresh(*arguments, **how)

    monkeypatch.setattr(progress, "tqdm", Watched)
    with progress.Bars() as bars:
        bars.hear(Progress("verifying", 1, 4, {}))
        again.wait()  # for ever, where nothing is shown
    assert capsys.readouterr().out.count(progress.STILL) == 1


def test_a_bar_says_what_is_done_now(capsys):
    """Also where steps are uneven: a bar that counts alone would stand still without a reason."""
    with progress.Bars() as bars:
        bars.hear(Progress("promoting", 3, 8, {"level": "finalists"}))
        bars.bar.refresh()
    assert re.search(r"promoting: +38%\|.*\| 3/8 \[00:00, level=finalists\]", capsys.readouterr().out)


def test_searches_are_compared(jaxgrity, search_run, tmp_path):
    """A search beside itself differs in no setting."""
    folder, _ = search_run
    done = jaxgrity("compare", folder, folder, "--out", tmp_path)
    assert done.code == 0, done.errors
    assert (tmp_path / "comparison.png").stat().st_size > 5000
    head, one = done.out.splitlines()[1:3]  # after the first word, that JAX is being loaded
    assert head.split()[:2] == ["run", "steady,"]
    assert one.startswith(str(folder))


@pytest.mark.parametrize("order", [1, -1])
def test_searches_with_other_settings_are_compared(order, jaxgrity, search_run, tmp_path):
    """An earlier version had no setting for the ramp: its cell says so, whichever run comes first."""
    folder, _ = search_run
    summary = json.loads((folder / "summary.json").read_text())
    del summary["settings"]["ramp"]
    (tmp_path / "earlier").mkdir()
    (tmp_path / "earlier" / "summary.json").write_text(json.dumps(summary))
    done = jaxgrity("compare", *[folder, tmp_path / "earlier"][::order], "--out", tmp_path)
    assert done.code == 0, done.errors
    head, *rows = done.out.splitlines()[1:4]
    assert head.split()[:2] == ["run", "ramp"]
    assert [row.split()[1] for row in rows] == ["0.75", "-"][::order]


def test_a_search_whose_robots_all_failed_is_compared_too(jaxgrity, search_run, tmp_path):
    """JSON has no number for their mean: the table says that it is not known, and the figure leaves it out."""
    folder, _ = search_run
    summary = json.loads((folder / "summary.json").read_text())
    for name in ("robust", "other_contact_model"):
        summary[name] |= {"mean": None, "standard_deviation": None, "standard_error": None}
    summary |= {"steady": None, "error_bar": None}
    (tmp_path / "failed").mkdir()
    (tmp_path / "failed" / "summary.json").write_text(json.dumps(summary))
    done = jaxgrity("compare", folder, tmp_path / "failed", "--out", tmp_path)
    assert done.code == 0, done.errors
    assert done.out.splitlines()[3].count("not known") == 3

"""The scripts as a user runs them: what they leave, and one clear line with exit code 2 on bad input."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import gait_search
import numpy as np
import pytest
import simulate
import tyro

from jaxgrity import InputError, load_gait, random_phases

ROOT = Path(__file__).parents[1]
SCENE = ROOT / "experiments" / "scenes" / "reference.toml"
EXACT = SCENE.with_name("exact.toml")
ANSWERS = json.loads((Path(__file__).parent / "data" / "reference_answers.json").read_text())


def run(script: str, *arguments: object, **environment: str) -> subprocess.CompletedProcess:
    command = [sys.executable, str(ROOT / "experiments" / script), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=280, env=os.environ | environment)


def write_gaits(path: Path, phases: np.ndarray) -> Path:
    np.savetxt(path, phases, delimiter=",", fmt="%.17g")
    return path


def test_simulate_agrees_with_an_independent_program(tmp_path):
    """16 gaits from a CSV, as in the README: every component of every centre of mass within 1e-7 m."""
    gaits = write_gaits(tmp_path / "gaits.csv", np.array([row["phase"] for row in ANSWERS["gaits"]]))
    done = run("simulate.py", SCENE, "--gaits", gaits, "--duration", 2, "--dt", 5e-4, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["method"], summary["dt"], summary["dtype"], summary["duration"]) == ("rk4", 5e-4, "float64", 2.0)
    assert summary["steps"] == 4000
    assert len(summary["error_bar"]) == 16
    assert max(summary["error_bar"]) < 0.01
    assert summary["diagnosis_of_furthest"]["error_bar"] == pytest.approx(
        summary["error_bar"][int(np.argmax(summary["distance"]))], rel=0.2, abs=1e-9
    )
    assert summary["failed"] == []
    assert summary["wall_seconds"] > 0
    assert summary["compile_seconds"] > 0
    expected = [row["com_end"] for row in ANSWERS["gaits"]]
    np.testing.assert_allclose(summary["com_end"], expected, rtol=0, atol=1e-7)
    assert (tmp_path / "out" / "outcomes.png").stat().st_size > 5000


def test_simulate_one_rollout(tmp_path):
    """One rollout leaves its trajectory and its figures; what the scene file chose is in the summary."""
    done = run("simulate.py", SCENE, "--duration", 1.5, "--method", "tsit5", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "smooth friction" in done.stdout
    summary = json.loads((tmp_path / "summary.json").read_text())
    with np.load(tmp_path / "trajectory.npz") as saved:
        assert saved["positions"].shape == (151, 12, 3)
        assert saved["velocities"].shape == (151, 12, 3)
        np.testing.assert_allclose(saved["positions"][-1].mean(0), summary["com_end"][0], atol=1e-12)
    assert summary["dt"] is None
    assert summary["diagnosis"]["error_bar"] < 1e-6
    assert "energy residual" in done.stdout
    assert (tmp_path / "path.png").exists()
    assert (tmp_path / "members.png").exists()


def test_simulate_reports_a_failure_as_data(tmp_path):
    """A gait that no step can follow ends in the summary's list of failures, with exit code 0."""
    text = SCENE.read_text().replace("stiffness = 2e4", "stiffness = 1e10").replace("damping = 36.0", "")
    (tmp_path / "scene.toml").write_text(text.replace("start = 1.0", "start = 0.0"))
    gaits = write_gaits(tmp_path / "gaits.csv", random_phases(2, 6, seed=0))
    done = run(
        "simulate.py", tmp_path / "scene.toml", "--gaits", gaits, "--duration", 0.05, "--method", "rk4",
        "--dt", 1e-3, "--any-step", "--out", tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["failed"] == [0, 1]
    assert summary["distance"] == [None, None]
    assert summary["outcome"][0] == "the motion is not finite, or misses its constraints"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["missing.toml"], ["missing.toml", "No such file"]),
        ([SCENE, "--method", "euler"], ["euler", "rk4, tsit5"]),
        ([SCENE, "--duration", "-1"], ["duration = -1", "positive"]),
        ([SCENE, "--dt", "0.02"], ["dt = 0.02", "largest stable step", "0.00136"]),
        ([SCENE, "--method", "symplectic"], ["symplectic", "dissipation"]),
        ([SCENE, "--gaits", "short.csv"], ["short.csv", "row 2 has 5 phases; expected 6"]),
        (["stiff.toml"], ["stiff.toml", "struts.stiffness", "-1"]),
    ],
)
def test_bad_input_is_one_line(tmp_path, monkeypatch, arguments, words):
    """What, where, the value received, what was expected; nothing is written."""
    monkeypatch.chdir(tmp_path)
    Path("short.csv").write_text("0,1,2,3,4,5\n0,1,2,3,4\n")
    Path("stiff.toml").write_text(SCENE.read_text().replace("stiffness = 2e4", "stiffness = -1.0"))
    with pytest.raises((InputError, OSError)) as refusal:
        simulate.main(tyro.cli(simulate.Settings, args=[*map(str, arguments), "--out", "out"]))
    said = str(refusal.value)
    assert "\n" not in said
    assert all(word in said for word in words), said
    assert not Path("out").exists()


def test_a_refusal_ends_with_exit_code_2(tmp_path):
    """And its one line is all that is said."""
    done = run("simulate.py", SCENE, "--dt", "0.02", "--out", tmp_path / "out")
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("error: dt = 0.02")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("setting", "said"),
    [("resume", "interrupted; the same command with --resume goes on from what was saved"), ("quick", "interrupted")],
)
def test_an_interruption_is_one_line(setting, said):
    """Ctrl-C ends with exit code 130, and says how to go on where one can."""
    code = (
        "from dataclasses import dataclass; from common import run\n"
        f"@dataclass\nclass S:\n    {setting}: bool = False\n"
        "def main(settings): raise KeyboardInterrupt\nrun(main, S)"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=ROOT / "experiments")
    assert done.returncode == 130
    assert done.stderr.strip() == said


SCRIPTS = sorted(path.name for path in (ROOT / "experiments").glob("*.py") if "\n    run(main" in path.read_text())


@pytest.mark.parametrize("script", SCRIPTS)
def test_help_comes_from_the_settings(script, capsys):
    """Every script explains itself, and has a --quick size."""
    module = importlib.import_module(script.removesuffix(".py"))
    with pytest.raises(SystemExit, match="0"):
        tyro.cli(module.Settings, args=["--help"], description=module.__doc__)
    assert "--quick" in capsys.readouterr().out


@pytest.fixture(scope="module")
def search_run(tmp_path_factory):
    """The main job, quick, on the cheaper scene and on two devices, and what it said."""
    folder = tmp_path_factory.mktemp("search")
    done = run("gait_search.py", "--quick", "--scene", EXACT, "--out", folder, JAX_NUM_CPU_DEVICES="2")
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


def test_gait_search_from_end_to_end(search_run):
    """A verified gait, and all that a search leaves; its numbers agree with each other."""
    folder, said = search_run
    assert "verified distance:" in said
    for name in ("convergence", "ladder", "robust", "path", "members"):
        assert (folder / f"{name}.png").stat().st_size > 5000, name
    for name in ("animation.gif", "index.html"):
        assert (folder / name).stat().st_size > 500, name
    gait, summary = (json.loads((folder / name).read_text()) for name in ("gait.json", "summary.json"))
    assert gait["distance"] > 0.8
    assert gait["error_bar"] < 0.05 * gait["distance"]
    assert gait["robust"]["mean"] == pytest.approx(gait["distance"], rel=0.2)
    assert len(summary["searches"][0]["best"]) == 3
    assert np.shape(summary["ladder"]["rank_correlation"]) == (3, 3)
    headings = sorted(one["heading"] for one in gait["directions"])
    np.testing.assert_allclose(np.diff(headings), 2 * np.pi / 3, atol=0.02)
    for one in gait["directions"]:
        assert abs(one["distance"] - gait["distance"]) <= one["error_bar"] + gait["error_bar"]
    with np.load(folder / "trajectory.npz") as saved:
        moved = saved["positions"][-1].mean(0) - saved["positions"][0].mean(0)
    assert np.hypot(*moved[:2]) == pytest.approx(gait["distance"], abs=1e-6)
    assert load_gait(folder / "gait.json").phase.tolist() == gait["phase"]


def test_runs_compare(search_run, tmp_path):
    """A run beside itself differs in no setting; what is no run is refused in one line."""
    folder, _ = search_run
    done = run("compare_gaits.py", folder, folder, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "comparison.png").stat().st_size > 5000
    bad = run("compare_gaits.py", tmp_path, "--out", tmp_path / "out")
    assert bad.returncode == 2
    assert "summary.json" in bad.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--dt", "0.1"], "largest stable step"),
        (["--dt", "nan"], "dt = nan"),
        (["--population", "1"], "population = 1: expected at least 2 gaits"),
        (["--polish-gaits", "17"], "polish_gaits = 17: expected 1 to 16"),
        (["--polish-rollouts", "3"], "3 rollouts of polish: expected 448 or more, for 4 climbs"),
    ],
)
def test_gait_search_refuses_before_it_searches(tmp_path, arguments, said):
    """What a later stage could not do: no folder is left that would have to be restarted."""
    with pytest.raises(InputError, match=said):
        gait_search.main(tyro.cli(gait_search.Settings, args=[*arguments, "--out", str(tmp_path / "out")]))
    assert not (tmp_path / "out").exists()


def test_gait_search_needs_a_gait(tmp_path):
    """A scene without [gait] has nothing to evolve."""
    (tmp_path / "still.toml").write_text(SCENE.read_text().split("[gait]")[0])
    done = run("gait_search.py", "--scene", tmp_path / "still.toml", "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "has no [gait]" in done.stderr

"""`jaxgrity validate`: what it says and leaves, for a recording made by another robot than the scene's."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxgrity import Gait, InputError, SolverOptions, load_scene, simulate, with_gait
from jaxgrity.cli import validate
from jaxgrity.cli.settings import ValidateSettings
from jaxgrity.identification import Parameter, changed
from jaxgrity.model.actuation import contraction

SCENE = """
[structure]
kind = "custom"
nodes = [[0, 0, 0], [0, 0, -1.1962]]
cables = [[0, 1]]
node_mass = [0.0, 2.0]
fixed = [0, { node = 1, axes = "xy" }]

[cables]
stiffness = 100.0
rest_length = 1.0
damping = 2.0

[gravity]
g = 9.81
"""
UNKNOWN = [Parameter("structure.cables.stiffness", 0.3), Parameter("structure.cables.damping", 0.5)]
OPTIONS = SolverOptions("rk4", dt=0.01)
NOISE = 1e-3


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    """A folder with the scene, and a recording of a robot with a stiffer cable, pulled by a motor; with gaps."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "hanging.toml").write_text(SCENE)
    scene = load_scene(folder / "hanging.toml")
    truth = changed(scene, UNKNOWN, np.log([1.2, 0.7]) / [0.3, 0.5])
    low = np.array([[0.0, 0, 0], [0, 0, -1 - 2 * 9.81 / 120]])
    gait = Gait((0,), [-np.pi / 2], [0.2], [0.9], start=0.2, ramp=0.2)
    moved = simulate(with_gait(truth, gait), 3.0, options=OPTIONS, frame_rate=50.0, positions=low)
    random = np.random.default_rng(1)
    seen = np.asarray(moved.positions)[:, 1] + random.normal(0, NOISE, (151, 3))
    asked = [float(contraction(gait, t)[0]) for t in np.asarray(moved.times)]
    hidden = random.uniform(size=151) < 0.1
    hidden[[0, 75]] = False
    cells = [["" if gone else f"{x:.6f}" for x in row] for gone, row in zip(hidden, seen)]
    rows = [f"{t:.4f},{','.join(cell)},{c:.6f}" for t, cell, c in zip(np.asarray(moved.times), cells, asked)]
    (folder / "run.csv").write_text("\n".join(["t,x1,y1,z1,contraction 0", *rows]))
    return folder


def settings(folder: Path, out: Path, **how) -> ValidateSettings:
    chosen = ValidateSettings(str(folder / "hanging.toml"), (folder / "run.csv",), method="rk4", dt=0.01, out=out)
    return replace(chosen, **how)


@pytest.mark.campaign
def test_parameters_are_fitted_to_one_half_and_tested_on_the_other(recorded, tmp_path, capsys):
    """The fitted robot is closer to the half held out, and its intervals contain the truth."""
    words = ("structure.cables.stiffness", "structure.cables.damping=0.5")
    validate.main(settings(recorded, tmp_path, identify=words, noise=NOISE))
    said = capsys.readouterr().out
    summary = json.loads((tmp_path / "summary.json").read_text())
    fitted, held_out = summary["parts"]
    assert [each["recording"] for each in (fitted, held_out)] == ["run.csv, fitted", "run.csv, held out"]
    assert (fitted["seconds"], held_out["seconds"]) == pytest.approx((1.5, 1.5))
    for part in (fitted, held_out):
        assert part["identified"]["error"] < 0.4 * part["simulated"]["error"]
        assert part["not_moved"] > 0.05
        assert part["identified"]["close_for"] == part["seconds"]
    for estimate, true in zip(summary["identified"]["estimates"], (1.2, 0.7)):
        assert estimate["interval"][0] < true < estimate["interval"][1]
    assert summary["identified"]["estimates"][0]["standard_error"] < 0.02
    assert 0.8 < summary["identified"]["misfit"] < 1.2
    (sentence,) = [line for line in said.splitlines() if line.startswith("run.csv, held out: ")]
    assert sentence.startswith("run.csv, held out: over 1.5 s the simulated nodes are 0.0")
    assert "after identification. If the robot had not moved, they would be 0." in sentence
    assert sentence.endswith("stays within 10% of a body length for all of the time.")
    assert f"structure.cables.stiffness: {summary['identified']['estimates'][0]['value']:.4g} ± " in said
    assert (tmp_path / "recorded.png").stat().st_size > 5000


@pytest.mark.campaign
def test_without_parameters_recordings_are_compared_as_a_whole(recorded, tmp_path, capsys):
    """The scene as it is; quick looks at the first two seconds. A gait of the scene is not needed."""
    validate.main(settings(recorded, tmp_path, quick=True))
    summary = json.loads((tmp_path / "summary.json").read_text())
    (part,) = summary["parts"]
    assert part["seconds"] == pytest.approx(2.0)
    assert 0.005 < part["simulated"]["error"] < part["not_moved"]
    assert "identified" not in summary
    assert "run.csv: over 2 s the simulated nodes are 0.0" in capsys.readouterr().out


def test_of_several_recordings_the_last_is_held_out(recorded, tmp_path):
    """Under their names, or where these are alike with their folders; one alone is cut where its node is seen."""
    (tmp_path / "run.csv").write_text((recorded / "run.csv").read_text())
    scene = load_scene(recorded / "hanging.toml")
    both = (recorded / "run.csv", tmp_path / "run.csv")
    parts, fitted = validate.recorded_parts(scene, settings(recorded, tmp_path, data=both, identify=("gravity",)))
    assert (list(parts), fitted) == ([*map(str, both)], [str(both[0])])
    parts, fitted = validate.recorded_parts(scene, settings(recorded, tmp_path, identify=("gravity",)))
    assert fitted == ["run.csv, fitted"]
    first, last = parts.values()
    assert first.times[-1] == last.times[0] == 1.5
    assert np.isfinite(last.positions[0, 1]).all()


def test_a_quick_part_has_enough_rows(tmp_path):
    """Where a robot was seen more seldom than each second."""
    (tmp_path / "hanging.toml").write_text(SCENE)
    (tmp_path / "run.csv").write_text("t,x1,y1,z1\n" + "".join(f"{3 * k},0,0,-1.2\n" for k in range(4)))
    scene = load_scene(tmp_path / "hanging.toml")
    with pytest.raises(InputError, match=r"run.csv: rows in the first 2 s: 1; expected 3 or more, or no --quick"):
        validate.recorded_parts(scene, settings(tmp_path, tmp_path, quick=True))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"identify": ("gravity=much",)}, "--identify gravity=much: expected a name, or a name with its spread"),
        ({"identify": ("structure.cables.colour",)}, "the scene has no such numbers"),
        ({"identify": ("gravity",), "noise": 0.0}, "noise = 0 m: expected"),
        ({"data": ()}, "--data: names no recording; expected at least one file"),
        ({"data": (Path("missing.csv"),)}, "missing.csv: cannot be read: No such file"),
        ({"dt": 10.0}, "largest stable step"),
    ],
)
def test_what_cannot_be_compared_is_refused_before_anything_is_written(recorded, tmp_path, changes, words):
    """In one line."""
    with pytest.raises(InputError, match=words) as refusal:
        validate.main(settings(recorded, tmp_path / "out", **changes))
    assert "\n" not in str(refusal.value)
    assert not (tmp_path / "out").exists()


def test_a_sentence_says_where_a_simulation_fails():
    """And for how long it stayed close until then."""
    row = {
        "recording": "run.csv",
        "seconds": 2.0,
        "not_moved": 0.5,
        validate.BEFORE: {"error": np.inf, "close_for": 0.7},
    }
    said = validate.sentence(row, 1.0)
    assert "the simulated nodes are nowhere, since the simulation failed (take a smaller --dt)." in said
    assert said.endswith("within 10% of a body length for the first 0.7 s.")


@pytest.mark.campaign
def test_a_published_robot_beside_a_file_in_another_unit(tmp_path, capsys):
    """Three bars, by the ends of its rods as JSON in decimetres: cables 20 % stiffer than the scene's are found."""
    scene = load_scene("three-bar")
    stiff = Parameter("structure.cables.stiffness", 0.3)
    moved = simulate(changed(scene, [stiff], np.log([1.2]) / 0.3), 2.6, frame_rate=50.0)
    seen = 10 * (np.asarray(moved.positions) + np.random.default_rng(0).normal(0, 1e-4, moved.positions.shape))
    names = [f"rod_{rod}_end_pt{end}" for rod in ("01", "23", "45") for end in "12"]
    frames = [
        {"time": float(t)} | dict(zip(names, places.tolist())) for t, places in zip(np.asarray(moved.times), seen)
    ]
    (tmp_path / "processed_data.json").write_text(json.dumps(frames[50:]))
    how = {"unit": 0.1, "noise": 1e-4, "identify": ("structure.cables.stiffness=0.3",), "quick": True}
    validate.main(ValidateSettings("three-bar", (tmp_path / "processed_data.json",), out=tmp_path, **how))
    assert "after identification" in capsys.readouterr().out
    found = json.loads((tmp_path / "summary.json").read_text())
    assert 1.17 < found["identified"]["estimates"][0]["value"] < 1.23
    for part in found["parts"]:
        assert part["identified"]["error"] < 0.5 * part["simulated"]["error"]

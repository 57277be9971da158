"""A real robot beside its simulation: the measured spine, and the tables made of its logs."""

import shutil

import jax
import numpy as np
import pytest
from measurements import spine_dynamics, spine_tables
from measurements.spine_robot import FOLDER, commanded, load_spine, pose, resting_shapes, rms

from jaxgrity import InputError
from jaxgrity.statics import resting_shape


@pytest.fixture(scope="module")
def spine():
    """Four commands of it: two going down, two going up."""
    whole = load_spine()
    some = np.array([1, 2, 80, 81])
    return whole._replace(
        retraction=whole.retraction[some],
        expected=whole.expected[some],
        seen=whole.seen[:, some],
        middle=whole.middle[:, some],
    )


def test_the_table_has_every_pose(spine):
    """118 of nine runs; two of them without a frame in time."""
    whole = load_spine()
    assert whole.seen.shape == (9, 118, 3)
    assert np.isnan(whole.seen).any(2).sum() == 2


def test_statics_gives_the_poses_of_the_authors_and_of_the_camera(spine):
    """The authors' to 10 micrometres and 1e-3 degrees, the camera's within what was seen; nothing is fitted."""
    shapes = resting_shapes(spine)
    poses = np.asarray(jax.vmap(pose)(shapes))
    error = np.abs(poses - spine.expected)
    assert error[:, :2].max() < 10e-6
    assert np.rad2deg(error[:, 2]).max() < 1e-3
    assert (rms(spine.seen - poses, axis=(0, 1)) < [1.5e-3, 3.5e-3, np.deg2rad(1.7)]).all()
    # stiff springs in place of rigid struts, by another way
    again = resting_shape(commanded(spine.scene, spine.retraction[2]), spine.scene.structure.nodes).q
    np.testing.assert_allclose(again, shapes[2], atol=2e-6)


def test_tables_are_made_of_logs(tmp_path):
    """Settled poses, their scatter, and the progress of a motion, of logs of two motions with a known answer."""
    times = [0, 2000, 4000, 6000]
    frames = range(-500, 8000, 250)
    at = {k: 1.0 + 0.1 * max(0, min(3, (k + 1000) // 2000)) for k in frames}  # each moves a second before its command
    head = "logger\nnames\n"
    (tmp_path / "commands_a.csv").write_text(head + "".join(f"{t},0,0,0,0,0,0\n" for t in times))
    (tmp_path / "camera_a.csv").write_text(head + "".join(f"{t},{100 * x},50,90\n" for t, x in at.items()))
    row = "1,2,3,4,0,0,0,0.5,0.25,0.125\n"
    (tmp_path / "inputs.csv").write_text("\n" * 5 + row * 4)
    spine_tables.main(spine_tables.Settings(logs=tmp_path, out=tmp_path / "out"))
    commands = (tmp_path / "out" / "commands.csv").read_text().splitlines()
    assert commands[1] == "0,0.010000,0.020000,0.030000,0.040000,0.5,0.25,0.125"
    poses = [line.split(",") for line in (tmp_path / "out" / "poses.csv").read_text().splitlines()[1:]]
    assert [pose[:5] for pose in poses] == [["a", str(k), "3", f"{1.1 + 0.1 * k:.6f}", "0.500000"] for k in range(3)]
    assert all(pose[6] == "0.000000" for pose in poses)
    response = np.genfromtxt(tmp_path / "out" / "response.csv", delimiter=",", names=True)
    assert response["progress"][response["time"] < -0.99].size == 0


def test_the_response_of_a_mode_is_that_of_the_closed_form():
    """To a step, 1 - (1 + w t) exp(-w t) at critical damping, and 1 - cos(w t) without damping."""
    times, w = np.linspace(0.0, 1.0, 50), 2 * np.pi * 2.0
    step = np.array([0.0, 0.0, 0.0])
    critical = spine_dynamics.response(times, 2.0, 1.0, step)
    np.testing.assert_allclose(critical, 1 - (1 + w * times) * np.exp(-w * times), atol=0.02)
    np.testing.assert_allclose(spine_dynamics.response(times, 2.0, 0.0, step), 1 - np.cos(w * times), atol=0.05)


def test_a_response_that_rings_tells_its_damping():
    """Of a slow mode, clocks without scatter, and motors that are done at once: the least squares are at the truth."""
    times = np.linspace(-1, 1, 41)
    seen = {"time": times, "standard_error": np.full(41, 0.01)}
    seen["progress"] = spine_dynamics.response(times, 2.0, 0.1, np.array([-0.5, 0.1, 0.02]))
    squares = [spine_dynamics.fitted(seen, 2.0, ratio)["squares"] for ratio in (0.03, 0.1, 0.3)]
    assert squares[1] < 4 < min(squares[0], squares[2])


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda folder: (folder / "poses.csv").unlink(), "poses.csv: cannot be read"),
        (lambda folder: (folder / "poses.csv").write_text("run,x\na,1\n"), "no column 'z'"),
    ],
    ids=["missing", "without a column"],
)
def test_bad_tables_are_refused(tmp_path, spoil, words):
    """In one line."""
    shutil.copytree(FOLDER, tmp_path / "spine")
    spoil(tmp_path / "spine")
    with pytest.raises(InputError, match=words) as refusal:
        load_spine(tmp_path / "spine")
    assert "\n" not in str(refusal.value)

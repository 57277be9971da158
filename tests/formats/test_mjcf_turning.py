"""MuJoCo models whose gravity leans, or whose plane falls along any direction: they move as there, turned upright."""

import numpy as np
import pytest
from formats.test_mjcf_springs import POINT, PULLING, ends, found, model, moved

from jaxgrity import InputError, SolverOptions, load_scene, save_scene

pytest.importorskip("mujoco")

TENDONS = [("w a0", PULLING), ("v a0", PULLING), ("u b0", PULLING), ("a0 b0", PULLING)]
PLANE = '<worldbody><geom name="floor" type="plane" size="9 9 1" pos="0 0 -3" {}/>'


def leaning(gravity, plane=""):
    """Two points on cables, under a gravity along any direction."""
    text = model(POINT, TENDONS).replace("integrator='RK4'", f"integrator='RK4' gravity='{gravity}'")
    return text.replace("<worldbody>", plane or "<worldbody>")


@pytest.mark.parametrize("gravity", ["2 -3 -8", "0 0 9.81", "-4 0 0"])
def test_points_fly_as_in_mujoco_under_gravity_that_leans(gravity, tmp_path):
    """0.5 s, within 1e-6 m after the turn that takes the start there to the start here."""
    text = leaning(gravity)
    scene, notes = found(tmp_path, text)
    start, end, _ = moved(text, 5000)
    nodes = np.asarray(scene.structure.nodes)
    assert scene.gravity == pytest.approx(np.linalg.norm(np.array(gravity.split(), float)))
    assert scene.up is None
    # the same turn takes all sites to their nodes
    sites = [k for k in range(len(start)) if not np.allclose(start[k], [-1, -2, 0])]  # at which no tendon ends
    nearest = np.abs(np.linalg.norm(nodes, axis=1) - np.linalg.norm(start[sites], axis=1)[:, None]).argmin(1)
    assert sorted(nearest.tolist()) == list(range(len(nodes)))
    turn = np.linalg.lstsq(start[sites], nodes[nearest], rcond=None)[0]
    np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1)
    np.testing.assert_allclose(np.array(gravity.split(), float) @ turn, [0, 0, -scene.gravity], atol=1e-12)
    assert np.abs(end - start).max() > 0.1
    ours = ends(scene, SolverOptions(method="dopri8"))[nearest]
    assert np.abs(ours - end[sites] @ turn).max() < 1e-6
    assert "the robot is turned: gravity is along -z here" in notes
    save_scene(scene, tmp_path / "robot.toml")
    np.testing.assert_array_equal(load_scene(tmp_path / "robot.toml").structure.nodes, nodes)


@pytest.mark.parametrize(
    ("gravity", "axis"), [("0 0 -9.81", (0.3, 0.4, 1)), ("0 -3 -9", (0, 0, 1)), ("1 2 -9", (-0.2, 0.1, 1))]
)
def test_a_plane_falls_as_gravity_has_it(gravity, axis, tmp_path):
    """The incline is the angle between both; nodes keep their heights above the plane, less the radius of 1 cm."""
    plane = PLANE.format('zaxis="{} {} {}"'.format(*axis))
    text = leaning(gravity, plane).replace('contype="0" conaffinity="0"', "")
    scene, notes = found(tmp_path, text)
    g, n = np.array(gravity.split(), float), np.array(axis, float) / np.linalg.norm(axis)
    angle = np.arccos(-g @ n / np.linalg.norm(g))
    assert scene.ground.incline == pytest.approx(angle)
    places = {"w": (0, 0, 3), "v": (2, 0, 0), "u": (-1, 2, 0), "a0": (0.1, 0.2, 0.3), "b0": (0.4, -0.5, 0.1)}
    there = sorted(np.add([*places.values()], [0, 0, 3]) @ n - 0.01)
    np.testing.assert_allclose(sorted(np.asarray(scene.structure.nodes) @ scene.ground.normal), there, atol=1e-9)
    assert any(note.startswith("robot and plane are turned: gravity is along -z here") for note in notes)


def test_gravity_away_from_the_plane_and_slides_are_refused(tmp_path):
    """With the line of the plane; a node that slides along some axes would slide along others."""
    plane = PLANE.format("")
    with pytest.raises(InputError, match=r"line 1: the plane's normal is .*, z against gravity; expected z > 0"):
        found(tmp_path, leaning("0 0 3", plane).replace('contype="0" conaffinity="0"', ""))
    held = leaning("1 0 -9").replace('<joint type="slide" axis="0 0 1"/>', "", 1)
    with pytest.raises(InputError, match=r"line 1: gravity is along -z only after a turn, but node \d slides along"):
        found(tmp_path, held)

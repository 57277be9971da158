"""The tables of rigid bodies in scene files: read, written, refused; files that cannot hold them."""

import numpy as np
import pytest

from jaxgrity import InputError, load_scene, parse_scene, save_scene
from jaxgrity.formats import save_matlab, save_tables
from jaxgrity.model import body_moments

TEXT = """
[structure]
kind = "custom"
nodes = [[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5], [0.5, 0.5, 0.5], [1, 1, 1], [1, 0, 1]]
fixed = [4]
cables = [[5, 6]]
pose = "face"
height = 0.3
[cables]
stiffness = 100.0
rest_length = 0.9
[[bodies]]
nodes = [0, 1, 2, 3, 4, 5]
mass = 2.0
inertia = [0.3, 0.4, 0.5]
centre = [0.1, 0.2, 0.3]
[[bodies]]
nodes = [5, 6]
mass = 1.0
inertia = [0.1, 0.0, 0.1, 0.0, 0.0, 0.0]
"""


def test_bodies_are_read_as_the_nodes_of_the_file_stand(tmp_path):
    """However they are posed; joints and supports are basic; and they are written as the same bodies."""
    scene = parse_scene(TEXT)
    first, second = scene.structure.bodies
    assert {4, 5} <= set(first.basic)
    assert set(second.basic) == {5, 6}
    nodes = np.array([[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5], [0.5, 0.5, 0.5], [1, 1, 1], [1, 0, 1.0]])
    mass, centre, inertia = body_moments(first, nodes)
    assert mass == pytest.approx(2, rel=1e-12)
    np.testing.assert_allclose(centre, [0.1, 0.2, 0.3], atol=1e-12)
    np.testing.assert_allclose(inertia, np.diag([0.3, 0.4, 0.5]), atol=1e-12)
    save_scene(scene, tmp_path / "robot.toml")
    again = load_scene(tmp_path / "robot.toml").structure
    np.testing.assert_array_equal(again.nodes, scene.structure.nodes)
    for body, same in zip(scene.structure.bodies, again.bodies):
        assert body.points == same.points
        np.testing.assert_allclose(same.matrix, body.matrix, atol=1e-12)
        np.testing.assert_allclose(same.weights, body.weights, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("inertia = [0.3, 0.4, 0.5]", "inertia = [0.3, 0.4, 0.8]", r"bodies\[0\]: no body has this inertia"),
        (
            "nodes = [5, 6]\nmass",
            "nodes = [5, 9]\nmass",
            r"bodies\[1\]: points\[1\] = 9: expected a whole number from 0 to 6",
        ),
        ("mass = 1.0", "mass = 0.0", r"bodies\[1\].mass = 0.0: expected a number > 0"),
        ("[0.1, 0.0, 0.1, 0.0", "[0.1, 0.0", r"bodies\[1\].inertia has 4 numbers; expected xx, yy, zz"),
        ("mass = 1.0", "weight = 1.0", r"bodies\[1\].weight = 1.0: unknown key"),
    ],
)
def test_bad_tables_are_refused(old, new, words):
    """With their number."""
    assert old in TEXT
    with pytest.raises(InputError, match=words):
        parse_scene(TEXT.replace(old, new))


@pytest.mark.parametrize("save", [save_matlab, save_tables])
def test_files_without_bodies_refuse_them(save, tmp_path):
    """Rather than lose them."""
    with pytest.raises(InputError, match="hold no rigid bodies, and this has 2"):
        save(parse_scene(TEXT), tmp_path / "robot")

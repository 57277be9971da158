"""The ground of scene files: surfaces, obstacles, pictures, and what is refused."""

import numpy as np
import pytest
from PIL import Image

from jaxgrity import InputError, load_scene, parse_scene, scene_text
from jaxgrity.io.files import read_picture


def with_ground(line, scene="reference"):
    return scene_text(scene).replace("[friction]", f"{line}\n[friction]")


@pytest.mark.parametrize(
    ("line", "heights"),
    [
        ('surface = { kind = "stairs", rise = 0.1, run = 0.3, steps = 2, start = 0.5 }', [0.0, 0.1, 0.2]),
        ('surface = { kind = "bowl", radius = 2.0 }', [0.0, 2 - np.sqrt(4 - 0.36), 2 - np.sqrt(4 - 0.81)]),
        ('obstacles = [{ kind = "box", centre = [0.6, 0, 0], size = [0.2, 1, 0.4] }]', [0.0, 0.2, 0.0]),
        (
            'obstacles = [{ kind = "box", centre = [0.6, 0, 0], size = [0.2, 0.4, 1], turn = [1.5707963268, 0, 0] }]',
            [0.0, 0.2, 0.0],
        ),
        ('surface = { kind = "box", centre = [0.5, 0, 0], size = [2, 2, 0.2] }', [0.1, 0.1, 0.1]),
        ('obstacles = [{ kind = "sphere", centre = [0.9, 0, 0], radius = 0.1 }]', [0.0, 0.0, 0.1]),
        (
            'obstacles = [{ kind = "cylinder", start = [0.6, -1, 0], end = [0.6, 1, 0], radius = 0.1 }]',
            [0.0, 0.1, 0.0],
        ),
    ],
)
def test_ground_is_as_high_as_the_file_says(line, heights):
    """At x = 0, 0.6 and 0.9; and the structure stands 2 cm above it."""
    scene = parse_scene(with_ground(line))
    np.testing.assert_allclose(scene.ground.height(np.array([0.0, 0.6, 0.9]), np.zeros(3)), heights, atol=1e-6)
    nodes = scene.structure.nodes
    above = nodes[:, 2] - scene.ground.height(nodes[:, 0], nodes[:, 1])
    np.testing.assert_allclose(above.min(), 0.02, atol=1e-9)


def test_a_picture_may_have_numbers_of_its_own(tmp_path):
    """From 0 to 1, as they are; others are refused."""
    heights = np.linspace(0, 1, 30).reshape(5, 6).astype(np.float32)
    Image.fromarray(heights).save(tmp_path / "hills.tif")
    np.testing.assert_allclose(read_picture(tmp_path / "hills.tif"), heights, atol=1e-7)
    for wrong in (heights * 300, heights - 0.5, np.full((5, 6), np.nan, np.float32)):
        Image.fromarray(wrong.astype(np.float32)).save(tmp_path / "hills.tif")
        with pytest.raises(InputError, match=r"hills.tif: brightness from .*; expected numbers from 0, black, to 1"):
            read_picture(tmp_path / "hills.tif")


def test_a_picture_is_ground_as_seen_from_above(tmp_path):
    """White is highest, the upper edge is the largest y, and the path is that from the scene file."""
    bright = np.zeros((9, 9), np.uint8)
    bright[0, :] = bright[:, -1] = 255
    Image.fromarray(bright).save(tmp_path / "hills.png")
    line = 'surface = { kind = "heights", size = [4, 2], image = "hills.png", highest = 0.3 }'
    (tmp_path / "scene.toml").write_text(with_ground(line), encoding="utf-8")
    ground = load_scene(tmp_path / "scene.toml").ground
    corners = ground.height(np.array([-2.0, 2.0, -2.0, 2.0]), np.array([-1.0, -1.0, 1.0, 1.0]))
    np.testing.assert_allclose(corners, [0.0, 0.3, 0.3, 0.3], atol=1e-12)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (
            'surface = { kind = "sand" }',
            "kind = 'sand': expected 'bumps', 'stairs', 'bowl', 'heights', 'waves', 'spline', 'box', ",
        ),
        ('surface = { kind = "bowl", radius = 0 }', "ground.surface.radius = 0: expected a number > 0"),
        (
            'surface = { kind = "bowl", depth = 1 }',
            "surface.depth = 1: unknown key; expected one of kind, radius",
        ),
        ('obstacles = [{ kind = "sphere", centre = [0, 0, 0], radius = -1 }]', "ground.obstacles.0..radius = -1"),
        ('obstacles = [{ kind = "pit" }]', "expected 'box', 'sphere' or 'cylinder'"),
        ('surface = { kind = "heights", size = [1, 1] }', "expected either values or image"),
        ('surface = { kind = "heights", size = [1, 1], image = "a.png" }', "ground.surface.highest: missing"),
        ('surface = { kind = "heights", size = [1, 1], image = "a.png", highest = 1 }', "a.png: no picture"),
        ('surface = { kind = "heights", size = [1, 1], values = [[0.0], [0.0, 1.0]] }', "rows of different lengths"),
    ],
)
def test_what_is_no_ground_is_refused(line, words):
    with pytest.raises(InputError, match=words):
        parse_scene(with_ground(line))


def test_an_incline_goes_with_obstacles_and_with_no_other_surface():
    """The obstacles stand on the inclined plane."""
    obstacles = 'obstacles = [{ kind = "sphere", centre = [9, 0, 0], radius = 0.1 }]'
    sloped = with_ground(obstacles).replace("incline = 0.0", "incline = 0.2")
    np.testing.assert_allclose(parse_scene(sloped).ground.height(np.ones(1), np.zeros(1)), -np.tan(0.2))
    bowl = with_ground('surface = { kind = "bowl", radius = 2.0 }').replace("incline = 0.0", "incline = 0.2")
    with pytest.raises(InputError, match=r"ground.incline = 0.2: it is that of the plane"):
        parse_scene(bowl)


def test_robots_stand_along_an_incline_with_obstacles_as_on_one_without():
    plain = """
        [structure]
        kind = "icosahedron"
        mass = 6.0
        pose = "face"
        aligned = true
        [struts]
        rigid = true
        [cables]
        stiffness = 600.0
        prestrain = 0.3
        [ground]
        contact = "complementarity"
        incline = 0.3
    """
    beside = plain + 'obstacles = [{kind = "sphere", centre = [9.0, 0.0, 0.0], radius = 0.2}]'
    alone, together = (parse_scene(text).structure.nodes for text in (plain, beside))
    np.testing.assert_allclose(together, alone, atol=1e-12)


@pytest.mark.parametrize(
    "touching",
    [
        "balls = { nodes = [0, 4, 8], radius = [0.05, 0.2, 0.0] }",
        "along_struts = { count = 2, radius = 0.05 }",
        "along_struts = { count = 2, struts = [1], radius = 0.05 }\nballs = { nodes = [0, 2] }",
        "along_struts = { count = 2 }",
    ],
)
@pytest.mark.parametrize("incline", [0.0, 0.3])
def test_a_robot_has_its_height_above_the_ground_with_all_that_touches_it(touching, incline):
    """Balls and struts with a radius too: with them it started in the ground."""
    text = scene_text("reference").replace("[ground]", f"[ground]\n{touching}").replace("incline = 0.0", "")
    scene = parse_scene(text.replace("[friction]", f"incline = {incline}\n[friction]"))
    distance = scene.ground.measured(np.asarray(scene.structure.nodes)).distance
    assert distance.min() == pytest.approx(0.02 * np.cos(incline), abs=1e-12)


def test_a_ball_about_no_node_is_refused():
    with pytest.raises(InputError, match=r"scene: balls.nodes has 99; expected nodes from 0 to 11"):
        parse_scene(scene_text("reference").replace("[ground]", "[ground]\nballs = { nodes = [99] }"))

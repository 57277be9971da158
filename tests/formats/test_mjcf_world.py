"""Boxes, balls and cylinders of a MuJoCo model's world as ground: motions on them as there, and what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrity import ExactGround, InputError, SolverOptions, load_scene, save_scene, simulate
from jaxgrity.formats import read_mjcf, save_mjcf
from jaxgrity.model.solids import Box, Cylinder, Sphere, Stairs
from jaxgrity.model.unions import Union
from jaxgrity.stepping.starts import check_start

mujoco = pytest.importorskip("mujoco")

MODEL = """<mujoco><option timestep="0.0002" cone="elliptic"/>
<default><geom friction="{mu} 0 0" solref="0.002 2" solimp="0.999 0.999 0.0001"/></default><worldbody>{world}{bodies}
</worldbody><tendon>{tendons}</tendon></mujoco>"""
"""Contact is stiff, and bodies hardly rebound."""
FLOOR = '<geom name="floor" type="plane" size="5 5 .1"/>'
STEP = '<geom name="step" type="box" size="0.2 0.5 0.1" pos="0 0 0.1"/>'
RAMP = '<geom name="step" type="box" size="0.3 0.5 0.02" pos="0 0 0.17" euler="10 25 15"/>'
STAIRS = "".join(
    f'<geom name="s{k}" type="box" size="0.1 0.5 {h}" pos="{x} 0 {h}"/>'
    for k, (x, h) in enumerate(((0.5, 0.03), (0.7, 0.06), (0.9, 0.09)))
)
SLIDES = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
CABLE = '<spatial stiffness="{K}" damping="1" springlength="0 0.3"><site site="a"/><site site="{end}"/></spatial>'
ROD = """<body pos="0.17 0.02 0.26" euler="0 8 12"><freejoint/>
<geom name="r" type="capsule" size="0.02" fromto="-0.15 0 0 0.25 0 0" mass="0.5"/>
<site name="a" pos="-0.15 0 0"/><site name="b" pos="0.25 0 0"/></body>"""
NODE = f'<body pos="-0.15 0.3 0.3">{SLIDES}<geom name="n" type="sphere" size="0.02" mass="0.2"/><site name="c"/></body>'
BODY = """<body pos="0.17 0.03 0.33" euler="0 5 20"><freejoint/>
<geom type="sphere" pos="0 0.1 0.03" size="0.04" mass="0.2"/>
<geom name="r" type="capsule" size="0.03" fromto="-0.15 0 0 0.25 0 0" mass="0.5"/>
<site name="a" pos="-0.15 0 0"/><site name="b" pos="0.2 0 0.02"/><site name="c" pos="0 0.1 0"/></body>
<body pos="-0.15 -0.4 0.45"><freejoint/><geom type="sphere" size="0.05" mass="0.2"/>
<site name="d" pos="0.02 0 0"/><site name="e" pos="0 0.02 0"/><site name="f" pos="0 0 0.02"/></body>"""
TENDONS = CABLE.format(K=50, end="c")
PLACES = np.array([[0.19, 0, 0.26], [0.04, 0.1, 0.3], [0.04, -0.1, 0.3], [0.14, 0, 0.45]])
NODES = "".join(
    f'<body pos="{x} {y} {z}">{SLIDES}<geom size="0.03" mass="0.2"/><site name="s{k}"/></body>'
    for k, (x, y, z) in enumerate(PLACES)
)
SPRINGS = "".join(
    f'<spatial stiffness="300" damping="3" springlength="{np.linalg.norm(PLACES[i] - PLACES[j])}"><site site="s{i}"/>'
    f'<site site="s{j}"/></spatial>'
    for i in range(4)
    for j in range(i)
)
MOTIONS = {
    "nodes at an edge": (0.5, FLOOR + STEP, NODES, SPRINGS, [f"s{k}" for k in range(4)]),
    "a rod tips over an edge": (0.0, FLOOR + STEP, ROD + NODE, TENDONS, list("abc")),
    "a body on a ramp": (0.0, FLOOR + RAMP, BODY, CABLE.format(K=5, end="d"), list("abcdef")),
}


@pytest.fixture
def read(tmp_path):
    """Of a model's text."""

    def from_text(text, **how):
        path = tmp_path / "robot.xml"
        path.write_text(text)
        return read_mjcf(path, **how)

    return from_text


def rod_on(world, mu=0.5):
    return MODEL.format(mu=mu, world=world, bodies=ROD + NODE, tendons=TENDONS)


def moved_by_mujoco(text, names, times):
    """(times, sites, 3), m."""
    model = mujoco.MjModel.from_xml_string(text)
    data, places = mujoco.MjData(model), []
    for time in times:
        mujoco.mj_step(model, data, round((time - data.time) / model.opt.timestep))
        mujoco.mj_kinematics(model, data)
        places.append(data.site_xpos[[model.site(name).id for name in names]])
    return np.array(places)


@pytest.mark.slow
@pytest.mark.parametrize(("mu", "world", "bodies", "tendons", "names"), MOTIONS.values(), ids=MOTIONS)
def test_robots_move_on_boxes_as_in_mujoco(mu, world, bodies, tendons, names, read, tmp_path):
    """Within 4 % of the way of the site that moves farthest, in the model and in the one that is written."""
    text = MODEL.format(mu=mu, world=world, bodies=bodies, tendons=tendons)
    scene, times = read(text).scene, np.arange(1, 5) / 10
    moved = simulate(scene, 0.4, options=SolverOptions(dt=1e-3), frame_rate=10.0)
    ours = np.asarray(moved.positions)[1:, : len(names)]
    way = np.linalg.norm(ours[-1] - scene.structure.nodes[: len(names)], axis=1).max()
    assert way > 0.06
    np.testing.assert_allclose(ours, moved_by_mujoco(text, names, times), rtol=0, atol=0.04 * way)
    written = save_mjcf(scene, tmp_path / "written.xml", 2e-4)
    assert not any("left out" in note for note in written.notes)
    stiff = written.xml.replace("solref=", 'solimp="0.999 0.999 0.0001" solref=').replace(
        'solref="0.0', 'solref="0.002'
    )
    theirs = moved_by_mujoco(stiff, [f"n{k}" for k in range(len(names))], times)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=0.04 * way)


WORLD = (
    FLOOR
    + """<geom type="box" size="0.1 0.2 0.3" pos="1 0 0.2" euler="0 0 30"/>
<body pos="0 1 0" euler="90 0 0"><geom type="box" size="0.1 0.2 0.3"/></body>
<geom type="box" size="0.1 0.2 0.3" pos="2 0 0.5" euler="20 30 40"/><geom type="sphere" size="0.2" pos="-1 0 0"/>
<geom type="capsule" size="0.05" fromto="-2 0 0.1 -2 1 0.2"/><geom type="cylinder" size="0.05 0.4" pos="-3 0 0"/>"""
)


def test_solids_are_read_and_written(read, tmp_path):
    """Distances of places from all of them are those in MuJoCo; scene files and written models keep them."""
    text = rod_on(WORLD)
    scene, notes = read(text)
    kinds = [type(part) for part in scene.ground.surface.solids[1:]]
    assert kinds == [Box, Box, Sphere, Cylinder, Cylinder, Box]  # that of another body comes last
    turns = [np.ndim(part.turn) for part in scene.ground.surface.solids if isinstance(part, Box)]
    assert turns == [0, 1, 0]
    assert "6 solids of the world (boxes, balls, cylinders) are parts of the ground" in notes
    save_scene(scene, tmp_path / "scene.toml")
    written = save_mjcf(scene, tmp_path / "written.xml")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    probe = mujoco.MjModel.from_xml_string(rod_on(WORLD + '<body mocap="true"><geom name="probe" size="1e-3"/></body>'))
    moved = mujoco.MjData(probe)
    places = np.random.default_rng(0).uniform([-4, -1, 0.01], [3, 2, 1], (60, 3))
    theirs = []
    for place in places:
        moved.mocap_pos[0] = place
        mujoco.mj_kinematics(probe, moved)
        each = [k for k in range(probe.ngeom) if probe.geom_bodyid[k] < 2]
        apart = [mujoco.mj_geomDistance(probe, moved, probe.geom("probe").id, k, 5.0, None) for k in each]
        theirs.append(min(apart) + 1e-3)
    theirs = np.array(theirs)
    for each in (scene, load_scene(tmp_path / "scene.toml"), read(written.xml).scene):
        ours = np.asarray(each.ground.surface.signed_distance(places))
        np.testing.assert_allclose(ours[theirs > 0.01], theirs[theirs > 0.01], rtol=0, atol=1e-6)
    assert np.sum(theirs < 0.3) > 10


def test_boxes_side_by_side_have_no_wall_between_them(read):
    """Steps of a stair stand on the floor, and touch each other: here they overlap, and have the same shape."""
    surface = read(rod_on(FLOOR + STAIRS)).scene.ground.surface
    x = np.linspace(0.3, 1.1, 81) + 1e-3
    heights = np.asarray(surface.height(x, 0 * x))
    right = np.select([x < 0.4, x < 0.6, x < 0.8, x < 1.0], [0, 0.06, 0.12, 0.18], 0.0)
    np.testing.assert_allclose(heights, right, atol=1e-12)
    boxes = [part for part in surface.solids if isinstance(part, Box)]
    walls = [np.asarray(box.centre)[0] + np.asarray(box.size)[0] / 2 for box in boxes]
    assert walls[0] > 0.61
    assert all(np.asarray(box.centre)[2] - np.asarray(box.size)[2] / 2 < -0.01 for box in boxes)


def test_a_floor_may_be_a_box(read, tmp_path):
    """Without a plane; scene files hold it, too."""
    floor = '<geom type="box" size="2 2 0.1" pos="0 0 0.1"/>'
    scene = read(rod_on(floor)).scene
    assert isinstance(scene.ground.surface, Box)
    save_scene(scene, tmp_path / "scene.toml")
    again = load_scene(tmp_path / "scene.toml").ground.surface
    np.testing.assert_array_equal(again.size, scene.ground.surface.size)
    x = np.asarray(scene.structure.nodes)
    assert float(scene.ground.measured(x).distance.min()) > 0.005
    parts = read(save_mjcf(scene, tmp_path / "written.xml").xml).scene.ground.surface
    np.testing.assert_allclose(parts.size, [4, 4, 0.2], rtol=1e-12)


def test_solids_are_turned_with_gravity(read):
    """Where it leans, distances of all nodes from the ground are the same as in the model that it turns into."""
    turn = Rotation.from_euler("xyz", [0.2, -0.1, 0.3])
    g = turn.apply([0, 0, -9.81])
    leaning = rod_on(
        FLOOR.replace("/>", ' pos="0 0 -1" zaxis="{} {} {}"/>'.format(*-g)) + RAMP.replace("0.17", "0.1")
    ).replace("<option", '<option gravity="{} {} {}"'.format(*g))
    upright = rod_on(FLOOR + RAMP.replace("0.17", "0.1"))
    model = mujoco.MjModel.from_xml_string(upright)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    scene = read(leaning).scene
    x = np.asarray(scene.structure.nodes, float)
    (_, box) = scene.ground.surface.solids
    ways = (x - np.asarray(box.centre)) @ np.asarray(box.axes).T
    own = np.array([0.6, 1.0, 0.04])
    sites = data.site_xpos[[model.site(name).id for name in "abc"]]
    at, axes = data.geom_xpos[model.geom("step").id], data.geom_xmat[model.geom("step").id].reshape(3, 3)
    order = [int(np.argmin(np.abs(np.asarray(box.size) - size))) for size in own]
    np.testing.assert_allclose(np.abs(ways[:, order]), np.abs((sites - at) @ axes), atol=1e-9)


def with_step(**given):
    """The rod above a step with further attributes, which replace its own."""
    attributes = {"type": "box", "size": "0.2 0.5 0.1", "pos": "0 0 0.1"} | given
    return rod_on(FLOOR + '<geom name="step" {}/>'.format(" ".join(f'{k}="{v}"' for k, v in attributes.items())))


BLOCK = with_step().replace('name="n" type="sphere" size="0.02"', 'name="n" type="box" size="0.02 0.02 0.02"')
MASKS = with_step(contype=2, conaffinity=2).replace('name="r"', 'name="r" conaffinity="3"')
BRICKS = rod_on(FLOOR + STEP + STEP.replace("step", "brick").replace("0 0 0.1", "-0.3 -0.4 0.3"))
TALL = with_step(size="0.1 0.5 2", pos="0.4 0 2")
BETWEEN = with_step(size="0.03 0.5 2", pos="0.25 0 2")
SHORT = with_step().replace('pos="0.25 0 0"', 'pos="0.2 0 0"')
REFUSED = {
    "a hill": (with_step(type="ellipsoid"), "contact", "bodies touch what stands beside the plane"),
    "masks": (MASKS, "contact", "geom n: touches geom floor, and not geom step"),
    "friction": (with_step(friction=0.8), "friction", "geom r: friction 0.5 on geom floor, and 0.8"),
    "a rebound": (with_step(priority=1, solref="0.01 0.2"), "contact", "geom r: bounces off at"),
    "a margin": (with_step(margin=0.01), "contact", "has a margin of 0 m to geom floor"),
    "a box that moves": (BLOCK, "contact", "geom n: a box that moves touches geom step"),
    "inside": (with_step(pos="0 0 0.2"), "contact", "m inside a solid of the world"),
    "an end in a pillar": (TALL, "contact", "the robot starts inside geom step, cannot be pushed out"),
    "a rod through a pillar": (BETWEEN, "contact", "the robot starts inside geom step, cannot be pushed out"),
    "a capsule without sites": (SHORT, "contact", "touches the plane where its body has no site"),
    "bricks": (BRICKS, "contact", "the world: a face of geom step lies on geom brick, and nodes"),
}


@pytest.mark.parametrize(("text", "kind", "reason"), REFUSED.values(), ids=REFUSED)
def test_what_the_ground_cannot_be_is_refused(text, kind, reason, read):
    with pytest.raises(InputError) as caught:
        read(text)
    assert reason in str(caught.value)
    assert kind in str(caught.value).split("drop=")[1]
    found = read(text, drop=[kind, "contact"])
    assert any(note.startswith("dropped: ") and reason.split(": ")[-1] in note for note in found.notes)


def test_a_cylinder_stands_on_the_plane_and_on_boxes(read):
    """It reaches into them, at either end, also where they are turned; past the edge of a box it is refused."""
    posts = """<geom type="cylinder" size="0.1 0.3" pos="1 0 0.3"/><geom type="cylinder" size="0.1 0.3" pos="-1 0 0.3"
    euler="180 0 0"/><geom name="under" type="box" size="0.3 0.1 0.1" pos="2 0 0.1" euler="0 0 30"/>
    <geom name="post" type="cylinder" size="{} 0.3" pos="2 0 0.5"/>"""
    surface = read(rod_on(FLOOR + posts.format(0.0999))).scene.ground.surface
    ends = [(np.asarray(each.start), np.asarray(each.end)) for each in surface.solids if isinstance(each, Cylinder)]
    for end, foot, top in zip(ends, [0, 0, 0.2], [0.6, 0.6, 0.8]):
        low, high = sorted(each[2] for each in end)
        assert low < foot - 0.01
        assert high == pytest.approx(top, abs=1e-12)
    x, y = np.array([1.05, -1.05, 2.05, 1.3]), np.zeros(4)
    np.testing.assert_allclose(np.asarray(surface.height(x, y)), [0.6, 0.6, 0.8, 0], atol=1e-9)
    with pytest.raises(InputError, match="the world: a face of geom under lies on geom post"):
        read(rod_on(FLOOR + posts.format(0.1001)))


def test_a_box_that_leans_by_little_is_not_upright(read):
    """4e-5 rad are 0.1 mm at 3 m."""
    turn = f'quat="{np.cos(2e-5):.12f} 0 {np.sin(2e-5):.12f} 0"'
    surface = read(rod_on(f'<geom type="box" size="3 3 0.1" {turn}/>')).scene.ground.surface
    right = np.cos(4e-5) + 2.9 * np.sin(4e-5) - 0.1
    np.testing.assert_allclose(np.asarray(surface.signed_distance(np.array([[2.9, 0, 1.0]]))), right, atol=1e-9)


SIDEWAYS = {
    "a wall": 'size="0.1 2 2" pos="-0.08995 0 2"',
    "a steep ramp": 'size="1 2 0.05" pos="{:.8f} {} {:.8f}" euler="0 60 0"'.format(
        *(PLACES[1] - (0.08 - 5e-5) * np.array([np.sqrt(0.75), 0, 0.5]))
    ),
    "a corner": 'size="0.1 2 2" pos="-0.08995 0 2"/><geom type="box" size="2 0.1 2" pos="0 -0.22995 2"',
}


@pytest.mark.parametrize("box", SIDEWAYS.values(), ids=SIDEWAYS)
def test_a_small_start_inside_is_pushed_out_sideways(box, read):
    """Along the normals of walls, until no node is inside; the robot moves by as little as it was inside."""
    text = MODEL.format(mu=0.5, world=FLOOR + f'<geom type="box" {box}/>', bodies=NODES, tendons=SPRINGS)
    scene, notes = read(text)
    x = np.asarray(scene.structure.nodes)
    assert any("inside a solid of the world; here it starts on it" in note for note in notes)
    assert float(scene.ground.measured(x).distance.min()) >= -1e-9
    assert np.linalg.norm(x - PLACES, axis=1).max() < 8e-5
    check_start(scene)


def test_a_start_that_no_push_mends_is_set_on_top(read):
    scene, notes = read(BETWEEN, drop=["contact"])
    assert any("inside geom step, cannot be pushed out, and is set on top of it" in note for note in notes)
    assert np.asarray(scene.structure.nodes)[:, 2].max() > 4
    check_start(scene)


def test_a_small_start_inside_is_raised(read):
    scene, notes = read(rod_on(FLOOR + STEP.replace("0 0 0.1", "0 0 0.105")).replace("0.02 0.26", "0.02 0.225"))
    assert any("inside a solid of the world; here it starts on it" in note for note in notes)
    assert not simulate(scene, 0.01).failed


def test_stairs_are_written_as_boxes(read, tmp_path):
    """Heights are those of the stairs, up to the end of the last box."""
    scene = read(rod_on(FLOOR)).scene
    stairs = Stairs(0.1, 0.3, 3, 0.4, turn=0.5)
    written = save_mjcf(type(scene)(scene.structure, 9.81, None, ExactGround(surface=stairs)), tmp_path / "written.xml")
    assert any("stairs are boxes there" in note for note in written.notes)
    surface = read(written.xml).scene.ground.surface
    assert isinstance(surface, Union)
    x, y = np.random.default_rng(1).uniform(-2, 2, (2, 200))
    lower = float(surface.height(np.full(1, -9.0), np.zeros(1))[0])
    np.testing.assert_allclose(np.asarray(surface.height(x, y)) - lower, stairs.height(x, y), atol=3e-3)

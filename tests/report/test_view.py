"""The replay is one file that plays in a browser without a network, and shows the robot where it is."""

import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from browser import is_red, screenshot, start_browser, wait_for
from scipy.ndimage import binary_dilation

import jaxgrity
from jaxgrity.report import drawing, stages, view
from jaxgrity.report.poses import RobotPoses, robot_poses, robot_size, rods
from jaxgrity.stepping.simulate import some_frames


@pytest.fixture(scope="module")
def rolling_robot():
    """A scene that rolls, and 1.5 s of its motion from the middle of it."""
    scene = jaxgrity.with_gait(jaxgrity.load_scene("exact"), jaxgrity.load_gait("brisk"))
    motion = jaxgrity.simulate(scene, 3.0, frame_rate=50.0)
    return scene, replace(some_frames(motion, slice(100, None)), times=motion.times[100:] - motion.times[100])


@pytest.fixture(scope="module")
def saved(rolling_robot, tmp_path_factory):
    """The replay, as a file."""
    path = tmp_path_factory.mktemp("replay") / "replay.html"
    view.save_html(*rolling_robot, path, title="a <robot> rolls")
    return path


def projected(points, scene, poses, frame, size):
    """Columns and rows at which points of the world are drawn when a frame is shown, by a pinhole camera."""
    width, height = size
    aim = np.array([0.0, 0.0, 0.4 * robot_size(scene)])
    place = view.camera_place(aim, poses, robot_size(scene))
    forward = (aim - place) / np.linalg.norm(aim - place)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    seen = points - poses.below[frame] - place
    depth = seen @ forward
    scale = height / 2 / np.tan(view.FIELD_OF_VIEW / 2) / depth
    return width / 2 + seen @ right * scale, height / 2 - seen @ np.cross(right, forward) * scale


def time_shown(browser):
    """s, of a replay that stands still."""
    return float(browser.find_element("css selector", "[role=slider]").get_attribute("aria-valuenow"))


def check_drawing(browser, scene, motion):
    """Struts are red where a pinhole camera would see them, and hardly anything is red elsewhere."""
    poses = robot_poses(scene, motion, 50.0)
    canvas = browser.find_element("css selector", "canvas").rect

    def drawn():
        # viser's notice that the browser draws in software covers the robot, and comes when it likes
        browser.execute_script("document.querySelectorAll('[class*=Notification]').forEach(e => e.remove())")
        frame = int(np.searchsorted(poses.times, time_shown(browser) + 1e-6)) - 1
        ends = poses.nodes[frame][np.array(scene.structure.struts.edges)]
        # along each strut, since something may hide part of it
        points = (ends[:, :1] + np.linspace(0, 1, 40)[:, None] * (ends[:, 1:] - ends[:, :1])).reshape(-1, 3)
        columns, rows = projected(points, scene, poses, frame, (canvas["width"], canvas["height"]))
        places = np.round([rows + canvas["y"], columns + canvas["x"]]).astype(int)
        red = is_red(screenshot(browser))
        # a strut is some pixels wide, and bright where light falls on it
        return (red, places) if binary_dilation(red, iterations=2)[tuple(places)].mean() > 0.75 else None

    red, places = wait_for(drawn, "struts where they should be")
    away = np.ones_like(red)
    for row, column in places.T:
        away[max(0, row - 8) : row + 8, max(0, column - 8) : column + 8] = False
    assert (red & away).sum() < 0.05 * red.sum()


@pytest.mark.slow
def test_the_saved_page_draws_and_plays_from_disk_without_a_network(rolling_robot, saved):
    """Struts are red where they should be; the button stops and starts the motion; nothing is asked of a network."""
    browser = start_browser()
    try:
        browser.execute_cdp_cmd("Network.enable", {})
        offline = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
        browser.execute_cdp_cmd("Network.emulateNetworkConditions", offline)
        browser.get(saved.as_uri())
        clock = wait_for(lambda: browser.find_elements("css selector", "input"), "the clock of the replay")[0]
        button = browser.find_elements("css selector", "button.mantine-ActionIcon-root")[0]
        wait_for(lambda: float(clock.get_attribute("value")) > 0, "the motion")
        button.click()
        browser.execute_script("document.getElementById('jaxgrity').remove()")  # the legend is red too
        check_drawing(browser, *rolling_robot)
        stopped = time_shown(browser)
        check_drawing(browser, *rolling_robot)
        assert time_shown(browser) == stopped
        button.click()
        wait_for(lambda: time_shown(browser) != stopped, "the motion, after a click")
        asked = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
        urls = [event["params"]["request"]["url"] for event in asked if event["method"] == "Network.requestWillBeSent"]
        assert not [url for url in urls if not url.startswith(("file:", "data:", "blob:"))]
        assert not [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    finally:
        browser.quit()


@pytest.mark.slow
def test_a_long_replay_is_small(rolling_robot):
    """20 s at 50 frames a second are far below 15 MB, client and all."""
    scene, motion = rolling_robot
    times = np.arange(1001) / 50.0
    frames = np.arange(1001) % len(motion.times)
    shaken = np.random.default_rng(0).normal(scale=1e-3, size=(1001, 12, 3))  # nothing repeats that could be packed
    long = replace(
        motion, times=times, positions=motion.positions[frames] + shaken, velocities=motion.velocities[frames]
    )
    page = view.replay(scene, long).page
    assert len(page.encode()) < 15e6


def test_the_page_escapes_titles_and_names_no_address(saved):
    """It is one file: nothing in it is loaded from elsewhere."""
    text = saved.read_text(encoding="utf-8")
    assert "a &lt;robot&gt; rolls" in text
    assert "a <robot>" not in text
    assert not [address for address in ("https://", "//cdn", "@import url") if address in text]


def test_rods_begin_and_end_where_they_should():
    """The unit rod, stretched, turned by its quaternion and moved, joins the two points; straight down too."""
    rng = np.random.default_rng(0)
    start, end = rng.normal(size=(2, 4, 5, 3))
    end[0, 0] = start[0, 0] - np.array([0.0, 0.0, 2.0])
    made = rods(start, end, 0.1)
    w, vector = made.turn[..., :1], made.turn[..., 1:]
    along = np.array([0.0, 0.0, 1.0]) * made.scale
    turned = along + 2 * np.cross(vector, np.cross(vector, along) + w * along)
    np.testing.assert_allclose(made.position + turned, end, atol=1e-12)


def test_slack_cables_are_pale_and_thin(rolling_robot):
    """Struts are red, and those cables that pull least are marked."""
    scene, motion = rolling_robot
    poses = robot_poses(scene, motion, 50.0)
    tension = jaxgrity.forces_along(scene, motion).tension
    slack = tension[:, 6:] <= 1e-3 * np.abs(tension[:, 6:]).max()
    assert slack.any()
    assert not slack.all()
    pale = (poses.colours[:, 6:] == [0xB9, 0xC6, 0xD2]).all(-1)
    np.testing.assert_array_equal(pale, slack)
    assert (poses.colours[:, :6] == [0xC1, 0x27, 0x2D]).all()
    assert poses.members.scale[:, 6:, 0][slack].max() < poses.members.scale[:, 6:, 0][~slack].min()


def still(scene):
    """Two frames in which nothing moves."""
    q, none = np.stack([np.asarray(scene.structure.nodes, float)] * 2), jnp.array(0)
    return jaxgrity.Trajectory(np.array([0.0, 0.1]), q, 0 * q, none, none, none, "rk4", 1e-3, scene)


@pytest.mark.parametrize("write", [view.save_html, jaxgrity.report.animate])
def test_a_film_is_not_drawn_for_the_place_of_a_folder(reference, tmp_path, monkeypatch, write):
    monkeypatch.setattr(view, "replay", lambda *given, **how: pytest.fail("drawn"))
    with pytest.raises(jaxgrity.InputError, match=r"is a folder; expected the name of a file to write$"):
        write(reference, still(reference), tmp_path)


def test_rigid_bodies_are_drawn(tmp_path):
    """As lines between all their points, in replays, figures and films; robots of bodies may have nothing else."""
    nodes = np.array([[0.0, 0, 0.1], [0.3, 0, 0.1], [0.1, 0.3, 0.1], [0.1, 0.1, 0.4]])
    body = jaxgrity.model.rigid_body(nodes, range(4), 1.0, [0.01, 0.01, 0.01])
    scene = jaxgrity.Scene(jaxgrity.Structure(nodes, np.zeros(4), bodies=(body,)))
    motion = still(scene)
    poses = robot_poses(scene, motion, 20.0)
    far = np.linalg.norm(nodes[:, None] - nodes, axis=-1)[np.triu_indices(4, 1)]
    np.testing.assert_allclose(np.sort(poses.bodies.scale[..., 2], axis=1), [np.sort(far)] * 2, rtol=1e-6)
    assert poses.members.scale.shape == (2, 0, 3)
    view.save_html(scene, motion, tmp_path / "replay.html")
    lines = jaxgrity.report.plot.still_figure(scene, motion).axes[0].collections
    assert [len(each.get_segments()) for each in lines if hasattr(each, "get_segments")] == [6, 6]
    with pytest.raises(jaxgrity.InputError, match="the structure has no members"):
        jaxgrity.report.plot.force_figure(scene, motion)
    for camera in ("whole", "follow"):
        jaxgrity.report.animate(scene, motion, tmp_path / f"{camera}.gif", camera=camera)


def test_numbers_of_small_robots_keep_their_digits(rolling_robot):
    """In the legend of a replay, and in the caption of a picture: not 0 N, and not one time for all."""
    poses = robot_poses(*rolling_robot, 50.0)._replace(largest_tension=0.0123)
    assert "cables, 0 to 0.0123 N" in view._with_legend("<body></body>", "", poses)
    times, centre = np.array([0.0, 0.012]), np.array([[0.0, 0, 0], [3e-4, 4e-4, 0]])
    assert stages.caption(times, centre, 1) == "t = 0.012 s, 0.000500 m from the start"
    assert stages.caption(100 * times, 100 * centre, 1) == "t = 1.2 s, 0.0500 m from the start"


def test_sliding_nodes_have_sleeves(tmp_path):
    """About their line, half of it on either side."""
    nodes = np.array([[0.0, 0, 0.1], [1.0, 0, 0.1], [0.4, 0, 0.1]])
    structure = jaxgrity.Structure(nodes, np.ones(3), jaxgrity.Members(((0, 1),), [1e4], [1.0]))
    scene = jaxgrity.Scene(structure, terms=(jaxgrity.model.Slides((2,), ((1, 0),)),))
    sleeves = robot_poses(scene, still(scene), 20.0).sleeves
    np.testing.assert_allclose(sleeves.position, [[[0.44, 0, 0.1]]] * 2)
    np.testing.assert_allclose(sleeves.scale, [[[0.026, 0.026, 0.08]]] * 2)
    view.save_html(scene, still(scene), tmp_path / "replay.html")


def test_struts_that_touch_the_ground_are_as_thick_as_they_are():
    """Those with a radius; others as ever."""
    nodes = np.array([[0.0, 0, 0.1], [1.0, 0, 0.1], [0.0, 1, 0.1], [1.0, 1, 0.1]])
    struts = jaxgrity.Members(((0, 1), (2, 3)), [1e4, 1e4], [1.0, 1.0])
    scene = jaxgrity.Scene(jaxgrity.Structure(nodes, np.ones(4), struts), ground=jaxgrity.PenaltyGround(1e4))
    scene = jaxgrity.with_contact_along_struts(scene, 1, struts=(1,), radius=0.05)
    np.testing.assert_allclose(robot_poses(scene, still(scene), 20.0).members.scale[..., 0], [[0.014, 0.05]] * 2)


def test_frames_are_those_nearest_to_the_rate(rolling_robot):
    """Of 50 saved frames a second every fifth is shown at 10; never more than there are."""
    scene, motion = rolling_robot
    assert len(robot_poses(scene, motion, 10.0).times) == 11
    assert len(robot_poses(scene, motion, 1e4).times) == len(motion.times)


def test_a_bad_frame_rate_is_one_line(rolling_robot):
    """Before anything is drawn."""
    with pytest.raises(jaxgrity.InputError, match="frame_rate = 0"):
        view.replay(*rolling_robot, frame_rate=0.0)


def test_without_viser_the_line_says_what_to_install(rolling_robot, monkeypatch):
    """The library does without it otherwise."""
    monkeypatch.setattr(view, "available", lambda: False)
    with pytest.raises(jaxgrity.InputError, match=r"pip install 'jaxgrity\[view\]'"):
        view.replay(*rolling_robot)


def test_robots_stand_beside_each_other(rolling_robot):
    """By their names, each once; what is beside moves along with the first."""
    scene, motion = rolling_robot
    beside = robot_poses(scene, motion, 50.0, (0.0, 2.0, 0.0))
    moved = beside.nodes - robot_poses(scene, motion, 50.0).nodes
    np.testing.assert_allclose(moved - np.array([0.0, 2.0, 0.0]), 0, atol=1e-12)
    with pytest.raises(jaxgrity.InputError, match="expected each once"):
        view.replay(scene, motion, others=[view.Robot(scene, motion, "robot")])


def test_a_trajectory_shows_itself(rolling_robot):
    """As an iframe in Jupyter; one that does not know its scene says so."""
    _, motion = rolling_robot
    assert motion.show(frame_rate=5.0)._repr_html_().startswith("<iframe")
    with pytest.raises(jaxgrity.InputError, match="does not know its scene"):
        replace(motion, scene=None).show()


def test_a_replay_is_kept_where_it_can_be_and_an_old_one_never(tmp_path, monkeypatch, rolling_robot):
    """Without viser there is none, not even that of an earlier run, which would show another motion."""
    path = tmp_path / "replay.html"
    assert view.keep_html(*rolling_robot, path)
    assert path.stat().st_size > 1e5
    monkeypatch.setattr(view, "available", lambda: False)
    assert not view.keep_html(*rolling_robot, path)
    assert not path.exists()


GROUNDS = {
    "bumps": jaxgrity.bumps(0.03, 0.8, seed=0),
    "stairs": jaxgrity.Stairs(0.1, 0.3, 3, start=0.2),
    "a box on the plane": jaxgrity.Union((jaxgrity.Slope(), jaxgrity.Box([1.0, 0, 0], [0.4, 0.4, 0.3]))),
    "a ball above nothing": jaxgrity.Sphere([0.0, 0, -1.0], 1.0),
}

SIZE = pytest.mark.campaign, pytest.mark.slow


@pytest.mark.campaign
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=SIZE[name in ("bumps", "a ball above nothing")]) for name in GROUNDS]
)
def test_uneven_ground_is_drawn(name, exact, tmp_path):
    """With what is on it: the path of the centre of mass, and where the robot stands."""
    ground = replace(exact.ground, surface=GROUNDS[name])
    nodes = ground.set_down(exact.structure.nodes, -0.01)
    scene = replace(exact, ground=ground, structure=replace(exact.structure, nodes=nodes))
    motion = jaxgrity.simulate(scene, 0.3, frame_rate=10.0)
    poses = robot_poses(scene, motion, 10.0)
    height = ground.height(poses.below[:, 0], poses.below[:, 1])
    np.testing.assert_allclose(poses.below[:, 2], np.where(np.isfinite(height), height, 0.0))
    standing = ground.measured(poses.support).distance
    assert np.all(standing[-1] < 0.02)
    view.save_html(scene, motion, tmp_path / "replay.html")
    assert (tmp_path / "replay.html").stat().st_size > 10_000
    jaxgrity.report.plot.save(jaxgrity.report.plot.still_figure(scene, motion), tmp_path / "still.png")


def test_the_mesh_of_the_ground_has_its_heights(exact):
    """It reaches beyond the path, and has no faces where there is no ground."""
    calls = []

    class Api:
        def __getattr__(self, name):
            return lambda *args, **kwargs: calls.append((name, args, kwargs))

    robot = drawing.RobotDrawing.__new__(drawing.RobotDrawing)
    robot._api, robot._root, nothing = Api(), "", RobotPoses(**dict.fromkeys(RobotPoses._fields))
    for robot._size in (0.01, 10.0):  # a hair above the ground, as the robot sees it
        calls.clear()
        robot.draw_path(nothing._replace(below=robot._size * np.eye(3)))
        np.testing.assert_allclose(calls[0][1][1][..., 2], robot._size * np.array([[0.004, 0.004], [0.004, 1.004]]))
    for name in ("bumps", "a ball above nothing"):
        scene = replace(exact, ground=replace(exact.ground, surface=GROUNDS[name]))
        world = drawing.World.__new__(drawing.World)
        world._api = Api()
        calls.clear()
        world.draw_ground(scene, np.array([[0.0, 0, 0], [2.0, 1, 0]]))
        _, (_, vertices, faces), _ = calls[0]
        x, y, z = np.asarray(vertices, float).T
        assert x.min() < -1
        assert x.max() > 3
        used = np.unique(faces)
        np.testing.assert_allclose(z[used], scene.ground.height(x[used], y[used]), atol=1e-5)
        assert (len(used) < len(x)) == (name == "a ball above nothing")

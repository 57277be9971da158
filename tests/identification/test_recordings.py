"""Recorded motions as tables: what is read, what is refused, where a simulation starts, and how far it is off."""

import json
from dataclasses import replace

import numpy as np
import pytest
from small_scenes import NODES, swept

from jaxgrity import Gait, InputError, Members, Scene, Shaking, SolverOptions, Structure
from jaxgrity.identification import Compared, Recording, beside_simulation, read_recording, recorded_motion
from jaxgrity.model import rigid_body
from jaxgrity.model.actuation import Commands, contraction

CABLE = Members(((0, 1),), [100.0], [1.0], damping=[0.8])
HANGING = Scene(Structure([[0, 0, 0], [0, 0, -1.2]], [0.0, 2.0], cables=CABLE, fixed=((0, "xyz"),)), gravity=9.81)
ROWS = """\
t, z1, x1, y1, contraction 0
0.0, -1.2, , 0.0, 0.0

0.1, -1.1, 0.5, 0.0, 0.1
0.2, , , , 0.2
0.25, -1.3, 0.2, nan, 0.25
0.3, -1.4, 0.1, 0.2, 0.3
"""


def read(tmp_path, text: str, scene: Scene = HANGING) -> Recording:
    (tmp_path / "run.csv").write_text(text)
    return read_recording(tmp_path / "run.csv", scene)


def test_a_table_is_read_with_its_gaps(tmp_path):
    """Columns in any order, a support left out, from the first row in which the node is whole; all commands."""
    found = read(tmp_path, ROWS)
    np.testing.assert_array_equal(found.times, [0.1, 0.2, 0.25, 0.3])
    assert np.isnan(found.positions[:, 0]).all()
    expected = [[0.5, 0, -1.1], [np.nan] * 3, [0.2, np.nan, -1.3], [0.1, 0.2, -1.4]]
    np.testing.assert_array_equal(found.positions[:, 1], expected)
    assert found.commands.members == (0,)
    np.testing.assert_array_equal(found.commands.times, [0.0, 0.1, 0.2, 0.25, 0.3])
    np.testing.assert_array_equal(found.commands.contraction[:, 0], found.commands.times)
    np.testing.assert_array_equal(found.known(HANGING.structure)[:, 1], [True, False, False, True])


def test_gaps_are_filled_along_straight_lines_and_supports_stay(tmp_path):
    """In time, not by the row; a support is where the scene has it, wherever it was seen."""
    filled = read(tmp_path, ROWS).filled(HANGING.structure)
    np.testing.assert_array_equal(filled[:, 0], np.zeros((4, 3)))
    np.testing.assert_allclose(filled[1, 1], [0.3, 0.1, -1.1 - 0.2 * 2 / 3], atol=1e-15)
    moved = ROWS.replace("contraction 0", "contraction 0, x0, y0, z0").replace("\n0.", "\n0.").splitlines()
    text = "\n".join([moved[0], *(f"{row}, 1, 1, 1" for row in moved[1:] if row)])
    np.testing.assert_array_equal(read(tmp_path, text).filled(HANGING.structure)[:, 0], np.zeros((4, 3)))


def test_commanded_rest_lengths_are_shares_of_the_scenes(tmp_path):
    """In metres, of a member whose number counts struts first."""
    text = "t,x0,y0,z0,x1,y1,z1,x2,y2,z2,rest length 2\n"
    rows = [f"{k / 10},{','.join(map(str, NODES.ravel()))},{0.6 - 0.06 * k}\n" for k in range(3)]
    commands = read(tmp_path, text + "".join(rows), swept()).commands
    assert commands.members == (2,)
    np.testing.assert_allclose(commands.contraction[:, 0], [0.0, 0.1, 0.2], atol=1e-15)


FRAMES = [
    {
        "time": 0.5 + 0.1 * k,
        "rod_07_end_pt1": [0.0, 10.0, 0.1 * k],
        "rod_07_end_pt2": None if k == 2 else [10.0, 10.0, 0.0],
        "targets": [1, 2],
    }
    for k in range(4)
]


def read_frames(tmp_path, frames: object, scene: Scene, unit: float = 1.0) -> Recording:
    path = tmp_path / "processed.json"
    path.write_text(frames if isinstance(frames, str) else json.dumps(frames))
    return read_recording(path, scene, unit)


def test_frames_with_the_ends_of_rods_are_read(tmp_path):
    """Of JSON, in another unit; an end that was not seen is null, other keys do not count."""
    rod = Scene(Structure([[0, 0, 0], [1.0, 0, 0]], [1.0, 1.0], Members(((0, 1),), [1.0], [1.0])))
    found = read_frames(tmp_path, FRAMES, rod, unit=0.1)
    np.testing.assert_allclose(found.times, [0.5, 0.6, 0.7, 0.8])
    np.testing.assert_allclose(found.positions[:, 0], [[0.0, 1.0, 0.01 * k] for k in range(4)])
    np.testing.assert_allclose(found.positions[:, 1], [[np.nan] * 3 if k == 2 else [1.0, 1.0, 0.0] for k in range(4)])
    assert found.commands is None
    for frames in ([{**frame, "rod_23_end_pt1": [3.0, 0, 0], "rod_23_end_pt2": [4.0, 0, 0]} for frame in FRAMES],):
        turned = [dict(reversed(frame.items())) for frame in frames]  # rods in the order of their numbers
        two = Scene(Structure([[0, 0, 0], [1.0, 0, 0], [0, 1, 0], [0, 2, 0]], np.ones(4)))
        first, second = (read_frames(tmp_path, each, two, unit=0.1).positions for each in (frames, turned))
        np.testing.assert_array_equal(first, second)
        np.testing.assert_allclose(first[:, 2], [[0.3, 0, 0]] * 4)
    with pytest.raises(InputError, match=r"unit = 0"):
        read_frames(tmp_path, FRAMES, rod, unit=0.0)
    with pytest.raises(InputError, match=r"processed.json: strut 0 \(nodes 0 and 1\) is 10 m long"):
        read_frames(tmp_path, FRAMES, rod)


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        ("[1, ", "not JSON"),
        ({"time": 0}, "expected a list of frames"),
        ([{"time": 0.0, "x": 1}] * 3, "has no places of nodes"),
        (
            [{**FRAMES[0], "rod_07_end_pt2": [1.0, 2.0]}] * 3,
            r"frame 0 has rod_07_end_pt2 = \[1.0, 2.0\]; expected three",
        ),
        ([{**FRAMES[0], "rod_07_end_pt2": [1.0, 2.0, "up"]}] * 3, "frame 0 has z1 = 'up'; expected a finite number"),
        ([FRAMES[0], FRAMES[0]], "frame 1 has t = 0.5 after 0.5; expected later times"),
        ([{**FRAMES[0], "time": None}], "frame 0 has no t; expected the time"),
        ([{**FRAMES[0], "rod_8_end_pt1": [0, 0, 0], "rod_8_end_pt2": [0, 0, 0]}] * 3, "column 'x2'; expected numbers"),
    ],
)
def test_wrong_frames_are_refused_in_one_line(tmp_path, frames, words):
    """With the file, the frame, what it has, and what was expected."""
    with pytest.raises(InputError, match=rf"processed\.json: .*{words}") as refusal:
        read_frames(tmp_path, frames, HANGING, unit=0.1)
    assert "\n" not in str(refusal.value)


HEAD = "t,x1,y1,z1\n"
GOOD = "0,0,0,-1.2\n0.1,0,0,-1.2\n0.2,0,0,-1.2\n"
BAD = {
    "empty": ("", "is empty; expected a header"),
    "no time": ("x1,y1,z1\n0,0,0\n", "has no column t; expected columns t, x0"),
    "semicolons": ("t;x1;y1;z1\n0;0;0;-1.2\n", "has no column t; expected columns t, x0"),
    "no places": ("t,contraction 0\n0,0\n", "has no places of nodes"),
    "another column": ("t,x1,y1,z1,force 3\n", "has a column 'force 3'; expected columns t, x0"),
    "twice": ("t,x1,x1,y1,z1\n", "has a column 'x1'; expected columns t, .* each once"),
    "no such node": ("t,x2,y2,z2\n", "has a column 'x2'; expected numbers from 0 to 1, as the scene has 2 nodes"),
    "no such member": ("t,x1,y1,z1,contraction 1\n", "'contraction 1'; expected numbers from 0 to 0, .* 1 members"),
    "no height": ("t,x1,y1\n", "has x1 and no z1; expected all three coordinates"),
    "a long row": (HEAD + "0,0,0,-1.2,7\n", "line 2 has 5 cells; expected 4"),
    "a word": (HEAD + "0,0,high,-1.2\n", "line 2 has y1 = 'high'; expected a finite number, or an empty cell"),
    "infinite": (HEAD + "0,0,inf,-1.2\n", "line 2 has y1 = 'inf'"),
    "no clock": (HEAD + ",0,0,-1.2\n", "line 2 has no t; expected the time"),
    "time backwards": (HEAD + "0.1,0,0,-1.2\n\n0.1,0,0,-1.2\n", "line 4 has t = 0.1 after 0.1; expected later times"),
    "never seen": (HEAD + "0,0,,-1.2\n0.1,0,,-1.2\n", "never has node 1; expected x1, y1, z1 in some rows"),
    "short": (HEAD + "0,,0,-1.2\n0.1,0,0,-1.2\n0.2,0,0,-1.2\n", "has 2 rows from the first one .* at least 3"),
    "millimetres": (
        HEAD + GOOD.replace("-1.2", "-120"),
        "robot is 100 times as large as the scene; expected metres, or the file's unit",
    ),
    "both commands": (
        "t,x1,y1,z1,contraction 0,rest length 0\n" + GOOD.replace("\n", ",0,1\n"),
        "has both commands of member 0; expected its rest length or its contraction",
    ),
    "a lost command": (
        "t,x1,y1,z1,rest length 0\n" + GOOD.replace("\n", ",1\n", 1).replace("-1.2\n", "-1.2,\n"),
        "line 3 has rest length 0 = nothing; expected a positive length in each row",
    ),
    "percents": (
        "t,x1,y1,z1,contraction 0\n" + GOOD.replace("\n", ",20\n"),
        "line 2 has contraction 0 = 20; expected a fraction below 1",
    ),
    "not CSV": (HEAD + '0,"0"0,0,0\n', "not CSV"),
}


@pytest.mark.parametrize(("text", "words"), BAD.values(), ids=BAD)
def test_a_wrong_table_is_refused_in_one_line(tmp_path, text, words):
    """With the file, the line or the column, what it has, and what was expected."""
    with pytest.raises(InputError, match=rf"run\.csv: .*{words}") as refusal:
        read(tmp_path, text)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("order", "scale", "words"),
    [
        ([0, 1, 2], 1000.0, r"strut 0 \(nodes 0 and 1\) is 1000 m long at 0 s, and 0\.968 m in the scene"),
        ([2, 1, 0], 1.0, r"strut 0 \(nodes 0 and 1\) is 0\.\d+ m long"),
    ],
    ids=["millimetres", "other numbers"],
)
def test_struts_of_other_lengths_are_in_another_unit_or_have_other_numbers(tmp_path, order, scale, words):
    """The gait moves the strut at the start; of three nodes, one is at a place that is none of the strut's ends."""
    scene = replace(swept(), gait=Gait((0,), [0.3], [0.05], [2.0], start=-1.0, ramp=0.1))
    text = "t,x0,y0,z0,x1,y1,z1,x2,y2,z2\n"
    places = (scale * NODES * [1.0, 0.3, 1.0] if scale == 1 else scale * NODES)[order]
    rows = [f"{k / 10},{','.join(map(str, places.ravel()))}\n" for k in range(3)]
    with pytest.raises(InputError, match=f"run.csv: {words}.*; expected metres, or the file's unit"):
        read(tmp_path, text + "".join(rows), scene)


def test_some_row_has_to_have_every_node(tmp_path):
    """Since the simulation starts there; each of the three is seen now and then."""
    rows = ["0,0,0,0,,,,0.5,0.6,0.2", "0.1,,,,0.8,0,0.6,0.5,0.6,0.2", "0.2,0,0,0,0.8,0,0.6,,,"]
    with pytest.raises(
        InputError, match=r"no row has every node \(the fullest lacks node 1\); expected one, from which"
    ):
        read(tmp_path, "t,x0,y0,z0,x1,y1,z1,x2,y2,z2\n" + "\n".join(rows), swept())


def test_rigid_struts_start_with_their_lengths_out_of_the_ground():
    """The nearest pose and velocities that they and exact ground allow; both hardly differ from the measured ones."""
    scene, times = swept(), np.linspace(0, 0.1, 11)
    scene = replace(scene, gait=None)
    way = np.array([0.5, 0.0, 0.2]) * times[:, None]
    noise = np.random.default_rng(0).normal(0, 2e-3, (11, 3, 3))
    motion = recorded_motion(scene, Recording(times, NODES + way[:, None] + noise - [0, 0, 0.02]))
    assert motion.unknown == ()
    q, v = motion.state[0]
    np.testing.assert_allclose(np.linalg.norm(q[0] - q[1]), 1.0, atol=1e-14)
    assert abs((q[0] - q[1]) @ (v[0] - v[1])) < 1e-14
    assert scene.ground.measured(q).distance.min() >= -1e-9
    np.testing.assert_allclose(q, NODES, atol=0.01)
    np.testing.assert_allclose(v.mean(0), [0.5, 0.0, 0.2], atol=0.15)


def test_rigid_struts_on_the_move_start_so_at_shaken_supports():
    """In the middle of a motion in which nothing has to be corrected: a strut that grows, on a support that shakes."""
    gait, shaking = Gait((0,), [0.3], [0.2], [2.0], start=0.0, ramp=0.1), Shaking([0.05, 0.0, 0.0], 2.0, ramp=0.3)
    struts, cables = Members(((0, 1),), None, [1.0]), Members(((1, 2), (0, 2)), [100.0, 100.0], [0.5, 0.5])
    nodes = np.array([[0.0, 0, 1], [1, 0, 1], [0.5, 0.5, 0.3]])
    structure = Structure(nodes, [0.0, 1.0, 2.0], struts, cables, fixed=((0, "xyz"),))
    scene, times = Scene(structure, gravity=9.81, gait=gait, shaking=shaking), 0.43 + np.arange(9) / 1000
    support = np.array([nodes[0] + np.asarray(shaking.displacement(t)) for t in times])
    end = support + (1 - np.array([contraction(gait, t) for t in times])) * [[1.0, 0, 0]]
    path = np.stack([support, end, np.broadcast_to(nodes[2], support.shape)], axis=1)
    q, v = recorded_motion(scene, Recording(times, path)).state[0]
    np.testing.assert_allclose(q, path[0], atol=1e-6)
    assert abs(v[1, 0] - v[0, 0]) > 0.1
    np.testing.assert_allclose(v, (path[1] - path[0]) / 1e-3, atol=0.02)


def test_all_points_of_rigid_bodies_start_in_their_places():
    """Also those that follow the basic ones, wherever they were seen; the pose is as near to all as noise allows."""
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [0.3, 0.3, 0.3]])
    body = rigid_body(nodes, range(6), 2.0, [0.3, 0.3, 0.3])
    scene, times = Scene(Structure(nodes, np.zeros(6), bodies=(body,))), np.linspace(0, 0.1, 11)
    noise = np.random.default_rng(0).normal(0, 2e-3, (11, 6, 3))
    q = recorded_motion(scene, Recording(times, nodes + noise)).state[0][0]
    np.testing.assert_allclose(np.linalg.norm(q[:, None] - q, axis=2), np.linalg.norm(nodes[:, None] - nodes, axis=2))
    np.testing.assert_allclose(q, nodes, atol=5e-3)


def test_frames_that_fill_no_window_are_left_out():
    """Ten steps from frame to frame make three windows of three; noise counts in body lengths where none is given."""
    times = np.linspace(0, 0.1, 11)
    still = np.broadcast_to(HANGING.structure.nodes, (11, 2, 3))
    motion = recorded_motion(HANGING, Recording(times, still), windows=3)
    assert motion.times.shape == (3, 4)
    np.testing.assert_array_equal(motion.noise[0], 2e-3)
    assert np.isnan(motion.values[:, :3]).all()  # what is fixed is not measured
    with pytest.raises(InputError, match=r"noise = -1 m: expected"):
        recorded_motion(HANGING, Recording(times, still), -1.0)
    with pytest.raises(InputError, match="windows = 11"):
        recorded_motion(HANGING, Recording(times, still), windows=11)


def test_errors_are_distances_of_the_nodes_that_were_seen():
    """Root mean squares over nodes but supports; infinite after a simulation failed, and NaN where nothing was seen."""
    recorded = np.zeros((4, 3, 3))
    recorded[1:, 1, 0], recorded[2, 2], recorded[3, 1:] = 3.0, np.nan, np.nan
    simulated = np.zeros((4, 3, 3))
    simulated[1:, 2, 1] = 4.0
    found = Compared(np.arange(4.0), recorded, simulated, np.array([False, True, True]))
    np.testing.assert_allclose(found.errors(), [0, np.sqrt(25 / 2), 3, np.nan])
    np.testing.assert_allclose(found.moved(), [0, np.sqrt(9 / 2), 3, np.nan])
    assert [found.stays_within(x) for x in (1.0, 3.2, 4.0)] == [1.0, 1.0, 3.0]
    failed = found._replace(simulated=np.where(np.arange(4)[:, None, None] < 2, simulated, np.nan))
    np.testing.assert_allclose(failed.errors(), [0, np.sqrt(25 / 2), np.inf, np.nan])
    assert failed.stays_within(4.0) == 2.0


@pytest.mark.slow
def test_recorded_commands_move_the_robot_as_its_gait_does():
    """In place of it, to the error of straight lines between rows; without either, it stays where it hangs."""
    times, options = np.linspace(0, 0.5, 51), SolverOptions("rk4", dt=5e-3)
    gait = Gait((0,), [-np.pi / 2], [0.2], [1.0], start=0.0, ramp=0.1)
    structure = replace(HANGING.structure, nodes=np.array([[0.0, 0, 0], [0, 0, -1.1962]]))
    still = Recording(times, np.broadcast_to(structure.nodes, (51, 2, 3)))
    asked = Commands((0,), times, np.array([np.asarray(contraction(gait, t)) for t in times]))
    moving = beside_simulation(replace(HANGING, structure=structure, gait=gait), still, options=options)
    commanded = still._replace(commands=asked)
    other = replace(gait, amplitude=np.array([0.1]))
    for scene in (replace(HANGING, structure=structure), replace(HANGING, structure=structure, gait=other)):
        found = beside_simulation(scene, commanded, options=options)
        np.testing.assert_allclose(found.simulated, moving.simulated, atol=1e-4)
    assert moving.errors()[-1] > 0.05

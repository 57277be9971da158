"""MuJoCo models whose bodies `weld` holds to each other: they are read as MuJoCo has one body, and fly as there."""

import numpy as np
import pytest

from jaxgrity import InputError, SolverOptions, simulate
from jaxgrity.formats import read_mjcf

mujoco = pytest.importorskip("mujoco")

FREE = "<freejoint/>"
BALL = '<joint type="ball" pos="-0.1 0 0"/>'
SLIDES = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
BODY = """<body name="{name}" pos="{pos}" quat="{quat}">{joint}
<geom type="box" size="{size}" mass="{mass}" contype="0" conaffinity="0"/>
<site name="{name}0" pos="0.1 0.2 0.05"/><site name="{name}1" pos="-0.1 0 0"/>{inside}</body>"""
MODEL = """<mujoco><option timestep="1e-4" integrator="RK4"/><worldbody>
<site name="w" pos="0 0 1.5"/><site name="v" pos="0.5 0 1.9"/>{bodies}</worldbody><tendon>
<spatial stiffness="50" springlength="0 0.1"><site site="w"/><site site="a0"/></spatial>
<spatial stiffness="80" springlength="0 0.1"><site site="v"/><site site="b1"/></spatial>
<spatial stiffness="80" springlength="0 0.1"><site site="b0"/><site site="c1"/></spatial>
</tendon><equality>{equality}</equality></mujoco>"""
STIFF = 'solref="0.0002 1" solimp="0.9999 0.9999 0.001"'
WELD = f'<weld name="k" body1="a" body2="b" {STIFF}/>'


class Robot:
    """Three bodies in random poses."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.x = np.array([[0, 0, 1], [0.3, 0.1, 1.2], [0.6, -0.2, 0.9]]) + rng.uniform(-0.05, 0.05, (3, 3))
        self.turn = rng.normal(size=(3, 4)) / 2
        self.turn /= np.linalg.norm(self.turn, axis=1, keepdims=True)
        self.parts = [
            {"name": name, "size": text(rng.uniform(0.03, 0.2, 3)), "mass": mass}
            for name, mass in zip("abc", rng.uniform(1, 3, 3))
        ]

    def body(self, k, joint=FREE, inside="", within=None):
        """As MJCF; within another body its pose is relative to that one's."""
        x, turn = self.x[k].copy(), self.turn[k].copy()
        if within is not None:
            back = np.zeros(4)
            mujoco.mju_negQuat(back, self.turn[within])
            mujoco.mju_rotVecQuat(x, self.x[k] - self.x[within], back)
            mujoco.mju_mulQuat(turn, back, self.turn[k])
        return BODY.format(pos=text(x), quat=text(turn), joint=joint, inside=inside, **self.parts[k])

    def apart(self, equality, c=""):
        """Three bodies, and what holds them to each other."""
        return MODEL.format(bodies=self.body(0) + self.body(1) + (c or self.body(2)), equality=equality)

    def whole(self):
        """The second body is a part of the first."""
        first = self.body(0, inside=self.body(1, "", within=0))
        return MODEL.format(bodies=first + self.body(2), equality="")


def text(numbers):
    return " ".join(map(repr, np.asarray(numbers, float).tolist()))


def found(folder, model, **how):
    (folder / "robot.xml").write_text(model)
    return read_mjcf(folder / "robot.xml", **how)


def assert_same(ours, theirs):
    """Structures of the same nodes, bodies, supports and cables."""
    np.testing.assert_allclose(ours.nodes, theirs.nodes, atol=1e-12)
    assert (ours.fixed, ours.cables.edges) == (theirs.fixed, theirs.cables.edges)
    assert [list(body.points) for body in ours.bodies] == [list(body.points) for body in theirs.bodies]
    for one, other in zip(ours.bodies, theirs.bodies):
        np.testing.assert_allclose(one.matrix, other.matrix, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_two_welded_bodies_are_one(seed, tmp_path):
    """As heavy and as hard to turn as one body of both; so are those welded at sites, or in a given pose."""
    robot = Robot(seed)
    whole = found(tmp_path, robot.whole()).scene.structure
    assert len(whole.bodies) == 2
    scene, notes = found(tmp_path, robot.apart(WELD))
    assert_same(scene.structure, whole)
    assert "1 welds make one body of two" in notes
    assert any("connect and weld give way there" in note for note in notes)
    model = mujoco.MjModel.from_xml_string(robot.apart(WELD))
    given = WELD.replace("/>", f' relpose="{text(model.eq_data[0, 3:10])}"/>')
    assert_same(found(tmp_path, robot.apart(given)).scene.structure, whole)
    places = [f'<site name="{s}" pos="{text(x)}" quat="{text(q)}"/>' for s, x, q in two_sites(robot)]
    at_sites = robot.apart(f'<weld site1="s" site2="t" {STIFF}/>')
    at_sites = at_sites.replace('<site name="a0"', places[0] + '<site name="a0"')
    at_sites = at_sites.replace('<site name="b0"', places[1] + '<site name="b0"')
    sites = found(tmp_path, at_sites).scene.structure
    np.testing.assert_allclose(sites.mass, whole.mass)
    assert len(sites.bodies) == 2


def two_sites(robot):
    """One frame of the world, 0.1 m above the origin of the first body, in both bodies."""
    for name, k in (("s", 0), ("t", 1)):
        back, x = np.zeros(4), np.zeros(3)
        mujoco.mju_negQuat(back, robot.turn[k])
        mujoco.mju_rotVecQuat(x, robot.x[0] + [0, 0, 0.1] - robot.x[k], back)
        yield name, x, back


def test_welded_to_the_world_it_is_a_support(tmp_path):
    """Directly, or by another body; a body within another that is welded to it is a part of it."""
    robot = Robot(0)
    fast = MODEL.format(bodies=robot.body(0) + robot.body(1, "") + robot.body(2), equality="")
    held = robot.apart(f'<weld body1="b" {STIFF}/>')
    assert_same(found(tmp_path, held).scene.structure, found(tmp_path, fast).scene.structure)
    both = MODEL.format(bodies=robot.body(0, "") + robot.body(1, "") + robot.body(2), equality="")
    chain = robot.apart(f'<weld body1="b" {STIFF}/>{WELD}')
    assert_same(found(tmp_path, chain).scene.structure, found(tmp_path, both).scene.structure)
    for joint in (BALL, SLIDES):
        inside = robot.body(0, inside=robot.body(1, joint, within=0)) + robot.body(2)
        welded = found(tmp_path, MODEL.format(bodies=inside, equality=WELD))
        assert_same(welded.scene.structure, found(tmp_path, robot.whole()).scene.structure)


def test_joints_of_welded_bodies_are_theirs(tmp_path):
    """A body that hangs on another by a ball joint, with a third that is welded to it."""
    robot = Robot(1)
    hangs = robot.body(0, inside=robot.body(1, BALL, within=0)) + robot.body(2)
    welded = MODEL.format(bodies=hangs, equality=f'<weld body1="c" body2="b" {STIFF}/>')
    part = robot.body(1, BALL, robot.body(2, "", within=1), within=0)
    plain = found(tmp_path, MODEL.format(bodies=robot.body(0, inside=part), equality="")).scene.structure
    ours = found(tmp_path, welded).scene.structure
    assert_same(ours, plain)
    assert len(ours.bodies) == 2


def test_what_does_not_hold_is_ignored(tmp_path):
    """Welds that are not active, and all equalities where a flag disables them."""
    robot = Robot(2)
    for model in (
        robot.apart(WELD.replace("/>", ' active="false"/>')),
        robot.apart(WELD).replace('"RK4"/>', '"RK4"><flag equality="disable"/></option>'),
    ):
        scene, notes = found(tmp_path, model)
        assert len(scene.structure.bodies) == 3
        assert not any("weld" in note for note in notes)


@pytest.mark.parametrize("kind", ["weld", "connect"])
def test_how_far_it_gives_way_is_named(kind, tmp_path):
    """As far as MuJoCo moves a body that it holds to the world, in the reach of a robot; a soft one is refused."""
    robot = Robot(0)
    arm = "" if kind == "weld" else 'anchor="0 0 0.1"'
    held = robot.apart(f'<{kind} body1="a" {arm} solref="0.01 1" solimp="0.98 0.98 0.001"/>')
    (said,) = (note for note in found(tmp_path, held).notes if note.startswith("connect and weld give way there"))
    model = mujoco.MjModel.from_xml_string(held)
    data, (place, turn) = mujoco.MjData(model), ([], [])
    mujoco.mj_kinematics(model, data)
    point, start = [0, 0, 0.1 * (kind == "connect")], data.xquat[1].copy()
    x = data.xpos[1] + data.xmat[1].reshape(3, 3) @ point
    for _ in range(5000):
        mujoco.mj_step(model, data)
        place.append(np.abs(data.xpos[1] + data.xmat[1].reshape(3, 3) @ point - x).max())
        turned = np.zeros(3)
        mujoco.mju_subQuat(turned, data.xquat[1], start)
        turn.append(np.abs(turned).max() * model.stat.extent * (kind == "weld"))
    assert float(said.split()[9]) == pytest.approx(max(*place, *turn), rel=0.5)
    with pytest.raises(InputError, match=r"equality 0: gives way by .* m of .*drop=\['forces'\]"):
        found(
            tmp_path, held.replace('solref="0.01 1" solimp="0.98 0.98 0.001"', 'solref="0.3 1" solimp="0.3 0.3 0.001"')
        )


FOOT = '<geom type="sphere" size="0.05" pos="0 0 -0.3" mass="0.1" friction="0.6"/>'


@pytest.mark.parametrize("base", ["", FREE, BALL])
def test_what_hangs_on_a_support_touches_the_plane(base, tmp_path):
    """On a body without a joint, and on one that is welded to the world, which is turned."""
    robot = Robot(0)
    floor = '<geom type="plane" size="5 5 1" pos="0 0 -3" friction="0.1"/>'
    arm = robot.body(1, BALL, FOOT, within=0)
    text = MODEL.format(bodies=floor + robot.body(0, base, arm) + robot.body(2), equality=f'<weld body1="a" {STIFF}/>')
    scene = found(tmp_path, text).scene
    assert len(scene.ground.balls.nodes) == 1
    assert float(np.max(scene.friction.mu)) == 0.6
    assert_same(scene.structure, found(tmp_path, text.replace(base, "", 1)).scene.structure)


HOLLOW = '<geom type="sphere" size="0.3" mass="0"/><site name="{name}0"'


def test_welded_bodies_pass_through_each_other(tmp_path):
    """Their contact is within one body, and moves nothing; what else would touch at the start is refused."""
    robot = Robot(0)
    model = robot.apart(WELD)
    for name in "ab":
        model = model.replace(f'<site name="{name}0"', HOLLOW.format(name=name))
    scene, _ = found(tmp_path, model)
    assert_same(scene.structure, found(tmp_path, robot.whole()).scene.structure)
    with pytest.raises(InputError, match="bodies a and b touch each other at the start"):
        found(tmp_path, model.replace(WELD, ""))


REFUSED = {
    "another place": (WELD.replace("/>", ' relpose="0.1 0 0 1 0 0 0"/>'), "equality k: holds its bodies 0."),
    "a bit aside": (WELD, "equality k: holds its bodies 1e-05 m and "),
    "free to turn": (WELD.replace("/>", ' torquescale="0"/>'), "equality k: a weld with torquescale 0 lets its bodies"),
    "soft": (WELD.replace(STIFF, 'solref="0.5 1"'), "(solref, solimp), which would be lost; drop=['forces']"),
    "a slide": (WELD.replace('"b"', '"c"'), "equality k: welds body c, which slides, to another"),
    "of joints": ('<joint name="k" joint1="j"/>', "equality k: a joint is not read; expected connect or weld"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_another_pose_is_refused(case, tmp_path):
    """In one line, which says how far away it is; so are welds that lock slides, soft ones, and other equalities."""
    equality, reason = REFUSED[case]
    robot = Robot(3)
    model = robot.apart(
        equality, robot.body(2, SLIDES.replace("joint ", 'joint name="j" ', 1) if "j" in case else FREE)
    )
    if case == "a slide":
        model = robot.apart(equality, robot.body(2, SLIDES))
    if case == "a bit aside":
        pose = mujoco.MjModel.from_xml_string(model).eq_data[0, 3:10] + [1e-5, 0, 0, 0, 0, 0, 0]
        model = model.replace(equality, equality.replace("/>", f' relpose="{text(pose)}"/>'))
    with pytest.raises(InputError) as caught:
        found(tmp_path, model)
    assert reason in str(caught.value)
    assert str(caught.value).isprintable()


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.campaign)])
def test_welded_bodies_fly_as_in_mujoco(seed, tmp_path):
    """Half a second with stiff welds: within 1e-6 m, and without the weld they would be elsewhere."""
    robot = Robot(seed)
    scene, _ = found(tmp_path, robot.apart(WELD))
    ends = []
    for model in (mujoco.MjModel.from_xml_string(robot.apart(equality)) for equality in (WELD, "")):
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        start = data.site_xpos.copy()
        mujoco.mj_step(model, data, 5000)
        mujoco.mj_kinematics(model, data)
        ends.append(data.site_xpos.copy())
    nodes = np.asarray(scene.structure.nodes)
    own = [int(np.argmin(np.linalg.norm(nodes - x, axis=1))) for x in start]
    end = np.asarray(simulate(scene, 0.5, options=SolverOptions(dt=1e-4), frame_rate=2.0).positions[-1])[own]
    np.testing.assert_allclose(end, ends[0], rtol=0, atol=1e-6)
    assert np.abs(ends[1] - ends[0]).max() > 0.1

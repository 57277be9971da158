"""MuJoCo models of many hands: what touches how, limits, damping, actuators. What is lost is refused, or named."""

import dataclasses

import numpy as np
import pytest

from jaxgrity import InputError, SolverOptions, simulate
from jaxgrity.formats import read_mjcf, save_mjcf

mujoco = pytest.importorskip("mujoco")

LOW = 0.2 * np.array([[np.cos(a), np.sin(a), 0.0] for a in 2 * np.pi / 3 * np.arange(3)])
TOP = 0.2 * np.array([[np.cos(a), np.sin(a), 0.0] for a in 2 * np.pi / 3 * (np.arange(3) + 1) + np.pi / 6])
ROD = '<geom name="g{k}" type="capsule" size="{radius}" fromto="{a} {b}" mass="0.3"/>'
CABLE = """<spatial name="c{k}" stiffness="400" damping="2" springlength="0 {rest:.6f}">
<site site="{i}"/><site site="{j}"/></spatial>"""
# by these masks, bodies touch the plane, but not each other
MODEL = """<mujoco><option timestep="0.0005"/><default><geom contype="0"/></default><worldbody>
<geom name="floor" type="plane" size="1 1 1" contype="1"/>{bodies}</worldbody><tendon>{tendons}</tendon></mujoco>"""
UNTOUCHED = ROD.replace("/>", ' contype="0" conaffinity="0"/>')


def prism(radius=0.01, geoms=ROD, joint="<freejoint/>", above=0.05, apart=0.0):
    """Three rods that nine cables hold, as MJCF: capsules, unless told otherwise, `above` (m) the floor."""
    low, top = LOW + np.array([0, 0, above]), TOP + np.array([0, 0, above + 0.3])
    bodies = tendons = ""
    for k, (a, b) in enumerate(zip(low, top)):
        a, b = ("{:.9f} {:.9f} {:.9f}".format(*x) for x in (a, b))
        geom = geoms.format(k=k, radius=radius + apart * k, a=a, b=b)
        sites = f'<site name="a{k}" pos="{a}"/><site name="b{k}" pos="{b}"/>'
        bodies += f'<body name="rod{k}">{joint}{geom}{sites}</body>'
    x = {**{f"a{k}": low[k] for k in range(3)}, **{f"b{k}": top[k] for k in range(3)}}
    pairs = [(f"{s}{k}", f"{s}{(k + 1) % 3}") for s in "ab" for k in range(3)] + [
        (f"a{k}", f"b{(k - 1) % 3}") for k in range(3)
    ]
    for k, (i, j) in enumerate(pairs):
        tendons += CABLE.format(k=k, rest=0.8 * np.linalg.norm(x[i] - x[j]), i=i, j=j)
    return MODEL.format(bodies=bodies, tendons=tendons)


@pytest.fixture
def read(tmp_path):
    """Of a model's text."""

    def from_text(text, **how):
        path = tmp_path / "robot.xml"
        path.write_text(text)
        return read_mjcf(path, **how)

    return from_text


def with_pairs(mu, text):
    pairs = "".join(f'<pair geom1="floor" geom2="g{k}" friction="{mu} {mu}"/>' for k in range(3))
    return text.replace("</mujoco>", f"<contact>{pairs}</contact></mujoco>")


def with_actuator(element, text):
    return text.replace("</mujoco>", f"<actuator>{element}</actuator></mujoco>")


BALLS = ROD.replace("capsule", "cylinder").replace("{radius}", "0.004") + "".join(
    f'<geom type="sphere" size="{{radius}}" pos="{{{end}}}" mass="0.05"/>' for end in "ab"
)


def settled_heights(text, found):
    """z of the robot's sites after 3 s, there and here, by the plane that each has."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    below = data.site_xpos[0, 2] - found.scene.structure.nodes[0, 2]
    mujoco.mj_step(model, data, 6000)
    end = np.asarray(simulate(found.scene, 3.0, frame_rate=1.0).positions[-1])
    return data.site_xpos[:, 2], end[:, 2] + below


@pytest.mark.slow
def test_settled_heights_are_those_of_mujoco(read):
    """Capsules in pairs with slippery ground, and balls without friction: within 2 mm of MuJoCo's soft contact.

    A radius that is not read makes 10 and 30 mm. With more friction feet rest where each engine's law leaves them.
    """
    balls = prism(0.03, BALLS).replace(FLOOR, FLOOR + ' condim="1" priority="1"')
    for text in (with_pairs(0.1, prism()), balls):
        theirs, ours = settled_heights(text, read(text))
        assert np.sort(theirs)[2] < 0.04
        np.testing.assert_allclose(ours.mean(), theirs.mean(), rtol=0, atol=2e-3)


def test_the_radius_is_that_of_what_touches(read):
    """Of capsules and balls; thin rods between balls do not count. Notes name a radius where there is one."""
    for text, radius in ((prism(0.01), 0.01), (prism(0.03, BALLS), 0.03)):
        scene, notes = read(text)
        np.testing.assert_allclose(scene.structure.nodes[:, 2].min(), 0.05 - radius, atol=1e-9)
        assert any(f"has a radius of {radius:g} m" in note for note in notes)
    shifted = prism().replace('type="plane"', 'type="plane" pos="0 0 -0.2"')
    np.testing.assert_allclose(read(shifted).scene.structure.nodes[:, 2].min(), 0.24, atol=1e-9)
    scene, _ = read(prism(0.01, ROD.replace("/>", ' margin="0.004"/>')))
    np.testing.assert_allclose(scene.structure.nodes[:, 2].min(), 0.036, atol=1e-9)


def test_no_radius_is_named_where_there_is_none(read):
    """Nothing is said of spheres that are not there, or of a move by 0 m; without contact there is no ground."""
    scene, notes = read(prism(geoms=UNTOUCHED))
    assert scene.ground is None
    assert "nothing touches the plane: the scene has no ground" in notes
    assert not any("radius" in note or "moved" in note for note in notes)


def test_friction_is_what_mujoco_combines(read):
    """Of pairs, of the rougher of two, of the one with priority; none where contact has one dimension; by rods."""
    rough = prism().replace(FLOOR, FLOOR + ' friction="0.4"').replace('size="0.01"', 'size="0.01" friction="0.7"')
    first = rough.replace(FLOOR, FLOOR + ' priority="1"')
    smooth = first.replace('priority="1"', 'priority="1" condim="1"')
    for text, mu in ((with_pairs(0.1, prism()), 0.1), (rough, 0.7), (first, 0.4), (smooth, 0.0), (prism(), 1.0)):
        assert float(read(text).scene.friction.mu) == mu
    two = rough.replace('friction="0.7"', 'friction="0.2"', 1)
    np.testing.assert_array_equal(read(two).scene.friction.mu, [0.4, 0.4, 0.7, 0.7, 0.7, 0.7])


DROPPED = """<mujoco><option timestep="1e-4"/><worldbody><geom type="plane" size="1 1 1" {spring}/>
<body pos="0 0 0.2"><freejoint/><geom size="0.02" mass="0.2" {spring}/></body></worldbody></mujoco>"""


def bounced(text):
    """The share of its speed with which the first body of a MuJoCo model bounces off the ground."""
    model = mujoco.MjModel.from_xml_string(text)
    data, speeds = mujoco.MjData(model), []
    for _ in range(4000):
        mujoco.mj_step(model, data)
        speeds.append(data.qvel[2])
    hit = int(np.argmin(speeds))
    return max(speeds[hit:]) / -speeds[hit]


@pytest.mark.parametrize("spring", ["", 'solref="0.02 0.7"', 'solref="0.02 2"', 'solref="-10000 -150"'])
def test_what_contact_gives_back_is_named(spring, read):
    """Once, for the share of its speed with which a ball that MuJoCo drops bounces off; 14 % by default."""
    scene, notes = read(prism().replace('type="plane"', f'type="plane" priority="1" {spring}'))
    (said,) = (note for note in notes if note.startswith("contact bounces off the plane at "))
    assert float(said.split()[6]) == pytest.approx(bounced(DROPPED.format(spring=spring)), rel=0.05)
    assert scene.ground.restitution is None


@pytest.mark.parametrize("spring", ['solref="-5000 -50"', 'solref="0.02 0.2"'])
@pytest.mark.parametrize("geoms", [ROD, BALLS])
def test_a_large_rebound_is_the_grounds_restitution(spring, geoms, read, tmp_path):
    """That of a ball that MuJoCo drops; written, MuJoCo drops a ball as before."""
    scene, notes = read(prism(geoms=geoms).replace('type="plane"', f'type="plane" priority="1" {spring}'))
    there = bounced(DROPPED.format(spring=spring))
    assert 0.3 < there < 0.7
    assert float(scene.ground.restitution) == pytest.approx(there, rel=0.05)
    assert any(note.endswith("which is the ground's restitution here") for note in notes)
    text = save_mjcf(scene, tmp_path / "written.xml").xml
    solref = text.split('solref="')[1].split('"')[0]
    assert bounced(DROPPED.format(spring=f'priority="1" solref="{solref}"')) == pytest.approx(there, rel=0.02)
    assert float(read(text).scene.ground.restitution) == pytest.approx(float(scene.ground.restitution), rel=1e-6)


BOUNCING = """<mujoco><option timestep="1e-4"/><worldbody><geom type="plane" size="1 1 1"/><site name="w" pos="0 0 9"/>
<body pos="0 0 0.3"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
<joint type="slide" axis="0 0 1"/><geom size="0.02" mass="0.2" priority="1" solref="-1e6 -800"/><site name="a"/></body>
</worldbody><tendon><spatial stiffness="9" springlength="0 20"><site site="a"/><site site="w"/></spatial></tendon>
</mujoco>"""


@pytest.mark.campaign
def test_a_ball_bounces_as_in_mujoco(read):
    """Its height a second later, after several bounces, within the time that contact lasts there."""
    scene = read(BOUNCING).scene
    model = mujoco.MjModel.from_xml_string(BOUNCING)
    data, heights = mujoco.MjData(model), []
    for _ in range(8000):
        mujoco.mj_step(model, data)
        heights.append(0.3 + data.qpos[2])
    motion = simulate(scene, 0.8, options=SolverOptions(dt=1e-3), frame_rate=100.0)
    node = int(np.argmin(np.asarray(scene.structure.nodes)[:, 2]))
    ours = np.asarray(motion.positions[1:, node, 2]) + 0.02
    theirs = np.array(heights)[99::100]
    assert np.sum(np.diff(np.sign(np.diff(theirs))) > 0) >= 2  # bounces
    assert np.abs(ours - theirs[: len(ours)]).max() < 0.01


SLIDING = """<mujoco><option cone="{cone}"/><worldbody><geom type="plane" size="1 1 1" friction="0.5"/>
<body pos="0 0 0.1"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
<joint type="slide" axis="0 0 1"/><geom size="0.1" mass="1" friction="0.5"/></body></worldbody></mujoco>"""


def test_a_pyramid_of_friction_is_named(read):
    """By as much as MuJoCo's is weaker between its tangents: a ball slides farther there. A cone is read as it is."""
    weaker = []
    for cone in ("pyramidal", "elliptic"):
        model = mujoco.MjModel.from_xml_string(SLIDING.format(cone=cone))
        slid = []
        for way in ([1.0, 0.0], [0.5**0.5, 0.5**0.5]):
            data = mujoco.MjData(model)
            data.qvel[:2] = way
            mujoco.mj_step(model, data, 1000)
            slid.append(np.hypot(*data.qpos[:2]))
        weaker.append(1 - slid[0] / slid[1])
        notes = read(prism().replace("<option", f'<option cone="{cone}"')).notes
        said = [float(note.split("up to ")[1].split()[0]) for note in notes if "friction there is a pyramid" in note]
        assert said == ([pytest.approx(100 * weaker[0], abs=1)] if cone == "pyramidal" else [])
    assert abs(weaker[1]) < 1e-3


BALL = '<geom type="sphere" size="SIZE" pos="0.{k} 0.3 0.2" mass="0" MASKS/>'
MEETING = 'contype="2" conaffinity="2"'
BOX = '<geom type="box" size="0.01 0.01 0.01" pos="{a}" mass="0"/>'
HILL = '<geom type="ellipsoid" size="1 1 0.1" pos="1 0 0" contype="1"/>'
MOVED = '<body mocap="true" pos="1 0 0"><geom type="box" size="1 1 0.1" contype="1"/></body>'
FLOOR, TENDON, SPRING = 'size="1 1 1"', 'name="c0"', 'stiffness="400"'
SERVO = '<position tendon="c0" kp="100"/>'
WEAK = '<general tendon="c0" gainprm="600" biastype="affine" biasprm="60 -600 -6" forcerange="-20 20"/>'
ROLLING = FLOOR + ' condim="6" friction="1 0.005 0.1"'
STIFF = ' solmix="1e6"'
SLACK = prism().replace(SPRING, 'stiffness="0"', 1)
MOTOR = '<motor tendon="c0" ctrlrange="1 9" ctrllimited="true"/>'
REFUSED = {
    "radii": (prism(apart=0.005), "radius", "radii from 0.01 to 0.02 m"),
    "cylinders": (prism(geoms=ROD.replace("capsule", "cylinder")), "radius", "the rims of a cylinder of 0.01 m"),
    "a ball elsewhere": (
        prism(geoms=ROD + BALL.replace("SIZE", "0.02").replace("MASKS", "")), "contact", "where its body has no site",
    ),
    "corners": (prism(geoms=UNTOUCHED + BOX), "contact", "where its body has no site"),
    "one end": (prism(geoms=UNTOUCHED + BALLS.split("/>")[1] + "/>"), "contact", "touches nothing, but nodes touch"),
    "a hill": (prism().replace("<body", HILL + "<body", 1), "contact", "bodies touch what stands beside the plane"),
    "a moved step": (
        prism().replace("<body", MOVED + "<body", 1), "contact", "bodies touch what stands beside the plane",
    ),
    "overlaps": (
        prism(geoms=ROD + BALL.replace("SIZE", "0.2").replace("MASKS", MEETING)),
        "contact",
        "touch each other at the start",
    ),
    "inside the plane": (prism(above=-0.05), "contact", "inside the plane"),
    "directions": (with_pairs(0.1, prism()).replace('"0.1 0.1"', '"0.1 0.3"', 1), "friction", "along two tangents"),
    "rolling friction": (prism().replace(FLOOR, ROLLING), "friction", "against what rolls, with an arm of 0.1 m"),
    "other rebounds": (
        prism().replace('name="g1"', 'name="g1" priority="1" solref="-5000 -2"'),
        "contact",
        "geom g1: bounces off the plane at 0.96 times its speed (solref), and geom g0 at 0.14 times",
    ),
    "a soft floor": (prism().replace(FLOOR, FLOOR + STIFF + ' solref="0.5 1"'), "contact", "some 0.1 m into the plane"),
    "a limit": (prism().replace(TENDON, TENDON + ' limited="true" range="0 0.3"'), "limits", "limited to 0 to 0.3 m"),
    "dry friction": (prism().replace(TENDON, TENDON + ' frictionloss="1"'), "friction", "tendon c0: dry friction"),
    "damped bodies": (prism(joint='<joint type="free" damping="0.5"/>'), "damping", "its joint has damping, and"),
    "inertia": (prism(joint='<joint type="free" armature="0.5"/>'), "forces", "armature"),
    "air": (prism().replace("<option", '<option density="1.2" viscosity="2e-5"'), "air", "air of 1.2 kg/m^3"),
    "floats": (prism().replace('name="rod1"', 'name="rod1" gravcomp="1"'), "forces", "rod1: gravity compensation"),
    "a motor": (with_actuator(MOTOR, prism()), "actuators", "tendon c0: its actuators push with 1 N; a cable only"),
    "a servo": (with_actuator(SERVO, SLACK), "actuators", "actuator 0: has the rest length 0 at control 0"),
    "a weak spring": (with_actuator(WEAK, SLACK), "limits", "limited to the -20 N of the start"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "kind", "reason"), REFUSED.values(), ids=REFUSED)
def test_another_motion_is_refused_unless_it_may_be(text, kind, reason, read):
    """In one line that names what would be lost; dropped, a note says what was."""
    with pytest.raises(InputError) as caught:
        read(text)
    assert reason in str(caught.value)
    assert f"drop=['{kind}']" in str(caught.value)
    found = read(text, drop=[kind])
    assert any(note.startswith("dropped: ") and reason in note for note in found.notes)


LINES = {
    "air": ("<option", '<option density="1.2"', "line 1: air of 1.2 kg/m^3"),
    "flags": ("<worldbody>", '\n<option><flag spring="disable"/></option><worldbody>', "line 2: option flag spring is"),
    "the plane": ("<option", '<option gravity="0 0 9"', "line 2: the plane's normal is ["),
    "bodies": (ROD, ROD + BALL.replace("SIZE", "0.2").replace("MASKS", MEETING), "line 2: bodies rod0 and rod1 touch"),
    "an equality": (
        "</mujoco>",
        '\n<equality><tendon name="e" tendon1="c0"/></equality></mujoco>',
        f"line {2 + prism().count(chr(10))}: equality e: a tendon is not read; expected connect or weld",
    ),
}


@pytest.mark.parametrize(("old", "new", "said"), LINES.values(), ids=LINES)
def test_refusals_name_the_line(old, new, said, read):
    """Of elements without a name, too."""
    text = prism(geoms=new) if old == ROD else prism().replace(old, new, 1)
    with pytest.raises(InputError) as caught:
        read(text)
    assert f"robot.xml: {said}" in str(caught.value)


def test_what_has_no_effect_is_a_note(read):
    """Lags, keyframes, bodies that are not joined, damping while slack."""
    spring = '<general tendon="c0" gainprm="600" biastype="affine" biasprm="60 -600 -6" {more}/>'
    lagging = spring.format(more='dyntype="filter" dynprm="0.1" forcerange="-900 900"')
    text = with_actuator(lagging, SLACK)
    text = text.replace("</mujoco>", '<keyframe><key time="1"/></keyframe></mujoco>')
    scene, notes = read(text)
    for said in (
        "actuator 0: lags behind its control there",
        "its force is limited to -900 to 900 N there",
        "bodies start where they are placed: 0, at the controls nearest to 0; --keyframe 0 starts in that one",
        "the damping of tendons acts there while they are slack, too",
    ):
        assert any(said in note for note in notes), said
    (dampers,) = scene.terms  # of cables that go slack in the motion that MuJoCo is asked for
    assert (scene.structure.cables.damping + dampers.damping).tolist() == pytest.approx([6 + 2, *[2] * 8])
    assert 0 < np.count_nonzero(dampers.damping) < 9
    # the control that is nearest to 0 within its range counts
    filtered = 'dyntype="filter" dynprm="0.1" actlimited="true" actrange="0.05 0.2"'
    for more in ('ctrlrange="0.05 0.2"', filtered):
        moved = with_actuator(spring.format(more=more), SLACK)
        np.testing.assert_allclose(read(moved).scene.structure.cables.rest_length[0], 0.15)
    other = '<body name="other" pos="0 0 1"><freejoint/><geom size="0.1" contype="0" conaffinity="0"/></body>'
    assert (
        "1 bodies that no tendon moves are left out: other" in read(prism().replace("<body", other + "<body", 1)).notes
    )


def test_dry_friction_that_is_disabled_is_no_loss(read):
    """By the option's flag, as in public models of a real robot."""
    text = prism().replace(TENDON, TENDON + ' frictionloss="1"')
    read(text.replace("<worldbody>", '<option><flag frictionloss="disable"/></option><worldbody>', 1))


def test_kinds_that_may_be_dropped_are_named(read):
    """An unknown one is refused with the list, and a text in the place of a list."""
    for drop in (["wheels"], "radius"):
        with pytest.raises(InputError, match="expected a list of some of contact, radius, friction, limits"):
            read(prism(), drop=drop)


def caps(sites):
    """The prism with balls of 3 cm, at which cables end beside the rods' axes, at places `sites` (m) from the ends."""
    text = prism(0.03, BALLS)
    for k, (a, b) in enumerate(zip(LOW + np.array([0, 0, 0.05]), TOP + np.array([0, 0, 0.35]))):
        for name, end in ((f"a{k}", a), (f"b{k}", b)):
            old, new = ('pos="{:.9f} {:.9f} {:.9f}"'.format(*x) for x in (end, end + sites))
            text = text.replace(
                f'<site name="{name}" {old}/>', f'<site name="{name}" {new}/><site name="{name}x" {old}/>'
            )
    return text


@pytest.mark.campaign
def test_end_caps_fly_as_in_mujoco(read):
    """Bodies whose cables end beside their axes are rigid bodies: free flight as there, to the error of the step."""
    text = caps([0.02, 0.01, 0.015])
    scene, notes = read(text)
    assert (len(scene.structure.bodies), scene.structure.struts) == (3, None)
    assert any("6 balls of 0.03 m touch the plane, and roll" in note for note in notes)
    assert len(scene.ground.balls.nodes) == 6
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.gravity[:] = 0
    model.geom_contype[:] = model.geom_conaffinity[:] = 0
    model.opt.timestep, model.opt.integrator = 1e-4, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start, nodes = data.site_xpos.copy(), np.asarray(scene.structure.nodes)
    order = [int(np.argmin(np.linalg.norm(nodes - nodes[0] + start[0] - x, axis=1))) for x in start]
    mujoco.mj_step(model, data, 2000)
    mujoco.mj_kinematics(model, data)
    flying = dataclasses.replace(scene, ground=None, friction=None, gravity=None)
    errors = []
    for dt in (1e-3, 5e-4):
        end = np.asarray(simulate(flying, 0.2, options=SolverOptions(dt=dt), frame_rate=5.0).positions[-1])[order]
        errors.append(np.abs(end - nodes[order] + start - data.site_xpos).max())
    assert errors[1] < 1e-5
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)

"""MuJoCo models of several files, with joints, with places in the world: the same robots as written plainly."""

import re

import numpy as np
import pytest

from jaxgrity import InputError, simulate
from jaxgrity.formats import read_mjcf

mujoco = pytest.importorskip("mujoco")

BODY = """<body name="{name}" pos="{pos}" {turn}>{joint}
<geom type="box" size="0.1 0.2 0.05" mass="2" contype="0" conaffinity="0"/>
<site name="{name}0" pos="0.1 0.2 0.05"/><site name="{name}1" pos="-0.1 0 0"/>{inside}</body>"""
MODEL = """<mujoco>{first}<option timestep="0.0005"/>
<worldbody><site name="w" pos="0 0 1.5"/>{bodies}</worldbody>
<tendon><spatial stiffness="50" springlength="0 0.4"><site site="w"/><site site="a0"/></spatial></tendon>
{last}</mujoco>"""
BALL, HINGE = '<joint type="ball" pos="-0.1 -0.2 0"/>', '<joint pos="-0.1 -0.2 0" axis="0.6 0 0.8"/>'


def body(name="a", pos="0 0 1", joint="<freejoint/>", turn="", inside=""):
    return BODY.format(name=name, pos=pos, joint=joint, turn=turn, inside=inside)


def model(bodies, first="", last=""):
    return MODEL.format(bodies=bodies, first=first, last=last)


def found(folder, text, **how):
    (folder / "robot.xml").write_text(text)
    return read_mjcf(folder / "robot.xml", **how)


CONNECT = '<equality><connect body1="a" body2="b" anchor="-0.1 -0.2 0"/></equality>'
JOINED = {
    "a ball on the world": (model(body(joint=BALL)), 1),
    "a hinge on the world": (model(body(joint=HINGE)), 2),
    "a hinge on a ball": (model(body(joint=BALL, inside=body("b", "0.1 0.2 0", HINGE))), 3),
    # six points, of which a body has at most four: the axes are parallel
    "three hinges": (
        model(
            body(inside="".join(body(*each, HINGE) for each in zip("bcd", ("0.1 0.2 0", "-0.1 0.3 0", "0 -0.3 0.1"))))
        ),
        6,
    ),
    "connect": (model(body() + body("b", "-0.3 -0.5 1", turn='euler="0 0 40"'), last=CONNECT), 1),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "points"),
    [pytest.param(*case, marks=[pytest.mark.campaign] * ("world" in name), id=name) for name, case in JOINED.items()],
)
def test_joined_bodies_move_as_in_mujoco(text, points, tmp_path):
    """Under gravity and a spring, for 0.3 s: sites within a millimetre of a motion of decimetres."""
    scene, notes = found(tmp_path, text)
    assert any(f"{points} points of joints are rigid" in note for note in notes)
    there = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(there)
    mujoco.mj_forward(there, data)
    start = data.site_xpos.copy()
    nodes = np.asarray(scene.structure.nodes)
    own = [int(np.argmin(np.linalg.norm(nodes - x, axis=1))) for x in start]
    np.testing.assert_allclose(nodes[own], start, atol=1e-9)
    mujoco.mj_step(there, data, 600)
    end = np.asarray(simulate(scene, 0.3, frame_rate=10.0).positions[-1])[own]
    assert np.linalg.norm(data.site_xpos - start, axis=1).max() > 0.05
    np.testing.assert_allclose(end, data.site_xpos, rtol=0, atol=1e-3)


def test_a_hinge_whose_mass_is_in_welded_bodies_is_read_as_that_of_one_body(tmp_path):
    """The massless parts between an axle and its wheel are part of that one body."""
    plain = body(joint='<joint pos="0 0 0.4" axis="1 0 0"/>')
    geom = plain[plain.index("<geom") : plain.index("<site")]
    apart = plain.replace(geom, f"<body>{geom}</body>")
    whole, welded = (found(tmp_path, model(text)).scene.structure for text in (plain, apart))
    np.testing.assert_allclose(welded.nodes, whole.nodes, rtol=0, atol=1e-12)
    assert welded.fixed == whole.fixed
    np.testing.assert_allclose(welded.bodies[0].matrix, whole.bodies[0].matrix, rtol=1e-9, atol=1e-12)


def test_included_files_are_read_in_their_places(tmp_path):
    """And pictures are left out, with the files that they need; messages name the line of the file that was given."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "sky.xml").write_text(
        '<mujoco><asset><texture name="s" type="2d" file="none.png"/><material name="m" texture="s"/></asset></mujoco>'
    )
    (tmp_path / "parts" / "body.xml").write_text(f"<mujocoinclude>{body()}</mujocoinclude>")
    plain = found(tmp_path, model(body())).scene.structure
    text = model('<include file="parts/body.xml"/>', '<include file="parts/sky.xml"/>')
    apart = found(tmp_path, text.replace("<site ", '<site material="m" ', 1)).scene.structure
    np.testing.assert_array_equal(apart.nodes, plain.nodes)
    np.testing.assert_array_equal(apart.bodies[0].matrix, plain.bodies[0].matrix)
    wrong = text.replace("<spatial ", '<spatial colour="red" ')
    with pytest.raises(ValueError, match=r"unrecognized attribute: 'colour'.*line 3"):
        found(tmp_path, wrong)
    (tmp_path / "all.xml").write_text('<mujoco>\n<option/>\n<include file="robot.xml"/></mujoco>')
    with pytest.raises(ValueError, match=r"unrecognized attribute: 'colour'.*line 3"):
        read_mjcf(tmp_path / "all.xml")
    limited = text.replace("<spatial ", '<spatial name="t&amp;t" limited="true" range="0 0.5" ')
    with pytest.raises(InputError, match=r"robot.xml: line 3: tendon t&t: its length is limited to 0 to 0.5 m, .*drop"):
        found(tmp_path, limited)


def test_global_coordinates_are_read(tmp_path):
    """As MuJoCo took them before version 2.3.4: places in the world, whatever the body's is."""
    placed = model(body(pos="0 0 0")).replace('mass="2"', 'mass="2" pos="0 0 0"')
    text = placed.replace("<option", '<compiler coordinate="global"/><option')
    text = text.replace('<body name="a" pos="0 0 0"', '<body name="a" pos="3 2 1" euler="10 20 30"')
    local, everywhere = (found(tmp_path, each).scene.structure for each in (placed, text))
    np.testing.assert_allclose(everywhere.nodes, local.nodes, atol=1e-12)
    np.testing.assert_allclose(everywhere.bodies[0].matrix, local.bodies[0].matrix, atol=1e-9)
    with pytest.raises(ValueError, match="<site> has no place of its own, in a model with global coordinates"):
        found(tmp_path, text.replace(' pos="-0.1 0 0"', ""))


def test_actuators_without_force_are_named(tmp_path):
    """A motor pulls nothing at control 0; a spring's control may have another gain than its stiffness."""
    motor = '<actuator><motor name="m" tendon="t" ctrlrange="-5 0" ctrllimited="true"/></actuator>'
    text = model(body(), last=motor).replace("<spatial ", '<spatial name="t" ')
    scene, notes = found(tmp_path, text)
    assert "1 actuators have no force at the start's controls, and are left out: m" in notes
    assert "controls change the rest lengths of 1 members by -25% to 0%: [gait] members = [0]" in notes, "5 N by 50 N/m"
    np.testing.assert_array_equal(scene.structure.cables.stiffness, [50])
    two = text.replace("</actuator>", '<motor tendon="t" ctrlrange="-5 0" ctrllimited="true"/></actuator>')
    assert "by -50% to 0%: [gait] members = [0]" in " ".join(found(tmp_path, two).notes), "forces add up"
    spring = motor.replace("motor", "general").replace("/>", ' gainprm="60" biastype="affine" biasprm="30 -100 -2"/>')
    text = model(body(), last=spring).replace('<spatial stiffness="50" springlength="0 0.4"', '<spatial name="t"')
    scene, notes = found(tmp_path, text)
    cables = scene.structure.cables
    # (30 - 60 * 5)/100 < 0: as short as can be
    assert "controls change the rest lengths of 1 members by -100% to 0%: [gait] members = [0]" in notes
    assert (cables.stiffness[0], cables.rest_length[0], cables.damping[0]) == (100, 0.3, 2)


def test_springs_that_are_compressed_push(tmp_path):
    """Beside rigid bodies, those that are stretched are cables, and the others are struts."""
    text = model(body()).replace('springlength="0 0.4"', 'springlength="0.9"')
    scene, notes = found(tmp_path, text)
    assert scene.structure.cables is None
    assert scene.structure.struts.rest_length.tolist() == [0.9]
    assert "1 tendons push as well as pull, and are struts" in notes


def test_bodies_that_hit_each_other_are_refused(tmp_path):
    """MuJoCo shows whether they do: two that a spring pulls together do, and do not where it is slack."""
    ball = '<geom type="sphere" size="0.05" pos="0 0 {}" mass="0.1"/>'
    bodies = body(inside=ball.format(-0.1)) + body("b", "0 0 0.4", inside=ball.format(0.1))
    text = model(bodies).replace('site="w"', 'site="b1"').replace('site="a0"', 'site="a1"')
    said = r"bodies a and b touch each other 0\.\d+ s after the start; here they would pass through each other"
    with pytest.raises(InputError, match=said):
        found(tmp_path, text)
    assert any(re.match(f"dropped: {said}", note) for note in found(tmp_path, text, drop=["contact"]).notes)
    slack = found(tmp_path, text.replace('springlength="0 0.4"', 'springlength="0 0.7"'))
    assert "bodies that meet each other touch there; here they pass through each other" in slack.notes


def test_parts_of_bodies_that_are_excluded_do_not_touch(tmp_path):
    """By the name of the part, which moves with the body around it."""
    ball = '<geom type="sphere" size="0.05" pos="0 0 {}" mass="0.1"/>'
    part = f'<body name="part">{ball.format(-0.1)}</body>'
    bodies = body(inside=part) + body("b", "0 0 0.4", inside=ball.format(0.1))
    for names, touch in (('body1="part" body2="b"', False), ('body1="a" body2="b"', True)):
        last = f"<contact><exclude {names}/></contact>"
        notes = found(tmp_path, model(bodies, last=last)).notes
        assert any("pass through each other" in note for note in notes) == touch


def test_a_keyframe_is_a_start(tmp_path):
    """Turned and moved as it says; an unknown one is refused, and those that are not asked for are named."""
    key = '<keyframe><key name="up" qpos="0 0 3 0.7071067811865476 0.7071067811865476 0 0"/></keyframe>'
    text = model(body(), last=key)
    structure = found(tmp_path, text, keyframe="up").scene.structure
    np.testing.assert_allclose(structure.nodes[1], [0.1, -0.05, 3.2], atol=1e-12)
    said = (
        "1 keyframes are not read, and bodies start where they are placed: up; --keyframe up starts in that one, with"
    )
    assert f"{said} its controls" in found(tmp_path, text).notes
    assert not any("start at rest" in note for note in found(tmp_path, text, keyframe="up").notes)
    moving = text.replace('<key name="up"', '<key name="up" qvel="0 0 1 0 0 0"')
    assert "keyframe up: its bodies move there; here they start at rest" in found(tmp_path, moving, keyframe="up").notes
    with pytest.raises(ValueError, match="keyframe = 'down': expected one of up"):
        found(tmp_path, text, keyframe="down")


def test_options_that_mujoco_knew_once(tmp_path):
    """Memory is found by itself; with predefined collisions the pairs alone touch, wherever the option stands."""
    ball = '<geom type="sphere" size="0.05" pos="0 0 {}" mass="0.1"/>'
    bodies = body(inside=ball.format(-0.1)) + body("b", "0 0 0.4", inside=ball.format(0.1))
    touching = model(bodies).replace('site="w"', 'site="b1"').replace('site="a0"', 'site="a1"')
    with pytest.raises(InputError, match="touch each other"):
        found(tmp_path, touching)
    old = touching.replace(
        "</mujoco>", '<size njmax="50"/><option collision="predefined" mpr_tolerance="1e-6"/></mujoco>'
    )
    assert not any("touch" in note for note in found(tmp_path, old).notes)
    with pytest.raises(InputError, match=r"line 8: <option collision='dynamic'>: expected all or predefined"):
        found(tmp_path, old.replace("predefined", "dynamic"))


def test_what_is_said_of_many_parts_is_said_once(tmp_path):
    """With the name of the first, and how many there are."""
    text = model(body() + body("b", "0 0 0.3")).replace('springlength="0 0.4"', 'limited="true" range="0 0.5"')
    more = text.replace(
        "</tendon>",
        '<spatial stiffness="1" limited="true" range="0 0.5"><site site="b0"/><site site="a1"/></spatial></tendon>',
    )
    lost = [note for note in found(tmp_path, more, drop=["limits"]).notes if note.startswith("dropped")]
    assert lost == ["dropped: tendon 0 and 1 more: its length is limited to 0 to 0.5 m"]


def test_all_that_would_be_lost_is_refused_at_once(tmp_path):
    """With the kinds to drop: the file is then read."""
    text = model(body(turn='gravcomp="1"')).replace('springlength="0 0.4"', 'limited="true" range="0 0.5"')
    said = r"tendon 0: its length is limited to 0 to 0.5 m; line 2: body a: gravity compensation, which would be lost; "
    with pytest.raises(InputError, match=said + r"drop=\['limits', 'forces'\], or --drop limits forces, reads"):
        found(tmp_path, text)
    notes = found(tmp_path, text, drop=["limits", "forces"]).notes
    assert sum(note.startswith("dropped: ") for note in notes) == 2
    # what else is wrong is said, too, and not that dropping is enough
    said = r"gravity compensation, which would be lost; and then: no tendon has a spring, [^;]*"
    with pytest.raises(InputError, match=said) as refused:
        found(tmp_path, text.replace('stiffness="50"', ""))
    assert "drop" not in str(refused.value)

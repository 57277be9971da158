"""MuJoCo models with springs that push and pull, dead bands and dampers: free flight as there; written as they were."""

import dataclasses
import re

import numpy as np
import pytest

from jaxgrity import (
    Gait,
    InputError,
    SolverOptions,
    force_limit,
    load_scene,
    parse_scene,
    save_scene,
    scene_text,
    simulate,
    with_gait,
    with_terms,
)
from jaxgrity.formats import mujoco_model, read_mjcf, save_mjcf
from jaxgrity.formats.mjcf_members import STRONGEST
from jaxgrity.model import cable_dampers, dead_band, polynomial_stiffness
from jaxgrity.model.force_laws import CableDampers, DeadBand
from jaxgrity.model.stiffening import PolynomialStiffness

mujoco = pytest.importorskip("mujoco")

APART = 'contype="0" conaffinity="0"'
POINT = (
    '<body name="{n}" pos="{x}">'
    + "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    + f'<geom type="sphere" size="0.01" mass="0.4" {APART}/><site name="{{n}}0"/></body>'
)
BOX = (
    '<body name="{n}" pos="{x}" euler="20 30 40"><freejoint/><site name="{n}0" pos="0.1 0.2 0.05"/>'
    '<site name="{n}1" pos="-0.1 0.2 -0.05"/><site name="{n}2" pos="0 -0.2 0"/>'
    f'<geom type="box" size="0.1 0.2 0.05" mass="2" {APART}/></body>'
)
WORLD = {"w": (0, 0, 3), "v": (2, 0, 0), "u": (-1, 2, 0), "t": (-1, -2, 0)}
"""Sites of the world, around the robot."""
PULLING = 'stiffness="60" damping="1" springlength="0 1.2"'
DEAD_BAND = 'stiffness="80" damping="0.7" springlength="{} {}"'


def model(body, tendons):
    """Two bodies, and tendons: the names of their sites, and their attributes."""
    sites = "".join('<site name="{}" pos="{} {} {}"/>'.format(name, *x) for name, x in WORLD.items())
    bodies = body.format(n="a", x="0.1 0.2 0.3") + body.format(n="b", x="0.4 -0.5 0.1")
    text = f"<mujoco><option timestep='1e-4' integrator='RK4'/><worldbody>{sites}{bodies}</worldbody><tendon>"
    for k, (path, law) in enumerate(tendons):
        text += f'<spatial name="t{k}" {law}>' + "".join(f'<site site="{s}"/>' for s in path.split()) + "</spatial>"
    return f"{text}</tendon></mujoco>"


def found(folder, text, **how):
    (folder / "robot.xml").write_text(text)
    return read_mjcf(folder / "robot.xml", **how)


def moved(text, steps):
    """Places of the sites, m, and the lengths of tendons, m, (steps, tendons), along a motion of MuJoCo.

    It starts in the model's keyframe, if there is one, and keeps the controls of that.
    """
    there = mujoco.MjModel.from_xml_string(text)
    data, lengths = mujoco.MjData(there), []
    if there.nkey:
        mujoco.mj_resetDataKeyframe(there, data, 0)
    mujoco.mj_forward(there, data)
    start = data.site_xpos.copy()
    for _ in range(steps):
        mujoco.mj_step(there, data)
        lengths.append(data.ten_length.copy())
    mujoco.mj_forward(there, data)
    return start, data.site_xpos.copy(), np.array(lengths)


def ends(scene, options):
    """Where the nodes are after half a second, m."""
    return np.asarray(simulate(scene, 0.5, options=options, frame_rate=2.0).positions[-1])


def largest_error(scene, ours, text):
    """The largest distance, m, of a site from where MuJoCo has it after half a second, and lengths on the way there."""
    start, end, lengths = moved(text, 5000)
    apart = np.linalg.norm(np.asarray(scene.structure.nodes) - start[:, None], axis=2)
    there = apart.min(1) < 1e-12  # sites of the world may be no nodes
    assert there.sum() > 4
    assert np.abs(end - start).max() > 0.1
    return np.abs(ours[apart.argmin(1)] - end)[there].max(), lengths


def check_both_sides(lengths, dead_bands):
    """Of each such tendon: it pushes at some time, and pulls at another."""
    for k, (low, high) in dead_bands.items():
        assert lengths[:, k].min() < low
        assert lengths[:, k].max() > high


TENDONS = [
    ("v a0", 'stiffness="60" springlength="0 1.2"'),
    ("t b0", 'stiffness="60" springlength="0 1.2"'),
    ("v a0", 'damping="3"'),  # beside the first one
    ("t a0", 'damping="0.5"'),  # alone
    ("w a0", DEAD_BAND.format(2.8, 3.0)),
    ("w b0", DEAD_BAND.format(3.3, 3.3)),
    ("v b0 a0 u", DEAD_BAND.format(5.0, 5.0)),
    ("w t", 'stiffness="10" springlength="0 1"'),
]


def same(ours, theirs):
    """Whether cables, struts, dead bands and dampers are those of another scene, to rounding."""
    for mine, other in zip(ours.structure.members, theirs.structure.members, strict=True):
        assert list(map(set, mine.edges)) == list(map(set, other.edges))
        assert mine.clusters == other.clusters
        for name in ("stiffness", "rest_length", "damping"):
            values = (0.0 if getattr(each, name) is None else getattr(each, name) for each in (mine, other))
            np.testing.assert_allclose(*values, rtol=1e-12, atol=1e-12, err_msg=name)
    assert [type(term) for term in ours.terms] == [type(term) for term in theirs.terms] == [DeadBand, CableDampers]
    np.testing.assert_allclose(ours.terms[0].width, theirs.terms[0].width, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(ours.terms[1].damping, theirs.terms[1].damping, rtol=1e-12)


def test_points_fly_as_in_mujoco(tmp_path):
    """RK4 at 1e-4 s in both, 0.5 s: within 1e-6 m."""
    text = model(POINT, TENDONS)
    scene, notes = found(tmp_path, text)
    error, lengths = largest_error(scene, ends(scene, SolverOptions(method="rk4", dt=1e-4)), text)
    assert error < 1e-6
    check_both_sides(lengths, {4: (2.8, 3.0), 6: (5.0, 5.0)})
    said = " ".join(notes)
    assert "2 tendons are cables that push when they are short, as springs there do" in said
    assert "1 tendons without a spring are dampers: t3" in said
    assert "damping of tendons acts there while they are slack" not in said
    # written for both programs, and read again
    written = save_mjcf(scene, tmp_path / "again.xml")
    assert written.notes == ()
    same(read_mjcf(tmp_path / "again.xml").scene, scene)
    save_scene(scene, tmp_path / "robot.toml")
    same(load_scene(tmp_path / "robot.toml"), scene)


@pytest.mark.campaign
def test_bodies_fly_as_in_mujoco(tmp_path):
    """Of free bodies, too: within 1e-6 m, extrapolated from steps of 0.05 and 0.1 ms."""
    tendons = [
        ("v a0", 'stiffness="60" springlength="0 1.2"'),
        ("t b0", 'stiffness="60" springlength="0 1.2"'),
        ("a1 b1", DEAD_BAND.format(0.9, 1.2)),
        ("w a2", DEAD_BAND.format(3.0, 3.2)),
        ("u b2", 'damping="0.5"'),
    ]
    text = model(BOX, tendons)
    scene, _ = found(tmp_path, text)
    assert len(scene.structure.bodies) == 2
    fine, coarse = (ends(scene, SolverOptions(dt=dt)) for dt in (1e-4, 2e-4))
    error, lengths = largest_error(scene, fine + (fine - coarse) / 3, text)
    assert error < 1e-6
    check_both_sides(lengths, {2: (0.9, 1.2), 3: (3.0, 3.2)})


def test_tendons_without_names_have_dampers_that_act_while_they_are_slack(tmp_path):
    """Notes number them; one goes slack."""
    tendons = [
        ("a0 b0", PULLING),
        ("w a1", PULLING),
        ("v b1", PULLING),
        ("u a2", PULLING),
        ("a1 b2", 'stiffness="9" damping="1" springlength="0 3"'),
    ]
    text = re.sub(r' name="t\d"', "", model(BOX, tendons))
    named, plain = (found(tmp_path, each).scene for each in (model(BOX, tendons), text))
    (one,), (other,) = plain.terms, named.terms
    assert isinstance(one, CableDampers)
    np.testing.assert_array_equal(one.damping, other.damping)


@pytest.mark.slow
@pytest.mark.parametrize(("path", "within"), [("a0 b0", 0.0), ("a2 a0 b0", np.sqrt(0.1725))])
def test_a_spring_that_goes_slack_beside_bodies_pushes_as_there(path, within, tmp_path):
    """It is stretched at the start, and short soon after. What of it is on one body is constant."""
    tendons = [(path, f'stiffness="90" springlength="{0.7 + within:.15g}" damping="0.3"')]
    tendons += [(each, PULLING) for each in ("w a1", "v b1", "u a2", "t b2")]
    text = model(BOX, tendons)
    scene, notes = found(tmp_path, text)
    assert any("1 tendons are cables that push when they are short" in note for note in notes)
    fine, coarse = (ends(scene, SolverOptions(dt=dt)) for dt in (1e-4, 2e-4))
    error, lengths = largest_error(scene, fine + (fine - coarse) / 3, text)
    assert lengths[0, 0] > 0.7 + within > lengths[:, 0].min() + 0.03
    assert error < 1e-6


def test_a_limit_that_is_reached_is_refused_with_what_to_write(tmp_path):
    """A soft stop; one that the robot does not reach is left out with a note."""
    limited = [*TENDONS[:2], ("w b0", 'limited="true" range="0 {}"')]
    text = model(POINT, limited)
    said = 'limited to 0 to 3 m, a soft stop that resists accelerations, too; .* has springlength="0 3" stiffness='
    with pytest.raises(InputError, match=said):
        found(tmp_path, text.format(3))
    notes = found(tmp_path, text.format(9)).notes
    assert any(
        "9 m there, not reached within 0.5 s at constant controls, and not at all here" in note for note in notes
    )


HANGING = """<mujoco><option timestep="1e-4"/><worldbody><site name="w" pos="0 0 1"/><site name="v" pos="1 0 0.51"/>
<body pos="0 0 0.51"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
<joint type="slide" axis="0 0 1"/><geom size="0.02" mass="0.4"/><site name="a"/></body></worldbody>
<tendon><spatial {} ><site site="w"/><site site="a"/></spatial>
<spatial stiffness="1" springlength="0 2"><site site="v"/><site site="a"/></spatial></tendon></mujoco>"""


@pytest.mark.parametrize("solref", ["0.02 1", "-400 -15"])
def test_the_spring_that_is_named_for_a_limit_is_as_long_at_rest_and_swings_otherwise(solref, tmp_path):
    """A mass hangs on each of them in MuJoCo. That they swing differently is why a limit is not read as the spring."""
    limit = f'limited="true" range="0 0.5" solreflimit="{solref}" solimplimit="0.9 0.9 0.001"'
    with pytest.raises(InputError) as caught:
        found(tmp_path, HANGING.format(limit))
    spring = re.search('springlength="0 0.5" stiffness="[^"]*" damping="[^"]*"', str(caught.value)).group()
    assert found(tmp_path, HANGING.format(spring)).scene.structure.cables is not None
    lengths = []
    for attributes in (limit, spring):
        model = mujoco.MjModel.from_xml_string(HANGING.format(attributes))
        data, each = mujoco.MjData(model), []
        for _ in range(30_000):
            mujoco.mj_step(model, data)
            each.append(data.ten_length[0] - 0.5)
        lengths.append(np.array(each))
    np.testing.assert_allclose(lengths[1][-5000:].mean(), lengths[0][-5000:].mean(), rtol=0.02)
    assert np.abs(lengths[0] - lengths[1])[:1000].max() > 0.2 * lengths[0].max()


def test_cables_that_a_gait_moves_keep_their_dampers(reference, tmp_path):
    """Beside an actuator's tendon as one of their own. Beyond a dead band these do not push there, says a note."""
    cables = reference.structure.cables
    widths = np.asarray(cables.rest_length).copy()
    widths[[0, 1, 3]] = 0.0, 0.1, 0.1
    gait = Gait((6, 7, 8), np.zeros(3), np.full(3, 0.1), np.ones(3))
    given = with_terms(
        with_gait(reference, gait), dead_band(cables, widths.tolist()), cable_dampers(cables, [*map(float, range(24))])
    )
    written = save_mjcf(given, tmp_path / "robot.xml")
    assert "1 cables with actuators do not push beyond their dead bands there" in written.notes
    assert "cables are damped there while they are slack, too" in written.notes
    there = mujoco.MjModel.from_xml_string(written.xml)
    assert there.ntendon == 6 + 24 + 22  # the first cable has none, and that of the pushing one is its tendon's
    assert there.tendon_damping[there.tendon("cable3").id] == 8 + 3
    np.testing.assert_array_equal(there.actuator_forcelimited[:3], [0, 1, 1])
    again = read_mjcf(tmp_path / "robot.xml").scene
    assert len(again.structure.struts.edges) == 7  # the first cable pushes and pulls
    np.testing.assert_array_equal(again.terms[1].damping, [1, 2, 3 + 8, *range(4, 24)])


def test_cables_that_go_slack_are_damped_as_there(tmp_path):
    """By a damper, which acts then, too; a cable that stays taut keeps its damping."""
    slack = PULLING.replace('"1"', '"4"')
    text = model(POINT, [("a0 b0", slack), ("w a0", PULLING), ("w b0", PULLING), ("v a0", PULLING), ("u b0", PULLING)])
    scene, notes = found(tmp_path, text)
    (dampers,) = scene.terms
    error, lengths = largest_error(scene, ends(scene, SolverOptions(method="dopri8")), text)
    loose = lengths.min(0) < 1.2
    assert 0 < loose.sum() < 5
    np.testing.assert_array_equal(dampers.damping, np.where(loose, [4, 1, 1, 1, 1], 0))
    np.testing.assert_array_equal(scene.structure.cables.damping, np.where(loose, 0, [4, 1, 1, 1, 1]))
    assert error < 1e-6
    assert any(note.startswith("the damping of tendons acts there while") for note in notes)


SERVOS = """<actuator><position name="s0" tendon="t0" kp="60" kv="1"/>
<position name="s1" tendon="t1" kp="80" forcelimited="true" forcerange="-900 0"/>
<intvelocity name="s2" tendon="t2" kp="50" actrange="0.2 1.5"/></actuator>"""
KEY = '<keyframe><key name="up" qpos="0 0 0 0.1 -0.1 0.2" ctrl="0.9 0.4 0" act="0.7"/></keyframe>'


def test_servos_have_the_rest_lengths_of_a_keyframe(tmp_path):
    """Plain `position` servos at the keyframe's controls, one that integrates them at its activation: as in MuJoCo."""
    taut = [("v a0", PULLING.replace("60", "70")), ("u b0", PULLING.replace("60", "90"))]
    text = model(POINT, [("a0 b0", ""), ("w a0", ""), ("w b0", ""), *taut])
    text = text.replace("</mujoco>", f"{SERVOS}{KEY}</mujoco>")
    scene, notes = found(tmp_path, text, keyframe="up")
    structure = scene.structure
    rest = {k: float(L) for members in structure.members for k, L in zip(members.stiffness, members.rest_length)}
    assert rest == pytest.approx({60.0: 0.9, 80.0: 0.4, 50.0: 0.7, 70.0: 1.2, 90.0: 1.2})
    error, _ = largest_error(scene, ends(scene, SolverOptions(method="dopri8")), text)
    assert error < 1e-8
    assert not any("are left out" in note for note in notes)


def test_controls_of_a_keyframe_that_are_forces_are_refused(tmp_path):
    """Where they lag behind their controls; a servo without a control says what it lacks."""
    springs = [("a0 b0", PULLING), ("w a0", PULLING)]
    lag = 'dyntype="filter" dynprm="1"'
    motor = f'<actuator><general name="m" tendon="t0" {lag} ctrlrange="-9 9"/></actuator>'
    key = '<keyframe><key name="up" ctrl="-3"/></keyframe></mujoco>'
    text = model(POINT, springs).replace("</mujoco>", motor + key)
    assert "1 actuators have no force at the start's controls, and are left out: m" in found(tmp_path, text).notes
    with pytest.raises(InputError, match="actuator m: has a force of its own at its control -3; expected one along"):
        found(tmp_path, text, keyframe="up")
    servo = '<actuator><position name="p" tendon="t1" kp="9"/></actuator></mujoco>'
    text = model(POINT, [*springs[1:], ("a0 b0", "")]).replace("</mujoco>", servo)
    with pytest.raises(InputError, match="actuator p: has the rest length 0 at control 0; expected a ctrlrange above"):
        found(tmp_path, text)


def test_limits_of_force_of_servos_that_only_pull(tmp_path):
    """A motor that yields, as the limit there: some of the time at the limit, some below it."""
    text = model(POINT, [("a0 b0", PULLING), ("w a0", ""), ("w b0", ""), ("v a0", PULLING), ("u b0", PULLING)])
    servo = '<position tendon="t{}" kp="{}" ctrlrange="0.2 9" forcerange="-{} 0"/>'
    text = text.replace(
        "</mujoco>", f"<actuator>{servo.format(1, 80, 150)}{servo.format(2, 70, 2e9)}</actuator></mujoco>"
    )
    scene, notes = found(tmp_path, text)
    assert scene.terms[0].largest.tolist() == pytest.approx([1e30, 150, 1e30, 1e30, 1e30])
    assert not any("limited" in note for note in notes)
    error, lengths = largest_error(scene, ends(scene, SolverOptions(method="dopri8")), text)
    force = 80 * (lengths[:, 1] - 0.2)
    assert force.min() < 150 < force.max()
    assert error < 1e-6
    assert "line 1: actuator" not in str(notes)
    save_scene(scene, tmp_path / "again.toml")
    np.testing.assert_array_equal(load_scene(tmp_path / "again.toml").terms[0].largest, scene.terms[0].largest)
    # written, it is such a servo again, without a control, whose damper is its tendon's
    written = save_mjcf(scene, tmp_path / "written.xml", timestep=1e-4)
    assert not any("left out" in note for note in written.notes)
    again = read_mjcf(tmp_path / "written.xml").scene
    np.testing.assert_array_equal(again.terms[0].largest, scene.terms[0].largest)
    np.testing.assert_allclose(again.structure.cables.rest_length, scene.structure.cables.rest_length)
    assert largest_error(again, ends(again, SolverOptions(method="dopri8")), written.xml)[0] < 1e-6


def test_limits_of_force_of_cables_that_a_gait_moves(reference, tmp_path):
    """Their controls move the same actuators, and their dampers do not count for the limit."""
    gait = Gait((6, 7), np.zeros(2), np.full(2, 0.1), np.ones(2))
    given = with_terms(with_gait(reference, gait), force_limit(reference.structure.cables, [40.0, *[1e12] * 23]))
    there = mujoco.MjModel.from_xml_string(save_mjcf(given, tmp_path / "robot.xml").xml)
    assert there.actuator_forcerange[0].tolist() == [-40.0, 0.0]
    assert there.actuator_forcerange[1].tolist() == [-STRONGEST, 0.0]
    damping = float(np.asarray(reference.structure.cables.damping)[0])
    assert there.tendon_damping[there.tendon("cable0").id] == damping > 0
    assert there.actuator_biasprm[:2, 2].tolist() == [0.0, -damping]
    assert there.actuator_gainprm[0, 0] > 0


def test_a_spring_and_a_servo_on_one_tendon(tmp_path):
    """Both push and pull: one spring with their stiffness, which controls move less. One that only pulls is refused."""
    both = 'stiffness="60" damping="1" springlength="1.2"'
    text = model(POINT, [("a0 b0", both), ("w a0", PULLING), ("w b0", PULLING), ("v a0", PULLING), ("u b0", PULLING)])
    servo = '<position name="p" tendon="t0" kp="20" kv="2" ctrlrange="-1 0"/>'
    driven = text.replace("</mujoco>", f"<actuator>{servo}</actuator></mujoco>")
    scene, notes = found(tmp_path, driven)
    struts = scene.structure.struts
    assert (struts.stiffness[0], struts.rest_length[0], struts.damping[0]) == pytest.approx((80, 60 * 1.2 / 80, 3))
    assert any("of 1 members by -28% to 0%" in note for note in notes)  # -1 m times 20/80, of 0.9 m
    error, _ = largest_error(scene, ends(scene, SolverOptions(method="dopri8")), driven)
    assert error < 1e-8
    with pytest.raises(InputError, match="tendon t0: has a spring and a servo, of which one only pulls; expected one"):
        found(tmp_path, driven.replace(both, PULLING))
    with pytest.raises(InputError, match="tendon t0: has a spring and a servo, of which one only pulls; expected one"):
        found(tmp_path, driven.replace('kv="2"', 'forcerange="-9 0"'))
    # a second servo adds to the first one
    twice = driven.replace("</actuator>", servo.replace('"p"', '"q"').replace("-1 0", "0.3 1") + "</actuator>")
    struts = found(tmp_path, twice).scene.structure.struts
    assert (struts.stiffness[0], struts.rest_length[0], struts.damping[0]) == pytest.approx((100, 0.78, 5))
    pulling = twice.replace('name="p"', 'name="p" forcerange="-9 0"')
    with pytest.raises(InputError, match="actuator q: is one of several servos of its tendon, of which one only pulls"):
        found(tmp_path, pulling)


BENT = [
    ("v a0", 'stiffness="60 40 25" springlength="0 1.2"'),
    ("t b0", 'stiffness="60 0 90" springlength="0 1.2"'),
    ("v b0 a0 u", 'stiffness="30 20" springlength="0 4.5"'),
    ("w a0", 'stiffness="40" springlength="0 2.5"'),
]
"""Springs of MuJoCo 4 with terms of higher order, one of them over three segments, and a linear one."""
has_polynomials = pytest.mark.skipif(not hasattr(mujoco.MjModel, "tendon_stiffnesspoly"), reason="MuJoCo before 4")


@has_polynomials
def test_polynomial_springs_pull_as_in_mujoco(tmp_path):
    """RK4 at 1e-4 s in both, 0.5 s: within 1e-6 m. Without their terms of higher order it is another motion."""
    text = model(POINT, BENT)
    scene, _ = found(tmp_path, text)
    (law,) = scene.terms
    np.testing.assert_allclose(law.quadratic, [40 / 60, 0, 20 / 30, 0])
    np.testing.assert_allclose(law.cubic, [25 / 60, 90 / 60, 0, 0])
    options = SolverOptions(method="rk4", dt=1e-4)
    error, _ = largest_error(scene, ends(scene, options), text)
    assert error < 1e-6
    linear = dataclasses.replace(
        scene, terms=(polynomial_stiffness(scene.structure.cables, law.quadratic.tolist(), 0.0),)
    )
    assert largest_error(linear, ends(linear, options), text)[0] > 1e-2
    (note,) = save_mjcf(scene, tmp_path / "again.xml").notes
    assert note == "it needs MuJoCo 4 or newer, since the stiffness of some tendons grows with their stretch"
    assert f"<!-- {note} -->" in (tmp_path / "again.xml").read_text()
    assert "<!--" not in mujoco_model(dataclasses.replace(scene, terms=())).xml
    save_scene(scene, tmp_path / "robot.toml")
    for again in (read_mjcf(tmp_path / "again.xml").scene, load_scene(tmp_path / "robot.toml")):
        assert [type(term) for term in again.terms] == [PolynomialStiffness]
        np.testing.assert_allclose(again.terms[0].quadratic, law.quadratic, rtol=1e-12)
        np.testing.assert_allclose(again.terms[0].cubic, law.cubic, rtol=1e-12)
    driven = with_gait(scene, Gait((0,), np.zeros(1), np.full(1, 0.1), np.ones(1)))
    notes = save_mjcf(driven, tmp_path / "driven.xml").notes
    assert "1 cables with actuators, or that push, do not grow stiffer with their stretch there" in notes


@has_polynomials
@pytest.mark.parametrize("law", ['stiffness="60 40" springlength="1.2"', 'stiffness="60 -4" springlength="0 1.2"'])
def test_other_polynomial_springs_are_refused(tmp_path, law):
    """Those that push, and those that soften: here cables only pull, and grow stiffer."""
    text = model(POINT, [BENT[3], ("v a0", law)])
    with pytest.raises(
        InputError, match=r"tendon t1: a spring that is not linear, and pushes, softens.* --drop forces"
    ):
        found(tmp_path, text)
    scene, notes = found(tmp_path, text, drop=["forces"])
    assert scene.terms == ()
    assert any(note.startswith("dropped: tendon t1: a spring that is not linear") for note in notes)


def test_polynomials_beside_other_forces_are_refused(tmp_path):
    """A largest force, a table and a pull without a stiffness in scene files; a pull in files of MuJoCo."""
    plain = scene_text("reference")
    for extra, stiff, message in (
        ("largest_force = 1.0", True, "largest_force: quadratic and cubic add to the force"),
        ("pull = 5.0", False, "quadratic, cubic: they multiply the stiffness"),
    ):
        text = plain.replace("[cables]\n", f"[cables]\n{extra}\nquadratic = 2.0\n")
        text = text if stiff else re.sub(r"(?ms)(\[cables\].*?)^stiffness[^\n]*\n", r"\1", text)
        with pytest.raises(InputError, match=message):
            parse_scene(text)
    scene = parse_scene(plain.replace("[cables]\n", "[cables]\npull = 5.0\nquadratic = 2.0\n"))
    with pytest.raises(InputError, match="quadratic or cubic beside pull"):
        save_mjcf(scene, tmp_path / "both.xml")

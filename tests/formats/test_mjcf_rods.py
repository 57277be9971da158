"""Capsules of MuJoCo models as rods of bodies: they touch each other along their length as there, and are written."""

import numpy as np
import pytest

from jaxgrity import InputError, SolverOptions, simulate
from jaxgrity.formats import read_mjcf, save_mjcf
from jaxgrity.model.rods import rods_of
from jaxgrity.model.strut_contact import strut_contact, with_contact_between_struts, without_strut_contact

mujoco = pytest.importorskip("mujoco")

TWO = """<mujoco><option timestep="0.0002" cone="elliptic"/>
<default><geom friction="{mu} 0 0" solref="0.001 1" solimp="0.999 0.999 0.001"/></default>
<worldbody><geom name="floor" type="plane" size="2 2 .1"/>
<body name="low" pos="0 0 0.05"><freejoint/><geom type="capsule" size="0.05" fromto="-0.5 0 0 0.5 0 0" mass="5"/>
<site name="a" pos="0.2 0 0.04"/><site name="b" pos="-0.2 0.04 0"/><site name="c" pos="-0.2 0 0"/></body>
<body name="high" pos="0.1 0.1 0.12"><freejoint/>
<geom name="h" type="capsule" size="0.02" fromto="0 -0.3 0 0 0.3 0" mass="0.5"/>
<site name="d" pos="0 0.3 0"/><site name="e" pos="0.01 0 0"/><site name="f" pos="0 -0.3 0.01"/></body>
</worldbody>
<tendon><spatial stiffness="10" springlength="0 1"><site site="a"/><site site="d"/></spatial></tendon></mujoco>"""
"""A log lies on the ground, and a rod across it, longer on one side; the cable between them is slack."""
TIPPED, WITHIN = 0.13, 1e-3
"""s, before the rod's end hits the ground, and m: what the motions differ by at most. MuJoCo's contact is soft."""
TEE = """<mujoco><worldbody><geom type="plane" size="2 2 .1"/>
<body pos="0 0 0.35"><freejoint/><geom type="capsule" size="0.02" fromto="-0.2 0 0 0.2 0 0" mass="0.4"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.25" mass="0.3"/>
<site name="a" pos="0.2 0 0"/><site name="b" pos="0 0 -0.25"/></body>
<body pos="2 0 0.35"><freejoint/><geom type="cylinder" size="0.004" fromto="-0.1 0 0 0.1 0 0" mass="0.1"/>
<geom size="0.03" pos="-0.1 0 0" mass="0.1"/><geom size="0.03" pos="0.1 0 0" mass="0.1"/>
<site name="c" pos="0 0 0.03"/><site name="d" pos="0 0.03 0"/></body></worldbody>
<tendon><spatial stiffness="10" springlength="0 1"><site site="a"/><site site="c"/></spatial></tendon></mujoco>"""
"""A T of two capsules, and a thin cylinder whose ends are within balls; they do not meet."""


@pytest.fixture
def read(tmp_path):
    def reading(text, **how):
        path = tmp_path / "robot.xml"
        path.write_text(text)
        return read_mjcf(path, **how)

    return reading


def moved_by_mujoco(text: str, names: list[str]) -> np.ndarray:
    """m: places of sites at `TIPPED`."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, round(TIPPED / model.opt.timestep))
    mujoco.mj_kinematics(model, data)
    return data.site_xpos[[model.site(name).id for name in names]]


@pytest.mark.slow
@pytest.mark.parametrize("mu", [0, 0.5])
def test_a_rod_tips_over_another_one_as_in_mujoco(mu, read, tmp_path):
    text = TWO.format(mu=mu)
    scene = read(text).scene
    options = SolverOptions(dt=1e-3)
    ours = np.asarray(simulate(scene, TIPPED, options=options, frame_rate=1 / TIPPED).positions[-1])[:6]
    assert np.linalg.norm(ours - scene.structure.nodes[:6], axis=1).max() > 0.03
    np.testing.assert_allclose(ours, moved_by_mujoco(text, list("abcdef")), rtol=0, atol=WITHIN)
    written = save_mjcf(scene, tmp_path / "written.xml", 2e-4)
    theirs = moved_by_mujoco(written.xml, [f"n{k}" for k in range(6)])
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=2 * WITHIN)


@pytest.mark.parametrize("text", [TWO.format(mu=0.5), TEE], ids=["two that touch", "a T"])
def test_rods_are_written_and_read_again(text, read, tmp_path):
    scene = read(text).scene
    save_mjcf(scene, tmp_path / "written.xml")
    again = read_mjcf(tmp_path / "written.xml").scene
    x, places = np.asarray(scene.structure.nodes), np.asarray(again.structure.nodes)
    ends = [
        sorted(sorted(at[[*rod]].round(9).tolist()) for rod in rods_of(each.structure))
        for at, each in ((x, scene), (places, again))
    ]
    assert ends[0] == ends[1]
    assert len(ends[0]) == {TEE: 3}.get(text, 2)
    for kept, found in ((scene.ground, again.ground), (again.ground, scene.ground)):
        capsules = [sorted(np.asarray(each.capsules.radius).tolist()) for each in (kept, found)]
        balls = [sorted(np.asarray(each.balls.radius).tolist()) for each in (kept, found)]
        np.testing.assert_allclose(*capsules, rtol=1e-12)
        np.testing.assert_allclose(*balls, rtol=1e-12)
    law, other = strut_contact(scene), strut_contact(again)
    assert (law is None) == (other is None) == (text is TEE)
    if law is not None and other is not None:
        np.testing.assert_allclose(np.sort(law.between.radius), np.sort(other.between.radius), rtol=1e-12)


def test_capsules_are_rods_between_nodes(read):
    """The stem of a T begins where no other ball is outermost; a cylinder is a rod of its own radius."""
    scene = read(TEE).scene
    x = np.asarray(scene.structure.nodes)
    ends = [x[[*rod]].round(6).tolist() for rod in rods_of(scene.structure)]
    assert [[0, 0, 0.35], [0, 0, 0.1]] in [each[::-1] for each in ends] or [[0, 0, 0.35], [0, 0, 0.1]] in ends
    assert sorted(np.asarray(scene.ground.capsules.radius).tolist()) == [0.004, 0.02, 0.02]
    assert strut_contact(scene) is None


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('name="h" type="capsule"', 'name="h" type="cylinder"', "bodies low and high touch each other"),
        ('name="h"', 'name="h" margin="0.001"', "bodies low and high touch each other"),
        ('name="h"', 'name="h" friction="0.9 0 0"', "geoms 1 and h touch each other with friction 0.9"),
        ('solref="0.001 1"', 'solref="0.001 0.05"', "bodies low and high touch each other"),
    ],
    ids=["a rim", "a margin", "friction", "a rebound"],
)
def test_what_touches_in_another_way_is_refused(old, new, said, read):
    with pytest.raises(InputError, match=said):
        read(TWO.format(mu=0.5).replace(old, new))


AXLE = """<body pos="{x} 0 0"><joint type="hinge" axis="0 1 0"/>
<geom type="capsule" size="0.05" fromto="0 -0.2 0 0 0.2 0" mass="1"/>
<site name="{n}d" pos="0 -0.2 0"/><site name="{n}e" pos="0 0.2 0"/><site name="{n}f" pos="0.03 0 0"/></body>"""
CART = f"""<mujoco><option cone="elliptic" timestep="0.0005"/>
<default><geom friction="0.8 0 0" solref="0.004 1"/></default><worldbody>
<geom type="plane" size="9 9 .1" zaxis="0.2 0 1"/>
<body pos="0.00981 0 0.04903" euler="0 11.3099325 0"><freejoint/>
<geom type="box" contype="0" conaffinity="0" size="0.2 0.02 0.02" mass="1"/>
<site name="a" pos="0.2 0 0.01"/><site name="b" pos="-0.2 0 0.01"/><site name="c" pos="0 0 0.02"/>
{AXLE.format(n="w", x=0.2)}{AXLE.format(n="v", x=-0.2)}</body></worldbody>
<tendon><spatial stiffness="1" springlength="0 9"><site site="a"/><site site="b"/></spatial></tendon></mujoco>"""
"""A cart with two rollers, capsules along their hinges, on a slope."""


@pytest.mark.slow
def test_a_roller_on_a_hinge_turns_with_itself_and_not_with_the_cart(read):
    """Three parts of 1 kg roll down a slope of tan 0.2, the two rollers of inertia I and radius r turn:
    a = g sin(slope) 3 / (3 + 2 I/r^2)."""
    scene = read(CART, drop=["contact"]).scene
    moved = simulate(scene, 0.3, options=SolverOptions(dt=1e-3), frame_rate=1 / 0.3)
    way = np.linalg.norm(np.asarray(moved.positions[-1] - moved.positions[0])[:3], axis=1)
    model = mujoco.MjModel.from_xml_string(CART)
    turning = 2 * float(model.body_inertia[2].min()) / 0.05**2
    np.testing.assert_allclose(way, 9.81 * 0.2 / np.hypot(1, 0.2) * 3 / (3 + turning) * 0.3**2 / 2, rtol=2e-3)


def test_rods_touch_each_other_with_radii_of_their_own(read, tmp_path):
    """Smaller than those with which they touch the ground, written and read again."""
    scene = without_strut_contact(read(TWO.format(mu=0.5)).scene)
    scene = with_contact_between_struts(scene, [0.04, 0.01], ((0, 1),))
    save_mjcf(scene, tmp_path / "written.xml")
    again = read_mjcf(tmp_path / "written.xml").scene
    assert sorted(np.ravel(strut_contact(again).between.radius).tolist()) == pytest.approx([0.01, 0.04])
    assert sorted(np.asarray(again.ground.capsules.radius).tolist()) == pytest.approx([0.02, 0.05])


def test_dropped_pairs_do_not_touch(read):
    """Neither two that MuJoCo lets touch in another way, nor two that start in each other."""
    pair = '<contact><pair geom1="g" geom2="h" margin="0.001" friction="0.5 0.5 0 0 0"/></contact></mujoco>'
    named = TWO.format(mu=0.5).replace('type="capsule" size="0.05"', 'name="g" type="capsule" size="0.05"')
    for text in (named.replace("</mujoco>", pair), named.replace("0.1 0.1 0.12", "0.1 0.1 0.08")):
        found = read(text, drop=["contact"])
        assert strut_contact(found.scene) is None
        assert any("dropped" in note for note in found.notes)


@pytest.mark.parametrize(("solmix", "pairs"), [(0.1, 3), (9.0, 1)])
def test_springs_of_rods_that_have_not_met_are_mixed_as_in_mujoco(solmix, pairs, read):
    """A third rod, far away, would bounce; beside the others its spring counts by its weight, and none bounces then."""
    third = f"""<body pos="0 3 0.3"><freejoint/>
<geom name="t" type="capsule" size="0.02" fromto="0 -0.3 0 0 0.3 0" mass="0.5" solref="0.001 0.2" solmix="{solmix}"/>
<site name="g" pos="0 0.3 0"/><site name="h" pos="0.01 0 0"/><site name="i" pos="0 -0.3 0.01"/></body></worldbody>"""
    cable = '<tendon><spatial stiffness="1" springlength="0 9"><site site="a"/><site site="g"/></spatial>'
    text = TWO.format(mu=0.5).replace("</worldbody>", third).replace("<tendon>", cable)
    text = text.replace('size="2 2 .1"', 'size="2 2 .1" priority="1"')
    assert len(strut_contact(read(text).scene).between.pairs) == pairs

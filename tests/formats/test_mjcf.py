"""MuJoCo models: MuJoCo loads what is written, moves as jaxgrity does, and what is written is read again."""

import dataclasses
from typing import get_args

import equinox as eqx
import jax
import numpy as np
import pytest
from measurements.conformance import (
    FLYING,
    RESTING_KINDS,
    RODS_WITH_MASS,
    SPRINGS,
    by_both,
    flying,
    mean_speed,
    resting,
)

from jaxgrity import (
    ExactGround,
    InputError,
    Members,
    Scene,
    SolverOptions,
    Structure,
    edge_lengths,
    load_gait,
    load_scene,
    parse_scene,
    simulate,
    with_gait,
)
from jaxgrity.formats import mjcf_controls, mujoco_model, read_mjcf, save_mjcf
from jaxgrity.io.structure_tables import CatalogueTable
from jaxgrity.model import Balls, energy_of_motion, penalty_twin
from jaxgrity.statics import settled
from jaxgrity.structures import random_tensegrity

mujoco = pytest.importorskip("mujoco")
run_once = pytest.importorskip("measurements.mujoco_peer").run_once

KINDS = [table.__struct_config__.tag for table in get_args(CatalogueTable)]
JOINED = ("d_bar", "t_bar", "grid")
"""kinds in which rods share nodes and are no rigid body"""


def campaigns(kinds, but) -> list:
    """The kinds but some, as parameters that campaigns alone take."""
    return [pytest.param(kind, marks=pytest.mark.campaign) for kind in kinds if kind not in but]


@pytest.mark.parametrize("kind", ["prism", *campaigns(KINDS, but=("prism",))])
def test_free_flight_of_spring_struts_agrees(kind):
    """RK4 at 1e-4 s in both, 0.5 s: within 1e-6 m."""
    scene = flying(kind, SPRINGS)
    theirs, ours, _ = by_both(scene, 0.5, 1e-4, SolverOptions(method="rk4", dt=1e-4))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6)
    fallen = ours - scene.structure.nodes
    assert np.abs(fallen - fallen.mean(0)).max() > 1e-4


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(4))
def test_random_robots_that_are_written_and_read_agree(seed, tmp_path):
    """Far from rest, some cables slack: read as they were, and after 0.5 s where MuJoCo moves them, within 1e-6 m."""
    shape, random = random_tensegrity(4, seed), np.random.default_rng(seed)
    members = [
        Members(
            edges, random.uniform(*K, len(edges)), edge_lengths(shape.nodes, edges) * random.uniform(*L, len(edges))
        )
        for edges, K, L in ((shape.struts, (1e4, 2e4), (0.98, 1.02)), (shape.cables, (1e2, 1e3), (0.7, 1.1)))
    ]
    given = Scene(Structure(shape.nodes + np.array([0, 0, 3]), random.uniform(0.1, 1, 8), *members), gravity=9.81)
    save_mjcf(given, tmp_path / "robot.xml")
    read = read_mjcf(tmp_path / "robot.xml").scene
    assert read.structure.struts.edges == shape.struts
    np.testing.assert_allclose(read.structure.nodes, given.structure.nodes, atol=1e-12)
    theirs, ours, _ = by_both(read, 0.5, 1e-4, SolverOptions(method="rk4", dt=1e-4))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6)
    alone = simulate(given, 0.5, options=SolverOptions(method="rk4", dt=1e-4), frame_rate=2.0)
    np.testing.assert_allclose(ours, alone.positions[-1], rtol=0, atol=1e-9)
    fallen = ours - given.structure.nodes
    assert np.abs(fallen - fallen.mean(0)).max() > 0.01


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param("prism", marks=pytest.mark.slow),
        # its vertebrae are bodies of several rods
        pytest.param("planar_spine", marks=pytest.mark.campaign),
        *campaigns(KINDS, but=("prism", "planar_spine", *JOINED)),
    ],
)
def test_free_flight_of_rods_with_mass_agrees(kind):
    """Free bodies in MuJoCo, constraints of complementarity stepping here: within 1e-6 m."""
    theirs, ours, _ = by_both(flying(kind, RODS_WITH_MASS), 0.5, 1e-4, SolverOptions(dt=5e-5))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", [pytest.param("t_bar", marks=pytest.mark.slow), *campaigns(JOINED, but=("t_bar",))])
def test_rods_that_share_nodes_are_springs_there(kind):
    """With their masses at their ends: that robot moves here as there, to 1e-6 m, and the notes name both changes."""
    scene = flying(kind, RODS_WITH_MASS)
    twin = penalty_twin(scene)
    struts = dataclasses.replace(twin.structure.struts, mass=None)
    lumped = dataclasses.replace(twin.structure, struts=struts, node_mass=scene.structure.lumped_mass)
    theirs, _ = run_once(scene, 0.5, 1e-4)
    ours = simulate(dataclasses.replace(twin, structure=lumped), 0.5, options=SolverOptions(dt=1e-4), frame_rate=2.0)
    np.testing.assert_allclose(ours.positions[-1], theirs, rtol=0, atol=1e-6)
    notes = " ".join(mujoco_model(scene).notes)
    assert "rigid struts are springs of" in notes
    assert "the mass of cables, and of struts that are springs there, is at their ends" in notes


@pytest.mark.parametrize("kind", campaigns(RESTING_KINDS, but=()))
def test_settled_heights_agree(kind):
    """The middle of the nodes at rest, rods with mass: within the penetration of MuJoCo's contact.

    Without friction: with it, feet come to rest where each engine's law of friction leaves them.
    """
    theirs, ours, deepest = by_both(resting(kind, mu=0.0), 3.0, 5e-4)
    assert 0 < deepest < 5e-3
    assert ours[:, 2].mean() == pytest.approx(theirs[:, 2].mean(), abs=deepest + 1e-4)


def test_rods_become_bodies_with_their_moments(exact):
    """Six free bodies: 0.5 kg and 0.3 kg a rod; the axial moment alone is made up."""
    struts = dataclasses.replace(exact.structure.struts, mass=np.full(6, 0.3))
    scene = dataclasses.replace(exact, structure=dataclasses.replace(exact.structure, struts=struts), gait=None)
    model = mujoco.MjModel.from_xml_string(mujoco_model(scene).xml)
    assert (model.nbody, model.nv, model.ntendon) == (7, 36 + 0, 24)
    np.testing.assert_allclose(model.body_mass[1:], 2 * 0.5 + 0.3)
    # two points of 0.5 kg at 0.5 m, and a rod of 0.3 kg, 1 m long
    np.testing.assert_allclose(np.sort(model.body_inertia[1:], axis=1)[:, 1:], 2 * 0.5 * 0.25 + 0.3 / 12, rtol=1e-12)
    # kinetic energy in any motion of one body
    data = mujoco.MjData(model)
    data.qvel[:6] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    mujoco.mj_forward(model, data)
    v = np.zeros((12, 3))
    first = [model.site("n0").id, model.site("n1").id]
    for row, site in enumerate(first):
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, site)
        v[row] = jacobian @ data.qvel
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass) if mujoco.__version__ >= "4" else mujoco.mj_fullM(model, mass, data.qM)
    theirs = 0.5 * data.qvel @ mass @ data.qvel
    assert float(energy_of_motion(scene.structure, v)) == pytest.approx(theirs, rel=1e-3)


def test_cables_only_pull_and_controls_are_changes_of_rest_length(reference):
    """A spring range from 0; a gait's actuators have the scene's law, and reach as far as the gait does."""
    written = mujoco_model(reference)
    model = mujoco.MjModel.from_xml_string(written.xml)
    cables = [model.tendon(f"cable{k}").id for k in range(24)]
    np.testing.assert_array_equal(model.tendon_lengthspring[cables, 0], 0)
    np.testing.assert_allclose(model.tendon_lengthspring[cables, 1], reference.structure.cables.rest_length)
    assert written.actuated == tuple(range(6))
    np.testing.assert_allclose(model.actuator_ctrlrange, [[-0.3, 0.0]] * 6)
    controls = mjcf_controls(reference, np.linspace(0, 5, 301))
    assert -0.3 - 1e-12 < controls.min() < -0.29
    assert controls.max() == 0
    assert any("the gait itself is no part" in note for note in written.notes)


def test_gaits_that_go_beyond_the_models_range_are_refused(reference):
    """A model's actuators reach as far as the gait with which it was written; less is in order."""
    times, gait = np.linspace(0, 5, 31), reference.gait
    with pytest.raises(InputError, match=r"members \[1\] move beyond what the scene's own gait"):
        mjcf_controls(reference, times, dataclasses.replace(gait, amplitude=np.array([0.3, 0.4, 0.3, 0.3, 0.3, 0.3])))
    less = mjcf_controls(reference, times, dataclasses.replace(gait, amplitude=gait.amplitude / 2))
    np.testing.assert_allclose(less, mjcf_controls(reference, times) / 2, atol=1e-15)


def test_gravity_leans_as_in_the_scene(reference):
    """As far as it does there."""
    up = np.array([-np.sin(0.3), 0, np.cos(0.3)])
    leaning = dataclasses.replace(reference, up=up)
    model = mujoco.MjModel.from_xml_string(mujoco_model(leaning).xml)
    np.testing.assert_allclose(model.opt.gravity, -9.81 * up, rtol=1e-6)
    with pytest.raises(InputError, match=r"up has shape \(12, 3\); expected \(3,\)"):
        dataclasses.replace(reference, up=np.tile(up, (12, 1)))


def test_balls_touch_with_their_radii(exact):
    """And nodes without one do not touch: the contacts that MuJoCo finds are as deep as the gaps of the scene."""
    feet = Balls((0, 1, 4, 6), [0.05, 0.0, 0.2, 0.3])
    scene = dataclasses.replace(with_gait(exact, None), ground=ExactGround(balls=feet))
    gaps = scene.ground.measured(np.asarray(scene.structure.nodes)).distance
    lowered = eqx.tree_at(lambda s: s.structure.nodes, scene, scene.structure.nodes - [0, 0, np.sort(gaps)[2] + 0.01])
    written = mujoco_model(lowered)
    model = mujoco.MjModel.from_xml_string(written.xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    expected = lowered.ground.measured(np.asarray(lowered.structure.nodes)).distance
    np.testing.assert_allclose(np.sort(data.contact.dist), np.sort(expected[expected < 0]), atol=1e-6)
    assert data.ncon == 3
    assert "balls at the ends of rods turn with these there, and slide here" in written.notes


def test_spheres_at_nodes_are_as_small_as_the_robot(exact):
    """A thousandth of it, and the plane is lower by as much: of a robot of a centimetre, too."""
    lengths = lambda s: (s.structure.nodes, s.structure.struts.rest_length, s.structure.cables.rest_length)  # noqa: E731
    small = eqx.tree_at(lengths, with_gait(exact, None), [0.01 * np.asarray(x) for x in lengths(exact)])
    model = mujoco.MjModel.from_xml_string(mujoco_model(small).xml)
    np.testing.assert_allclose(model.geom_size[model.geom_contype == 1, 0], 1e-5, rtol=1e-9)
    np.testing.assert_allclose(model.geom("ground").pos, [0, 0, -1e-5], rtol=1e-9, atol=1e-15)


def test_contact_and_steps_are_those_of_the_robots_size(exact):
    """A robot of a centimetre sinks a hundredth as deep into MuJoCo's contact, and its steps are a tenth as long."""
    bare = with_gait(dataclasses.replace(exact, structure=dataclasses.replace(exact.structure, cables=None)), None)
    for size, time in ((1.0, 1.0), (0.01, 0.1), (100.0, 10.0)):
        lengths = lambda s: (s.structure.nodes, s.structure.struts.rest_length)  # noqa: E731
        there = eqx.tree_at(lengths, bare, [size * np.asarray(x) for x in lengths(bare)])
        model = mujoco.MjModel.from_xml_string(mujoco_model(there).xml)
        np.testing.assert_allclose(model.geom("ground").solref, [0.02 * time, 1.0], rtol=1e-9)
        assert model.opt.timestep == pytest.approx(2e-3 * time, rel=1e-9)


def test_frictions_that_differ_are_those_of_the_nodes(reference, tmp_path):
    """MuJoCo takes the coefficient of each node's own sphere, and the ground's stiffness stays as it is."""
    mu = np.linspace(0.2, 0.7, 12)
    uneven = dataclasses.replace(reference, friction=dataclasses.replace(reference.friction, mu=mu))
    springs = []
    for scene, words in ((uneven, "the friction coefficients of the nodes"), (reference, "of the scene")):
        written = save_mjcf(scene, tmp_path / "robot.xml")
        assert any(words in note for note in written.notes)
        again = read_mjcf(tmp_path / "robot.xml").scene
        expected = np.broadcast_to(scene.friction.mu, 12)
        np.testing.assert_allclose(np.broadcast_to(again.friction.mu, 12), expected, rtol=1e-12)
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
        data = mujoco.MjData(model)
        data.qpos[:] = 0.0
        for joint in np.flatnonzero(model.jnt_axis[:, 2] == 1):
            data.qpos[model.jnt_qposadr[joint]] -= 0.5  # all nodes into the ground
        mujoco.mj_forward(model, data)
        assert data.ncon >= 3
        for contact in data.contact:
            geom = max(contact.geom)
            node = int(model.site(int(np.flatnonzero(model.site_bodyid == model.geom_bodyid[geom])[0])).name[1:])
            assert contact.friction[0] == pytest.approx(expected[node])
        springs.append(np.array(data.contact.solref))
    np.testing.assert_array_equal(springs[0], springs[1])


@pytest.mark.campaign
def test_the_lasting_gait_rolls_in_both():
    """The penalty twin of its scene: MuJoCo's contact is another, so that speeds agree roughly and not exactly."""
    scene = penalty_twin(with_gait(load_scene("exact"), load_gait("lasting")))
    theirs, ours = (mean_speed(scene, end, 20.0) for end in by_both(scene, 20.0, 5e-4)[:2])
    assert theirs > 0.3
    assert ours == pytest.approx(theirs, rel=0.5)


@pytest.mark.parametrize("name", ["reference", "exact", "uphill"])
def test_what_is_written_is_read(name, tmp_path):
    """Members, masses, damping, gravity, incline and friction; a gait and its struts' springs as they were written."""
    scene = load_scene(name)
    save_mjcf(scene, tmp_path / "robot.xml")
    again, notes = read_mjcf(tmp_path / "robot.xml")
    ours, theirs = scene.structure, again.structure
    np.testing.assert_allclose(theirs.nodes, ours.nodes, atol=1e-12)
    assert (theirs.struts.edges, theirs.cables.edges) == (ours.struts.edges, ours.cables.edges)
    np.testing.assert_allclose(theirs.cables.rest_length, ours.cables.rest_length, rtol=1e-12)
    np.testing.assert_allclose(theirs.cables.damping, ours.cables.damping)
    np.testing.assert_allclose(theirs.node_mass, ours.node_mass)
    np.testing.assert_allclose(again.node_damping, scene.node_damping)
    assert again.ground.incline == pytest.approx(scene.ground.incline)
    assert (again.gravity, again.friction.mu) == (scene.gravity, scene.friction.sliding_mu)
    assert any("the gait is not read" in note for note in notes)


def test_thick_rods_are_as_hard_to_turn_over_as_there(tmp_path):
    """A strut has the moment of inertia about its normals, 3 r^2/l^2 more than that of a thin rod."""
    cylinder = '<geom type="cylinder" fromto="{x} 0 1 {x} 0.6 1" size="0.03" mass="0.7" contype="0"/>'
    rod = f"<body><freejoint/>{cylinder}{{sites}}</body>"
    sites = [f'<site name="a{x}" pos="{x} 0 1"/><site name="b{x}" pos="{x} 0.6 1"/>' for x in (0, 1)]
    rods = "".join(rod.format(x=x, sites=each) for x, each in enumerate(sites))
    tendons = "".join(
        f'<spatial stiffness="9" springlength="0 0.5"><site site="{a}"/><site site="{b}"/></spatial>'
        for a, b in (("a0", "a1"), ("b0", "b1"), ("a0", "b1"))
    )
    path = tmp_path / "robot.xml"
    path.write_text(f"<mujoco><worldbody>{rods}</worldbody><tendon>{tendons}</tendon></mujoco>")
    robot = read_mjcf(path).scene.structure
    x, (rod_mass, *_) = robot.nodes, robot.struts.mass
    along = x[1] - x[0]
    inertia = robot.node_mass[:2] @ np.sum((x[:2] - x[:2].mean(0)) ** 2, axis=1) + rod_mass * along @ along / 12
    assert inertia == pytest.approx(0.7 * (0.6**2 / 12 + 0.03**2 / 4), rel=1e-9)
    assert robot.node_mass[:2].sum() + rod_mass == pytest.approx(0.7)
    assert robot.node_mass[0] == pytest.approx(robot.node_mass[1])


def test_rods_with_mass_and_supports_are_read(tmp_path):
    """Masses of ends and rods follow from a body's mass and moments; slides along two axes are a support."""
    text = FLYING.format(kind="prism", struts=RODS_WITH_MASS, drag=0.2, prestress=50.0, pose="")
    rods = parse_scene(text)
    save_mjcf(rods, tmp_path / "robot.xml")
    again, _ = read_mjcf(tmp_path / "robot.xml")
    assert again.structure.struts.rigid
    np.testing.assert_allclose(again.structure.struts.mass, 0.4, rtol=1e-9)
    np.testing.assert_allclose(again.structure.node_mass, 2 / 6, rtol=1e-9)
    np.testing.assert_allclose(again.node_damping, 0.2)
    held = parse_scene(
        text.replace(RODS_WITH_MASS, SPRINGS).replace("mass = 2.0", 'mass = 2.0\nfixed = [1, {node = 2, axes = "xz"}]')
    )
    save_mjcf(held, tmp_path / "held.xml")
    assert read_mjcf(tmp_path / "held.xml").scene.structure.fixed == held.structure.fixed


PUBLIC = """
<mujoco>
  <compiler autolimits="true"/>
  <default>
    <geom friction="0.8 0.005 0.0001"/>
    <tendon damping="1"/>
    <general ctrlrange="-0.05 0.05" gainprm="600" biastype="affine" biasprm="60 -600 -6" forcerange="-600 0"/>
  </default>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    {bodies}
  </worldbody>
  <tendon>
    {tendons}
    <spatial name="driven"><site site="a0"/><site site="b1"/></spatial>
    <spatial name="idle" damping="0"><site site="a1"/><site site="b0"/></spatial>
  </tendon>
  <actuator><general tendon="driven"/></actuator>
  <contact><exclude body1="a" body2="b"/></contact>
</mujoco>
"""
ROD = """
    <body name="{name}" pos="{place} 0 0.2" euler="0 {turn} 0">
      <freejoint/>
      <geom type="cylinder" fromto="0 0 -0.15 0 0 0.15" size="0.002" mass="0.04"/>
      <geom type="sphere" pos="0 0 -0.15" size="0.01" mass="0.02"/>
      <geom type="sphere" pos="0 0 0.15" size="0.01" mass="0.02"/>
      <site name="{name}0" pos="0 0 -0.15"/>
      <site name="{name}1" pos="0 0 0.15"/>
    </body>"""


def test_a_robot_of_another_hand(tmp_path):
    """Defaults, cylinders and spheres, springs that would push, a rest length by an actuator's bias."""
    bodies = ROD.format(name="a", place=0, turn=0) + ROD.format(name="b", place=0.2, turn=30)
    tendons = '<spatial stiffness="100" springlength="0.1"><site site="a0"/><site site="b0"/></spatial>'
    path = tmp_path / "robot.xml"
    path.write_text(PUBLIC.format(bodies=bodies, tendons=tendons))
    scene, notes = read_mjcf(path)
    structure = scene.structure
    assert structure.struts.edges == ((0, 1), (2, 3))
    np.testing.assert_allclose(structure.struts.rest_length, 0.3)
    assert float(structure.mass) == pytest.approx(0.16)
    # 60/600 m at control 0; the tendon's own damping, which is its default, and the actuator's
    np.testing.assert_allclose(structure.cables.rest_length, [0.1, 0.1])
    np.testing.assert_allclose(structure.cables.stiffness, [100, 600])
    np.testing.assert_allclose(structure.cables.damping, [0, 7])
    assert float(scene.friction.mu) == 0.8
    assert "1 tendons without a spring are left out: idle" in notes
    assert "1 tendons are cables that push when they are short, as springs there do" in notes  # it goes slack soon
    rod, ends = structure.struts.mass[0], structure.node_mass[:2]
    # a thin cylinder and two balls: about its middle, m l^2/12 and what the ends add
    inertia = 0.04 * (0.09 / 12 + 0.002**2 / 4) + 2 * 0.02 * (0.15**2 + 0.4 * 0.01**2)
    assert rod * 0.09 / 12 + ends.sum() * 0.15**2 == pytest.approx(inertia, rel=1e-9)


REFUSED = {
    "no XML": ("<mujoco>", "not XML: "),
    "entities": ('<!DOCTYPE a [<!ENTITY b "c">]><mujoco/>', "has a document type or entities"),
    "no such file": ('<mujoco>\n<include file="a.xml"/></mujoco>', "line 2: <include file='a.xml'>: there is no"),
    "itself": ('<mujoco><include file="robot.xml"/></mujoco>', "line 1: robot.xml: includes robot.xml twice"),
    "a million": ('<mujoco><worldbody><replicate count="1000000"/></worldbody></mujoco>', "line 1: <replicate> makes"),
    "deep": ("<mujoco>" + "<body>" * 60 + "</body>" * 60 + "</mujoco>", "more than 50 levels deep"),
    "unknown": ("<mujoco><wheel/></mujoco>", "Schema violation"),
    "no step": ('<mujoco><option timestep="0"/></mujoco>', "option: timestep = 0 s; expected a positive number"),
    "not a number": ('<mujoco><worldbody><geom size="nan"/></worldbody></mujoco>', "nan size in geom"),
    "no tendons": ("<mujoco/>", "has no tendons; expected spatial tendons between sites"),
    "two hinges": (
        '<mujoco><worldbody><site name="w"/>'
        '<body><joint/><joint axis="1 0 0"/><geom size="1"/><site name="s"/></body></worldbody>'
        '<tendon><spatial stiffness="1" springlength="0 1"><site site="s"/><site site="w"/></spatial>'
        "</tendon></mujoco>",
        "body 1: has several joints; expected one",
    ),
    "a slide across": (
        '<mujoco><worldbody><site name="w"/><body euler="0 0 45"><joint type="slide" axis="1 0 0"/>'
        '<geom size="1"/><site name="s"/></body></worldbody>'
        '<tendon><spatial stiffness="1" springlength="0 1"><site site="s"/><site site="w"/></spatial>'
        "</tendon></mujoco>",
        "body 1: its slides are not along x, y or z",
    ),
    "a body that slides on another": (
        '<mujoco><worldbody><site name="w"/><body><joint type="slide" axis="1 0 0"/><geom size="1"/><site name="s"/>'
        '<body name="bob"><joint type="slide"/><geom size="1"/></body></body></worldbody>'
        '<tendon><spatial stiffness="1" springlength="0 1"><site site="s"/><site site="w"/></spatial>'
        "</tendon></mujoco>",
        "body bob: slides on another body; expected ball joints and hinges",
    ),
    "a body that slides and has a joint": (
        '<mujoco><worldbody><site name="w"/><body name="cart"><joint type="slide" axis="1 0 0"/><geom size="1"/>'
        '<site name="s"/><site pos="0 1 0"/><body pos="1 0 0"><joint type="ball"/><geom size="1"/><site/>'
        '<site pos="0 1 0"/></body></body></worldbody>'
        '<tendon><spatial stiffness="1" springlength="0 1"><site site="s"/><site site="w"/></spatial>'
        "</tendon></mujoco>",
        "body cart: slides, and has a joint with another body; expected a free joint",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "reason"), REFUSED.values(), ids=REFUSED)
def test_refused_in_one_line(text, reason, tmp_path, monkeypatch):
    """With the file, and without a log of MuJoCo's in the working folder."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "robot.xml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_mjcf(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert reason in message
    assert message.isprintable()
    assert list(tmp_path.iterdir()) == [path]


def test_struts_that_must_be_springs_are_named(exact):
    """A rigid strut that a gait moves is a spring, as stiff as the penalty twin's; without gravity it is refused."""
    notes = mujoco_model(exact).notes
    assert "6 rigid struts are springs of 19620 N/m there" in notes
    with pytest.raises(InputError, match="gravity: not modelled"):
        mujoco_model(dataclasses.replace(exact, gravity=None))


def test_it_settles_to_what_mujoco_is_given(exact):
    """`settled` leaves what is at rest where it is."""
    assert settled(exact).moved < 1e-9
    assert jax.config.jax_enable_x64


@pytest.mark.slow
def test_slides_are_along_the_axes_of_the_world(tmp_path):
    """Those of a body that is turned by a quarter, too."""
    text = (
        '<mujoco><worldbody><site name="w"/><body pos="1 0 1" euler="0 0 90"><joint type="slide" axis="1 0 0"/>'
        '<joint type="slide" axis="0 0 1"/><geom size="0.1" contype="0" conaffinity="0"/><site name="s"/></body>'
        '</worldbody><tendon><spatial stiffness="1" springlength="0 1"><site site="s"/><site site="w"/></spatial>'
        "</tendon></mujoco>"
    )
    (tmp_path / "robot.xml").write_text(text)
    fixed = dict(read_mjcf(tmp_path / "robot.xml").scene.structure.fixed)
    assert "x" in fixed.values()
    assert "y" not in fixed.values()

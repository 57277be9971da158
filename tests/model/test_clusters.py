"""Cables that run through several nodes: closed forms, statics, what is refused."""

import dataclasses

import jax
import numpy as np
import pytest

from jaxgrity import (
    ExactGround,
    Gait,
    InputError,
    Members,
    PenaltyGround,
    Scene,
    SolverOptions,
    Structure,
    describe,
    energy_audit,
    gaits_of,
    load_scene,
    parse_scene,
    save_scene,
    scene_text,
    simulate,
    simulate_population,
)
from jaxgrity.model import symmetries
from jaxgrity.statics import inspect_structure, member_forces, resting_shape, static_response, stiffness_matrix
from jaxgrity.stepping import step_limit
from jaxgrity.stepping.discretisation import state_failure

G = 9.81
ALL_AS_ONE = scene_text("reference").replace("prestrain = 0.3", "prestrain = 0.3\nclusters = [[0, 3], [1, 20, 22]]")

SHORTENED = Gait((0,), [0.0], [0.2], [1.0], ramp=0.2)


def atwood(ground) -> Scene:
    """1 kg and 2 kg on a cable over a support, which starts with the tension that it keeps, 2 m M g/(m + M)."""
    nodes = np.array([[0.0, 0.0, 4.0], [0.0, 0.0, 5.0], [0.0, 0.0, 3.8]])
    stiffness = np.array([2e3, 1e3])
    stretch = 4 / 3 * G * (1 / stiffness).sum()
    rest = np.array([1.0 - stretch, 1.2])
    cables = Members(((0, 1), (1, 2)), stiffness, rest, np.array([4.0, 8.0]), clusters=((0, 1),))
    fixed = ((1, "xyz"), (0, "xy"), (2, "xy"))
    return Scene(Structure(nodes, np.array([1.0, 0.0, 2.0]), None, cables, fixed), G, ground=ground)


def lamp(height: float, rest: float, gait: Gait | None = None) -> Scene:
    """A weight of 0.5 kg that slides along a cable between two supports, 1 m apart and at different heights."""
    nodes = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, -0.6], [1.0, 0.0, height]])
    damping = None if gait is None else np.array([3.0, 6.0])
    cables = Members(((0, 1), (2, 1)), np.full(2, 500.0), np.full(2, rest / 2), damping, clusters=((0, 1),))
    return Scene(Structure(nodes, np.full(3, 0.5), None, cables, ((0, "xyz"), (2, "xyz"), (1, "y"))), G, gait=gait)


@pytest.mark.parametrize(
    "ground",
    [
        pytest.param(PenaltyGround(1e4), marks=pytest.mark.slow, id="penalty"),
        pytest.param(ExactGround(), marks=pytest.mark.campaign, id="exact"),
    ],
)
def test_weights_over_a_pulley_fall_as_atwood_says(ground):
    """a = g (M - m)/(M + m), with both contact models; the ground below is out of reach."""
    end = simulate(atwood(ground), 0.3, options=SolverOptions(dt=1e-3), frame_rate=10.0).positions[-1]
    fallen = G / 3 * 0.3**2 / 2
    tolerance = 2e-3 if ground.impulsive else 1e-6  # the first step of a leapfrog from rest: half a step too much
    np.testing.assert_allclose(end[:, 2], [4.0 + fallen, 5.0, 3.8 - fallen], atol=tolerance)


def test_the_power_of_a_cable_through_nodes_is_booked(booked):
    """Gaits shorten segments, and with them the whole cable; dampers in series take what is lost."""
    found = booked(lamp(0.3, 1.4, SHORTENED))
    assert (found["cables"] > 1e-3).sum() > 10
    assert (abs(found["actuation"]) > 1e-3).sum() > 10


@pytest.mark.campaign
def test_work_of_a_cable_through_nodes_is_in_the_balance():
    """Gaits shorten segments, and with them the whole cable; dampers in series take what the balance says."""
    audit = energy_audit(lamp(0.3, 1.5, SHORTENED), 1.0, options=SolverOptions("rk4", 1e-3), frame_rate=20.0)
    assert abs(audit.residual).max() < 1e-4 * audit.turned_over
    assert audit.dissipated["cables"][-1] > 0
    assert audit.actuation[-1] != 0


def test_such_a_cable_is_torn_as_a_whole():
    """It runs through its nodes: a side that grows from a centimetre is no damage, and a whole that grows is."""
    scene = lamp(0.3, 1.4)
    start = dataclasses.replace(scene.structure, nodes=[[0.0, 0, 0], [0.01, 0, 0], [1.0, 0, 0.3]])
    for place, code in ((0.9, 0), (9.0, 2)):
        q = np.array([[0.0, 0, 0], [place, 0, 0], [1.0, 0, 0.3]])
        assert state_failure(dataclasses.replace(scene, structure=start), q, np.zeros((3, 3))) == code


@pytest.mark.campaign
def test_a_population_with_such_cables_moves_as_each_robot_does():
    scene, options = lamp(0.3, 1.5, SHORTENED), SolverOptions("rk4", 1e-3, any_step=True)
    found = simulate_population(scene, gaits_of(SHORTENED, np.array([[0.0], [1.0]])), 0.5, options=options)
    alone = simulate(scene, 0.5, options=options)
    np.testing.assert_allclose(found.positions[0], alone.positions[-1], atol=1e-9)


def test_a_lamp_on_a_rope_hangs_where_both_sides_are_equally_steep():
    """One tension: 2 T sin(angle) = m g with the same angle to both sides, whatever the supports' heights."""
    scene = lamp(height=0.3, rest=1.5)
    rest = resting_shape(scene)
    d = rest.q[[0, 2]] - rest.q[1]
    slope = d[:, 2] / np.linalg.norm(d, axis=1)
    np.testing.assert_allclose(slope[0], slope[1], rtol=1e-9)
    tension = member_forces(scene.structure, rest.q)
    np.testing.assert_allclose(tension, 0.5 * G / 2 / slope, rtol=1e-9)
    # by hand: half of the spring constant of each half
    longer = np.linalg.norm(d, axis=1).sum() - 1.5
    np.testing.assert_allclose(tension, 250.0 * longer, rtol=1e-12)
    K = stiffness_matrix(scene, rest.q).toarray()
    with jax.enable_x64(True):
        push = 1e-6 * np.eye(9)[3].reshape(3, 3)
        slope_of = jax.jit(jax.grad(scene.potential_energy))
        column = (slope_of(rest.q + push, 0.0) - slope_of(rest.q - push, 0.0)) / 2e-6
    np.testing.assert_allclose(K[3], column.ravel(), atol=1e-3)
    response = static_response(scene, rest.q, np.array([[0, 0, 0], [0.01, 0, 0], [0, 0, 0.0]]))
    there, back = (member_forces(scene.structure, rest.q + way * response.displacement) for way in (1, -1))
    np.testing.assert_allclose(response.force_change, (there - back) / 2, atol=1e-6)


def test_statics_counts_no_self_stress_of_such_cables_and_gives_no_prestress():
    scene = lamp(height=0.0, rest=1.5)
    report = inspect_structure(scene)
    assert report.at_rest
    assert report.statics is None
    assert "not counted" in report.table()
    with pytest.raises(
        InputError, match=r"cables: clusters = .*decides each segment|clusters = .*expected rest lengths"
    ):
        parse_scene(ALL_AS_ONE.replace("prestrain = 0.3\n", "").replace("mass = 6.0", "mass = 6.0\nprestress = 100.0"))


def test_reports_and_files_name_such_cables(tmp_path):
    scene = parse_scene(ALL_AS_ONE)
    assert "as one cable each [[0, 3], [1, 20, 22]]" in describe(scene)
    assert any(
        "cable 0, 3 (nodes " in name for law in scene.laws if law.name.startswith("cables") for name in law.parts(scene)
    )
    assert step_limit(lamp(0.3, 1.4), "rk4").set_by.startswith("cable 0, 1 (nodes 0, 1, 2)")
    save_scene(scene, tmp_path / "robot.toml")
    assert load_scene(tmp_path / "robot.toml").structure.cables.clusters == ((0, 3), (1, 20, 22))
    assert len(symmetries(scene.structure)) < len(symmetries(load_scene("reference").structure))


@pytest.mark.parametrize(
    ("clusters", "words"),
    [
        (
            "[[0, 23]]",
            r"cables: clusters: 0 joins \[0, 4\], 23 joins .*; expected two or more members, each from where",
        ),
        ("[[0]]", "expected two or more members"),
        ("[[0, 1], [1, 2]]", "expected members from 0 to 23, once"),
        ("[[0, 99]]", "expected members from 0 to 23, once"),
    ],
)
def test_what_is_no_cable_is_refused(clusters, words):
    with pytest.raises(InputError, match=words):
        parse_scene(ALL_AS_ONE.replace("[[0, 3], [1, 20, 22]]", clusters))


def test_struts_and_massive_cables_do_not_slide():
    two = Members(((0, 1), (1, 2)), np.ones(2), np.ones(2), clusters=((0, 1),))
    with pytest.raises(InputError, match="struts cannot slide"):
        Structure(np.eye(3), np.ones(3), two)
    with pytest.raises(InputError, match="moves its mass along"):
        dataclasses.replace(two, mass=np.ones(2))

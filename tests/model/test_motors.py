"""Motors: rest lengths against an independent ODE, work in the balance, scene files, what is refused."""

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxgrity import (
    InputError,
    Members,
    Motor,
    Scene,
    SolverOptions,
    Structure,
    describe,
    edge_lengths,
    energy_audit,
    load_scene,
    parse_scene,
    save_scene,
    scene_text,
    simulate,
)
from jaxgrity.model import rest_length, symmetries

TIMES, LENGTHS = [0.5, 1.0, 2.5], [0.4, 0.9, 0.1]
MOTOR = Motor(0, TIMES, LENGTHS, rate=0.3, lag=0.1, smallest=0.25)
FILE = scene_text("reference").replace(
    "prestrain = 0.3",
    "prestrain = 0.3\nmotors = [{ member = 2, times = [0.1, 0.4], lengths = [0.3, 0.4], rate = 0.5, lag = 0.02 }]",
)


def one_member(motor: Motor, rigid: bool = False) -> Scene:
    """1 kg that hangs from a support by 0.7 m."""
    nodes = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.7]])
    kind = {"struts": Members(((0, 1),), None, [0.7], motors=(motor,))}
    if not rigid:
        kind = {"cables": Members(((0, 1),), [2e3], [0.7 - 9.81 / 2e3], [20.0], motors=(motor,))}
    return Scene(Structure(nodes, [0.0, 1.0], fixed=((0, "xyz"),), **kind), 9.81)


def test_a_motor_is_as_slow_as_its_rate_and_lag_and_stops_at_its_spool():
    """Against scipy: w' = clip to the rate until there, never below the smallest length; L' = (w - L)/lag."""
    members = Members(((0, 1),), None, [0.7], motors=(MOTOR,))

    def rates(t, y):
        asked = [0.7, *LENGTHS][np.searchsorted(TIMES, t, side="right")]
        return [np.clip((max(asked, 0.25) - y[0]) / 1e-4, -0.3, 0.3), (y[0] - y[1]) / 0.1]

    at = np.linspace(0.0, 5.0, 26)
    expected = solve_ivp(rates, (0, 5), [0.7, 0.7], "LSODA", at, rtol=1e-8, atol=1e-10, max_step=0.01).y[1]
    found = jax.jit(jax.vmap(lambda t: rest_length(members, None, t, 0)[0]))(at)
    np.testing.assert_allclose(found, expected, atol=1e-4)
    np.testing.assert_allclose(found[-1], 0.25, atol=2e-3)


def test_lengths_have_derivatives_in_what_is_asked_for():
    """It is on its way up for all of 1 to 2.5 s, and down again from where the first command ended."""

    def length(times, lengths):
        motor = Motor(0, times, lengths, rate=0.3)
        return rest_length(Members(((0, 1),), None, [0.7], motors=(motor,)), None, 0.9, 0)[0]

    slopes = jax.jit(jax.grad(length, argnums=(0, 1)))
    by_time, by_length = slopes(np.array([0.5]), np.array([0.4]))
    np.testing.assert_allclose((by_time[0], by_length[0]), (0.3, 0.0), atol=1e-12)
    _, there = slopes(np.array([0.5]), np.array([0.65]))
    np.testing.assert_allclose(there[0], 1.0)


def test_a_command_that_repeats_the_length_before_it_has_a_derivative():
    """Only the last one says where a fast motor is, whether it moves for it or not."""

    def length(lengths):
        motor = Motor(0, np.array([0.1, 0.5, 1.0]), lengths, rate=2.0)
        return rest_length(Members(((0, 1),), None, [0.7], motors=(motor,)), None, 1.4, 0)[0]

    slope = jax.jit(jax.grad(length))
    for lengths in ([0.7, 0.7, 0.7], [0.7, 0.7, 0.8], [0.75, 0.6, 0.6]):
        np.testing.assert_allclose(slope(np.array(lengths)), [0, 0, 1], atol=1e-12)


def test_the_power_of_a_motor_is_booked(booked):
    """While it winds, and at the end, when it only approaches the last length."""
    found = booked(one_member(Motor(0, [0.1], [0.595], rate=0.2, lag=0.08)))["actuation"]
    assert found.max() > 1


@pytest.mark.campaign
def test_a_motor_lifts_a_weight_and_its_work_is_what_that_takes():
    """Wound in by 0.1 m, so slowly that the cable stays taut, from one step to another: m g h once it hangs still."""
    audit = energy_audit(one_member(Motor(0, [0.1], [0.595], rate=0.2, lag=0.08)), 1.4, frame_rate=20.0)
    assert abs(audit.residual).max() < 1e-5 * audit.turned_over
    lifted = audit.positions[-1, 1, 2] - audit.positions[0, 1, 2]
    np.testing.assert_allclose(lifted, 0.7 - 9.81 / 2e3 - 0.595, atol=1e-3)
    np.testing.assert_allclose(audit.actuation[-1] - audit.lost[-1], 9.81 * lifted, rtol=1e-3)


@pytest.mark.slow
def test_a_rigid_strut_with_a_motor_has_the_motors_length():
    scene = one_member(Motor(0, [0.1], [0.5], rate=0.4, lag=0.05), rigid=True)
    moved = simulate(scene, 0.5, options=SolverOptions(dt=5e-3), frame_rate=20.0)
    struts = scene.structure.struts
    wanted = jax.jit(jax.vmap(lambda t: rest_length(struts, None, t, 0)[0]))(np.asarray(moved.times))
    np.testing.assert_allclose([edge_lengths(q, struts.edges)[0] for q in moved.positions], wanted, atol=1e-9)
    assert wanted[-1] < 0.6


def test_scene_files_have_motors(tmp_path):
    scene = parse_scene(FILE)
    assert "with a motor [2]" in describe(scene)
    save_scene(scene, tmp_path / "robot.toml")
    (motor,) = load_scene(tmp_path / "robot.toml").structure.cables.motors
    assert (motor.member, float(motor.rate), float(motor.lag), motor.smallest) == (2, 0.5, 0.02, None)
    assert motor.lengths.tolist() == [0.3, 0.4]
    assert len(symmetries(scene.structure)) == 1


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[0.1, 0.4]", "[0.4, 0.1]", r"cables: motor of member 2: times = \[0.4, 0.1\]; expected ascending ones"),
        ("[0.1, 0.4]", "[0.4]", "expected a length for each time"),
        ("rate = 0.5", "rate = 0.0", r"cables.motors\[0\].rate = 0.0: expected a number > 0"),
        ("member = 2", "member = 24", "expected members from 0 to 23"),
        ('members = "struts"', "members = [0, 1, 2, 3, 4, 8]", r"gait.members names \[8\], which have motors"),
        ("motors =", "stuck = [2]\nmotors =", "expected no members with motors"),
    ],
)
def test_bad_motors_are_refused(old, new, words):
    with pytest.raises(InputError, match=words):
        parse_scene(FILE.replace(old, new))


@pytest.mark.parametrize("method", ["tsit5", pytest.param("dopri8", marks=pytest.mark.campaign)])
def test_steps_that_adapt_see_a_motor_that_moves_and_comes_back(method):
    """However long nothing has moved: against fixed steps."""
    motor = Motor(0, [20.0, 20.1], [0.9, 1.0], rate=1.0)
    spring = Members(((0, 1),), [400.0], [1.0], motors=(motor,))
    nodes = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    scene = Scene(Structure(nodes, [0.0, 1.0], spring, fixed=((0, "xyz"), (1, "yz"))))
    ends = [
        float(simulate(scene, 21.0, options=options, frame_rate=1 / 21).positions[-1, 1, 0])
        for options in (SolverOptions(method, rtol=1e-8, atol=1e-10), SolverOptions("rk4", dt=5e-3))
    ]
    assert abs(ends[1] - 1.0) > 0.05
    assert ends[0] == pytest.approx(ends[1], abs=1e-4)

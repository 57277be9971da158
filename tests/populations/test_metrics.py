"""Metrics: what actuators do, and how robots meet the ground, against the energy balance and motions known by hand."""

import dataclasses

import equinox as eqx
import numpy as np
import pytest

from jaxgrity import (
    ConeFriction,
    ExactGround,
    Gait,
    InputError,
    Members,
    Motor,
    PenaltyGround,
    Scene,
    SolverOptions,
    Structure,
    energy_audit,
    gaits_of,
    one_gait,
    random_phases,
    with_gait,
    with_terms,
)
from jaxgrity import simulate_population as roll
from jaxgrity.model import commanded_pull, rigid_body
from jaxgrity.model.scene import as_dtype
from jaxgrity.populations.metrics import FORCE_WINDOW, actuator_tension, initial_metrics, updated_metrics
from jaxgrity.search.objectives import CostOfTransport, JumpHeight, Straightness
from jaxgrity.stepping.complementarity import CoupledState
from jaxgrity.stepping.loop import Carried, Step

G, CARRIED = 9.81, 2.0
STEP = 1e-2


def rows(scene):
    """The scene's own gait, two others, and one that does not move."""
    phases = np.concatenate([[scene.gait.phase], random_phases(2, 6, seed=0), [scene.gait.phase]])
    return gaits_of(scene.gait, phases, np.array([0.3, 0.3, 0.2, 0.0])[:, None] * np.ones((4, 6)))


@pytest.fixture(scope="module")
def measured(exact):
    """Two seconds of four robots in the exact scene, one of them with the scene's own gait."""
    return roll(exact, rows(exact), 2.0, with_metrics=True, options=SolverOptions(dt=STEP))


@pytest.mark.slow
def test_measuring_disturbs_nothing():
    """Positions are those without metrics."""
    gaits = strokes(np.array([0.3, 0.2, 0.2, 0.0]), np.array([0.5, 1.0, 0.25, 0.5]))
    measured, plain = (
        roll(column(rigid=True), gaits, 2.0, with_metrics=each, options=SolverOptions(dt=STEP))
        for each in (True, False)
    )
    np.testing.assert_allclose(measured.positions, plain.positions, rtol=0, atol=1e-12)
    assert np.ptp(np.asarray(measured.positions)[:, 1, 2]) > 0.1
    np.testing.assert_array_equal(measured.steps, plain.steps)
    np.testing.assert_array_equal(measured.failure, plain.failure)
    assert plain.metrics is None


def test_motors_that_hold_a_force_reel_their_cables():
    """1 kg pulled from rest by 3 N for 0.5 s: 0.375 m, 1.125 J, whatever the gait's strokes."""
    cable = Members(((0, 1),), [0.0], [2.0])
    structure = Structure([[0.0, 0, 0], [2.0, 0, 0]], [0.0, 1.0], None, cable, ((0, "xyz"),))
    scene = with_terms(Scene(structure, gait=Gait((0,), [0.0], [0.1], [1.0])), commanded_pull(cable, 3.0))
    gaits = gaits_of(scene.gait, np.zeros((2, 1)), np.array([[0.1], [0.0]]))
    metrics = roll(scene, gaits, 0.5, with_metrics=True, options=SolverOptions("rk4", 1e-3)).metrics
    np.testing.assert_allclose(metrics.effort, 1.125, rtol=1e-6)
    np.testing.assert_allclose(metrics.peak_rate[:, 0], 1.5, rtol=1e-3)
    assert np.ptp(metrics.peak_power) == 0


@pytest.mark.slow
def test_work_is_that_of_the_balance(exact, measured):
    """Of exact contact and rigid struts to rounding, for impulses are summed alike."""
    audit = energy_audit(exact, 2.0, options=SolverOptions(dt=STEP))
    assert audit.actuation[-1] < -100
    assert float(measured.metrics.work[0]) == pytest.approx(audit.actuation[-1], rel=1e-12)


@pytest.mark.slow
def test_metrics_bound_each_other(measured):
    """No actuator does more than all do by themselves, no way is shorter than the straight one, none slips aloft."""
    metrics = measured.metrics
    assert np.all(metrics.effort[:3] > np.maximum(metrics.work[:3], 1))
    assert np.all(metrics.path >= measured.distance() * (1 - 1e-12))
    assert np.all(metrics.path[:3] > 1.05 * measured.distance()[:3])
    assert np.all((metrics.slip >= 0) & (metrics.slip <= metrics.contact))
    assert np.all(metrics.slip[:3] > 0.1)
    # of twelve nodes, in the second since the gait began
    assert np.all(metrics.contact <= 12 * (1 - metrics.flight) + 1e-9)
    assert np.all(np.abs(metrics.force) <= metrics.peak_force)
    assert np.all(metrics.peak_power <= metrics.peak_force * metrics.peak_rate)


@pytest.mark.slow
def test_a_robot_that_lies_still_costs_nothing(measured):
    """Once it has settled, it stays on three nodes: no effort, no rate, no slip and, but for rounding, no path."""
    still = [np.asarray(x)[3] for x in measured.metrics]
    metrics = dict(zip(measured.metrics._fields, still))
    for name in ("effort", "slip", "flight", "peak_rate", "peak_power"):
        np.testing.assert_array_equal(metrics[name], 0, err_msg=name)
    assert metrics["contact"] == pytest.approx(3.0, rel=1e-12)
    assert metrics["path"] < 1e-13
    assert np.all(metrics["force"] < -200)


def column(rigid: bool, gait: Gait | None = None) -> Scene:
    """A strut of 1 m that stands upright on one node and carries another: as nothing pushes it aside, it does not fall.

    A spring is as short as the load makes it, and stands as deep in the ground as the weight does.
    """
    stiffness, ground = None if rigid else np.array([1e3]), ExactGround() if rigid else PenaltyGround(2e3)
    base = 0.0 if rigid else -(1.0 + CARRIED) * G / 2e3
    height = 1.0 if rigid else 1.0 - CARRIED * G / 1e3
    struts = Members(((0, 1),), stiffness, np.array([1.0]))
    nodes = np.array([[0, 0, base], [0, 0, base + height]])
    return Scene(Structure(nodes, np.array([1.0, CARRIED]), struts), G, ground=ground, gait=gait)


def strokes(amplitude, frequency) -> Gait:
    """Of the column's strut, from its full length, in full swing from t = 0."""
    phase = np.full(len(amplitude), -np.pi / 2)
    return Gait((0,), *(np.reshape(x, (-1, 1)) for x in (phase, amplitude, frequency)), start=-1.0, ramp=1.0)


@pytest.mark.slow
def test_a_strut_that_lifts_a_load_by_hand():
    """A rigid one: its force is the load's weight and inertia, its effort the load lifted at each stroke.

    What is lifted was lowered before, and no motor stores it: work is nothing where strokes are whole, and effort is
    where there is but half of one, down. Rates peak between two steps, 5e-4 higher; peaks of forces are means.
    """
    amplitude, frequency = np.array([0.3, 0.2, 0.2, 0.0]), np.array([0.5, 1.0, 0.25, 0.5])
    lifts = np.array([1, 2, 0, 0])
    outcomes = roll(
        column(rigid=True), strokes(amplitude, frequency), 2.0, with_metrics=True, options=SolverOptions(dt=STEP)
    )
    metrics, weight = outcomes.metrics, CARRIED * G
    assert np.asarray(outcomes.failure).tolist() == [0] * 4
    np.testing.assert_allclose(metrics.peak_rate[:, 0], np.pi * frequency * amplitude, rtol=1e-3)
    np.testing.assert_allclose(metrics.effort, weight * amplitude * lifts, rtol=1e-3, atol=1e-12)
    lowered = np.array([0, 0, 0.2, 0])
    # to the last step's work, which is done half a step before its end
    np.testing.assert_allclose(metrics.work, -weight * lowered, atol=1e-3 * weight)
    inertia = CARRIED * amplitude / 2 * (2 * np.pi * frequency) ** 2
    peaks = np.asarray(metrics.peak_force[:, 0])
    assert np.all(peaks <= (weight + inertia) * (1 + 1e-3))
    assert np.all(peaks >= weight + 0.9 * inertia - 1e-9)
    np.testing.assert_allclose(metrics.force[3], -weight, rtol=1e-9)
    np.testing.assert_allclose(metrics.contact, 2.0, rtol=1e-12)
    for name in ("path", "slip", "flight"):
        np.testing.assert_array_equal(getattr(metrics, name), 0, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motor", "lifted"),
    [(Motor(1, [0.0], [1.2], rate=0.1, lag=0.1), 0.09), (Motor(1, [0.0], [1.05], rate=0.1), 0.05)],
    ids=["lag", "at once"],
)
def test_motors_beside_a_gait_cost_what_they_lift(motor, lifted):
    """Two columns: a motor makes one of them longer, up to 0.1 m/s, and gaits move the other.

    A motor that has its speed at once gives its load half of m v^2 in one step.
    """
    alone = column(rigid=True)
    nodes = np.concatenate([alone.structure.nodes, np.add(alone.structure.nodes, [1.0, 0, 0])])
    struts = Members(((0, 1), (2, 3)), None, np.ones(2), motors=(motor,))
    two = Scene(Structure(nodes, [1.0, CARRIED] * 2, struts), G, ground=ExactGround())
    gaits = strokes(np.array([0.0, 0.2]), np.array([1.0, 1.0]))
    metrics = roll(two, gaits, 1.0, with_metrics=True, options=SolverOptions(dt=STEP)).metrics
    assert metrics.force.shape == (2, 1), "forces are those of the gait's actuators"
    expected = CARRIED * G * np.array([lifted, lifted + 0.2]) + CARRIED / 2 * 0.1**2
    np.testing.assert_allclose(metrics.effort, expected, rtol=0.006)


@pytest.mark.slow
def test_a_jump_is_as_high_as_the_load_was_lifted():
    """Above the place where counting begins, at the highest point: strokes that go down alone have none."""
    amplitude, frequency = np.array([0.3, 0.2, 0.2, 0.0]), np.array([0.5, 1.0, 0.25, 0.5])
    found = roll(
        column(rigid=True), strokes(amplitude, frequency), 1.75, with_metrics=0.5, options=SolverOptions(dt=STEP)
    )
    times = np.arange(0.5, 1.75 + STEP / 2, STEP)
    length = 1 - amplitude * (1 - np.cos(2 * np.pi * times[:, None] * frequency)) / 2
    share = CARRIED / (1 + CARRIED)
    np.testing.assert_allclose(
        JumpHeight().worth(column(rigid=True), found, 1.75),
        share * np.ptp(np.maximum(length, length[0]), axis=0),
        rtol=0,
        atol=1e-12,
    )
    np.testing.assert_allclose(found.metrics.moved_z, share * (length[-1] - length[0]), rtol=0, atol=1e-12)
    assert 2 * float(found.metrics.moved_z[1]) == pytest.approx(float(found.metrics.rise[1]), rel=1e-9)


@pytest.mark.parametrize("method", ["rk4", "tsit5"])
@pytest.mark.slow
def test_a_spring_that_carries_a_load_by_hand(method):
    """At rest its force is K (l - L), the load's weight; the work of a stroke is what it lifts and what it stores.

    By half of a stroke, in a time long for the spring, the load comes down by the stroke. What is left of its swing,
    1 % of the amplitude, is less than 1 % of the work.
    """
    gaits = strokes(np.array([0.0, 0.3]), np.array([0.5, 0.5]))
    outcomes = roll(column(rigid=False), gaits, 1.0, with_metrics=True, options=SolverOptions(dt=1e-3, method=method))
    assert outcomes.method == method
    metrics, q = outcomes.metrics, np.asarray(outcomes.positions)
    np.testing.assert_allclose(q[0], column(rigid=False).structure.nodes, rtol=0, atol=1e-12)
    assert float(metrics.force[0, 0]) == pytest.approx(1e3 * (q[0, 1, 2] - q[0, 0, 2] - 1.0), rel=1e-8)
    assert float(metrics.force[0, 0]) == pytest.approx(-CARRIED * G, rel=1e-8)
    assert float(metrics.work[0]) == float(metrics.effort[0]) == 0
    assert float(metrics.work[1]) == pytest.approx(-0.3 * CARRIED * G, rel=0.01)
    assert float(metrics.peak_rate[1, 0]) == pytest.approx(0.15 * np.pi, rel=1e-4)


@pytest.mark.slow
def test_work_of_springs_is_that_of_the_balance_to_second_order():
    """Powers at both ends of steps are averaged, and integrated in the balance. Positions are those of the balance."""
    dt, gaits = 1e-3, strokes(np.array([0.0, 0.3]), np.array([0.5, 0.5]))
    outcomes = roll(column(rigid=False), gaits, 0.8, with_metrics=True, options=SolverOptions(dt=dt))
    audit = energy_audit(column(rigid=False, gait=one_gait(gaits, 1)), 0.8, options=SolverOptions(dt=dt))
    np.testing.assert_allclose(outcomes.positions[1], audit.positions[-1], rtol=0, atol=1e-12)
    slope = np.gradient(np.gradient(audit.actuation, audit.times), audit.times)
    bar = dt**2 * np.abs(slope).max()
    assert bar < 1e-4 * abs(audit.actuation[-1])
    assert float(outcomes.metrics.work[1]) == pytest.approx(audit.actuation[-1], abs=bar)


def test_forces_stand_in_the_gaits_order(reference):
    """Cables and struts in any order; a slack cable does not pull, a stuck strut has no rate, and each force belongs to
    its member: over a step of the time that forces are averaged over, it is K (l - L)."""
    gait = Gait((20, 0, 7, 2), [0.1, 0.7, 2.0, 4.0], [0.3, 0.2, 0.1, 0.25], [0.5, 0.7, 0.9, 1.1], 0.0, 1.0)
    longer = np.array(reference.structure.cables.rest_length)
    longer[1] = 3.0
    stuck = dataclasses.replace(reference.structure.struts, stuck=(2,))
    scene = eqx.tree_at(
        lambda s: (s.structure.cables.rest_length, s.structure.struts), with_gait(reference, gait), (longer, stuck)
    )
    q = scene.structure.nodes + np.random.default_rng(0).normal(size=(12, 3)) * 0.05
    state = (q, 0 * q)

    @eqx.filter_jit
    def one_step(scene):
        return updated_metrics(
            scene, Step(1.5, FORCE_WINDOW, Carried(state, None), Carried(state, None)), initial_metrics(scene)
        )

    metrics = one_step(as_dtype(scene, "float64"))
    forces, rates = [], []
    for k, phase, delta, f in zip(gait.members, gait.phase, gait.amplitude, gait.frequency):
        members, row = (scene.structure.struts, k) if k < 6 else (scene.structure.cables, k - 6)
        i, j = members.edges[row]
        moves = 0 if k == 2 else 1
        before, after = (
            members.rest_length[row] * (1 - moves * delta / 2 * (1 + np.sin(2 * np.pi * f * t + phase)))
            for t in (1.5, 1.5 + FORCE_WINDOW)
        )
        forces.append(members.stiffness[row] * (np.linalg.norm(q[i] - q[j]) - after))
        rates.append(abs(after - before) / FORCE_WINDOW)
    assert forces[2] < 0
    forces[2] = 0.0
    assert rates[3] == 0
    np.testing.assert_allclose(metrics.force, forces, rtol=1e-10)
    np.testing.assert_allclose(metrics.peak_force, np.abs(forces), rtol=1e-10)
    np.testing.assert_allclose(metrics.peak_rate, rates, rtol=1e-10)
    np.testing.assert_allclose(metrics.peak_power, np.abs(np.multiply(forces, rates)), rtol=1e-10)


def test_the_force_of_a_strut_at_a_body_is_its_own():
    """A strut pulls a rod at one end with 3 N for 10 ms; the rod's two ends push each other apart with 50 N."""
    nodes = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 0, -1]])
    rod = rigid_body(nodes, (0, 1), 2.0, [0.0, 0.2, 0.2])
    gait = Gait((0,), [0.0], [0.1], [1.0])
    scene = Scene(Structure(nodes, [0, 0, 1.0, 1.0], Members(((0, 3),), None, [np.sqrt(2)]), bodies=(rod,)), gait=gait)
    along = (nodes[3] - nodes[0]) / np.sqrt(2)
    impulses = 0.01 * (3 * np.outer([1, 0, 0, -1], along) + 50 * np.outer([-1, 1, 0, 0], [1, 0, 0]))
    state = (nodes, 0 * nodes)
    memory = CoupledState(np.asarray(0.01), None, impulses, np.zeros(()))
    step = Step(np.asarray(0.0), np.asarray(0.01), Carried(state, memory), Carried(state, memory))
    np.testing.assert_allclose(actuator_tension(scene, step), [3.0], rtol=1e-6)


@pytest.mark.slow
def test_counting_begins_with_the_gait(exact):
    """Fallen by 2 cm before it, the robot has never been in the air; a gait that begins at once sees it fall."""
    at_once = dataclasses.replace(rows(exact), start=np.asarray(0.0))
    flight = roll(exact, at_once, 2.0, with_metrics=True, options=SolverOptions(dt=STEP)).metrics.flight
    # to the step in which it lands
    assert float(flight[3]) == pytest.approx(np.sqrt(2 * 0.02 / G), abs=STEP)


@pytest.mark.slow
def test_counting_may_begin_later(exact):
    """What is counted from a moment on is what is counted from the start, less what was so at that moment."""
    gaits, options = rows(exact), SolverOptions(dt=STEP)
    half, whole, rest = (
        roll(exact, gaits, until, with_metrics=since, options=options).metrics
        for until, since in ((1.5, 1.0), (2.0, 1.0), (2.0, 1.5))
    )
    for name in ("path", "work", "effort", "contact", "slip", "flight", "moved_x", "moved_y", "moved_z"):
        parts = (np.asarray(getattr(metrics, name)) for metrics in (half, rest, whole))
        first, second, together = parts
        np.testing.assert_allclose(first + second, together, rtol=1e-9, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(np.maximum(half.peak_force, rest.peak_force), whole.peak_force, rtol=1e-12)
    np.testing.assert_array_equal(rest.force, whole.force)
    default = roll(exact, gaits, 2.0, with_metrics=True, options=options).metrics
    np.testing.assert_allclose(default.effort, whole.effort, rtol=1e-12)


@pytest.mark.slow
def test_no_path_is_shorter_than_the_way(exact):
    """On a slippery slope, where the robot slides before its gait begins: straightness counts from then on."""
    up = np.array([-np.sin(0.2), 0, np.cos(0.2)])
    slippery = dataclasses.replace(exact, friction=ConeFriction(0.05), up=up)
    found = roll(slippery, rows(slippery), 1.5, with_metrics=True, options=SolverOptions(dt=STEP))
    straight = np.asarray(Straightness().worth(slippery, found, 1.5))
    assert np.all((straight > 0.9) & (straight <= 1 + 1e-12))
    assert np.all(np.asarray(found.distance()) > 1.2 * np.asarray(found.metrics.path))
    cost = -np.asarray(CostOfTransport().worth(slippery, found, 1.5))
    weight = float(slippery.structure.mass) * G
    expected = found.metrics.effort / (weight * np.hypot(found.metrics.moved_x, found.metrics.moved_y))
    np.testing.assert_allclose(cost, expected, rtol=1e-12)


@pytest.mark.parametrize("since", [-0.1, np.nan, 2.0])
def test_counting_begins_within_the_rollout(exact, since):
    with pytest.raises(InputError, match=r"with_metrics = .*: expected True, False, or a time, s, from 0 to before"):
        roll(exact, rows(exact), 2.0, with_metrics=since, options=SolverOptions(dt=STEP))


def test_adaptive_and_implicit_methods_have_no_metrics(reference):
    """Steps of one size, all robots at once: only such are measured."""
    for options in ({"method": "tsit5"}, {"method": "kvaerno3", "dt": 1e-3}):
        with pytest.raises(InputError, match="expected an explicit one at a fixed step, for metrics"):
            roll(reference, rows(reference), 0.1, with_metrics=True, options=SolverOptions(**options))


def test_what_cannot_be_measured_is_refused(reference):
    """Without a gait, nothing is actuated; forces of rigid struts that share a node cannot be told apart."""
    with pytest.raises(InputError, match="no gait; expected one, whose actuators can be measured"):
        initial_metrics(with_gait(reference, None))
    struts = Members(((0, 1), (1, 2)), None, np.ones(2))
    chain = Structure(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]]), np.ones(3), struts)
    gait = Gait((0,), np.zeros(1), np.zeros(1), np.ones(1))
    with pytest.raises(InputError, match="rigid struts share nodes: their forces cannot be told apart"):
        initial_metrics(Scene(chain, gait=gait))

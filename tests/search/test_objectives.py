"""Objectives, computed by hand from outcomes, and the fitness of ensembles."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxgrity import (
    ActuatorBounds,
    CostOfTransport,
    Direction,
    Distance,
    Fitness,
    Gait,
    Genome,
    InputError,
    Members,
    Metrics,
    Outcomes,
    Scene,
    SearchProblem,
    SolverOptions,
    Speed,
    SteadyDirection,
    SteadySpeed,
    SteadyTurn,
    Straightness,
    Structure,
    Uncertainty,
    ensemble,
    gaits_of,
    one_gait,
    random_phases,
    register_objective,
    simulate_population,
    with_gait,
)
from jaxgrity.model import body_length
from jaxgrity.populations.uncertainty import Differences
from jaxgrity.search import OBJECTIVES, FidelityLevel, JumpHeight, QuickStart, find_objective, judge_at, judging
from jaxgrity.search.judging import Scores, scored

MOVED = np.array([[3.0, 4.0, 7.0], [-0.6, 0.8, 0.0], [0.0, -2.0, 1.0]])
"""m, of three robots; the last fails"""
PATH, EFFORT = np.array([10.0, 2.5, 4.0]), np.array([20.0, 5.0, 1.0])
RISE = np.array([7.5, 0.2, 1.5])
RATE = np.array([[0.1, 0.5], [0.4, 0.3], [0.2, 0.2]])


def outcomes(measured: bool = True) -> Outcomes:
    """Three robots that moved as above."""
    start, zero = np.array([[1.0, 2.0, 0.5]] * 3), np.zeros(3)
    metrics = Metrics(PATH, zero, EFFORT, zero, zero, zero, 0 * RATE, 100 * RATE, RATE, 10 * RATE, *MOVED.T, RISE, zero)
    code, steps = np.array([0, 0, 1]), np.full(3, 5)
    nodes = np.zeros((3, 12, 3))
    path = np.stack([start, start + MOVED], axis=1)
    return Outcomes(path, nodes, code, steps, 0 * steps, metrics if measured else None, "rk4", 1e-3)


@pytest.mark.parametrize(
    ("objective", "worth"),
    [
        (Distance(), [5.0, 1.0]),
        (Direction(), [3.0, -0.6]),
        (Direction(heading=np.pi / 2), [4.0, 0.8]),
        (Direction(heading=math.atan2(4, 3)), [5.0, 0.28]),
        (Speed(), [5.0 / 8, 1.0 / 8]),
        (CostOfTransport(), [-20 / (6 * 9.81 * 5), -5 / (6 * 9.81 * 1)]),
        (Straightness(), [0.5, 0.4]),
        (JumpHeight(), [7.5, 0.2]),
    ],
    ids=str,
)
def test_each_objective_is_worth_what_is_computed_by_hand(reference, objective, worth):
    """Of a robot of 1 m and 6 kg after 8 s; NaN where it failed."""
    found = np.asarray(objective.worth(reference, outcomes(objective.needs_metrics), 8.0))
    np.testing.assert_allclose(found[:2], worth, rtol=1e-14)
    assert np.isnan(found[2])


def test_speed_is_in_the_robots_own_lengths(reference):
    """The longest strut as built; without struts, the longest cable."""
    half = eqx.tree_at(lambda s: s.structure.nodes, reference, reference.structure.nodes / 2)
    assert float(body_length(half)) == pytest.approx(0.5, rel=1e-14)
    speeds = [Speed().worth(s, outcomes(), 8.0)[:2] for s in (half, reference)]
    np.testing.assert_allclose(speeds[0], 2 * speeds[1], rtol=1e-14)
    loose = eqx.tree_at(lambda s: s.structure.struts, with_gait(reference, None), None)
    assert float(body_length(loose)) == pytest.approx(np.sqrt(6) / 4, rel=1e-14)
    bare = eqx.tree_at(lambda s: s.structure.cables, loose, None)
    with pytest.raises(InputError, match="no members; expected some, whose length is the body length"):
        body_length(bare)


def judged_by_bounds(reference, kind, **bounds) -> Scores:
    """The three robots, one a gait; struts of 1 m that move at 1 Hz reach the rates with these amplitudes."""
    gaits = Gait((0, 1), 0 * RATE, RATE / np.pi, 1 + 0 * RATE)
    worth, excess = Fitness(kind(), bounds=ActuatorBounds(**bounds)).worth(reference, gaits, outcomes(), 8.0)
    return scored(np.asarray(worth)[:, None], 0.0, np.asarray(excess)[:, None])


MEASURED = [CostOfTransport, Straightness, JumpHeight]
every_objective = pytest.mark.parametrize("kind", [Distance, Direction, Speed, *MEASURED])


@every_objective
def test_a_gait_within_its_bounds_loses_nothing(reference, kind):
    """Up to the bound itself, by the actuator that needs most."""
    plain = kind().worth(reference, outcomes(), 8.0)
    for bound in ({"rate": 0.5 * (1 + 1e-12)}, {"force": 50.0}, {"power": 5.0}):
        found = judged_by_bounds(reference, kind, **bound)
        np.testing.assert_array_equal(found.mean, plain)
        np.testing.assert_array_equal(found.merit[:2], plain[:2])
        np.testing.assert_array_equal(found.beyond, 0)


@every_objective
def test_a_gait_beyond_a_bound_comes_after_all_within(reference, kind):
    """However little it exceeds it, and however far it goes: here the first of two robots, which is better at all
    but cost, exceeds it with one actuator. What it is worth stays what it is."""
    plain = kind().worth(reference, outcomes(), 8.0)
    for name, peak in (("rate", 0.5), ("force", 50.0), ("power", 5.0)):
        for share in (1e-6, 1e-3, 0.1):
            found = judged_by_bounds(reference, kind, **{name: peak / (1 + share)})
            np.testing.assert_array_equal(found.mean, plain)
            np.testing.assert_array_equal(found.beyond, [1, 0, 0])
            assert np.argsort(-found.merit).tolist() == [1, 0, 2], (name, share)


def test_the_more_a_gait_exceeds_bounds_the_later_it_comes(reference):
    """So that a search knows its way back to what is allowed: with the excess, and with every bound exceeded."""

    def first(**bounds):
        return float(judged_by_bounds(reference, Distance, **bounds).merit[0])

    beyond = [first(rate=bound) for bound in (0.4, 0.3, 0.2)]
    assert beyond[0] > beyond[1] > beyond[2]
    assert first(rate=0.4, force=40.0) < first(rate=0.4)
    assert first(rate=0.4, force=60.0) == first(rate=0.4)


def test_cost_of_transport_needs_a_weight(reference):
    """It is a share of the work that lifts the robot so far."""
    weightless = eqx.tree_at(lambda s: s.gravity, reference, None)
    with pytest.raises(InputError, match="cost of transport needs gravity"):
        CostOfTransport().worth(weightless, outcomes(), 8.0)


def test_cost_of_transport_is_per_weight_of_each_robot(reference, monkeypatch):
    """Perturbed robots have masses of their own: 3, 6 and 12 kg do the same work over the same way."""
    factors = np.array([0.5, 1.0, 2.0])[:, None] * np.ones((3, 12))
    gaits = Gait((0, 1), 0 * RATE, RATE / np.pi, 1 + 0 * RATE)
    alike = jax.tree.map(lambda x: x[[1, 1, 1]], outcomes())
    rolled = lambda *_: (gaits, Differences(node_mass=factors), alike)  # noqa: E731
    monkeypatch.setattr(judging, "ensembles_rolled_out", rolled)
    fitness = Fitness(CostOfTransport(), Uncertainty(node_mass=0.9), robots=3)
    asked = judging.Judging((judging.RolloutModel(reference, None),), 8.0, fitness)
    one = gaits_of(one_gait(gaits, 0), RATE[:1])
    expected = [-5 / (9.81 * mass) for mass in (3, 6, 12)]
    np.testing.assert_allclose(judging.judge(jax.random.key(0), asked, one).each, [expected], rtol=1e-12)


def test_the_bound_on_rates_holds_for_the_cables_of_each_robot(reference, monkeypatch):
    """A cable that is a tenth longer changes its length a tenth more quickly."""
    cables = np.asarray(reference.structure.cables.rest_length)
    factors = np.array([0.9, 1.0, 1.1])
    amplitude, first = np.full((3, 1), 0.2), len(reference.structure.struts.edges)
    gaits = Gait((first,), 0 * amplitude, amplitude, 1 + 0 * amplitude)
    alike = jax.tree.map(lambda x: x[[1, 1, 1]], outcomes())
    rolled = lambda *_: (gaits, Differences(cable_rest_length=factors[:, None] + 0 * cables), alike)  # noqa: E731
    monkeypatch.setattr(judging, "ensembles_rolled_out", rolled)
    bound = 0.2 * np.pi * float(cables[0])
    fitness = Fitness(Distance(), Uncertainty(prestress=0.1), robots=3, bounds=ActuatorBounds(rate=bound * (1 + 1e-9)))
    asked = judging.Judging((judging.RolloutModel(reference, None),), 8.0, fitness)
    one = gaits_of(one_gait(gaits, 0), amplitude[:1])
    np.testing.assert_allclose(judging.judge(jax.random.key(0), asked, one).excess, [[0, 0, 0.1]], atol=1e-6)


def test_objectives_say_what_they_need():
    """Work, paths and bounds need metrics; distances come without. Objectives of distance have their units."""
    assert [kind().needs_metrics for kind in (Distance, Direction, Speed)] == [False] * 3
    assert [kind().needs_metrics for kind in MEASURED] == [True] * 3
    assert not Fitness().needs_metrics
    assert Fitness(Straightness()).needs_metrics
    assert Fitness(bounds=ActuatorBounds(power=1.0)).needs_metrics
    assert not Fitness(bounds=ActuatorBounds(rate=1.0)).needs_metrics
    assert [kind().unit for kind in (Distance, Speed, Straightness)] == ["m", "body lengths/s", ""]


def on_a_path(path: np.ndarray, failure: int = 0) -> Outcomes:
    """One robot whose centre of mass is at (points, 2), m, at the ends of the parts of the time."""
    points = np.column_stack([path, np.ones(len(path))])[None]
    one = np.array([1])
    return Outcomes(points, np.zeros((1, 12, 3)), np.array([failure]), one, one, None, "rk4", 1e-3)


def test_steady_speed_is_that_of_the_settled_part(reference):
    """The first quarter of the time, here spent on the way back, does not count; a failed robot is worth nothing."""
    x = np.concatenate([np.linspace(5, 0, 6, endpoint=False), np.linspace(0, 9, 19)])
    path = np.column_stack([0.6 * x, 0.8 * x])
    speed = SteadySpeed().worth(reference, on_a_path(path), 24.0)
    np.testing.assert_allclose(speed, [9 / 18], rtol=1e-12)
    assert np.isnan(SteadySpeed().worth(reference, on_a_path(path, failure=1), 24.0)[0])


@pytest.mark.parametrize("size", [1.0, 0.25])
def test_a_quick_start_loses_the_time_before_the_steady_motion(reference, size):
    """A wait of 3 s, a way back of 2 m for another 4 s at 1 m/s; who hardly moves counts as moving at 0.3 m/s. All in
    seconds of a robot of one metre: in one of a quarter, time runs twice as fast."""
    there = np.linspace(0, 24, 25)
    waits, returns = np.maximum(there - 3, 0), np.abs(there - 2)
    small = eqx.tree_at(lambda s: s.structure.struts.rest_length, reference, replace_fn=lambda length: size * length)
    pace = np.sqrt(size)
    for x, lost in ((there, 0.0), (waits, 3.0), (returns, 4.0), (0.01 * there, 24 - 0.24 / 0.3), (0 * there, 24.0)):
        path = size * np.column_stack([0.6 * x, 0.8 * x])
        found = QuickStart().worth(small, on_a_path(path), 24.0 * pace)
        np.testing.assert_allclose(found, [-lost * pace], rtol=1e-12, atol=1e-12)
    assert np.isnan(QuickStart().worth(reference, on_a_path(path, failure=1), 24.0)[0])


@pytest.mark.parametrize("turning", [0.4, -0.4])
def test_steady_turns_are_worth_their_speed_if_they_turn_as_asked(reference, turning):
    """On a circle of 1/0.4 m, to the left and to the right; what it turns too little or too much is held against it."""
    angle = np.sign(turning) * np.linspace(0, 4, 25)
    path = np.column_stack([np.sin(angle), 1 - np.cos(angle)]) / turning
    length = 4 / 24 / 0.4 * 18
    for asked in (turning, 2 * turning, -turning):
        worth = SteadyTurn(turning=asked).worth(reference, on_a_path(path), 24.0)
        expected = length / 18 - 2 * min(1, abs(turning - asked))
        np.testing.assert_allclose(worth, [expected], rtol=1e-9, atol=1e-12)


def test_only_a_direction_depends_on_the_heading(reference):
    """Turned about the vertical, outcomes are worth the same to every other objective, as `any_heading` says; and their
    mirror images are, as `either_hand` says."""
    cosine, sine = np.cos(1.0), np.sin(1.0)
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    angle = np.linspace(0, 2, 25)
    bent = on_a_path(np.column_stack([np.sin(angle), 1 - np.cos(angle)]))
    for kind in OBJECTIVES.values():
        as_it_was = bent if kind().parts > 1 else outcomes()
        for matrix, same in ((turn, kind.any_heading), (np.diag([1.0, -1.0, 1.0]), kind.either_hand)):
            turned = eqx.tree_at(lambda o: o.com_path, as_it_was, replace_fn=lambda x, m=matrix: x @ m)
            before, after = (kind().worth(reference, found, 8.0)[:2] for found in (as_it_was, turned))
            assert np.allclose(before, after, rtol=1e-12) == same, kind


def test_a_steady_direction_is_the_displacement_along_it(reference):
    """Over the settled part, in body lengths a second; against it a robot is worth less than one that stands still."""
    path = np.linspace(0, 1, 25)[:, None] * np.array([12.0, 16.0])
    for heading, share in ((0.0, 0.6), (np.pi / 2, 0.8), (np.pi, -0.6)):
        speed = SteadyDirection(heading).worth(reference, on_a_path(path), 40.0)
        np.testing.assert_allclose(speed, [0.5 * share], rtol=1e-12, atol=1e-12)
        straight = SteadyDirection(heading, sideways=0.5).worth(reference, on_a_path(path), 40.0)
        np.testing.assert_allclose(straight, [0.5 * (share - 0.5 * np.sqrt(1 - share**2))], rtol=1e-12, atol=1e-12)
    assert np.isnan(SteadyDirection().worth(reference, on_a_path(path, failure=1), 40.0)[0])


@pytest.fixture(scope="module")
def judged(exact):
    """32 gaits by four robots each, the second of which tears its own apart, with what they were judged by."""
    doubts = Uncertainty(0.3, 0.1, 0.4, 0.1, 0.1, 0.05, 0.05)
    fitness = Fitness(Direction(heading=0.7), doubts, robots=4, caution=1.5)
    amplitude = np.array([0.3, 0.9, *np.full(30, 0.2)])[:, None] * np.ones((32, 6))
    frequency = np.array([0.5, 47.0, *np.full(30, 0.5)])[:, None] * np.ones((32, 6))
    gaits = gaits_of(exact.gait, random_phases(32, 6, seed=0), jnp.asarray(amplitude), jnp.asarray(frequency))
    problem = SearchProblem(exact, Genome(6), 2.5, fitness)
    return problem, gaits, judge_at(FidelityLevel("", exact, 1e-2, "float64"), gaits, problem, seed=5)


@pytest.mark.slow
def test_fitness_is_the_mean_less_caution_times_the_spread(judged):
    """Of the robots of each ensemble; a gait one of whose robots fails is worth less than any other."""
    _, _, scores = judged
    assert scores.failed[:3].tolist() == [False, True, False]
    assert np.isneginf(scores.fitness[1])
    good = scores.each[[0, 2]]
    assert good.std(1).min() > 1e-3
    np.testing.assert_allclose(scores.mean[[0, 2]], good.mean(1), rtol=1e-12)
    np.testing.assert_allclose(scores.spread[[0, 2]], good.std(1), rtol=1e-12)
    np.testing.assert_allclose(scores.fitness[[0, 2]], good.mean(1) - 1.5 * good.std(1), rtol=1e-12)


@pytest.mark.campaign
def test_each_robot_is_worth_what_it_does(exact, judged):
    """As rolled out from the same draws; all robots of a gait stand in its row."""
    problem, gaits, scores = judged
    fitness = problem.fitness
    many, differences = ensemble(jax.random.key(5), exact, gaits, fitness.uncertainty, fitness.robots)
    alone = simulate_population(exact, many, 2.5, options=SolverOptions(dt=1e-2), differences=differences)
    expected = np.asarray(fitness.objective.worth(exact, alone, 2.5)).reshape(32, 4)
    np.testing.assert_allclose(scores.each, expected, rtol=0, atol=1e-12)
    assert np.isnan(scores.each[1]).any()


@pytest.mark.slow
def test_the_same_seed_draws_the_same_robots(exact, judged):
    """To the last bit; another seed draws others."""
    problem, gaits, scores = judged
    level = FidelityLevel("", exact, 1e-2, "float64")
    np.testing.assert_array_equal(judge_at(level, gaits, problem, seed=5).each, scores.each)
    assert not np.array_equal(judge_at(level, gaits, problem, seed=6).fitness, scores.fitness)


def test_without_uncertainty_one_robot_is_enough():
    """It is the gait's own rollout, however many are asked for: there is no spread. Here, a jump down a slope."""
    strut = Members(((0, 1),), None, np.array([1.0]))
    gait = Gait((0,), np.zeros((2, 1)), np.array([[0.0], [0.2]]), np.ones((2, 1)))
    structure = Structure(np.array([[0.0, 0, 0], [1, 0, 0]]), np.ones(2), strut)
    scene = Scene(structure, 9.81, gait=one_gait(gait, 0), up=np.array([-0.6, 0, 0.8]))
    problem = SearchProblem(scene, Genome(1), 0.5, Fitness(robots=4))
    scores = judge_at(FidelityLevel("", scene, 1e-2, "float64"), gait, problem, seed=0)
    assert scores.each.shape == (2, 1)
    np.testing.assert_array_equal(scores.fitness, scores.each[:, 0])
    np.testing.assert_allclose(scores.fitness, 0.6 * 9.81 * 0.5**2 / 2, rtol=1e-9)
    np.testing.assert_array_equal(scores.spread, 0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ActuatorBounds(rate=0.0), r"^bounds\.rate \(--objective.largest-rate\) = 0: expected a positive"),
        (lambda: ActuatorBounds(force=-1.0), r"^bounds\.force \(--objective.largest-force\) = -1: expected a positive"),
        (lambda: ActuatorBounds(power=float("nan")), r"^bounds\.power \(--objective.largest-power\) = nan: expected"),
        (lambda: Fitness(robots=0), "robots = 0: expected a whole number, at least 1"),
        (lambda: Fitness(caution=1.0), "caution = 1.0: one robot has no spread; expected robots = 2 or more"),
        (lambda: Fitness(robots=2, caution=1.0), "caution = 1.0: nothing is uncertain, nothing spreads"),
    ],
    ids=["rate", "force", "power", "robots", "one robot", "no uncertainty"],
)
def test_bad_objectives_are_refused(make, message):
    """Bounds that are not positive, ensembles too small for what is asked of them."""
    with pytest.raises(InputError, match=message):
        make()


def test_an_unknown_objective_is_refused():
    """With those that there are."""
    with pytest.raises(
        InputError, match="objective = 'far': unknown; expected one of distance, direction, speed, cost"
    ):
        find_objective("far")


@pytest.mark.slow
def test_an_objective_of_ones_own_is_found_by_its_name(monkeypatch):
    """Once it is registered, and a name that is taken already is refused."""

    class Climb(Distance):
        """How far the centre of mass rises, m."""

    monkeypatch.setattr("jaxgrity.search.objectives.OBJECTIVES", dict(OBJECTIVES))
    assert register_objective("climb", Climb) is Climb
    assert find_objective("climb") is Climb
    for taken in ("climb", "distance"):
        with pytest.raises(InputError, match=f"objective = '{taken}': there is one of this name already"):
            register_objective(taken, Climb)
    jaxtyping.config.update("jaxtyping_disable", True)  # of this test alone: conftest.py sets it anew for each
    for kind in (3, Climb(), ActuatorBounds):
        with pytest.raises(InputError, match=r"objective = 'ascent': its kind is .*; expected a subclass of Objective"):
            register_objective("ascent", kind)
    with pytest.raises(InputError, match="objective = 'ascent': unknown"):
        find_objective("ascent")

"""Model-predictive control: what makes a sample good, and that a robot follows the best."""

from dataclasses import replace

import jax
import numpy as np
import pytest

import jaxgrity
from jaxgrity import InputError, SolverOptions, control
from jaxgrity.control import PhaseLocked, Sampling, Steered, centre_offsets, predictive
from jaxgrity.control.choices import choices_of
from jaxgrity.control.closed_loop import Loop
from jaxgrity.control.obstacles import StraightWay
from jaxgrity.control.samples import Sampled, best, between, costs, followed, shifted, sized
from jaxgrity.control.steering import clock_moved
from jaxgrity.model.actuation import contraction

HASTY = Sampling(samples=2, horizon=0.1, interval=0.1)
"""a choice of two ways that is made ten times a second: its programs serve several tests"""


@pytest.fixture(scope="module")
def walker():
    """A robot, and a policy that can be steered, whose gait begins at once."""
    scene, gait = jaxgrity.load_scene("exact"), jaxgrity.load_gait("lasting")
    gait = replace(gait, start=np.array(0.0), ramp=np.array(0.2))
    plant = control.plant_of(scene, gait.members, options=SolverOptions(dt=0.01, dtype="float32"))
    policy = Steered(PhaseLocked(gait), np.array(0.0), centre_offsets(scene.structure, gait.members))
    return plant, jaxgrity.as_dtype(policy, "float32")


def test_costs_prefer_early_arrivals_and_refuse_failures():
    """Of samples that end 2 m away, arrive at the third look, at the second, and fail on the spot."""
    x = np.array([[3.0, 3.0, 3.0, 0.0], [2.5, 1.0, 0.1, 0.0], [2.0, 0.1, 4.0, 0.0]])
    path, failed = np.stack([x, np.zeros_like(x)], axis=1)[:, :, None], np.array([[False, False, False, True]])
    found = costs(path, failed, StraightWay(np.zeros(2)), Sampling(within=0.3, margin=0.1))
    np.testing.assert_array_equal(np.argsort(found), [2, 1, 0, 3])
    assert found[0] == 2.0
    assert found[3] == 1e6


def straight_on(sampling):
    """One robot's gait and bends before its first choice."""
    return np.zeros(1, int), np.zeros((sampling.knots, 1))


@pytest.mark.campaign
def test_a_robot_that_is_led_to_a_goal_comes_closer_than_one_that_is_not(walker):
    """The goal is behind where the open loop rolls to; the model is the robot itself."""
    plant, policy = walker
    loop = control.loop_start(plant, policy, jax.random.key(0))
    alone = np.asarray(control.drive(plant, policy, loop, 10, 100).path)[:, :2]
    goal = -alone[-1]
    led = control.lead_to(plant, plant, policy, goal, sampling=Sampling(samples=16, patience=10.0))
    away = lambda path: np.linalg.norm(path[:, :2] - goal, axis=1).min()  # noqa: E731
    assert away(led.path) < away(alone) - 2
    near = np.linalg.norm(led.path[:, :2] - goal, axis=1) < 0.3
    assert led.reached == near.any()
    assert led.seconds == pytest.approx((len(led.path) - 1) / 100)
    assert led.arrived == len(led.path) - 1
    assert near.sum() == led.reached == near[-1]  # the path ends where the goal is reached
    assert len(led.bends) == np.ceil(led.seconds / 0.5)


@pytest.mark.parametrize("several", [False, True])
def test_rounds_about_the_best_find_better_ways_of_a_cart(walker, monkeypatch, several):
    """Of a cart at 0.5 m/s that turns as it is bent, with its goal out of reach: the last distance is the cost.

    Of several gaits the first turns to the right, the second to the left, where the goal is, and the last one goes
    straight on. Most of the first round turn to the right.
    """
    plant, policy = walker
    loop, goal = control.loop_start(plant, policy, jax.random.key(0)), np.array([-1.0, 1.5])
    choices = choices_of(policy)
    if several:
        choices = control.GaitChoices(jax.tree.map(lambda x: np.repeat(x, 3, axis=-1), choices.policy), ("", "", ""))

    def rolled_out(many, choices, gaits, loop, clocks, bends, ticks):
        turning = np.array([-0.5, 0.5, 0.0])[gaits] if several else 0.0
        heading = np.cumsum(np.concatenate([0 * bends[:1], bends + turning]), axis=0) * 0.1
        steps = 0.05 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        return np.cumsum(steps, axis=0) - steps[0], np.zeros(bends.shape[-1], bool)

    monkeypatch.setattr("jaxgrity.control.samples._rolled_out", rolled_out)

    def away(seed, rounds):
        sampling, draw = sized(Sampling(rounds=rounds), plant.scene), np.random.default_rng(seed)
        found = best(plant, choices, loop, [StraightWay(goal)], draw, sampling, straight_on(sampling))
        return np.linalg.norm(found.path[-1, :, 0, 0] - goal)

    once, more = (np.mean([away(seed, rounds) for seed in range(30)]) for rounds in (1, 4))
    straight = np.linalg.norm(goal - [1.5, 0.0])
    assert more < once < straight - 0.3


@pytest.mark.campaign
def test_rounds_about_the_best_find_better_ways(walker):
    """Of as many rollouts of the model: four rounds of 16, beside one of 64."""
    plant, policy = walker
    loop = control.loop_start(plant, policy, jax.random.key(0))
    loop = control.drive(plant, policy, loop, 300).end
    goal = np.array([-1.0, 1.5])

    def reached(seed, **how):
        sampling, draw = sized(Sampling(**how), plant.scene), np.random.default_rng(seed)
        many, choices = control.side_by_side(plant, sampling.drawn), choices_of(policy)
        found = best(many, choices, loop, [StraightWay(goal)], draw, sampling, straight_on(sampling))
        jump = float(found.turns[0]) / float(policy.policy.gait.frequency[0])
        moved = loop._replace(memory=clock_moved(loop.memory, 1.0, jump))
        _, _, path, _ = followed(plant, choices, 0, moved, between(sampling) @ found.knots[:, 0], 10)
        return np.linalg.norm(np.asarray(path)[-1, :2] - goal)

    once = [reached(seed, samples=64, rounds=1) for seed in range(6)]
    rounds = [reached(seed, samples=64, rounds=4) for seed in range(6)]
    assert np.mean(rounds) < np.mean(once)


def test_what_is_left_of_a_way_is_tried_first(walker):
    """Of one sample for each choice nothing else is tried."""
    plant, policy = walker
    loop = control.loop_start(plant, policy, jax.random.key(0))
    sampling = sized(HASTY._replace(samples=1, rounds=1), plant.scene)
    before = np.zeros(1, int), np.array([[0.1], [-0.2], [0.3]])
    many, way = control.side_by_side(plant, 1), StraightWay(np.ones(2))
    found = best(many, choices_of(policy), loop, [way], np.random.default_rng(0), sampling, before)
    np.testing.assert_array_equal(found.knots, before[1])
    assert found.turns == 0


def test_bends_change_along_straight_lines_between_knots():
    """Seen in the middle of each look; what is left of them an interval later is tried first."""
    sampling = Sampling(horizon=1.0, interval=0.5, knots=3)
    bends = between(sampling) @ np.array([0.0, 0.5, 0.1])
    np.testing.assert_allclose(bends, [0.05, 0.15, 0.25, 0.35, 0.45, 0.46, 0.38, 0.30, 0.22, 0.14])
    np.testing.assert_allclose(between(Sampling(horizon=1.0, knots=1)) @ np.array([0.3]), 0.3)
    knots = np.array([[0.0, 0.3], [0.5, 0.3], [0.1, 0.0]])
    np.testing.assert_allclose(shifted(knots, sampling), [[0.5, 0.3], [0.1, 0.0], [0.1, 0.0]])
    np.testing.assert_array_equal(shifted(np.array([[0.2, -0.1]]), sampling), [[0.2, -0.1]])


def test_a_robot_that_fails_at_once_is_known_where_it_starts(walker, monkeypatch):
    """So its distance from an obstacle is that of its start, without a warning."""
    plant, policy = walker
    q = np.asarray(plant.scene.structure.nodes)
    nodes = np.repeat(q[None], 11, axis=0)
    rolled = lambda plant, choices, gaits, loop, bends, ticks: (loop, nodes, nodes.mean(1), np.asarray(True))  # noqa: E731
    monkeypatch.setattr(predictive, "followed", rolled)
    sampling, none = sized(HASTY, plant.scene), np.zeros(1, int)
    chosen = Sampled(none, np.zeros((3, 1)), np.zeros(1), np.zeros((2, 2, 1, 1)), np.zeros(1))
    _, found = predictive._moved(plant, choices_of(policy), Loop(None, policy.first()), none, chosen, sampling)
    post = control.Discs(np.array([[5.0, 0.0]]), np.array([0.3]))
    ways = [StraightWay(np.array([9.0, 0.0]), post)]
    reached, arrived, gaps = predictive.arrivals([plant.scene], *found, ways, sampling)
    assert (reached.tolist(), arrived.tolist()) == ([False], [1])
    assert gaps == control.gap(post, plant.scene, q)


def test_a_journey_makes_no_choice_beyond_its_patience(walker):
    """60 intervals of 0.1 s, whose sum is not quite 6 s, and one of 0.3 s."""
    plant, policy = walker
    sampling = HASTY._replace(patience=0.3)
    led = control.lead_to(plant, plant, policy, np.array([50.0, 0.0]), sampling=sampling)
    assert len(led.bends) == 3
    assert led.seconds == pytest.approx(0.3)


def test_gaits_of_several_frequencies_have_no_cycle_to_jump_in(walker):
    plant, policy = walker
    gait = policy.policy.gait
    odd = replace(policy, policy=PhaseLocked(replace(gait, frequency=gait.frequency * np.linspace(1, 2, 6))))
    with pytest.raises(InputError, match=r"gait.frequency = .*: expected the same for all members"):
        control.lead_to(plant, plant, odd, np.ones(2))
    with pytest.raises(InputError, match=r"gait.frequency = .*: expected the same for all members"):
        control.gait_choices(jaxgrity.load_scene("exact").structure, {"odd": odd.policy})
    still = PhaseLocked(replace(gait, frequency=0 * gait.frequency))
    with pytest.raises(InputError, match=r"gait.frequency = .*: expected .* above 0 Hz"):
        control.gait_choices(jaxgrity.load_scene("exact").structure, {"still": still})


def test_gaits_to_choose_from_are_in_full_swing_at_every_clock():
    """However short the control period is, and where a jump sets the clock back."""
    structure, gait = jaxgrity.load_scene("exact").structure, jaxgrity.load_gait("lasting")
    choices = control.gait_choices(structure, {"lasting": PhaseLocked(gait)}, dtype="float64")
    chosen = choices.chosen(np.array([0]), np.zeros(1)).policy.gait
    chosen = jax.tree.map(lambda x: x[..., 0], chosen)
    for clock in (-0.4, -1e-4, 0.0, 1e-4, 0.3):
        wave = (1 + np.sin(2 * np.pi * clock * gait.frequency + gait.phase)) / 2
        np.testing.assert_allclose(contraction(chosen, clock), gait.amplitude * wave, rtol=1e-9, atol=1e-12)


@pytest.mark.campaign
def test_one_robot_is_led_as_many_of_one(walker):
    """And has no axis of robots in its journey."""
    plant, policy = walker
    sampling, goal = HASTY._replace(patience=0.6), np.array([0.5, 0.5])
    alone = control.lead_to(plant, plant, policy, goal, sampling=sampling)
    many = control.lead_to(control.side_by_side(plant, 1), plant, policy, [goal], sampling=sampling)
    for name in ("nodes", "path", "arrived", "bends", "gaits", "spread"):
        one, other = getattr(alone, name), getattr(many, name)
        assert other.shape == (*one.shape, 1)
        np.testing.assert_allclose(other[..., 0], one, atol=1e-4)
    assert alone.path.shape == (61, 3)
    assert np.ptp(alone.path[:, :2], axis=0).max() > 1e-3


@pytest.mark.campaign
def test_all_settings_go_together(walker):
    """Two robots, one in the open and one beside a post; several gaits, frictions, knots and rounds."""
    plant, policy = walker
    gaits = control.gait_choices(jaxgrity.load_scene("exact").structure, {"lasting": policy.policy})
    post = control.Discs(np.array([[1.0, 2.0]]), np.array([0.3]))
    goals = [np.array([3.0, 0.0]), control.way_map(post, np.array([-3.0, 0.0]), (-5.0, -5.0, 5.0, 5.0))]
    sampling = Sampling(samples=8, horizon=0.5, interval=0.25, patience=0.5, friction=(0.5, 1.5), seed=3)
    seen: list[int] = []
    led = control.lead_to(control.side_by_side(plant, 2), plant, gaits, goals, sampling=sampling, on_choice=seen.append)
    assert seen == [0, 1]
    assert led.path.shape == (51, 3, 2)
    assert led.nodes.shape == (51, 12, 3, 2)
    assert {np.shape(x) for x in (led.gaits, led.bends, led.spread, led.surprise)} == {(2, 2)}
    assert led.gap[0] == np.inf
    assert 1.0 < led.gap[1] < 2.0
    assert not led.reached.any()
    assert led.spread.max() > 0
    assert led.surprise.max() < 0.05


@pytest.fixture(scope="module")
def learned():
    """A robot, and a learned policy that goes along x."""
    options = SolverOptions(dt=0.01, dtype="float32")
    env = control.environment("heading", jaxgrity.load_scene("exact"), options=options)
    return env.plant, control.Deployed(env, control.load_policy("heading"), heading=[1.0, 0.0])


def test_a_bend_turns_the_heading_of_a_learned_policy(learned):
    """To the left, by half a turn for a bend of 1; all else stays as it is."""
    plant, policy = learned
    turned = choices_of(policy).chosen(np.zeros(3, int), np.array([0.0, 0.5, -1.0]))
    np.testing.assert_allclose(turned.heading, [[1, 0, -1], [0, 1, 0]], atol=1e-6)
    np.testing.assert_array_equal(turned.policy.mean, np.repeat(policy.policy.mean[:, None], 3, axis=1))
    goal = control.Deployed(policy.environment, policy.policy, goal=[1.0, 0.0])
    with pytest.raises(InputError, match=r"policy = Deployed: expected .* or a Deployed with a heading"):
        control.lead_to(plant, plant, goal, np.ones(2))


@pytest.mark.campaign
def test_a_learned_policy_is_led_round_a_post(learned):
    """Which stands on its way where it is not led."""
    plant, policy = learned
    post, goal = control.Discs(np.array([[1.5, -0.1]]), np.array([0.2])), np.array([3.0, 0.0])
    way = control.way_map(post, goal, (-2.0, -3.0, 5.0, 3.0), robot=jaxgrity.load_scene("exact"))
    alone = control.simulate_policy(plant, policy, 3.0)
    assert control.gap(post, plant.scene, np.asarray(alone.positions)).min() < 0
    sampling = Sampling(samples=16, patience=10.0, widest=0.5)
    led = control.lead_to(plant, plant, policy, way, sampling=sampling)
    assert led.reached
    assert led.gap > 0.05


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (np.ones(3), r"goal = \[1. 1. 1.\]: expected a place"),
        (np.array([1.0, np.nan]), r"goal = \[ 1. nan\]: expected a place"),
        ("there", "goal = there: expected a place"),
        ([1.0, 2.0, 3.0], "goal = .*: expected a place"),
    ],
)
def test_goals_that_are_no_places_are_refused(walker, goal, message):
    plant, policy = walker
    with pytest.raises(InputError, match=message):
        control.lead_to(plant, plant, policy, goal)


def test_many_robots_have_a_goal_each(walker):
    plant, policy = walker
    with pytest.raises(InputError, match="goal: 1 for 2 robots; expected one for each"):
        control.lead_to(control.side_by_side(plant, 2), plant, policy, np.ones((1, 2)))


def test_a_policy_of_another_goal_is_led_as_one_without(walker):
    """What it was going to does not count."""
    plant, policy = walker
    sampling = HASTY._replace(patience=0.6)
    goal = np.array([0.5, 0.5])
    paths = [
        control.lead_to(plant, plant, replace(policy, goal=other), goal, sampling=sampling).path
        for other in (None, np.array([-3.0, 1.0], np.float32))
    ]
    np.testing.assert_array_equal(*paths)
    assert np.ptp(paths[0][:, :2], axis=0).max() > 1e-3


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"interval": 0.005}, "interval = 0.005 s: expected a multiple of 0.01 s"),
        ({"interval": 0.255, "horizon": 2.0}, "interval = 0.255 s: expected a multiple of 0.01 s"),
        ({"horizon": 1.05}, "horizon = 1.05 s: expected a multiple of 0.1 s"),
        ({"per_second": 200}, "1 / per_second = 0.005 s: expected a multiple of 0.01 s"),
        ({"within": 0.0}, "within, margin = 0, 0.1 m: expected finite numbers, the first above 0"),
        ({"patience": 0.0}, "patience = 0 s: expected a multiple of 0.5 s"),
        ({"patience": np.nan}, "patience = nan s: expected a multiple of 0.5 s"),
        ({"patience": 0.7}, "patience = 0.7 s: expected a multiple of 0.5 s"),
        ({"horizon": 0.3}, "horizon = 0.3 s: expected at least the interval, 0.5 s"),
        ({"samples": 0}, "samples = 0, rounds = 2, knots = 3, per_second = 10: expected whole numbers, at least 1"),
        ({"samples": 65}, "samples = 65, rounds = 2, .*: expected .* as many samples in each round"),
        ({"samples": 64.0}, "samples = 64.0, .*: expected whole numbers"),
        ({"knots": 0}, "knots = 0, .*: expected whole numbers, at least 1"),
        ({"per_second": 0}, "per_second = 0: expected whole numbers, at least 1"),
        ({"widest": -1.0}, "widest = -1, jumping = 0.5, usual = 0.6: expected numbers from 0 to 1"),
        ({"usual": np.nan}, "widest = 0.6, jumping = 0.5, usual = nan: expected numbers from 0 to 1"),
        ({"seed": -1}, "seed = -1: expected a whole number from 0 on"),
        ({"friction": ()}, r"friction = \(\): expected factors that are not negative, at least one"),
        ({"friction": (1.0, -0.5)}, r"friction = \(1.0, -0.5\): expected factors that are not negative"),
    ],
)
def test_samplings_that_make_no_sense_are_refused(walker, how, message):
    plant, policy = walker
    with pytest.raises(InputError, match=message):
        control.lead_to(plant, plant, policy, np.ones(2), sampling=Sampling(**how))


def test_a_model_that_acts_at_other_times_is_refused(walker):
    plant, policy = walker
    model = replace(plant, period=0.02)
    with pytest.raises(InputError, match=r"model: members .* every 0\.02 s; expected members .* every 0\.01 s"):
        control.lead_to(plant, model, policy, np.ones(2))


def test_policies_without_a_clock_are_refused(walker):
    plant, policy = walker
    blind = replace(policy, policy=control.OpenLoop(policy.policy.gait))
    with pytest.raises(InputError, match=r"policy = Steered\(OpenLoop\): expected a Steered\(PhaseLocked\)"):
        control.lead_to(plant, plant, blind, np.ones(2))

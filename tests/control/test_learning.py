"""Policies are learned, judged, kept and seen; the pieces of the method against their definitions."""

import re
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxgrity import (
    ExactGround,
    Gait,
    InputError,
    Members,
    Scene,
    SolverOptions,
    Structure,
    centre_path,
    load_scene,
)
from jaxgrity.cli import train
from jaxgrity.cli.settings import TrainSettings
from jaxgrity.control import (
    Deployed,
    LearningConfig,
    MotorLimits,
    drive,
    environment,
    episode,
    learn,
    learner,
    load_policy,
    loop_start,
    observe,
    plant_of,
    plant_start,
    policy_names,
    save_policy,
    side_by_side,
    simulate_policy,
    trials,
)
from jaxgrity.control.learned import standardised, untrained
from jaxgrity.control.ppo import AXIS, Learner, Tried, advantages, with_observations
from jaxgrity.io.files import save_json
from jaxgrity.stepping.discretisation import FAILURES

SMALL = LearningConfig(robots=4, decisions=3, held=2, batches=2, epochs=2, width=8)


@pytest.fixture(scope="module")
def env():
    """Half a second of the task speed, in float32."""
    return environment("speed", load_scene("exact"), options=SolverOptions(dt=0.01, dtype="float32"), seconds=0.5)


@pytest.fixture(scope="module")
def first(env):
    return learner(env, jax.random.key(3), SMALL)


def same(a, b) -> bool:
    return all(
        np.array_equal(x, y) for x, y in zip(*(jax.tree.leaves(eqx.filter(each, eqx.is_array)) for each in (a, b)))
    )


@pytest.mark.slow
def test_two_updates_are_one_and_one_more(env, first):
    """Learning goes on from what it returned as if it had never stopped; each update changes the policy."""
    told = []
    both = learn(env, first, 2, SMALL, lambda done, facts: told.append((done, facts["progress"])))
    half = learn(env, first, 1, SMALL)
    assert same(learn(env, half, 1, SMALL), both)
    assert not same(half.policy.network, both.policy.network)
    assert [done for done, _ in told] == [1, 2]
    assert all(np.isfinite(progress) for _, progress in told)
    np.testing.assert_array_equal(both.ages, (np.asarray(first.ages) + 6) % 25)


@pytest.mark.campaign
def test_an_episode_is_the_motion_that_trials_judge(env):
    """Mean progress of the task speed is that of the averaged velocity, which follows from the centre's path.

    By a policy without a pose, which changes at once where rounding decides between two.
    """
    policy = learner(env, jax.random.key(3), replace(SMALL, symmetric=False)).policy
    keys = jax.random.split(jax.random.key(5), 1)
    (progress,) = trials(env, policy, jax.random.key(5), 1)
    motion = episode(env, policy, keys[0])
    assert motion.positions.shape == (51, 12, 3)
    assert motion.commands is not None
    velocity = np.diff(np.asarray(centre_path(motion.scene, motion), float)[:, :2], axis=0) / 0.01
    average, found = np.zeros(2), []
    for v in velocity:
        average = average + (1 - np.exp(-0.01 / env.task.averaged)) * (v - average)
        found.append(np.linalg.norm(average))
    np.testing.assert_allclose(progress, np.mean(found), rtol=1e-3, atol=1e-6)


def test_an_episode_says_how_its_rollout_failed(monkeypatch):
    """Two masses on a cable that is torn at once, since what counts as torn is shorter than it is."""
    monkeypatch.setattr("jaxgrity.stepping.discretisation.TORN", 0.5)
    pair = Structure([[0.0, 0, 5], [1, 0, 5]], [1.0, 2.0], None, Members(((0, 1),), [200.0], [0.9]))
    gait = Gait((0,), [0.0], [0.1], [1.0])
    env = environment("speed", Scene(pair, ground=ExactGround(), gait=gait), seconds=0.01)
    motion = episode(env, lambda seen: seen[:1], jax.random.key(0))
    assert FAILURES[motion.failure] == "the structure was torn apart"


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["heading", "speed"])
def test_policies_of_the_library_roll(name):
    """By steps that they were not trained on, from new starts; the start included, and along the way asked for."""
    env = environment(name, load_scene("exact"), options=SolverOptions(dt=0.005, dtype="float32"), seconds=5.0)
    assert trials(env, load_policy(name), jax.random.key(77), episodes=16).mean() > 0.5


def test_policies_are_found_by_name():
    """Or by file; a name that is nearly right is answered with the right one."""
    assert policy_names() == ("heading", "speed")
    with pytest.raises(
        InputError, match="policy 'spead': unknown; perhaps you meant speed; expected a file, or one of"
    ):
        load_policy("spead")


def test_policies_are_kept(env, tmp_path):
    policy = untrained(env, jax.random.key(1), 8, 2, 4)
    save_policy(policy, tmp_path / "policy.eqx")
    again = load_policy(tmp_path / "policy.eqx")
    assert same(policy, again)
    assert again.held == 4
    (tmp_path / "other").write_text("{}")
    with pytest.raises(InputError, match="other: not a policy; expected a file that save_policy wrote"):
        load_policy(tmp_path / "other")
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        load_policy(tmp_path)
    with pytest.raises(InputError, match="nowhere': unknown; expected a file, or one of heading, speed"):
        load_policy(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("policy", "said"),
    [
        (lambda seen: seen[:5], r"policy: .*; expected actions of shape \(6,\)"),
        (untrained, "policy: takes observations of 7 numbers; expected 104"),
    ],
)
def test_policies_of_other_robots_are_refused(env, policy, said):
    if policy is untrained:
        policy = untrained(env, jax.random.key(1), 8, 2, 4)
        policy = eqx.tree_at(lambda p: p.network, policy, eqx.nn.MLP(7, 6, 8, 1, key=jax.random.key(0)))
    with pytest.raises(InputError, match=said):
        episode(env, policy, jax.random.key(0))


def test_the_page_says_what_is_observed(env):
    """Each row of the table in docs/environments.md, by the sizes of what sensors say of this robot."""
    page = (Path(__file__).parents[2] / "docs" / "environments.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) to (\d+) \| (.*?) \|", page, re.MULTILINE)
    seen = jax.eval_shape(lambda key: observe(env.plant, plant_start(env.plant, key))[0], jax.random.key(0))
    sizes = [np.prod(part.shape, dtype=int) for part in seen._replace(place=jnp.zeros(2))]
    ends = np.cumsum(sizes)
    assert [(int(a), int(b)) for a, b, _ in rows] == list(zip(ends - sizes, ends - 1, strict=True))
    words = ["direction of each", "angular velocity", "length", "tension", "touches", "wanted direction", "contraction"]
    assert all(word in said for word, (_, _, said) in zip(words, rows, strict=True))
    assert seen._fields == ("directions", "spins", "cable_lengths", "tensions", "contact", "place", "contraction")
    assert ends[-1] == env.observation_size == 104


def test_robots_have_to_fit_the_devices(env):
    with pytest.raises(InputError, match="robots = 0: expected"):
        learner(env, jax.random.key(0), LearningConfig(robots=0))


def test_advantages_are_those_of_their_definition(env):
    """A = sum_l (gamma lambda)^l delta_(t+l) until the episode is over, where one that ended is worth nothing more."""
    rng = np.random.default_rng(0)
    size, count = env.observation_size, 6
    seen, later = rng.normal(size=(2, count, 1, size)).astype(np.float32)
    reward, ended = rng.normal(size=(count, 1)).astype(np.float32), np.zeros((count, 1), bool)
    ended[2], over = True, np.zeros((count, 1), bool)
    over[2] = over[4] = True
    now = learner_of(env)
    value = lambda x: float(now.critic(jnp.clip(x, -5, 5)))  # noqa: E731
    gains, targets = advantages(SMALL, now, Tried(seen, None, None, reward, later, ended, over))
    gain = 0.0
    for t in reversed(range(count)):
        delta = 0.03 * reward[t, 0] + 0.97 * (0 if ended[t, 0] else value(later[t, 0])) - value(seen[t, 0])
        gain = delta + 0.97 * 0.95 * (0 if over[t, 0] else gain)
        np.testing.assert_allclose(gains[t, 0], gain, atol=1e-5)
        np.testing.assert_allclose(targets[t, 0], gain + value(seen[t, 0]), atol=1e-5)


@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_mean_and_deviation_are_those_of_all_observations(env, unit):
    """Seen in three parts, on two devices; of lengths that vary by micrometres, too, and of what is always 0."""
    seen = np.random.default_rng(1).normal(2.0 * unit, 3.0 * unit, (3, 2, 5, env.observation_size)).astype(np.float32)
    seen[..., 0] = 0.0
    now = learner_of(env)
    for part in seen:
        after = jax.vmap(lambda x, now=now: places(with_observations(now, x)), axis_name=AXIS)(part)
        mean, deviation, count = (x[0] for x in after)
        policy = eqx.tree_at(lambda p: (p.mean, p.deviation), now.policy, (mean, deviation))
        now = now._replace(policy=policy, seen=count)
    whole = seen.reshape(-1, seen.shape[-1])
    np.testing.assert_allclose(now.policy.mean, whole.mean(0), atol=1e-5 * unit)
    np.testing.assert_allclose(now.policy.deviation, whole.std(0), rtol=1e-4)
    np.testing.assert_allclose(
        standardised(now.policy, whole[-1]),
        (whole[-1] - whole.mean(0)) / np.where(whole.std(0), whole.std(0), 1),
        atol=1e-3,
    )
    assert now.seen == len(whole)


def places(now):
    return now.policy.mean, now.policy.deviation, now.seen


def learner_of(env):
    """One with an untrained policy and critic, and no robots."""
    policy = untrained(env, jax.random.key(1), 8, 2, 2)
    critic = eqx.nn.MLP(env.observation_size, "scalar", 8, 2, jnp.tanh, dtype=jnp.float32, key=jax.random.key(2))
    nothing = jnp.zeros((), jnp.float32)
    return Learner(policy, nothing, critic, None, nothing, nothing, None, None, None)


def test_a_run_of_another_task_is_not_resumed(tmp_path):
    """What was learned for bumps is no policy for headings: refused before anything is compiled."""
    settings = TrainSettings("heading", resume=True, out=tmp_path)
    earlier = train.what_is_learned(replace(settings, task="bumps", seed=1))
    save_json(tmp_path / "curve.json", {"settings": earlier, "curve": [{"progress": 0.1, "seconds": 1.0}]})
    with pytest.raises(InputError, match="its run has task = bumps, not heading, seed = 1, not 0; expected the same"):
        train.main(settings)
    assert len(train.earlier_curve(replace(settings, task="bumps", seed=1, updates=7))) == 1


@pytest.mark.parametrize("content", [[], {"settings": 3, "curve": []}, {"settings": {}, "curve": 3}])
def test_what_no_training_left_is_not_resumed(tmp_path, content):
    save_json(tmp_path / "curve.json", content)
    with pytest.raises(InputError, match="nothing to resume; expected an earlier run"):
        train.earlier_curve(TrainSettings("heading", resume=True, out=tmp_path))


@pytest.fixture(scope="module")
def travelling():
    """An environment for headings, with episodes of half a second, and the library's policy for them."""
    return travelling_environment("float64"), load_policy("heading")


def travelling_environment(dtype):
    return environment("heading", load_scene("exact"), options=SolverOptions(dt=0.01, dtype=dtype), seconds=0.5)


@pytest.fixture(scope="module")
def expected(travelling):
    """One episode, and its heading."""
    env, policy = travelling
    return episode(env, policy, jax.random.key(4)), env.reset(jax.random.key(4)).pipeline_state.aim


def start_of(motion):
    return motion.positions[0], motion.velocities[0]


@pytest.mark.campaign
def test_a_deployed_policy_moves_as_in_its_episode(travelling, expected):
    """From the same start, for the heading that was drawn, of whatever length, and for a goal far along it.

    In double precision: in single precision two programs of the same motion are 1.5e-5 m apart on some processors.
    """
    (env, policy), (expected, aim) = travelling, expected
    for way in ({"heading": 3 * aim}, {"goal": 1e7 * aim}):
        motion = simulate_policy(env.plant, Deployed(env, policy, **way), 0.5, start=start_of(expected))
        np.testing.assert_allclose(motion.commands.contraction, expected.commands.contraction, atol=1e-5)
        np.testing.assert_allclose(motion.positions, expected.positions, atol=1e-5)
    other = simulate_policy(env.plant, Deployed(env, policy, heading=-aim), 0.5, start=start_of(expected))
    assert np.abs(other.positions[-1] - expected.positions[-1]).max() > 0.05


@pytest.mark.campaign
def test_a_deployed_policy_for_any_direction_moves_as_in_its_episode():
    """In double precision, with motors that lag and stall, whose positions follow from no command."""
    motors = MotorLimits(rate=1.0, lag=0.03, force=20.0, stroke=0.4)
    env = environment("speed", load_scene("exact"), options=SolverOptions(dt=0.01), seconds=0.5, motors=motors)
    policy = load_policy("speed")
    expected = episode(env, policy, jax.random.key(4))
    motion = simulate_policy(env.plant, Deployed(env, policy), 0.5, start=start_of(expected))
    np.testing.assert_allclose(motion.positions, expected.positions, atol=1e-7)
    assert np.abs(expected.commands.contraction).max() > 0.1


@pytest.mark.campaign
def test_a_deployed_policy_drives_many_robots_as_one(travelling, expected):
    """In single precision, in which each of them moves as all others, and near the one of double precision."""
    (_, policy), (expected, aim) = travelling, expected
    env = travelling_environment("float32")
    many, deployed = side_by_side(env.plant, 8), Deployed(env, policy, heading=aim)
    start = tuple(np.repeat(x[..., None], 8, axis=-1).astype(np.float32) for x in start_of(expected))
    end = drive(many, deployed, loop_start(many, deployed, jax.random.key(0), start), 50)
    assert end.path.dtype == np.float32
    np.testing.assert_array_equal(end.path[-1], np.repeat(end.path[-1][:, :1], 8, axis=1))
    np.testing.assert_allclose(end.path[-1, :, 0], centre_path(expected.scene, expected)[-1], atol=1e-4)


def test_deployed_policies_that_do_not_fit_are_refused(travelling):
    env, policy = travelling
    for said, kwargs in (
        ("neither heading nor goal given; expected one of heading and goal, since the environment's task wants a", {}),
        ("Deployed: heading and goal given", {"heading": [1.0, 0.0], "goal": [1.0, 0.0]}),
        (r"heading = \[0.0, 0.0\]: expected finite numbers, for a heading not all 0", {"heading": [0.0, 0.0]}),
        (r"goal = \[nan, 0.0\]: expected finite numbers", {"goal": [np.nan, 0.0]}),
        (r"goal has the shape \(3,\): expected \(2,\)", {"goal": [1.0, 2.0, 3.0]}),
    ):
        with pytest.raises(InputError, match=said):
            Deployed(env, policy, **kwargs)
    anywhere = environment("speed", load_scene("exact"))
    with pytest.raises(InputError, match="heading given; expected neither, since the environment's task wants no"):
        Deployed(anywhere, load_policy("speed"), heading=[1.0, 0.0])
    jaxtyping.config.update("jaxtyping_disable", True)  # which users do not have; of this test alone
    with pytest.raises(InputError, match="Deployed: environment is 'heading'; expected a"):
        Deployed("heading", policy, heading=[1.0, 0.0])


class FirstSeen(eqx.Module):
    """A policy that repeats the first numbers that it sees, and holds them for four control periods of learning."""

    held: int = eqx.field(static=True, default=4)

    def __call__(self, seen):
        return seen[:6]


@pytest.mark.parametrize("period", [pytest.param(0.005, marks=pytest.mark.campaign), 0.01, 0.03])
def test_a_deployed_policy_acts_as_often_as_in_learning(travelling, period):
    """Every 0.04 s, to the nearest control period of the plant, however long those are."""
    env, _ = travelling
    deployed = Deployed(env, FirstSeen(), heading=[1.0, 0.0])
    shapes = jax.eval_shape(lambda key: observe(env.plant, plant_start(env.plant, key))[0], jax.random.key(0))
    memory, acted = deployed.first(), []
    for tick in range(round(0.24 / period)):
        seen = jax.tree.map(lambda x, tick=tick: np.full(x.shape, tick * period), shapes)
        _, memory = deployed(seen, (tick + 1) * period, memory)
        acted.append(float(memory[0][0]))
    np.testing.assert_allclose(sorted(set(acted)), 0.04 * np.arange(6), rtol=0, atol=period / 2 + 1e-9)


def test_a_deployed_policy_of_another_robot_is_refused(travelling):
    """Where it is made; on a plant with other members; and, before anything compiles, with other sensors' readings."""
    env, policy = travelling
    smaller = eqx.tree_at(lambda p: p.network, policy, eqx.nn.MLP(7, 6, 8, 1, key=jax.random.key(0)))
    with pytest.raises(InputError, match="policy: takes observations of 7 numbers; expected 104"):
        Deployed(env, smaller, heading=[1.0, 0.0])
    deployed = Deployed(env, policy, heading=[1.0, 0.0])
    with pytest.raises(InputError, match=r"policy.members = \(0, 1, .*: expected \(0, 1\)"):
        simulate_policy(plant_of(load_scene("exact"), (0, 1)), deployed, 0.1)
    more_cables = plant_of(load_scene("paper_program"), env.plant.members)
    with pytest.raises(InputError, match="plant: its sensors tell 116 numbers; expected 104, as in the policy's"):
        simulate_policy(more_cables, deployed, 0.1)

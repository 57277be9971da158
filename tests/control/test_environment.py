"""Environments: the same seed is the same episode, and numbers stay finite."""

import itertools
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrity
from jaxgrity import InputError, SolverOptions, control
from jaxgrity.control import TASKS, Situation

QUICK = SolverOptions(dt=0.01, dtype="float32")


@pytest.fixture(scope="module")
def scene():
    return jaxgrity.load_scene("exact")


@pytest.fixture(scope="module")
def goal(scene):
    """With 0.2 s for the goal, and a short stroke."""
    return control.environment("goal", scene, options=QUICK, seconds=0.2, motors=control.MotorLimits(stroke=0.3))


@pytest.fixture(scope="module")
def jitted(goal):
    """Its `reset` and `step`."""
    return jax.jit(goal.reset), jax.jit(goal.step)


def test_many_episodes_under_a_random_policy(goal):
    """Mapped and jitted: they differ, are over in time, can be repeated, and hold no number that is not finite."""
    keys = jax.random.split(jax.random.key(0), 4)

    @jax.jit
    def episodes(keys):
        def step(state, key):
            actions = jax.random.uniform(key, (4, goal.action_size), minval=-1.5, maxval=1.5)
            state = jax.vmap(goal.step)(state, actions)
            return state, (state.obs, state.reward, state.done)

        return jax.lax.scan(step, jax.vmap(goal.reset)(keys), jax.random.split(keys[0], 20))

    end, (obs, reward, done) = episodes(keys)
    assert obs.shape == (20, 4, goal.observation_size)
    assert np.all(np.isfinite(obs))
    assert np.all(np.isfinite(reward))
    assert np.ptp(reward[-1]) > 0
    np.testing.assert_array_equal(done.sum(0), 1)
    np.testing.assert_array_equal(done[-1], 1)
    np.testing.assert_array_equal(end.info["truncation"], 1)
    np.testing.assert_array_equal(episodes(keys)[1][1], reward)


def test_an_episode_is_over_at_the_goal_and_where_the_rollout_fails(goal, jitted):
    """A failed one has an observation and a reward of zero."""
    reset, step = jitted
    state = reset(jax.random.key(0))
    plant, _, average, _ = state.pipeline_state
    place = jaxgrity.stepping.centre_of_mass(goal.plant.scene, plant.motion[0])[:2]
    there = step(state.replace(pipeline_state=Situation(plant, place, average, jnp.zeros((), jnp.int32))), jnp.zeros(6))
    assert there.done == there.metrics["reached"] == 1
    away = there.pipeline_state._replace(aim=place + 5)
    later = step(there.replace(pipeline_state=away), jnp.ones(6))
    assert later.done == later.metrics["reached"] == 1
    assert there.info["truncation"] == later.info["truncation"] == 0
    assert there.reward != 0 == later.reward
    q, v = plant.motion
    broken = plant._replace(motion=(q * jnp.nan, v))
    lost = step(state.replace(pipeline_state=Situation(broken, place, average, jnp.zeros((), jnp.int32))), jnp.zeros(6))
    assert lost.done == lost.metrics["failed"] == 1
    assert lost.reward == 0
    assert not lost.obs.any()


def rolled(env, key, actions):
    """The states of an episode, the start included, and where the centre of mass is in each, m."""
    first = env.reset(key)
    _, states = jax.lax.scan(lambda state, action: (env.step(state, action),) * 2, first, actions)
    q = jnp.concatenate([first.pipeline_state.plant.motion[0][None], states.pipeline_state.plant.motion[0]])
    return first, states, jax.vmap(lambda x: jaxgrity.stepping.centre_of_mass(env.plant.scene, x))(q)


@pytest.mark.parametrize(
    "task",
    [pytest.param(name, marks=pytest.mark.slow) for name in ("goal", "speed")]
    + [pytest.param(name, marks=pytest.mark.campaign) for name in ("heading", "slope")],
)
def test_rewards_are_progress_less_what_effort_costs(task, scene):
    """By hand, from places and contractions; and the wanted direction is what the observation says it is."""
    env = control.environment(task, scene, options=QUICK, seconds=0.5, effort_cost=0.01)
    actions = jax.random.uniform(jax.random.key(2), (40, 6), minval=-1, maxval=1)
    first, states, place = jax.jit(lambda: rolled(env, jax.random.key(1), actions))()
    place, aim = np.asarray(place, float)[:, :2], np.asarray(first.pipeline_state.aim, float)
    velocity = np.diff(place, axis=0) / 0.01
    if task == "speed":
        average = np.zeros((41, 2))
        for k, v in enumerate(velocity):
            average[k + 1] = average[k] + (1 - np.exp(-0.01)) * (v - average[k])
        progress, wanted = np.linalg.norm(average[1:], axis=1), np.zeros((40, 2))
    else:
        wanted = {"heading": aim + 0 * place, "slope": [-1, 0] + 0 * place}.get(task, aim - place)
        wanted = wanted / np.linalg.norm(wanted, axis=1, keepdims=True)
        progress, wanted = np.sum(velocity * wanted[:-1], axis=1), wanted[1:]
    np.testing.assert_allclose(states.metrics["progress"], progress, atol=2e-4)
    contracted = np.concatenate([np.zeros((1, 6)), states.pipeline_state.plant.contraction])
    effort = np.mean((np.diff(contracted, axis=0) / 0.01) ** 2, axis=1)
    np.testing.assert_allclose(states.reward, progress - 0.01 * effort, atol=2e-4)
    assert effort.max() > 1
    np.testing.assert_allclose(states.obs[:, -8:-6], wanted, atol=1e-4)
    np.testing.assert_array_equal(states.obs[:, -6:], contracted[1:])


@pytest.mark.parametrize(("task", "wanted"), [("heading", [0.6, 0.8]), ("slope", [-1.0, 0.0]), ("goal", [0.0, 1.0])])
def test_progress_is_the_velocity_along_the_wanted_direction(task, wanted):
    """Of a robot at the origin that moves along x and y: a heading, uphill, and the way to a goal on the y axis."""
    before, place = np.zeros(3), np.array([3e-3, 5e-3, -7e-3])
    aim = np.array([0.0, 2.0]) if task == "goal" else np.array([0.6, 0.8])
    progress, _ = TASKS[task].progressed(aim, before, place, 0.01, np.zeros(2))
    np.testing.assert_allclose(progress, np.dot([0.3, 0.5], wanted), rtol=1e-4)


@pytest.mark.parametrize("name", TASKS)
def test_a_task_is_the_same_for_a_small_robot(scene, name):
    """One of 1 cm, ten times as quick, 2 cm from its goal and near the place where it is told to stop."""
    struts = lambda s: s.structure.struts.rest_length  # noqa: E731
    small = eqx.tree_at(struts, scene, 0.01 * struts(scene))
    aim, before, place = np.array([0.6, 0.8]), np.array([0.59, 0.79, 1.0]), np.array([0.598, 0.791, 1.0])
    if name == "goal":
        aim = 1.01 * aim
    (big, u), (little, w) = (
        control.find_task(name, robot).progressed(direction, a, b, period, np.array([0.3, -0.2]) * speed)
        for robot, direction, a, b, period, speed in (
            (scene, aim, before, place, 0.01, 1.0),
            (small, 0.01 * aim if name == "goal" else aim, 0.01 * before, 0.01 * place, 0.001, 0.1),
        )
    )
    assert abs(big) > 0.01
    np.testing.assert_allclose([little, *w], 0.1 * np.array([big, *u]), rtol=1e-6)
    assert control.find_task(name, scene) == TASKS[name]
    assert control.find_task("goal", small).reached == pytest.approx(0.003)


class StopAtLine(control.Task):
    """A task of a user's own, whose direction is in the precision of JAX, not of the robot."""

    line = 0.5

    def wanted_direction(self, aim, place):
        return jnp.array([jnp.clip(self.line - place[0], -0.3, 0.3), 0.0], float)


class Doubled(control.Task):
    """What it remembers is in the precision of JAX, not of the robot."""

    def progressed(self, aim, before, place, period, average):
        return jnp.dot((place - before)[:2], aim) / period, jnp.asarray(average, float) + 1


def test_a_task_of_ones_own_may_remember_in_another_precision(scene):
    """Its episodes are stepped in a loop all the same."""
    env = control.environment(Doubled("heading"), scene, options=QUICK)

    def episode(key):
        return jax.lax.scan(lambda state, action: (env.step(state, action), 0), env.reset(key), jnp.zeros((2, 6)))[0]

    assert jax.eval_shape(episode, jax.random.key(0)).pipeline_state.average.dtype == np.float32


@pytest.mark.parametrize("way", [{"heading": [0.0, 2.0]}, {"goal": [3.0, 1.0]}, {}])
def test_a_policy_for_a_task_of_ones_own_is_deployed_with_its_direction(scene, way):
    """It is told what the environment told it, whatever was drawn there."""
    env = control.environment(StopAtLine("heading" if way else "anywhere"), scene, options=QUICK)
    deployed = control.Deployed(env, lambda seen: jnp.concatenate([seen[96:98], 0 * seen[:4]]), **way)
    q = jnp.asarray(env.plant.scene.structure.nodes)
    seen = jax.jit(control.measure)(env.plant.scene, 0.0, q, 0 * q)._replace(contraction=jnp.zeros(6))
    for x, wanted in ((0.0, 0.3), (0.4, 0.1), (0.6, -0.1)):
        command, _ = deployed(seen._replace(place=jnp.array([x, 0.2, 0.5])), 0.0, deployed.first())
        expected = env.commanded(jnp.array([wanted, 0, 0, 0, 0, 0]))
        np.testing.assert_allclose(command, expected, atol=1e-6)


def test_a_task_of_ones_own_is_observed_and_rewarded(scene):
    """At the line it wants nothing; the reward is the velocity along the direction that was observed before."""
    env = control.environment(StopAtLine("heading"), scene, options=QUICK, effort_cost=0.0)
    place = lambda state: jaxgrity.stepping.centre_of_mass(env.plant.scene, state.pipeline_state.plant.motion[0])  # noqa: E731

    @jax.jit
    def rolled(key):
        def step(state, action):
            after = env.step(state, action)
            return after, (after.obs[96:98], after.reward, place(after))

        state = env.reset(key)
        actions = jax.random.uniform(key, (30, 6), minval=-1.0)
        return state, place(state), jax.lax.scan(step, state, actions)[1]

    first, start, (seen, reward, places) = rolled(jax.random.key(0))
    places = np.vstack([start, places])
    np.testing.assert_allclose(seen, np.array([[np.clip(0.5 - x, -0.3, 0.3), 0.0] for x in places[1:, 0]]), atol=1e-6)
    wanted = np.vstack([first.obs[96:98], seen[:-1]])
    np.testing.assert_allclose(reward, (np.diff(places[:, :2], axis=0) / 0.01 * wanted).sum(1), atol=1e-4)
    assert np.abs(reward).max() > 0.01
    assert first.obs.dtype == np.float32


def test_shaking_in_place_is_no_progress():
    """Where any direction is as good as another: a place that swings by 5 cm twice a second, and one that goes on."""
    times = np.arange(0, 10, 0.01)
    swinging = np.stack([0.05 * np.sin(4 * np.pi * times), 0 * times, 0 * times], axis=1)
    going = np.stack([0.3 * times, 0 * times, 0 * times], axis=1)
    means = []
    for path in (swinging, going):
        average, told = np.zeros(2), []
        for before, place in itertools.pairwise(path):
            progress, average = TASKS["speed"].progressed(np.zeros(2), before, place, 0.01, average)
            told.append(progress)
        means.append(np.mean(told))
    assert np.mean(np.abs(np.diff(swinging[:, 0]))) / 0.01 > 0.3
    assert means[0] < 0.05
    assert means[1] == pytest.approx(0.3 * 0.9, abs=0.01)


@pytest.mark.campaign
def test_gradient_of_rewards_is_that_of_central_differences(scene):
    """In the action, of a robot that has come to rest on a face, where nothing switches."""
    lagging = control.MotorLimits(lag=0.05, stroke=0.5)
    env = control.environment("heading", scene, options=SolverOptions(dt=0.01), motors=lagging)

    def on(state, action, ticks):
        def step(state, _):
            state = env.step(state, action)
            return state, (state.reward, state.metrics["progress"])

        return jax.lax.scan(step, state, length=ticks)

    state, _ = jax.jit(lambda: on(env.reset(jax.random.key(1)), -jnp.ones(6), 300))()
    assert np.sum(np.all(np.abs(state.pipeline_state.plant.motion[1]) < 1e-9, axis=1)) == 3  # it stands on them
    at = jnp.linspace(-0.9, -0.8, 6)

    def totals(action):
        sums = jnp.stack(on(state, action, 10)[1]).sum(1)
        return sums, sums

    both = jax.jit(jax.jacrev(totals, has_aux=True))
    gradient, _ = both(at)
    for a in (0, 4):
        up, down = (both(at.at[a].add(s))[1] for s in (1e-5, -1e-5))
        np.testing.assert_allclose(gradient[:, a], (up - down) / 2e-5, rtol=1e-6)
        assert np.abs(gradient[:, a]).min() > 1e-3


def test_actions_shorten_members_up_to_the_stroke(jitted):
    """-1 not at all, 1 by the motors' stroke, and what is beyond does not count."""
    reset, step = jitted
    state = step(reset(jax.random.key(0)), jnp.array([-1.0, 0.0, 1.0, 5.0, -5.0, 0.5]))
    expected = [0.0, 0.15, 0.3, 0.3, 0.0, 0.225]
    np.testing.assert_allclose(state.pipeline_state.plant.contraction, expected, atol=1e-6)


def test_uphill_is_where_the_ground_rises(scene):
    """Towards +x on a negative incline. That of a scene is refused: the task does not know of it."""
    for incline in (0.1, -0.1):
        task = control.Task("uphill", incline=incline)
        up = task.wanted_direction(np.zeros(2), np.zeros(3))
        here, there = control.ground_of(task, scene, seed=0).ground.height([0.0, up[0]], [0.0, up[1]])
        assert there > here
    leaning = replace(scene, ground=replace(scene.ground, incline=-0.1))
    with pytest.raises(InputError, match=r"ground.incline = -0.1: it rises towards \+x; expected a level plane"):
        control.environment(control.Task("uphill"), leaning)


def test_tasks_keep_the_ground_that_they_do_not_bring(scene):
    """A heading may be asked for on a scene's own slope; a slope of the task's own may not, and is not dropped."""
    steep = replace(scene, ground=replace(scene.ground, incline=0.1))
    assert control.ground_of(TASKS["heading"], steep, seed=0).ground.incline == 0.1
    leaning = replace(scene, up=np.array([0.0, np.sin(0.1), np.cos(0.1)]))
    for task, other in itertools.product(("slope", "bumps"), (steep, leaning)):
        with pytest.raises(InputError, match="this task brings its own; expected a scene on a level plane"):
            control.environment(task, other)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_wrappers_of_brax_accept_environments(dtype, scene):
    """Where Brax is installed, with its own, float64 being allowed: as long episodes as the environment's own, which
    are cut and begin anew, also after failures, and sums of what happened; in a scan, as learners roll out."""
    training = pytest.importorskip("brax.envs.wrappers.training")
    options = SolverOptions(dt=0.01, dtype=dtype)
    goal = control.environment("goal", scene, options=options, seconds=0.15, motors=control.MotorLimits(stroke=0.3))
    env = training.EvalWrapper(training.wrap(goal, episode_length=15))
    start = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), 3))
    actions = np.ones((31, 3, 6), np.float32)
    actions[4, 1, 2] = np.nan

    def step(state, action):
        state = env.step(state, action)
        return state, (state.done, state.info["truncation"], state.metrics["failed"], state.obs)

    end, (done, cut, failed, obs) = jax.jit(lambda s, a: jax.lax.scan(step, s, a))(start, actions)
    ends = [[14, 29], [4, 19], [14, 29]]
    for k, expected in enumerate(ends):
        np.testing.assert_array_equal(np.flatnonzero(done[:, k]), expected)
        np.testing.assert_array_equal(np.flatnonzero(cut[:, k]), [tick for tick in expected if tick != 4])
        for tick in expected:
            np.testing.assert_array_equal(obs[tick, k], start.obs[k])
    np.testing.assert_array_equal(np.argwhere(failed), [[4, 1]])
    np.testing.assert_array_equal(end.info["eval_metrics"].episode_steps, [15, 5, 15])
    np.testing.assert_array_equal(end.info["eval_metrics"].episode_metrics["failed"], [0, 1, 0])
    np.testing.assert_array_equal(end.pipeline_state.plant.tick, [1, 11, 1])
    assert np.isfinite(obs).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "task",
    ["recover", *(pytest.param(name, marks=pytest.mark.campaign) for name in ("bumps", "heading", "slope"))],
)
def test_starts_stand_just_above_their_ground(task, scene):
    """Within a body length where the robot has fallen, and within a few centimetres else; seeds draw other starts."""
    env = control.environment(task, scene, options=QUICK)
    ground = env.plant.scene.ground

    @jax.jit
    @jax.vmap
    def starts(key):
        q, v = control.task_start(env.task, env.plant.scene, key)
        return q, v, jnp.min(ground.signed_distance(q))

    q, v, gaps = starts(jax.random.split(jax.random.key(0), 3))
    assert 0 < gaps.min() <= gaps.max() < (1.1 if env.task.fallen else 0.05)
    assert np.abs(q[0] - q[1]).max() > 0.1
    assert np.any(v) == env.task.fallen


def test_a_stuck_member_makes_no_effort(scene, goal):
    """Whatever it is commanded: the cost counts how fast the others shorten."""
    struts = replace(scene.structure.struts, stuck=(0, 4))
    stuck = replace(scene, structure=replace(scene.structure, struts=struts))
    env = control.environment("goal", stuck, options=QUICK, seconds=0.2, motors=goal.plant.motors)
    change = 0.01 * np.arange(1.0, 7.0)
    assert goal._effort(change) == pytest.approx(np.mean((change / 0.01) ** 2))
    change[[0, 4]] = 0
    assert env._effort(0.01 * np.arange(1.0, 7.0)) == pytest.approx(np.mean((change / 0.01) ** 2))


def test_bad_input_is_refused(scene):
    """In one line, before anything compiles."""
    with pytest.raises(InputError, match="task = 'fly': unknown"):
        control.environment("fly", scene)
    with pytest.raises(InputError, match=r"task\.towards = 'moon': expected one of anywhere, heading"):
        control.environment(control.Task("moon"), scene)
    with pytest.raises(InputError, match=r"task.averaged = 0 s: expected a positive number"):
        control.environment(control.Task("anywhere", averaged=0.0), scene)
    with pytest.raises(InputError, match=r"task.fallen = 'no': expected True or False"):
        control.environment(control.Task("anywhere", fallen="no"), scene)
    with pytest.raises(InputError, match=r"task.incline = '5 degrees' rad: expected a number from -1.57"):
        control.environment(control.Task("uphill", incline="5 degrees"), scene)
    with pytest.raises(InputError, match=r"task.distance = -1 m: expected a finite number, at least 0"):
        control.environment(control.Task("goal", distance=-1), scene)
    with pytest.raises(InputError, match=r"task.reached = 0 m: expected a positive number"):
        # at the goal the direction to it would be 0/0
        control.environment(control.Task("goal", reached=0.0), scene)
    bent = type("Bent", (control.Task,), {"wanted_direction": lambda self, aim, place: place})
    with pytest.raises(InputError, match=r"Bent.wanted_direction: returns .*expected an array of shape \(2,\)"):
        control.environment(bent("heading"), scene)
    short = type("Short", (control.Task,), {"wanted_direction": lambda self, place: place[:2]})
    with pytest.raises(
        InputError, match=r"^Short.wanted_direction: TypeError: .* positional arguments .*expected a fu"
    ):
        control.environment(short("heading"), scene)
    every = lambda self, aim, before, place, period, average: ((place - before)[:2] / period, average)  # noqa: E731
    last = lambda self, aim, before, place, period, average: (jnp.sum(place), place)  # noqa: E731
    for progressed in (every, last, lambda self, aim, before, place, period, average: jnp.sum(place)):
        odd = type("Odd", (control.Task,), {"progressed": progressed})
        with pytest.raises(InputError, match=r"Odd.progressed: returns .*expected a number, and two to remember"):
            control.environment(odd("heading"), scene)
    with pytest.raises(InputError, match="the scene has no gait"):
        control.environment("speed", jaxgrity.with_gait(scene, None))
    for seconds in (-1.0, 0.0, np.nan, np.inf, 0.015):
        with pytest.raises(InputError, match=f"seconds = {seconds:g} s: expected a multiple of 0.01 s"):
            control.environment("speed", scene, seconds=seconds)
    with pytest.raises(InputError, match="effort_cost = nan m s: expected a finite number, at least 0"):
        control.environment("speed", scene, effort_cost=np.nan)
    env = control.environment("speed", scene)
    for key in (0, jnp.zeros(2), jax.random.split(jax.random.key(0), 4)):
        with pytest.raises(InputError, match=r"key of type .*: expected one key"):
            env.reset(key)
        with pytest.raises(InputError, match=r"key of type .*: expected one key"):
            control.task_start(env.task, scene, key)
    states = jax.eval_shape(jax.vmap(env.reset), jax.random.split(jax.random.key(0), 4))
    with pytest.raises(InputError, match=r"over, keys: shapes \(\) and \(4,\); expected one of each"):
        env.reset_where(np.ones((), bool), states, jax.random.split(jax.random.key(0), 4))
    with pytest.raises(InputError, match=r"over, keys: shapes \(\) and \(\); .*of many episodes"):
        env.reset_where(np.ones((), bool), jax.eval_shape(env.reset, jax.random.key(0)), jax.random.key(0))
    with pytest.raises(InputError, match=r"action has shape \(\); expected \(6,\)"):
        env.step(jax.eval_shape(env.reset, jax.random.key(0)), np.zeros(()))

"""Starts: as far above any ground as the task says, possible, and the same in both precisions."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrity
from jaxgrity import Box, InputError, SolverOptions, Stairs, Union, control
from jaxgrity.model.balls import Balls
from jaxgrity.model.surface import Slope

WANTED = 0.02
"""m"""


@pytest.fixture(scope="module")
def scene():
    return jaxgrity.load_scene("exact")


def to_box(q, centre, size):
    """m, from each node to an upright box, without its inside."""
    beyond = np.maximum(np.abs(q - centre) - np.asarray(size) / 2, 0)
    return np.linalg.norm(beyond, axis=-1)


def to_plane(incline):
    return lambda q: q[..., 0] * np.sin(incline) + q[..., 2] * np.cos(incline)


def to_step(q):
    """m, to level ground of which all beyond x = -0.1 is 0.3 higher."""
    return np.minimum(q[..., 2], to_box(q, np.array([99.9, 0, -99.7]), (200.0, 200.0, 200.0)))


def to_block(q):
    """m, to level ground with a block that is a part of a robot wide."""
    return np.minimum(q[..., 2], to_box(q, np.array([0.3, 0.2, 0.15]), (0.3, 0.4, 0.5)))


GROUNDS = [
    ({"incline": 0.2}, to_plane(0.2)),
    ({"incline": 0.5}, to_plane(0.5)),
    ({"surface": Stairs(0.3, 1.0, 1, start=-0.1)}, to_step),
    ({"surface": Union((Slope(), Box([0.3, 0.2, 0.15], [0.3, 0.4, 0.5])))}, to_block),
]


@pytest.mark.slow
@pytest.mark.parametrize(("ground", "distance"), GROUNDS)
@pytest.mark.parametrize("name", ["exact", pytest.param("reference", marks=pytest.mark.campaign)])
def test_balls_start_as_far_above_any_ground_as_the_task_says(ground, distance, name):
    """Their surfaces: nodes without one may be below the ground, which they pass."""
    scene, task = jaxgrity.load_scene(name), control.TASKS["heading"]
    nodes, radius = (0, 3, 4, 7, 10), np.array([0.05, 0.1, 0.05, 0.2, 0.0])
    scene = replace(scene, ground=replace(scene.ground, balls=Balls(nodes, radius), **ground))
    starts = jax.jit(jax.vmap(lambda key: control.task_start(task, scene, key)[0]))
    q = np.asarray(starts(jax.random.split(jax.random.key(0), 50)))
    np.testing.assert_allclose((distance(q)[:, nodes] - radius).min(1), WANTED, atol=1e-8)
    assert np.any(distance(q).min(1) < 0)


@pytest.mark.parametrize(("ground", "distance"), GROUNDS[1:3])
@pytest.mark.parametrize("gap", [0.0, -0.003])
def test_balls_are_set_on_the_ground_too_or_into_it(ground, distance, gap):
    """On a slope too, where a ball that touches the ground below its centre is in the ground beside it."""
    nodes, radius = (0, 1), np.array([0.1, 0.05])
    q = np.array([[0.0, 0, 1], [0.3, 0, 1.1], [0, 0.4, 1.3]])
    placed = jaxgrity.ExactGround(balls=Balls(nodes, radius), **ground).set_above(jnp.asarray(q), gap)
    assert (distance(np.asarray(placed))[..., nodes] - radius).min() == pytest.approx(gap, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("ground", "distance"), GROUNDS)
def test_robots_start_as_far_above_any_ground_as_the_task_says(ground, distance, scene):
    """By distances of the test's own, however the robot is turned."""
    env = control.environment("heading", replace(scene, ground=replace(scene.ground, **ground)))
    starts = jax.jit(jax.vmap(lambda key: control.task_start(env.task, env.plant.scene, key)))
    q, v = starts(jax.random.split(jax.random.key(0), 50))
    np.testing.assert_allclose(distance(np.asarray(q)).min(1), WANTED, atol=1e-8)
    assert np.ptp(np.asarray(q)[..., 2]) > 0.5
    assert not np.any(v)


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["exact", "reference"])
def test_struts_that_touch_between_their_ends_start_above_a_post(name):
    """As far as the task says, by points along all struts; as built, and turned: the post is below the robot's middle,
    where it has few nodes."""
    post = np.array([0.0, 0.0, 0.2]), np.array([0.06, 0.06, 0.8])
    scene = jaxgrity.load_scene(name)
    scene = replace(scene, ground=replace(scene.ground, surface=Union((Slope(), Box(*post)))))
    scene, task = jaxgrity.with_contact_along_struts(scene, 9), control.TASKS["heading"]
    starts = jax.jit(jax.vmap(lambda key: control.task_start(task, scene, key)[0]))
    built = control.ground_of(task, scene, seed=0).structure.nodes
    q = np.concatenate([built[None], starts(jax.random.split(jax.random.key(0), 50))])
    share = np.linspace(0, 1, 2001 if name == "exact" else 11)[:, None]
    ends = q[:, np.array(scene.structure.struts.edges)]
    along = (1 - share) * ends[:, :, None, 0] + share * ends[:, :, None, 1]
    nodes, struts = (np.minimum(x[..., 2], to_box(x, *post)) for x in (q, along))
    np.testing.assert_allclose(struts.min((1, 2)), WANTED, atol=1e-4)
    assert np.mean(nodes.min(1) > WANTED + 0.01) > 0.1


@pytest.mark.campaign
def test_robots_start_as_far_above_bumps_as_the_task_says(scene):
    """By the nearest of many points of the ground."""
    env = control.environment("bumps", scene)
    for k in range(3):
        q = np.asarray(control.task_start(env.task, env.plant.scene, jax.random.key(k))[0])
        phi = np.asarray(env.plant.scene.ground.signed_distance(jnp.asarray(q)))
        node = q[phi.argmin()]
        side = np.linspace(-0.05, 0.05, 401)
        x, y = (a.ravel() for a in np.meshgrid(node[0] + side, node[1] + side))
        ground = np.stack([x, y, env.plant.scene.ground.height(x, y)], axis=1)
        assert np.linalg.norm(node - ground, axis=1).min() == pytest.approx(WANTED, abs=1e-4)


@pytest.mark.parametrize("task", ["heading", "goal", "recover"])
def test_a_key_is_the_same_start_in_both_precisions(task, scene):
    """To rounding: where the robot is, how it moves, and where it is to go."""
    single, double = (
        control.environment(task, scene, options=SolverOptions(dt=0.01, dtype=dtype)).reset(jax.random.key(7))
        for dtype in ("float32", "float64")
    )
    for a, b in zip(single.pipeline_state.plant.motion, double.pipeline_state.plant.motion):
        np.testing.assert_allclose(a, b, atol=5e-6)
    np.testing.assert_allclose(single.pipeline_state.aim, double.pipeline_state.aim, atol=5e-6)


@pytest.mark.parametrize("task", ["heading", "recover"])
def test_robots_start_where_the_scene_has_them(task, scene):
    """Above the same place, such as the middle of a height map, not the origin; their goals are about it, too."""
    there = replace(scene, structure=replace(scene.structure, nodes=np.add(scene.structure.nodes, [3.0, -4.0, 0.0])))
    q, v = jax.jit(lambda key: control.task_start(control.TASKS[task], there, key))(jax.random.key(0))
    np.testing.assert_allclose(jaxgrity.stepping.centre_of_mass(scene, q)[:2], [3.0, -4.0], atol=1e-12)
    spun = np.cross(q - np.mean(q, axis=0), v - np.mean(v, axis=0)).sum(0)
    assert np.any(np.abs(spun) > 0.1) == (task == "recover")


def test_supports_stay_where_they_are(scene):
    """A robot with a support starts as it is posed, and cannot be asked to fall."""
    held = replace(scene, structure=replace(scene.structure, fixed=((3, "xyz"),)))
    env = control.environment("heading", held)
    state = env.reset(jax.random.key(0))
    np.testing.assert_allclose(state.pipeline_state.plant.motion[0], scene.structure.nodes)
    with pytest.raises(InputError, match="lets the robot fall; expected one without supports"):
        control.environment("recover", held)


def longer_rods(scene):
    struts = replace(scene.structure.struts, rest_length=1.2 * scene.structure.struts.rest_length)
    return replace(scene, gait=None, structure=replace(scene.structure, struts=struts))


def test_controllers_refuse_starts_that_simulate_refuses(scene):
    """Rods that are too long for where the robot stands; a start below the ground; a support that moves."""
    policy = control.OpenLoop(jaxgrity.load_gait("lasting"))
    stretched = longer_rods(scene)
    with pytest.raises(InputError, match=r"strut 0 starts 1 m long; expected 1.2 m") as refused:
        jaxgrity.simulate(stretched, 0.1)
    with pytest.raises(InputError) as also:
        control.simulate_policy(control.plant_of(stretched, policy.members), policy, 0.1)
    assert str(refused.value) == str(also.value)
    with pytest.raises(InputError, match=r"expected 1.2 m"):
        control.environment("heading", jaxgrity.with_gait(stretched, policy.gait))
    plant, nodes = control.plant_of(scene, policy.members), np.asarray(scene.structure.nodes)
    with pytest.raises(InputError, match="m below the ground"):
        control.plant_start(plant, jax.random.key(0), (nodes - [0, 0, 0.5], 0 * nodes))
    for lost in ((np.nan * nodes, 0 * nodes), (nodes, np.full_like(nodes, np.inf))):
        with pytest.raises(InputError, match=r"(positions|velocities)\[0, 0\] = (nan|inf): expected a finite number"):
            control.plant_start(plant, jax.random.key(0), lost)
    held = control.plant_of(replace(scene, structure=replace(scene.structure, fixed=((3, "z"),))), policy.members)
    with pytest.raises(InputError, match=r"velocities.*where the node is fixed"):
        control.plant_start(held, jax.random.key(0), (nodes, 0 * nodes + [0, 0, 0.5]))


def test_one_of_many_robots_with_a_start_that_cannot_be_fails_alone(scene):
    policy = control.OpenLoop(jaxgrity.load_gait("lasting"))
    many = control.side_by_side(control.plant_of(scene, policy.members, options=SolverOptions(dt=0.01)), 2)
    q = np.repeat(np.asarray(scene.structure.nodes)[..., None], 2, axis=-1)
    q[..., 2, 1] -= 0.5
    end = control.drive(many, policy, control.loop_start(many, policy, jax.random.key(0), (q, 0 * q)), 1)
    assert (np.asarray(end.failure) > 0).tolist() == [False, True]


def test_velocities_of_robots_side_by_side_are_those_of_their_start(scene):
    """They are refused among what differs, not dropped."""
    plant = control.plant_of(scene, (0, 1))
    moving = jaxgrity.Differences(velocities=np.ones((2, 12, 3)))
    with pytest.raises(InputError, match=r"differences.velocities: a plant has none"):
        control.side_by_side(plant, 2, moving)


def test_a_policy_that_asks_for_no_number_fails_in_the_next_period(scene):
    """Of robots side by side the one that is asked, on cables that would be slack."""
    members = (6, 7)
    many = control.side_by_side(control.plant_of(scene, members, options=SolverOptions(dt=0.01)), 2)
    state = control.plant_start(many, jax.random.key(0))
    wanted = np.zeros((2, 2))
    wanted[1, 0] = np.nan
    after = control.actuate(many, state, wanted)
    assert np.isnan(after.motion[1][..., 0]).all()
    assert np.isfinite(after.motion[1][..., 1]).all()

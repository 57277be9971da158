"""Policies do the same in all poses that symmetries and turns make alike, and where nothing is alike they know."""

from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    ExactGround,
    InputError,
    Scene,
    SolverOptions,
    Sphere,
    Structure,
    load_scene,
    with_contact_along_struts,
)
from jaxgrity.control import (
    LearningConfig,
    environment,
    learner,
    load_policy,
    measure,
    save_policy,
)
from jaxgrity.control.canonical import BY_DIRECTION, BY_POSE, NO_TURN, canonical_pose
from jaxgrity.control.environments import sensed
from jaxgrity.control.learned import check_acting, untrained
from jaxgrity.control.tasks import Task
from jaxgrity.model.laws import ForceLaw
from jaxgrity.model.symmetry import symmetries

SCENE = load_scene("exact")
SYMMETRIES = symmetries(SCENE.structure)
HILL = Sphere([0.0, 0.0, -5.0], 5.0)


def turn_of(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


def moved(symmetry, angle: float):
    """What nodes have, what members have, and vectors in the plane, after a symmetry in space and a turn."""
    in_space = turn_of(angle) @ np.diag([1.0, np.sign(np.linalg.det(symmetry.matrix)), 1.0])

    def nodes(x):
        new = np.empty_like(np.asarray(x))
        new[list(symmetry.nodes)] = np.asarray(x) @ in_space.T
        return new

    def members(x):
        new = np.empty_like(np.asarray(x))
        new[[symmetry.members[k] for k in SCENE.gait.members]] = np.asarray(x)
        return new

    return nodes, members, lambda d: in_space[:2, :2] @ np.asarray(d)


def random_state(seed: int):
    """A robot as it may be while it rolls: turned, out of shape, moving."""
    random = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    q = np.asarray(SCENE.structure.nodes) @ (turn * np.sign(np.linalg.det(turn))).T
    q = q + random.normal(0, 0.05, q.shape)
    q[:, 2] -= q[:, 2].min()
    return q, random.normal(size=q.shape), random.uniform(0, 0.5, len(SCENE.gait.members)), random.normal(size=2)


ON_SLOPE = replace(SCENE, ground=ExactGround(incline=0.1))


@pytest.mark.parametrize(
    ("task", "scene", "turns"), [("heading", SCENE, True), ("speed", SCENE, True), ("heading", ON_SLOPE, False)]
)
def test_policies_are_equivariant(task, scene, turns):
    """Under every relabelling and mirror of the robot, with any turn on level ground: the same action, by the motors in
    the same place.

    A policy of a task without direction gets none.
    """
    env = environment(task, scene)
    policy = untrained(env, jax.random.key(0), 16, 2, 1, canonical_pose(env))
    assert len(policy.pose.exchange.mirror) == len(SYMMETRIES) == 24
    policy = eqx.tree_at(lambda p: p.network.layers[-1].weight, policy, replace_fn=lambda w: 100 * w)

    @jax.jit
    def acts(q, v, contraction, direction):
        seen = measure(env.plant.scene, 0.0, q, v)._replace(contraction=contraction)
        return policy(sensed(seen, direction if task == "heading" else 0 * direction))

    for k, symmetry in enumerate(SYMMETRIES):
        q, v, contraction, direction = random_state(k)
        nodes, members, plane = moved(symmetry, angle=0.7 * k * turns)
        there = acts(nodes(q), nodes(v), members(contraction), plane(direction))
        here = acts(q, v, contraction, direction)
        np.testing.assert_allclose(there, members(here), atol=2e-5)
        assert np.ptp(here) > 0.05
    assert np.abs(np.asarray(there) - np.asarray(here)).max() > 0.05  # no policy that does the same everywhere


@pytest.mark.slow
def test_robots_that_are_alike_go_alike():
    """The image of a start, with the image of a heading, moves as the image of the motion: the physics agrees."""
    env = environment("heading", SCENE)
    policy = untrained(env, jax.random.key(0), 16, 2, 1, canonical_pose(env))
    policy = eqx.tree_at(lambda p: p.network.layers[-1].weight, policy, replace_fn=lambda w: 100 * w)
    first = jax.jit(env.reset)(jax.random.key(4))
    nodes, _, plane = moved(SYMMETRIES[17], angle=1.3)
    situation, plant = first.pipeline_state, first.pipeline_state.plant
    image = situation._replace(plant=plant._replace(motion=tuple(map(nodes, plant.motion))), aim=plane(situation.aim))
    step = jax.jit(lambda state: env.step(state, policy(state.obs)))
    still = jnp.zeros(env.action_size)
    here, there = (jax.jit(env.step)(first.replace(pipeline_state=each), still) for each in (situation, image))
    for _ in range(40):
        here, there = step(here), step(there)
    ends = [state.pipeline_state.plant.motion[0] for state in (here, there)]
    assert np.abs(nodes(ends[0]) - ends[1]).max() < 1e-6
    assert np.abs(np.asarray(ends[0]) - np.asarray(plant.motion[0])).max() > 0.05


def heavier(scene: Scene) -> Scene:
    masses = np.asarray(scene.structure.node_mass) * np.where(np.arange(12) == 3, 1.5, 1.0)
    return replace(scene, structure=replace(scene.structure, node_mass=masses))


def sticky(scene: Scene) -> Scene:
    return replace(scene, friction=replace(scene.friction, mu=np.where(np.arange(12) == 3, 0.7, 0.5)))


class EastWind(ForceLaw):
    """A force along x, of which no rule says which symmetries keep it."""

    name: ClassVar[str] = "east wind"
    cause: ClassVar[str] = "east wind"

    def force(self, motion, other_forces):
        return jnp.stack([1 + motion.at.q[:, 2], 0 * motion.at.q[:, 0], 0 * motion.at.q[:, 0]], axis=1)


class Spin(Task):
    """A reward along y."""

    def progressed(self, aim, before, place, period, average):
        return (place - before)[1] / period, average


class Stroll(Task):
    """Along the heading, but not too fast: the same however it is turned."""

    def progressed(self, aim, before, place, period, average):
        along = jnp.dot((place - before)[:2] / period, aim)
        return along - 2 * jnp.maximum(along - 0.5, 0), average


class East(Task):
    """A direction of its own, where none is asked for."""

    def wanted_direction(self, aim, place):
        return jnp.array([0.0, 1.0])


def with_support(scene: Scene) -> Scene:
    s = scene.structure
    return replace(scene, structure=Structure(s.nodes, s.node_mass, s.struts, s.cables, fixed=((0, "xyz"),)))


@pytest.mark.parametrize(
    ("scene", "task", "count", "turned"),
    [
        (SCENE, "goal", 24, BY_DIRECTION),
        (SCENE, "speed", 24, BY_POSE),
        (SCENE, "bumps", 24, BY_DIRECTION),
        (SCENE, "slope", 24, NO_TURN),
        (ON_SLOPE, "speed", 24, NO_TURN),
        (replace(SCENE, terms=(EastWind(),)), "speed", 24, NO_TURN),
        (SCENE, Spin("anywhere"), 12, NO_TURN),
        (SCENE, Stroll("heading"), 24, BY_DIRECTION),
        (SCENE, East("anywhere"), 24, NO_TURN),
        (with_contact_along_struts(replace(SCENE, ground=ExactGround(surface=HILL)), 1, (0,)), "speed", 2, NO_TURN),
        (heavier(SCENE), "speed", 2, BY_POSE),
        (sticky(SCENE), "speed", 2, BY_POSE),
        (with_support(SCENE), "speed", 1, NO_TURN),
    ],
    ids=[
        *("goal", "speed", "bumps", "slope", "own slope", "own law", "own progress", "stroll", "own direction", "hill"),
        *("heavier node", "sticky node", "support"),
    ],
)
def test_only_what_is_alike_counts(scene, task, count, turned):
    """24 symmetries of 12 nodes: two of them leave a node in its place."""
    pose = canonical_pose(environment(task, scene))
    assert (len(pose.exchange.mirror), pose.turned) == (count, turned)


def test_struts_that_touch_along_their_length_are_like_each_other_alone():
    """One of six: 4 of 24 symmetries leave it in its place."""
    rough = with_contact_along_struts(replace(SCENE, ground=ExactGround(surface=HILL)), 1, (0,)).ground
    kept = [s for s in SYMMETRIES if rough.capsules.keep(s.nodes)]
    assert len(kept) == 4


def test_policies_of_other_robots_and_tasks_are_refused():
    """Of the same size, which alone cannot tell."""
    policy, env = load_policy("heading"), environment("heading", SCENE)
    check_acting(env, policy)
    check_acting(environment("heading", replace(ON_SLOPE, ground=ExactGround(incline=0.2))), policy)
    gait = replace(SCENE.gait, members=tuple(reversed(SCENE.gait.members)))
    with pytest.raises(InputError, match=r"moves members \[0, 1, 2, 3, 4, 5\].*\[5, 4, 3, 2, 1, 0\]"):
        check_acting(environment("heading", replace(SCENE, gait=gait)), policy)
    with pytest.raises(InputError, match="without a wanted direction"):
        check_acting(env, load_policy("speed"))
    lying = replace(SCENE.structure, nodes=np.asarray(SCENE.structure.nodes)[:, [2, 0, 1]])
    check_acting(environment("heading", replace(SCENE, structure=lying)), policy)
    first, *others = SCENE.structure.struts.edges
    struts = replace(SCENE.structure.struts, edges=(first[::-1], *others))
    with pytest.raises(InputError, match="other directions"):
        check_acting(environment("heading", replace(SCENE, structure=replace(SCENE.structure, struts=struts))), policy)


def test_a_policy_in_single_precision_knows_all_symmetries():
    env = environment("speed", SCENE, options=SolverOptions(dt=0.01, dtype="float32"))
    assert len(canonical_pose(env).exchange.mirror) == 24


def test_policies_keep_their_pose(tmp_path):
    """In their files, too; those without one are as they were."""
    env = environment("heading", SCENE)
    seen = jax.random.normal(jax.random.key(2), (env.observation_size,))
    for symmetric in (True, False):
        config = LearningConfig(robots=4, decisions=2, batches=1, width=8, symmetric=symmetric)
        policy = learner(env, jax.random.key(1), config).policy
        assert (policy.pose is not None) == symmetric
        save_policy(policy, tmp_path / "policy.eqx")
        np.testing.assert_array_equal(load_policy(tmp_path / "policy.eqx")(seen), policy(seen))

"""Balls on the ground: they roll where friction lets them, and nodes that are no balls pass."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    ConeFriction,
    ExactGround,
    InputError,
    PenaltyGround,
    Scene,
    SmoothFriction,
    SolverOptions,
    Sphere,
    Structure,
    SwitchFriction,
    energy_audit,
    load_scene,
    parse_scene,
    save_scene,
    simulate,
)
from jaxgrity.model import Balls, rigid_body
from jaxgrity.stepping.constraints import GroundImpulses
from jaxgrity.stepping.entering import frame_met
from jaxgrity.stepping.ground_impulses import on_nodes

RADIUS, MASS, G = 0.1, 1.5, 9.81
SLOPE = 0.2
"""rad"""
NORMAL = np.array([math.sin(SLOPE), 0.0, math.cos(SLOPE)])


def sphere(mu: float) -> Scene:
    """A solid one on a slope, by its centre and three points of its surface, which pass the ground."""
    nodes = RADIUS * (NORMAL + np.vstack([np.zeros(3), np.eye(3)]))
    body = rigid_body(nodes, range(4), MASS, [0.4 * MASS * RADIUS**2] * 3, nodes[0])
    ground = ExactGround(SLOPE, balls=Balls((0,), [RADIUS]))
    return Scene(Structure(nodes, np.zeros(4), bodies=(body,)), G, ground=ground, friction=ConeFriction(mu))


def cylinder() -> Scene:
    """A solid one across a rough slope, with a ball at either end of its axis, and two further points."""
    half, moment = 0.2, MASS * (3 * RADIUS**2 + 0.4**2) / 12
    ends = RADIUS * NORMAL + np.array([[0, -half, 0], [0, half, 0]])
    nodes = np.concatenate([ends, ends[:1] + RADIUS * np.eye(3)[[0, 2]]])
    body = rigid_body(nodes, range(4), MASS, [moment, MASS * RADIUS**2 / 2, moment], ends.mean(0))
    ground = ExactGround(SLOPE, balls=Balls((0, 1), [RADIUS] * 2))
    return Scene(Structure(nodes, np.zeros(4), bodies=(body,)), G, ground=ground, friction=ConeFriction(0.5))


SLIDING = G * (math.sin(SLOPE) - 0.02 * math.cos(SLOPE))
"""m/s^2, where mu is 0.02"""


@pytest.mark.slow
def test_a_sphere_rolls_or_slides_as_galilei_says():
    """5/7 g sin on a rough slope; g (sin - mu cos) where friction is too small."""
    for mu, a in ((0.5, G * math.sin(SLOPE) / 1.4), (0.02, SLIDING)):
        motion = simulate(sphere(mu), 1.0, options=SolverOptions(dt=4e-3))
        path = np.asarray(motion.positions)[:, 0]
        assert not motion.failed
        assert np.linalg.norm(path[-1] - path[0]) == pytest.approx(a / 2, rel=1e-12)
        np.testing.assert_allclose(path @ NORMAL, RADIUS, atol=1e-14)


@pytest.mark.slow
def test_a_cylinder_rolls_on_two_balls():
    """2/3 g sin: half of its mass counts once more as it turns. Both ends touch, and share friction in many ways."""
    motion = simulate(cylinder(), 1.0, options=SolverOptions(dt=4e-3))
    ends = np.asarray(motion.positions)[:, :2]
    assert not motion.failed
    way = np.linalg.norm(ends[-1] - ends[0], axis=1)
    np.testing.assert_allclose(way, G * math.sin(SLOPE) / 1.5 / 2, rtol=1e-9)
    np.testing.assert_allclose(ends @ NORMAL, RADIUS, atol=1e-12)


@pytest.mark.campaign
def test_friction_is_booked_where_it_acts():
    """A ball that rolls loses nothing, one that slides by the slip of its edge."""
    rolled = energy_audit(sphere(0.5), 1.0, options=SolverOptions(dt=4e-3))
    assert abs(rolled.dissipated["friction"][-1]) < 1e-12
    assert np.max(rolled.momentum_residual) < 1e-12
    # the slip at the edge: the spin grows by mu g cos r / (0.4 r^2)
    slid = energy_audit(sphere(0.02), 1.0, options=SolverOptions(dt=4e-3))
    force, spin = 0.02 * MASS * G * math.cos(SLOPE), 0.02 * G * math.cos(SLOPE) / 0.4
    assert slid.dissipated["friction"][-1] == pytest.approx(force * (SLIDING - spin) / 2, rel=2e-2)


def test_impulses_of_curved_ground_act_where_a_ball_meets_it():
    """Of a ball that lands on the flank of another one: not where that would be nearest at the start of the step."""
    nodes = RADIUS * np.vstack([np.zeros(3), np.eye(3)]) + [0.3, 0.0, math.sqrt(1.1**2 - 0.3**2) - 0.99]
    ground = ExactGround(surface=Sphere((0.0, 0.0, -1.0), 1.0), balls=Balls((0,), [RADIUS]))
    body = rigid_body(nodes, range(4), MASS, [0.4 * MASS * RADIUS**2] * 3, nodes[0])
    scene = Scene(Structure(nodes, np.zeros(4), bodies=(body,)), G, ground=ground, friction=ConeFriction(0.5))
    h, start = 0.02, (jnp.asarray(nodes), jnp.tile(jnp.array([1.0, 2.0, -1.0]), (4, 1)))
    first = jnp.array([1.0, 0, 0, 0])
    found = GroundImpulses(first, (0.3 * first, -0.2 * first), None)
    met = jax.jit(lambda start: frame_met(ground, 1.0, h, start))(start)
    n, along, across = (np.asarray(x)[0] for x in (met.normal, *met.tangents))
    assert np.abs(n - np.asarray(ground.frame(start[0]).normal)[0]).max() > 0.01
    impulse = float(scene.structure.borne_mass[0]) * (n + 0.3 * along - 0.2 * across)
    given = np.asarray(jax.jit(lambda *at: sum(on_nodes(scene, h, *at)))(start, found))
    np.testing.assert_allclose(given.sum(0), impulse, rtol=1e-6)
    # where it is nearest at the start, the moment would be another by a hundredth
    np.testing.assert_allclose(np.cross(nodes, given).sum(0), np.cross(nodes[0] - RADIUS * n, impulse), rtol=1e-5)


def test_balls_are_read_and_written(tmp_path):
    """With one radius for all, or one each."""
    text = '[structure]\nkind = "custom"\nnodes = [[0, 0, 1], [1, 0, 1], [0, 1, 1]]\nmass = 1.0\n[ground]\n'
    for line, radius in (("balls = { nodes = [0, 2], radius = 0.1 }", [0.1, 0.1]), ("balls = { nodes = [1] }", [0.0])):
        scene = parse_scene(f'{text}contact = "complementarity"\n{line}')
        save_scene(scene, tmp_path / "robot.toml")
        balls = load_scene(tmp_path / "robot.toml").ground.balls
        assert balls.nodes == scene.ground.balls.nodes
        np.testing.assert_array_equal(balls.radius, radius)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Balls((), []), "expected at least one node"),
        (lambda: Balls((0,), [0.1, 0.1]), r"expected \(1,\)"),
        (lambda: Balls((0,), [-0.1]), r"balls.radius\[0\] = -0.1 m: expected a finite number, at least 0"),
        (lambda: Scene(Structure(np.ones((1, 3)), [1.0]), ground=ExactGround(balls=Balls((3,), [0.1]))), "from 0 to 0"),
        (
            lambda: (
                Scene(
                    Structure(np.ones((1, 3)), [1.0]),
                    ground=PenaltyGround(1e3, balls=Balls((0,), [0.1])),
                    friction=SwitchFriction(0.5, 0.4, 1e-2),
                ).laws
            ),
            "knows no balls yet",
        ),
    ],
)
def test_what_is_no_ball_is_refused(make, words):
    """In one line."""
    with pytest.raises(InputError, match=words):
        make()


def test_a_ball_sinks_into_a_spring_by_its_edge():
    """Penalty contact presses on the ball alone, and smooth friction turns its body."""
    scene = sphere(0.5)
    soft = PenaltyGround(1e4, 2.0, SLOPE, balls=scene.ground.balls)
    scene = Scene(scene.structure, G, ground=soft, friction=SmoothFriction(0.5, 1e-3))
    q = np.asarray(scene.structure.nodes) - 1e-3 * NORMAL
    np.testing.assert_allclose(soft.normal_force(q, 0 * q), [10.0, 0, 0, 0], rtol=1e-9)


def test_a_ball_at_a_joint_turns_with_the_first_body():
    """Its point of contact moves by w x (-r n), whatever the other body does."""
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]])
    points = (0, 1, 2, 3), (0, 4, 5, 6)
    bodies = tuple(rigid_body(x, each, 1.0, [1.0, 1.0, 1.0], basic=each) for each in points)
    w, normal = np.array([0.3, -0.2, 0.5]), np.array([[0.6, 0.0, 0.8]])
    v = np.cross(w, x)
    v[4:] = np.cross([1.0, 2.0, 3.0], x[4:])
    weights = Balls((0,), [0.1]).turning(bodies, jnp.asarray(x), jnp.asarray(normal))
    np.testing.assert_allclose(weights @ v, np.cross(w, -0.1 * normal), atol=1e-15)

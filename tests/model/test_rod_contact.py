"""Points of contact along struts: a rod across an obstacle, against closed forms and nodes in the same place."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrity
from jaxgrity import (
    Box,
    Differences,
    Gait,
    InputError,
    Members,
    PenaltyGround,
    Scene,
    Slope,
    SmoothFriction,
    SolverOptions,
    Sphere,
    Structure,
    SwitchFriction,
    Trajectory,
    Union,
    energy_audit,
    simulate,
    with_contact_along_struts,
)
from jaxgrity.io.scene_writing import scene_toml
from jaxgrity.model import exact_twin, penalty_twin
from jaxgrity.model.balls import Balls
from jaxgrity.populations import rod_depths
from jaxgrity.stepping.dynamics import total_force
from jaxgrity.stepping.starts import check_start

STIFFNESS, MASS, G = 2e4, 1.0, 9.81
POST = Box((0.0, 0.0, 0.0), (0.2, 2.0, 0.6))
"""half as wide as three points of the rod are apart"""
BALL = Sphere((0.0, 0.0, 0.0), 0.3)
"""as high: a smaller program"""


def across(friction=None, damping=None, surface=BALL, gait=None) -> Scene:
    """A rod, level along x, above the middle of the surface."""
    nodes = np.array([[-0.5, 0.0, 0.31], [0.5, 0.0, 0.31]])
    struts = Members(((0, 1),), [1e4], [1.0], damping=[20.0])
    ground = PenaltyGround(STIFFNESS, 2.0, surface=surface)
    damped = None if damping is None else np.full(2, damping)
    return Scene(Structure(nodes, [MASS, MASS], struts), G, damped, ground, friction, gait)


@pytest.mark.campaign
@pytest.mark.parametrize("surface", [BALL, POST], ids=["ball", "post"])
def test_a_rod_rests_on_what_is_between_its_nodes(surface):
    """As deep in it as its weight presses the point that touches, where contact at nodes lets it fall through."""
    scene = across(damping=20.0, surface=surface)
    options = SolverOptions("rk4", dt=1e-3, any_step=True)
    held = with_contact_along_struts(scene, 3)
    fallen, resting = (simulate(each, 3.0, frame_rate=10.0, options=options) for each in (scene, held))
    assert fallen.positions[-1, :, 2].max() < -1
    depth = 0.3 - np.asarray(resting.positions[-1, :, 2])
    np.testing.assert_allclose(depth, 2 * MASS * G / (STIFFNESS / 3), rtol=1e-6)
    assert rod_depths(scene, fallen, 3).max() > 10 * rod_depths(held, resting, 3).max()


def test_balls_of_nodes_are_none_of_the_points():
    """A rod with a large foot: its points, and the depths of its parts, are those of a thin rod."""
    scene = across(surface=None)
    feet = replace(scene, ground=replace(scene.ground, balls=Balls((1,), [0.3])))
    for z in (0.2, -0.04):
        q = scene.structure.nodes * [1.0, 1.0, 0.0] + [0.0, 0.0, z]
        thin, footed = (
            with_contact_along_struts(each, 3).potential_energy(q, 0.0) - each.potential_energy(q, 0.0)
            for each in (scene, feet)
        )
        expected = 3 * (STIFFNESS / 3) / 2 * min(z, 0.0) ** 2
        np.testing.assert_allclose([thin, footed], expected, rtol=1e-12)
        none = jnp.array(0)
        still = Trajectory(np.array([0.0]), q[None], 0 * q[None], none, none, none, "rk4", 1e-3, feet)
        np.testing.assert_allclose(rod_depths(feet, still, 3), max(-z, 0.0), rtol=1e-12)


@pytest.mark.parametrize("count", [1, 3])
def test_a_thick_rod_is_as_deep_as_its_surface(count):
    """Half its radius above a plane, which its axis does not touch."""
    scene = with_contact_along_struts(across(surface=None), count, radius=0.02)
    q, none = scene.structure.nodes * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.01], jnp.array(0)
    still = Trajectory(np.array([0.0]), q[None], 0 * q[None], none, none, none, "rk4", 1e-3, scene)
    np.testing.assert_allclose(rod_depths(scene, still, 3), 0.01, rtol=1e-12)


@pytest.mark.campaign
def test_an_exact_twin_starts_on_what_its_rods_touch():
    """Of a rod that lies a centimetre deep across a post, whose ends are in the air."""
    soft = with_contact_along_struts(across(SmoothFriction(0.4, 0.01), surface=Union((Slope(), POST))), 3)
    top = float(soft.ground.height([0.0], [0.0])[0])
    q = soft.structure.nodes * [1.0, 1.0, 0.0] + [0.0, 0.0, top - 0.01]
    twin = exact_twin(replace(soft, structure=replace(soft.structure, nodes=q)))
    np.testing.assert_allclose(twin.structure.nodes - q, [[0.0, 0.0, 0.01]] * 2, atol=2e-5)
    check_start(twin)


def test_contact_twins_touch_along_the_same_struts():
    """With their radii: by laws at points on one model, by the ground's capsules on the other."""
    scene = with_contact_along_struts(across(SmoothFriction(0.4, 0.01)), 3, radius=0.02)
    exact = exact_twin(scene)
    assert len(scene.terms) == 3
    assert not exact.terms
    assert exact.ground.capsules.struts == (0,)
    np.testing.assert_array_equal(exact.ground.capsules.radius, [0.02])
    np.testing.assert_array_equal(exact.ground.balls.radius, [0.02, 0.02])
    np.testing.assert_array_equal(penalty_twin(exact).terms[0].points.radius, np.full(5, 0.02))


@pytest.mark.campaign
@pytest.mark.parametrize("radius", [0.0, 0.02])
def test_scene_files_have_it(radius):
    """Read and written, of both contact models; points at other places have no key."""
    soft = with_contact_along_struts(
        across(SmoothFriction(0.4, 0.01), surface=Union((Slope(), POST))), 3, radius=radius
    )
    for scene in (soft, exact_twin(soft)):
        text = scene_toml(scene)
        assert "along_struts = { count = " in text
        again = jaxgrity.parse_scene(text)
        assert jax.tree.all(jax.tree.map(np.array_equal, again, scene))
    elsewhere = eqx.tree_at(lambda s: s.terms[0].points.share, soft, np.array([0.1, 0.2, 0.3]))
    with pytest.raises(InputError, match="expected evenly spaced points, as many on each strut"):
        scene_toml(elsewhere)


def test_a_point_gets_what_a_node_gets_there():
    """Forces of contact and of friction on a node in the same place, divided among both ends by position."""
    friction = SmoothFriction(0.4, 0.01)
    scene = with_contact_along_struts(across(friction), 1)
    q = jnp.array([[-0.45, 0.1, 0.28], [0.55, -0.2, 0.29]])
    v = jnp.array([[0.3, 0.2, -0.4], [0.1, -0.5, 0.2]])
    point = Scene(Structure(q[:1], [MASS]), None, None, across().ground, friction)
    there, moving = q.mean(0, keepdims=True), v.mean(0, keepdims=True)

    @jax.jit
    def forces():
        at = [(point, there, moving), (scene, q, v), (across(friction), q, v)]
        return [total_force(each, jnp.array(0.0), *state) for each, *state in at]

    alone, with_points, with_nodes = forces()
    both = with_points - with_nodes
    assert jnp.linalg.norm(alone[0, :2]) > 1
    np.testing.assert_allclose(both, np.repeat(alone / 2, 2, axis=0), rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_the_power_of_all_forces_is_booked(booked):
    """Of a rod on the ball: some of its points are pressed in, and slide."""
    found = booked(with_contact_along_struts(across(SmoothFriction(0.3, 0.05)), 3))
    assert (found["friction"] > 1e-3).sum() > 5
    assert (abs(found["contact"]) > 1e-3).sum() > 5


@pytest.mark.campaign
def test_energy_is_accounted_for():
    """Of a rod that tips over the post and slides off: what is lost is booked, to a thousandth of the energy."""
    scene = across(SmoothFriction(0.3, 0.05), surface=POST)
    beside = eqx.tree_at(lambda s: s.structure.nodes, scene, scene.structure.nodes + np.array([0.2, 0.0, 0.0]))
    audit = energy_audit(with_contact_along_struts(beside, 3), 0.4, options=SolverOptions(dt=2e-4))
    assert audit.dissipated["friction"][-1] > 1e-2
    assert abs(audit.residual).max() < 1e-3 * 2 * MASS * G * 0.3


@pytest.mark.campaign
def test_a_population_moves_as_each_robot_does():
    """With gaits and frictions of their own, over ground that their points slide on."""
    gait = Gait((0,), [0.0], [0.2], [2.0], start=0.0, ramp=0.1)
    scene = with_contact_along_struts(across(SmoothFriction(0.3, 0.05), gait=gait), 3)
    options = SolverOptions("rk4", dt=1e-3, any_step=True)
    gaits = jaxgrity.gaits_of(gait, np.array([[0.5], [2.0]]))
    mu = np.array([1.0, 0.2])
    shift = np.array([0.2, 0.05, 0.0])
    scene = eqx.tree_at(lambda s: s.structure.nodes, scene, scene.structure.nodes + shift)
    many = jaxgrity.simulate_population(scene, gaits, 0.3, options=options, differences=Differences(friction=mu))
    for k in range(2):
        one = jaxgrity.with_gait(scene, jax.tree.map(lambda x, k=k: x[k] if np.ndim(x) else x, gaits))
        one = eqx.tree_at(lambda s: s.friction.mu, one, one.friction.mu * mu[k])
        alone = simulate(one, 0.3, options=options)
        np.testing.assert_allclose(many.positions[k], alone.positions[-1], atol=1e-6)
    assert abs(many.positions[1] - many.positions[0]).max() > 1e-2


def test_gradients_agree_with_central_differences():
    """In forward mode, of a rod that falls on the ball."""
    resolved = jaxgrity.stepping.resolve(across(), 0.1, SolverOptions("rk4", dt=1e-3))
    held = with_contact_along_struts(across(SmoothFriction(0.3, 0.05)), 3)

    def height(z):
        nodes = jnp.asarray(held.structure.nodes) + jnp.array([0.05, 0.0, 0.0]) * z
        start = nodes, jnp.array([[0.5, 0.0, 0.0], [0.5, 0.0, 0.1]])
        return jaxgrity.final_state(held, 0.1, resolved, start)[0][0, 2]

    h = 1e-4
    with_slope = jax.jit(lambda z: jax.jvp(height, (z,), (1.0,)))
    (below, _), (_, forward), (above, _) = map(with_slope, (0.3 - h, 0.3, 0.3 + h))
    assert abs(forward) > 1e-4
    np.testing.assert_allclose((above - below) / (2 * h), forward, atol=1e-7)


@pytest.mark.parametrize(
    ("scene", "arguments", "message"),
    [
        (lambda: replace(across(), ground=None), (3,), "contact along struts needs a ground"),
        (
            lambda: across(SwitchFriction(0.4, 0.3, 0.01)),
            (3,),
            "friction: SwitchFriction along struts; expected smooth",
        ),
        (across, (1, None, -0.1), r"radius\[0\] = -0.1 m: expected a finite number, at least 0"),
        (across, (1, None, [0.1, 0.1]), "radius has 2 numbers; expected one, or 1"),
        (
            lambda: with_contact_along_struts(exact_twin(across(damping=1.0)), 1),
            (2,),
            r"struts = \[0\]: the scene has contact along \[0\] already",
        ),
        (across, (0,), "count = 0: expected a whole number, at least 1"),
        (across, (1, (1,)), r"struts = \[1\]: expected some of 1 struts and rods"),
        (
            lambda: with_contact_along_struts(across(), 1),
            (2,),
            r"struts = \[0\]: the scene has contact along \[0\] already",
        ),
    ],
)
def test_what_cannot_be_is_refused(scene, arguments, message):
    """In one line."""
    with pytest.raises(InputError, match=message):
        with_contact_along_struts(scene(), *arguments)

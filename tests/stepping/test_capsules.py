"""Struts on exact contact between their ends: rods and capsules across edges, against closed forms and equations."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from studies.thrown_rods import thrown_at_post

import jaxgrity
from jaxgrity import (
    Box,
    ConeFriction,
    Cylinder,
    Differences,
    ExactGround,
    Gait,
    Members,
    PenaltyGround,
    Scene,
    SolverOptions,
    Stairs,
    Structure,
    energy_audit,
    forces_along,
    simulate,
    with_contact_along_struts,
)
from jaxgrity.model import Balls
from jaxgrity.model.capsules import nearest
from jaxgrity.populations import rod_depths
from jaxgrity.populations.motion_kinds import rolling

G = 9.81
POST = Box((0.0, 0.0, 0.0), (0.2, 2.0, 0.6))
"""with edges along y, at z = 0.3"""
LOG = Cylinder((0.0, -1.0, 0.0), (0.0, 1.0, 0.0), 0.3)
EDGE = np.array([0.1, 0.0, 0.3])
"""a point of the post's edge"""


def rod(friction=None, radius=0.0, surface=POST, along=True) -> Scene:
    """Of two kilogrammes and one metre, level along x, 1 cm above the middle of the post."""
    nodes = np.array([[-0.5, 0.0, 0.31 + radius], [0.5, 0.0, 0.31 + radius]])
    cone = None if friction is None else ConeFriction(friction)
    struts = Members(((0, 1),), None, [1.0])
    scene = Scene(Structure(nodes, [1.0, 1.0], struts), G, None, ExactGround(surface=surface), cone)
    return with_contact_along_struts(scene, 1, radius=radius) if along else scene


def tilted(angle: float, beyond: float, above: float = 0.0, azimuth: float = 0.0) -> jax.Array:
    """(2, 3), m, ends of the rod across the edge, which falls by `angle`; its middle is so far `beyond` the edge."""
    level = jnp.array([jnp.cos(azimuth), jnp.sin(azimuth), 0.0])
    u = math.cos(angle) * level - math.sin(angle) * jnp.array([0.0, 0.0, 1.0])
    n = jnp.cross(u, jnp.array([0.0, 1.0, 0.0]))
    middle = EDGE + above * n / jnp.linalg.norm(n) + beyond * u
    return jnp.stack([middle - u / 2, middle + u / 2])


@pytest.mark.parametrize("surface", [POST, LOG], ids=["edge", "log"])
def test_the_nearest_point_is_where_the_rod_and_the_edge_are_nearest(surface):
    """Across an edge, or a log: the normal is perpendicular to both, wherever the rod is, and whichever way it lies."""
    look = jax.jit(lambda ends: nearest(surface, ends[:1], ends[1:], jnp.array([[0.0], [1.0]]), jnp.zeros(1)))
    for gap in (0.0, 1e-9, -1e-9, -1e-3, 1e-3, 0.1):
        if surface is LOG and gap < -1e-6:
            continue  # deep in it the distance is no longer that of the axes
        for azimuth in (0.0, 0.4, -1.0):
            ends = tilted(0.3, 0.13, gap, azimuth)
            n = np.cross(ends[1] - ends[0], [0.0, 1.0, 0.0])
            n /= np.linalg.norm(n)
            if surface is LOG:
                ends = ends - EDGE + 0.3 * n
            found = look(ends)
            np.testing.assert_allclose(found.normal[0], n, atol=1e-7)
            np.testing.assert_allclose(found.distance, gap, atol=1e-9)
            np.testing.assert_allclose(found.share, 0.37, atol=1e-7 + 2 * max(-gap, 0.0))
            assert found.found.all()


@pytest.mark.campaign
def test_a_rod_comes_to_rest_across_a_narrow_post():
    """Where it falls past its edges with contact at nodes; and level, since it touches both edges."""
    options = SolverOptions(dt=2e-3)
    fallen, resting = (simulate(rod(along=along), 1.0, options=options) for along in (False, True))
    assert fallen.positions[-1, :, 2].max() < -1
    np.testing.assert_allclose(resting.positions[50:, :, 2], 0.3, atol=1e-8)
    np.testing.assert_allclose(resting.velocities[50:, :, 2], 0.0, atol=G * 2e-3)


def pendulum(radius: float, beyond: float, duration: float) -> tuple[float, np.ndarray]:
    """Angle and middle, from the edge, in x and z, of a frictionless rod that has tipped over it from rest.

    With u along the rod, n across it, and s the way of the middle along u from the point of contact, the middle is at
    r n + s u. Lagrange's equations have T = m/2 ((s' + r a')^2 + (s a')^2) + I/2 a'^2, and the weight.
    """
    mass, inertia = 2.0, 2 * 0.5**2

    def rates(_, state):
        s, a, s_, a_ = state
        turns = mass * (G * s * math.cos(a) - 2 * s * s_ * a_ - radius * s * a_**2) / (mass * s * s + inertia)
        return [s_, a_, s * a_**2 + G * math.sin(a) - radius * turns, turns]

    s, a, *_ = solve_ivp(rates, (0.0, duration), [beyond, 0.0, 0.0, 0.0], rtol=1e-12, atol=1e-12).y[:, -1]
    return a, radius * np.array([math.sin(a), math.cos(a)]) + s * np.array([math.cos(a), -math.sin(a)])


@pytest.mark.slow
@pytest.mark.parametrize(
    "radius", [pytest.param(0.0, marks=pytest.mark.campaign, id="rod"), pytest.param(0.05, id="capsule")]
)
def test_a_rod_tips_over_an_edge_as_its_equations_say(radius):
    """At second order, from where it lies flat. Its axis stays a radius from the edge."""
    angle, middle = pendulum(radius, 0.12, 0.3)
    assert angle > 0.15
    errors = []
    for dt in (1e-2, 5e-3):
        motion = simulate(
            rod(radius=radius), 0.3, positions=tilted(0.0, 0.12, radius), options=SolverOptions(dt=dt), frame_rate=10.0
        )
        q = np.asarray(motion.positions)[-1]
        d = q[1] - q[0]
        errors.append([math.atan2(-d[2], d[0]) - angle, *(q.mean(0) - EDGE)[[0, 2]] - middle])
    errors = abs(np.array(errors))
    np.testing.assert_allclose(errors[1], 0.0, atol=5e-6)
    assert errors[1].max() < errors[0].max() / 3


@pytest.mark.campaign
def test_a_rod_passes_an_edge_that_it_does_not_touch():
    """1 mm above it, by 1 cm in each step: wherever steps begin, it moves on as if there were no post."""
    free = replace(rod(), gravity=0.0)
    for ahead in np.linspace(0.0, 0.01, 5):
        q = np.array([[-0.3 + ahead, -0.5, 0.301], [-0.3 + ahead, 0.5, 0.301]])
        v = np.array([[2.0, 0.0, 0.0]] * 2)
        motion = simulate(free, 0.25, positions=q, velocities=v, options=SolverOptions(dt=5e-3))
        np.testing.assert_allclose(motion.positions[-1], q + 0.25 * v, atol=1e-12)


@pytest.mark.campaign
def test_a_rod_rests_on_an_edge_at_its_balance_point():
    """Tilted by less than the angle of friction. The ground carries its weight there: both ends get it by position."""
    scene = rod(friction=0.5)
    masses = np.array([0.8, 1.2])
    scene = replace(scene, structure=replace(scene.structure, node_mass=masses))
    motion = simulate(scene, 0.5, positions=tilted(0.2, -0.1), options=SolverOptions(dt=5e-3))
    np.testing.assert_allclose(motion.positions[-1], motion.positions[0], atol=1e-9)
    force = forces_along(scene, motion).ground
    np.testing.assert_allclose(force[1:].sum(1), [[0.0, 0.0, 2 * G]] * (len(force) - 1), atol=1e-9)
    np.testing.assert_allclose(force[1:, :, 2], [masses * G] * (len(force) - 1), atol=1e-6)


@pytest.mark.campaign
@pytest.mark.parametrize("count", [10, 200])
def test_no_thrown_rod_enters_the_post_or_gains_energy(count):
    """But for the depth that a start may have, and a hundredth of its energy. A quarter of them would enter it."""
    scene, plain = rod(friction=0.4), rod(friction=0.4, along=False)
    passed = 0
    for number in range(count):
        q, v = thrown_at_post(number)
        both = [
            simulate(each, 1.0, positions=q, velocities=v, options=SolverOptions(dt=5e-3), frame_rate=200.0)
            for each in (scene, plain)
        ]
        depth, without = (rod_depths(scene, motion, 127)[0] for motion in both)
        assert not both[0].failed
        assert depth < 5e-4
        x, w = (np.asarray(part) for part in (both[0].positions, both[0].velocities))
        energy = (w * w).sum((1, 2)) / 2 + G * x[..., 2].sum(1)
        assert np.diff(energy).max() < 1e-2 * (energy[0] + 2 * G)
        passed += without > 1e-2
    assert passed >= count // 4


@pytest.mark.campaign
def test_on_a_plane_a_capsule_is_its_two_balls():
    """To the last bit, and it rests a radius above it."""
    scene = rod(radius=0.04, surface=None)
    balls = replace(scene, ground=ExactGround(balls=Balls((0, 1), [0.04, 0.04])))
    assert scene.ground.capsules is not None
    there, here = (simulate(each, 0.5, options=SolverOptions(dt=5e-3)) for each in (scene, balls))
    np.testing.assert_array_equal(there.positions, here.positions)
    np.testing.assert_allclose(there.positions[-1, :, 2], 0.04, atol=1e-12)


@pytest.mark.campaign
@pytest.mark.parametrize("contact", ["exact", "penalty"])
def test_reports_see_that_a_robot_rests_on_a_strut(contact):
    """Of a tetrahedron that lies across the post, with no node near the ground; and populations, of a rod."""
    nodes = np.array([[-0.5, 0.0, 0.3], [0.5, 0.0, 0.3], [0.0, -0.3, 0.5], [0.0, 0.3, 0.5]])
    edges = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
    struts = Members(edges, None, [math.dist(nodes[i], nodes[j]) for i, j in edges])
    body = Scene(Structure(nodes, [0.5] * 4, struts), G, None, ExactGround(surface=POST))
    gait = Gait((0,), [0.0], [1e-3], [2.0], start=0.0, ramp=0.1)
    one = rod(along=False)
    one = replace(one, structure=replace(one.structure, nodes=one.structure.nodes - [0.0, 0.0, 0.01]), gait=gait)
    if contact == "penalty":
        body, one = jaxgrity.model.penalty_twin(body), jaxgrity.model.penalty_twin(one)
    body, one = (with_contact_along_struts(each, 1) for each in (body, one))
    options = SolverOptions(dt=2e-3 if contact == "exact" else None)
    assert rolling(body, simulate(body, 0.3, options=options)).airborne_share < 0.05
    gaits = jaxgrity.gaits_of(gait, np.zeros((1, 1)))
    measured = jaxgrity.simulate_population(one, gaits, 0.3, options=options, with_metrics=True).metrics
    assert measured.flight[0] < 0.05


def test_robots_with_contact_along_struts_do_not_differ_in_their_ground():
    """They would be set down by their nodes, with struts in the ground."""
    scene = replace(rod(), gait=Gait((0,), [0.0], [1e-3], [2.0], start=0.0, ramp=0.1))
    gaits = jaxgrity.gaits_of(scene.gait, np.zeros((1, 1)))
    with pytest.raises(jaxgrity.InputError, match="robots with contact along struts would start in the ground"):
        jaxgrity.ensemble(jax.random.key(0), scene, gaits, jaxgrity.Uncertainty(terrain=0.1), 2)


@pytest.mark.campaign
def test_the_balance_of_a_sliding_capsule():
    """Of momentum to rounding; of energy to what steps miss."""
    scene = replace(rod(friction=0.1, radius=0.03), structure=replace(rod().structure, nodes=tilted(0.3, 0.2, 0.03)))
    audit = energy_audit(scene, 0.3, options=SolverOptions(dt=2e-3))
    assert audit.dissipated["friction"][-1] > 1e-2
    assert abs(audit.residual).max() < 1e-3
    assert np.max(audit.momentum_residual) < 1e-10


@pytest.mark.campaign
def test_stiff_penalty_contact_agrees():
    """A frictionless rod that tips over a log, with many points of contact along it."""
    q = np.asarray(tilted(0.0, 0.12)) - EDGE + np.array([0.0, 0.0, 0.3])
    exact = replace(rod(surface=LOG), structure=replace(rod().structure, nodes=q))
    springs = Members(((0, 1),), [1e6], [1.0], damping=[50.0])
    soft = Scene(Structure(q, [1.0, 1.0], springs), G, None, PenaltyGround(4e6, 1.0, surface=LOG))
    found = simulate(exact, 0.3, options=SolverOptions(dt=2e-3)).positions[-1]
    other = simulate(with_contact_along_struts(soft, 61), 0.3, options=SolverOptions(dt=2e-5)).positions[-1]
    assert abs(found - q).max() > 0.1
    np.testing.assert_allclose(found, other, atol=2e-3)


@pytest.mark.campaign
@pytest.mark.parametrize("radius", [0.0, 0.05])
def test_derivatives_are_those_of_differences(radius):
    """Of a rod that lies on an edge all the time, in forward and in reverse mode.

    Its point of contact is found to 9e-8 of its length, so differences over 2e-4 are right to 4.5e-4.
    """
    scene = rod(friction=0.1, radius=radius)
    options = jaxgrity.stepping.resolve(scene, 0.1, SolverOptions(dt=5e-3))
    weights = jnp.array([[0.3, -1.0, 0.4], [0.2, 1.0, -0.1]])

    def place(azimuth):
        start = tilted(0.3, 0.2, radius, azimuth), jnp.zeros((2, 3))
        return (jaxgrity.final_state(scene, 0.1, options, start)[0] * weights).sum()

    h = 1e-4
    slope = jax.jit(jax.value_and_grad(place))(0.2)[1]
    forward = jax.jit(lambda x: jax.jvp(place, (x,), (1.0,))[1])(0.2)
    low, high = (jax.jit(place)(0.2 + d) for d in (-h, h))
    assert abs(slope) > 1e-2
    np.testing.assert_allclose([slope, forward], (high - low) / (2 * h), rtol=4.5e-4)


@pytest.mark.campaign
def test_a_population_and_single_precision():
    """Each robot of a population moves as it does alone; single precision does the same to a millimetre."""
    scene = replace(rod(friction=0.4), gait=Gait((0,), [0.0], [0.05], [2.0], start=0.5, ramp=0.1))
    mu = np.array([1.0, 0.2])
    many = jaxgrity.simulate_population(
        scene,
        jaxgrity.gaits_of(scene.gait, np.array([[0.5], [2.0]])),
        0.4,
        options=SolverOptions(dt=5e-3),
        differences=Differences(friction=mu),
    )
    for k in range(2):
        one = replace(scene, friction=ConeFriction(0.4 * mu[k]))
        for dtype, atol in (("float64", 1e-9), ("float32", 1e-3)):
            alone = simulate(one, 0.4, options=SolverOptions(dt=5e-3, dtype=dtype))
            np.testing.assert_allclose(many.positions[k], alone.positions[-1], atol=atol)


@pytest.mark.campaign
def test_no_strut_of_a_robot_that_tumbles_down_stairs_enters_them():
    """By more than a hundredth of a step's height, where with contact at nodes alone struts do by more than a sixth."""
    scene = jaxgrity.load_scene("exact")
    scene = replace(jaxgrity.with_gait(scene, None), ground=replace(scene.ground, surface=Stairs(0.12, 0.25, 5, -0.5)))
    nodes = np.asarray(scene.structure.nodes)
    v = np.tile([-1.0, 0.0, 0.0], (12, 1))
    for turned in ([-3.026, -0.154, -0.339], [0.238, -2.844, -1.106], [-0.544, -2.034, 0.322]):
        q = Rotation.from_rotvec(turned).apply(nodes - nodes.mean(0)) + np.array([0.3, 0.0, 1.5])
        depths = []
        for each in (scene, with_contact_along_struts(scene, 1)):
            motion = simulate(each, 1.5, positions=q, velocities=v, options=SolverOptions(dt=5e-3))
            assert not motion.failed
            depths.append(rod_depths(each, motion, 63).max())
        assert depths[0] > 0.12 / 6
        assert depths[1] < 0.0012

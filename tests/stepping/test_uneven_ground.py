"""Motions on uneven ground: against closed forms, an independent ODE, and one contact model against the other."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxgrity import (
    ConeFriction,
    ExactGround,
    HeightFunction,
    InputError,
    Members,
    PenaltyGround,
    Scene,
    Slope,
    SmoothFriction,
    SolverOptions,
    Sphere,
    Stairs,
    Structure,
    Uncertainty,
    bumps,
    edge_lengths,
    energy_audit,
    ensemble,
    final_state,
    gaits_of,
    simulate,
)
from jaxgrity.model import Surface
from jaxgrity.stepping import resolve, step_limit

G, RADIUS = 9.81, 2.0
BOWL = Sphere(np.array([0.0, 0.0, RADIUS]), RADIUS, hollow=True)
HILLS = HeightFunction(lambda x, y: 0.1 * jnp.sin(3 * x) + 0.05 * jnp.cos(4 * y))


def node(ground, x=0.0, y=0.0, friction=None, above=0.0):
    """One node of 1 kg on the ground, or above it."""
    z = float(ground.height(np.array([x]), np.array([y]))[0]) + above
    return Scene(Structure(np.array([[x, y, z]]), np.ones(1)), G, ground=ground, friction=friction)


def moved(scene, duration, dt, speed=(0.0, 0.0, 0.0), frame_rate=100.0, **how):
    options = SolverOptions(dt=dt, any_step=True)
    found = simulate(scene, duration, options=options, velocities=np.array([speed]), frame_rate=frame_rate, **how)
    assert not found.failed
    return np.asarray(found.positions, float)[:, 0]


@pytest.mark.slow
def test_a_node_in_a_bowl_is_a_pendulum():
    """Large swings, 1 rad, against the pendulum's own equation: the error is of second order in the step.

    Under the surface the node is by much less than it is off along it.
    """
    swing = solve_ivp(lambda t, y: [y[1], -G / RADIUS * np.sin(y[0])], (0, 10), [1.0, 0.0], rtol=1e-10, atol=1e-12)
    expected = RADIUS * np.sin(swing.y[0, -1])
    start = node(ExactGround(surface=BOWL), RADIUS * np.sin(1.0))
    paths = [moved(start, 10.0, dt) for dt in (4e-3, 2e-3)]
    errors = [path[-1, 0] - expected for path in paths]
    assert abs(errors[0]) < 5e-3
    np.testing.assert_allclose(errors[1], errors[0] / 4, rtol=0.1)
    depths = [-start.ground.measured(path[:, None]).distance.min() for path in paths]
    assert depths[0] < 1e-6
    assert depths[1] < depths[0] / 4


@pytest.mark.slow
def test_small_swings_have_the_period_of_a_pendulum():
    """2 pi sqrt(R/g), on penalty ground too."""
    for ground, dt in ((ExactGround(surface=BOWL), 2e-3), (PenaltyGround(1e5, surface=BOWL), 5e-4)):
        period = 2 * np.pi * np.sqrt(RADIUS / G)
        x = moved(node(ground, 0.02), 2 * period, dt)[:, 0]
        times = np.linspace(0, 2 * period, len(x))
        down = np.flatnonzero((x[:-1] > 0) & (x[1:] <= 0))
        crossings = times[down] + x[down] / (x[down] - x[down + 1]) * times[1]
        np.testing.assert_allclose(np.diff(crossings), period, rtol=2e-3)


@pytest.mark.slow
def test_no_node_is_below_exact_ground_by_more_than_the_linearised_gap_explains():
    """At least of the second order in the step, for a node that slides over hills and lands on them."""
    start = node(ExactGround(surface=HILLS), 0.1, 0.2, above=0.05)
    deepest = []
    for dt in (8e-3, 4e-3):
        path = moved(start, 1.6, dt, (1.0, 0.4, 0.0), frame_rate=1 / dt)
        deepest.append(-start.ground.measured(path[:, None]).distance.min())
    assert 1e-9 < deepest[0] < 1e-3
    assert deepest[1] < deepest[0] / 3.5


@pytest.mark.slow
def test_both_contact_models_meet_as_the_penalty_ground_stiffens():
    """A node that slides over hills: the difference falls as 1/k_n."""
    exact = moved(node(ExactGround(surface=HILLS), 0.1), 0.6, 1e-4)[-1]
    apart = []
    for stiffness, dt in ((1e3, 1e-3), (1e4, 5e-4), (1e5, 1e-4)):
        ground = PenaltyGround(stiffness, 0.5, surface=HILLS)
        scene = node(ground, 0.1)
        resting = np.asarray(scene.structure.nodes) - [[0, 0, G / stiffness]]
        apart.append(np.linalg.norm(moved(scene, 0.6, dt, positions=resting)[-1] - exact))
    assert apart[1] < apart[0] / 4
    assert apart[2] < apart[1] / 4
    assert apart[2] < 1e-3


def as_plane(x, y):
    """The height of an incline of 0.3 rad."""
    return -np.tan(0.3) * x


PENALTY, EXACT = partial(PenaltyGround, 1e4, 2.0), ExactGround


@pytest.mark.parametrize("mu", [0.2, 0.5])
@pytest.mark.parametrize(
    ("kind", "surface"),
    [
        pytest.param(EXACT, HeightFunction(as_plane), marks=pytest.mark.slow),
        pytest.param(PENALTY, Slope(0.3), marks=pytest.mark.campaign),
        pytest.param(EXACT, Slope(0.3), marks=pytest.mark.campaign),
        pytest.param(PENALTY, HeightFunction(as_plane), marks=pytest.mark.campaign),
    ],
)
def test_friction_on_a_surface_is_that_on_the_plane(kind, surface, mu):
    """A node slides down, or sticks on, the same slope given as a plane, as a surface, and as a function."""
    friction, dt = (ConeFriction(mu), 5e-3) if kind is EXACT else (SmoothFriction(mu, 0.01), 5e-4)
    grounds = kind(0.3), kind(surface=surface)
    plane, same = (moved(node(ground, friction=friction), 0.5, dt)[-1] for ground in grounds)
    np.testing.assert_allclose(same, plane, atol=1e-10)


@pytest.mark.slow
def test_a_node_that_slides_into_a_step_stops_there():
    """It stays on the tread, does not enter the riser, and does not come back."""
    scene = node(ExactGround(surface=Stairs(0.2, 0.4, 2, start=0.503)), 0.0)
    path = moved(scene, 1.0, 5e-3, (2.0, 0.0, 0.0))
    np.testing.assert_allclose(path[-1], [0.503, 0, 0], atol=1e-9)
    assert path[:, 0].max() < 0.503 + 1e-9
    assert path[:, 2].min() > -3.01 * G * 5e-3**2


def block(side=0.2):
    """Eight nodes, every two joined by a strut that is a spring."""
    nodes = side / 2 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    edges = tuple((i, j) for i in range(8) for j in range(i))
    struts = Members(edges, np.full(28, 5e3), edge_lengths(nodes, edges), np.full(28, 5.0))
    return Structure(nodes, np.full(8, 0.25), struts)


def falling_block(kind):
    """A cube over the edge of a stair."""
    stairs = Stairs(0.1, 0.3, 3, start=0.0, rounding=0.005)
    grounds = {
        "penalty": (PenaltyGround(1e4, 2.0, surface=stairs), SmoothFriction(0.6, 0.01)),
        "exact": (ExactGround(surface=stairs), ConeFriction(0.6)),
    }
    body = block()
    body = dataclasses.replace(body, nodes=np.asarray(body.nodes) + np.array([0.05, 0.0, 0.25]))
    return Scene(body, G, np.full(8, 0.2), *grounds[kind])


# Penalty contact with other surfaces than a plane: nodes in a bowl, on a slope and on bumps.
ON_STAIRS = [
    pytest.param("penalty", 5e-4, marks=pytest.mark.campaign),
    pytest.param("exact", 2e-3, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("kind", "dt"), ON_STAIRS)
def test_a_block_comes_to_rest_on_stairs(kind, dt):
    """Dropped over an edge it topples onto treads that carry its weight."""
    scene = falling_block(kind)
    end = simulate(scene, 3.0, options=SolverOptions(dt=dt), frame_rate=5.0).positions
    still = np.asarray(end[-1])
    assert np.abs(still - end[-2]).max() < 2e-3
    distance = scene.ground.measured(still).distance
    assert distance.min() > {"penalty": -2e-3, "exact": -1e-4}[kind]
    if kind == "penalty":
        pressed = jax.jit(lambda q: scene.normal_force(q, jnp.zeros((8, 3))))(still)
        upward = scene.ground.measured(still).axes[:, 0, 2]
        assert abs(np.sum(pressed * upward) - 2 * G) < 1.0


@pytest.mark.campaign
@pytest.mark.parametrize(("kind", "dt"), ON_STAIRS)
def test_what_the_balance_misses_on_stairs_falls_with_the_step(kind, dt):
    """Nodes land, and pass from one face to the next, within a step, where forces jump: an error of the step alone."""
    missed = []
    for step in (dt, dt / 4):
        audit = energy_audit(falling_block(kind), 1.0, options=SolverOptions(dt=step), frame_rate=10.0)
        missed.append(abs(audit.residual).max() / audit.turned_over)
    assert missed[1] < missed[0] / 4
    assert missed[1] < 1e-3


def downhill(scene, waves=3):
    """The scene without its gait, at rest on a bumpy slope."""
    hills = bumps(0.02, 0.6, seed=1, waves=waves)
    ground = dataclasses.replace(scene.ground, surface=HeightFunction(lambda x, y: hills.height(x, y) - 0.3 * x))
    nodes = ground.set_down(np.asarray(scene.structure.nodes), -0.001)
    return dataclasses.replace(
        scene, ground=ground, gait=None, structure=dataclasses.replace(scene.structure, nodes=nodes)
    )


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("name", "steps", "residuals"),
    [("reference", [None], [1e-4]), ("exact", [1.25e-3, 2.5e-3], [1e-4, 4e-4])],
    ids=["penalty", "exact"],
)
def test_a_robot_rolls_down_bumps_and_its_energy_is_booked(request, name, steps, residuals):
    """On a bumpy slope, on both contact models: energy and momentum close as on a plane, to the order of the step."""
    uneven = downhill(request.getfixturevalue(name))
    for step, residual in zip(steps, residuals):
        audit = energy_audit(uneven, 0.8, frame_rate=20.0, options=SolverOptions(dt=step))
        assert (audit.positions[-1] - uneven.structure.nodes)[:, 0].mean() > 0.05
        assert abs(audit.residual).max() < residual * audit.turned_over
        assert audit.momentum_residual.max() < 0.02


@pytest.mark.campaign
def test_the_energy_of_a_node_that_slides_down_bumps_is_booked():
    """On penalty contact."""
    uneven = downhill(node(PENALTY(), friction=SmoothFriction(0.2, 0.01)), waves=2)
    audit = energy_audit(uneven, 0.8, frame_rate=20.0, options=SolverOptions(dt=1e-3))
    assert audit.positions[-1, 0, 0] > 0.2
    assert abs(audit.residual).max() < 1e-5 * audit.turned_over
    assert audit.momentum_residual.max() < 1e-9
    assert audit.dissipated["friction"][-1] > 0.1
    assert audit.dissipated["contact"][-1] > 1e-6


def test_the_stable_step_is_that_of_the_plane():
    """The same slope as a surface limits the step as the plane does."""
    grounds = PenaltyGround(1e4, 2.0), PenaltyGround(1e4, 2.0, surface=Slope(0.0))
    plane, found = (step_limit(node(ground, friction=SmoothFriction(0.5, 0.01)), "rk4") for ground in grounds)
    np.testing.assert_allclose(found.step, plane.step, rtol=1e-6)
    assert found.set_by.split()[0] == plane.set_by.split()[0]


def test_robots_of_an_ensemble_start_alike_on_ground_of_their_own(exact):
    """Moved by up to 2 m, the lowest node of each is as high above its ground as the model's, the bumps differ; also
    where the model's have been moved before."""
    ground = dataclasses.replace(exact.ground, surface=bumps(0.05, 0.6, seed=0), offset=[0.3, -0.2, 0.1])
    nodes = np.asarray(exact.structure.nodes)
    above = (nodes[:, 2] - ground.height(nodes[:, 0], nodes[:, 1])).min()
    scene = dataclasses.replace(exact, ground=ground)
    gaits = jax.tree.map(jnp.asarray, gaits_of(exact.gait, np.zeros((1, 6))))
    _, differences = ensemble(jax.random.key(0), scene, gaits, Uncertainty(terrain=2.0), 8)
    assert np.ptp(np.asarray(differences.terrain)[:, :2]) > 2.0
    for shift in np.asarray(differences.terrain):
        there = dataclasses.replace(ground, offset=shift)
        np.testing.assert_allclose((nodes[:, 2] - there.height(nodes[:, 0], nodes[:, 1])).min(), above, atol=1e-9)
    with pytest.raises(InputError, match="terrain: robots cannot differ in it, since there is a plane"):
        ensemble(jax.random.key(0), exact, gaits, Uncertainty(terrain=2.0), 8)


@pytest.mark.campaign
def test_a_rod_with_mass_slides_in_a_bowl_as_its_equation_says():
    """Across the way it goes, its ends on the bowl, it turns about the bowl's centre.

    Without friction it does to second order in the step; with friction it is nearly as near.

    With d from the rod's middle to the centre, and mu R/d times the radial force for friction, since the two normals
    point inwards; where mu is large, it stays.
    """
    half, angle, duration = 0.6, 1.0, 0.7
    d = np.sqrt(RADIUS**2 - half**2)
    nodes = np.array([[d * np.sin(angle), y, RADIUS - d * np.cos(angle)] for y in (-half, half)])
    body = Structure(nodes, np.zeros(2), Members(((0, 1),), None, [2 * half], mass=[2.0]))

    def ends(mu, dt):
        scene = Scene(body, G, ground=ExactGround(surface=BOWL), friction=ConeFriction(mu))
        motion = simulate(scene, duration, options=SolverOptions(dt=dt, any_step=True))
        assert not motion.failed
        x, y, z = np.asarray(motion.positions[-1]).T
        np.testing.assert_allclose(y, [-half, half], atol=1e-9)
        np.testing.assert_allclose([x[0], z[0]], [x[1], z[1]], atol=1e-9)
        return np.arctan2(x[0], RADIUS - z[0])

    for mu in (0.0, 0.2):

        def rates(t, y, mu=mu):
            radial = G / d * np.cos(y[0]) + y[1] ** 2
            return [y[1], -G / d * np.sin(y[0]) + mu * RADIUS / d * radial]

        exact = solve_ivp(rates, (0, duration), [angle, 0.0], rtol=1e-10, atol=1e-12).y[0, -1]
        errors = [ends(mu, dt) - exact for dt in (2e-3, 1e-3)]
        assert abs(errors[1]) < 1e-5
        if mu == 0:
            np.testing.assert_allclose(errors[1], errors[0] / 4, rtol=0.1)
    assert abs(ends(3.0, 2e-3) - angle) < 1e-9


@pytest.mark.campaign
@pytest.mark.parametrize("surface", [Slope(0.3), HeightFunction(as_plane)])
def test_rods_with_mass_slide_on_a_surface_as_on_the_plane(surface):
    """Three rods that share their nodes fall on the same slope, given as a plane, as a surface and as a function."""
    nodes, edges = np.array([[0, 0, 0.1], [1, 0, 0.0], [0.4, 0.8, 0.2]]), ((0, 1), (1, 2), (2, 0))
    body = Structure(nodes, np.zeros(3), Members(edges, None, edge_lengths(nodes, edges), mass=np.array([1.0, 2, 3])))
    options = SolverOptions(dt=5e-3, any_step=True)
    ends = [
        simulate(Scene(body, G, ground=ground, friction=ConeFriction(0.2)), 0.4, options=options)
        for ground in (ExactGround(0.3), ExactGround(surface=surface))
    ]
    assert not any(end.failed for end in ends)
    np.testing.assert_allclose(ends[1].positions[-1], ends[0].positions[-1], rtol=0, atol=1e-9)


@pytest.mark.campaign
def test_solved_together_the_robot_moves_on_bumps_as_by_sweeps(exact):
    """Both satisfy the same conditions in each step, with a normal of its own at each node."""
    ground = dataclasses.replace(exact.ground, surface=bumps(0.03, 0.6, seed=2))
    nodes = ground.set_down(np.asarray(exact.structure.nodes), 0.0)
    there = dataclasses.replace(exact, ground=ground, structure=dataclasses.replace(exact.structure, nodes=nodes))
    ends = [simulate(there, 0.4, options=SolverOptions(coupled=way)).positions[-1] for way in (False, True)]
    assert np.abs(ends[0] - nodes).max() > 0.01
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [pytest.param("float32", marks=pytest.mark.campaign), "float64"])
def test_the_derivative_is_finite_where_a_node_comes_to_rest_on_a_curve(dtype):
    """It lands in a bowl, slides and sticks: against differences."""
    start = node(ExactGround(surface=BOWL), 0.4, 0.1, ConeFriction(0.3), above=0.02)
    options = resolve(start, options=SolverOptions(dt=5e-3, dtype=dtype))
    end = jax.jit(lambda v: final_state(start, 0.6, options, (start.structure.nodes, v))[0].sum())
    v, h = jnp.array([[1.0, 0.3, -0.5]]), 1e-6
    slope = jax.jit(jax.grad(end))(v)
    assert np.all(np.isfinite(slope))
    if dtype == "float64":
        beside = [(end(v + h * e) - end(v - h * e)) / (2 * h) for e in np.eye(3)]
        np.testing.assert_allclose(slope[0], beside, atol=1e-7)


class Ramp(Surface):
    """z = 0.1 x, with a slope that is a NumPy number in float64."""

    def height(self, x, y):
        return np.float64(0.1) * x

    def level(self, x, y, z):
        return (z - self.height(x, y)) / np.sqrt(np.float64(1.01))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ground", "surface"),
    [
        pytest.param(PenaltyGround(1e4, 1.0), Ramp(), id="penalty, own", marks=pytest.mark.campaign),
        pytest.param(ExactGround(), HeightFunction(lambda x, y: np.float64(0.1) * x), id="exact, function"),
    ],
)
def test_heights_in_float64_serve_a_robot_in_float32(ground, surface):
    """It slides down as on the same slope of the library."""
    ends = []
    for each in (surface, Slope(-np.arctan(0.1))):
        start = node(dataclasses.replace(ground, surface=each), friction=None)
        ends.append(simulate(start, 0.2, options=SolverOptions(dt=1e-3, dtype="float32"), frame_rate=5.0))
    assert ends[0].positions.dtype == np.float32
    assert ends[1].positions[-1, 0, 0] < -0.01
    np.testing.assert_allclose(ends[0].positions, ends[1].positions, rtol=0, atol=1e-6)

"""Rods with mass, supports, shared nodes and hard contact, against closed forms, equations of their own and a table."""

import dataclasses
import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipk
from studies.body_costs import scene_of

from jaxgrity import (
    ConeFriction,
    Differences,
    ExactGround,
    Gait,
    InputError,
    Members,
    Scene,
    SolverOptions,
    Structure,
    as_dtype,
    edge_lengths,
    energy_audit,
    final_state,
    gaits_of,
    random_phases,
    reactions,
    simulate,
    simulate_population,
)
from jaxgrity.model import rest_length, rigid_body
from jaxgrity.stepping import coupled_contacts, discretise, integrate, resolve
from jaxgrity.stepping.coupled_contacts import onto_cone
from jaxgrity.stepping.ground_response import Contact

G = 9.81
ANSWERS = json.loads((Path(__file__).parents[1] / "data" / "rod_answers.json").read_text())


def rods(nodes, edges, mass, node_mass=None, stiffness=None, **parts) -> Structure:
    """Rods of these masses, rigid where no stiffness is given."""
    nodes, edges = np.asarray(nodes, float), tuple(map(tuple, edges))
    stiff = None if stiffness is None else np.full(len(edges), stiffness)
    members = Members(edges, stiff, edge_lengths(nodes, edges), mass=None if mass is None else np.asarray(mass, float))
    return Structure(
        nodes, np.zeros(len(nodes)) if node_mass is None else np.asarray(node_mass, float), members, **parts
    )


def on_ground(structure: Structure, mu: float, gait: Gait | None = None) -> Scene:
    return Scene(structure, G, ground=ExactGround(), friction=ConeFriction(mu), gait=gait)


def angles(positions) -> np.ndarray:
    """Of the rods of a chain from the downward vertical, rad, (frames, rods)."""
    d = np.diff(np.asarray(positions), axis=1)
    return np.arctan2(d[..., 0], -d[..., 2])


def hanging(*theta: float) -> np.ndarray:
    steps = [[np.sin(a), 0, -np.cos(a)] for a in theta]
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


@pytest.mark.slow
def test_a_double_pendulum_of_rods_swings_as_another_program_says():
    """Within 1e-6 rad at 11 times over 5 s, by steps whose error falls by four as they are halved."""
    rows = np.array(ANSWERS["double_pendulum"]["rows"])
    structure = rods(hanging(*rows[0, 1:3]), [(0, 1), (1, 2)], [1.0, 1.0], fixed=((0, "xyz"),))
    errors = []
    for dt in (2e-3, 1e-3, 2.5e-4):
        motion = simulate(Scene(structure, 9.8), 5.0, frame_rate=2.0, options=SolverOptions(dt=dt))
        errors.append(np.abs(angles(motion.positions) - rows[:, 1:3]).max())
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)
    assert errors[2] < 1e-6


@pytest.mark.campaign
@pytest.mark.parametrize("amplitude", [1e-3, 2.5])
def test_a_rod_swings_about_its_end_in_its_period(amplitude):
    """2 pi sqrt(2 L/3 g) times 2/pi K(sin^2(A/2)), from small angles to large ones."""
    period = 4 * np.sqrt(2 / (3 * G)) * ellipk(np.sin(amplitude / 2) ** 2)
    structure = rods(hanging(amplitude), [(0, 1)], [2.0], fixed=((0, "xyz"),))
    motion = simulate(Scene(structure, G), period, frame_rate=2 / period, options=SolverOptions(dt=period / 4000))
    np.testing.assert_allclose(angles(motion.positions)[:, 0], [amplitude, -amplitude, amplitude], rtol=1e-5)


@pytest.mark.campaign
def test_a_rod_that_hangs_pulls_at_its_support():
    """By m g at rest, and by 5/2 m g at the lowest point of a swing from the horizontal; the audit closes with it."""
    structure = rods(hanging(np.pi / 2), [(0, 1)], [2.0], fixed=((0, "xyz"),))
    scene = Scene(structure, G)
    quarter = np.sqrt(2 / (3 * G)) * ellipk(0.5)
    motion = simulate(scene, quarter, frame_rate=1 / quarter, options=SolverOptions(dt=quarter / 2000))
    force = reactions(scene, motion)[-1]
    assert force[0, 2] == pytest.approx(2.5 * 2 * G, rel=1e-3)
    assert np.all(force[1] == 0)
    audit = energy_audit(scene, quarter, options=SolverOptions(dt=quarter / 2000))
    assert audit.momentum_residual.max() < 1e-12
    assert audit.angular_residual.max() < 1e-9
    assert abs(audit.residual).max() < 1e-5 * audit.turned_over


@pytest.mark.slow
def test_springs_with_mass_on_a_support_balance_energy_and_momentum():
    """By a Runge-Kutta method, the reaction of the support among the forces from outside."""
    structure = rods(hanging(0.8, 0.8), [(0, 1), (1, 2)], [1.0, 1.0], stiffness=1e4, fixed=((0, "xyz"),))
    options = SolverOptions(method="tsit5", rtol=1e-10, atol=1e-10)
    audit = energy_audit(Scene(structure, G), 0.5, options=options)
    assert abs(audit.residual).max() < 1e-7 * audit.turned_over
    assert audit.momentum_residual.max() < 1e-7
    assert audit.angular_residual.max() < 1e-7


@pytest.mark.campaign
def test_a_rod_thrown_spins_evenly():
    """Its centre on a parabola, its angle in proportion to time, to second order in the step."""
    structure = rods([[-0.5, 0, 0], [0.5, 0, 0]], [(0, 1)], [3.0])
    spin, speed = 4.0, np.array([1.0, 0.5, 3.0])
    velocities = speed + spin * np.array([[0, -0.5, 0], [0, 0.5, 0]])
    found = []
    for dt in (4e-3, 2e-3):
        options = SolverOptions(dt=dt)
        motion = simulate(Scene(structure, G), 0.6, frame_rate=10.0, options=options, velocities=velocities)
        q, t = np.asarray(motion.positions), np.asarray(motion.times)
        parabola = speed * t[:, None] - [0, 0, G / 2] * t[:, None] ** 2
        np.testing.assert_allclose(q.mean(1), parabola, rtol=0, atol=1e-12)
        turned = np.unwrap(np.arctan2(q[:, 1, 1] - q[:, 0, 1], q[:, 1, 0] - q[:, 0, 0]))
        found.append(np.abs(turned - spin * t).max())
    assert found[1] < 1e-4
    assert found[0] / found[1] == pytest.approx(4, rel=0.1)


def falling(resist, duration: float, start: float) -> float:
    """The angle from the vertical of a rod of 1 m that falls from `start`, by an equation of its own, rad."""
    solution = solve_ivp(resist, (0, duration), [start, 0.0], rtol=1e-11, atol=1e-12)
    return solution.y[0, -1]


ON_ICE = "centre falls straight: (1/12 + sin^2/4) a'' = g/2 sin - sin cos/4 a'^2"
HELD = "turns about its end: a'' = 3 g/2 sin"


@pytest.mark.parametrize(
    ("mu", "law"),
    [
        pytest.param(0.0, ON_ICE, marks=pytest.mark.slow),
        pytest.param(2.0, HELD, marks=pytest.mark.slow),
        pytest.param(None, ON_ICE, marks=pytest.mark.campaign),
    ],
)
def test_a_rod_falls_from_nearly_upright(mu, law):
    """On ice its centre falls straight down; on rough ground it turns about its end."""
    tilt, duration = 0.2, 0.45
    structure = rods([[0, 0, 0], [np.sin(tilt), 0, np.cos(tilt)]], [(0, 1)], [2.0])
    friction = None if mu is None else ConeFriction(mu)
    scene = Scene(structure, G, ground=ExactGround(), friction=friction)

    def rates(t, y):
        sine, cosine = np.sin(y[0]), np.cos(y[0])
        on_ice = (G / 2 * sine - sine * cosine / 4 * y[1] ** 2) / (1 / 12 + sine**2 / 4)
        return [y[1], on_ice if law == ON_ICE else 1.5 * G * sine]

    motion = simulate(scene, duration, frame_rate=1 / duration, options=SolverOptions(dt=1e-3, coupled=True))
    d = np.asarray(motion.positions[-1, 1] - motion.positions[-1, 0])
    assert np.arctan2(d[0], d[2]) == pytest.approx(falling(rates, duration, tilt), abs=2e-5)
    held = float(motion.positions[-1, 0, 0]) if law == HELD else float(motion.positions[-1].mean(0)[0])
    assert held == pytest.approx(0.0 if law == HELD else np.sin(tilt) / 2, abs=1e-12)


@pytest.mark.slow
def test_a_rod_slides_down_a_wall():
    """One end along the wall, the other along the ground, by supports of some axes: a'' = 3 g/2 sin; and d/dg of it."""
    tilt, duration = 0.3, 0.5
    nodes = [[np.sin(tilt), 0, 0], [0, 0, np.cos(tilt)]]
    scene = as_dtype(Scene(rods(nodes, [(0, 1)], [2.0], fixed=((0, "yz"), (1, "xy"))), G), "float64")
    options = resolve(scene, duration, SolverOptions(dt=1e-3)).as_inputs()

    def angle(g):
        changed = eqx.tree_at(lambda s: s.gravity, scene, g)
        start = (changed.structure.nodes, jnp.zeros((2, 3)))
        q = integrate(start, jnp.array([0.0, duration]), changed, options).ys[0][-1]
        return jnp.arctan2(q[0, 0], q[1, 2])

    found, slope = jax.jit(lambda g: jax.jvp(angle, (g,), (1.0,)))(G)
    at = [falling(lambda t, y, g=g: [y[1], 1.5 * g * np.sin(y[0])], duration, tilt) for g in (G, G + 1e-3, G - 1e-3)]
    assert float(found) == pytest.approx(at[0], abs=1e-5)
    assert float(slope) == pytest.approx((at[1] - at[2]) / 2e-3, rel=1e-4)


ACTUATED = Gait((0,), np.zeros(1), np.array([0.2]), np.array([0.5]))
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0.5, 0, 0.5]], [(0, 1), (1, 2), (0, 2)]


def lengths_off(scene: Scene, motion) -> float:
    """The largest error of a strut's length, m."""
    struts = scene.structure.struts
    i, j = np.array(struts.edges).T
    q = np.asarray(motion.positions)
    wanted = jax.vmap(lambda t: rest_length(struts, scene.gait, t, 0))(jnp.asarray(motion.times))
    return float(np.abs(np.linalg.norm(q[:, i] - q[:, j], axis=2) - wanted).max())


@pytest.mark.campaign
@pytest.mark.parametrize(("mass", "mu"), [((1, 1, 3), 1.2), ((0.5, 0.5, 5), 2.0)])
def test_a_rough_triangle_whose_base_turns_back(mass, mu):
    """Three struts that share nodes, the base pressed on at both ends as it changes its length: sweeps alone fail."""
    scene = on_ground(rods(*TRIANGLE, None, mass), mu, ACTUATED)
    motion = simulate(scene, 2.0, options=SolverOptions(dt=5e-3))
    assert not motion.failed
    assert lengths_off(scene, motion) < 1e-10
    assert np.min(motion.positions[..., 2]) > -1e-12


@pytest.mark.slow
@pytest.mark.parametrize(("masses", "mu"), [((1e-6, 1), 0.8), ((1, 1), 8.0)])
def test_a_strut_that_falls_over_its_light_end(masses, mu):
    """Where the light end sticks, the heavy one turns about it as a pendulum does, whatever the ratio of masses.

    By the program of the flat strut below: the gait has no amplitude.
    """
    tilt, duration = np.radians(20), 0.3
    nodes = [[0, 0, 0], [np.sin(tilt), 0, np.cos(tilt)]]
    still = dataclasses.replace(ACTUATED, amplitude=np.zeros(1))
    scene = on_ground(rods(nodes, [(0, 1)], None, masses), mu, still)
    motion = simulate(scene, duration, frame_rate=200.0, options=SolverOptions(dt=1e-3))
    assert not motion.failed
    expected = falling(lambda t, y: [y[1], G * np.sin(y[0])], duration, tilt)
    x, _, z = np.asarray(motion.positions[-1, 1] - motion.positions[-1, 0])
    assert np.arctan2(x, z) == pytest.approx(expected, abs=1e-5)
    assert np.abs(motion.positions[-1, 0]).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(("mu", "dt"), [(1.0, 5e-3), (2.0, 2e-2)])
def test_a_flat_strut_keeps_its_length_against_friction(mu, dt):
    """Four sweeps leave an error of about mu g h^2, and fail at 20 ms."""
    scene = on_ground(rods([[0, 0, 0], [1, 0, 0]], [(0, 1)], None, [1, 1]), mu, ACTUATED)
    motion = simulate(scene, 2.0, frame_rate=50.0, options=SolverOptions(dt=dt, any_step=True))
    assert not motion.failed
    assert lengths_off(scene, motion) < 1e-10


@pytest.mark.campaign
def test_a_chain_of_twenty_struts_falls_on_the_ground():
    """And the error of its lengths stays rounding."""
    x = np.stack([0.3 * np.arange(21), 0 * np.arange(21), 0.05 + 0.1 * np.random.default_rng(0).random(21)], axis=1)
    scene = on_ground(rods(x, [(k, k + 1) for k in range(20)], None, np.ones(21)), 0.5)
    motion = simulate(scene, 1.0, options=SolverOptions(dt=5e-3))
    assert not motion.failed
    assert lengths_off(scene, motion) < 1e-10


SQUARE = [[0, 0, 0.2], [1, 0, 0.4], [1, 1, 0.6], [0, 1, 0.4]]


@pytest.mark.parametrize(
    ("nodes", "duration"),
    [
        pytest.param(SQUARE, 0.4, marks=pytest.mark.slow),
        pytest.param([*SQUARE, [0.5, 0.4, 1.2]], 1.0, marks=pytest.mark.campaign),
    ],
    ids=["six between four in a plane", "ten between five"],
)
def test_more_struts_than_rigidity_needs(nodes, duration):
    """All nodes are joined by struts, one too many; they fall on a corner: lengths are kept to the root of rounding.

    The struts' Delassus matrix is singular there, so that rounds stop at a share of 1.5e-8.
    """
    edges = [(i, j) for i in range(len(nodes)) for j in range(i)]
    scene = on_ground(rods(nodes, edges, None, np.ones(len(nodes))), 0.7)
    motion = simulate(scene, duration, options=SolverOptions(dt=5e-3))
    assert not motion.failed
    assert np.min(motion.positions[..., 2]) < 1e-9
    assert lengths_off(scene, motion) < 1e-7


@pytest.mark.campaign
def test_solved_together_the_six_strut_robot_moves_as_by_sweeps(exact):
    """Both satisfy the same conditions in each step."""
    ends = [simulate(exact, 1.0, options=SolverOptions(coupled=way)).positions[-1] for way in (False, True)]
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("shape", "mass"),
    [
        pytest.param(([[0, 0, 0], [1, 0, 0]], [(0, 1)]), [0.3], marks=pytest.mark.slow),
        pytest.param(TRIANGLE, [0.3, 0.2, 0.1], marks=pytest.mark.campaign),
    ],
    ids=["rod", "triangle"],
)
def test_derivatives_are_those_of_the_motion(central_difference, shape, mass):
    """Rods slide and are actuated: reverse mode against differences."""
    count = len(shape[0])
    scene = as_dtype(on_ground(rods(*shape, mass, np.full(count, 0.5)), 0.4, ACTUATED), "float64")
    options = resolve(scene, 0.1, SolverOptions(dt=1e-2, any_step=True))
    terms, solver = discretise(options)
    push = jnp.array([[1.0, 0.1, 0]] * count)

    def end(mu, mass):
        changed = eqx.tree_at(
            lambda s: (s.friction.mu, s.structure.node_mass), scene, (mu, mass * jnp.arange(1.0, count + 1))
        )
        y, state = (
            (changed.structure.nodes, push),
            solver.init(terms, 0.0, 0.01, (scene.structure.nodes, push), changed),
        )

        def step(carry, k):
            y, _, _, state, _ = solver.step(
                terms, 1.0 + 0.01 * k, 1.01 + 0.01 * k, *carry[:1], changed, carry[1], False
            )
            return (y, state), None

        (y, _), _ = jax.lax.scan(step, (y, state), jnp.arange(3.0))
        return y[0][-1, 0] + y[0][0, 0]

    end = jax.jit(jax.value_and_grad(end, (0, 1)))
    reverse = end(0.4, 0.7)[1]
    for argument, (value, found) in enumerate(zip((0.4, 0.7), reverse)):
        at = lambda x: end(*(x if k == argument else y for k, y in enumerate((0.4, 0.7))))[0]  # noqa: B023, E731
        difference = central_difference(at, value, 1e-5)
        assert abs(difference) > 1e-4
        assert float(found) == pytest.approx(float(difference), rel=1e-5)


@pytest.mark.campaign
def test_populations_have_rods_and_supports_of_their_own_masses():
    """Two robots that differ in node masses move as each alone."""
    structure = rods(hanging(0.8), [(0, 1)], [1.0], [0.1, 0.2], fixed=((0, "xyz"),))
    scene = Scene(structure, G, gait=dataclasses.replace(ACTUATED, start=0.1, ramp=0.1))
    factors = np.array([[1.0, 1.0], [2.0, 3.0]])
    options = SolverOptions(dt=5e-3)
    gaits = gaits_of(scene.gait, np.zeros((2, 1)))
    together = simulate_population(scene, gaits, 0.5, options=options, differences=Differences(node_mass=factors))
    for factor, found in zip(factors, together.positions):
        own = dataclasses.replace(structure, node_mass=structure.node_mass * factor)
        alone = simulate(dataclasses.replace(scene, structure=own), 0.5, options=options)
        np.testing.assert_allclose(found, alone.positions[-1], rtol=0, atol=1e-9)


def slab(gap: np.ndarray) -> coupled_contacts.ContactProblem:
    """A slab of 1 kg on a grid of nine contacts, with nine more above them, that falls for a step with these gaps."""
    h, inertia, side = 2e-3, 1 / 6, np.linspace(-0.1, 0.1, 3)
    x = np.stack(np.meshgrid([0, 0.1], side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    r, units = x - x.mean(0), np.eye(3)
    # the motion of each contact, along x as the normal, with the velocity of the centre and the spin
    reach = np.concatenate([np.tile(units, (len(x), 1, 1)), np.cross(units, r[:, None]).swapaxes(1, 2)], axis=2)
    reach = reach.reshape(-1, 6)
    response = reach @ np.diag([1, 1, 1, 1 / inertia, 1 / inertia, 1 / inertia]) @ reach.T
    root = 1 / np.sqrt(np.diag(response).reshape(-1, 3).mean(1))
    scale = np.repeat(root, 3)
    fall = (scale * (reach @ [-G * h, 0, 0, 0, 0, 0])).reshape(-1, 3)
    contact = Contact(jnp.array(-(x[:, 0] + gap) / h * root), jnp.array(0.5))
    tolerance = np.finfo(float).eps ** 0.75
    return coupled_contacts.ContactProblem(
        jnp.array(scale[:, None] * response * scale), jnp.array(fall), contact, jnp.array(root), tolerance, tolerance
    )


def test_a_body_on_many_more_contacts_than_it_has_motions_rests_at_once(monkeypatch):
    """A slab on nine contacts, which share its weight in many ways.

    Newton's method needs one iteration, since no contact changes. Rounding errors of a singular matrix once made it
    go astray, so that other methods took over, at many times the cost.
    """
    monkeypatch.setattr(coupled_contacts, "NEWTON", 2)
    monkeypatch.setattr(coupled_contacts, "ROUNDS", 0)
    problem = slab(np.zeros(18))
    z, error = coupled_contacts.solve_contacts(problem, -problem.b)
    assert error <= problem.tolerance
    p = np.asarray(coupled_contacts.as_impulses(problem.contact, z) * problem.root_mass[:, None])
    np.testing.assert_allclose(p[:, 0].sum(), G * 2e-3, rtol=1e-9)


def test_contacts_out_of_reach_are_no_unknowns(monkeypatch):
    """A slab in the air, or on four feet: the same velocities as with all contacts, from eight of them.

    If those that are taken first are too few, and another would sink in, all are solved.
    """
    solve, feet = coupled_contacts.solve_contacts, np.where(np.isin(np.arange(18), [0, 2, 6, 8]), 0.0, 0.05)
    of_all = jax.jit(lambda problem: solve(problem, -problem.b))

    def from_nearest(nearest, unused=None):
        """The solution that takes so many contacts first, and where no solution with `unused` contacts is finite."""

        def solved(problem, start):
            found = solve(problem, start)
            return found._replace(trial=found.trial * jnp.nan) if len(start) == unused else found

        def found(problem):
            with monkeypatch.context() as changed:
                changed.setattr(coupled_contacts, "NEAREST", nearest)
                changed.setattr(coupled_contacts, "solve_contacts", solved)
                return coupled_contacts.solve_nearest_contacts(problem, -problem.b)

        return jax.jit(found)

    of_eight = from_nearest(8, unused=18)
    for gap, solved in ((feet + 1.0, of_eight), (feet, of_eight), (feet, from_nearest(2))):
        problem = slab(gap)
        found, whole = solved(problem), of_all(problem)
        w, expected = (coupled_contacts.as_impulses(problem.contact, z) - z for z in (found.trial, whole.trial))
        np.testing.assert_allclose(w, expected, atol=1e-12)
        assert found.error <= problem.tolerance
        assert np.array_equal(w, problem.b) == (gap[0] > 0)


def test_where_more_contacts_press_all_are_unknowns_at_once(monkeypatch):
    """A slab that lies on nine contacts: no solution with eight of them is tried before."""
    solve, tried = coupled_contacts.solve_contacts, []

    def counted(problem, start):
        jax.debug.callback(tried.append, jnp.array(len(start)))
        return solve(problem, start)

    monkeypatch.setattr(coupled_contacts, "solve_contacts", counted)
    solved = jax.jit(lambda problem: coupled_contacts.solve_nearest_contacts(problem, -problem.b))
    few = np.where(np.isin(np.arange(18), [0, 2, 6, 8]), 0.0, 0.05)
    for gap, expected in ((np.zeros(18), [18]), (few, [8])):
        tried.clear()
        assert jax.block_until_ready(solved(slab(gap))).error < 1e-12
        jax.effects_barrier()
        assert list(map(int, tried)) == expected


def test_the_response_of_contacts_by_its_factors_is_that_of_their_product():
    """Alike, on four feet and on all contacts; the factors are of a body of one node that moves without turning."""
    feet = np.where(np.isin(np.arange(18), [0, 2, 6, 8]), 0.0, 0.05)
    solved = jax.jit(lambda problem: coupled_contacts.solve_nearest_contacts(problem, -problem.b))
    for gap in (feet, np.zeros(18)):
        problem = slab(gap)
        D = np.asarray(problem.root_mass)[:, None, None] * np.eye(3)
        factors = coupled_contacts.Factors(jnp.array(D.reshape(-1, 3)), 0.5 * jnp.eye(3))
        found = solved(problem._replace(G=factors))
        expected = solved(problem._replace(G=factors.whole()))
        np.testing.assert_allclose(found.trial, expected.trial, rtol=0, atol=1e-12)
        assert found.error <= problem.tolerance


@pytest.mark.campaign
def test_derivatives_of_a_body_with_many_contacts(central_difference):
    """Eighteen, of which three feet land one after the other on a slope and slide on: in friction and gravity.

    With a fourth foot the shares of the weight would not be unique, nor would friction, to rounding.
    """
    side = np.array([-0.1, 0.0, 0.1])
    x = np.stack(np.meshgrid(side, side, [0.03, 0.1], indexing="ij"), axis=-1).reshape(-1, 3)
    x[2 * np.array([0, 2, 7]), 2] = 0
    x = x @ Rotation.from_rotvec([0.03, 0.55, 0.0]).as_matrix().T
    x[:, 2] += 0.004 - (x[:, 2] + np.tan(0.5) * x[:, 0]).min()
    structure = Structure(x, np.zeros(18), bodies=(rigid_body(x, range(18), 1.0, [6e-3, 6e-3, 8e-3]),))
    scene = Scene(structure, G, ground=ExactGround(incline=0.5), friction=ConeFriction(0.3))
    assert len(x) >= 2 * coupled_contacts.NEAREST
    scene, options = as_dtype(scene, "float64"), resolve(scene, 0.2, SolverOptions(dt=5e-3, any_step=True))

    @jax.jit
    @jax.value_and_grad
    def end(given):
        changed = eqx.tree_at(lambda s: (s.friction.mu, s.gravity), scene, (given[0], given[1]))
        return final_state(changed, 0.2, options)[0][17] @ jnp.array([1.0, 0.5, 0.3])

    at = jnp.array([0.3, G])
    found = end(at)[1]
    expected = [central_difference(lambda y, k=k: end(at.at[k].set(y))[0], at[k], 1e-5) for k in range(2)]
    assert np.abs(expected).min() > 1e-3
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_the_nearest_point_of_a_cone():
    """What is left after the projection is at a right angle to it, and in the polar cone."""
    rng = np.random.default_rng(0)
    x, mu = rng.normal(size=(200, 3)), 0.6
    near = np.asarray(onto_cone(jnp.array(x), mu * jnp.ones(200)))
    across = np.hypot(near[:, 1], near[:, 2])
    assert np.all(across <= mu * near[:, 0] + 1e-12)
    rest = x - near
    np.testing.assert_allclose(np.sum(rest * near, axis=1), 0, atol=1e-12)
    assert np.all(mu * np.hypot(rest[:, 1], rest[:, 2]) <= -rest[:, 0] + 1e-12)


def test_what_makes_no_sense_is_refused(reference, exact):
    """In one line."""
    with pytest.raises(InputError, match="only complementarity stepping has it"):
        simulate(reference, 1.0, options=SolverOptions(coupled=True))
    held = dataclasses.replace(exact.structure, fixed=((0, "xyz"),))
    with pytest.raises(InputError, match="sweeps handle no rods with mass, supports"):
        simulate(dataclasses.replace(exact, structure=held), 1.0, options=SolverOptions(coupled=False))
    with pytest.raises(InputError, match="expected 0 where the node is fixed"):
        simulate(dataclasses.replace(exact, structure=held), 1.0, velocities=np.ones((12, 3)))
    with pytest.raises(InputError, match="nothing is fixed"):
        reactions(exact, simulate(exact, 0.01))


@pytest.mark.parametrize(
    "structure",
    [
        pytest.param(rods([[0, 0, 0], [0.2, 0, 1.0]], [(0, 1)], [2.0]), marks=pytest.mark.campaign),
        pytest.param(
            rods(
                [[0.0, 0, 0.8], [0.6, 0, 0.6], [1.2, 0.2, 0.3]],
                [(0, 1), (1, 2)],
                [0.5, 0.7],
                node_mass=[0.1, 0.2, 0.1],
                fixed=((0, "xyz"),),
            ),
            marks=pytest.mark.campaign,
        ),
    ],
    ids=["a rod", "two rods and a support"],
)
def test_float32_stays_float32(structure):
    """Rods with mass and the ground: the same motion as in float64, as far as single precision goes."""
    scene = on_ground(structure, 0.5)
    options = SolverOptions("complementarity", dt=5e-3, any_step=True, coupled=True)
    moved = [
        simulate(scene, 0.3, options=dataclasses.replace(options, dtype=dtype)) for dtype in ("float32", "float64")
    ]
    assert [str(each.positions.dtype) for each in moved] == ["float32", "float64"]
    assert not any(each.failed for each in moved)
    np.testing.assert_allclose(moved[0].positions, moved[1].positions, atol=1e-4)


@pytest.mark.campaign
def test_a_foot_on_more_points_than_hold_it_needs_the_second_method_less(monkeypatch):
    """Of a spine with hinges whose cables a gait moves: some 40 rounds of it in a step, and 74 with plain Newton's
    iterations alone."""
    used, steps, splitting = [], 100, coupled_contacts._split
    monkeypatch.setattr(
        coupled_contacts, "_split", lambda *given: (jax.debug.callback(lambda: used.append(1)), splitting(*given))[1]
    )
    scene = scene_of("hinged", 3)
    each = np.ones(scene.structure.member_count)
    moving = Gait(
        tuple(range(len(each))), random_phases(1, len(each), seed=0)[0], 0.1 * each, each, start=0.0, ramp=0.1
    )
    motion = simulate(
        dataclasses.replace(scene, gait=moving), 2e-3 * steps, options=SolverOptions(dt=2e-3, any_step=True)
    )
    jax.effects_barrier()
    assert not motion.failed
    assert len(used) < 50 * steps

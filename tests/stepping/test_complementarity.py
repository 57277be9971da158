"""Complementarity stepping: exact contact, Coulomb's cone, rigid struts."""

import dataclasses
import json
from functools import partial
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import swept

from jaxgrity import (
    InputError,
    SolverOptions,
    Sphere,
    bumps,
    final_state,
    gaits_of,
    parse_scene,
    random_phases,
    scene_text,
    simulate,
    simulate_population,
    verify,
    with_gait,
)
from jaxgrity.core.tracing import traced
from jaxgrity.model.actuation import rest_length
from jaxgrity.model.friction import ConeFriction
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.model.structure import Members, Structure, edge_lengths
from jaxgrity.stepping import constraints, velocities_midway
from jaxgrity.stepping.blocks import Blocks, disjoint_groups
from jaxgrity.stepping.complementarity import LARGEST_LENGTH_ERROR
from jaxgrity.stepping.constraints import impulses, length_error, step_problem, sweep, trials_of, velocities
from jaxgrity.stepping.discretisation import FAILURES, integrate
from jaxgrity.stepping.options import resolve
from jaxgrity.stepping.swept import SweptImpulses

G = 9.81


@pytest.fixture(scope="module")
def rolling(exact):
    """Some turns of it at the default step, in as many frames as motions share one program for."""
    return simulate(exact, 25.0, frame_rate=200.0)


def length_errors(scene: Scene, trajectory) -> np.ndarray:
    """(frames, struts), how far each strut is from L(t), in the frames where a step ends."""
    struts, times, dt = scene.structure.struts, np.asarray(trajectory.times), trajectory.dt
    ends = np.abs(times - dt * np.round(times / dt)) < 1e-9
    i, j = np.array(struts.edges).T
    q = np.asarray(trajectory.positions)[ends]
    wanted = jax.jit(jax.vmap(lambda t: rest_length(struts, scene.gait, t, 0)))(times[ends])
    return np.abs(np.linalg.norm(q[:, i] - q[:, j], axis=2) - wanted)


def block(incline: float, mu: float | None = None, restitution: float | None = None, height: float = 0.0) -> Scene:
    """A point mass of 2 kg on, or `height` above, a plane."""
    ground = ExactGround(incline, restitution)
    structure = Structure(np.array([[0.0, 0.0, height]]), np.array([2.0]))
    return Scene(structure, gravity=G, ground=ground, friction=None if mu is None else ConeFriction(mu))


def test_the_order_is_1_where_a_node_slides_along_a_curve():
    """It is thrown across a slope with mu = tan(incline), on which its speed and that down the slope add up to what
    they are at first. Friction acts against the velocity at the end of a step: half the step, half the error."""
    slope, speed = 0.35, 0.5
    scene, errors = block(slope, np.tan(slope)), []
    for dt in (5e-3, 2.5e-3, 1.25e-3):
        thrown = {"velocities": np.array([[0.0, speed, 0.0]])}
        motion = simulate(scene, 0.1, options=SolverOptions(dt=dt, any_step=True), **thrown)
        velocity = velocities_midway(scene, motion)[-1, 0]
        down = velocity @ np.array([np.cos(slope), 0.0, -np.sin(slope)])
        errors.append(abs(np.linalg.norm(velocity) + down - speed))
    assert 0.1 < down < 0.9 * np.linalg.norm(velocity)
    assert 1e-3 < errors[0] < 2e-2
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 2, atol=0.1)


@pytest.mark.slow
def test_no_node_is_ever_below_the_plane(rolling):
    """Signorini's law is met last in every sweep, so only rounding is left."""
    assert rolling.method == "complementarity"
    assert np.min(rolling.positions[..., 2]) > -1e-12


@pytest.mark.parametrize(
    "duration", [pytest.param(25.0, marks=pytest.mark.slow), pytest.param(60.0, marks=pytest.mark.campaign)]
)
def test_struts_keep_their_lengths(exact, rolling, duration):
    """Within 1e-12 m of L(t) in every step of a roll, by the default sweeps, and no worse at its end."""
    motion = rolling if duration == rolling.times[-1] else simulate(exact, duration, frame_rate=200.0)
    errors = length_errors(exact, motion).max(1)
    assert len(errors) == 200 * duration + 1
    assert errors.max() < 1e-12
    third = len(errors) // 3
    assert np.median(errors[-third:]) <= 2 * np.median(errors[third // 2 : 3 * third // 2]), "the error drifts"


@pytest.mark.campaign
def test_struts_keep_their_lengths_as_closely_as_asked(exact):
    """Sweeps go on until every strut is within the tolerance, for one robot as for many."""
    trajectory = simulate(exact, 25.0, frame_rate=200.0, options=SolverOptions(strut_tolerance=1e-10))
    assert not trajectory.failed
    assert length_errors(exact, trajectory).max() < 1e-10
    gaits = gaits_of(exact.gait, np.stack([exact.gait.phase, exact.gait.phase + 1]))
    outcomes = simulate_population(exact, gaits, 2.0, options=SolverOptions(strut_tolerance=1e-10))
    assert trajectory.times[400] == 2.0
    np.testing.assert_allclose(outcomes.com_end[0], np.asarray(trajectory.positions[400]).mean(0), rtol=0, atol=1e-8)


@pytest.mark.slow
def test_a_tolerance_that_is_not_met_is_a_failure():
    """One sweep does not suffice on the ground: the rollout says so, and so does a robot of a population."""
    scene, one_sweep = swept(), SolverOptions(dt=5e-3, strut_tolerance=1e-10, sweeps=1)
    assert simulate(scene, 0.5, options=one_sweep).failed
    gaits = gaits_of(scene.gait, random_phases(2, 1, seed=0))
    assert np.all(simulate_population(scene, gaits, 0.5, options=one_sweep).failure == 1)


def with_a_short_strut(scene: Scene, length: float) -> Scene:
    """The scene with one more strut, which falls far above the robot, and is so short that it takes nearly no room."""
    structure, struts = scene.structure, scene.structure.struts
    nodes = np.concatenate([structure.nodes, [[0.0, 0.0, 100.0], [length, 0.0, 100.0]]])
    edges, rest = (*struts.edges, (12, 13)), np.append(struts.rest_length, length)
    longer = Structure(nodes, np.append(structure.node_mass, [0.5, 0.5]), Members(edges, None, rest), structure.cables)
    gait = dataclasses.replace(scene.gait, members=tuple(k + (k >= 6) for k in scene.gait.members))
    return Scene(longer, scene.gravity, None, scene.ground, scene.friction, gait)


@pytest.fixture(scope="module")
def few_sweeps(exact):
    """The robot with a short strut, and its motions by one, two and three sweeps in each step."""
    scene = with_a_short_strut(exact, 1e-4)
    options = [SolverOptions(dt=5e-3, sweeps=count) for count in (1, 2, 3)]
    return scene, [simulate(scene, 4.0, frame_rate=200.0, options=each) for each in options]


@pytest.mark.campaign
def test_sweeps_are_newton_steps(few_sweeps):
    """Each sweep about squares the error in strut lengths, since impulses allow for what the ground will answer."""
    scene, motions = few_sweeps
    errors = [length_errors(scene, motion).max() for motion in motions]
    assert 1e-6 < errors[0] < 1e-3
    assert errors[1] < 1e-5
    assert errors[2] < 1e-10


@pytest.mark.campaign
def test_each_strut_is_judged_by_its_own_length(few_sweeps):
    """Where a long strut may be off by some of a millimetre, a far shorter one beside it changes nothing in that."""
    scene, (motion, *_) = few_sweeps
    assert not motion.failed
    errors = length_errors(scene, motion).max(0) / np.asarray(scene.structure.struts.rest_length)
    assert errors.max() < LARGEST_LENGTH_ERROR
    assert errors[:6].max() > LARGEST_LENGTH_ERROR * 1e-4, "a thousandth of the short strut's length would be no limit"


def test_the_error_of_a_strut_is_relative_to_its_own_length():
    """A short strut off by less than a long one, but by more of its length, is the worse of the two."""
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.01, 1, 0]])
    struts = Members(((0, 1), (2, 3)), None, np.array([1.0, 0.01]))
    scene = as_dtype(Scene(Structure(nodes, np.ones(4), struts)), "float64")
    stretching = jnp.array([[0.0, 0, 0], [5e-4, 0, 0], [0, 0, 0], [2e-5, 0, 0]])
    problem = step_problem(scene, 1.0, 1.0, scene.structure.nodes, stretching)
    error = length_error(scene, 1.0, problem, trials_of(scene, stretching))
    assert float(error.largest) == pytest.approx(5e-4, rel=1e-9)
    assert float(error.relative) == pytest.approx(2e-3, rel=1e-9)


def thrown_about(exact: Scene, incline: float) -> tuple[Scene, jax.Array, jax.Array]:
    """Six struts and a free node, some nodes pressed on, some slipping: scene, positions and velocities."""
    structure = exact.structure
    nodes, mass = np.vstack([structure.nodes, [0.0, 0.0, 0.5]]), np.append(structure.node_mass, 0.3)
    ground = ExactGround(incline)
    scene = Scene(Structure(nodes, mass, structure.struts), G, None, ground, ConeFriction(0.1), exact.gait)
    rng = np.random.default_rng(0)
    q, w = nodes + 0.02 * rng.normal(size=nodes.shape), 2 * rng.normal(size=nodes.shape)
    q[:, 2] -= np.median(q[:, 2])
    return as_dtype(scene, "float64"), jnp.asarray(q), jnp.asarray(w)


@pytest.mark.parametrize("incline", [0.0, 0.3])
def test_laid_out_by_struts_a_sweep_does_the_same(exact, incline, monkeypatch):
    """As laid out by nodes, the way of struts that share some: with a free node beside them, pressed on, slipping."""
    scene, q, w = thrown_about(exact, incline)
    edges, everywhere = scene.structure.struts.edges, tuple(range(len(q)))
    by_nodes = Blocks((everywhere,), disjoint_groups(edges), edges)
    found = []
    for by_struts in (True, False):
        if not by_struts:
            monkeypatch.setattr(constraints, "blocks", lambda *_: by_nodes)

        def swept_thrice(w, parts=2 if by_struts else 1):
            problem = step_problem(scene, 0.01, 1.5, q, w)
            assert len(problem.closing) == parts
            trials = trials_of(scene, w)
            for _ in range(3):
                trials = sweep(scene, problem, trials)
            return velocities(scene, problem, trials), impulses(scene, problem, trials)

        found.append(jax.jit(swept_thrice)(w))
    pressed = np.asarray(found[0][1].normal)
    assert 0 < np.count_nonzero(pressed) < len(q)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=0, atol=1e-12), *found)


def converged(scene: Scene, problem, trials, sweeps: int, tolerance: float | None = None):
    """Trial impulses after sweeps, with their derivative where they end."""
    return SweptImpulses()._constrain(scene, 0.01, problem, trials, sweeps, tolerance)


def one_by_one(scene: Scene, problem, trials, sweeps: int):
    """The same, differentiated through each sweep."""
    return jax.lax.fori_loop(0, sweeps, lambda _, trials: sweep(scene, problem, trials), trials)


def after_a_step(exact, ground, friction) -> tuple:
    """A number made of velocities and impulses after eight sweeps: as a function of how to sweep, and of arguments.

    Those are positions, velocities, masses and factors of the struts' lengths; with a direction to change them in.
    """
    scene, q, w = thrown_about(exact, 0.0)
    scene = as_dtype(dataclasses.replace(scene, ground=ground, friction=friction), "float64")
    at, rng = (q, w, scene.structure.node_mass, jnp.ones(6)), np.random.default_rng(1)
    weights, along = rng.normal(size=(2, *q.shape)), tuple(rng.normal(size=x.shape) for x in at)

    def number(sweeps, q, w, mass, factor):
        changed = eqx.tree_at(lambda s: s.structure.node_mass, scene, mass)
        changed = eqx.tree_at(lambda s: s.structure.struts.rest_length, changed, replace_fn=lambda x: factor * x)
        problem = step_problem(changed, 0.01, 1.5, q, w)
        trials = sweeps(changed, problem, trials_of(changed, w), 8)
        pressed = impulses(changed, problem, trials).normal
        return jnp.vdot(weights[0], velocities(changed, problem, trials)) + jnp.vdot(weights[1, :, 0], pressed)

    return number, at, along


def difference(of, at, along) -> float:
    """Of a number, by so much of a direction."""
    ends = [of(*(x + h * d for x, d in zip(at, along))) for h in (1e-7, -1e-7)]
    return (ends[0] - ends[1]) / 2e-7


HILLS = bumps(0.05, 0.6, seed=1)


@pytest.mark.parametrize(
    ("ground", "friction", "tolerance"),
    [
        pytest.param(ExactGround(0.3, restitution=0.5), ConeFriction(0.1), None, marks=pytest.mark.campaign),
        pytest.param(ExactGround(), ConeFriction(0.1), 1e-10, marks=pytest.mark.campaign),
        (ExactGround(restitution=0.5), None, None),
        pytest.param(ExactGround(surface=HILLS), ConeFriction(0.1), None, marks=pytest.mark.campaign),
    ],
    ids=["incline and restitution", "with a tolerance", "restitution", "bumps"],
)
def test_derivatives_of_sweeps_are_those_of_each_in_turn(exact, ground, friction, tolerance):
    """Where they end they have forgotten where they began: eight, differentiated one by one, have the same.

    And so have differences; with respect to positions, velocities, masses and the lengths of struts, in both modes.
    """
    number, at, along = after_a_step(exact, ground, friction)
    ends = partial(number, partial(converged, tolerance=tolerance))
    slopes = [jax.jit(jax.grad(of, argnums=(0, 1, 2, 3)))(*at) for of in (partial(number, one_by_one), ends)]
    assert all(np.abs(slope).max() > 1e-2 for slope in slopes[0])
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9), *slopes)
    expected = sum(np.vdot(x, y) for x, y in zip(along, slopes[0]))
    forward = jax.jit(lambda *at: jax.jvp(ends, at, along))
    np.testing.assert_allclose(forward(*at)[1], expected, rtol=1e-9)
    np.testing.assert_allclose(difference(lambda *at: forward(*at)[0], at, along), expected, rtol=1e-5)


@pytest.mark.campaign
def test_derivatives_of_sweeps_on_a_surface_agree_with_differences(exact):
    """In a bowl, where normals turn with the nodes, and with a tolerance."""
    ground = ExactGround(surface=Sphere(np.array([0.0, 0, 3]), 3.0, hollow=True))
    number, at, along = after_a_step(exact, ground, ConeFriction(0.1))
    ends = jax.jit(jax.value_and_grad(partial(number, partial(converged, tolerance=1e-10)), argnums=(0, 1, 2, 3)))
    slopes = ends(*at)[1]
    assert all(np.abs(slope).max() > 1e-2 for slope in slopes)
    expected = sum(np.vdot(x, y) for x, y in zip(along, slopes))
    np.testing.assert_allclose(difference(lambda *at: ends(*at)[0], at, along), expected, rtol=1e-5)


def test_the_derivative_is_right_where_a_light_end_sticks():
    """There sweeps take the strut for held at both ends, and need thousands: differences agree all the same."""
    angle, masses = 1.2, np.array([1 / 120, 1.0])
    nodes = jnp.array([[0.0, 0, 0], [np.cos(angle), 0, np.sin(angle)]])
    struts = Members(((0, 1),), None, np.ones(1))
    scene = as_dtype(Scene(Structure(nodes, masses, struts), G, None, ExactGround(), ConeFriction(0.5)), "float64")
    v = jnp.array([[0.0, 0, 0], [-0.3 * np.sin(angle), 0.1, 0.3 * np.cos(angle)]]) - jnp.array([0.0, 0, 2e-3 * G])

    def after(factor):
        problem = step_problem(scene, 2e-3, 2e-3, nodes, factor * v)
        trials = converged(scene, problem, trials_of(scene, factor * v), 3000)
        assert traced(trials) or float(length_error(scene, 2e-3, problem, trials).relative) < 1e-12
        return velocities(scene, problem, trials)

    slope = jax.jvp(after, (1.0,), (1.0,))[1]
    moved = [after(1.0 + h) for h in (1e-6, -1e-6)]
    assert np.abs(slope).max() > 0.1
    np.testing.assert_allclose(slope, (moved[0] - moved[1]) / 2e-6, rtol=1e-5, atol=1e-6)


def test_struts_do_not_turn_around():
    """Where forces alone would carry its ends past each other within a step, a strut keeps length and side."""
    struts = Members(((0, 1),), None, np.ones(1))
    scene = as_dtype(Scene(Structure(np.array([[0.0, 0, 0], [1, 0, 0]]), np.ones(2), struts)), "float64")
    q, w = scene.structure.nodes, jnp.array([[30.0, 1, 0], [-30, 0, 0]])
    problem = step_problem(scene, 0.1, 0.1, q, w)
    ends = q + 0.1 * velocities(scene, problem, sweep(scene, problem, trials_of(scene, w)))
    np.testing.assert_allclose(ends[1] - ends[0], [np.sqrt(1 - 0.01), -0.1, 0], rtol=0, atol=1e-15)


@pytest.mark.slow
def test_lost_struts_are_a_failure(exact):
    """At a step ten times the default the sweeps leave struts more than 0.1 % off: that is no result, and says so.

    In as many frames as the roll, whose program it shares.
    """
    motion = simulate(exact, 25.0, frame_rate=200.0, options=SolverOptions(dt=5e-2, any_step=True))
    assert FAILURES[int(motion.failure)] == "the motion is not finite, or misses its constraints"


def test_sweeps_and_tolerances_that_make_no_sense_are_refused(exact, reference):
    """In one line, before anything compiles."""
    with pytest.raises(InputError, match="sweeps = 0: expected a whole number, at least 1"):
        simulate(exact, 1.0, options=SolverOptions(sweeps=0))
    with pytest.raises(InputError, match="strut_tolerance = 1e-10 m: expected at least 1e-05 m in float32"):
        simulate(exact, 1.0, options=SolverOptions(strut_tolerance=1e-10, dtype="float32"))
    with pytest.raises(InputError, match="only complementarity stepping has them, not 'rk4'"):
        simulate(reference, 1.0, options=SolverOptions(strut_tolerance=1e-10))


@pytest.mark.campaign
def test_the_robot_rolls_as_far_in_a_population(exact, rolling):
    """The swept loop gives the same answers for one robot and for many."""
    phases = exact.gait.phase + 0.5 * np.arange(8)[:, None]
    outcomes = simulate_population(exact, gaits_of(exact.gait, phases), 10.0)
    mean = np.asarray(rolling.positions[2000]).mean(0)
    np.testing.assert_allclose(outcomes.com_end[0], mean, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_first_order_in_the_step(exact):
    """8 random gaits at 4 s: 5 ms is within 2 mm (median) of 0.25 ms, 1 ms within 0.4 mm, and so on in proportion."""
    gaits = gaits_of(exact.gait, random_phases(8, 6, seed=0))
    steps = (5e-3, 2.5e-3, 1e-3, 2.5e-4)
    ends = [np.asarray(simulate_population(exact, gaits, 4.0, options=SolverOptions(dt=dt)).com_end) for dt in steps]
    errors = [np.median(np.linalg.norm(end - ends[-1], axis=1)) for end in ends[:-1]]
    assert errors[0] < 2e-3
    assert errors[2] < 4e-4
    order = np.polyfit(np.log(steps[:-1]), np.log(errors), 1)[0]
    assert 0.75 < order < 1.5


@pytest.mark.parametrize("dt", [1e-3, 1e-2])
def test_a_block_sticks_below_the_friction_angle(dt):
    """It moves less than 1e-12 m in 10 s, a thousandth below the angle."""
    scene = block(np.arctan(0.5) * 0.999, mu=0.5)
    trajectory = simulate(scene, 10.0, options=SolverOptions(dt=dt))
    assert np.abs(trajectory.positions - trajectory.positions[0]).max() < 1e-12


@pytest.mark.slow
def test_a_block_slides_above_the_friction_angle():
    """Its distance is exact, g (sin - mu cos) t^2/2; so is its velocity in the middle of the last step."""
    angle, dt = np.arctan(0.5) * 1.2, 1e-3
    rate = G * (np.sin(angle) - 0.5 * np.cos(angle))
    scene = block(angle, mu=0.5)
    trajectory = simulate(scene, 2.0, options=SolverOptions(dt=dt))
    downhill = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    assert velocities_midway(scene, trajectory)[-1, 0] @ downhill == pytest.approx((2.0 - dt / 2) * rate, rel=1e-9)
    assert np.asarray(trajectory.positions[-1, 0]) @ downhill == pytest.approx(rate / 2 * 2.0**2, rel=1e-9)


@pytest.mark.slow
def test_slip_depends_on_friction_as_it_should():
    """The derivative of a sliding block's distance by mu is -g cos(theta) t^2/2, exactly."""
    angle, dt = 0.6, 1e-3
    scene = as_dtype(block(angle, mu=0.3), "float64")
    options = resolve(scene, 1.0, SolverOptions(dt=dt))

    def distance(mu):
        changed = eqx.tree_at(lambda s: s.friction.mu, scene, mu)
        start = (changed.structure.nodes, jnp.zeros((1, 3)))
        end = integrate(start, jnp.array([0.0, 1.0]), changed, options).ys[0][-1, 0]
        return end[0] * jnp.cos(angle) - end[2] * jnp.sin(angle)

    slope = jax.jvp(distance, (jnp.array(0.3),), (jnp.array(1.0),))[1]
    assert float(slope) == pytest.approx(-G * np.cos(angle) / 2, rel=1e-9)


@pytest.mark.campaign
def test_reverse_mode_works_with_a_tolerance_of_struts():
    """Though the number of sweeps depends on the state then: a strut slides on one end, and falls over."""
    nodes = np.array([[0.0, 0, 0], [0.5, 0.2, np.sqrt(1 - 0.5**2 - 0.2**2)]])
    scene = Scene(Structure(nodes, np.ones(2), Members(((0, 1),), None, np.ones(1))), G, None, ExactGround())
    scene = as_dtype(dataclasses.replace(scene, friction=ConeFriction(0.2)), "float64")
    options = resolve(scene, 0.2, SolverOptions(dt=5e-3, dtype="float64", strut_tolerance=1e-10))

    def place(mu):
        return final_state(eqx.tree_at(lambda s: s.friction.mu, scene, mu), 0.2, options)[0][:, :2].sum()

    with_reverse = jax.jit(jax.value_and_grad(place))
    reverse, forward = float(with_reverse(0.2)[1]), float(jax.jit(jax.jacfwd(place))(0.2))
    moved = [float(with_reverse(0.2 + h)[0]) for h in (1e-6, -1e-6)]
    assert abs(forward) > 1e-4
    assert reverse == pytest.approx(forward, rel=1e-9)
    assert forward == pytest.approx((moved[0] - moved[1]) / 2e-6, rel=1e-4)


@pytest.mark.slow
def test_derivatives_are_finite_at_rest():
    """A block that lies still on level ground, its slip exactly zero, has derivatives, and they are zero."""
    scene = as_dtype(block(0.0, mu=0.3), "float64")
    options = resolve(scene, 0.1, SolverOptions(dt=1e-2))

    def end(mu):
        changed = eqx.tree_at(lambda s: s.friction.mu, scene, mu)
        start = (changed.structure.nodes, jnp.zeros((1, 3)))
        return integrate(start, jnp.array([0.0, 0.1]), changed, options).ys[0][-1, 0]

    np.testing.assert_array_equal(jax.jvp(end, (jnp.array(0.3),), (jnp.array(1.0),))[1], 0.0)


@pytest.mark.parametrize("restitution", [None, 0.0, 0.5, 1.0])
def test_restitution(restitution):
    """A ball dropped from 0.5 m leaves the ground at e times the speed at which it came; without e it stays."""
    trajectory = simulate(
        block(0.0, restitution=restitution, height=0.5), 0.5, frame_rate=1000.0, options=SolverOptions(dt=1e-4)
    )
    speed = np.asarray(trajectory.velocities[:, 0, 2])
    impact = int(np.argmin(speed))
    leaving = speed[impact + 2] + 2e-3 * G
    assert leaving == pytest.approx((restitution or 0.0) * -speed[impact], abs=2.5e-2)


@pytest.mark.slow
def test_a_settled_robot_stays(exact):
    """By a gait that moves nothing: it comes to rest, and then moves less than 1e-9 m in a minute."""
    still = dataclasses.replace(exact.gait, amplitude=np.zeros(6))
    trajectory = simulate(with_gait(exact, still), 90.0, frame_rate=10.0)
    settled = np.asarray(trajectory.positions[300:])
    assert np.abs(settled - settled[0]).max() < 1e-9


@pytest.mark.campaign
def test_struts_that_share_nodes_keep_their_lengths():
    """A rigid triangle falls on one corner and tips over: three struts, each sharing both its nodes."""
    text = """
    [structure]
    kind = "custom"
    nodes = [[0, 0, 0.5], [1, 0, 1.0], [0.2, 1, 1.2]]
    struts = [[0, 1], [1, 2], [2, 0]]
    mass = 3.0
    [struts]
    rigid = true
    [gravity]
    [ground]
    contact = "complementarity"
    [friction]
    kind = "cone"
    mu = 0.4
    """
    scene = parse_scene(text)
    edges = scene.structure.struts.edges
    assert disjoint_groups(edges) == ((0,), (1,), (2,))
    trajectory = simulate(scene, 2.0, options=SolverOptions(dt=1e-3))
    for q in np.asarray(trajectory.positions)[::10]:
        np.testing.assert_allclose(edge_lengths(q, edges), edge_lengths(scene.structure.nodes, edges), atol=1e-5)
    assert trajectory.positions[..., 2].min() > -1e-12
    assert np.ptp(np.asarray(trajectory.positions[-1, :, 2])) < 1e-3


@pytest.mark.slow
def test_agrees_with_an_independent_program(exact):
    """Converged answers of a C program written for nothing else, whose steps and sweeps go another way."""

    answers = json.loads((Path(__file__).parents[1] / "data" / "exact_answers.json").read_text())
    gaits = gaits_of(exact.gait, np.array([row["phase"] for row in answers["gaits"]]))
    outcomes = simulate_population(exact, gaits, answers["duration"], options=SolverOptions(dt=2e-4))
    expected = np.array([row["com_end"] for row in answers["gaits"]])
    np.testing.assert_allclose(outcomes.com_end, expected, rtol=0, atol=1e-5)


@pytest.mark.slow
def test_verify_knows_the_scene(exact):
    """Error bars come from the same halving of steps."""
    gaits = gaits_of(exact.gait, random_phases(8, 6, seed=1))
    verified = verify(exact, gaits, 3.0, options=SolverOptions(dt=5e-3))
    finer = simulate_population(exact, gaits, 3.0, options=SolverOptions(dt=2e-4))
    assert np.all(np.linalg.norm(verified.com_end - finer.com_end, axis=1) <= verified.error_bar)


def test_other_methods_are_refused(exact):
    """Only complementarity stepping meets constraints; penalty friction does not go with exact contact."""
    with pytest.raises(InputError, match="expected 'complementarity'"):
        simulate(exact, 1.0, options=SolverOptions(method="rk4"))
    text = scene_text("exact").replace('kind = "cone"', 'kind = "smooth"\nslip_speed = 0.01')
    with pytest.raises(InputError, match="a cone with exact contact"):
        parse_scene(text)

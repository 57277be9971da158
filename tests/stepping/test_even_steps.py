"""Durations that are no multiple of the step: complementarity stepping takes shorter ones, all alike."""

import jax
import jax.numpy as jnp
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
    final_state,
    gaits_of,
    rollout,
    simulate,
    simulate_population,
)
from jaxgrity.stepping import resolve
from jaxgrity.stepping.discretisation import even_step
from jaxgrity.stepping.simulate import velocities_midway
from jaxgrity.trust.trust_report import _strut_strain

G, DT = 9.81, 0.02
DURATIONS = [0.5, 0.51, 0.23, 0.004]


def resting() -> Scene:
    """A rigid strut that lies on the ground."""
    struts = Members(((0, 1),), None, [1.0])
    return Scene(Structure([[0.0, 0, 0], [1, 0, 0]], [1.0, 2.0], struts), G, ground=ExactGround())


@pytest.mark.parametrize("duration", DURATIONS)
def test_what_rests_does_not_move_midway(duration):
    """The half step that frames are later than their velocities is that of the steps that were taken."""
    moving = np.full((2, 3), [1e-3, 0, 0])
    motion = simulate(resting(), duration, options=SolverOptions(dt=DT), frame_rate=200.0, velocities=moving)
    midway = velocities_midway(resting(), motion)[motion.times > (1 - 1e-9) * motion.dt]
    assert len(midway) > 0
    np.testing.assert_allclose(midway[:, :, 2], 0, atol=1e-12)
    np.testing.assert_allclose(motion.positions[:, :, 2], 0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "duration", [pytest.param(each, marks=[pytest.mark.campaign] * (each in (0.5, 0.23))) for each in DURATIONS]
)
def test_one_robot_and_many_take_the_same_steps(duration):
    """And so does the pure rollout; the step that was taken is told."""
    structure = Structure([[0, 0, 0.2], [0.6, 0, 1.0]], [1.0, 2.0], Members(((0, 1),), None, [1.0]))
    scene = Scene(structure, G, ground=ExactGround(), gait=Gait((0,), [0.0], [0.0], [1.0]))
    options = SolverOptions(dt=DT)
    one = simulate(scene, duration, options=options)
    many = simulate_population(scene, gaits_of(scene.gait, np.zeros((2, 1))), duration, options=options)
    np.testing.assert_allclose(many.positions[0], one.positions[-1], rtol=0, atol=1e-12)
    rolled = rollout(scene, np.array([0.0, duration]), options=options)
    np.testing.assert_allclose(rolled.positions[-1], one.positions[-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(rolled.velocities[-1], one.velocities[-1], rtol=0, atol=1e-10)
    assert one.dt * int(one.steps) == pytest.approx(duration, rel=1e-12)
    assert one.dt <= DT


def test_a_strut_keeps_its_length_in_reports_too():
    """A rod that turns, in frames that fall on ends of steps and in others."""
    structure = Structure([[0, 0, 0], [1, 0, 0]], [1.0, 1.0], Members(((0, 1),), None, [1.0]))
    scene, spun = Scene(structure), np.array([[0.0, -2, 0], [0, 2, 0]])
    motion = simulate(scene, 1.005, options=SolverOptions(dt=0.01), frame_rate=200.0, velocities=spun)
    assert _strut_strain(scene, motion) < 1e-12


def test_the_longest_step_that_divides_a_time():
    """Where the one that is asked for does, it is that one to the last bit."""
    for dt, duration, step in ((0.1, 1.0, 0.1), (0.1, 0.3, 0.1), (0.1, 0.25, 0.25 / 3), (0.1, 0.05, 0.05)):
        assert float(even_step(np.asarray(dt), np.asarray(duration))) == pytest.approx(step, rel=1e-15)
    assert float(even_step(np.asarray(0.005), np.asarray(0.3))) == 0.005


@pytest.mark.parametrize("duration", [0.0, -0.1, np.nan])
def test_a_final_state_lies_ahead(duration):
    scene = resting()
    with pytest.raises(InputError, match=r"^duration = .* s: expected a positive number"):
        final_state(scene, duration, resolve(scene, 1.0))


def test_a_traced_start_that_moves_a_support_is_not_ok():
    """A known one is refused."""
    structure = Structure([[0, 0, 0], [0, 0, -1.0]], [1.0, 1.0], Members(((0, 1),), None, [1.0]), fixed=((0, "xyz"),))
    scene = Scene(structure, G)
    options = resolve(scene, 0.1)
    times = np.array([0.0, 0.1])

    def ok(v):
        return rollout(scene, times, start=(jnp.asarray(structure.nodes), v), options=options).ok

    still = jnp.zeros((2, 3))
    assert jax.jit(ok)(still)
    assert not jax.jit(ok)(still.at[0, 0].set(1.0))
    with pytest.raises(InputError, match="expected 0 where the node is fixed"):
        rollout(scene, times, start=(structure.nodes, np.ones((2, 3))), options=options)


def test_rounding_makes_no_step_more():
    """In either precision a duration of whole steps has as many."""
    for dtype in (np.float32, np.float64):
        for steps in (3, 60, 4001):
            step, duration = np.asarray(5e-3, dtype), np.asarray(5e-3 * steps, dtype)
            assert even_step(step, duration) == step

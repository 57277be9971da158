"""Derivatives of rollouts: forward mode, reverse mode and differences agree for every array of a scene."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from studies.leaf_gradients import CASES, compared

from jaxgrity import ConeFriction, ExactGround, Members, PenaltyGround, Scene, SolverOptions, Structure, final_state
from jaxgrity.model.scene import as_dtype
from jaxgrity.stepping import resolve, states_at

# Both contact models, supports, every number of a gait, and a shape at rest; whole robots show nothing more.
SMALL = ["tripod slides, exact", "chain at rest"]


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=name, marks=pytest.mark.slow if name in SMALL else pytest.mark.campaign)
        for name, case in CASES.items()
    ],
)
def test_forward_and_reverse_mode_agree_with_differences_for_every_leaf(case):
    """To 1e-6, of the derivative where that is above 1; at least half of them matter, and rest lengths do.

    The shape of a robot at rest that floats depends neither on masses, damping and velocities nor on when a gait began.
    """
    rows = compared(case)
    for row in rows:
        assert row["reverse"] < 1e-8, row
        assert row["differences"] < 1e-6, row
    matter = {row["leaf"] for row in rows if row["derivative"] != 0}
    assert len(matter) >= len(rows) / 2
    rest_lengths = {row["leaf"] for row in rows if row["leaf"].endswith("rest_length")}
    assert rest_lengths
    assert rest_lengths <= matter


def ball(height: float, exact: bool = False) -> Scene:
    """A point mass of 1 kg above the ground."""
    ground = ExactGround() if exact else PenaltyGround(1e4)
    friction = ConeFriction(0.0) if exact else None
    return Scene(Structure([[0.0, 0, height]], [1.0]), gravity=9.81, ground=ground, friction=friction)


def derivatives(of) -> Callable:
    """One program for the value, and the derivative by forward and by reverse mode."""

    @jax.jit
    def found(x):
        return *jax.jvp(of, (x,), (jnp.ones_like(x),)), jax.grad(of)(x)

    return lambda x: tuple(map(float, found(x)))


def test_at_the_corner_of_a_force_the_slack_side_is_returned():
    """A node that just touches, and a cable at its rest length: one step of either, started there at rest."""

    def pressed(depth):
        there = eqx.tree_at(lambda s: s.structure.nodes, ball(0.0), jnp.array([[0.0, 0.0, -1.0]]) * depth)
        return there.potential_energy(there.structure.nodes, 0.0)

    stiffness = derivatives(jax.grad(pressed))
    assert stiffness(0.0)[1:] == (0.0, 0.0)  # gravity's force is constant; the slack side of 1e4
    assert stiffness(1e-9)[1:] == (1e4, 1e4)
    cable = Members(((0, 1),), [500.0], [1.0])
    held = Scene(Structure([[0.0, 0, 0], [1.0, 0, 0]], [1.0, 1.0], cables=cable))

    def pull(x):
        return held.potential_energy(jnp.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]) * x, 0.0)

    stiffness = derivatives(jax.grad(pull))
    assert stiffness(1.0)[1:] == (0.0, 0.0)
    np.testing.assert_allclose(stiffness(1 + 1e-9)[1:], 500.0, rtol=1e-6)


def test_through_a_bounce_the_derivative_is_that_of_the_motion():
    """Penalty contact that is made and lost at single times: the derivative agrees with differences.

    A ball that is thrown up faster is higher later, one that is thrown down faster too, once it has bounced.
    """
    scene = ball(0.02)
    options = resolve(scene, 0.2, SolverOptions("rk4", dt=1e-4))

    def height(v):
        start = (jnp.array([[0.0, 0.0, 0.02]]), jnp.array([[0.0, 0.0, 1.0]]) * v)
        return final_state(scene, 0.12, options, start)[0][0, 2]

    found = derivatives(height)
    _, forward, reverse = found(-0.5)
    moved = [found(-0.5 + h)[0] for h in (1e-4, -1e-4)]
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)
    assert forward < -0.01
    np.testing.assert_allclose(forward, (moved[0] - moved[1]) / 2e-4, rtol=1e-3)


def test_through_an_exact_landing_the_derivative_is_that_of_the_motion():
    """A point that falls and stays, thrown along x with nothing that slows it.

    Where it ends is x = v t, and its height is 0 from the impact on, whatever it fell from.
    """
    scene = ball(0.02, exact=True)
    options = resolve(scene, 0.2, SolverOptions(dt=1e-3))

    def end(v):
        start = (jnp.array([[0.0, 0.0, 0.02]]), jnp.array([[1.0, 0.0, 0.0]]) * v)
        return final_state(scene, 0.1, options, start)[0][0]

    np.testing.assert_allclose(jax.jit(jax.jacfwd(end))(0.5), [0.1, 0, 0], atol=1e-9)

    def landed(height):
        start = (jnp.array([[0.0, 0.0, 1.0]]) * height, jnp.zeros((1, 3)))
        return final_state(scene, 0.1, options, start)[0][0, 2]

    assert derivatives(landed)(0.02) == (0.0, 0.0, 0.0)


@pytest.mark.slow
def test_sweeps_are_not_run_again_step_by_step():
    """On the way back each stretch is run again, and then its steps once more, which know what sweeps found."""
    strut = Members(((0, 1),), None, [1.0])
    structure = Structure([[0.0, 0, 0], [0.6, 0, 0.8]], [1.0, 1.0], strut)
    scene = as_dtype(Scene(structure, 9.81, ground=ExactGround(), friction=ConeFriction(0.2)), "float64")
    options = resolve(scene, 0.06, SolverOptions(dt=5e-3, sweeps=7))

    def height(g):
        return final_state(eqx.tree_at(lambda s: s.gravity, scene, g), 0.06, options)[0][0, 2]

    compiled = jax.jit(jax.grad(height)).lower(scene.gravity).compile().as_text()
    assert compiled.count('"known_trip_count":{"n":"7"}') == 2


def test_states_at_frames_are_those_of_single_rollouts():
    """By the same steps: at frames that are not alike, from a start that is not at rest."""
    case = CASES["tripod slides, penalty"]
    scene, times = case.make(), np.array([0.0, 0.01, 0.015])
    q = np.asarray(scene.structure.nodes)
    start = (q, np.broadcast_to(case.velocity, q.shape))
    options = resolve(scene, 0.01, SolverOptions("rk4", dt=5e-4))
    positions, velocities = jax.jit(lambda: states_at(scene, start, times, 20, options))()
    twenty = jax.jit(lambda duration, start: final_state(scene, duration, options, start, steps=20))
    np.testing.assert_allclose(positions[0], q)
    halfway = twenty(0.01, start)
    np.testing.assert_allclose(positions[1], halfway[0], rtol=1e-12)
    end = twenty(0.005, halfway)
    np.testing.assert_allclose(positions[2], end[0], rtol=1e-12)
    np.testing.assert_allclose(velocities[2], end[1], rtol=1e-9)

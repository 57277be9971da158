"""What a rollout returns can be handed back: the motion in pieces is the motion in one piece, to rounding."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import class_2, swept

from jaxgrity import (
    Differences,
    ExactGround,
    Members,
    Scene,
    Shaking,
    SolverOptions,
    Sphere,
    Structure,
    final_state,
    gaits_of,
    rollout,
    simulate,
    simulate_population,
    wind,
    with_terms,
)
from jaxgrity.stepping import resolve, velocities_midway
from jaxgrity.stepping.dynamics import acceleration
from jaxgrity.stepping.frame_velocities import velocity_at

STEPS, DT = 120, 5e-3
ALL = {
    "swept": (swept(), None),
    "in the air": (swept(ground=False), None),
    "class 2": (class_2(), None),
    "with restitution": (eqx.tree_at(lambda s: s.ground.restitution, swept(), 0.5, is_leaf=lambda x: x is None), None),
    "rk4": (swept(stiff=False), "rk4"),
    "tsit5": (swept(stiff=False), "tsit5"),
    "verlet": (dataclasses.replace(swept(stiff=False, ground=False), node_damping=None), "verlet"),
}
BOWL = Sphere([0.0, 0.0, 1.0], 1.0, hollow=True)
SWINGING = Structure([[np.sin(1.0), 0, 1 - np.cos(1.0)]], [1.0])
ALL["in a bowl"] = Scene(SWINGING, 9.81, ground=ExactGround(surface=BOWL)), None
HANGING = np.array([[0.0, 0, 2], [0.3, 0, 1], [0.3, 0.2, 0.5]])
SHAKEN = Structure(
    HANGING,
    [0.0, 1.0, 0.5],
    Members(((0, 1),), None, [np.sqrt(1.09)], mass=[1.0]),
    Members(((0, 2), (1, 2)), [300.0, 300.0], [0.9, 0.5], damping=[5.0, 5.0]),
    fixed=((0, "xyz"),),
)
ALL["shaken"] = Scene(SHAKEN, 9.81, shaking=Shaking([0.05, 0, 0], 2.0, ramp=0.3)), None
undamped = eqx.tree_at(
    lambda s: (s.structure.struts.damping, s.structure.cables.damping), ALL["verlet"][0], (None, None)
)
ALL["verlet"] = undamped, "verlet"


MARKS = {"swept": (), "in a bowl": pytest.mark.slow}
"""of those cut into single steps"""


def in_pieces(scene: Scene, options, pieces: int):
    """(q, v) after all steps, in so many pieces."""
    times, state, each = options.dt * np.arange(STEPS + 1), None, STEPS // pieces
    for k in range(0, STEPS, each):
        rolled = rollout(scene, times[[k, k + each]], start=state, options=options, steps=each)
        assert rolled.ok
        state = rolled.positions[-1], rolled.velocities[-1]
    return state


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "pieces"),
    [
        pytest.param(
            name, pieces, marks=MARKS.get(name, pytest.mark.campaign) if pieces == STEPS else pytest.mark.campaign
        )
        for name in ALL
        for pieces in (STEPS, 2, 10)
    ],
)
def test_a_motion_in_pieces_is_that_in_one_piece(name, pieces):
    """With and without contact, with dampers, gaits, shared nodes, restitution and moving supports, by every method of
    fixed steps.

    In a bowl each step ends a little below the ground: by 2e-6 m, and starts there again.
    """
    scene, method = ALL[name]
    options = resolve(scene, 1.0, SolverOptions(method, dt=DT if method is None else 1e-3))
    q, v = in_pieces(scene, options, 1)
    assert np.abs(v).max() > 0.1
    again = in_pieces(scene, options, pieces)
    np.testing.assert_allclose(again[0], q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(again[1], v, rtol=0, atol=1e-10)


def rod(height: float = 10.0) -> Scene:
    """A rigid strut that falls."""
    nodes = np.array([[0.0, 0, height], [1.0, 0, height]])
    return Scene(Structure(nodes, [1.0, 1.0], Members(((0, 1),), None, [1.0])), gravity=9.81)


def test_free_fall_in_steps_is_free_fall():
    """By `final_state` in calls of one step each, for 1 s: 4.905 m, and 9.81 m/s."""
    scene = rod()
    options = resolve(scene, 1.0, SolverOptions(dt=DT))

    @jax.jit
    def fall():
        start = (jnp.asarray(scene.structure.nodes), jnp.zeros((2, 3)))
        step = lambda state, _: (final_state(scene, DT, options, state), None)  # noqa: E731
        return jax.lax.scan(step, start, length=200)[0]

    q, v = fall()
    np.testing.assert_allclose(10 - q[:, 2], 9.81 / 2, rtol=1e-12)
    np.testing.assert_allclose(v[:, 2], -9.81, rtol=1e-12)


def test_frames_of_simulate_are_starts_also_between_steps():
    """Velocities are those at the times of the frames: exact in free fall, also where the step does not divide it."""
    options = SolverOptions(dt=0.01)
    motion = simulate(rod(), 0.255, options=options, frame_rate=400.0)
    np.testing.assert_allclose(motion.velocities[:, 0, 2], -9.81 * motion.times, rtol=0, atol=1e-12)
    whole = simulate(rod(), 0.3, options=options, frame_rate=10.0)
    again = simulate(
        rod(), 0.2, options=options, frame_rate=10.0, positions=whole.positions[1], velocities=whole.velocities[1]
    )
    np.testing.assert_allclose(again.positions, whole.positions[1:], rtol=0, atol=1e-13)
    np.testing.assert_allclose(again.velocities, whole.velocities[1:], rtol=0, atol=1e-13)


@pytest.mark.campaign
def test_robots_of_a_population_go_on_where_others_stopped():
    """Each from a state of its own, one of them at rest, as `simulate` goes on from there."""
    scene = dataclasses.replace(swept(), gait=dataclasses.replace(swept().gait, start=np.array(5.0)))
    options = SolverOptions(dt=DT)
    first = simulate(scene, 0.3, options=options, frame_rate=10.0)
    starts = Differences(positions=first.positions, velocities=first.velocities)
    gaits = gaits_of(scene.gait, np.repeat(scene.gait.phase[None], 4, axis=0))
    ends = simulate_population(scene, gaits, 0.2, options=options, differences=starts).positions
    for k in range(4):
        start = {"positions": first.positions[k], "velocities": first.velocities[k]}
        alone = simulate(scene, 0.2, options=options, frame_rate=10.0, **start)
        np.testing.assert_allclose(ends[k], alone.positions[-1], rtol=0, atol=1e-12)


def test_velocities_midway_are_those_that_contact_lets_pass():
    """A rod that lies on the ground has -g h/2 at each frame after the first, and does not move in between."""
    lying = dataclasses.replace(rod(0.0), ground=swept().ground, friction=swept().friction)
    motion = simulate(lying, 0.1, options=SolverOptions(dt=DT))
    np.testing.assert_allclose(motion.velocities[1:, :, 2], -9.81 * DT / 2, rtol=1e-12)
    np.testing.assert_array_equal(motion.velocities[0], 0)
    np.testing.assert_allclose(velocities_midway(lying, motion), 0, atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("damping", [1.0, 1e3, 1e6])
def test_the_velocity_at_the_end_solves_its_equation(damping):
    """v = w + h/2 a(q, v), however strong dampers are, and where wind makes it nonlinear; masses differ."""
    windy = with_terms(swept(), wind([3.0, 0, 0], 0.2, nodes=3))
    scene = eqx.tree_at(lambda s: s.structure.cables.damping, windy, np.full(2, damping))
    q, w = jnp.asarray(scene.structure.nodes), jnp.asarray(np.random.default_rng(0).normal(size=(3, 3)))
    v = velocity_at(scene, 0.1, q, w, 2.5e-3)
    force = 2.5e-3 * acceleration(scene, 0.1, q, v)
    missed = np.abs(w + force - v).max()
    assert missed < 1e-14 * (1 + damping)  # rounding of the dampers' force


@pytest.mark.campaign
@pytest.mark.parametrize("mode", [jax.jacfwd, jax.grad])
def test_derivatives_through_pieces_agree_with_differences(mode):
    """Of the velocity after three calls."""
    scene = swept()
    options = resolve(scene, 1.0, SolverOptions(dt=DT))

    @jax.jit
    def speed(damping):
        there = eqx.tree_at(lambda s: s.structure.cables.damping, scene, jnp.full(2, damping))
        piece = lambda state, k: (final_state(there, 4 * DT, options, state, since=4 * k * DT), None)  # noqa: E731
        start = jnp.asarray(scene.structure.nodes), jnp.zeros((3, 3))
        return jax.lax.scan(piece, start, jnp.arange(3))[0][1][2] @ jnp.array([1.0, 2.0, 3.0])

    difference = (speed(5.0 + 1e-4) - speed(5.0 - 1e-4)) / 2e-4
    assert abs(difference) > 1e-3
    np.testing.assert_allclose(mode(speed)(5.0), difference, rtol=1e-6)

"""Forces of the ground, of supports and of struts, against weights, and against the change of momentum."""

import dataclasses

import numpy as np
import pytest

import jaxgrity
from jaxgrity import (
    ConeFriction,
    ExactGround,
    Gait,
    Members,
    PenaltyGround,
    Scene,
    Slope,
    SmoothFriction,
    SolverOptions,
    Structure,
)
from jaxgrity.stepping.methods import find_method

G = 9.81
STEP = 5e-3
"""s"""


def rod(ends, node_mass, mass=None, stiffness=None, **parts) -> Structure:
    """One strut between two nodes, rigid where no stiffness is given."""
    ends = np.asarray(ends, float)
    length = np.linalg.norm(ends[1] - ends[0])
    given = {} if stiffness is None else {"damping": [200.0]}
    stiff, own = (None if x is None else [x] for x in (stiffness, mass))
    return Structure(ends, node_mass, Members(((0, 1),), stiff, [length], mass=own, **given), **parts)


def exact(structure: Structure, **parts) -> Scene:
    return Scene(structure, G, friction=ConeFriction(0.4), **{"ground": ExactGround(), **parts})


def unbalanced(scene: Scene, motion, forces) -> np.ndarray:
    """N s, (3,): the change of momentum, less what weight, ground and supports did in the meantime.

    Velocities are those in the middle of a step: of a start at rest the first step acts on them for half of its time.
    """
    mass, t = np.asarray(scene.structure.lumped_mass), np.asarray(motion.times, float)
    if not np.any(motion.velocities[0]):
        t = t - np.minimum(t, motion.dt) / 2
    momentum = np.einsum("n,fnk->fk", mass, jaxgrity.stepping.velocities_midway(scene, motion))
    outside = (forces.ground + forces.supports).sum(1) - [0, 0, mass.sum() * G]
    return momentum[-1] - momentum[0] - (np.diff(t)[:, None] * outside[:-1]).sum(0)


FLAT = [[0, 0, 0], [1.0, 0, 0]]
TILTED = [[0, 0, 0.1], [0.9, 0, 0.4]]
THROWN = np.array([[1.0, 0.3, -1.0], [1.0, -0.4, 0.5]])
"""m/s"""


@pytest.mark.campaign
def test_the_ground_carries_rods_with_mass_at_both_ends():
    """2 kg lie flat: 9.81 N at each end, however the mass is shared between nodes and rod."""
    for node_mass, mass in (([0.0, 0.0], 2.0), ([0.5, 0.5], 1.0), ([1.0, 1.0], 0.0)):
        scene = exact(rod(FLAT, node_mass, mass))
        motion = jaxgrity.simulate(scene, 0.1, options=SolverOptions(dt=STEP))
        forces = jaxgrity.forces_along(scene, motion)
        np.testing.assert_allclose(forces.ground[-1], [[0, 0, G], [0, 0, G]], atol=1e-9)
        assert not forces.supports.any()


@pytest.mark.parametrize("frame_rate", [50.0, 200.0, 130.0, 700.0])
@pytest.mark.slow
def test_impacts_and_sliding_of_a_rod_balance_its_momentum(frame_rate):
    """Of frames with several steps between them, with one, with frames between steps, and with several in a step."""
    scene = exact(rod(TILTED, [0.2, 0.3], 1.5))
    options = SolverOptions(dt=STEP)
    motion = jaxgrity.simulate(scene, 0.3, options=options, velocities=THROWN, frame_rate=frame_rate)
    forces = jaxgrity.forces_along(scene, motion)
    assert (forces.ground[..., 2] > 100).any()
    assert not forces.ground[0].any()
    np.testing.assert_allclose(unbalanced(scene, motion, forces), 0, atol=1e-6)


def test_forces_on_ground_of_any_shape_balance_the_momentum():
    """On a slope that is a surface: at each node along its own normal, and in its cone."""
    ground = ExactGround(surface=Slope(0.2))
    scene = exact(rod(TILTED, [0.7, 1.3]), ground=ground)
    motion = jaxgrity.simulate(scene, 0.3, options=SolverOptions(dt=STEP), velocities=THROWN)
    forces = jaxgrity.forces_along(scene, motion)
    np.testing.assert_allclose(unbalanced(scene, motion, forces), 0, atol=1e-6)
    normal = np.array([np.sin(0.2), 0, np.cos(0.2)])
    pressed = forces.ground @ normal
    across = np.linalg.norm(forces.ground - pressed[..., None] * normal, axis=-1)
    assert pressed.max() > 100
    assert (across <= 0.4 * pressed + 1e-9).all()


@pytest.mark.campaign
def test_springs_and_penalty_contact_carry_a_rod_with_mass():
    """At rest, by a Runge-Kutta method: 9.81 N at each end, and 19.62 N of a support where one end is held."""
    ground, friction = PenaltyGround(1e4, 2.0), SmoothFriction(0.4, 0.01)
    deep = G / 1e4
    lying = Scene(rod(np.array(FLAT) - [0, 0, deep], [0.0, 0.0], 2.0, 1e4), G, ground=ground, friction=friction)
    forces = jaxgrity.forces_along(lying, jaxgrity.simulate(lying, 0.05))
    np.testing.assert_allclose(forces.ground[-1], [[0, 0, G], [0, 0, G]], atol=1e-6)
    hung = Scene(rod([[0, 0, 1], [0, 0, -G / 1e4]], [0.0, 0.0], 2.0, 1e4, fixed=((0, "xyz"),)), G)
    stretched = dataclasses.replace(
        hung, structure=dataclasses.replace(hung.structure, struts=Members(((0, 1),), [1e4], [1.0], [9.0], mass=[2.0]))
    )
    forces = jaxgrity.forces_along(stretched, jaxgrity.simulate(stretched, 0.05))
    np.testing.assert_allclose(forces.supports[-1], [[0, 0, 2 * G], [0, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(forces.tension[-1], G, atol=1e-6)


@pytest.mark.slow
def test_a_rod_that_hangs_carries_itself_and_what_hangs_from_it():
    """A rod of 2 kg with 1 kg at its end: 19.62 N in its middle, 29.43 N at the support."""
    scene = Scene(rod([[0, 0, 2], [0, 0, 1]], [0.0, 1.0], 2.0, fixed=((0, "xyz"),)), G)
    motion = jaxgrity.simulate(scene, 0.1, options=SolverOptions(dt=STEP))
    forces = jaxgrity.forces_along(scene, motion)
    np.testing.assert_allclose(forces.tension, 2 * G, atol=1e-9)
    np.testing.assert_allclose(forces.supports[-1], [[0, 0, 3 * G], [0, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(jaxgrity.reactions(scene, motion), forces.supports)


@pytest.mark.slow
def test_a_rod_that_swings_pulls_as_its_multiplier_says():
    """A rod of 2 kg with 1 kg at its end, let go level: by its energy, w^2 = 2.4 g sin(angle) for a length of 1 m."""
    scene = Scene(rod([[0, 0, 0], [1, 0, 0]], [0.0, 1.0], 2.0, fixed=((0, "xyz"),)), G)
    options = SolverOptions(method="rk4", dt=STEP)
    motion = jaxgrity.simulate(scene, 0.5, options=options)
    forces, down = jaxgrity.forces_along(scene, motion), -np.asarray(motion.positions)[:, 1, 2]
    np.testing.assert_allclose(forces.tension[:, 0], 6 * G * down, atol=1e-5)
    along = np.einsum("fk,fk->f", forces.supports[:, 0], np.asarray(motion.positions)[:, 1])
    np.testing.assert_allclose(along, -7.8 * G * down, atol=1e-5)
    np.testing.assert_allclose(forces.supports[0, 0], [0, 0, 0.6 * G], atol=1e-9)
    audit = jaxgrity.energy_audit(scene, 0.5, options=options)
    assert max(audit.momentum_residual.max(), audit.angular_residual.max()) < 1e-6


@pytest.mark.parametrize(
    "dtype", [pytest.param("float32", marks=pytest.mark.campaign), pytest.param("float64", marks=pytest.mark.slow)]
)
def test_forces_follow_the_lengths_of_the_motion(dtype):
    """Also where the scene does not know the gait, as that of a closed loop: the same as with it."""
    structure = rod(TILTED, [0.7, 1.3])
    gait = Gait((0,), [0.0], [0.2], [2.0], ramp=1.0)
    scene = exact(structure, gait=gait)
    motion = jaxgrity.simulate(scene, 0.3, options=SolverOptions(dt=STEP, dtype=dtype))
    known = jaxgrity.forces_along(scene, motion)
    followed = jaxgrity.forces_along(jaxgrity.with_gait(scene, None), motion)
    for one, other in zip(known, followed):
        np.testing.assert_allclose(one, other, atol=1e-2 * np.abs(known.ground).max())
    np.testing.assert_allclose(unbalanced(scene, motion, known), 0, atol=1e-3)
    assert known.ground.any()


@pytest.mark.campaign
def test_a_tripod_of_struts_that_share_a_node_pushes_outwards():
    """A weight of 3 kg on three legs at 45 degrees: each carries a third, and friction holds the feet."""
    turn = 2 * np.pi * np.arange(3) / 3
    nodes = np.array([[0, 0, 1.0], *([np.cos(a), np.sin(a), 0] for a in turn)])
    legs = Members(((0, 1), (0, 2), (0, 3)), None, np.full(3, np.sqrt(2)))
    scene = Scene(Structure(nodes, [3.0, 1, 1, 1], legs), G, ground=ExactGround(), friction=ConeFriction(1.0))
    motion = jaxgrity.simulate(scene, 0.1, options=SolverOptions(dt=STEP))
    forces = jaxgrity.forces_along(scene, motion)
    np.testing.assert_allclose(forces.tension[-1], -np.sqrt(2) * G, rtol=1e-6)
    np.testing.assert_allclose(forces.ground[-1, 1:, 2], 2 * G, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(forces.ground[-1, 1:, :2], axis=1), G, rtol=1e-6)
    assert not forces.ground[-1, 0].any()


@pytest.mark.parametrize("duration", [0.1, 0.1012])
def test_a_node_that_rests_has_its_weight_whatever_the_duration(duration):
    """Also where the duration is no multiple of the step."""
    structure = Structure(np.zeros((1, 3)), [1.0])
    scene = Scene(structure, G, ground=ExactGround(), friction=ConeFriction(0.5))
    motion = jaxgrity.simulate(scene, duration, options=SolverOptions(dt=STEP), frame_rate=200.0)
    np.testing.assert_allclose(jaxgrity.forces_along(scene, motion).ground[1:, 0, 2], G, rtol=1e-9)


@pytest.mark.campaign
def test_penalty_contact_pushes_on_rigid_struts_as_their_momentum_says():
    """Frames in every step, for which balances hold to one step of the largest force: a tilted rod falls on its end."""
    ground, friction = PenaltyGround(2e3, 1.0), SmoothFriction(0.4, 0.01)
    scene = Scene(rod(TILTED, [1.0, 1.0]), G, ground=ground, friction=friction)
    motion = jaxgrity.simulate(scene, 0.3, frame_rate=1000.0, options=SolverOptions(dt=1e-3))
    forces = jaxgrity.forces_along(scene, motion)
    assert find_method(motion.method).constrained
    assert (forces.ground[:, 0, 2] > G).any()
    np.testing.assert_allclose(unbalanced(scene, motion, forces), 0, atol=motion.dt * forces.ground.max())

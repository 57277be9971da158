"""Struts that touch each other, on exact contact: impacts, rest, throws, balances and derivatives."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from studies.thrown_rods import thrown_pair

import jaxgrity
from jaxgrity import (
    ConeFriction,
    Differences,
    ExactGround,
    Gait,
    Members,
    PenaltyGround,
    Scene,
    SmoothFriction,
    SolverOptions,
    Structure,
    energy_audit,
    forces_along,
    simulate,
)
from jaxgrity.model import with_contact_between_struts
from jaxgrity.model.strut_contact import strut_contact

G = 9.81
R = 0.02
"""m, radius of the struts"""
STEP = SolverOptions(dt=5e-3)


def gaps(scene: Scene, positions) -> np.ndarray:
    """(frames, pairs), m."""
    between = strut_contact(scene).between
    return np.asarray(jax.jit(jax.vmap(lambda q: between.nearest(q).gap))(jnp.asarray(positions)))


def crossing(gap: float = 0.05, touch: bool = True) -> Scene:
    """Two rods of one metre with unequal ends, one across the other above it, without gravity or ground."""
    above = gap + 2 * R
    nodes = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.1, -0.5, above], [0.1, 0.5, above]])
    scene = Scene(Structure(nodes, [1.0, 2.0, 0.5, 1.0], Members(((0, 1), (2, 3)), None, [1.0, 1.0])))
    return with_contact_between_struts(scene, R) if touch else scene


@pytest.mark.campaign
def test_rods_that_meet_head_on_lose_what_a_plastic_impact_loses():
    """One impulse P at the point of contact changes each end's velocity by its share of P over its mass."""
    scene = crossing()
    v = np.array([[0.0, 0.0, 1.0]] * 2 + [[0.0, 0.0, -1.0]] * 2)
    motion = simulate(scene, 0.1, velocities=v, options=STEP)
    mass, share = np.asarray(scene.structure.node_mass), np.array([-0.4, -0.6, 0.5, 0.5])
    impulse = 2.0 / (share**2 / mass).sum()
    after = v[:, 2] + share * impulse / mass
    # they are 5 steps apart; frames are 10 ms
    np.testing.assert_allclose(motion.velocities[2], v, atol=1e-12)
    np.testing.assert_allclose(motion.velocities[3, :, 2], after, atol=1e-6)
    energy = (mass[:, None] * np.asarray(motion.velocities) ** 2).sum((1, 2)) / 2
    np.testing.assert_allclose(energy[3] - energy[2], -2.0 * impulse / 2, rtol=1e-5)
    assert np.diff(energy).max() < 1e-8
    assert gaps(scene, motion.positions).min() > -1e-6


@pytest.mark.parametrize(
    "count", [pytest.param(12, marks=pytest.mark.campaign), pytest.param(200, marks=pytest.mark.campaign)]
)
def test_thrown_rods_do_not_enter_each_other(count):
    """By more than 2 mm, and 95 % of those that cross by 0.1 mm: else the point of contact runs along them in a step.

    Energy grows by at most 1 % in a step, for 95 % of those that cross by 0.02 %. Momenta stay.
    """
    scene, mass, met = crossing(), np.array([1.0, 2.0, 0.5, 1.0]), 0
    within: list[bool] = []
    for number in range(count):
        q, v = thrown_pair(number)
        motion = simulate(scene, 0.4, positions=q, velocities=v, options=STEP, frame_rate=200.0)
        assert not motion.failed
        x, w = (np.asarray(part) for part in (motion.positions, motion.velocities))
        energy = (mass[:, None] * w**2).sum((1, 2)) / 2
        depth, grown = -gaps(scene, x).min(), np.diff(energy).max() / energy[0]
        assert depth < 2e-3
        assert grown < 1e-2
        within += [depth < 1e-4 and grown < 2e-4] if number % 3 else []  # the others are nearly parallel
        np.testing.assert_allclose((mass[:, None] * w).sum(1), [(mass[:, None] * v).sum(0)] * len(w), atol=1e-9)
        met += energy[-1] < 0.99 * energy[0]
    assert met >= count // 2
    assert np.mean(within) >= 0.95


def pile(friction=0.4, tilt=0.0, contact="exact") -> tuple[Scene, np.ndarray]:
    """A rod that slides along itself across two others, which are held, and its velocities. By `tilt` it falls."""
    nodes = np.array(
        [
            *([-0.3, -0.5, 1.0], [-0.3, 0.5, 1.0], [0.3, -0.5, 1.0], [0.3, 0.5, 1.0]),
            *([-0.5, 0.1, 1.0 + 2 * R], [0.5, 0.1, 1.0 + 2 * R]),
        ]
    )
    nodes[:, [0, 2]] = (nodes[:, [0, 2]] - [0.0, 1.0]) @ [
        [math.cos(tilt), -math.sin(tilt)],
        [math.sin(tilt), math.cos(tilt)],
    ] + [0.0, 1.0]
    fixed = tuple((k, "xyz") for k in range(4))
    if contact == "exact":
        struts, ground = Members(((0, 1), (2, 3), (4, 5)), None, [1.0] * 3), ExactGround()
        cone = ConeFriction(friction) if friction else None
    else:
        struts, ground = Members(((0, 1), (2, 3), (4, 5)), [1e5] * 3, [1.0] * 3), PenaltyGround(1e5, 1.0)
        cone = SmoothFriction(friction, 1e-3) if friction else None
    scene = Scene(Structure(nodes, [1.0] * 6, struts, fixed=fixed), G, None, ground, cone)
    v = np.zeros((6, 3))
    v[4:, 0] = 0.5
    return with_contact_between_struts(scene, R), v


@pytest.mark.campaign
def test_a_rod_slides_on_two_others_and_comes_to_rest():
    """After v^2/(2 mu g), with its weight on both."""
    scene, v = pile()
    motion = simulate(scene, 0.3, velocities=v, options=SolverOptions(dt=2e-3))
    x = np.asarray(motion.positions)[:, 4:] - scene.structure.nodes[4:]
    np.testing.assert_allclose(x[-1, :, 0], 0.5**2 / (2 * 0.4 * G), rtol=0.02)
    np.testing.assert_allclose(x[-5:], [x[-1]] * 5, atol=1e-9)
    np.testing.assert_allclose(x[:, :, 2], 0.0, atol=1e-8)
    forces = forces_along(scene, motion)
    np.testing.assert_allclose(forces.between[-1].sum(0), 0.0, atol=1e-9)
    np.testing.assert_allclose(forces.between[-1, 4:].sum(0), [0.0, 0.0, 2 * G], atol=1e-6)
    np.testing.assert_allclose(forces.supports[-1].sum(0), [0.0, 0.0, 6 * G], atol=1e-6)
    np.testing.assert_allclose(forces.ground, 0.0, atol=1e-12)


@pytest.mark.campaign
def test_stiff_penalty_contact_agrees():
    """With where the rod comes to rest on both models."""
    (exact, v), (soft, _) = pile(), pile(contact="penalty")
    found = simulate(exact, 0.3, velocities=v, options=SolverOptions(dt=1e-3)).positions[-1]
    other = simulate(soft, 0.3, velocities=v, options=SolverOptions(dt=2e-5)).positions[-1]
    assert abs(found - exact.structure.nodes).max() > 0.03
    np.testing.assert_allclose(found, other, atol=1e-3)


@pytest.mark.campaign
def test_the_balance_of_a_sliding_rod():
    """Of momentum to rounding; of energy to what steps miss."""
    scene, _ = pile(friction=0.1, tilt=0.3)
    audit = energy_audit(scene, 0.3, options=SolverOptions(dt=2e-3))
    way = G * (math.sin(0.3) - 0.1 * math.cos(0.3)) * 0.3**2 / 2
    np.testing.assert_allclose(audit.dissipated["friction"][-1], 0.1 * 2 * G * math.cos(0.3) * way, rtol=0.02)
    assert abs(audit.residual).max() < 1e-3
    assert np.max(audit.momentum_residual) < 1e-10


@pytest.mark.campaign
def test_derivatives_are_those_of_differences():
    """Of a rod that falls on two others a little turned and slides there, in forward and in reverse mode."""
    scene, v = pile(friction=0.1)
    options = jaxgrity.stepping.resolve(scene, 0.1, STEP)
    weights = jnp.array([[0.3, -1.0, 0.4], [0.2, 1.0, -0.1]])

    def place(speed):
        q = jnp.asarray(scene.structure.nodes).at[4:, 2].add(1e-3)
        start = q, jnp.asarray(v).at[4, 1].set(speed).at[5, 1].set(0.2 - speed)
        return (jaxgrity.final_state(scene, 0.1, options, start)[0][4:] * weights).sum()

    h = 1e-5
    slope = jax.jit(jax.value_and_grad(place))(0.2)[1]
    forward = jax.jit(lambda x: jax.jvp(place, (x,), (1.0,))[1])(0.2)
    low, high = (jax.jit(place)(0.2 + d) for d in (-h, h))
    assert abs(slope) > 1e-2
    np.testing.assert_allclose([slope, forward], (high - low) / (2 * h), rtol=1e-3)


@pytest.mark.campaign
def test_struts_of_a_robot_that_is_squeezed_do_not_cross():
    """All nodes are thrown inward, between weak cables. Then parallel struts would change places.

    Instead, twelve pairs meet at once.
    """
    robot = replace(jaxgrity.with_gait(jaxgrity.load_scene("exact"), None), ground=None, friction=None, gravity=None)
    cables = robot.structure.cables
    weak = replace(robot.structure, cables=replace(cables, stiffness=cables.stiffness / 100))
    robot = replace(robot, structure=weak)
    scene = with_contact_between_struts(robot, R, at_once=15)
    nodes = np.asarray(robot.structure.nodes)
    v = -12.0 * (nodes - nodes.mean(0))
    free, motion = (simulate(each, 0.3, velocities=v, options=STEP, frame_rate=200.0) for each in (robot, scene))
    assert gaps(scene, free.positions).min() < -R
    assert not motion.failed
    assert gaps(scene, motion.positions).min() > -5e-4


@pytest.mark.campaign
def test_what_a_step_might_miss_fails():
    """With both supports in contact, and one pair at once."""
    scene, v = pile()
    few = replace(scene, terms=(replace(scene.terms[0], at_once=1),))
    assert simulate(few, 0.02, velocities=v, options=STEP).failed
    enough = replace(scene, terms=(replace(scene.terms[0], at_once=2),))
    assert not simulate(enough, 0.02, velocities=v, options=STEP).failed


@pytest.mark.campaign
def test_a_population_and_single_precision():
    """Each robot of a population moves as it does alone; single precision does the same to a millimetre."""
    scene, _ = pile(tilt=0.3)
    scene = replace(scene, gait=Gait((2,), [0.0], [0.05], [2.0], start=0.5, ramp=0.1))
    mu, gaits = np.array([1.0, 0.25]), jaxgrity.gaits_of(scene.gait, np.zeros((2, 1)))
    many = jaxgrity.simulate_population(
        scene, gaits, 0.3, options=STEP, differences=Differences(friction=mu), with_metrics=True
    )
    assert abs(many.positions[0] - many.positions[1]).max() > 0.03
    for k in range(2):
        one = replace(scene, friction=ConeFriction(0.4 * mu[k]))
        for dtype, atol in (("float64", 1e-9), ("float32", 1e-3)):
            alone = simulate(one, 0.3, options=SolverOptions(dt=5e-3, dtype=dtype))
            np.testing.assert_allclose(many.positions[k], alone.positions[-1], atol=atol)

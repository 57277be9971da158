"""U(q, t): forces from `jax.grad` against the paper's hand-derived gradients, and what U does not depend on."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from jaxgrity.model.energy import CableSprings, Gravity, StrutSprings
from jaxgrity.model.ground import PenaltyGround, contact_energy
from jaxgrity.model.laws import Configuration
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, member_vectors

NODES = 5
EDGES = ((0, 1), (2, 3), (4, 0), (1, 3))
STIFFNESS = np.array([100.0, 250.0, 40.0, 700.0])
# Sums of at most four forces of some 1e3 N, rounded in float64; nothing else separates the two sides.
ROUNDING = 1e-11
# Products below it are flushed to zero.
SMALLEST = np.finfo(float).tiny

# No member shorter than 0.2 m: close nodes would amplify the rounding of their positions.
CORNERS = 2.0 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
positions = arrays(float, (NODES, 3), elements=st.floats(-0.9, 0.9)).map(lambda moved: CORNERS + moved - 0.5)
rest_lengths = arrays(float, len(EDGES), elements=st.floats(0.1, 3))
angles = st.floats(-1.2, 1.2)


def members(rest_length):
    return Members(EDGES, STIFFNESS, rest_length)


def strut_energy(q, struts):
    """U of struts that nothing actuates."""
    return StrutSprings(struts, None).energy(Configuration(q, 0.0, member_vectors(q, {"struts": struts}), None))


def cable_energy(q, cables):
    """U of cables that nothing actuates."""
    return CableSprings(cables, None, 0).energy(Configuration(q, 0.0, member_vectors(q, {"cables": cables}), None))


def paper_gradient(q, strain_force):
    """dU/dq of springs with U' = `strain_force(k, l)`, by Appendix A.1 and section 6.2.

    A.1 prints dl/dx_p = -d_pq and dl/dx_q = +d_pq. The signs are the other way round, as section 6.2 has them:
    l grows when x_p moves along d_pq = (x_p - x_q)/l.
    """
    gradient = np.zeros_like(q)
    for k, (p, other) in enumerate(EDGES):
        length = np.linalg.norm(q[p] - q[other])
        d_pq = (q[p] - q[other]) / length
        gradient[p] += strain_force(k, length) * d_pq
        gradient[other] -= strain_force(k, length) * d_pq
    return gradient


@jax.jit
def strut_gradient(q, rest):
    return jax.grad(strut_energy)(q, members(rest))


@jax.jit
def cable_gradient(q, rest):
    return jax.grad(cable_energy)(q, members(rest))


@given(positions, rest_lengths)
def test_strut_pushes_and_pulls_as_the_paper_derives(q, rest):
    expected = paper_gradient(q, lambda k, length: STIFFNESS[k] * (length - rest[k]))
    np.testing.assert_allclose(strut_gradient(q, rest), expected, rtol=0, atol=ROUNDING)


@given(positions, rest_lengths)
def test_cable_only_pulls_as_the_paper_derives(q, rest):
    expected = paper_gradient(q, lambda k, length: STIFFNESS[k] * max(length - rest[k], 0))
    np.testing.assert_allclose(cable_gradient(q, rest), expected, rtol=0, atol=ROUNDING)


@given(positions)
def test_slack_cable_stores_nothing_and_pulls_nothing(q):
    rest = np.full(len(EDGES), 10.0)
    assert float(cable_energy(q, members(rest))) == 0
    assert not np.any(cable_gradient(q, rest))


@pytest.mark.parametrize(("stretch", "tension"), [(-1.0, 0.0), (0.0, 0.0), (1.0, 100.0)])
def test_cable_slack_at_its_rest_length_and_taut(stretch, tension):
    """At l = L the sub-differential of Appendix A.2 is {0}: no force, and a finite one on either side."""
    q, rest = np.zeros((NODES, 3)), np.full(len(EDGES), 2.0)
    q[1, 0], q[2, 1], q[4, 2] = 2.0 + stretch, 1.0, 1.0
    q[3] = q[1]
    gradient = cable_gradient(q, rest)
    np.testing.assert_allclose(gradient[0], [-tension, 0, 0], rtol=1e-15)


@given(positions, st.floats(0, 20, allow_subnormal=False))
def test_gravity_pulls_each_node_down_by_its_weight(q, g):
    mass = np.array([1.0, 2.0, 0.5, 3.0, 0.1])
    gradient = jax.grad(lambda q: Gravity(np.asarray(g), mass, None).energy(Configuration(q, 0.0, {}, None)))(q)
    np.testing.assert_allclose(gradient, np.outer(mass * g, [0, 0, 1]), rtol=1e-15, atol=SMALLEST)


@given(positions, angles)
def test_penalty_contact_pushes_along_the_normal_as_the_paper_derives(q, incline):
    """Section 6.3, with the plane falling towards +x: n = (sin theta, 0, cos theta)."""
    ground = PenaltyGround(1e4, incline=incline)
    normal = np.array([np.sin(incline), 0, np.cos(incline)])
    expected = 1e4 * np.minimum(q @ normal, 0)[:, None] * normal
    gradient = jax.grad(lambda q: contact_energy(ground, ground.signed_distance(q)))(q)
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=ROUNDING)


@given(angles, st.floats(-5, 5), st.floats(-5, 5))
def test_ground_is_a_plane_falling_towards_plus_x(incline, x, y):
    """A point of the plane stands at z = -x tan(theta); one metre along the normal is one metre of distance."""
    ground = PenaltyGround(1.0, incline=incline)
    foot = np.array([[x, y, -x * np.tan(incline)]])
    np.testing.assert_allclose(ground.signed_distance(foot), 0, atol=1e-14)
    np.testing.assert_allclose(ground.signed_distance(foot + ground.normal), 1, rtol=1e-13)
    axes = np.array([ground.normal, *ground.tangents])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)


def near(scene, seed, spread=0.1):
    """The scene's structure, each node moved at random, by about `spread` (m)."""
    return np.asarray(scene.structure.nodes) + spread * np.random.default_rng(seed).normal(size=(12, 3))


@pytest.fixture(scope="module")
def energy(reference):
    return jax.jit(lambda q, t: reference.potential_energy(q, t))


@pytest.mark.parametrize("seed", range(5))
def test_energy_unchanged_by_turning_about_gravity_and_moving_along_the_ground(energy, reference, seed):
    angle, (x, y) = np.random.default_rng(seed).uniform(-3, 3), np.random.default_rng(seed).normal(size=2)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    q = near(reference, seed)
    np.testing.assert_allclose(energy(q @ turn.T + [x, y, 0], 1.7), energy(q, 1.7), rtol=1e-13)


@pytest.mark.parametrize("seed", range(5))
def test_energy_of_the_members_unchanged_by_any_rigid_motion(reference, seed):
    random = np.random.default_rng(seed)
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    q = near(reference, seed)

    members = Scene(reference.structure, gait=reference.gait)

    def elastic(q):
        return members.potential_energy(q, jnp.asarray(1.7))

    np.testing.assert_allclose(elastic(q @ turn.T + random.normal(size=3)), elastic(q), rtol=1e-13)


def test_energy_depends_on_height_and_on_tilt(energy, reference):
    """The invariances above are not those of a constant."""
    q = near(reference, 0)
    assert abs(energy(q + np.array([0, 0, 0.1]), 1.7) - energy(q, 1.7)) > 1
    assert abs(energy(q[:, [2, 0, 1]], 1.7) - energy(q, 1.7)) > 1


def test_gait_shortens_members_by_the_stated_law(reference):
    """An actuated strut acts as a passive one of L(t) = L0 (1 - delta/2 r (1 + sin(2 pi f t + phase)))."""
    q, t, gait = near(reference, 1), 1.7, reference.gait
    shortened = 0.3 / 2 * 0.7 * (1 + np.sin(2 * np.pi * 0.5 * t + np.arange(6.0)))
    struts = reference.structure.struts
    shorter = dataclasses.replace(struts, rest_length=struts.rest_length * (1 - shortened))
    expected = jax.grad(strut_energy)(q, shorter) + jax.grad(cable_energy)(q, reference.structure.cables)
    actual = jax.grad(Scene(reference.structure, gait=gait).potential_energy)(q, jnp.asarray(t))
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-9)


COINCIDENT = np.zeros((NODES, 3))
AT_REST_LENGTH = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0], [2, 0, 2], [0, 0, 2.0]])


def energy_of_all(q, rest, k_n):
    """U of struts, cables and contact."""
    ground = PenaltyGround(k_n)
    total = strut_energy(q, members(rest)) + cable_energy(q, members(rest))
    return total + contact_energy(ground, ground.signed_distance(q))


DERIVATIVES = [jax.jit(derivative(energy_of_all, (0, 1, 2))) for derivative in (jax.grad, jax.hessian)]


@pytest.mark.parametrize("q", [COINCIDENT, AT_REST_LENGTH], ids=["coincident nodes", "l = L and phi = 0"])
@pytest.mark.parametrize("derivative", DERIVATIVES, ids=["first", "second"])
def test_derivatives_are_finite_where_the_energy_has_kinks(q, derivative):
    """By positions, rest lengths and the stiffness of the ground."""
    rest = np.full(len(EDGES), 2.0)
    for part in jax.tree.leaves(derivative(q, rest, jnp.asarray(1e4))):
        assert np.all(np.isfinite(part))

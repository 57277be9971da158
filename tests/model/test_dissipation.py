"""R(v; q, t) and the Coulomb switch: each dissipative force against its law, and that none of them feeds energy in."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from jaxgrity.model.friction import SmoothFriction, SwitchFriction, slip_dissipation, switch_force
from jaxgrity.model.ground import PenaltyGround, contact_dissipation, normal_force
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure
from jaxgrity.stepping.dynamics import acceleration

EDGES = ((0, 1), (2, 3), (4, 0), (1, 3))
DAMPING = np.array([1.0, 5.0, 20.0, 0.5])
INCLINE = 0.4
GROUND = PenaltyGround(1e4, 2.0, INCLINE)
NORMAL = np.array([np.sin(INCLINE), 0, np.cos(INCLINE)])
SWITCH = SwitchFriction(0.6, 0.4, 0.01)

velocities = arrays(float, (5, 3), elements=st.floats(-3, 3))
# No member shorter than 0.2 m: close nodes would amplify the rounding of their positions.
CORNERS = 2.0 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
positions = arrays(float, (5, 3), elements=st.floats(-0.9, 0.9)).map(lambda moved: CORNERS + moved)
pressures = arrays(float, 5, elements=st.floats(0, 100))


def members(rest_length):
    return Members(EDGES, np.ones(4), np.full(4, rest_length), DAMPING)


def tangential(x):
    return x - np.outer(x @ NORMAL, NORMAL)


def paper_damping(q, v, active):
    """Force -c l' d on one end of each damped member and +c l' d on the other, with l' = d·(v_p - v_q)."""
    force = np.zeros_like(q)
    for (p, other), c in zip(EDGES, DAMPING):
        length = np.linalg.norm(q[p] - q[other])
        d = (q[p] - q[other]) / length
        pull = c * d @ (v[p] - v[other]) * active(length)
        force[p] -= pull * d
        force[other] += pull * d
    return force


def dissipative_force(v, q, **parts):
    """-dR/dv of a scene without ground, N."""
    structure = Structure(CORNERS, np.ones(5), parts.pop("struts", None), parts.pop("cables", None))
    return -jax.grad(Scene(structure, **parts).dissipation)(v, q, jnp.asarray(0.0), None)


@jax.jit
def strut_damping_force(v, q):
    return dissipative_force(v, q, struts=members(1.0))


@jax.jit
def cable_damping_force(v, q):
    return dissipative_force(v, q, cables=members(1.0))


@pytest.mark.slow
@given(velocities, positions)
def test_strut_damping_acts_along_the_member_against_its_rate(v, q):
    expected = paper_damping(q, v, lambda length: True)
    np.testing.assert_allclose(strut_damping_force(v, q), expected, rtol=0, atol=1e-11)


@given(velocities, positions)
def test_cable_damping_acts_only_while_taut(v, q):
    expected = paper_damping(q, v, lambda length: length > 1.0)
    np.testing.assert_allclose(cable_damping_force(v, q), expected, rtol=0, atol=1e-11)


@given(velocities)
def test_node_damping_takes_power_c_v_squared(v):
    c = np.array([0.5, 1.0, 2.0, 0.0, 3.0])
    power = float(jnp.sum(v * dissipative_force(v, CORNERS, node_damping=c)))
    np.testing.assert_allclose(power, -np.sum(c * np.sum(v * v, axis=1)), rtol=1e-14)


@given(arrays(float, 5, elements=st.floats(-3, 3)), arrays(float, 5, elements=st.floats(-0.1, 0.1)))
def test_contact_force_is_hunt_and_crossleys_and_never_pulls(v_n, phi):
    """F_n = k_n pen max(0, 1 - alpha v_n); let go from v_n = 1/alpha = 0.5 m/s on."""
    expected = 1e4 * np.maximum(-phi, 0) * np.maximum(1 - 2.0 * v_n, 0)
    force = normal_force(GROUND, phi, v_n)
    # F_n is a difference of elastic force and R's gradient, both up to 1e3 N.
    np.testing.assert_allclose(force, expected, rtol=1e-13, atol=1e-11)
    assert np.all(force >= 0)


@given(velocities, pressures)
def test_smooth_friction_is_coulombs_law_regularised(v, pressed):
    friction = SmoothFriction(0.5, 0.01)
    force = -jax.grad(slip_dissipation, argnums=2)(friction, GROUND.tangents, v, pressed)
    v_t = tangential(v)
    expected = -0.5 * pressed[:, None] * v_t / np.sqrt(np.sum(v_t**2, axis=1) + 0.01**2)[:, None]
    # tangential() leaves 1e-16 m/s of rounding, which 50 N / (0.01 m/s) turns into 1e-11 N at most.
    np.testing.assert_allclose(force, expected, rtol=1e-12, atol=1e-11)


def test_ground_force_in_the_equations_of_motion_is_contact_plus_friction():
    """One node pressed 1 mm into the incline, moving down it and along its normal: F = F_n n - mu F_n v_t/|v_t|."""
    q, v = -1e-3 * NORMAL[None], (0.3 * np.array(GROUND.tangents[0]) - 0.1 * NORMAL)[None]
    scene = Scene(Structure(q, np.array([2.0])), ground=GROUND, friction=SmoothFriction(0.5, 0.01))
    F_n = 1e4 * 1e-3 * (1 + 2.0 * 0.1)
    F_t = -0.5 * F_n * 0.3 / np.hypot(0.3, 0.01)
    expected = (F_n * NORMAL + F_t * np.array(GROUND.tangents[0])) / 2.0
    np.testing.assert_allclose(acceleration(scene, 0.0, q, v)[0], expected, rtol=1e-12, atol=1e-12)


def switched(slip, push):
    """The tangential force on one node pressed with 100 N that slips and is pushed down the slope."""
    down, level = (np.array(t) for t in GROUND.tangents)
    others = push * down - 100.0 * NORMAL
    force = switch_force(SWITCH, GROUND.tangents, (slip * down)[None], np.array([100.0]), others[None])[0]
    assert abs(force @ NORMAL) < 1e-13
    assert abs(force @ level) < 1e-13
    return float(force @ down)


@pytest.mark.parametrize("slip", [0.0, 0.009, -0.009])
@pytest.mark.parametrize("push", [0.0, 30.0, -59.999])
def test_switch_sticks_while_slow_and_held(slip, push):
    """The sticking force cancels every other tangential force, up to mu_s F_n = 60 N."""
    np.testing.assert_allclose(switched(slip, push), -push, rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("slip", [0.011, 2.0, -0.5])
@pytest.mark.parametrize("push", [0.0, 30.0, -90.0])
def test_switch_slides_with_kinetic_friction_against_the_slip(slip, push):
    np.testing.assert_allclose(switched(slip, push), -40.0 * np.sign(slip), rtol=1e-14)


@pytest.mark.parametrize("push", [60.001, 90.0, -75.0])
def test_switch_breaks_away_against_the_push(push):
    """Slow, but pushed by more than mu_s F_n: kinetic friction against the slip that is about to start."""
    np.testing.assert_allclose(switched(0.005, push), -40.0 * np.sign(push), rtol=1e-14)


@given(velocities, velocities, arrays(float, 5, elements=st.floats(0, 100)))
def test_switch_never_exceeds_static_friction_nor_adds_power_in_a_slide(v, direction, pressed):
    """Appendix B: |F_t| <= mu_s F_n; and a node faster than eps only loses power."""
    force = np.asarray(switch_force(SWITCH, GROUND.tangents, v, pressed, 30 * direction))
    assert np.all(np.linalg.norm(force, axis=1) <= 0.6 * pressed * (1 + 1e-12) + 1e-12)
    sliding = np.linalg.norm(tangential(v), axis=1) > 0.0101
    power = np.sum(force * v, axis=1)[sliding]
    lost = (0.4 * pressed * np.linalg.norm(tangential(v), axis=1))[sliding]
    # as much as a slide at 1 cm/s leaves of the digits of v; the rest is for forces near the smallest float
    np.testing.assert_allclose(power, -lost, rtol=1e-10, atol=1e-15)


@pytest.fixture(scope="module")
def lost_power(reference):
    """v·dR/dv of each node of the reference robot, W."""

    @jax.jit
    def power(v, q):
        pressed = reference.normal_force(q, v)
        return jnp.sum(v * jax.grad(reference.dissipation)(v, q, jnp.asarray(1.7), pressed))

    return power


@given(seed=st.integers(0, 2**32 - 1), speed=st.floats(0, 5), sunk=st.floats(-0.1, 0.3))
def test_dissipation_never_feeds_energy_in(lost_power, reference, seed, speed, sunk):
    random = np.random.default_rng(seed)
    q = np.asarray(reference.structure.nodes) + 0.05 * random.normal(size=(12, 3)) - [0, 0, sunk]
    power = float(lost_power(speed * random.normal(size=(12, 3)), q))
    assert power >= 0
    assert power > 0 or speed < 1e-100


def kinked_scenes():
    """Scenes at rest with coincident and touching nodes, cables at l = L, and each kind of friction."""
    q = np.array([[0, 0, 0], [0, 0, 0], [0, 1, 0], [0, 1, 2.0], [1, 0, -0.01]])
    structure = Structure(
        q,
        np.ones(5),
        struts=Members(((0, 1), (2, 4)), np.full(2, 1e3), np.ones(2), np.ones(2)),
        cables=Members(((2, 3), (0, 4)), np.full(2, 1e3), np.array([2.0, 3.0]), np.ones(2)),
    )
    parts = dict(gravity=9.81, node_damping=np.ones(5), ground=PenaltyGround(1e4, 2.0, 0.0))
    return [Scene(structure, **parts, friction=friction) for friction in (SmoothFriction(0.5, 0.01), SWITCH)]


@pytest.mark.parametrize("scene", kinked_scenes(), ids=["smooth", "switch"])
@pytest.mark.slow
def test_derivatives_are_finite_where_the_forces_have_kinks(scene):
    """First and second derivatives of the acceleration by state and by every number of the scene, at v = 0."""
    q = scene.structure.nodes
    numbers, rest = eqx.partition(jax.tree.map(jnp.asarray, scene), eqx.is_array)

    def pull(state, numbers):
        weights = jnp.arange(15.0).reshape(5, 3)
        return jnp.sum(weights * acceleration(eqx.combine(numbers, rest), jnp.asarray(0.0), *state))

    state = (jnp.asarray(q), jnp.zeros((5, 3)))
    gradient = jax.grad(pull, (0, 1))
    tangents = jax.tree.map(jnp.ones_like, (state, numbers))
    first_and_second = jax.jit(lambda s, n: jax.jvp(gradient, (s, n), tangents))(state, numbers)
    for part in jax.tree.leaves(first_and_second):
        assert np.all(np.isfinite(part))


def test_contact_dissipation_is_continuous_at_release():
    """R and dR/dv_n are continuous where the contact lets go, v_n = 1/alpha."""
    phi = np.array([-0.01])
    R = lambda v_n: contact_dissipation(GROUND, v_n, phi)  # noqa: E731
    below, above = np.array([0.5 - 1e-9]), np.array([0.5 + 1e-9])
    np.testing.assert_allclose(R(below), R(above), rtol=1e-8)
    np.testing.assert_allclose(jax.grad(R)(below), jax.grad(R)(above), rtol=1e-8)

"""Points of contact along struts: a rod across an obstacle, against closed forms and nodes in the same place."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrity
from jaxgrity import (
    Box,
    Differences,
    InputError,
    Members,
    PenaltyGround,
    Scene,
    SmoothFriction,
    SolverOptions,
    Structure,
    energy_audit,
    rod_depths,
    simulate,
    with_contact_along_struts,
)
from jaxgrity.stepping.dynamics import total_force

STIFFNESS, MASS, G = 2e4, 1.0, 9.81


def across(friction=None, damping=None) -> Scene:
    """A rod, level along x, above a post half as wide as the rod's points are apart."""
    nodes = np.array([[-0.5, 0.0, 0.31], [0.5, 0.0, 0.31]])
    struts = Members(((0, 1),), [1e4], [1.0], damping=[20.0])
    ground = PenaltyGround(STIFFNESS, 2.0, surface=Box((0.0, 0.0, 0.0), (0.2, 2.0, 0.6)))
    damped = None if damping is None else np.full(2, damping)
    return Scene(Structure(nodes, [MASS, MASS], struts), G, damped, ground, friction)


def test_a_rod_rests_on_a_post_between_its_nodes():
    """As deep in it as its weight presses the point that touches, where contact at nodes lets it fall through."""
    scene = across(damping=20.0)
    options = SolverOptions("rk4", dt=1e-3)
    held = with_contact_along_struts(scene, 3)
    fallen, resting = (simulate(each, 3.0, frame_rate=10.0, options=options) for each in (scene, held))
    assert fallen.positions[-1, :, 2].max() < -1
    depth = 0.3 - np.asarray(resting.positions[-1, :, 2])
    np.testing.assert_allclose(depth, 2 * MASS * G / (STIFFNESS / 3), rtol=1e-6)
    assert rod_depths(scene, fallen, 3).max() > 10 * rod_depths(held, resting, 3).max()


def test_a_point_gets_what_a_node_gets_there():
    """Forces of contact and of friction on a node in the same place, divided among both ends by position."""
    friction = SmoothFriction(0.4, 0.01)
    scene = with_contact_along_struts(across(friction), 1)
    q = jnp.array([[-0.45, 0.1, 0.28], [0.55, -0.2, 0.29]])
    v = jnp.array([[0.3, 0.2, -0.4], [0.1, -0.5, 0.2]])
    point = Scene(Structure(q[:1], [MASS]), None, None, across().ground, friction)
    there, moving = q.mean(0, keepdims=True), v.mean(0, keepdims=True)

    def force(each, q, v):
        return total_force(each, jnp.array(0.0), q, v)

    alone = force(point, there, moving)
    both = force(scene, q, v) - force(across(friction), q, v)
    assert jnp.linalg.norm(alone[0, :2]) > 1
    np.testing.assert_allclose(both, np.repeat(alone / 2, 2, axis=0), rtol=1e-12, atol=1e-12)


def test_energy_is_accounted_for():
    """Of a rod that tips over the post and slides off: what is lost is booked, to a thousandth of the energy."""
    scene = across(SmoothFriction(0.3, 0.05))
    beside = eqx.tree_at(lambda s: s.structure.nodes, scene, scene.structure.nodes + np.array([0.2, 0.0, 0.0]))
    audit = energy_audit(with_contact_along_struts(beside, 3), 0.4, options=SolverOptions(dt=2e-4))
    assert audit.dissipated["friction"][-1] > 1e-2
    assert abs(audit.residual).max() < 1e-3 * 2 * MASS * G * 0.3


def test_populations_and_gradients_agree_with_one_robot():
    """A robot of many moves as it does alone; forward mode agrees with central differences."""
    scene = with_contact_along_struts(jaxgrity.load_scene("reference"), 2, struts=(0, 3))
    options = SolverOptions(dt=1e-3)
    gaits = jaxgrity.gaits_of(scene.gait, jaxgrity.random_phases(2, actuators=6, seed=0))
    many = jaxgrity.simulate_population(
        scene, gaits, 0.3, options=options, differences=Differences(friction=np.array([1.0, 0.8]))
    )
    one = jaxgrity.with_gait(scene, jax.tree.map(lambda x: x[0] if np.ndim(x) else x, gaits))
    alone = simulate(one, 0.3, options=options)
    np.testing.assert_allclose(many.positions[0], alone.positions[-1], atol=1e-6)

    resolved = jaxgrity.resolve(across(), 0.1, SolverOptions("rk4", dt=1e-3))
    held = with_contact_along_struts(across(SmoothFriction(0.3, 0.05)), 3)

    def height(z):
        nodes = jnp.asarray(held.structure.nodes) + jnp.array([0.05, 0.0, 0.0]) * z
        start = nodes, jnp.array([[0.5, 0.0, 0.0], [0.5, 0.0, 0.1]])
        return jaxgrity.final_state(held, 0.1, resolved, start)[0][0, 2]

    h = 1e-4
    _, forward = jax.jvp(jax.jit(height), (0.3,), (1.0,))
    np.testing.assert_allclose((height(0.3 + h) - height(0.3 - h)) / (2 * h), forward, atol=1e-7)


@pytest.mark.parametrize(
    ("scene", "arguments", "message"),
    [
        (lambda: jaxgrity.load_scene("exact"), (3,), "contact along struts needs penalty contact"),
        (across, (0,), "count = 0: expected at least 1 point"),
        (across, (1, (1,)), r"struts = \[1\]: expected some of the scene's 1"),
    ],
)
def test_what_cannot_be_is_refused(scene, arguments, message):
    """In one line."""
    with pytest.raises(InputError, match=message):
        with_contact_along_struts(scene(), *arguments)

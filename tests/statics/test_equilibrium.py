"""Shapes at rest: prisms and springs of which they are known, supports, loads, and how they depend on the scene."""

import dataclasses
import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse as sp

from jaxgrity import (
    EnergyTerm,
    InputError,
    Members,
    Motor,
    Scene,
    Structure,
    describe,
    edge_lengths,
    force_limit,
    load_scene,
    parse_scene,
    with_terms,
)
from jaxgrity.model import body_moments, rigid_body
from jaxgrity.model.bodies import with_factors
from jaxgrity.statics import (
    equilibrium_near,
    prestressed,
    resting_shape,
    settled,
    static_response,
    vibration_modes,
)
from jaxgrity.statics.stiffness import factor_if_definite, stiffness_matrix, tangent_of
from jaxgrity.structures import prism, prism_tower, tower


def sprung(geometry, tension=50.0) -> Structure:
    """Springs that are prestressed in the given shape, the tightest cable with `tension`, N."""
    struts, cables = geometry.struts, geometry.cables
    plain = Structure(
        geometry.nodes,
        np.full(len(geometry.nodes), 0.1),
        Members(struts, np.full(len(struts), 2e4), np.ones(len(struts))),
        Members(cables, np.full(len(cables), 600.0), np.ones(len(cables))),
    )
    return prestressed(plain, tension)


def hanging(stiffness=100.0, fixed=((0, "xyz"),)) -> Scene:
    """2 kg under a spring of 1 m that is held at its upper end."""
    cable = Members(((0, 1),), jnp.asarray([stiffness]), np.ones(1))
    structure = Structure(np.array([[0.0, 0, 0], [0, 0, -1.2]]), np.array([0.1, 2.0]), cables=cable, fixed=fixed)
    return Scene(structure, gravity=9.81)


@pytest.mark.parametrize("n", [3, *(pytest.param(n, marks=pytest.mark.campaign) for n in range(4, 13))])
def test_prism_finds_its_twist(n):
    """pi/2 + pi/n between its polygons to 1e-10, from nodes that are off by some per cent of its size."""
    structure = sprung(prism(n))
    start = structure.nodes + 0.01 * np.random.default_rng(3).normal(size=structure.nodes.shape)
    found = resting_shape(Scene(structure), start)
    assert found.stable
    low, high = found.q[:n] - found.q[:n].mean(0), found.q[n:] - found.q[n:].mean(0)
    axis = found.q[n:].mean(0) - found.q[:n].mean(0)
    axis /= np.linalg.norm(axis)
    twist = np.arctan2(np.cross(low, high) @ axis, (low * high).sum(1)) % (2 * np.pi)
    np.testing.assert_allclose(twist, np.pi / 2 + np.pi / n, rtol=0, atol=1e-10)


def test_a_hanging_mass_is_lower_by_its_weight_over_the_stiffness():
    """l = L + m g/K; the support carries both weights. A further load adds its own."""
    found = resting_shape(hanging())
    np.testing.assert_allclose(found.q[1], [0, 0, -1 - 2 * 9.81 / 100], atol=1e-12)
    np.testing.assert_allclose(found.reactions, [[0, 0, 2.1 * 9.81], [0, 0, 0]], atol=1e-9)
    loaded = resting_shape(hanging(), loads=np.array([[0, 0, 0], [0, 0, -10.0]]))
    np.testing.assert_allclose(loaded.q[1, 2], -1 - (2 * 9.81 + 10) / 100, atol=1e-12)


def test_a_hanging_body_turns_until_its_centre_is_below():
    """It begins sideways. The cable holds it at a point that follows the basic ones."""
    corners = np.array([[0.3, 0, 0], [0.5, 0, 0], [0.3, 0.4, 0], [0.3, 0, 0.6]]) - [0, 0, 1.2]
    nodes = np.concatenate([[[0.0, 0, 0], [0, 0, -1.2]], corners])
    body = rigid_body(nodes, (1, 2, 3, 4, 5), 2.0, [0.2, 0.3, 0.4], [0.3, 0.0, -1.2], basic=(2, 3, 4, 5))
    cable = Members(((0, 1),), np.array([100.0]), np.ones(1))
    structure = Structure(nodes, np.r_[0.1, np.zeros(5)], cables=cable, fixed=((0, "xyz"),), bodies=(body,))
    found = resting_shape(Scene(structure, gravity=9.81))
    eye = -1 - 2 * 9.81 / 100
    _, centre, _ = body_moments(body, np.asarray(found.q))
    np.testing.assert_allclose(found.q[1], [0, 0, eye], atol=1e-6)
    np.testing.assert_allclose(centre, [0, 0, eye - 0.3], atol=1e-5)
    np.testing.assert_allclose(found.reactions.sum(0), [0, 0, 2.1 * 9.81], atol=1e-6)


def test_a_chain_of_rigid_struts_hangs_though_it_starts_level(monkeypatch):
    """Straight down by its four metres; the support carries its five kilogrammes. The stiff chain alone creeps."""
    monkeypatch.setattr("jaxgrity.statics.equilibrium.ITERATIONS", 60)
    nodes = np.arange(5.0)[:, None] * np.array([1.0, 0, 0])
    struts = Members(tuple((k, k + 1) for k in range(4)), None, np.ones(4))
    found = resting_shape(Scene(Structure(nodes, np.ones(5), struts, fixed=((0, "xyz"),)), gravity=9.81))
    np.testing.assert_allclose(found.q[-1], [0, 0, -4], atol=1e-5)
    np.testing.assert_allclose(found.reactions[0], [0, 0, 5 * 9.81], atol=1e-6)
    assert found.stable


def test_a_tower_of_rigid_struts_far_from_rest_settles():
    """Cables of 98 % of their lengths pull its prisms together and turn them. With stiff struts alone it creeps."""
    structure = prism_tower(9, exact=True).structure
    found = resting_shape(Scene(structure))
    assert found.steps < 120
    assert np.linalg.norm(found.q - structure.nodes, axis=1).max() > 0.02
    np.testing.assert_allclose(edge_lengths(found.q, structure.struts.edges), structure.struts.rest_length, rtol=1e-5)


@pytest.mark.slow
def test_one_program_gives_energy_force_and_stiffness(reference):
    """Those of U by automatic differentiation, deep in the ground and beside it."""
    scene = dataclasses.replace(reference, gait=None)

    @jax.jit
    def by_jax(q):
        U = lambda q: scene.potential_energy(q, 0.0)  # noqa: E731
        return *jax.value_and_grad(U)(q), jax.hessian(U)(q)

    for q in (scene.structure.nodes, scene.structure.nodes - [0, 0, 0.05]):
        found = tangent_of(scene)(q)
        U, slope, hessian = by_jax(q)
        np.testing.assert_allclose(found.energy, U, rtol=1e-13)
        np.testing.assert_allclose(found.gradient, slope, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(found.stiffness().toarray(), hessian.reshape(q.size, q.size), rtol=1e-9, atol=1e-9)


def test_settling_knows_the_cables_forces():
    """A mass between two cables rests where both pull alike, or where one pulls with the limit of the other, 5 N."""
    cables = Members(((0, 1), (1, 2)), np.full(2, 100.0), np.array([0.7, 0.9]))
    row = Structure(
        np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.ones(3), cables=cables, fixed=((0, "xyz"), (2, "xyz"))
    )
    limited = with_terms(Scene(row), force_limit(cables, [5.0, 1e3]))
    np.testing.assert_allclose(settled(Scene(row)).scene.structure.nodes[1], [0.9, 0, 0], atol=1e-9)
    np.testing.assert_allclose(settled(limited).scene.structure.nodes[1], [2 - 0.95, 0, 0], atol=1e-9)
    assert "not listed beside largest force of cables" in describe(limited)


def test_without_the_support_it_falls():
    """No shape balances its weight, and a shape of the wrong size is no start."""
    with pytest.raises(InputError, match=r"no equilibrium near the start: .* N are left after"):
        resting_shape(hanging(fixed=()))
    with pytest.raises(InputError, match=r"start has shape \(3, 3\)"):
        resting_shape(hanging(), start=np.zeros((3, 3)))


def test_a_column_on_its_point_of_balance_ends_beside_it():
    """A weight on a hinged spring is in equilibrium upright, but U falls to all sides: that is not the answer."""
    rod = Members(((0, 1),), np.array([1e4]), np.ones(1))
    nodes, mass = np.array([[0.0, 0, 0], [1e-3, 0, 1]]), np.array([0.0, 2.0])
    found = resting_shape(Scene(Structure(nodes, mass, struts=rod, fixed=((0, "xyz"),)), gravity=9.81))
    np.testing.assert_allclose(found.q[1, 2], -1 - 2 * 9.81 / 1e4, rtol=1e-9)


def test_stiffness_is_the_hessian_of_all_that_acts(reference):
    """Of members, one of them slack, of gravity and of contact with the ground: the same as jax.hessian, at random."""
    q = np.asarray(reference.structure.nodes) + 0.05 * np.random.default_rng(3).normal(size=(12, 3)) - [0, 0, 0.1]
    still = dataclasses.replace(reference, gait=None)
    expected = jax.jit(jax.hessian(lambda x: still.potential_energy(x, 0.0)))(jnp.asarray(q)).reshape(36, 36)
    np.testing.assert_allclose(stiffness_matrix(still, q).toarray(), expected, rtol=1e-10, atol=1e-9)


class Tether(EnergyTerm):
    """U = K/2 |x_0 - x_2|^2, which no member shows."""

    stiffness: float
    name = "tether"

    def energy(self, at):
        return self.stiffness / 2 * jnp.sum((at.q[0] - at.q[2]) ** 2)

    def keeps(self, symmetry):
        return False


@pytest.mark.parametrize("stiffness", [2.0, 2e-4])
def test_what_joins_nodes_otherwise_is_in_the_whole_hessian(stiffness, monkeypatch):
    """A soft term beside stiff springs too: its share of a product would be rounding. Large structures are refused."""
    plain = Scene(sprung(prism(3)))
    stiff = dataclasses.replace(plain.structure.struts, stiffness=np.full(3, 1e6))
    plain = dataclasses.replace(plain, structure=dataclasses.replace(plain.structure, struts=stiff))
    scene, q = with_terms(plain, Tether(stiffness)), plain.structure.nodes
    alone = np.zeros((6, 6))
    alone[np.ix_([0, 2], [0, 2])] = [[1, -1], [-1, 1]]
    more = (stiffness_matrix(scene, q) - stiffness_matrix(plain, q)).toarray()
    np.testing.assert_allclose(more, stiffness * np.kron(alone, np.eye(3)), rtol=1e-5, atol=1e-8)
    monkeypatch.setattr("jaxgrity.statics.stiffness.MOST_WHOLE", 5)
    with pytest.raises(InputError, match="tether: joins nodes otherwise than by members; expected at most 5 nodes"):
        stiffness_matrix(scene, q)


HELD_BY_A_HINGE = """
[structure]
kind = "custom"
nodes = [[0, -0.1, 0], [0, 0.1, 0], [0.6, 0, 0], [0.6, 0, 0.1], [0, 0, 1], [0.6, 1, 0]]
cables = [[2, 5]]
node_mass = [0, 0, 0, 0, 1, 1]
fixed = [0, 1, 4, 5]
[cables]
stiffness = 100.0
rest_length = 0.9999
[[bodies]]
nodes = [0, 1, 2, 3]
mass = 2.0
inertia = [0.02, 0.05, 0.05]
centre = [0.3, 0.0, 0.0]
[[hinges]]
nodes = [4, 0, 1, 2]
stiffness = 3.0
"""


def test_the_spring_of_a_hinge_counts_beside_stiff_bodies():
    """A bar of 0.6 m on two supports: k = 3 N m/rad of the hinge, 0.01 N of a cable across, I = 0.05 + 2 * 0.3^2."""
    scene = parse_scene(HELD_BY_A_HINGE)
    held = 3 + 0.01 * 0.6**2
    (frequency,) = vibration_modes(scene).frequency
    assert frequency == pytest.approx(np.sqrt(held / 0.23) / 2 / np.pi, rel=1e-5)
    down = np.zeros((6, 3))
    down[2, 2] = -1.0
    found = static_response(scene, scene.structure.nodes, down).displacement[2, 2]
    assert found == pytest.approx(-(0.6**2) / held, rel=1e-5)
    rest = resting_shape(scene, loads=down)
    x, z, length = rest.q[2, 0], rest.q[2, 2], np.linalg.norm(rest.q[2] - rest.q[5])
    assert rest.stable
    assert 3 * np.arctan2(-z, x) == pytest.approx(x + 100 * (length - 0.9999) / length * 0.6 * z, rel=1e-6)


def test_definite_matrices_are_told_from_others():
    """By the signs of their eigenvalues, which a random congruence keeps (Sylvester)."""
    turn = np.random.default_rng(3).normal(size=(6, 6))
    for signs, definite in (([1] * 6, True), ([1, 1, 1, 1, 1, -1], False), ([-1] * 6, False)):
        matrix = sp.csc_array(turn @ np.diag(np.array(signs, float)) @ turn.T)
        assert (factor_if_definite(matrix) is not None) == definite


def test_the_shape_can_be_differentiated_with_respect_to_stiffness():
    """z = -L - m g/K, so dz/dK = m g/K^2."""
    q = resting_shape(hanging()).q

    def height(stiffness):
        return equilibrium_near(hanging(stiffness), q)[1, 2]

    z, slope = jax.jit(jax.value_and_grad(height))(100.0)
    np.testing.assert_allclose([z, slope], [-1 - 2 * 9.81 / 100, 2 * 9.81 / 100**2], rtol=1e-9)


def test_the_shape_of_a_free_prism_can_be_differentiated():
    """The height by one strut's rest length, against differences of shapes; rigid motions do not matter."""
    scene = Scene(sprung(prism(3)))
    q = resting_shape(scene).q

    def changed(length):
        rest = jnp.asarray(scene.structure.struts.rest_length).at[0].set(length)
        return eqx.tree_at(lambda s: s.structure.struts.rest_length, scene, rest)

    def gap(x):
        return jnp.linalg.norm(x[3:].mean(0) - x[:3].mean(0))

    at, h = float(scene.structure.struts.rest_length[0]), 1e-4
    slope = jax.jit(jax.grad(lambda length: gap(equilibrium_near(changed(length), q))))(at)
    expected = (gap(resting_shape(changed(at + h), q).q) - gap(resting_shape(changed(at - h), q).q)) / (2 * h)
    np.testing.assert_allclose(slope, expected, rtol=1e-5)


def test_rigid_struts_keep_their_length_in_the_derivative_too():
    """A rigid rod of 1 m, pinned at its lower end and held by a cable from the side: the shape minimises U over its
    angle, and so do the derivatives of the angle by the cable's stiffness."""
    nodes = np.array([[0.0, 0, 0], [np.sin(0.3), 0, np.cos(0.3)], [-2.0, 0, 1]])
    rod, cable = Members(((0, 1),), None, [1.0]), Members(((1, 2),), [50.0], [1.5])
    scene = Scene(Structure(nodes, [0.0, 1.0, 0.0], rod, cable, ((0, "xyz"), (1, "y"), (2, "xyz"))), gravity=9.81)

    shape = resting_shape(scene, nodes).q

    def angle(stiffness):
        q = equilibrium_near(eqx.tree_at(lambda s: s.structure.cables.stiffness, scene, stiffness[None]), shape)
        return jnp.arctan2(q[1, 0], q[1, 2])

    def energy(a, stiffness):
        return 9.81 * jnp.cos(a) + stiffness / 2 * (jnp.hypot(jnp.sin(a) + 2, jnp.cos(a) - 1) - 1.5) ** 2

    found, slope = jax.jit(jax.value_and_grad(angle))(jnp.array(50.0))
    torque = jax.grad(energy)
    left, (turned, stiffened) = jax.jit(jax.value_and_grad(torque, (0, 1)))(found, 50.0)
    np.testing.assert_allclose(left, 0, atol=1e-8)
    np.testing.assert_allclose(slope, -stiffened / turned, rtol=1e-8)


@pytest.mark.slow
def test_a_tower_of_600_struts_takes_seconds():
    """Its shape from one that is spoilt is the one it is made for; of its lowest modes none is loose."""
    scene = Scene(sprung(tower(10, 60, overlap=0.0)))
    start = scene.structure.nodes + 0.003 * np.random.default_rng(3).normal(size=scene.structure.nodes.shape)
    found = resting_shape(scene, start)
    assert found.stable
    for members in (scene.structure.struts, scene.structure.cables):
        wanted = edge_lengths(scene.structure.nodes, members.edges)
        np.testing.assert_allclose(edge_lengths(found.q, members.edges), wanted, rtol=1e-6)
    modes = vibration_modes(scene, found.q, count=8)
    assert modes.growing == 0
    assert np.all(modes.frequency > 0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"tension": -1.0}, "tension = -1 N"),
        ({"tension": 50.0, "force_density": np.ones(12)}, "N are left at a node"),
        ({"tension": 50.0, "force_density": -np.ones(12)}, "cable 0 would push"),
    ],
)
def test_stress_that_cannot_be_is_refused(given, message):
    with pytest.raises(InputError, match=message):
        prestressed(sprung(prism(3)), **given)
    with pytest.raises(InputError, match="tolerance = 0 N"):
        resting_shape(hanging(), tolerance=0.0)


def test_equilibrium_near_knows_what_a_motor_has_wound_from_rigid_struts():
    """1 m as built, 0.8 m at t = 0."""
    structure = load_scene("exact").structure
    wound = dataclasses.replace(structure.struts, motors=(Motor(0, [-9.0], [0.8], 1.0),))
    scene = Scene(dataclasses.replace(structure, struts=wound))
    q = resting_shape(scene).q
    lengths = edge_lengths(equilibrium_near(scene, q), structure.struts.edges)
    np.testing.assert_allclose(lengths, [0.8, 1, 1, 1, 1, 1], atol=1e-9)


def test_equilibrium_near_knows_rigid_bodies():
    """A board that hangs from four cables, two of them at points that follow others: its shape, and its derivatives."""
    board = np.array([[0.0, 0, 0], [1.0, 0, 0], [0, 0.6, 0], [0.5, 0.3, -0.2], [1.0, 0.6, 0]])
    above = np.array([[-0.1, 0, 1.0], [1.2, 0, 1.0], [0, 0.7, 1.0], [1.0, 0.7, 1.1]])
    nodes = np.concatenate([board, above])
    body = rigid_body(nodes, range(5), 2.0, [0.1, 0.2, 0.25], [0.45, 0.3, -0.05], basic=(0, 1, 2, 3))
    assert body.carried == (4,)
    cables = Members(((0, 5), (1, 6), (2, 7), (4, 8)), [200.0, 300.0, 250.0, 150.0], [0.8] * 4)
    fixed = tuple((k, "xyz") for k in range(5, 9))
    scene = Scene(Structure(nodes, np.zeros(9), cables=cables, fixed=fixed, bodies=(body,)), 9.81)
    found = resting_shape(scene)
    shape = np.asarray(equilibrium_near(scene, found.q))
    np.testing.assert_allclose(shape, found.q, atol=1e-5)  # where springs keep its shape
    lengths = [math.dist(shape[i], shape[j]) for i, j in itertools.combinations(range(5), 2)]
    built = [math.dist(nodes[i], nodes[j]) for i, j in itertools.combinations(range(5), 2)]
    np.testing.assert_allclose(lengths, built, atol=1e-9)

    def height(x):
        """Of the point that follows, by the weight and one stiffness."""
        bodies = (with_factors(body, mass=x[0], inertia=x[0]),)
        other = eqx.tree_at(lambda s: (s.structure.bodies, s.structure.cables.stiffness), scene, (bodies, x[1]))
        return equilibrium_near(other, found.q)[4, 2]

    at = (jnp.array(1.0), jnp.asarray(cables.stiffness))
    height = jax.jit(height)
    slopes = jax.jit(jax.grad(height))(at)
    step = 1e-4
    for k, (slope, unit) in enumerate(((slopes[0], 1.0), (slopes[1][3], np.eye(4)[3] * 100))):
        low, high = (height((*at[:k], at[k] + s * step * unit, *at[k + 1 :])) for s in (-1, 1))
        np.testing.assert_allclose(slope * (1.0 if k == 0 else 100.0), (high - low) / (2 * step), rtol=1e-5)
        assert abs(slope) > 1e-6

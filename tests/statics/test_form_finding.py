"""Force densities: what is known in closed form of prisms and of the icosahedron, and shapes that carry a stress."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import InputError, edge_lengths
from jaxgrity.statics import (
    equilibrium_matrix,
    group_average,
    nearest_tensegrity,
    prestress,
    prestress_stable,
    rest_lengths,
    shape_of_force_densities,
    statics_of,
    stress_matrix,
    super_stable,
)
from jaxgrity.structures import icosahedron, planar_spine, prism, tetrahedral_spine, tower

SQUARE = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
SIDES, DIAGONALS = ((0, 1), (1, 2), (2, 3), (3, 0)), ((0, 2), (1, 3))


def test_both_matrices_say_the_same_of_equilibrium():
    """A q = (Omega x 1) x, row by row the sum of q_ij (x_i - x_j), for any shape and any force densities."""
    random = np.random.default_rng(0)
    nodes, edges = random.normal(size=(5, 3)), ((0, 1), (1, 2), (2, 4), (3, 0), (4, 1))
    q = random.normal(size=5)
    expected = np.zeros((5, 3))
    for (i, j), density in zip(edges, q):
        expected[i] += density * (nodes[i] - nodes[j])
        expected[j] += density * (nodes[j] - nodes[i])
    np.testing.assert_allclose(equilibrium_matrix(nodes, edges) @ q, expected.ravel(), atol=1e-14)
    np.testing.assert_allclose(stress_matrix(q, edges, 5) @ nodes, expected, atol=1e-14)


def test_icosahedron_has_one_stress_and_one_mechanism():
    """q_strut = -3/2 q_cable, the equilibrium matrix has rank 29 of 30, and the stress stiffens the mechanism."""
    nodes, struts, cables = icosahedron(1.7)
    edges = struts + cables
    found = statics_of(nodes, edges)
    assert (found.rank, found.self_stress.shape, len(found.mechanisms), found.rigid) == (29, (30, 1), 1, 6)
    q = found.self_stress[:, 0]
    np.testing.assert_allclose(q[:6, None] / q[None, 6:], -1.5, rtol=0, atol=1e-12)
    tight = prestress(nodes, struts, cables, tension=5.0)
    np.testing.assert_allclose((tight * edge_lengths(nodes, edges))[6:], 5.0, rtol=1e-9)
    assert prestress_stable(found.mechanisms, edges, tight)
    assert not prestress_stable(found.mechanisms, edges, -tight)
    assert super_stable(nodes, edges, tight)
    assert not super_stable(nodes, edges, -tight)


@pytest.mark.parametrize("n", range(3, 13))
def test_prism_has_the_stress_of_the_closed_form(n):
    """q_vertical/q_polygon = 2 sin(pi/n), q_strut = -q_vertical, rank 4n - 1, 2n - 5 mechanisms, whatever its size."""
    nodes, struts, cables = prism(n, radius=0.7, height=1.1)
    edges = struts + cables
    found = statics_of(nodes, edges)
    assert (found.rank, found.self_stress.shape[1], len(found.mechanisms)) == (4 * n - 1, 1, 2 * n - 5)
    q = found.self_stress[:, 0]
    np.testing.assert_allclose(q[3 * n :] / q[n : 2 * n], 2 * np.sin(np.pi / n), rtol=0, atol=1e-12)
    np.testing.assert_allclose(q[:n] / q[3 * n :], -1, rtol=0, atol=1e-12)
    assert super_stable(nodes, edges, prestress(nodes, struts, cables, 1.0))


def test_mechanisms_change_no_length_to_first_order():
    """They are orthogonal to each other and to rigid motions; with supports they move nothing that is held."""
    nodes, struts, cables = prism(5)
    edges = struts + cables
    fixed = np.zeros((10, 3), bool)
    fixed[:2] = True
    for held in (None, fixed):
        found = statics_of(nodes, edges, held)
        moved = found.mechanisms.reshape(len(found.mechanisms), -1)
        np.testing.assert_allclose(moved @ moved.T, np.eye(len(moved)), atol=1e-12)
        np.testing.assert_allclose(equilibrium_matrix(nodes, edges).T @ moved.T, 0, atol=1e-12)
        if held is None:
            np.testing.assert_allclose(found.mechanisms.sum(1), 0, atol=1e-12)
            np.testing.assert_allclose(np.cross(nodes, found.mechanisms).sum(1), 0, atol=1e-12)
        else:
            np.testing.assert_array_equal(found.mechanisms[:, held], 0)
    assert found.rigid == 1  # a turn about the line through the two nodes that are held


def test_averaging_over_a_group_leaves_the_stress_that_it_leaves_alone():
    """Under a half turn of a spine: what is averaged away is turned over by it."""
    nodes, struts, cables = tetrahedral_spine(2)
    states = statics_of(nodes, struts + cables).self_stress
    # a half turn about z swaps both nodes of each pair, and with them members
    swap = {0: 1, 1: 0, 2: 3, 3: 2, 4: 5, 5: 4, 6: 7, 7: 6}
    number = {frozenset(edge): k for k, edge in enumerate(struts + cables)}
    moved = tuple(number[frozenset((swap[i], swap[j]))] for i, j in struts + cables)
    found = group_average(states, (tuple(range(len(moved))), moved))
    np.testing.assert_allclose(found[list(moved)], found, atol=1e-12)
    np.testing.assert_allclose(equilibrium_matrix(nodes, struts + cables) @ found, 0, atol=1e-12)
    assert 0 < found.shape[1] <= states.shape[1]
    kept = states.T @ found  # whatever lies outside of it is turned over by the swap
    outside = states @ (np.eye(states.shape[1]) - kept @ kept.T)
    np.testing.assert_allclose(outside[list(moved)], -outside, atol=1e-12)


def test_the_most_even_stress_is_found_among_many():
    """A spine has several states: none of its cables is slack, and no other mixture has a larger smallest tension."""
    nodes, struts, cables = tetrahedral_spine(3)
    edges = struts + cables
    length = edge_lengths(nodes, edges)
    q = prestress(nodes, struts, cables, tension=2.0)
    np.testing.assert_allclose(equilibrium_matrix(nodes, edges) @ q, 0, atol=1e-9)
    forces = (q * length)[len(struts) :]
    np.testing.assert_allclose(forces.max(), 2.0, rtol=1e-12)
    states = statics_of(nodes, edges).self_stress
    random = np.random.default_rng(0)
    for _ in range(200):
        other = ((q + states @ random.normal(size=states.shape[1])) * length)[len(struts) :]
        assert other.min() / np.abs(other).max() <= forces.min() / forces.max() + 1e-9


def test_a_structure_without_a_stress_is_refused():
    """A prism that is not turned by its angle; a single cable."""
    nodes, struts, cables = prism(3)
    nodes[3:] = nodes[3:] @ np.array([[np.cos(0.1), np.sin(0.1), 0], [-np.sin(0.1), np.cos(0.1), 0], [0, 0, 1]])
    for structure in ((nodes, struts, cables), (nodes, (), ((0, 1),))):
        with pytest.raises(InputError, match="no self-stress has every cable in tension"):
            prestress(*structure, tension=1.0)


def test_a_cross_in_a_square_is_super_stable():
    """Connelly's (1982): q = 1 on the sides, -1 on the diagonals; of rank 1 = nodes - 3 in a plane."""
    q = np.array([-1.0, -1, 1, 1, 1, 1])
    np.testing.assert_allclose(equilibrium_matrix(SQUARE, DIAGONALS + SIDES) @ q, 0, atol=1e-15)
    assert super_stable(SQUARE, DIAGONALS + SIDES, q)
    assert not super_stable(SQUARE, DIAGONALS + SIDES, -q)


def test_planar_spine_is_stable_in_its_plane_alone():
    """As its docstring says."""
    nodes, struts, cables = planar_spine(3)
    edges = struts + cables
    q = prestress(nodes, struts, cables, 1.0)
    flat = np.zeros((len(nodes), 3), bool)
    flat[:, 1] = True
    assert prestress_stable(statics_of(nodes, edges, flat).mechanisms, edges, q)
    assert not prestress_stable(statics_of(nodes, edges).mechanisms, edges, q)


def test_given_force_densities_decide_the_shape_of_a_net():
    """A node between four supports hangs at their mean, lower by load/(sum of q); the held nodes stay."""
    nodes = np.concatenate([SQUARE, [[0.3, 0.2, 0.5]]])
    fixed = np.repeat([[True], [True], [True], [True], [False]], 3, axis=1)
    edges, q = tuple((4, k) for k in range(4)), np.array([1.0, 2.0, 3.0, 2.0])
    loads = np.zeros((5, 3))
    loads[4, 2] = -4.0
    found = shape_of_force_densities(q, edges, nodes, fixed, loads)
    np.testing.assert_allclose(found[4], [(1.0 - 3.0) / 8, 0, -0.5], atol=1e-15)
    np.testing.assert_array_equal(found[:4], nodes[:4])
    with pytest.raises(InputError, match="the force densities do not decide the shape"):
        shape_of_force_densities(np.array([1.0, -1.0, 0, 0]), edges, nodes, fixed)


@pytest.mark.parametrize("geometry", [prism(4), icosahedron(), tower(3, 2)], ids=["prism", "icosahedron", "tower"])
def test_a_stressed_shape_is_found_near_a_spoilt_one(geometry):
    """Both linear problems hold to rounding, and the shape has moved little more than it was spoilt."""
    nodes, struts, cables = geometry
    spoilt = nodes + 0.02 * np.random.default_rng(1).normal(size=nodes.shape)
    found, q = nearest_tensegrity(spoilt, struts, cables)
    np.testing.assert_allclose(equilibrium_matrix(found, struts + cables) @ q, 0, atol=1e-12)
    assert np.all(q[len(struts) :] > 0)
    assert np.abs(found - spoilt).max() < 0.1


def test_rest_lengths_can_be_differentiated():
    """L = l - q l/K, so dL/dq = -l/K; and a member that would need none is refused."""
    nodes, edges = jnp.array([[0.0, 0, 0], [0, 0, 2.0]]), ((0, 1),)
    stiffness = jnp.array([100.0])
    L, slope = jax.value_and_grad(lambda q: rest_lengths(nodes, edges, stiffness, q)[0])(jnp.array([10.0]))
    np.testing.assert_allclose([L, slope[0]], [1.8, -0.02], rtol=1e-14)
    with pytest.raises(InputError, match="member 0 needs a rest length of -1 m"):
        rest_lengths(np.asarray(nodes), edges, np.array([100.0]), np.array([150.0]))

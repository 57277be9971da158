"""Rigid bodies by basic points: their energy, how forces move them, which points can be basic, and what is refused."""

import dataclasses

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrity import InputError, Members, Scene, Structure
from jaxgrity.model import Body, energy_of_motion, mass_matrix, mobility, momenta, rigid_body, symmetries
from jaxgrity.model.body_points import carrying, independent_nodes
from jaxgrity.model.inertia import along_fixed, borne_by_supports
from jaxgrity.model.rigidity import RigidBodies, rigid_lengths, rigid_pairs
from jaxgrity.stepping.dynamics import angular_momentum, centre_of_mass

INERTIA = {"space": [1.0, 2.0, 2.5], "plate": [1.0, 1.5, 2.5], "rod": [0.0, 1.5, 1.5]}
"""kg m^2 about the principal axes"""


def made(kind: str, turn: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> tuple[Structure, np.ndarray, np.ndarray]:
    """A body of 3 kg with more points than it needs, its inertia turned by that vector, and its centre."""
    points = np.random.default_rng(0).normal(size=(7, 3))
    centre = np.array([0.1, -0.2, 0.3])
    extends = {"space": [1, 1, 1], "plate": [1, 1, 0], "rod": [1, 0, 0]}[kind]
    turned = Rotation.from_rotvec(turn).as_matrix()
    nodes = centre + points * extends @ turned.T
    inertia = turned @ np.diag(INERTIA[kind]) @ turned.T
    body = rigid_body(nodes, range(7), 3.0, inertia, centre)
    return Structure(nodes, np.zeros(7), bodies=(body,)), inertia, centre


@pytest.mark.parametrize("kind", INERTIA)
def test_energy_and_momenta_are_those_of_a_rigid_body(kind):
    """In any pose, of bodies in space, plates and rods: m v^2/2 + w·I w/2, m v and I w."""
    structure, inertia, centre = made(kind, (0.3, 1.0, -0.5))
    w, drift = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.2, -0.1])
    v = drift + np.cross(w, structure.nodes - centre)
    assert float(energy_of_motion(structure, v)) == pytest.approx(1.5 * drift @ drift + w @ inertia @ w / 2, rel=1e-12)
    scene = Scene(structure)
    np.testing.assert_allclose(np.sum(momenta(structure, v), axis=0), 3 * drift, rtol=1e-12)
    np.testing.assert_allclose(centre_of_mass(scene, structure.nodes), centre, rtol=1e-12)
    spin = angular_momentum(scene, structure.nodes - centre, v)
    np.testing.assert_allclose(spin, inertia @ w, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("kind", INERTIA)
def test_forces_at_any_point_move_the_body_by_newton_and_euler(kind):
    """The mobility of the points, with the distances held: F/m and the moment by the inverse of the inertia."""
    structure, inertia, centre = made(kind)
    nodes, body = structure.nodes, structure.bodies[0]
    force = np.random.default_rng(1).normal(size=nodes.shape)
    A = np.einsum("ijk,kl->ikjl", mobility(structure), np.eye(3)).reshape(nodes.size, nodes.size)
    J = RigidBodies((body,), nodes).directions(nodes, 1.0).toarray()
    a = A @ force.ravel()
    a = (a - A @ J.T @ np.linalg.solve(J @ A @ J.T, J @ a)).reshape(nodes.shape)
    turning = np.linalg.pinv(inertia, rcond=1e-9) @ np.cross(nodes - centre, force).sum(0)
    expected = force.sum(0) / 3 + np.cross(turning, nodes - centre)
    np.testing.assert_allclose(a, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_a_strut_with_mass_is_the_body_of_two_points():
    """The same mass matrix and the same mobility."""
    ends = np.array([[0.0, 0, 0], [0.6, 0, 0.8]])
    strut = Structure(ends, np.zeros(2), Members(((0, 1),), None, [1.0], mass=[6.0]))
    along = np.array([0.6, 0, 0.8])
    inertia = 0.5 * (np.eye(3) - np.outer(along, along))
    body = Structure(ends, np.zeros(2), bodies=(rigid_body(ends, (0, 1), 6.0, inertia),))
    np.testing.assert_allclose(mass_matrix(body), mass_matrix(strut), atol=1e-14)
    np.testing.assert_allclose(mobility(body), mobility(strut), atol=1e-14)


def test_basic_points_can_be_chosen_and_change_nothing():
    """Joints and supports need to be basic; the motion that forces make is the same."""
    structure, inertia, centre = made("space")
    chosen = rigid_body(structure.nodes, range(7), 3.0, inertia, centre, basic=(5, 2))
    assert chosen.basic[:2] == (5, 2)
    other = dataclasses.replace(structure, bodies=(chosen,))
    np.testing.assert_allclose(mobility(other), mobility(structure), rtol=1e-9, atol=1e-12)
    N = carrying(other.bodies, 7)
    np.testing.assert_allclose(N @ structure.nodes[sorted(chosen.basic)], structure.nodes, atol=1e-12)


def test_supports_take_what_acts_at_points_that_follow():
    """With the weights by which these follow."""
    structure, inertia, centre = made("space")
    node = 5
    body = rigid_body(structure.nodes, range(7), 3.0, inertia, centre, basic=(node,))
    pinned = dataclasses.replace(structure, bodies=(body,), fixed=((node, "xyz"),))
    force = np.random.default_rng(2).normal(size=(7, 3))
    row = independent_nodes(pinned.bodies, 7).index(node)
    np.testing.assert_allclose(
        borne_by_supports(pinned, force)[node], (carrying(pinned.bodies, 7).T @ force)[row], rtol=1e-12
    )
    np.testing.assert_array_equal(along_fixed(pinned, force)[node], force[node])


def test_mass_and_inertia_have_derivatives():
    """So that a fit can find them: of the energy, against that of a rigid body."""
    structure, inertia, centre = made("space")
    w = np.array([1.0, -2.0, 0.5])
    v = np.cross(w, structure.nodes - centre) + 1.0

    def energy(mass, inertia):
        body = rigid_body(structure.nodes, range(7), mass, inertia, centre)
        return energy_of_motion(dataclasses.replace(structure, bodies=(body,)), v)

    by_mass, by_inertia = jax.grad(energy, (0, 1))(3.0, np.asarray(inertia))
    assert float(by_mass) == pytest.approx(1.5, rel=1e-12)
    np.testing.assert_allclose(np.diag(by_inertia), w**2 / 2, rtol=1e-10)


def test_symmetries_are_those_of_the_inertia():
    """A box of corners has eight; with other inertia about one axis, and with its own at a corner, fewer."""
    corners = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])[[0, 3, 5, 6]]
    count = lambda inertia: len(  # noqa: E731
        symmetries(Structure(corners, np.zeros(4), bodies=(rigid_body(corners, range(4), 1.0, inertia),)))
    )
    assert [count([1.0, 1.0, 1.0]), count([1.0, 1.0, 0.8]), count([1.0, 0.9, 0.8])] == [24, 8, 4]


SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])


@pytest.mark.parametrize(
    ("words", "how"),
    [
        ("do not say where the body is; expected four points not in a plane", {"nodes": SQUARE}),
        ("no body has this inertia", {"inertia": [1.0, 1.0, 3.0]}),
        ("no body has this inertia", {"inertia": [[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]]}),
        ("lies 1 m beside the plane", {"inertia": [1.0, 1.0, 2.0]}),
        ("beside the line", {"inertia": [0.0, 1.0, 1.0]}),
        ("mass = 0 kg: expected a positive number", {"mass": 0.0}),
        ("expected both above 0", {"inertia": [0.0, 0.0, 0.0]}),
        ("inertia has shape", {"inertia": [1.0, 1.0]}),
        (r"points\[3\] = 7: expected a whole number from 0 to 4", {"points": (0, 1, 2, 7)}),
        ("expected some, the basic ones too", {"basic": (4,)}),
    ],
)
def test_what_is_no_body_is_refused(words, how):
    """By name, with what was found."""
    given = {"nodes": TETRAHEDRON, "points": range(4), "mass": 1.0, "inertia": [1.0] * 3, "centre": np.zeros(3)} | how
    with pytest.raises(InputError, match=words):
        rigid_body(**given)


def test_points_that_follow_belong_to_one_body_and_are_free():
    """Where a support or another body holds a node, it has to be basic."""
    body = rigid_body(TETRAHEDRON, range(5), 1.0, [1.0] * 3)
    (carried,) = body.carried
    with pytest.raises(InputError, match=rf"expected rigid_body\(..., basic=\({carried},\)\)"):
        Structure(TETRAHEDRON, np.zeros(5), bodies=(body,), fixed=((carried, "xyz"),))
    with pytest.raises(InputError, match="a point of another body too"):
        Structure(TETRAHEDRON, np.zeros(5), bodies=(body, body))
    with pytest.raises(InputError, match="has node 4; expected 0 to 3"):
        Structure(TETRAHEDRON[:4], np.ones(4), bodies=(body,))
    with pytest.raises(InputError, match="weights has shape"):
        Body(body.points, body.matrix, np.zeros((2, 4)), body.lengths)


def test_two_points_that_are_held_keep_their_distance_anyway():
    """It is no constraint beside those of the supports: a body on a hinge has five."""
    nodes = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0.5, 0], [0.3, 0.5, 0.8]])
    body = rigid_body(nodes, (0, 1, 2, 3), 2.0, [0.2, 0.3, 0.4], [0.5, 0.5, 0.2], basic=(0, 1))
    hinge = Structure(nodes, np.zeros(4), bodies=(body,), fixed=((0, "xyz"), (1, "xyz")))
    free = Structure(nodes, np.zeros(4), bodies=(body,), fixed=((0, "xyz"), (1, "xz")))
    assert len(rigid_pairs(Scene(free))) == 6
    assert set(rigid_pairs(Scene(free))) - set(rigid_pairs(Scene(hinge))) == {(0, 1)}
    assert len(rigid_lengths(Scene(hinge), 0.0)) == 5

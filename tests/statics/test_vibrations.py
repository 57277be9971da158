"""Vibrations with supports, prestress and members' mass, against a published tower and against closed forms."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    InputError,
    Members,
    PenaltyGround,
    Scene,
    SolverOptions,
    Structure,
    edge_lengths,
    load_scene,
    simulate,
)
from jaxgrity.model import mass_matrix
from jaxgrity.statics import prestressed, resting_shape, sparse_mass_matrix, vibration_modes, vibrations
from jaxgrity.statics.stiffness import rigid_motions, stiffness_matrix
from jaxgrity.structures import prism, tower

BOTH_ENDS = ((0, "xyz"), (2, "xyz"))
"""supports of three nodes in a row"""


def test_published_tower_has_its_18_frequencies(published_tower, tower_answers):
    """To 8 digits: members' mass spread along them, three nodes held, the stress that is given."""
    modes = vibration_modes(Scene(published_tower))
    np.testing.assert_allclose(modes.frequency, tower_answers["natural_frequencies_Hz"], rtol=1e-8)
    assert modes.growing == 0
    assert not np.any(modes.shapes[:, tower_answers["fixed_nodes"]])


def test_modes_are_orthogonal_with_respect_to_mass(published_tower):
    """shape' M shape = 1 and shape' K shape = (2 pi f)^2, each with itself alone."""
    scene = Scene(published_tower)
    modes = vibration_modes(scene)
    x = modes.shapes.reshape(len(modes.shapes), -1)
    np.testing.assert_allclose(x @ (sparse_mass_matrix(scene.structure) @ x.T), np.eye(18), atol=1e-9)
    K = x @ (stiffness_matrix(scene, scene.structure.nodes) @ x.T)
    np.testing.assert_allclose(K, np.diag((2 * np.pi * modes.frequency) ** 2), atol=1e-8 * np.abs(K).max())


def test_without_member_mass_they_are_those_of_the_dense_hessian(reference):
    """A free robot: the same 30 numbers, of sqrt(eig(M^-1 d2U/dq2)) / 2 pi, but for its six rigid motions.

    The pose is no equilibrium: turns cost energy there, and both spectra differ by what the rigid motions take with
    them. The shape in which it rests is one.
    """
    scene = Scene(reference.structure)
    q = resting_shape(scene).q
    hessian = jax.jit(jax.hessian(scene.potential_energy))(jnp.asarray(q), 0.0).reshape(q.size, q.size)
    mass = np.repeat(reference.structure.node_mass, 3)
    squares = np.linalg.eigvalsh(hessian / np.sqrt(np.outer(mass, mass)))
    found = vibration_modes(scene, q)
    assert len(found.frequency) == 30
    expected = np.sqrt(np.maximum(np.sort(squares)[-30:], 0)) / (2 * np.pi)
    np.testing.assert_allclose(found.frequency, expected, rtol=1e-7, atol=1e-4)


def test_mass_spread_along_a_rod_has_its_kinetic_energy():
    """v' M v/2 = m/6 (v_p.v_p + v_p.v_q + v_q.v_q): m v^2/2 moved, m L^2/24 w^2 turned about its middle."""
    rod = Members(((0, 1),), np.ones(1), np.ones(1), mass=np.array([3.0]))
    M = sparse_mass_matrix(Structure(np.array([[0.0, 0, 0], [2, 0, 0]]), np.array([0.25, 0]), struts=rod))
    moved, turned = np.tile([0.0, 2, 0], 2), np.array([0.0, -1, 0, 0, 1, 0])
    np.testing.assert_allclose(moved @ (M @ moved) / 2, (3 + 0.25) * 4 / 2, rtol=1e-15)
    np.testing.assert_allclose(turned @ (M @ turned) / 2, 3 * 2**2 / 24 + 0.25 / 2, rtol=1e-15)


def test_the_sparse_mass_matrix_is_the_dense_one(published_tower):
    """One from sums over members, the other by differentiating the kinetic energy."""
    expected = mass_matrix(published_tower)
    np.testing.assert_allclose(sparse_mass_matrix(published_tower).toarray(), expected, rtol=1e-13, atol=1e-15)


def test_a_taut_string_vibrates_as_its_tension_says():
    """One mass between two supports: across, (2 pi f)^2 = 2 F/(a m), and along, 2 K/m, whatever supports it has."""
    K, rest, m = 50.0, 0.8, 0.3
    cables = Members(((0, 1), (1, 2)), np.full(2, K), np.full(2, rest))
    structure = Structure(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.full(3, m), cables=cables, fixed=BOTH_ENDS)
    found = vibration_modes(Scene(structure)).frequency
    expected = np.sqrt([2 * K * (1 - rest) / m, 2 * K * (1 - rest) / m, 2 * K / m]) / (2 * np.pi)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_an_unstable_shape_has_growing_modes():
    """A mass that two compressed struts hold: it gives way to both sides."""
    struts = Members(((0, 1), (1, 2)), np.full(2, 50.0), np.full(2, 1.2))
    structure = Structure(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.ones(3), struts=struts, fixed=BOTH_ENDS)
    found = vibration_modes(Scene(structure))
    assert found.growing == 2
    np.testing.assert_array_equal(found.frequency > 0, [False, False, True])


def test_sparse_and_dense_solvers_agree(monkeypatch):
    """The lowest modes of a free tower, which has six rigid motions and mechanisms that the stress alone holds."""
    geometry = tower(3, 4, 0.3)
    struts = Members(geometry.struts, np.full(12, 2e4), np.full(12, 0.66))
    cables = Members(geometry.cables, np.full(len(geometry.cables), 500.0), np.full(len(geometry.cables), 0.2))
    scene = Scene(Structure(geometry.nodes, np.linspace(0.1, 0.2, 24), struts, cables))
    dense = vibration_modes(scene, count=10)
    monkeypatch.setattr(vibrations, "DENSE", 0)
    sparse = vibration_modes(scene, count=10)
    assert sparse.growing == dense.growing
    np.testing.assert_allclose(sparse.frequency, dense.frequency, rtol=1e-6)


def hollow_tower(rigid: bool, fixed=()) -> Scene:
    """With mass in its cables, slack at two nodes. One hangs on a strut; a compressed strut ends at the other."""
    geometry = tower(3, 4, 0.3)
    lengths = [edge_lengths(geometry.nodes, edges) for edges in (geometry.struts, geometry.cables)]
    ends = geometry.struts[0][0], geometry.struts[-1][1]
    slack = np.isin(geometry.cables, ends).any(1)
    compression = np.where(np.arange(12) == 11, 1e-7 if rigid else 1e-2, 0.0)
    struts = Members(geometry.struts, None if rigid else np.full(12, 2e4), (1 + compression) * lengths[0])
    rest, count = np.where(slack, 1.1, 0.9) * lengths[1], len(geometry.cables)
    cables = Members(geometry.cables, np.full(count, 500.0), rest, mass=np.full(count, 0.01))
    return Scene(Structure(geometry.nodes, np.linspace(0.1, 0.2, 24), struts, cables, fixed=fixed))


@pytest.mark.parametrize("rigid", [False, True])
@pytest.mark.parametrize("fixed", [(), ((3, "xyz"), (4, "xz"))])
def test_the_ends_of_the_spectrum_are_those_of_all_modes(monkeypatch, rigid, fixed):
    """Counted by pivots and found beside shifts, in a shape where some motions grow and some meet no resistance."""
    scene = hollow_tower(rigid, fixed)
    q, unreal = np.asarray(scene.structure.nodes), 12 if rigid else 0
    dense, few = vibrations.frequency_range(scene, q, unreal), vibration_modes(scene, q, count=4)
    monkeypatch.setattr(vibrations, "DENSE", 0)
    sparse, also_few = vibrations.frequency_range(scene, q, unreal), vibration_modes(scene, q, count=4)
    assert dense.zero == sparse.zero > 0
    np.testing.assert_allclose(sparse[1:], dense[1:], rtol=1e-6)
    assert (also_few.zero, also_few.growing) == (few.zero, few.growing)
    assert few.growing > 0


def test_many_motions_without_resistance_are_found_and_counted(monkeypatch):
    """Three prisms beside each other: the twelve rigid motions of two of them, more than are asked for."""
    geometry, apart = prism(3), np.array([5.0, 0, 0])
    nodes = np.concatenate([geometry.nodes + k * apart for k in range(3)])
    edges = [tuple((i + 6 * k, j + 6 * k) for k in range(3) for i, j in e) for e in (geometry.struts, geometry.cables)]
    struts, cables = (Members(e, np.full(len(e), K), np.ones(len(e))) for e, K in zip(edges, (2e3, 500.0)))
    structure = Structure(nodes, np.linspace(0.3, 0.5, 18), struts, cables)
    scene = Scene(prestressed(structure, 40.0))
    dense = vibration_modes(scene)
    monkeypatch.setattr(vibrations, "DENSE", 0)
    sparse = vibration_modes(scene, count=10)
    assert dense.zero == sparse.zero == 12
    np.testing.assert_array_equal(sparse.frequency, 0)
    x = sparse.shapes.reshape(10, -1)
    np.testing.assert_allclose(x @ (sparse_mass_matrix(scene.structure) @ x.T), np.eye(10), atol=1e-9)
    assert abs(stiffness_matrix(scene, nodes) @ x.T).max() < 1e-3


def test_rigid_motions_are_those_that_supports_leave():
    """Six; three turns about a held node, one about a held line, none about three nodes; moves along a rail."""
    q = np.random.default_rng(0).normal(size=(5, 3))
    for held, left in ((0, 6), (1, 3), (2, 1), (3, 0)):
        fixed = np.zeros((5, 3), bool)
        fixed[:held] = True
        assert rigid_motions(q, fixed).shape == (15 - 3 * held, left)
    on_floor = np.zeros((5, 3), bool)
    on_floor[:, 2] = True
    assert rigid_motions(q, on_floor).shape == (10, 3)


def test_motion_of_a_mode_is_a_sine(published_tower):
    """Its largest displacement is the amplitude, a quarter of a period after it passes the equilibrium."""
    modes = vibration_modes(Scene(published_tower), count=2)
    q, period = np.asarray(published_tower.nodes), 1 / modes.frequency[1]
    frames = modes.motion(q, 1, amplitude=0.5, times=np.array([0, period / 4, period / 2]))
    moved = np.linalg.norm(frames - q, axis=2).max(1)
    np.testing.assert_allclose(moved, [0, 0.5, 0], atol=1e-12)


@pytest.mark.slow
def test_a_rollout_about_the_equilibrium_swings_as_the_mode_says():
    """A prism let go from a small displacement along its slowest mode: cos(2 pi f t) of it, for two periods."""
    geometry = prism(3)
    struts = Members(geometry.struts, np.full(3, 2e3), np.ones(3))
    cables = Members(geometry.cables, np.full(9, 500.0), np.ones(9))
    structure = prestressed(Structure(geometry.nodes, np.linspace(0.3, 0.5, 6), struts, cables), 40.0)
    modes = vibration_modes(Scene(structure), count=1)
    start = modes.motion(structure.nodes, 0, 1e-6, np.array([0.25 / modes.frequency[0]]))[0]
    released = dataclasses.replace(structure, nodes=start)
    swung = simulate(Scene(released), 2 / modes.frequency[0], options=SolverOptions(method="dopri8", rtol=1e-11))
    size = np.sum((np.asarray(swung.positions) - structure.nodes) * (start - structure.nodes), axis=(1, 2))
    expected = np.cos(2 * np.pi * modes.frequency[0] * np.asarray(swung.times))
    np.testing.assert_allclose(size / size[0], expected, atol=1e-4)


def test_what_hangs_swings_and_what_stands_on_soft_ground_rocks():
    """A mass under a strut: sqrt(g/l) both ways, growing where it stands on it. Two masses on ground of stiffness k:
    2 k/m for each, up and down together and in turn."""
    strut = Members(((0, 1),), np.array([1e4]), np.ones(1))
    for side in (-1.0, 1.0):
        structure = Structure(np.array([[0.0, 0, 0], [0, 0, side]]), np.array([0.0, 2.0]), strut, fixed=((0, "xyz"),))
        q = resting_shape(Scene(structure, gravity=9.81)).q
        found = vibration_modes(Scene(structure, gravity=9.81), q)
        assert found.growing == (0 if side < 0 else 2)
        expected = np.sqrt(9.81 / abs(q[1, 2])) / (2 * np.pi) if side < 0 else 0
        np.testing.assert_allclose(found.frequency[:2], expected, rtol=1e-9)
    lying = Structure(np.array([[0.0, 0, -0.01], [1, 0, -0.01]]), np.full(2, 2.0), strut)
    found = vibration_modes(Scene(lying, gravity=9.81, ground=PenaltyGround(2 * 9.81 / 0.01)))
    np.testing.assert_allclose(found.frequency[:2], np.sqrt(9.81 / 0.01) / (2 * np.pi), rtol=1e-9)


def test_rigid_struts_are_compressed_as_built():
    """A robot of rigid struts is at rest in its own shape: modes there are those where stiff springs are at rest."""
    scene = Scene(load_scene("exact").structure)
    at_rest = vibration_modes(scene, resting_shape(scene).q, count=8)
    np.testing.assert_allclose(vibration_modes(scene, count=8).frequency, at_rest.frequency, rtol=1e-5)


@pytest.mark.parametrize("given", [{"count": 0}, {"count": -1}, {"q": np.full((3, 3), np.nan)}])
def test_arguments_that_mean_nothing_are_refused(given):
    string = Structure(np.eye(3), np.ones(3), cables=Members(((0, 1), (1, 2)), np.ones(2), np.ones(2)))
    with pytest.raises(InputError, match=next(iter(given))):
        vibration_modes(Scene(string), **given)

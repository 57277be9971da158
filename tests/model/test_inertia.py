"""Rods with mass and supports: kinetic energy, mass matrix, frequencies, and what is refused."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import InputError, Members, Structure, describe, parse_scene
from jaxgrity.model import energy_of_motion, mass_matrix, mobility, momenta, rigid_body, symmetries, with_mass_at_ends
from jaxgrity.model.inertia import accelerations, along_fixed, rod_inertia


def test_kinetic_energy_is_that_of_mass_spread_along_a_rod():
    """Summed over 100,000 slices of a rod whose ends move anyhow."""
    rng = np.random.default_rng(0)
    x, v, m = rng.normal(size=(2, 3)), rng.normal(size=(2, 3)), 3.0
    rod = Structure(x, np.zeros(2), Members(((0, 1),), None, np.ones(1), mass=np.array([m])))
    s = (np.arange(100_000) + 0.5)[:, None] / 100_000
    speeds = (1 - s) * v[0] + s * v[1]
    assert float(energy_of_motion(rod, jnp.array(v))) == pytest.approx(m / 2 * np.mean(np.sum(speeds**2, 1)), rel=1e-9)


def test_mass_at_the_ends_of_rods_turns_three_times_as_hard():
    """Mass and centre stay; a rod of mass m and length L has m L^2/4 about its centre. Bodies stay as they are."""
    x = np.random.default_rng(0).normal(size=(7, 3))
    rods = Members(((0, 1), (2, 3)), None, np.linalg.norm(x[[0, 2]] - x[[1, 3]], axis=1), mass=[2.0, 0.5])
    cables = Members(((0, 2), (1, 3)), [9.0, 9.0], [1.0, 1.0], mass=[0.1, 0.2])
    body = rigid_body(x, (4, 5, 6, 0), 3.0, [0.4, 0.5, 0.6], basic=(0,))
    structure = Structure(x, [0.1, 0, 0, 0.2, 0, 0, 0], rods, cables, bodies=(body,))
    light = with_mass_at_ends(structure)
    assert light.rod_masses == ()
    np.testing.assert_allclose(light.node_mass, [1.15, 1.1, 0.3, 0.55, 0, 0, 0])
    np.testing.assert_allclose(light.lumped_mass, structure.lumped_mass)
    assert light.bodies == structure.bodies
    alone = Structure(x[:2], [0.0, 0.0], Members(((0, 1),), None, rods.rest_length[:1], mass=[2.0]))
    v = np.cross([0.3, -0.4, 0.5], x[:2] - x[:2].mean(0))
    turning = [energy_of_motion(each, jnp.asarray(v)) for each in (alone, with_mass_at_ends(alone))]
    assert float(turning[1] / turning[0]) == pytest.approx(3)
    assert with_mass_at_ends(light) is light


def test_the_moment_of_inertia_of_a_rod_with_its_end_nodes_is_that_of_its_energy():
    """About the centre of mass, T = I w^2/2 for a turn w, with the mass along the rod and at its ends."""
    x, ends, omega = np.array([[0.0, 0, 0], [0.8, 0, 0]]), np.array([0.4, 1.3]), 0.7
    rod = Structure(x, ends, Members(((0, 1),), None, [0.8], mass=[2.0]))
    for structure, moved in ((rod, False), (with_mass_at_ends(rod), True)):
        v = np.cross([0, 0, omega], x - (np.asarray(structure.lumped_mass) @ x / structure.mass))
        inertia = rod_inertia(np.array([2.0]), ends[None], np.array([0.8]), moved)
        np.testing.assert_allclose(
            inertia * omega**2 / 2, float(energy_of_motion(structure, jnp.asarray(v))), rtol=1e-6
        )


def test_momenta_are_the_mass_matrix_times_velocities(published_tower):
    """And a force along a free coordinate accelerates as the inverse of the free part says."""
    v = np.random.default_rng(1).normal(size=published_tower.nodes.shape)
    M = np.asarray(mass_matrix(published_tower))
    np.testing.assert_allclose(np.ravel(momenta(published_tower, v)), M @ v.ravel(), rtol=1e-12)
    free = published_tower.free.ravel()
    force = np.random.default_rng(2).normal(size=published_tower.nodes.shape)
    a = np.asarray(accelerations(published_tower, force)).ravel()
    assert np.all(a[~free] == 0)
    np.testing.assert_allclose(M[np.ix_(free, free)] @ a[free], force.ravel()[free], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(along_fixed(published_tower, force).ravel(), np.where(free, 0, force.ravel()))


def test_nodes_alone_have_the_diagonal_mass_matrix(reference):
    """Without rods that have mass, and the response is its inverse."""
    structure = reference.structure
    np.testing.assert_array_equal(mass_matrix(structure), np.diag(np.repeat(structure.node_mass, 3)))
    assert not structure.needs_mobility
    assert structure.lumped_mass is structure.node_mass
    np.testing.assert_allclose(mobility(structure)[..., 0], np.diag(1 / structure.node_mass), rtol=1e-15)


def test_supports_leave_fewer_symmetries():
    """A square of nodes with one that is fixed along the diagonal's axis alone keeps fewer maps than a free one."""
    nodes = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1]])
    free = Structure(nodes, np.ones(5))
    assert len(symmetries(free)) == 8
    assert len(symmetries(dataclasses.replace(free, fixed=((0, "xyz"),)))) == 2
    every = tuple((node, "xyz") for node in range(4))
    assert len(symmetries(dataclasses.replace(free, fixed=every))) == 8
    assert len(symmetries(dataclasses.replace(free, fixed=tuple((node, "x") for node in range(4))))) == 4


TEXT = """
[structure]
kind = "custom"
nodes = [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
struts = [[0, 1], [1, 2]]
fixed = FIXED
[struts]
rigid = true
mass = [1.0, 2.0]
[gravity]
"""


def test_scene_files_have_rods_with_mass_and_supports():
    """Whole nodes by their number, and some of their axes; node masses may be left out."""
    scene = parse_scene(TEXT.replace("FIXED", '[0, { node = 2, axes = "xz" }]'))
    assert scene.structure.fixed == ((0, "xyz"), (2, "xz"))
    np.testing.assert_array_equal(scene.structure.lumped_mass, [0.5, 1.5, 1.0])
    described = describe(scene)
    assert "node 0, node 2 along xz" in described
    assert "mass 1 to 2 kg" in described


@pytest.mark.parametrize(
    ("fixed", "message"),
    [
        ("[7]", "structure.fixed names node 7; expected 0 to 2"),
        ("[1, 1]", "expected each node once"),
        ('[{ node = 2, axes = "w" }]', "node 2 is fixed along 'w'; expected some of x, y and z"),
        ("[{ node = 1 }]", r"structure.fixed\[0\].axes: missing"),
    ],
)
def test_supports_that_make_no_sense_are_refused(fixed, message):
    """In one line."""
    with pytest.raises(InputError, match=message):
        parse_scene(TEXT.replace("FIXED", fixed))


def test_a_node_without_any_mass_is_refused():
    """Unless it is fixed."""
    text = TEXT.replace("FIXED", "[0]").replace("[1.0, 2.0]", "[1.0, 0.0]")
    with pytest.raises(InputError, match=r"node_mass\[2\] = 0: no member there has mass either"):
        parse_scene(text)


def test_the_force_on_a_node_moves_others_through_a_rod():
    """The derivative of the response by a rod's mass agrees with finite differences, in both modes."""

    def end(m):
        rod = Members(((0, 1),), None, np.ones(1), mass=m * jnp.ones(1))
        structure = Structure(np.eye(2, 3), np.array([0.5, 0.1]), rod)
        return accelerations(structure, jnp.array([[1.0, 2, 3], [0, 0, 0]]))[1, 2]

    slope = (end(2.0 + 1e-6) - end(2.0 - 1e-6)) / 2e-6
    assert float(jax.jvp(end, (2.0,), (1.0,))[1]) == pytest.approx(float(slope), rel=1e-7)
    assert float(jax.grad(end)(2.0)) == pytest.approx(float(slope), rel=1e-7)

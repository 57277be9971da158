"""Sliding nodes in statics: shapes at rest, small motions and small loads, as few coordinates without springs say."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import minimize

from jaxgrity import Members, Scene, Structure
from jaxgrity.model import LoadCase, Slides, rigid_body
from jaxgrity.statics import (
    equilibrium_near,
    load_report,
    resting_shape,
    settled,
    static_response,
    stiffness_matrix,
    vibration_modes,
)
from jaxgrity.statics.slide_springs import springs_for
from jaxgrity.stepping.linearised import linearise

ROD, BEAD, G, AT = 2.0, 0.5, 9.81, 0.6
"""kg, kg, m/s^2, and m from the pivot of the rod to the bead"""
NODES = np.array([[0, 0, 0], [1.0, 0, 0], [AT, 0, 0], [1.0, 0, 1.0], [-1.0, 0, 0], [3.0, 0, 0]])
K, REST = np.array([400.0, 50.0, 30.0]), np.array([1 - (ROD / 2 + AT * BEAD) * G / 400.0, 1.3, 1.9])
"""N/m and m, of cables from the end of the rod and from the bead to supports: at rest with a level rod"""


@pytest.fixture(scope="module")
def level():
    """A rigid rod on a pivot that carries a bead. Cables hold both."""
    rod = Members(((0, 1),), None, [1.0], mass=[ROD])
    fixed = tuple((k, "xyz" if k in (0, 3, 4, 5) else "y") for k in range(6))
    structure = Structure(NODES, [0, 0, BEAD, 0, 0, 0], rod, Members(((1, 3), (2, 4), (2, 5)), K, REST), fixed=fixed)
    return Scene(structure, gravity=G, terms=(Slides((2,), ((0, 1),)),))


def energy(y, bead=BEAD, push=0.0, down=0.0, g=G):
    """U less the work of a push along x and a pull down at the bead, J: of the rod's angle and the bead's place."""
    along = jnp.array([jnp.cos(y[0]), 0, jnp.sin(y[0])])
    ends = jnp.stack([along, y[1] * along, y[1] * along])
    springs = jnp.sum(K * (jnp.linalg.norm(ends - NODES[3:], axis=1) - REST) ** 2) / 2
    work = push * y[1] * along[0] - down * y[1] * along[2]
    return springs + (ROD / 2 + bead * y[1]) * g * along[2] - work


LEVEL = jnp.array([0.0, AT])
curvature_of = jax.jit(jax.hessian(energy))
"""N/m and so on, of both coordinates"""


def test_modes_are_those_of_both_coordinates(level):
    """The weight on the rod counts: it makes the bead slide as the rod leans. Then come motions of stiff springs."""
    curvature = curvature_of(LEVEL)
    assert abs(curvature[0, 1]) > 1
    rates = eigh(curvature, np.diag([ROD / 3 + BEAD * AT**2, BEAD]), eigvals_only=True)
    frequency = vibration_modes(level).frequency
    np.testing.assert_allclose(frequency[:2], np.sqrt(rates) / (2 * np.pi), rtol=1e-5)
    assert frequency[2] > 100 * frequency[1]


def test_small_loads_lean_the_rod(level):
    """By the slope of the two coordinates."""
    loads = np.zeros((6, 3))
    loads[1, 2], loads[2, 0] = 0.1, 0.2
    lean, along = np.linalg.solve(curvature_of(LEVEL), [0.1, 0.2])
    found = static_response(level, NODES, loads).displacement
    np.testing.assert_allclose(found[1:3], [[0, 0, lean], [along, 0, AT * lean]], atol=1e-7)


def test_derivatives_of_a_shape_are_those_of_both_coordinates(level):
    """By the bead's mass, a push and gravity."""

    def shape(x):
        structure = dataclasses.replace(level.structure, node_mass=jnp.zeros(6).at[2].set(x[0]))
        loads = jnp.zeros((6, 3)).at[2, 0].set(x[1])
        q = equilibrium_near(dataclasses.replace(level, structure=structure, gravity=x[2]), NODES, loads)
        return jnp.array([q[1, 2], q[2, 0]])

    x = jnp.array([BEAD, 0.0, G])
    slopes = jax.jit(jax.jacobian(lambda x: jax.grad(energy)(LEVEL, x[0], x[1], 0.0, x[2])))(x)
    expected = -np.linalg.solve(curvature_of(LEVEL), slopes)
    np.testing.assert_allclose(jax.jit(jax.jacobian(shape))(x), expected, rtol=1e-8, atol=1e-12)


@pytest.mark.slow
def test_a_load_path_is_that_of_both_coordinates(level):
    """To the point at which the cable that the bead leaves behind is the only one: the other goes slack."""
    report = load_report(level, LoadCase("aside", (2,), [[20.0, 0, -5.0]]), most=2.0)
    y = minimize(jax.jit(lambda y: energy(y, push=20.0, down=5.0)), [0, AT], tol=1e-14).x
    along = np.array([np.cos(y[0]), 0, np.sin(y[0])])
    np.testing.assert_allclose(report.shape[1:3], [along, y[1] * along], atol=3e-6)
    np.testing.assert_allclose(report.reactions.sum(0), [-20, 0, (ROD + BEAD) * G + 5], atol=1e-6)
    assert [event.what for event in report.path] == ["goes slack"]


def beside() -> Scene:
    """A box whose corner, which follows others, slides along a spring, and a bead on its edge; cables pull at them."""
    box = np.array([[x, y, z] for x in (0, 0.5) for y in (0, 0.3) for z in (0, 0.2)])
    across = np.array([0.3, -0.5, 0.7])
    nodes = np.concatenate([box, [box[7] + 0.4 * across, box[7] - 0.6 * across, 0.7 * box[3] + 0.3 * box[7]]])
    body = rigid_body(nodes, range(8), 2.0, [0.022, 0.048, 0.057], basic=(0, 1, 2, 4))
    assert {3, 7} <= set(body.carried)
    structure = Structure(
        nodes,
        np.r_[np.zeros(8), 0.6, 0.4, 0.3],
        Members(((8, 9),), [300.0], [0.8]),
        Members(((8, 0), (10, 9), (10, 1)), [40.0, 30.0, 50.0], [0.3, 0.4, 0.2]),
        bodies=(body,),
    )
    return Scene(structure, terms=(Slides((7, 10), ((8, 9), (3, 7))),))


@pytest.mark.slow
def test_a_settled_robot_is_on_its_lines():
    """To rounding, at rest, and with the small motions that it has in steps: springs and bodies have lines, free."""
    scene = settled(beside()).scene
    q = np.asarray(scene.structure.nodes)
    assert scene.terms[0].gaps(q, 0.0).max() < 1e-9
    slope = np.asarray(jax.grad(scene.potential_energy)(jnp.asarray(q), 0.0))
    assert np.abs(slope).max() > 1
    found = vibration_modes(scene)
    small = np.sort(np.abs(np.linalg.eigvals(linearise(scene, (q, 0 * q)).stiffness))) ** 0.5 / (2 * np.pi)
    assert found.growing == found.zero == 0
    np.testing.assert_allclose(found.frequency[:5], small[6:], rtol=1e-4)
    given = resting_shape(scene)
    assert given.stable
    assert np.abs(given.q - q).max() < 1e-4


def test_springs_in_place_of_slides_have_the_hessian_of_their_energy(level):
    """Blocks of three nodes beside those of members, of the whole U."""
    springs = dataclasses.replace(springs_for(level.terms[0], 70.0), offset=np.array([[0.1, 0.2, -0.3]]))
    scene = dataclasses.replace(level, terms=(springs,))
    q = NODES + 0.1 * np.random.default_rng(0).normal(size=NODES.shape)
    expected = jax.jit(jax.hessian(scene.potential_energy))(jnp.asarray(q), 0.0).reshape(18, 18)
    np.testing.assert_allclose(stiffness_matrix(scene, q).toarray(), expected, atol=1e-9)

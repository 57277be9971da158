"""Small loads on structures at rest: against closed forms, and against the shape that the loads lead to."""

import dataclasses

import jax
import numpy as np
import pytest

from jaxgrity import Gait, InputError, Members, Motor, Scene, Structure, force_table
from jaxgrity.statics import member_forces, resting_shape, static_response

BOTH_ENDS = ((0, "xyz"), (2, "xyz"))
"""supports of three nodes in a row"""


@pytest.fixture(scope="module")
def robot(reference):
    """The six-strut robot by itself, at rest."""
    scene = Scene(reference.structure)
    return scene, resting_shape(scene).q


def test_a_string_gives_way_as_its_stiffness_says():
    """A node between two supports, in one line: along it u = f/2K, across it u = f a/2F; both ends' tension changes."""
    K, rest = 50.0, 0.8
    cables = Members(((0, 1), (1, 2)), np.full(2, K), np.full(2, rest))
    scene = Scene(Structure(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.ones(3), cables=cables, fixed=BOTH_ENDS))
    loads = np.array([[0.0, 0, 0], [4, 0, 3], [0, 0, 0]])
    found = static_response(scene, scene.structure.nodes, loads)
    np.testing.assert_allclose(found.displacement[1], [4 / (2 * K), 0, 3 / (2 * K * (1 - rest))], rtol=1e-12)
    np.testing.assert_allclose(found.force_change, [2, -2], rtol=1e-12)
    np.testing.assert_allclose(found.slack_margin, K * (1 - rest) / 2, rtol=1e-12)
    np.testing.assert_allclose(found.compliance, (16 / (2 * K) + 9 / (2 * K * (1 - rest))) / 25, rtol=1e-12)


def test_forces_are_those_that_each_cable_has_at_the_start():
    """A node between two cables that a gait has shortened from 0.8 m to 0.72 m, on the table's slope of 500 N/m.

    They pull with 10 + 500 * 0.18 N; along them each takes half of the load. Motors wind to 0.7 m in place of the gait.
    """
    x = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    cables = Members(((0, 1), (1, 2)), np.full(2, 100.0), np.full(2, 0.8))
    structure = Structure(x, np.ones(3), cables=cables, fixed=BOTH_ENDS)
    gait = Gait((0, 1), np.zeros(2), np.full(2, 0.2), np.ones(2), start=-9.0)
    scene = Scene(structure, gait=gait, terms=(force_table(cables, [0.0, 0.1, 0.3], [0.0, 10.0, 110.0]),))
    found = static_response(scene, x, np.array([[0.0, 0, 0], [4, 0, 0], [0, 0, 0]]))
    np.testing.assert_allclose(found.force_change, [2, -2], rtol=1e-12)
    np.testing.assert_allclose(found.slack_margin, 100 / 2, rtol=1e-12)
    motors = tuple(Motor(k, np.full(1, -9.0), np.full(1, 0.7), rate=1.0) for k in range(2))
    wound = dataclasses.replace(structure, cables=dataclasses.replace(cables, motors=motors))
    np.testing.assert_allclose(member_forces(wound, x), 100 * 0.3, rtol=1e-12)


def test_small_loads_lead_where_the_shape_at_rest_goes(robot):
    """The response is the derivative of the shape, and of all forces, by the size of the loads."""
    scene, q = robot
    loads = (q - q.mean(0)) * [1.0, 1.0, -2.0]
    found = static_response(scene, q, loads)
    h = 1e-3
    ends = [resting_shape(scene, q, loads=sign * h * loads).q for sign in (1, -1)]
    forces = [member_forces(scene.structure, x) for x in ends]
    np.testing.assert_allclose((forces[0] - forces[1]) / (2 * h), found.force_change, atol=1e-4)
    lengths = [np.linalg.norm(x[:, None] - x, axis=2) for x in ends]
    d = q[:, None] - q
    moved = found.displacement[:, None] - found.displacement
    expected = np.sum(d * moved, axis=2) / (np.linalg.norm(d, axis=2) + np.eye(12))
    np.testing.assert_allclose((lengths[0] - lengths[1]) / (2 * h), expected, atol=1e-6)


def test_loads_that_nothing_balances_are_refused(robot):
    """A push in one direction on a free robot; a load across cables without tension."""
    scene, q = robot
    with pytest.raises(InputError, match="loads: they do not balance"):
        static_response(scene, q, np.ones(q.shape))
    with pytest.raises(InputError, match=r"loads has shape \(2, 3\)"):
        static_response(scene, q, np.ones((2, 3)))
    cables = Members(((0, 1), (1, 2)), np.ones(2), np.ones(2))
    loose = Scene(Structure(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.ones(3), cables=cables, fixed=BOTH_ENDS))
    with pytest.raises(InputError, match="loads: nothing resists them"):
        static_response(loose, loose.structure.nodes, np.array([[0.0, 0, 0], [0, 1, 0], [0, 0, 0]]))


def test_what_hangs_gives_way_to_the_side():
    """A mass on a strut: u = f l/(m g). Loads on supports alone, or that are not numbers, are refused."""
    strut = Members(((0, 1),), np.array([1e4]), np.ones(1))
    structure = Structure(np.array([[0.0, 0, 0], [0, 0, -1]]), np.array([0.0, 2.0]), strut, fixed=((0, "xyz"),))
    scene = Scene(structure, gravity=9.81)
    q, loads = resting_shape(scene).q, np.array([[0.0, 0, 0], [0.1, 0, 0]])
    found = static_response(scene, q, loads)
    np.testing.assert_allclose(found.displacement[1], [-0.1 * q[1, 2] / (2 * 9.81), 0, 0], rtol=1e-9, atol=1e-15)
    for bad in (loads[::-1], np.nan * loads):
        with pytest.raises(InputError, match="expected finite numbers, and a load on a coordinate that no support"):
            static_response(scene, q, bad)
    with pytest.raises(InputError, match="static_response: its numbers have to be known"):
        jax.jit(lambda f: static_response(scene, q, f).displacement)(loads)

"""Bodies with more joints than basic points, or with joints in a plane: legs of several parallel hinges."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxgrity import (
    InputError,
    Members,
    SolverOptions,
    Structure,
    edge_lengths,
    final_state,
    load_scene,
    parse_scene,
    save_scene,
    simulate,
)
from jaxgrity.model import rigid_body, symmetries, travelling_waves
from jaxgrity.model.joints import joined_bodies
from jaxgrity.stepping import resolve

LEG = """
[structure]
kind = "custom"
height = 1.0
nodes = [[0, -0.1, 0], [0, 0.1, 0], [0.3, -0.1, 0], [0.3, 0.1, 0], [0.15, 0, 0.1],
         [0.7, 0, 0], [0.5, 0.0, 0.1], [0.5, 0.0, -0.1]]
fixed = [0, 1]
[gravity]
[[bodies]]
nodes = [0, 1, 2, 3, 4]
mass = 1.2
inertia = [0.01, 0.02, 0.015]
centre = [0.15, 0.0, 0.0]
[[bodies]]
nodes = [2, 3, 5, 6, 7]
mass = 0.8
inertia = [0.01, 0.03, 0.025]
centre = [0.5, 0.0, 0.0]
"""


def swung(duration):
    """Both angles, rad, of the double pendulum, which starts level, by its equations of motion, to rounding."""
    m, far, arms, inertia = (1.2, 0.8), 0.3, (0.15, 0.2), (0.02, 0.03)

    def slope(_, y):
        a, b, u, w = y  # below the level
        c, s = np.cos(a - b), np.sin(a - b)
        coupled = m[1] * far * arms[1]
        M = [
            [inertia[0] + m[0] * arms[0] ** 2 + m[1] * far**2, coupled * c],
            [coupled * c, inertia[1] + m[1] * arms[1] ** 2],
        ]
        pull = 9.81 * np.array([(m[0] * arms[0] + m[1] * far) * np.cos(a), m[1] * arms[1] * np.cos(b)])
        return np.r_[u, w, np.linalg.solve(M, pull + coupled * s * np.array([-(w**2), u**2]))]

    return solve_ivp(slope, (0, duration), np.zeros(4), method="DOP853", rtol=1e-12, atol=1e-13).y[:2, -1]


@pytest.mark.slow
def test_a_leg_of_two_parallel_hinges_swings_as_a_double_pendulum():
    """At second order; all four points of the upper body's hinges are in a plane, so that one of them is pinned."""
    scene, duration = parse_scene(LEG), 0.6
    upper, lower = scene.structure.bodies
    ((pinned, *three),) = upper.pinned
    assert pinned in (2, 3)
    assert {2, 3} - {pinned} <= set(three)  # the lower body holds this distance, too
    assert pinned in lower.basic
    a, b = swung(duration)
    knee = np.array([0.3 * np.cos(a), 0, 1.1 - 0.3 * np.sin(a)])  # the lowest node is at 1 m
    end = knee + np.array([0.4 * np.cos(b), 0, -0.4 * np.sin(b)])
    errors = []
    for dt in (1e-3, 5e-4):
        q = np.asarray(simulate(scene, duration, options=SolverOptions(dt=dt), frame_rate=1 / duration).positions[-1])
        errors.append(np.abs(np.stack([q[2] - knee, q[3] - knee, q[5] - end]) - HINGE[:, None] * [0, 1, 0]).max())
        np.testing.assert_allclose(np.linalg.norm(q[2] - q[3]), 0.2, atol=1e-12)
    assert errors[1] < 1e-5
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)


HINGE = np.array([-0.1, 0.1, 0.0])
"""m, along the hinge, of the nodes whose places are compared"""


@pytest.mark.slow
def test_derivatives_go_through_pins():
    """With respect to mass, against differences."""
    scene = parse_scene(LEG)
    options = resolve(scene, 0.2)

    @jax.jit
    def height(scale):
        matrix = lambda s: s.structure.bodies[0].matrix  # noqa: E731
        return final_state(eqx.tree_at(matrix, scene, matrix(scene) * scale), 0.2, options)[0][5, 2]

    difference = (height(1 + 1e-5) - height(1 - 1e-5)) / 2e-5
    assert float(jax.jit(jax.grad(height))(1.0)) == pytest.approx(float(difference), rel=1e-6)


def test_a_file_keeps_them(tmp_path):
    """The same basic and pinned points, and the same numbers."""
    scene = parse_scene(LEG)
    save_scene(scene, tmp_path / "leg.toml")
    for body, again in zip(scene.structure.bodies, load_scene(tmp_path / "leg.toml").structure.bodies):
        assert (again.points, again.pinned) == (body.points, body.pinned)
        np.testing.assert_allclose(again.matrix, body.matrix, rtol=0, atol=1e-14)


def test_what_holds_no_joint_is_refused():
    """A flat body has three joints at most; a pinned node is a basic point elsewhere, or fixed."""
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1]])
    with pytest.raises(InputError, match="without extent along an axis has at most 3 joints and supports"):
        rigid_body(x, range(4), 1.0, [1.0, 1.0, 2.0], basic=range(4))
    body = rigid_body(x, range(5), 1.0, [1.0] * 3, basic=range(4))
    assert [pin[0] for pin in body.pinned] == [3]
    with pytest.raises(InputError, match="node 3 is pinned, and is neither fixed along all axes"):
        Structure(x, np.zeros(5), bodies=(body,))
    held = Structure(x, np.zeros(5), bodies=(body,), fixed=((3, "xyz"),))
    assert held.bodies[0].edges[-3:] == tuple((3, other) for other in body.pinned[0][1:])
    with pytest.raises(InputError, match="expected the last points, each with three others"):
        dataclasses.replace(body, pinned=((0, 1, 2, 4),))


def test_near_joints_are_basic_where_all_of_them_can_be():
    """Of a straight body, a plate and one in space, whose joints are near to a line or plane."""
    line = np.array([[0.0, 0, 0], [0.04, 0, 0], [1, 0, 0]])
    assert set(rigid_body(line, range(3), 1.0, [0.0, 0.1, 0.1], basic=(0, 1)).basic) == {0, 1}
    plate = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0.04, 0], [0.5, 1, 0]])
    assert set(rigid_body(plate, range(4), 1.0, [0.1, 0.1, 0.2], basic=(0, 1, 2)).basic) == {0, 1, 2}
    space = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.4, 0.4, 0.04], [0, 0, 1]])
    body = rigid_body(space, range(5), 1.0, [1.0] * 3, basic=range(4))
    assert (set(body.basic), body.pinned) == ({0, 1, 2, 3}, ())


def test_nodes_that_are_held_along_some_axes_are_basic():
    """They have no mass but that of their body, so that they cannot be pinned to it."""
    text = LEG.replace("fixed = [0, 1]", 'fixed = [{node = 0, axes = "z"}, {node = 1, axes = "z"}]')
    upper, _ = parse_scene(text).structure.bodies
    assert {0, 1} <= set(upper.basic)
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1]])
    body = rigid_body(x, range(5), 1.0, [1.0] * 3, basic=range(4))
    with pytest.raises(InputError, match="node 3 is pinned, and is neither fixed along all axes"):
        Structure(x, np.zeros(5), bodies=(body,), fixed=tuple((k, "z") for k in range(4)))


def two_legs(mass: float = 0.4) -> Structure:
    """A trunk with a leg on a hinge at each end, whose four points lie in a plane; cables lead from leg to trunk."""
    hinge = np.array([[0.3, -0.1, 0], [0.3, 0.1, 0], [0.5, 0.02, -0.3], [0.45, -0.05, -0.25]])
    nodes = np.concatenate([hinge, hinge * [-1, -1, 1], [[0, 0, 0.2]]])
    inertia = np.array([[0.02, 0.001, 0], [0.001, 0.03, 0], [0, 0, 0.04]])
    leg = np.array([[0.01, 0.001, 0.002], [0.001, 0.012, 0.0], [0.002, 0.0, 0.009]])
    turn = np.diag([-1.0, -1.0, 1.0])
    middle = hinge.mean(0)
    points = [0, 1, 4, 5, 8], [0, 1, 2, 3], [4, 5, 6, 7]
    parts = (1.0, inertia, np.zeros(3)), (0.4, leg, middle), (mass, turn @ leg @ turn.T, turn @ middle)
    bodies = joined_bodies(points, (), lambda k, basic: rigid_body(nodes, points[k], *parts[k], basic=basic))
    edges = ((2, 8), (6, 8), (3, 8), (7, 8))
    cables = Members(edges, np.full(4, 100.0), 0.9 * edge_lengths(nodes, edges))
    return Structure(nodes, np.zeros(9), cables=cables, bodies=bodies)


def test_symmetries_map_basic_points_on_pinned_ones():
    """Half a turn exchanges the legs, and the pinned point with a basic one; not if one leg is heavier."""
    structure = two_legs()
    (pin,) = structure.bodies[0].pinned
    image = {0: 4, 1: 5, 4: 0, 5: 1}[pin[0]]
    assert image in structure.bodies[0].basic
    turned = symmetries(structure, mirrors=False)
    assert [symmetry.nodes for symmetry in turned] == [tuple(range(9)), (4, 5, 6, 7, 0, 1, 2, 3, 8)]
    waves = travelling_waves(structure, (0, 1, 2, 3))
    assert [wave.shifts for wave in waves] == [(0.0, 0.5, 0.0, 0.5)]
    assert len(symmetries(two_legs(0.41), mirrors=False)) == 1

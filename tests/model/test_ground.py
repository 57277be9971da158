"""The two kinds of ground: what they are made of, and what is no ground."""

import numpy as np
import pytest

from jaxgrity import Box, ExactGround, InputError, PenaltyGround, Union
from jaxgrity.model.surface import Slope


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
@pytest.mark.parametrize("name", ["stiffness", "dissipation"])
def test_penalty_ground_without_stiffness_or_with_zero_dissipation_is_refused(name, value):
    """Its contact law divides by the dissipation: None stands for one that is not modelled."""
    numbers = {"stiffness": 1e4, "dissipation": 2.0, name: value}
    expected = "a finite number" if np.isnan(value) else "a positive number"
    absent = ", or None where it is not modelled" if name == "dissipation" and value == 0 else ""
    with pytest.raises(InputError, match=rf"ground\.{name} = {value:g}.*: expected {expected}{absent}$"):
        PenaltyGround(**numbers)


@pytest.mark.parametrize("restitution", [-0.1, 1.1, np.nan])
def test_restitution_is_a_share(restitution):
    """Of the speed at which a node hits the ground."""
    expected = "a finite number" if np.isnan(restitution) else "a number from 0 to 1"
    with pytest.raises(InputError, match=rf"ground\.restitution = {restitution}: expected {expected}"):
        ExactGround(restitution=restitution)


@pytest.mark.parametrize("incline", [0.0, 0.3, -1.2])
def test_normal_and_tangents_are_orthonormal(incline):
    """The first tangent goes down the slope, which falls towards +x; the second is level."""
    ground = ExactGround(incline)
    axes = np.array([ground.normal, *ground.tangents])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    assert np.sign(ground.tangents[0][2]) == -np.sign(incline)
    assert ground.tangents[1][2] == 0
    np.testing.assert_allclose(ground.signed_distance(np.array([ground.normal])), [1.0], rtol=1e-15)


def test_what_each_ground_answers_by(reference, exact):
    """Forces that follow from positions and velocities, or impulses that do not."""
    q = np.asarray(reference.structure.nodes) - [0, 0, 0.03]
    pressed = np.asarray(reference.ground.normal_force(q, 0 * q))
    np.testing.assert_allclose(pressed[pressed > 0], 1e4 * 0.01, rtol=1e-9)
    assert np.count_nonzero(pressed) == 3
    assert exact.ground.normal_force(q, 0 * q) is None
    assert not reference.ground.impulsive
    assert exact.ground.impulsive


def test_a_body_is_set_down_at_an_edge_where_normals_push_it_to_and_fro(exact):
    """And refused where its nodes are nowhere."""
    ground = ExactGround(surface=Union((Slope(), Box([0.3, 0.2, 0.15], [0.3, 0.4, 0.5]))))
    nodes = np.asarray(exact.structure.nodes)
    for depth in (-0.02, 0.0, 0.001):
        assert ground.measured(ground.set_down(nodes, depth)).distance.min() == pytest.approx(-depth, abs=1e-6)
    with pytest.raises(InputError, match=r"the lowest node cannot be set down .* expected finite nodes, and ground"):
        ground.set_down(np.nan * nodes, 0.0)
    with pytest.raises(InputError, match="depth = nan m: expected a finite number"):
        ground.set_down(nodes, np.nan)


@pytest.mark.parametrize("distance", [0.02, -0.01])
def test_a_body_beside_all_ground_keeps_its_height(exact, distance):
    """A lone box is not below it, and there is no height at which a node is in it."""
    ground = ExactGround(surface=Box([5.0, 0.0, 0.0], [1.0, 1.0, 1.0]))
    nodes = np.asarray(exact.structure.nodes)
    np.testing.assert_allclose(ground.set_above(nodes, distance), nodes, atol=1e-12)

"""Forces along a trajectory: what springs say, what carries the weight, and what exact contact leaves over."""

import dataclasses

import numpy as np
import pytest

import jaxgrity

STANDING = 3.0
"""s, after which a robot that nothing moves stands still"""


def still(scene):
    """With a gait that moves nothing: other tests simulate these robots with gaits, by the same programs."""
    return jaxgrity.with_gait(scene, dataclasses.replace(scene.gait, amplitude=np.zeros(6)))


@pytest.fixture(scope="module")
def standing():
    """By scenes' names: the robot, its trajectory and the forces in it."""
    found = {}
    # stable steps that are not checked: nothing is compiled but rollouts
    for name, dt in (("reference", 5e-4), ("exact", 5e-3)):
        scene = still(jaxgrity.load_scene(name))
        options = jaxgrity.SolverOptions(dt=dt, any_step=True)
        trajectory = jaxgrity.simulate(scene, STANDING, frame_rate=20.0, options=options)
        found[name] = scene, trajectory, jaxgrity.forces_along(scene, trajectory)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", ["reference", "exact"])
def test_the_ground_carries_the_weight(standing, name):
    """Of a robot at rest, by three nodes, straight up; each node is in balance."""
    scene, trajectory, forces = standing[name]
    weight = float(scene.structure.mass) * float(scene.gravity)
    np.testing.assert_allclose(forces.ground[-1].sum(0), [0, 0, weight], atol=0.05 * weight)
    assert (forces.ground[-1, :, 2] > 1).sum() == 3
    structure, q = scene.structure, np.asarray(trajectory.positions[-1])
    net = forces.ground[-1] - [0, 0, 1] * (np.asarray(structure.node_mass) * float(scene.gravity))[:, None]
    for (i, j), pull in zip((*structure.struts.edges, *structure.cables.edges), forces.tension[-1]):
        along = pull * (q[j] - q[i]) / np.linalg.norm(q[j] - q[i])
        net[i] += along
        net[j] -= along
    np.testing.assert_allclose(net, 0, atol=0.02 * weight)


@pytest.mark.slow
def test_springs_pull_by_their_law(standing):
    """K (l - L) of cables at rest, and none below zero; struts push."""
    scene, trajectory, forces = standing["reference"]
    cables = scene.structure.cables
    lengths = jaxgrity.edge_lengths(trajectory.positions[-1], cables.edges)
    expected = np.maximum(0, cables.stiffness * (lengths - cables.rest_length))
    np.testing.assert_allclose(forces.tension[-1, 6:], expected, atol=0.2)
    assert (forces.tension[-1, :6] < 0).all()


@pytest.mark.slow
def test_rigid_struts_carry_what_stiff_ones_do(standing):
    """The same robot on both contact models, standing: within what soft struts give way."""
    exact, soft = (standing[name][2].tension[-1, :6] for name in ("exact", "reference"))
    np.testing.assert_allclose(exact, soft, rtol=0.05)


def test_a_falling_robot_feels_no_ground(exact):
    """Nothing touches; the struts carry the prestress alone."""
    nodes = np.asarray(exact.structure.nodes) + np.array([0, 0, 100.0])
    options = jaxgrity.SolverOptions(dt=5e-3, any_step=True)
    high = dataclasses.replace(still(exact), structure=dataclasses.replace(exact.structure, nodes=nodes))
    forces = jaxgrity.forces_along(high, jaxgrity.simulate(high, STANDING, frame_rate=20.0, options=options))
    assert not forces.ground.any()
    assert (forces.tension[:, :6] < -100).all()

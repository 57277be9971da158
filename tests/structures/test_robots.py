"""Robots of rigid bodies: what they are made of, that they carry a stress, and that they stand."""

import dataclasses

import numpy as np
import pytest

from jaxgrity import InputError, SolverOptions, Structure, edge_lengths, energy_audit, parse_scene
from jaxgrity.model import body_moments
from jaxgrity.structures import Robot, hinged_spine

ROBOTS = {"hinged_spine": hinged_spine()}
MIRRORS = {"hinged_spine": "xy"}
"""the axes along which each robot may be mirrored"""
TEXT = """
[structure]
kind = "KIND"
prestress = 30.0
[cables]
stiffness = 2000.0
damping = 5.0
[gravity]
[damping]
node = 0.05
[ground]
contact = "complementarity"
[friction]
kind = "cone"
mu = 0.5
"""


def moments(robot: Robot) -> tuple[float, np.ndarray]:
    """Mass and centre of all bodies."""
    each = [body_moments(body, robot.nodes)[:2] for body in robot.bodies]
    mass = sum(m for m, _ in each)
    return mass, sum(m * centre for m, centre in each) / mass


def tensions(structure: Structure) -> np.ndarray:
    """N, of the cables."""
    cables = structure.cables
    return cables.stiffness * (edge_lengths(structure.nodes, cables.edges) - cables.rest_length)


def test_hinged_spine_has_the_moments_of_its_cylinders():
    """Three of 0.2 kg, 0.3 m wide and high; neighbours share the two ends of a hinge."""
    robot = hinged_spine(3, 0.3, 0.2)
    assert len(robot.nodes) == 20
    for k, body in enumerate(robot.bodies):
        mass, centre, inertia = body_moments(body, robot.nodes)
        assert mass == pytest.approx(0.2, rel=1e-12)
        np.testing.assert_allclose(centre, [0, 0, 0.3 * (k + 0.5)], atol=1e-12)
        across, along = 0.2 * (3 * 0.15**2 + 0.3**2) / 12, 0.2 * 0.15**2 / 2
        np.testing.assert_allclose(inertia, np.diag([across, across, along]), atol=1e-15)
    for first, second in zip(robot.bodies, robot.bodies[1:]):
        assert len(set(first.points) & set(second.points)) == 2


@pytest.mark.parametrize("kind", ROBOTS)
def test_robots_have_their_mirror_symmetries(kind):
    """Nodes, cables and bodies have an image each."""
    robot = ROBOTS[kind]
    for axis in MIRRORS[kind]:
        mirrored = robot.nodes * np.where(np.array(list("xyz")) == axis, -1, 1)
        gaps = np.linalg.norm(mirrored[:, None] - robot.nodes, axis=2)
        image = gaps.argmin(1)
        assert gaps.min(1).max() < 1e-12
        sets = lambda groups: {frozenset(image[list(group)].tolist()) for group in groups}  # noqa: B023, E731
        assert sets(robot.cables) == set(map(frozenset, robot.cables))
        assert sets(body.points for body in robot.bodies) == {frozenset(body.points) for body in robot.bodies}


def test_cables_on_both_sides_of_a_hinge_pull_alike():
    """They have equal arms, so all have the tension that the tightest one has."""
    structure = parse_scene(TEXT.replace("KIND", "hinged_spine")).structure
    np.testing.assert_allclose(tensions(structure), 30, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ROBOTS)
def test_robots_stand(kind):
    """Pushed aside for a moment: energy and momentum balance, bodies keep their shape, cables stay taut."""
    push = f"[[pushes]]\nnodes = [{len(ROBOTS[kind].nodes) // 2}]\nforce = [0.5, 0.3, 0]\nstart = 0.1\nduration = 0.1\n"
    scene = parse_scene(TEXT.replace("KIND", kind) + push)
    audit = energy_audit(scene, 1.0, options=SolverOptions(dt=2e-3))
    structure, q = scene.structure, audit.positions
    moved = np.abs(q - q[0]).max()
    assert 1e-4 < moved < 0.1 * np.ptp(structure.nodes[:, 2])
    assert np.abs(audit.residual).max() < 1e-2 * audit.turned_over
    assert audit.momentum_residual.max() < 1e-6 * float(structure.mass) * scene.gravity  # of the weight, in 1 s
    for body in structure.bodies:
        lengths = lambda x: np.linalg.norm(x[:, None] - x, axis=2)  # noqa: E731
        points = list(body.points)
        np.testing.assert_allclose(lengths(q[-1][points]), lengths(structure.nodes[points]), atol=1e-9)
    for each in q:
        assert tensions(dataclasses.replace(structure, nodes=each)).min() > 0


@pytest.mark.parametrize(("make", "message"), [(lambda: hinged_spine(1), "vertebrae = 1: expected at least 2")])
def test_numbers_that_make_no_robot_are_refused(make, message):
    """In one line, with the value received."""
    with pytest.raises(InputError, match=message):
        make()

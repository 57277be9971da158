"""Robots of rigid bodies: what they are made of, that they carry a stress, and that they stand."""

import dataclasses

import numpy as np
import pytest

from jaxgrity import (
    InputError,
    Scene,
    SolverOptions,
    Structure,
    edge_lengths,
    energy_audit,
    load_scene,
    parse_scene,
    save_scene,
)
from jaxgrity.model import body_moments
from jaxgrity.structures import RobotGeometry, capped_robot, hinged_spine, quadruped, superball

ROBOTS = {
    "hinged_spine": hinged_spine(),
    "quadruped": quadruped(),
    "capped_robot": capped_robot(),
    "superball": superball(),
}
MIRRORS = {"hinged_spine": "xy", "quadruped": "y", "capped_robot": "xyz", "superball": "xyz"}
"""the axes along which each robot may be mirrored"""
PRESTRESS = {"hinged_spine": 30.0, "quadruped": 30.0, "capped_robot": 60.0, "superball": 200.0}
"""N"""
TEXT = """
[structure]
kind = "KIND"
prestress = PRESTRESS
pose = "POSE"
[cables]
stiffness = 2000.0
damping = DAMPING
[gravity]
[damping]
node = 0.05
[ground]
contact = "complementarity"
[friction]
kind = "cone"
mu = 0.5
"""


SLOPE = """
contact = "complementarity"
incline = 0.2
"""
ROD = """
[[bodies]]
nodes = [0, 1]
mass = 0.1
inertia = [0.0, 0.1, 0.1]
"""


def standing(kind: str, more: str = "") -> Scene:
    """The robot on level ground; those of six rods stand on a triangle."""
    pose = "strut" if kind in ("hinged_spine", "quadruped") else "face"
    given = {"KIND": kind, "POSE": pose, "PRESTRESS": str(PRESTRESS[kind]), "DAMPING": str(PRESTRESS[kind] / 6)}
    text = TEXT
    for word, value in given.items():
        text = text.replace(word, value)
    return parse_scene(text + more)


def moments(robot: RobotGeometry) -> tuple[float, np.ndarray]:
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


@pytest.mark.parametrize(("kind", "payload"), [("capped_robot", 0.5), ("superball", None)])
def test_rods_have_the_moments_of_their_parts(kind, payload):
    """Two solid balls at the ends of a thin rod of 2 m, in every direction; the payload is a solid ball."""
    rod, cap, r = 0.6, 0.2, 0.03 * 2
    robot = capped_robot(2.0, rod, cap, payload) if payload else superball(2.0, rod, cap)
    mass, centre = moments(robot)
    assert mass == pytest.approx(6 * (rod + 2 * cap) + (payload or 0), rel=1e-12)
    np.testing.assert_allclose(centre, 0, atol=1e-12)
    along = 2 * 0.4 * cap * r**2
    for k, body in enumerate(robot.bodies[:6]):
        _, middle, inertia = body_moments(body, robot.nodes)
        np.testing.assert_allclose(middle, robot.nodes[[2 * k, 2 * k + 1]].mean(0), atol=1e-12)
        expected = np.full(3, along + rod * 2**2 / 12 + 2 * cap)
        expected[k // 2] = along
        np.testing.assert_allclose(inertia, np.diag(expected), atol=1e-12)
    if payload:
        _, _, inertia = body_moments(robot.bodies[6], robot.nodes)
        np.testing.assert_allclose(inertia, np.eye(3) * 0.4 * payload * (0.08 * 2) ** 2, atol=1e-12)
    np.testing.assert_array_equal(robot.balls.radius, np.full(12, r))


def test_quadruped_has_the_moments_of_its_parts():
    """In units of the width: vertebrae with their middles 2/3 apart from 1/2 on, legs at 1 and at 7/3, 1 long."""
    width, vertebra, leg = 0.4, 0.5, 0.2
    mass, centre = moments(quadruped(3, width, vertebra, leg))
    assert mass == pytest.approx(3 * vertebra + 4 * leg, rel=1e-12)
    x = vertebra * (3 / 2 + 2) + 2 * leg * (1 + 7 / 3)
    np.testing.assert_allclose(centre, np.array([x, 0, -4 * leg / 2]) * width / mass, atol=1e-12)


def test_cables_end_beside_the_axes_of_rods():
    """At rims 3 % of a rod's length beside them, or at spools as far beside and 10 % before the end, then at an end."""
    for robot, inward, both in ((capped_robot(), 0.0, True), (superball(1.0), 0.1, False)):
        for cable in robot.cables[:24]:
            for place, node in enumerate(cable):
                (body,) = (k for k, body in enumerate(robot.bodies) if node in body.points)
                axis = body // 2
                beside, along = np.delete(robot.nodes[node] - robot.nodes[2 * body], axis), robot.nodes[node][axis]
                spooled = both or place == 0
                assert np.linalg.norm(beside) == pytest.approx(0.03 if spooled else 0.0, abs=1e-12)
                assert abs(along) == pytest.approx(0.5 - (inward if spooled else 0.0), rel=1e-12)


@pytest.mark.parametrize("kind", ["quadruped", "capped_robot", "superball"])
def test_the_cables_of_each_body_balance(kind):
    """Forces and moments, at the tension asked for; symmetric robots have one tension for each kind of cables."""
    structure = standing(kind).structure
    nodes, forces = np.asarray(structure.nodes), tensions(structure)
    i, j = np.transpose(structure.cables.edges)
    pulls = forces[:, None] * (nodes[j] - nodes[i]) / edge_lengths(nodes, structure.cables.edges)[:, None]
    at_nodes = np.zeros(nodes.shape)
    np.add.at(at_nodes, i, pulls)
    np.add.at(at_nodes, j, -pulls)
    for body in structure.bodies:
        own = list(body.points)
        np.testing.assert_allclose(at_nodes[own].sum(0), 0, atol=1e-9)
        np.testing.assert_allclose(np.cross(nodes[own], at_nodes[own]).sum(0), 0, atol=1e-9)
    assert forces.max() == pytest.approx(PRESTRESS[kind], rel=1e-9)
    if kind == "quadruped":
        assert forces.min() > 0.3 * PRESTRESS[kind]
    else:
        np.testing.assert_allclose(forces[:24], PRESTRESS[kind], rtol=1e-9)
        np.testing.assert_allclose(forces[24:], PRESTRESS[kind] / 2, rtol=1e-9)


def test_scene_files_hold_robots(tmp_path):
    """Their balls touch the ground at the height asked for, also on a slope; they are written, held and extended."""
    scene = standing("quadruped")
    save_scene(scene, tmp_path / "robot.toml")
    again = load_scene(tmp_path / "robot.toml")
    np.testing.assert_array_equal(again.structure.nodes, scene.structure.nodes)
    for found in (scene, again):
        assert found.ground.balls.nodes == (12, 13, 14, 15)
        np.testing.assert_allclose(found.ground.balls.radius, 0.01)
        np.testing.assert_allclose(found.structure.nodes[12:, 2], 0.01, atol=1e-12)
    slope = parse_scene('[structure]\nkind = "quadruped"\n[cables]\nstiffness = 1.0\n[ground]\n' + SLOPE)
    gaps = slope.ground.balls.gaps(slope.structure.nodes @ [np.sin(0.2), 0, np.cos(0.2)])
    assert gaps.min() == pytest.approx(0, abs=1e-12)
    held = parse_scene('[structure]\nkind = "capped_robot"\nfixed = [3]\n[cables]\nstiffness = 1.0\n' + ROD).structure
    assert len(held.bodies) == 8
    assert 3 in held.bodies[1].basic
    assert {0, 1} == set(held.bodies[7].basic)


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
    structure = standing("hinged_spine").structure
    np.testing.assert_allclose(tensions(structure), 30, rtol=1e-9)


SIZES = {kind: pytest.mark.slow if kind == "superball" else pytest.mark.campaign for kind in ROBOTS}


@pytest.mark.campaign
@pytest.mark.parametrize("kind", [pytest.param(kind, marks=SIZES[kind]) for kind in ROBOTS])
def test_robots_stand(kind):
    """Pushed aside for a moment: energy and momentum balance, bodies keep their shape, cables stay taut."""
    weight = 9.81 * moments(ROBOTS[kind])[0]
    push = f"[[pushes]]\nnodes = [{len(ROBOTS[kind].nodes) // 2}]\nstart = 0.1\nduration = 0.1\n"
    scene = standing(kind, f"{push}force = [{0.2 * weight}, {0.1 * weight}, 0]\n")
    audit = energy_audit(scene, 1.0, options=SolverOptions(dt=2e-3))
    structure, q = scene.structure, audit.positions
    moved = np.abs(q - q[0]).max()
    assert 1e-4 < moved < 0.1 * np.ptp(structure.nodes[:, 2])
    assert np.abs(audit.residual).max() < 1e-2 * audit.turned_over
    assert audit.momentum_residual.max() < 1e-6 * weight  # for 1 s
    for body in structure.bodies:
        lengths = lambda x: np.linalg.norm(x[:, None] - x, axis=2)  # noqa: E731
        points = list(body.points)
        np.testing.assert_allclose(lengths(q[-1][points]), lengths(structure.nodes[points]), rtol=1e-6, atol=1e-12)
    for each in q:
        assert tensions(dataclasses.replace(structure, nodes=each)).min() > 0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: hinged_spine(1), "vertebrae = 1: expected a whole number, at least 2"),
        (lambda: hinged_spine(2, -0.1), "height = -0.1 m: expected a positive number"),
        (lambda: quadruped(1), "vertebrae = 1: expected a whole number, at least 2"),
        (lambda: quadruped(leg_mass=0.0), "leg_mass = 0 kg: expected a positive number"),
        (lambda: capped_robot(payload_mass=-1.0), "payload_mass = -1 kg: expected a positive number"),
        (lambda: superball(np.inf), "strut_length = inf m: expected a positive number"),
    ],
)
def test_numbers_that_make_no_robot_are_refused(make, message):
    """In one line, with the value received."""
    with pytest.raises(InputError, match=message):
        make()

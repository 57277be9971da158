"""Rigid bodies in statics: the same counts, forces and modes as with trusses of struts in their places."""

import itertools

import numpy as np
import pytest
import scipy

from jaxgrity import EnergyTerm, Gait, Members, Motor, Scene, Structure, parse_scene
from jaxgrity.model import LoadCase, rigid_body
from jaxgrity.statics import (
    inspect_structure,
    load_report,
    member_forces,
    resting_shape,
    static_response,
    statics_of,
    vibration_modes,
)

SPINE = """
[structure]
kind = "tetrahedral_spine"
vertebrae = 2
mass = 0.8
prestress = 40.0
[struts]
rigid = true
[cables]
stiffness = 2000.0
"""
NODES = np.random.default_rng(4).normal(size=(12, 3))
TRUSSES = {
    "two of five nodes, and a rod": ((0, 1, 2, 3, 4), (5, 6, 7, 8, 9), (10, 11)),
    "a ball joint": ((0, 1, 2, 3, 4), (4, 5, 6, 7, 8), (9, 10, 11)),
    "a hinge": ((3, 4, 0, 1, 2), (3, 4, 5, 6, 7), (7, 8, 9), (10, 11)),
}


def body_of(points: tuple[int, ...], basic: tuple[int, ...]):
    """Four nodes or more with an inertia, three as a plate, two as a rod."""
    x = NODES[list(points)] - NODES[list(points)].mean(0)
    second = x.T @ x
    return rigid_body(NODES, points, float(len(x)), np.trace(second) * np.eye(3) - second, basic=basic)


def truss_of(points: tuple[int, ...]) -> list[tuple[int, int]]:
    """Bars between all of the first four nodes, and from three of these to each other node: 3 n - 6."""
    return [*itertools.combinations(points[:4], 2), *((k, node) for node in points[4:] for k in points[:3])]


@pytest.mark.parametrize("held", [False, True], ids=["free", "on supports"])
@pytest.mark.parametrize("groups", TRUSSES.values(), ids=TRUSSES)
def test_counts_are_those_of_trusses(groups, held):
    """States of self-stress, mechanisms and rigid motions, and the spaces that they span; rank less the trusses' bars.

    Bars of one truss alone carry nothing; nor do members between nodes of one body act on anything else.
    """
    shared = [k for k in range(12) if sum(k in points for points in groups) > 1]
    fixed = np.zeros((12, 3), bool)
    fixed[[0, 6, 11]] = held * np.array([[1, 1, 1], [1, 0, 0], [0, 0, 1]])
    basic = {*shared, *np.flatnonzero(fixed.any(1)).tolist()}
    bodies = tuple(body_of(points, tuple(k for k in points if k in basic)) for points in groups)
    bars = tuple(dict.fromkeys(bar for points in groups for bar in truss_of(points)))
    cables = tuple(pair for pair in itertools.combinations(range(12), 2) if sum(pair) % 3 == 0 and pair not in bars)
    ours, theirs = statics_of(NODES, cables, fixed, 1e-9, bodies), statics_of(NODES, (*bars, *cables), fixed, 1e-9)
    assert (ours.rigid, ours.rank) == (theirs.rigid, theirs.rank - len(bars))
    assert ours.self_stress.shape[1] == theirs.self_stress.shape[1] > 0
    span = scipy.linalg.orth(theirs.self_stress[len(bars) :])
    np.testing.assert_allclose(ours.self_stress @ ours.self_stress.T, span @ span.T, atol=1e-9)
    few = cables[: len(cables) // 4]
    ours, theirs = statics_of(NODES, few, fixed, 1e-9, bodies), statics_of(NODES, (*bars, *few), fixed, 1e-9)
    flat = [each.mechanisms.reshape(-1, 36) for each in (ours, theirs)]
    assert len(flat[0]) == len(flat[1]) > 0
    np.testing.assert_allclose(flat[0].T @ flat[0], flat[1].T @ flat[1], atol=1e-9)


@pytest.fixture(scope="module")
def spine():
    """A spine of trusses, and the same with each vertebra as a rigid body of the same point masses."""
    scene = parse_scene(SPINE)
    built = scene.structure
    nodes = np.asarray(built.nodes)
    own = [tuple(range(4 * k, 4 * k + 4)) for k in range(2)]
    arms = [nodes[list(points)] - nodes[list(points)].mean(0) for points in own]
    inertia = [0.1 * sum(r @ r * np.eye(3) - np.outer(r, r) for r in each) for each in arms]
    bodies = tuple(rigid_body(nodes, points, 0.4, each) for points, each in zip(own, inertia))
    return scene, Scene(Structure(nodes, np.zeros(8), cables=built.cables, bodies=bodies))


@pytest.mark.slow
def test_a_report_is_that_of_the_truss(spine):
    """Counts, tensions, stability and frequencies, of all six modes that two bodies have beside rigid motions."""
    theirs, ours = (inspect_structure(scene) for scene in spine)
    counts = [[each.summary()[key] for key in ("states_of_self_stress", "mechanisms")] for each in (ours, theirs)]
    assert counts[0] == counts[1]
    assert ours.statics.rank == theirs.statics.rank - 12
    assert (ours.at_rest, ours.stable, ours.loose) == (True, True, 0)
    assert ours.prestress_stable == theirs.prestress_stable
    assert ours.super_stable is None
    np.testing.assert_allclose(ours.forces, theirs.forces[12:], rtol=1e-3)
    assert ours.forces.max() == pytest.approx(40, rel=1e-3)
    assert len(ours.frequencies) == 6
    np.testing.assert_allclose(ours.frequencies, theirs.frequencies[:6], rtol=1e-3)


def test_forces_of_members_alone(spine):
    """Of cables beside bodies: the springs that stand for bodies are not among them."""
    theirs, ours = (member_forces(scene.structure, scene.structure.nodes) for scene in spine)
    np.testing.assert_array_equal(ours, theirs[12:])


def test_small_loads_change_the_same_tensions(spine):
    """Two vertebrae pulled apart along two lines: tensions, their changes, and the margin to slack."""
    found = []
    for scene in spine:
        q = resting_shape(scene).q
        loads = np.zeros((8, 3))
        for low, high, size in ((0, 5, 3.0), (2, 7, -1.0)):
            loads[[low, high]] += size * np.array([[-1], [1]]) * (q[high] - q[low])
        found.append(static_response(scene, q, loads))
    theirs, ours = found
    np.testing.assert_allclose(ours.force_change, theirs.force_change[12:], atol=1e-3 * np.abs(loads).max())
    assert ours.slack_margin == pytest.approx(theirs.slack_margin, rel=1e-3)
    assert ours.compliance == pytest.approx(theirs.compliance, rel=1e-3)


LENGTH, AWAY, STIFFNESS, TENSION = 1.2, 0.9, 500.0, 60.0
"""Of a rigid column on a hinge, m; of two level cables from its top, m, N/m and N."""


@pytest.fixture(scope="module")
def column():
    """Its hinge is along y; no cable ends at a basic point, so that the body carries them."""
    hinge = [[0, -0.1, 0], [0, 0.1, 0]]
    nodes = np.array([*hinge, [0.3, 0, 0.5], [-0.2, 0.1, 0.7], [0, 0, LENGTH], [AWAY, 0, LENGTH], [-AWAY, 0, LENGTH]])
    body = rigid_body(nodes, (0, 1, 2, 3, 4), 2.0, [0.3, 0.3, 0.05], basic=(0, 1, 2, 3))
    cables = Members(((4, 5), (4, 6)), np.full(2, STIFFNESS), np.full(2, AWAY - TENSION / STIFFNESS))
    fixed = tuple((node, "xyz") for node in (0, 1, 5, 6))
    return Scene(Structure(nodes, np.zeros(7), cables=cables, bodies=(body,), fixed=fixed))


def test_a_rigid_column_gives_way(column):
    """Under P = 2 K l: cables give a moment of 2 K l^2 a radian, prestress none, and P takes P l."""
    report = load_report(column, LoadCase("down", (4,), np.array([[0, 0, -100.0]])), most=20.0)
    assert [event.what for event in report.path] == ["loses its stability"]
    assert report.path[0].factor == pytest.approx(2 * STIFFNESS * LENGTH / 100, rel=1e-4)
    np.testing.assert_allclose(report.reactions.sum(0), [0, 0, 100], atol=1e-6)
    np.testing.assert_allclose(report.reactions[:2].sum(0), [0, 0, 100], atol=2e-3)  # bodies are stiff springs


def test_a_rigid_column_leans(column):
    """Far, until a cable is slack, as its moments say; at first by F/(2 K)."""
    push = 200.0

    def moment(angle):
        top = LENGTH * np.array([np.sin(angle), np.cos(angle)])
        turn = LENGTH * np.array([np.cos(angle), -np.sin(angle)])
        total = push * turn[0]
        for end in (AWAY, -AWAY):
            d = np.array([end, LENGTH]) - top
            length = np.linalg.norm(d)
            total += STIFFNESS * max(length - AWAY + TENSION / STIFFNESS, 0) * (d @ turn) / length
        return total

    angle = scipy.optimize.brentq(moment, 0, 1)
    report = load_report(column, LoadCase("aside", (4,), np.array([[push, 0, 0]])))
    np.testing.assert_allclose(report.shape[4], LENGTH * np.array([np.sin(angle), 0, np.cos(angle)]), atol=1e-5)
    assert report.slack == (0,)
    assert report.forces[1] == pytest.approx(push * np.cos(angle) * LENGTH / arm(report.shape), rel=1e-4)
    small = static_response(column, column.structure.nodes, np.eye(7)[4][:, None] * [push, 0, 0])
    np.testing.assert_allclose(small.displacement[4], [push / (2 * STIFFNESS), 0, 0], atol=1e-5)
    np.testing.assert_allclose(small.force_change, [-push / 2, push / 2], rtol=1e-4)


def arm(shape):
    """m, of the second cable's pull about the hinge."""
    d = shape[6] - shape[4]
    return abs(np.cross(shape[4], d / np.linalg.norm(d))[1])


class Ballast(EnergyTerm):
    """A weight at the middle of each strut."""

    name = "ballast"

    def energy(self, at):
        i, j = np.array(at.scene.structure.struts.edges).T
        return 5.0 * (at.q[i, 2] + at.q[j, 2]).sum()


def test_a_held_body_is_as_good_as_held_nodes():
    """For a strut with mass, a motor and a user's term, and for a cable that a gait has shortened before t = 0."""
    nodes = np.array([[0.0, 0, 0], [0.3, 0, 0], [0, 0.3, 0], [0, 0, 0.3], [0, 0, -1]])
    struts = Members(((1, 4),), [1e4], [1.2], mass=[3.0], motors=(Motor(0, [-9.0], [1.05], rate=1.0),))
    cables = Members(((0, 4),), [1e3], [1.0])
    body = rigid_body(nodes, (0, 1, 2, 3), 1.0, [0.02] * 3, basic=(0, 1, 2))
    gait = Gait((1,), [np.pi / 2], [0.2], [1.0], start=-2.0, ramp=1.0)
    held = (*((k, "xyz") for k in range(3)), (4, "xy"))
    found = []
    for mass, bodies, fixed in (([0, 0, 0, 0, 0.5], (body,), held), ([0.25] * 4 + [0.5], (), (*held, (3, "xyz")))):
        structure = Structure(nodes, mass, struts, cables, fixed=fixed, bodies=bodies)
        scene = Scene(structure, gravity=9.81, gait=gait, terms=(Ballast(),))
        rest = resting_shape(scene)
        found.append((rest.q[4, 2], rest.reactions.sum(0), vibration_modes(scene, rest.q).frequency))
    np.testing.assert_allclose(found[0][0], found[1][0], rtol=1e-8)
    np.testing.assert_allclose(found[0][1], [0, 0, 4.5 * 9.81 + 10], atol=1e-6)
    np.testing.assert_allclose(found[0][2], found[1][2], rtol=1e-6)


def test_a_body_swings_about_a_node():
    """As its weight and its inertia say, from the shape in which it is built: the pull of the support is known there.

    Small loads lean it by their moment over that of its weight.
    """
    nodes, moments, arm = np.array([[0.0, 0, 0], [0.1, 0, -0.5], [-0.1, 0.1, -0.5], [0, -0.1, -0.4]]), [0.03, 0.04], 0.4
    body = rigid_body(nodes, (0, 1, 2, 3), 2.0, [*moments, 0.05], [0.0, 0.0, -arm], basic=(0,))
    scene = Scene(Structure(nodes, np.zeros(4), bodies=(body,), fixed=((0, "xyz"),)), gravity=9.81)
    expected = np.sort(np.sqrt(2 * 9.81 * arm / (np.array(moments) + 2 * arm**2)) / (2 * np.pi))
    np.testing.assert_allclose(vibration_modes(scene).frequency, expected, rtol=1e-6)
    leans = static_response(scene, nodes, np.eye(4)[1][:, None] * [0.01, 0, 0]).displacement[1, 0]
    np.testing.assert_allclose(leans, 0.5 * 0.01 * 0.5 / (2 * 9.81 * arm), rtol=1e-5)

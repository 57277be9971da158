"""Least masses against closed forms, against another program, and against what the members then bear."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from measurements import conformance_loads as known

import jaxgrity
from jaxgrity import InputError, Members, Scene, Structure, edge_lengths
from jaxgrity.model import LoadCase, Material, rigid_body
from jaxgrity.statics import least_mass, load_report

BARS, STRINGS = Material(60e9, 2700.0, 110e6), Material(120e9, 970.0, 2.7e9)


def test_answers_of_others():
    """Closed forms to rounding; MOTES as far as its solver went."""
    for case in known.least_masses():
        np.testing.assert_allclose(case.ours, case.theirs, rtol=1e-4 if case.source == known.MOTES else 1e-9)


@pytest.fixture
def diamond():
    """A D-bar in a plane, on two supports, pushed along its axis."""
    nodes = np.array([[0.0, 0, 0], [1, 0.4, 0], [2, 0, 0], [1, -0.4, 0]])
    struts = Members(((0, 1), (1, 2), (2, 3), (3, 0)), np.ones(4), np.ones(4))
    cables = Members(((0, 2), (1, 3)), np.ones(2), np.ones(2))
    structure = Structure(nodes, np.ones(4), struts, cables, fixed=((0, "xyz"), (1, "z"), (2, "yz"), (3, "z")))
    return Scene(structure, loads=(LoadCase("push", (2,), np.array([[-5e3, 0, 0]])),))


def test_what_is_least_fails_at_the_loads(diamond):
    """In the given shape, with every member that is needed at its limit."""
    found = least_mass(diamond, BARS, STRINGS)
    structure = found.structure()
    assert [len(members.edges) for members in (structure.struts, structure.cables)] == [4, 1]
    np.testing.assert_allclose(structure.mass - 4.0, found.mass, rtol=0.01)  # shorter or longer at rest
    report = load_report(dataclasses.replace(diamond, structure=structure), "push", most=2.0)
    np.testing.assert_allclose(report.shape, diamond.structure.nodes, atol=1e-9)
    np.testing.assert_allclose(report.margins, 1, rtol=1e-6)
    assert {event.what for event in report.path} >= {"buckles", "yields"}
    np.testing.assert_allclose([event.factor for event in report.path if event.what != "snaps through"], 1, rtol=1e-6)


def test_tubes_are_lighter_than_bars(diamond):
    """By the root of I/A^2 where all struts buckle; the structure has their diameters and walls."""
    solid, tubes = (least_mass(diamond, BARS, STRINGS, hollow=share) for share in (0.0, 0.6))
    np.testing.assert_allclose(solid.area[:4] / tubes.area[:4], np.sqrt((1 + 0.36) / (1 - 0.36)), rtol=1e-6)
    margins = load_report(dataclasses.replace(diamond, structure=tubes.structure()), "push", most=1.0).margins
    np.testing.assert_allclose(margins, 1, rtol=1e-6)


def test_prestress_costs_what_it_stresses(diamond):
    """A tension in the long cable pushes all struts; the other cable holds them together."""
    tension = 1e3
    found = least_mass(diamond, BARS, STRINGS, least_tension=tension)
    cosine = 1 / np.hypot(1, 0.4)
    push = (5e3 + tension) / (2 * cosine)
    np.testing.assert_allclose(found.forces[0, :4], -push, rtol=1e-9)
    np.testing.assert_allclose(found.forces[0, 4:], [tension, 0.8 * push * cosine], rtol=1e-9)


def test_each_member_bears_its_worst_case(diamond):
    """Pushed or pulled along the axis: struts buckle in one case, and the cable along it pulls in the other."""
    pull = LoadCase("pull", (2,), np.array([[9e3, 0, 0]]))
    both = least_mass(dataclasses.replace(diamond, loads=(*diamond.loads, pull)), BARS, STRINGS)
    alone = least_mass(diamond, BARS, STRINGS)
    np.testing.assert_allclose(both.area[:4], alone.area[:4], rtol=1e-9)
    assert both.mass > alone.mass
    needed = np.maximum(np.abs(both.forces[1, :4]) / 110e6, 0)
    assert np.all(both.area[:4] >= needed * (1 - 1e-9))


def test_a_long_cable_bears_itself():
    """Half of its weight hangs at its lower end: m = (density l P/stress)/(1 - density l g/(2 stress))."""
    soft = Material(1e9, 1000.0, 1e6)
    nodes, cables = np.array([[0.0, 0, 0], [0, 0, -20.0]]), Members(((0, 1),), np.ones(1), np.ones(1))
    structure = Structure(nodes, np.array([0.0, 3.0]), cables=cables, fixed=((0, "xyz"),))
    scene = Scene(structure, gravity=9.81, loads=(LoadCase("more", (1,), np.array([[0, 0, -100.0]])),))
    per_newton = 1000.0 * 20 / 1e6
    expected = per_newton * (100 + 3 * 9.81) / (1 - per_newton * 9.81 / 2)
    np.testing.assert_allclose(least_mass(scene, soft, soft).mass, expected, rtol=1e-9)


def test_each_round_lowers_the_mass():
    """Of a ground structure with many choices: to less than what the forces without buckling need against it."""
    nodes = np.array([[x, 0, z] for x in range(4) for z in range(3)], float)
    pairs = [(i, j) for i in range(12) for j in range(i) if np.abs(nodes[i] - nodes[j]).max() <= 1]
    members = Members(tuple(pairs), np.ones(len(pairs)), np.ones(len(pairs)))
    fixed = tuple((k, "xyz" if k < 3 else "y") for k in range(12))
    structure = Structure(nodes, np.ones(12), members, members, fixed=fixed)
    scene = Scene(structure, loads=(LoadCase("tip", (10,), np.array([[0, 0, -1e3]])),))
    free, bound = (least_mass(scene, BARS, BARS, buckling=each) for each in (False, True))
    length = np.linalg.norm([nodes[i] - nodes[j] for i, j in pairs], axis=1)
    push = np.maximum(-free.forces[0, : len(pairs)], 0)
    area = np.maximum(free.area, np.r_[2 * length * np.sqrt(push / (np.pi * 60e9)), 0 * length])
    assert free.rounds == 1 < bound.rounds
    assert free.mass < bound.mass < 0.99 * 2700 * np.sum(area * np.r_[length, length])
    assert bound.area.astype(bool).sum() < len(pairs)
    for found in (free, bound):
        balance = np.zeros((12, 3))
        for (i, j), force in zip((*pairs, *pairs), found.forces[0]):
            d = nodes[j] - nodes[i]
            balance[i] += force * d / np.linalg.norm(d)
            balance[j] -= force * d / np.linalg.norm(d)
        np.testing.assert_allclose(balance[3:, [0, 2]], -scene.loads[0].on_nodes(12)[3:, [0, 2]], atol=1e-4)


def test_impossible_programmes_are_refused(diamond):
    with pytest.raises(InputError, match="the scene has no loads"):
        least_mass(dataclasses.replace(diamond, loads=()), BARS, STRINGS)
    with pytest.raises(InputError, match=r"struts\.yield_stress: missing"):
        least_mass(diamond, Material(1e9, 1.0), STRINGS)
    with pytest.raises(InputError, match="material = 'stel': unknown"):
        least_mass(diamond, "stel", STRINGS)
    with pytest.raises(InputError, match="hollow = 1: expected a number from 0, below 1"):
        least_mass(diamond, BARS, STRINGS, hollow=1.0)
    with pytest.raises(InputError, match="the loads act on supports alone"):
        least_mass(dataclasses.replace(diamond, loads=(LoadCase("no", (0,), np.ones((1, 3))),)), BARS, STRINGS)
    strings = dataclasses.replace(diamond.structure, struts=None)
    with pytest.raises(InputError, match="no forces balance the loads"):
        least_mass(dataclasses.replace(diamond, structure=strings), BARS, STRINGS)


@pytest.mark.campaign
def test_sizes_by_gradient_on_the_page():
    """A bracket that may give way by 1 mm: m = 9 density F/(E limit) and areas in the ratio of the root of 2, both to
    the share of its size by which it gives way."""
    page = (Path(__file__).parents[2] / "docs" / "statics.md").read_text(encoding="utf-8")
    (program,) = (text for text in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "minimize" in text)
    ran = {"jaxgrity": jaxgrity}
    exec(program, ran)
    assert float(ran["spare"](ran["found"].x)) == pytest.approx(0, abs=1e-6)
    assert ran["found"].fun == pytest.approx(9 * 7850 * 1e3 / (210e9 * 1e-3), rel=2e-3)
    assert ran["found"].x[0] / ran["found"].x[1] == pytest.approx(np.sqrt(2), rel=2e-3)
    assert f"{ran['found'].fun:.3f} kg" in program
    first, second = ran["found"].x
    assert f"{first:.3f} cm^2 and {second:.3f} cm^2" in program


def platform(joined: bool) -> Scene:
    """A platform of 3 kg on six bars, with a load beside its middle: one rigid body, or two that share three nodes."""
    turns = np.radians([0, 120, 240])
    base, top = (
        np.stack([r * np.cos(turns + a), r * np.sin(turns + a), 0 * turns + z], 1)
        for r, a, z in ((1.0, 0.0, 0.0), (0.4, 0.8, 0.9))
    )
    nodes = np.concatenate([base, top, [[0.1, 0.05, 1.1]]])
    edges = tuple((k, 3 + m % 3) for k in range(3) for m in (k, k + 2))
    whole = rigid_body(nodes, (3, 4, 5, 6), 3.0, [0.2, 0.2, 0.3], [0.02, 0.0, 0.95])
    half = rigid_body(nodes, (3, 4, 5, 6), 1.5, [0.2, 0.2, 0.3], [0.02, 0.0, 0.95], basic=(3, 4, 5, 6))
    bars = Members(edges, np.full(6, 1e6), edge_lengths(nodes, edges))
    fixed = tuple((k, "xyz") for k in range(3))
    structure = Structure(nodes, np.zeros(7), bars, fixed=fixed, bodies=(half, half) if joined else (whole,))
    force = np.array([[30.0, -50.0, -200.0]])
    return Scene(structure, 9.81, loads=(LoadCase("aside", (6,), force),))


@pytest.mark.parametrize("joined", [False, True], ids=["one body", "two that are joined"])
def test_a_rigid_body_bears_what_six_bars_give_it(joined):
    """Their forces are those of its six equations of equilibrium, and the areas those of the yield stress."""
    scene = platform(joined)
    x, material = np.asarray(scene.structure.nodes), BARS._replace(density=1e-3)
    found = least_mass(scene, material, material, buckling=False)
    i, j = np.array(scene.structure.struts.edges).T
    ways = (x[i] - x[j]) / np.linalg.norm(x[i] - x[j], axis=1)[:, None]
    wrench = lambda force, place: np.concatenate([force, np.cross(place, force)], axis=-1)  # noqa: E731
    load = wrench(np.array([30.0, -50.0, -200.0]), x[6]) + wrench(np.array([0, 0, -3 * 9.81]), [0.02, 0.0, 0.95])
    expected = np.linalg.solve(wrench(ways, x[j]).T, -load)
    np.testing.assert_allclose(found.forces[0], expected, rtol=1e-5)
    np.testing.assert_allclose(found.area, np.abs(expected) / material.yield_stress, rtol=1e-5)

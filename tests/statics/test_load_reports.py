"""What loads do to structures: closed forms, other programs, and what is refused."""

import dataclasses
import itertools
import json
import re
from pathlib import Path

import jaxtyping
import numpy as np
import pytest
from measurements import conformance_loads as known
from measurements.conformance_rib import rib

from jaxgrity import InputError, Members, Scene, Structure, describe, edge_lengths, load_scene, parse_scene
from jaxgrity.cli.inspect import main
from jaxgrity.cli.settings import InspectSettings
from jaxgrity.model import LoadCase, sized_members
from jaxgrity.statics import inspect_structure, least_mass, load_report, member_forces, resting_shape, static_response
from jaxgrity.statics.strength import strength_of


@pytest.mark.slow
@pytest.mark.parametrize(
    "cases",
    [
        *(known.kresling, known.dome, known.cantilever, known.deployed_tower, rib),
        *(pytest.param(cases, marks=pytest.mark.campaign) for cases in (known.arches, known.half_t_bar)),
    ],
)
def test_answers_of_others(cases):
    """Each to 1e-7 of the largest number of its unit."""
    found = list(cases())
    for case in found:
        size = max(abs(other.theirs) for other in found if other.unit == case.unit)
        assert abs(case.ours - case.theirs) < 1e-7 * size, case


PAGE = (Path(__file__).parents[2] / "docs" / "statics.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def prism():
    """The prism in docs/statics.md, on three supports, with a load that slackens cables besides."""
    (text,) = re.findall(r"```toml\n(\[structure\]\nkind = \"prism\".*?)```", PAGE, re.DOTALL)
    scene = parse_scene(text)
    up = LoadCase("up", (3, 4, 5), np.tile([0.0, 0, 800], (3, 1)))
    return dataclasses.replace(scene, loads=(*scene.loads, up))


@pytest.fixture(scope="module")
def reports(prism):
    return {case.name: load_report(prism, case) for case in prism.loads}


@pytest.mark.campaign
def test_the_page_shows_what_is_printed(reports):
    assert reports["wind"].table() in PAGE


def test_supports_bear_the_loads(prism, reports):
    """Reactions balance loads, and members' forces balance both at every node."""
    for case in prism.loads:
        report = reports[case.name]
        loads = case.on_nodes(6)
        np.testing.assert_allclose(report.reactions.sum(0), -loads.sum(0), atol=1e-6)
        at_nodes = loads + report.reactions
        for (i, j), force in zip(prism.structure.struts.edges + prism.structure.cables.edges, report.forces):
            d = report.shape[j] - report.shape[i]
            pull = force * d / np.linalg.norm(d)
            at_nodes[i] += pull
            at_nodes[j] -= pull
        np.testing.assert_allclose(at_nodes, 0, atol=1e-6)


def test_margins_are_strength_over_force(prism, reports):
    """Of struts Euler's load at their length under the loads; of cables the force at which they break."""
    report, struts = reports["payload"], prism.structure.struts
    for k, (i, j) in enumerate(struts.edges):
        euler = np.pi**2 * struts.bending_stiffness[k] / np.sum((report.shape[i] - report.shape[j]) ** 2)
        np.testing.assert_allclose(report.margins[k], euler / -report.forces[k], rtol=1e-12)
    np.testing.assert_allclose(report.margins[3:], 1.6e9 * 5e-7 / report.forces[3:], rtol=1e-12)
    at_rest = inspect_structure(dataclasses.replace(prism, gravity=None))
    np.testing.assert_allclose(at_rest.margins[3:], 1.6e9 * 5e-7 / at_rest.forces[3:], rtol=1e-12)


@pytest.mark.parametrize("name", ["payload", "wind", "up"])
def test_events_happen_where_the_report_says(prism, reports, name):
    """Shortly before its load factor a member still bears, and shortly after it does not; by small loads likewise."""
    report = reports[name]
    case = next(each for each in prism.loads if each.name == name)
    assert report.path
    assert report.path == tuple(sorted(report.path))
    for event in report.path:
        before, after = (
            resting_shape(Scene(prism.structure), report.shape, event.factor * share * case.on_nodes(6))
            for share in (0.999, 1.001)
        )
        forces = [member_forces(prism.structure, found.q) for found in (before, after)]
        if event.what == "goes slack":
            assert forces[0][event.where] > 0 == forces[1][event.where]
        elif event.what in ("yields", "buckles"):
            margins = [
                strength_of(prism.structure, found.q).margins(force)[event.where]
                for found, force in zip((before, after), forces)
            ]
            assert margins[0] > 1 > margins[1]
    rest = inspect_structure(dataclasses.replace(prism, gravity=None))
    change = static_response(Scene(prism.structure), rest.shape, case.on_nodes(6)).force_change
    for event in report.linear:
        force = rest.forces[event.where] + event.factor * change[event.where]
        strength = (report.margins * np.abs(report.forces))[event.where]
        np.testing.assert_allclose(abs(force), 0 if event.what == "goes slack" else strength, rtol=0.01, atol=1e-6)


def test_what_fails_without_loads_fails_at_once(prism):
    """Struts that the prestress alone makes buckle."""
    struts = dataclasses.replace(prism.structure.struts, bending_stiffness=np.full(3, 1.0))
    weak = dataclasses.replace(prism, structure=dataclasses.replace(prism.structure, struts=struts))
    report = load_report(weak, "wind", most=1.0)
    assert [event[:2] for event in (report.linear[0], report.path[0])] == [(0.0, "buckles")] * 2


def test_a_column_buckles_at_eulers_load():
    """And yields there if it is short: whichever comes first."""
    column = Structure(np.array([[0.0, 0, 0], [0, 0, 1]]), np.ones(2), fixed=((0, "xyz"), (1, "xy")))
    case = LoadCase("down", (1,), np.array([[0.0, 0, -1.0]]))
    for diameter, what in ((0.01, "buckles"), (0.1, "yields")):
        struts = sized_members(((0, 1),), np.ones(1), "steel", diameter=diameter)
        report = load_report(Scene(dataclasses.replace(column, struts=struts)), case, most=1.0)
        expected = min(np.pi**3 * 210e9 * diameter**4 / 64, 235e6 * np.pi * diameter**2 / 4)
        assert [event.what for event in report.linear] == [what]
        np.testing.assert_allclose(report.linear[0].factor, expected, rtol=1e-12)


def test_a_structure_that_snaps_is_reported_where_it_lands():
    """Below its supports, as deep as it stood above where the load is small, and stretched by it."""
    scene = known.arch(0.1)
    case = LoadCase("much", (2,), np.array([[0, 0, -0.5]]))
    report = load_report(scene, case)
    np.testing.assert_allclose(report.path[-1].factor, load_report(scene, "down").path[-1].factor / 0.5, rtol=1e-9)
    assert report.shape[2, 2] < -0.1
    assert report.reached < 1


def test_strength_of_nobody_is_no_limit():
    """Members of stiffness alone: no margins, no failures, and a report all the same."""
    report = load_report(known.arch(1.0), "down", most=2.0)
    assert np.all(np.isinf(report.margins))
    assert report.linear == report.path == ()
    assert report.summary()["margins"] == [None, None]
    assert "followed             up to" in report.table()


@pytest.mark.slow
def test_loads_that_make_no_sense_are_refused(prism):
    jaxtyping.config.update("jaxtyping_disable", True)  # of this test alone: conftest.py sets it anew for each
    with pytest.raises(InputError, match="case = 'snow': unknown; expected one of payload, wind, up"):
        load_report(prism, "snow")
    with pytest.raises(InputError, match=r"case = 'snow': unknown; the scene has none; expected \[\[loads\]\] in it"):
        load_report(dataclasses.replace(prism, loads=()), "snow")
    with pytest.raises(InputError, match=r"load case 'far': nodes\[0\] = 9: expected a whole number from 0 to 5"):
        load_report(prism, LoadCase("far", (9,), np.ones((1, 3))))
    with pytest.raises(InputError, match="loads has 3; expected a LoadCase"):
        dataclasses.replace(prism, loads=(3,))
    with pytest.raises(InputError, match="loads are called a, a; expected another name"):
        dataclasses.replace(prism, loads=(LoadCase("a", (3,), np.ones((1, 3))),) * 2)
    with pytest.raises(InputError, match="load case 'push': the structure does not resist every motion"):
        load_report(load_scene("reference"), LoadCase("push", (0,), np.ones((1, 3))))
    arch = known.arch(1.0)
    unheld = dataclasses.replace(arch.structure, fixed=((0, "xyz"), (1, "xyz")))  # free to fall out of its plane
    with pytest.raises(InputError, match="and prestress where it has mechanisms"):
        load_report(dataclasses.replace(arch, structure=unheld), "down")


def test_a_structure_may_hang_in_its_loads():
    """Two loose cables and a node between them: the loads alone make them taut, K (l - L) along each."""
    nodes = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 0, -0.5]])
    cables = Members(((0, 2), (1, 2)), np.full(2, 1e3), np.full(2, 1.25))
    hung = Structure(nodes, np.ones(3), cables=cables, fixed=((0, "xyz"), (1, "xyz"), (2, "y")))
    report = load_report(Scene(hung), LoadCase("down", (2,), np.array([[0, 0, -50.0]])))
    length = np.hypot(1, report.shape[2, 2])
    np.testing.assert_allclose(report.forces, 1e3 * (length - 1.25), rtol=1e-9)
    np.testing.assert_allclose(2 * report.forces[0] * -report.shape[2, 2] / length, 50, rtol=1e-9)
    assert report.slack == report.path == ()


def test_inspect_prints_each_load_case(tmp_path, capsys):
    """And writes its numbers."""
    path = tmp_path / "arch.toml"
    path.write_text("""
        [structure]
        kind = "custom"
        nodes = [[-1, 0, 0], [1, 0, 0], [0, 0, 0.2]]
        struts = [[0, 2], [1, 2]]
        fixed = [0, 1, { node = 2, axes = "y" }]
        [struts]
        material = "steel"
        diameter = 0.02
        [[loads]]
        name = "middle"
        nodes = [2]
        force = [0, 0, -1e3]
    """)
    main(InspectSettings(str(path), out=tmp_path))
    printed = capsys.readouterr().out
    assert "load case            middle" in printed
    assert "load cases           middle (motions ignore them)" in describe(load_scene(path))
    (case,) = json.loads((tmp_path / "inspection.json").read_text())["loads"]
    assert f"strut 0 buckles at {case['linear'][0]['factor']:.4g} times the loads" in printed


def test_supports_of_a_squeezed_free_robot_bear_nothing():
    """Held at one loaded node, at the other across the line between them, and at any third against turning about it:
    every third node gives the same distances, far from rest."""
    scene = load_scene("reference")
    x = scene.structure.nodes
    low, high = max(itertools.combinations(range(12), 2), key=lambda pair: np.linalg.norm(x[pair[0]] - x[pair[1]]))
    up = (x[high] - x[low]) / np.linalg.norm(x[high] - x[low])
    across = np.linalg.svd(up[None])[2][1:]
    turned = (x - x[low]) @ np.stack([*across, up], 1)
    squeeze = LoadCase("squeeze", (low, high), 40.0 * np.array([[0, 0, 1.0], [0, 0, -1]]))
    far = np.abs(turned[:, 0]) > 0.1
    found = []
    for third in np.flatnonzero(far)[:2].tolist():
        fixed = ((low, "xyz"), (high, "xy"), (third, "y"))
        held = Scene(dataclasses.replace(scene.structure, nodes=turned, fixed=fixed))
        report = load_report(held, squeeze, most=1.0)
        np.testing.assert_allclose(report.reactions, 0, atol=1e-6)
        found.append(np.linalg.norm(report.shape[:, None] - report.shape, axis=2))
    np.testing.assert_allclose(*found, atol=1e-9)
    assert np.abs(found[0] - np.linalg.norm(x[:, None] - x, axis=2)).max() > 0.01


def test_gravity_that_leans_is_the_structure_turned():
    """In reports, and for the lightest members: a bracket with mass, turned by 0.5 rad together with gravity's axis."""
    nodes, c, s = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0, 0], [0.2, 0.3, 1]]), np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    edges = ((0, 3), (1, 3), (2, 3))
    found = []
    for matrix, up in ((np.eye(3), None), (turn, turn[:, 2])):
        x = nodes @ matrix.T
        struts = sized_members(edges, edge_lengths(x, edges), "steel", diameter=0.01)
        structure = Structure(x, [0.0, 0, 0, 20], struts, fixed=tuple((k, "xyz") for k in range(3)))
        case = LoadCase("aside", (3,), np.array([[30.0, 0, 0]]) @ matrix.T)
        scene = Scene(structure, gravity=9.81, up=up, loads=(case,))
        report, at_rest = load_report(scene, "aside", most=1.0), inspect_structure(scene)
        lightest = least_mass(scene, "steel", "steel")
        found.append([report.reactions @ matrix, report.forces, at_rest.forces, lightest.area / lightest.area.max()])
    for leaning, upright in zip(*found):
        np.testing.assert_allclose(leaning, upright, rtol=1e-6, atol=1e-6 * np.abs(upright).max())

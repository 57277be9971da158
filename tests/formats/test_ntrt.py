"""NTRT's structure files: counts, masses, rest lengths and places as computed by hand; every refusal one clear line."""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from jaxgrity import InputError, contact_twin, edge_lengths, simulate
from jaxgrity.formats import read_ntrt
from jaxgrity.formats.yaml_text import parse_yaml
from jaxgrity.statics import settled

DATA = Path(__file__).parents[1] / "data" / "ntrt"


def refusal(folder, text: str) -> str:
    """What a user reads of a file that is refused: one line that starts with the file."""
    path = folder / "robot.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_ntrt(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert message.isprintable(), message
    return message.removeprefix(f"{path}: ")


def test_prism():
    """Decimetres and y up become metres and z up; m = density pi r^2 l; L = l - P/K; rods without radius are struts."""
    scene, notes = read_ntrt(DATA / "prism.yaml", drop=["radius"])
    structure = scene.structure
    np.testing.assert_allclose(structure.nodes[[0, 1, 4]], [[0.4, 0, 0], [-0.2, -0.3, 0], [0.2, 0.3, 0.6]], atol=1e-15)
    assert (len(structure.struts.edges), len(structure.cables.edges)) == (3, 9)
    assert structure.struts.rigid
    # rod a-d: from (4, 0, 0) to (-4, 6, 0), 10 dm long, of 0.5 kg/dm^3 and 0.2 dm radius
    assert structure.struts.edges[0] == (0, 3)
    assert structure.struts.rest_length[0] == pytest.approx(1.0, abs=1e-15)
    assert structure.struts.mass[0] == pytest.approx(0.5 * math.pi * 0.04 * 10, rel=1e-15)
    # string a-b: sqrt(36 + 9) dm, 1000/500 dm shorter; string a-f: sqrt(4 + 36 + 9) = 7 dm, 1500/250 dm shorter
    cables = dict(zip(structure.cables.edges, zip(structure.cables.rest_length, structure.cables.stiffness)))
    assert cables[0, 1] == pytest.approx((0.1 * (math.sqrt(45) - 2), 500))
    assert cables[0, 5] == pytest.approx((0.1 * (7 - 6), 250))
    tension = cables[0, 5][1] * (0.7 - cables[0, 5][0])
    assert tension == pytest.approx(1500 * 0.1)  # N: 1500 kg dm/s^2
    assert structure.cables.damping.tolist() == [4.0] * 6 + [2.0] * 3
    np.testing.assert_array_equal(structure.node_mass, 0)
    assert "one unit of length is 0.1 m" in notes[0]
    assert "y, which is up in the file, is z here" in notes[0]
    assert notes[-1] == "dropped: the radius of rods and boxes; 18 ends of strings are at nodes, not on surfaces"
    assert (scene.ground.balls, float(scene.friction.mu)) == (None, 0.9 * 0.5)  # the rods' times that of NTRT's ground


def test_builders_that_match_nothing_are_named(tmp_path):
    """A misspelt tag leaves NTRT's own string in place, with its stiffness: so a note says so."""
    text = (DATA / "prism.yaml").read_text()
    assert not any("match nothing" in note for note in read_ntrt(DATA / "prism.yaml").notes)
    (tmp_path / "robot.yaml").write_text(
        text + "  horizonal string: {class: tgBasicActuatorInfo, parameters: {stiffness: 9}}\n"
    )
    found = read_ntrt(tmp_path / "robot.yaml")
    assert "builders that match nothing have no effect: horizonal string" in found.notes


def test_parameters_that_move_nothing_are_left_out(tmp_path):
    """By the names of NTRT's first builder of files too."""
    text = (DATA / "prism.yaml").read_text()
    older = text.replace("max_tension", "hist: 0, targetVelocity: 9, minActualLength: 1, minRestLength: 1, maxTens")
    (tmp_path / "robot.yaml").write_text(older.replace("friction: 0.9", "friction: 0.9, rollFriction: 0.1"))
    again, plain = read_ntrt(tmp_path / "robot.yaml").scene.structure, read_ntrt(DATA / "prism.yaml").scene.structure
    np.testing.assert_array_equal(again.nodes, plain.nodes)
    np.testing.assert_array_equal(again.mass, plain.mass)


def test_the_unit_of_length_can_be_another():
    """Masses and stiffness do not depend on it; lengths and forces do."""
    small, large = (read_ntrt(DATA / "prism.yaml", unit, ["radius"]).scene.structure for unit in (0.1, 1.0))
    np.testing.assert_allclose(large.nodes, 10 * small.nodes)
    np.testing.assert_allclose(large.struts.mass, small.struts.mass)
    np.testing.assert_allclose(large.cables.stiffness, small.cables.stiffness)
    np.testing.assert_allclose(large.cables.rest_length, 10 * small.cables.rest_length)
    with pytest.raises(InputError, match=r"unit = 0\.0: expected a positive number"):
        read_ntrt(DATA / "prism.yaml", 0.0)


def test_substructures_are_turned_scaled_offset_and_moved():
    """In this order, each about its centre unless a reference is given."""
    structure = read_ntrt(DATA / "spine.yaml", drop=["radius"]).scene.structure
    y_up = np.stack([structure.nodes[:, 0], structure.nodes[:, 2], -structure.nodes[:, 1]], axis=1) * 10
    y_up[:, 1] -= 3  # the lowest node, four of v1, stands on the ground
    first, second = y_up[:5], y_up[5:]
    local = np.array([[0, 0, 0], [3, 0, 0], [0, 3, 0], [0, 0, 3], [-3, -3, -3]], float)
    np.testing.assert_allclose(first, local, atol=1e-12)
    turned = np.stack([local[:, 2], local[:, 1], -local[:, 0]], axis=1)  # 90 degrees about y: z to x, x to -z
    halved = turned.mean(0) + 0.5 * (turned - turned.mean(0))
    np.testing.assert_allclose(second, halved + np.array([1, 10, 0]), atol=1e-12)
    assert [(i, j - 5) for i, j in structure.cables.edges] == [(1, 1), (2, 4), (0, 0)]
    length = np.linalg.norm(first[1] - second[1])
    assert structure.cables.rest_length[0] == pytest.approx(0.1 * (length - 0.5))
    # half as long, half as heavy
    whole, half = (float(body.matrix.sum()) for body in structure.bodies)
    assert half == pytest.approx(whole / 2)


def test_edges_dock_to_nodes():
    """The upper prism comes to lie where the middles of its lower edges meet the nodes; each edge goes by its node."""
    structure = read_ntrt(DATA / "docked.yaml", drop=["radius"]).scene.structure
    nodes, names = structure.nodes, "abcdef"
    lower, upper = ({n: nodes[k + shift] for k, n in enumerate(names)} for shift in (0, 6))
    # both triangles are as large as each other, so that the planes meet, and the centres too
    middles = np.array([(upper[i] + upper[j]) / 2 for i, j in ("ab", "bc", "ca")])
    targets = np.array([lower[n] for n in "def"])
    np.testing.assert_allclose(middles.mean(0), targets.mean(0), atol=1e-12)
    np.testing.assert_allclose(middles[:, 2], targets[:, 2], atol=1e-12)
    edges = set(structure.cables.edges)
    # of nine strings each, three edges of the upper and those between the nodes of the lower are gone; six come
    assert len(edges) == 18
    for node, (i, j) in zip((3, 4, 5), ((6, 7), (7, 8), (8, 6))):
        assert (i, j) not in edges
        assert (j, i) not in edges
        assert {(node, i), (node, j)} <= edges
    assert not {(3, 4), (4, 5), (3, 5)} & edges
    # it has kept its shape
    np.testing.assert_allclose(edge_lengths(nodes, ((0, 3), (6, 9))), 1.0)


def test_a_file_that_is_not_where_it_should_be_is_taken_from_beside(tmp_path):
    """Collections are copied into one folder; it is said, and where there is none it is refused."""
    shutil.copy(DATA / "vertebra.yaml", tmp_path)
    (tmp_path / "robot.yaml").write_text("substructures: {a: {path: ../Parts/vertebra.yaml}}")
    scene, notes = read_ntrt(tmp_path / "robot.yaml")
    assert len(scene.structure.nodes) == 5
    assert "../Parts/vertebra.yaml is not there; vertebra.yaml, beside the file, was taken for it" in notes
    said = refusal(tmp_path, "substructures: {a: {path: Parts/other.yaml}}")
    assert said == "line 1: substructures.a.path = 'Parts/other.yaml': there is no such file"


@pytest.fixture(scope="module")
def found():
    """The prism, settled."""
    return settled(read_ntrt(DATA / "prism.yaml", drop=["radius"]).scene)


@pytest.mark.slow
def test_it_settles(found):
    """As files are not equilibria, it is said how far the nodes moved."""
    structure = found.scene.structure
    assert 0.02 < found.moved < 0.5
    np.testing.assert_allclose(edge_lengths(structure.nodes, structure.struts.edges), structure.struts.rest_length)
    assert settled(found.scene).moved < 1e-8
    assert structure.nodes[:, 2].min() == pytest.approx(0, abs=1e-12)


@pytest.mark.campaign
@pytest.mark.parametrize("model", [lambda scene: scene, contact_twin], ids=["exact", "penalty"])
def test_settled_it_stands(found, model):
    """On both models of contact."""
    motion = simulate(model(found.scene), 0.3)
    assert not motion.failed
    height = np.ptp(np.asarray(motion.positions)[:, :, 2], axis=1)
    assert height[-1] > 0.9 * height[0]


REFUSED = {
    "no table": ("[1, 2]", "the file = ['1', '2']: expected a table"),
    "unknown key": ("knots: {}", "the file has 'knots'; expected one of nodes, pair_groups, builders"),
    "no node": ("pair_groups: {rod: [[a, b]]}", "line 1: pair_groups.rod[0]: there is no node 'a'"),
    "two coordinates": ("nodes: {a: [1, 2]}", "line 1: nodes.a = ['1', '2']: expected a list of 3 numbers"),
    "no number": ("nodes:\n  a: [1, 2, x]", "line 2: nodes.a[2] = 'x': expected a number"),
    "not finite": ("nodes: {a: [1, 2, .nan]}", "nodes.a[2] = '.nan': expected a number"),
    "NaN": ("nodes: {a: [1, 2, nan]}", "nodes.a[2] = 'nan': expected a finite number"),
    "three names": ("pair_groups: {rod: [[a, b, c]]}", "pair_groups.rod[0] = ['a', 'b', 'c']: expected two names"),
    "a key twice": ("nodes: {a: [1, 2, 3], a: [1, 2, 3]}", "line 1: 'a' is there twice"),
    "an alias of itself": ("nodes: {a: &x [1, 2, *x]}", "line 1: aliases repeat more than 30000 values, or themselves"),
    "a tag": ("nodes: !!python/object:os.system {}", "line 1: tag:yaml.org,2002:python/object:os.system is a tag"),
    "no YAML": ("nodes: {a: [1, 2, 3}", "line 1: not YAML: "),
    "deep": ("[" * 30 + "]" * 30, "line 1: not YAML: more than 20 levels within each other"),
    "itself": ("substructures: {a: {path: robot.yaml}}", "is a substructure of itself"),
    "builder": ("builders: {rod: {class: tgWheel}}", "builders.rod.class = 'tgWheel': expected one of tgRodInfo"),
    "parameter": (
        "builders: {rod: {class: tgRodInfo, parameters: {colour: 3}}}",
        "builders.rod.parameters.colour is unknown; expected one of radius, density",
    ),
    "negative": (
        "builders: {rod: {class: tgRodInfo, parameters: {radius: -1}}}",
        "builders.rod.parameters.radius = '-1': expected no negative number",
    ),
    "nothing": ("nodes: {a: [0, 0, 0]}", "no rod, box or sphere is built; expected some"),
    "nothing there": (
        "nodes: {a: [0, 0, 0], b: [0, 1, 0], c: [1, 0, 0]}\npair_groups: {string: [[a, b]], rod: [[a, c]]}",
        "a string ends at [0.0, 0.0, 0.1] m, where nothing is built",
    ),
    "no length": (
        "nodes: {a: [0, 0, 0], b: [0, 0, 0], c: [1, 0, 0]}\npair_groups: {string: [[a, b]], rod: [[a, c]]}",
        "a string tagged 'string' has no length",
    ),
    "not yes or no": (
        "builders: {string: {class: tgBasicActuatorInfo, parameters: {moveCablePointAToEdge: maybe}}}",
        "builders.string.parameters.moveCablePointAToEdge = 'maybe': expected true or false",
    ),
    "wrapping": (
        "nodes: {a: [0, 0, 0], b: [1, 0, 0], c: [0, 9, 0]}\npair_groups: {rod: [[a, b]], string: [[a, b]]}\n"
        "builders: {string: {class: tgBasicContactCableInfo}}",
        "1 strings are deflected by bodies (builders.string.class = 'tgBasicContactCableInfo'), which would be lost; "
        "drop=['wrapping'], or --drop wrapping,",
    ),
    "too tight": (
        "nodes: {a: [0, 0, 0], b: [1, 0, 0]}\npair_groups: {tight: [[a, b]], rod: [[a, b]]}\n"
        "builders: {tight: {class: tgBasicActuatorInfo, parameters: {pretension: 2000}}}",
        "a string of 0.1 m needs a rest length of -0.1 m for its pretension",
    ),
    "one child": ("bond_groups: {string: {a/node_node: []}}", "bond_groups.string.a/node_node: expected two or more"),
    "no child": ("bond_groups: {string: {a/b/node_node: []}}", "there is no substructure 'a'"),
    "missing file": ("substructures: {a: {path: x.yaml}}", "substructures.a.path = 'x.yaml': there is no such file"),
}


@pytest.mark.parametrize(("text", "reason"), REFUSED.values(), ids=REFUSED)
def test_refused_in_one_line(text, reason, tmp_path):
    """With the place, the value and what was expected."""
    assert reason in refusal(tmp_path, text)


def test_substructures_without_end_are_refused(tmp_path):
    """Each file names the next three times: three hundred files are read, and no more."""
    for k in range(12):
        (tmp_path / f"{k}.yaml").write_text(f"substructures: {{a/b/c: {{path: {k + 1}.yaml}}}}")
    (tmp_path / "12.yaml").write_text("nodes: {}")
    assert "levels of substructures, 300 in all" in refusal(tmp_path, "substructures: {a: {path: 0.yaml}}")


def test_text_is_text():
    """`no` and `1e3` are what is written; no dates, numbers or objects; aliases repeat, and tabs are spaces."""
    found = parse_yaml("{no: on, a: &x 1e3,\tb: [2020-01-01, ~, '', *x]}")
    assert found.value == {"no": "on", "a": "1e3", "b": ["2020-01-01", "~", "", "1e3"]}
    assert parse_yaml("# nothing\n").value is None
    assert parse_yaml("a:\n  b: 1\n  c: [2,\n 3]").lines == {
        "": 1,
        "a": 2,
        "a.b": 2,
        "a.c": 3,
        "a.c[0]": 3,
        "a.c[1]": 4,
    }

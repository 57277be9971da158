"""Nodes and cables that a scene file adds to a kind of the catalogue: numbered, placed, refused, saved."""

import equinox as eqx
import numpy as np
import pytest

from jaxgrity import InputError, load_scene, parse_scene, save_scene, scene_text
from jaxgrity.model.structure import edge_lengths
from jaxgrity.stepping import resolve
from jaxgrity.stepping.blocks import blocks

KIND = """
[structure]
kind = "prism"
mass = 3.0
pose = "face"
height = 0.2
[struts]
rigid = true
[cables]
stiffness = 400.0
prestrain = 0.2
"""
HUNG = """
[[added]]
nodes = [[0.0, 0.0, 0.1], [0.0, 0.0, -0.1]]
mass = 0.5
cables = [[0, 6], [1, 6], [2, 6], [3, 7], [4, 7], [5, 7], [6, 7]]
"""
MORE = "\n[[added]]\ncables = [[3, 6]]\nstiffness = 100.0\nprestrain = 0.0\ndamping = 3.0\n"


def refused(text: str) -> str:
    """The one line with which a file is refused."""
    with pytest.raises(InputError) as caught:
        parse_scene(text, "robot.toml")
    assert str(caught.value).isprintable()
    return str(caught.value).removeprefix("robot.toml: ")


def test_added_parts_come_after_those_of_the_kind():
    """So no number of the kind changes, and no length; places are from the kind's middle, and turn with it."""
    plain, found = parse_scene(KIND).structure, parse_scene(KIND + HUNG).structure
    np.testing.assert_allclose(found.nodes[:6] - found.nodes[0], plain.nodes - plain.nodes[0], atol=1e-12)
    assert found.cables.edges[:9] == plain.cables.edges
    assert found.struts.edges == plain.struts.edges
    np.testing.assert_array_equal(found.node_mass, [0.5] * 6 + [0.5] * 2)
    np.testing.assert_allclose(found.cables.rest_length[:9], plain.cables.rest_length)
    np.testing.assert_allclose(found.nodes[6:].mean(0), found.nodes[:6].mean(0), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found.nodes[6] - found.nodes[7]), 0.2)
    assert abs(found.nodes[6, 2] - found.nodes[7, 2]) < 0.19  # not along z any more
    np.testing.assert_allclose(found.nodes[:, 2].min(), 0.2)


def test_added_cables_may_have_numbers_of_their_own():
    """Others have those of [cables]."""
    cables = parse_scene(KIND + HUNG + MORE).structure.cables
    assert cables.stiffness.tolist() == [400.0] * 16 + [100.0]
    assert cables.damping.tolist() == [0.0] * 16 + [3.0]
    nodes = parse_scene(KIND + HUNG + MORE).structure.nodes
    shares = cables.rest_length / edge_lengths(nodes, cables.edges)
    np.testing.assert_allclose(shares, [0.8] * 16 + [1.0])


def test_a_robot_with_added_parts_is_saved_and_loaded_back(tmp_path):
    scene = parse_scene(KIND + HUNG + MORE)
    save_scene(scene, tmp_path / "robot.toml")
    assert eqx.tree_equal(load_scene(tmp_path / "robot.toml"), scene)


def test_kinds_of_rigid_bodies_get_them_too():
    """And their balls touch the ground as before."""
    kind = '[structure]\nkind = "capped_robot"\nstrut_length = 1.0\n[cables]\nstiffness = 100.0\n'
    plain, found = parse_scene(kind), parse_scene(f"{kind}[[added]]\ncables = [[0, 1]]\nstiffness = 5.0\n")
    assert len(found.structure.bodies) == len(plain.structure.bodies)
    assert found.structure.cables.edges == (*plain.structure.cables.edges, (0, 1))
    assert found.structure.cables.stiffness[-1] == 5.0


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[0, 6]", "[0, 8]", "added[0].cables[0] = [0, 8]: there is no node 8; expected 0 to 7"),
        ("[0, 6]", "[6, 6]", "added[0].cables[0] = [6, 6]: the member has no length"),
        ("[1, 6]", "[6, 0]", "added[0].cables[1] = [6, 0]: cables[0] joins these nodes already"),
        ("[0, 6]", "[1, 0]", "added[0].cables[0] = [1, 0]: a member joins these nodes already"),
        ("cables = [[3, 6]]", "cables = [[6, 1]]", "added[1].cables[0] = [6, 1]: a member joins these nodes already"),
        ("cables = [[3, 6]]", "", "added[1]: adds nothing; expected nodes, cables or both"),
        ("cables = [[3, 6]]", "mass = 1.0\ncables = [[3, 6]]", "added[1].mass = 1: it adds no nodes; expected none"),
        ("cables = [[3, 6]]", "nodes = [[0, 0, 1]]\nmass = 1", "added[1].stiffness = 100: it adds no cables"),
        ("mass = 0.5", "", "added[0].mass: missing; expected the mass of each node, kg"),
        ("mass = 0.5", "mass = -1", "added[0].mass = -1: expected a number >= 0"),
        ("mass = 0.5", "mass = 0", "added[0].mass = 0: no cable of node 6 has mass either; expected some mass"),
        ("mass = 0.5", "weight = 0.5", "added[0].weight = 0.5: unknown key; expected one of nodes, mass, cables"),
        ("stiffness = 400.0\n", f"stiffness = {[1] * 17}\n", "added[1].stiffness = 100: cables.stiffness is a list"),
        ("stiffness = 400.0\n", "force = { stretch = [0, 1], force = [0, 5] }\n", "cables.stiffness is missing"),
        ("prestrain = 0.2", "rest_length = 0.2", "added[1].prestrain = 0: cables.rest_length is given"),
        ("[cables]\nstiffness = 400.0\nprestrain = 0.2\n", "", "added[0].cables: there is no [cables] table"),
        ('"prism"\n', '"prism"\ncables = [[0, 1]]\n', "write [[added]]; to list all of them, kind = \"custom\""),
        ('"prism"\n', '"prism"\nnodes = [[0, 1, 2]]\n', "to add nodes and cables to this kind, write [[added]]"),
        ('"prism"', '"custom"\nnodes = [[0, 0, 0], [1, 0, 0]]\nstruts = [[0, 1]]', 'kind = "custom" lists all'),
    ],
)  # fmt: skip
def test_added_parts_that_are_none_are_refused(old, new, said):
    """In one line that says where."""
    text = KIND + HUNG + MORE
    assert old in text
    assert said in refused(text.replace(old, new, 1))


def test_added_nodes_without_mass_need_cables_with_mass_or_a_support():
    """These bear them."""
    massless = (KIND + HUNG).replace("mass = 0.5", "mass = 0")
    on_cables = parse_scene(massless.replace("prestrain = 0.2", "prestrain = 0.2\nmass = 0.1")).structure
    assert on_cables.node_mass[6:].tolist() == [0.0, 0.0]
    held = massless.replace('"prism"', '"prism"\nfixed = [6, 7]')
    assert parse_scene(held).structure.fixed == ((6, "xyz"), (7, "xyz"))


def test_no_other_kind_of_unknown_key_is_told_of_added_parts():
    """Only who looks for nodes or members there wants to add some."""
    assert "[[added]]" not in refused(KIND.replace("mass", "weight"))
    assert "[[added]]" not in refused(scene_text("reference").replace("[cables]", "[cables]\nnodes = 3"))


def test_a_payload_on_cables_is_solved_by_sweeps():
    """As fast as the robot without it: a node without strut needs no coupled solver, and no block of its own."""
    hung = "[[added]]\nnodes = [[0, 0, 0]]\nmass = 0.5\ncables = [[0, 12], [5, 12], [7, 12], [10, 12]]\n"
    scene = parse_scene(f"{scene_text('exact')}\n{hung}")
    assert not resolve(scene, 1.0).coupled
    assert [len(rows) for rows in blocks(scene.structure.struts.edges, 13).nodes] == [7, 6]

"""Scene files: the numbers they turn into, and every refusal as one clear line."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from jaxgrity import InputError, load_scene, parse_scene
from jaxgrity.friction import SmoothFriction, SwitchFriction
from jaxgrity.structure import edge_lengths

SCENE = Path(__file__).parents[1] / "experiments" / "scenes" / "reference.toml"
TEXT = SCENE.read_text()
CUSTOM = """
[structure]
kind = "custom"
nodes = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
struts = [[0, 1]]
cables = [[1, 2]]
node_mass = [1.0, 2.0, 3.0]
[struts]
stiffness = 10
[cables]
stiffness = 5
rest_length = 1.0
"""


def changed(*pairs: tuple[str, str]) -> str:
    """The reference scene's text with replacements, each of which must find something to replace."""
    text = TEXT
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def test_reference_scene():
    """Masses, lengths, prestress and pose as the file says."""
    structure = load_scene(SCENE).structure
    assert structure.nodes.shape == (12, 3)
    np.testing.assert_allclose(structure.node_mass, 0.5)
    np.testing.assert_allclose(edge_lengths(structure.nodes, structure.struts.edges), 1.0)
    np.testing.assert_allclose(edge_lengths(structure.nodes, structure.cables.edges), np.sqrt(6) / 4)
    np.testing.assert_allclose(structure.cables.rest_length, 0.7 * np.sqrt(6) / 4)
    np.testing.assert_allclose(np.sort(structure.nodes[:, 2])[:3], 0.02, atol=1e-12)


def test_numbering_of_the_icosahedron():
    """Node, strut and cable order are fixed, since gaits and results name members by their numbers."""
    structure = parse_scene(changed(('pose = "face"', 'pose = "strut"'), ("height = 0.02", "height = -0.5"))).structure
    first = np.array([[2, 1, 0], [-2, 1, 0], [2, -1, 0], [-2, -1, 0]]) / 4
    np.testing.assert_allclose(structure.nodes[:4], first, atol=1e-15)
    np.testing.assert_allclose(structure.nodes[4:8], np.roll(first, 1, axis=1), atol=1e-15)
    assert structure.struts.edges == ((0, 1), (2, 3), (4, 5), (6, 7), (8, 9), (10, 11))
    assert len(structure.cables.edges) == 24
    assert structure.cables.edges[:3] == ((0, 4), (0, 6), (0, 8))
    assert all(a < b for a, b in pairwise(structure.cables.edges))


def test_face_pose_stands_on_three_nodes():
    """Direction (1, 1, 1) of the pattern points down: the face there is level, and lowest."""
    nodes = load_scene(SCENE).structure.nodes
    lowest = np.flatnonzero(np.isclose(nodes[:, 2], nodes[:, 2].min(), atol=1e-9))
    assert len(lowest) == 3
    pattern = parse_scene(changed(('pose = "face"', 'pose = "strut"'))).structure.nodes
    pattern = pattern - pattern.mean(0)
    np.testing.assert_allclose(pattern[lowest].sum(1), pattern.sum(1).max(), atol=1e-12)


def test_height_is_above_the_incline():
    """On a slope the lowest node is `height` above the plane, measured along z."""
    scene = parse_scene(changed(("incline = 0.0", "incline = 0.2")))
    above = scene.structure.nodes[:, 2] + np.tan(0.2) * scene.structure.nodes[:, 0]
    assert above.min() == pytest.approx(0.02, abs=1e-12)


def test_custom_structure():
    """Nodes stay where they are, whole numbers will do, and a missing height moves nothing."""
    scene = parse_scene(CUSTOM)
    np.testing.assert_array_equal(scene.structure.nodes, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(scene.structure.node_mass, [1, 2, 3])
    assert scene.structure.struts.rest_length.tolist() == [1.0]
    assert scene.structure.cables.rest_length.tolist() == [1.0]
    assert scene.structure.struts.damping is None


@pytest.mark.parametrize("table", ["struts", "cables", "gravity", "damping", "ground", "friction", "gait"])
def test_absent_tables_are_not_modelled(table):
    """Every table but [structure] may be left out; friction goes with the ground it acts on."""
    gone = {table, "friction"} if table == "ground" else {table}
    if table == "struts":
        gone.add("gait")
    parts = TEXT.split("\n[")
    kept = [part for part in parts if part.split("]")[0] not in gone]
    scene = parse_scene("\n[".join(kept))
    owner = scene.structure if table in ("struts", "cables") else scene
    assert getattr(owner, {"damping": "node_damping"}.get(table, table)) is None


def test_one_word_swaps_struts_for_cables():
    """The same file with another word actuates the cables; a list names any members, struts first."""
    six, many = "phase = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]", f"phase = {[0.1] * 24}"
    assert parse_scene(TEXT).gait.members == tuple(range(6))
    assert parse_scene(changed(('members = "struts"', 'members = "cables"'), (six, many))).gait.members == tuple(
        range(6, 30)
    )
    chosen = parse_scene(changed(('members = "struts"', "members = [5, 6, 29]"), (six, "phase = [0, 1, 2]")))
    assert chosen.gait.members == (5, 6, 29)


def test_random_cables_are_seeded():
    """About 20 % of the 24 cables: five, the same for the same seed, with phases by a seed of their own."""

    def drawn(seed: int):
        members = f'members = {{ random = 0.2, of = "cables", seed = {seed} }}'
        six = "phase = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]"
        return parse_scene(changed(('members = "struts"', members), (six, "phase = { seed = 1 }"))).gait

    assert len(drawn(0).members) == len(drawn(0).phase) == 5
    assert set(drawn(0).members) <= set(range(6, 30))
    assert drawn(0).members == drawn(0).members
    assert drawn(0).members != drawn(1).members
    np.testing.assert_array_equal(drawn(0).phase, drawn(1).phase)


def test_kinds_of_friction():
    """Smooth and switch, each with its own keys."""
    assert isinstance(parse_scene(TEXT).friction, SmoothFriction)
    switch = changed(('kind = "smooth"', 'kind = "switch"'), ("mu = 0.5", "mu_static = 0.6\nmu_kinetic = 0.5"))
    friction = parse_scene(switch).friction
    assert isinstance(friction, SwitchFriction)
    assert (float(friction.mu_static), float(friction.mu_kinetic)) == (0.6, 0.5)


def test_describe_says_what_is_modelled():
    """Terms, members, masses, prestress and frequencies; the cables of the reference scene carry about 105 N."""
    text = load_scene(SCENE).describe()
    lines = dict(line.split(maxsplit=1) for line in text.replace("not modelled", "absent").splitlines())
    assert "smooth friction" in lines["modelled"]
    assert lines["absent"] == "rigid struts, exact contact, Coulomb switch, Coulomb cone"
    assert "6 kg" in lines["nodes"]
    assert "cables 105" in lines["prestress"]
    assert "Hz" in lines["natural"]
    bare = parse_scene(CUSTOM).describe()
    assert "gravity" in bare.split("not modelled")[1]


def bad(old: str, new: str, *words: str):
    return pytest.param(old, new, words, id=f"{old} -> {new}"[:60])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        bad("[gravity]", "[gravity", "not TOML"),
        bad("stiffness = 2e4", "stifness = 2e4", "struts.stifness = 20000.0", "unknown key", "stiffness, rigid"),
        bad("[struts]", "[strutz]", "strutz: unknown table", "structure, struts"),
        bad("[structure]", "[frame]", "unknown table", "structure"),
        bad("stiffness = 2e4", "stiffness = -2e4", "struts.stiffness = -20000.0", "a number > 0"),
        bad("stiffness = 2e4", "stiffness = nan", "struts.stiffness = nan", "finite"),
        bad("stiffness = 600.0", "stiffness = [1.0, inf]", "cables.stiffness[1] = inf", "finite"),
        bad("stiffness = 600.0", "stiffness = [1.0, 2.0]", "cables.stiffness has 2 numbers", "24"),
        bad("stiffness = 600.0", "", "cables.stiffness: missing"),
        bad("stiffness = 2e4", 'stiffness = "hard"', "struts.stiffness = 'hard'", "expected a number or a list"),
        bad("node = 0.5", "node = true", "damping.node = True", "a number"),
        bad("mass = 6.0", "mass = -6.0", "structure.mass = -6.0", "> 0"),
        bad("mass = 6.0", "", "structure", "mass", "node_mass"),
        bad("mass = 6.0", "node_mass = [1.0, 2.0]", "structure.node_mass has 2 numbers", "12"),
        bad('kind = "icosahedron"', 'kind = "ico"', "structure.kind = 'ico'", "'icosahedron' or 'custom'"),
        bad('pose = "face"', 'pose = "edge"', "structure.pose = 'edge'", "'face' or 'strut'"),
        bad("4.0, 5.0]", "4.0]", "gait.phase has 5 numbers", "expected 6"),
        bad("amplitude = 0.3", "amplitude = 1.0", "gait.amplitude = 1.0", "< 1"),
        bad('members = "struts"', "members = [0, 30]\nphase_ = 0", "gait.phase_", "unknown key"),
        bad('members = "struts"', "members = [0, 1, 2, 3, 4, 30]", "member 30", "0 to 29"),
        bad('members = "struts"', "members = [0, 1, 2, 3, 4, 4]", "gait.members", "none twice"),
        bad("prestrain = 0.3", "prestrain = 0.3\nrest_length = 0.4", "prestrain and rest_length"),
        bad("mu = 0.5", "mu_static = 0.5", "friction.kind = 'smooth'", "mu_static", "expected mu, slip_speed"),
        bad('contact = "penalty"', 'contact = "complementarity"', "ground.contact", "expected neither stiffness"),
        bad("stiffness = 2e4", "rigid = true", "struts.rigid = true", "neither stiffness nor damping"),
        bad('kind = "smooth"', 'kind = "cone"', "friction.kind = 'cone'", "expected mu"),
        bad("dissipation = 2.0", "restitution = 0.5", "ground.restitution", "complementarity"),
        bad("stiffness = 1e4", "", "ground", "expected stiffness"),
        bad("incline = 0.0", "incline = 2.0", "ground.incline = 2.0"),
    ],
)
def test_bad_scenes_are_refused_in_one_line(old, new, words):
    """File, key, value received, what was expected."""
    with pytest.raises(InputError) as caught:
        parse_scene(changed((old, new)), "robot.toml")
    message = str(caught.value)
    assert message.startswith("robot.toml: ")
    assert "\n" not in message
    assert all(word in message for word in words), message


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        bad("struts = [[0, 1]]", "struts = [[0, 3]]", "structure.struts[0] = [0, 3]", "no node 3", "0 to 2"),
        bad("struts = [[0, 1]]", "struts = [[0, -1]]", "structure.struts[0]", "no node -1"),
        bad("struts = [[0, 1]]", "struts = [[1, 1]]", "structure.struts[0] = [1, 1]", "no length"),
        bad("[1, 0, 0]", "[0, 0, 0]", "structure.struts[0] = [0, 1]", "no length"),
        bad("cables = [[1, 2]]", "cables = [[1, 2], [2, 1]]", "structure.cables[1] = [2, 1]", "cables[0] joins"),
        bad("cables = [[1, 2]]", "cables = [[1, 0]]", "structure.cables[0] = [1, 0]", "struts[0] joins"),
        bad("struts = [[0, 1]]", "struts = [[0, 1, 2]]", "structure.struts[0]", "length 2"),
        bad("[0, 1, 0]]", "[0, 1]]", "structure.nodes[2]", "length 3"),
        bad("struts = [[0, 1]]", "", "struts: the structure has none"),
        bad("[[0, 0, 0], [1, 0, 0], [0, 1, 0]]", "[]", "structure.nodes = []", "length >= 1"),
    ],
)
def test_bad_structures_are_refused_in_one_line(old, new, words):
    """Members to nodes that are not there, without length, or twice; nodes that are no points."""
    assert old in CUSTOM
    with pytest.raises(InputError) as caught:
        parse_scene(CUSTOM.replace(old, new, 1), "robot.toml")
    assert all(word in str(caught.value) for word in words), caught.value


def test_friction_needs_a_ground():
    """A friction without anything to rub on is a mistake, not a scene without friction."""
    text = "\n[".join(part for part in TEXT.split("\n[") if not part.startswith("ground"))
    with pytest.raises(InputError, match="friction needs a ground"):
        parse_scene(text)


@pytest.mark.parametrize("make", [lambda p: None, Path.mkdir, lambda p: p.write_bytes(b"\xff\xfe\x00")])
def test_files_that_cannot_be_read(tmp_path, make):
    """Not there, a folder, not text: the file is named."""
    path = tmp_path / "scene.toml"
    make(path)
    with pytest.raises(InputError, match=r"scene\.toml: cannot be read"):
        load_scene(path)

"""Scene files: the numbers they turn into, and every refusal as one clear line."""

from itertools import pairwise
from pathlib import Path
from typing import get_args

import equinox as eqx
import numpy as np
import pytest

from jaxgrity import InputError, load_scene, parse_scene, scene_names, scene_text
from jaxgrity.io.structure_tables import CatalogueTable
from jaxgrity.model.actuation import contraction, rest_length
from jaxgrity.model.friction import ConeFriction, SmoothFriction, SwitchFriction
from jaxgrity.model.structure import edge_lengths
from jaxgrity.statics import member_forces

TEXT = scene_text("reference")
PHASE = "phase = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]"
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


def without(*tables: str) -> str:
    """The reference scene's text without some of its tables."""
    return "\n[".join(part for part in TEXT.split("\n[") if part.split("]")[0] not in tables)


def refusal(text: str) -> str:
    """What a user reads of a scene that is refused: one line that starts with the file."""
    with pytest.raises(InputError) as caught:
        parse_scene(text, "robot.toml")
    message = str(caught.value)
    assert message.startswith("robot.toml: ")
    assert message.isprintable(), message
    return message


def test_reference_scene():
    """Masses, lengths, prestress and pose as the file says."""
    structure = load_scene("reference").structure
    assert structure.nodes.shape == (12, 3)
    np.testing.assert_allclose(structure.node_mass, 0.5)
    np.testing.assert_allclose(edge_lengths(structure.nodes, structure.struts.edges), 1.0)
    np.testing.assert_allclose(edge_lengths(structure.nodes, structure.cables.edges), np.sqrt(6) / 4)
    np.testing.assert_allclose(structure.cables.rest_length, 0.7 * np.sqrt(6) / 4)
    np.testing.assert_allclose(structure.cables.stiffness, 600)
    np.testing.assert_allclose(structure.struts.damping, 36)
    np.testing.assert_allclose(np.sort(structure.nodes[:, 2])[:3], 0.02, atol=1e-12)


def test_whole_numbers_and_lists_stand_for_numbers():
    """`mass = 6` is a mass, and every member's number may be a list, one for each."""
    whole = parse_scene(changed(("mass = 6.0", "mass = 6"), ("damping = 36.0", "damping = [1, 2, 3, 4, 5, 0]")))
    np.testing.assert_allclose(whole.structure.node_mass, 0.5)
    assert whole.structure.struts.damping.tolist() == [1, 2, 3, 4, 5, 0]


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
    """Direction (1, 1, 1) of the pattern points down, by the shortest rotation: the face there is level, and lowest."""
    nodes = load_scene("reference").structure.nodes
    lowest = np.flatnonzero(np.isclose(nodes[:, 2], nodes[:, 2].min(), atol=1e-9))
    assert len(lowest) == 3
    pattern = parse_scene(changed(('pose = "face"', 'pose = "strut"'))).structure.nodes
    pattern = pattern - pattern.mean(0)
    np.testing.assert_allclose(pattern[lowest].sum(1), pattern.sum(1).max(), atol=1e-12)
    axis = np.cross([1, 1, 1], [0, 0, -1])
    np.testing.assert_allclose((nodes - nodes.mean(0)) @ axis, pattern @ axis, atol=1e-12)


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
    beside = {"ground": ["friction"], "struts": ["gait"]}.get(table, [])
    scene = parse_scene(without(table, *beside))
    owner = scene.structure if table in ("struts", "cables") else scene
    assert getattr(owner, {"damping": "node_damping"}.get(table, table)) is None


def test_one_word_swaps_struts_for_cables():
    """The same file with another word actuates the cables; a list names any members, struts first."""
    seeded = (PHASE, "phase = { seed = 3 }")
    assert parse_scene(changed(seeded)).gait.members == tuple(range(6))
    cables = parse_scene(changed(seeded, ('members = "struts"', 'members = "cables"'))).gait
    assert cables.members == tuple(range(6, 30))
    assert cables.phase.shape == (24,)
    chosen = parse_scene(changed(('members = "struts"', "members = [5, 6, 29]"), (PHASE, "phase = [0, 1, 2]")))
    assert chosen.gait.members == (5, 6, 29)
    assert chosen.gait.phase.tolist() == [0, 1, 2]


def test_random_cables_are_seeded():
    """About 20 % of the 24 cables: five, the same for the same seed, with phases by a seed of their own."""

    def drawn(seed: int):
        members = f'members = {{ random = 0.2, of = "cables", seed = {seed} }}'
        return parse_scene(changed(('members = "struts"', members), (PHASE, "phase = { seed = 1 }"))).gait

    assert len(drawn(0).members) == len(drawn(0).phase) == 5
    assert set(drawn(0).members) <= set(range(6, 30))
    assert drawn(0).members == drawn(0).members
    assert drawn(0).members != drawn(1).members
    np.testing.assert_array_equal(drawn(0).phase, drawn(1).phase)


def test_kinds_of_friction():
    """Smooth, switch and cone, each with its own keys."""
    assert isinstance(parse_scene(TEXT).friction, SmoothFriction)
    switch = changed(('kind = "smooth"', 'kind = "switch"'), ("mu = 0.5", "mu_static = 0.6\nmu_kinetic = 0.5"))
    friction = parse_scene(switch).friction
    assert isinstance(friction, SwitchFriction)
    assert (float(friction.mu_static), float(friction.mu_kinetic)) == (0.6, 0.5)
    exact = load_scene("exact")
    assert isinstance(exact.friction, ConeFriction)
    assert exact.ground.impulsive
    assert exact.structure.struts.rigid


def test_stuck_members_keep_their_rest_length():
    """Whatever the gait asks of them; the others do as it says, among struts and cables, some actuated or all."""
    for members, move in (('"struts"', 4), ('"cables"', 22), ("[0, 2, 8, 29, 7]", 2)):
        gait = (('members = "struts"', f"members = {members}"), (PHASE, "phase = { seed = 3 }"))
        free = parse_scene(changed(*gait))
        text = changed(*gait, ("damping = 36.0", "stuck = [4, 2]"), ("damping = 8.0", "stuck = [2, 23]"))
        scene = parse_scene(text)
        assert (scene.structure.struts.stuck, scene.structure.cables.stuck) == ((2, 4), (2, 23))
        moved = 0
        for kind, first in (("struts", 0), ("cables", 6)):
            part = getattr(scene.structure, kind)
            lengths = np.array(rest_length(part, scene.gait, 2.3, first))
            wanted = np.array(rest_length(getattr(free.structure, kind), free.gait, 2.3, first))
            wanted[list(part.stuck)] = part.rest_length[list(part.stuck)]
            np.testing.assert_array_equal(lengths, wanted)
            moved += np.count_nonzero(lengths != part.rest_length)
        assert moved == move


def test_where_every_actuated_member_is_stuck_nothing_moves():
    """Rest lengths are those of the structure."""
    text = changed(('members = "struts"', "members = [1]"), (PHASE, "phase = [0.0]"), ("damping = 36.0", "stuck = [1]"))
    scene = parse_scene(text)
    lengths = rest_length(scene.structure.struts, scene.gait, 2.3, 0)
    np.testing.assert_array_equal(lengths, scene.structure.struts.rest_length)


def test_broken_cables_neither_pull_nor_damp():
    """All else stays: they are still members, with numbers."""
    whole, scene = (
        parse_scene(TEXT).structure,
        parse_scene(changed(("[cables]", "[cables]\nbroken = [7, 3]"))).structure,
    )
    others = np.delete(np.arange(24), [3, 7])
    for part in ("stiffness", "damping"):
        ours, before = getattr(scene.cables, part), getattr(whole.cables, part)
        np.testing.assert_array_equal(ours[[3, 7]], 0)
        np.testing.assert_array_equal(ours[others], before[others])
    np.testing.assert_array_equal(scene.cables.rest_length, whole.cables.rest_length)
    assert scene.cables.edges == whole.cables.edges


@pytest.mark.parametrize("damping", ["", "damping = 0.0", "damping = [0.0, 0, 0.0, 0.0, 0.0, 0]"])
def test_rigid_struts_take_no_damping_however_it_is_said(damping):
    """Left out, as one zero, or as a zero for each: rigid struts, without a damper."""
    struts = parse_scene(changed(("stiffness = 2e4", "rigid = true"), ("damping = 36.0", damping))).structure.struts
    assert struts.rigid
    assert struts.damping is None


@pytest.mark.parametrize("damping", ["damping = 36.0", "damping = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]"])
def test_rigid_struts_with_damping_are_refused(damping):
    """A rigid strut does not change its length, but as its actuator says."""
    message = refusal(changed(("stiffness = 2e4", "rigid = true"), ("damping = 36.0", damping)))
    assert "struts.rigid = true: a rigid strut has no spring; expected neither stiffness nor damping" in message


@pytest.mark.parametrize("dissipation", ["", "dissipation = 0.0"])
def test_ground_that_dissipates_nothing_has_no_dissipation(dissipation):
    """Left out, or a zero: not modelled."""
    assert parse_scene(changed(("dissipation = 2.0", dissipation))).ground.dissipation is None


def bad(old: str, new: str, *words: str):
    return pytest.param(old, new, words, id=f"{old} -> {new}"[:60])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        # what is not TOML, or not numbers
        bad("[gravity]", "[gravity", "not TOML"),
        bad("mass = 6.0", f"mass = {'[' * 3000}", "not TOML"),
        bad("stiffness = 2e4", "stiffness = nan", "struts.stiffness = nan: expected a finite number"),
        bad("stiffness = 600.0", "stiffness = [1.0, inf]", "cables.stiffness[1] = inf: expected a finite number"),
        bad("mass = 6.0", f"mass = {'9' * 400}", "structure.mass = 9", "...", "expected a finite number"),
        # unknown and missing
        bad(
            "stiffness = 2e4",
            "stifness = 2e4",
            "struts.stifness = 20000.0: unknown key; expected one of stiffness, mass, damping, prestrain, rest",
        ),
        bad("mass = 6.0", "weight = 6", "structure.weight = 6: unknown key; expected one of kind, strut_length, mass"),
        bad("[struts]", "[strutz]", "strutz: unknown table; expected one of structure, struts, cables, gravity"),
        bad("[struts]", '["a\\nb"]', r"'a\nb': unknown table; expected one of structure, struts"),
        bad("stiffness = 2e4", '"a\\nb" = nan', r"struts.'a\nb' = nan: expected a finite number"),
        bad('members = "struts"', "members = { part = 1 }", "gait.members.part = 1: unknown key", "one of random"),
        bad('kind = "icosahedron"', "", "structure.kind: missing; expected 'icosahedron', 'prism', ", " or 'custom'"),
        bad("stiffness = 600.0", "", "cables.stiffness: missing; expected a number > 0 or a list of numbers > 0"),
        bad("stiffness = 2e4", "", "struts.stiffness: missing; expected a stiffness (N/m) or rigid = true"),
        bad("stiffness = 1e4", "", "ground.stiffness: missing; expected a stiffness (N/m)"),
        bad("mass = 6.0", "", "structure.mass: missing; expected mass", "or node_mass"),
        bad(PHASE, "", "gait.phase: missing; expected a list of numbers or a table (seed)"),
        bad(PHASE, "phase = {}", "gait.phase.seed: missing; expected a whole number >= 0"),
        # of another type
        bad(
            "stiffness = 2e4",
            'stiffness = "hard"',
            "struts.stiffness = 'hard': expected a number > 0 or a list of numbers > 0, got a string",
        ),
        bad("mass = 6.0", "mass = [6.0]", "structure.mass = [6.0]: expected a number > 0, got a list"),
        bad("mass = 6.0", "mass = 2020-02-02", "structure.mass = 2020-02-02: expected a number > 0, got a date"),
        bad("height = 0.02", "height = { m = 1 }", "structure.height: expected a number, got a table"),
        bad("node = 0.5", "node = true", "damping.node = true: expected a number >= 0", "got a boolean"),
        bad("g = 9.81", "g = false", "gravity.g = false: expected a number >= 0, got a boolean"),
        bad("stiffness = 2e4", "rigid = 1", "struts.rigid = 1: expected true or false, got a whole number"),
        bad("5.0]", "true]", "gait.phase[5] = true: expected a number, got a boolean"),
        bad('members = "struts"', "members = [0.5]", "gait.members[0] = 0.5: expected a whole number, got a number"),
        bad("[gravity]", "[[gravity]]", "gravity = [{'g': 9.81}]: expected a table (g), got a list"),
        # of another choice
        bad(
            'kind = "icosahedron"',
            'kind = "ico"',
            "structure.kind = 'ico': expected 'icosahedron', 'prism', ",
            " or 'custom'",
        ),
        bad(
            'kind = "icosahedron"',
            "kind = 3",
            "structure.kind = 3: expected 'icosahedron', ",
            " or 'custom', got a whole",
        ),
        bad('pose = "face"', 'pose = "fac"', "structure.pose = 'fac': expected 'face' or 'strut'"),
        bad('kind = "smooth"', 'kind = "oily"', "friction.kind = 'oily': expected 'smooth', 'switch' or 'cone'"),
        bad(
            'members = "struts"',
            'members = "all"',
            "gait.members = 'all': expected 'struts', 'cables', a list of whole numbers or a table (random, of, seed)",
        ),
        # out of range
        bad("stiffness = 2e4", "stiffness = -2e4", "struts.stiffness = -20000.0: expected a number > 0"),
        bad("damping = 8.0", f"damping = {[*[8] * 23, -8]}", "cables.damping[23] = -8: expected a number >= 0"),
        bad("mass = 6.0", "mass = -6.0", "structure.mass = -6.0: expected a number > 0"),
        bad("amplitude = 0.3", "amplitude = 1.0", "gait.amplitude = 1.0: expected a number >= 0 and < 1"),
        bad("incline = 0.0", "incline = 2.0", "ground.incline = 2.0: expected a number > -1.571 and < 1.571"),
        bad(PHASE, "phase = { seed = -1 }", "gait.phase.seed = -1: expected a whole number >= 0"),
        bad("[struts]", "[struts]\nstuck = [6]", "struts.stuck = [6]: expected numbers from 0 to 5, none twice"),
        bad(
            "[cables]", "[cables]\nstuck = [0, 24]", "cables.stuck = [0, 24]: expected numbers from 0 to 23, none twice"
        ),
        bad("[cables]", "[cables]\nbroken = [24]", "cables.broken = [24]: expected numbers from 0 to 23, none twice"),
        bad("[cables]", "[cables]\nbroken = [1, 1]", "cables.broken = [1, 1]: expected", "none twice"),
        bad("[cables]", "[cables]\nbroken = [-1]", "cables.broken[0] = -1: expected a whole number >= 0"),
        bad("[cables]", "[cables]\nbroken = 3", "cables.broken = 3: expected a list of whole numbers >= 0"),
        bad("[struts]", "[struts]\nstuck = [0.5]", "struts.stuck[0] = 0.5: expected a whole number", "got a number"),
        bad("[struts]", "[struts]\nbroken = [1]", "struts.broken = [1]: unknown key; expected one of stiffness"),
        # of another length
        bad("stiffness = 600.0", "stiffness = [1.0, 2.0]", "cables.stiffness has 2 numbers; expected one, or 24"),
        bad("damping = 36.0", "damping = []", "struts.damping has 0 numbers; expected one, or 6"),
        bad("prestrain = 0.3", "prestrain = []", "cables.prestrain has 0 numbers; expected one, or 24"),
        bad("mass = 6.0", "node_mass = [1.0, 2.0]", "structure.node_mass has 2 numbers; expected 12"),
        bad("4.0, 5.0]", "4.0]", "gait.phase has 5 numbers; expected 6"),
        # that do not fit each other
        bad("mass = 6.0", "mass = 6.0\nnode_mass = [1]", "structure.mass = 6.0: node_mass is given too; expected one"),
        bad(
            "prestrain = 0.3",
            "prestrain = 0.3\nrest_length = 0.4",
            "cables.prestrain = 0.3: rest_length is given too; expected one of them",
        ),
        bad('members = "struts"', "members = [0, 1, 2, 3, 4, 30]", "gait.members names member 30; expected 0 to 29"),
        bad('members = "struts"', "members = [0, 0]", "gait.members = [0, 0]: expected", "none twice"),
        bad('members = "struts"', "members = []", "gait.members = []: expected at least one member"),
        bad("mu = 0.5", "mu = [0.5, 0.6]", "friction.mu has 2 numbers; expected one, or 12"),
        bad("mu = 0.5", "mu_static = 0.5", "friction.kind = 'smooth' comes with mu_static", "expected mu, slip_speed"),
        bad('kind = "smooth"', 'kind = "cone"', "friction.kind = 'cone' comes with mu, slip_speed; expected mu"),
        bad(
            'kind = "smooth"\nmu = 0.5',
            'kind = "switch"\nmu_static = 0.4\nmu_kinetic = 0.5',
            "friction.mu_static = 0.4: expected at least mu_kinetic = 0.5, since friction does not grow as a node",
        ),
        bad('kind = "smooth"\nmu = 0.5\nslip_speed = 0.01', "", "'smooth' comes with no keys; expected mu, slip_speed"),
        bad('contact = "penalty"', 'contact = "complementarity"', "ground.contact", "expected neither stiffness"),
        bad("stiffness = 2e4", "rigid = true", "struts.rigid = true", "expected neither stiffness nor damping"),
        bad("dissipation = 2.0", "restitution = 0.5", "ground.restitution = 0.5 goes with", "expected dissipation"),
    ],
)
def test_bad_scenes_are_refused_in_one_line(old, new, words):
    """File, key, value received, what was expected."""
    message = refusal(changed((old, new)))
    assert all(word in message for word in words), message


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        bad("struts = [[0, 1]]", "struts = [[0, 3]]", "structure.struts[0] = [0, 3]: there is no node 3", "0 to 2"),
        bad("struts = [[0, 1]]", "struts = [[0, -1]]", "structure.struts[0] = [0, -1]: there is no node -1", "0 to 2"),
        bad("struts = [[0, 1]]", "struts = [[1, 1]]", "structure.struts[0] = [1, 1]", "no length; expected two nodes"),
        bad("[1, 0, 0]", "[0, 0, 0]", "structure.struts[0] = [0, 1]", "no length; expected two nodes apart"),
        bad("cables = [[1, 2]]", "cables = [[1, 2], [2, 1]]", "structure.cables[1] = [2, 1]", "cables[0] joins"),
        bad("cables = [[1, 2]]", "cables = [[1, 0]]", "structure.cables[0] = [1, 0]", "struts[0] joins"),
        bad(
            "struts = [[0, 1]]",
            "struts = [[0, 1, 2]]",
            "structure.struts[0] = [0, 1, 2]: expected a list of 2 whole numbers, got 3",
        ),
        bad("struts = [[0, 1]]", "struts = [[0, 0.5]]", "structure.struts[0][1] = 0.5: expected a whole number"),
        bad("[0, 1, 0]]", "[0, 1]]", "structure.nodes[2] = [0, 1]: expected a list of 3 numbers, got 2"),
        bad("[0, 1, 0]]", "[0, 1, nan]]", "structure.nodes[2][2] = nan: expected a finite number"),
        bad(
            "nodes = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]",
            "nodes = []",
            "structure.nodes = []: expected a list of lists of 3 numbers, at least 1",
        ),
        bad("nodes = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]", "", "structure.nodes: missing; expected a list of lists"),
        bad("node_mass", "strut_length = 1\nnode_mass", "structure.strut_length = 1: unknown key", "kind, nodes"),
        bad("[1.0, 2.0, 3.0]", "[1.0, 2.0, 0]", "structure.node_mass[2] = 0: no member there has mass either"),
        bad("struts = [[0, 1]]", "", "struts: the structure has none; expected no [struts] table"),
    ],
)
def test_bad_structures_are_refused_in_one_line(old, new, words):
    """Members to nodes that are not there, without length, or twice; nodes that are no points."""
    assert old in CUSTOM
    message = refusal(CUSTOM.replace(old, new, 1))
    assert all(word in message for word in words), message


@pytest.mark.parametrize("text", ["", "[gravity]\ng = 9.81\n"])
def test_a_scene_has_a_structure(text):
    """It is the one table that may not be left out."""
    assert "structure: missing; expected a table (kind = 'icosahedron')" in refusal(text)


def test_tables_that_need_each_other():
    """Friction without a ground to rub on, or a gait of cables that are not modelled, is a mistake."""
    assert "friction needs a ground" in refusal(without("ground"))
    assert "expected [ground] beside [friction]" in refusal(without("ground"))
    bare = without("cables")
    for members in ('"cables"', "{ random = 0.2 }"):
        message = refusal(bare.replace('members = "struts"', f"members = {members}"))
        assert "gait.members: 'cables' is chosen" in message
        assert "expected a [cables] table" in message


@pytest.mark.parametrize(
    ("name", "nearest"), [("referense", "; perhaps you meant reference"), ("no/such/robot.toml", "")]
)
def test_scenes_that_are_not_there(name, nearest):
    """Neither a file nor one of the library's: these are named, and the one that is spelt nearly so comes first."""
    listed = "; expected a file, or one of exact, paper_program"
    with pytest.raises(InputError, match=rf"^scene '{name}': unknown{nearest}{listed}"):
        load_scene(name)


@pytest.mark.parametrize(
    ("make", "reason"),
    [(Path.mkdir, "Is a directory"), (lambda path: path.write_bytes(b"\xff\xfe\x00"), "utf-8")],
    ids=["folder", "not text"],
)
def test_files_that_cannot_be_read(tmp_path, make, reason):
    """A folder, not text: the file is named."""
    path = tmp_path / "scene.toml"
    make(path)
    with pytest.raises(InputError, match=rf"^.*scene\.toml: cannot be read: .*{reason}") as caught:
        load_scene(path)
    assert "\n" not in str(caught.value)


def test_errors_name_the_file_that_was_loaded(tmp_path):
    """`load_scene` puts the path in front."""
    path = tmp_path / "scene.toml"
    path.write_text(changed(("mass = 6.0", "mass = 0")))
    with pytest.raises(InputError) as caught:
        load_scene(path)
    assert str(caught.value) == f"{path}: structure.mass = 0: expected a number > 0"


@pytest.mark.parametrize("name", scene_names())
def test_every_scene_that_ships_loads(name):
    """By its name, as from its text and from a file."""
    scene = load_scene(name)
    assert scene.gait is not None
    assert eqx.tree_equal(scene, parse_scene(scene_text(name)))


def test_scenes_load_by_path(tmp_path):
    """Given as text or as a path."""
    path = tmp_path / "robot.toml"
    path.write_text(TEXT)
    for given in (path, str(path)):
        assert eqx.tree_equal(load_scene(given), load_scene("reference"))


def test_a_gait_may_have_begun_before():
    """start = -ramp: in full swing from t = 0."""
    text = TEXT.replace("start = 1.0", "start = -1.0")
    gait = parse_scene(text).gait
    np.testing.assert_allclose(
        contraction(gait, 0.0), gait.amplitude / 2 * (1 + np.sin(gait.phase)), rtol=0, atol=1e-15
    )


CATALOGUE = """
[structure]
kind = "KIND"
mass = 2.0
prestress = 30.0
[struts]
stiffness = 2e4
[cables]
stiffness = 900.0
"""


@pytest.mark.parametrize("kind", [table.__struct_config__.tag for table in get_args(CatalogueTable)])
def test_every_kind_of_structure_stands_under_its_prestress(kind):
    """Forces balance at every node in the shape of the formula, and the tightest cable has the tension asked for."""
    structure = parse_scene(CATALOGUE.replace("KIND", kind)).structure
    nodes, forces = np.asarray(structure.nodes), member_forces(structure, structure.nodes)
    balance = np.zeros(nodes.shape)
    for (i, j), force in zip(structure.struts.edges + structure.cables.edges, forces):
        pull = force * (nodes[j] - nodes[i]) / np.linalg.norm(nodes[j] - nodes[i])
        balance[i] += pull
        balance[j] -= pull
    np.testing.assert_allclose(balance, 0, atol=1e-7)
    np.testing.assert_allclose(forces[structure.first_cable :].max(), 30.0, rtol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"KIND"', '"prism"\nstruts = 2', "structure.struts = 2: expected a whole number, at least 3"),
        ('"KIND"', '"ball"\nstruts = 7', "structure.struts = 7: expected 6, 12 or 30"),
        (
            '"KIND"',
            '"tower"\nstages = 1000000',
            "structure.stages = 1000000: expected a whole number >= 1 and <= 1e+04",
        ),
        ("stiffness = 900.0", "stiffness = 900.0\nprestrain = 0.1", "expected neither cables.prestrain nor"),
        ("stiffness = 900.0", "stiffness = 1.0", "needs a rest length of"),
        ("prestress = 30.0", "prestress = -3.0", "structure.prestress = -3.0: expected a number > 0"),
    ],
)
def test_structures_that_cannot_be_made_are_refused(old, new, words):
    """In one line."""
    assert words in refusal(CATALOGUE.replace(old, new).replace("KIND", "prism"))

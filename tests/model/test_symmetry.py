"""Symmetries: a group of the right size, fewer where a part differs, and gaits whose motions are images of a gait's."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest

from jaxgrity import (
    ConeFriction,
    ExactGround,
    Gait,
    InputError,
    Scene,
    SolverOptions,
    Structure,
    parse_scene,
    scene_text,
    simulate_population,
)
from jaxgrity.model import Balls, rigid_body
from jaxgrity.model.joints import joined_bodies
from jaxgrity.model.symmetry import gene_permutations, image, standing_symmetries, symmetries
from jaxgrity.structures import prism_tower


def on_strut(name: str):
    """The scene of that name, with the robot standing on a strut."""
    return parse_scene(scene_text(name).replace('pose = "face"', 'pose = "strut"'))


def random_gait(members: tuple[int, ...]) -> Gait:
    """One whose members all differ in everything."""
    random = np.random.default_rng(0)
    ranges = ((0, 2 * np.pi), (0.1, 0.4), (0.3, 0.6))
    return Gait(members, *(random.uniform(*ends, len(members)) for ends in ranges), start=0.5, ramp=0.5)


def together(gaits: list[Gait]) -> Gait:
    """Gaits as one population."""
    return jax.tree.map(lambda *rows: np.stack(rows) if np.ndim(rows[0]) else rows[0], *gaits)


@pytest.fixture(scope="module")
def group(reference):
    return symmetries(reference.structure)


def test_maps_are_orthogonal_and_move_nodes_and_members_together(reference, group):
    """Node i is moved to where node nodes[i] was, and the ends of a member to the ends of its image."""
    structure = reference.structure
    edges = structure.struts.edges + structure.cables.edges
    r = structure.nodes - structure.nodes.mean(0)
    for s in group:
        np.testing.assert_allclose(s.matrix @ s.matrix.T, np.eye(3), atol=1e-14)
        np.testing.assert_allclose(r @ s.matrix.T, r[list(s.nodes)], atol=1e-14)
        for k, (i, j) in enumerate(edges):
            assert {s.nodes[i], s.nodes[j]} == set(edges[s.members[k]])


def test_icosahedron_has_the_group_of_24(group):
    """T_h: the identity, 11 more rotations, and 12 with a mirror; any two after each other make a third of them."""
    assert group[0].nodes == tuple(range(12))
    assert group[0].members == tuple(range(30))
    assert [round(np.linalg.det(s.matrix)) for s in group] == [1] * 12 + [-1] * 12
    known = {s.nodes: s for s in group}
    assert len(known) == 24
    for a in group:
        for b in group:
            both = known[tuple(a.nodes[i] for i in b.nodes)]
            np.testing.assert_allclose(both.matrix, a.matrix @ b.matrix, atol=1e-14)
            assert both.members == tuple(a.members[k] for k in b.members)


def test_mirrors_can_be_left_out(reference, group):
    without = symmetries(reference.structure, mirrors=False)
    assert [s.nodes for s in without] == [s.nodes for s in group[:12]]


def test_all_poses_and_models_have_the_same_group(exact, group):
    """Turned in space, or with rigid struts, the same nodes and members go to the same places."""
    for structure in (on_strut("reference").structure, exact.structure):
        assert {(s.nodes, s.members) for s in symmetries(structure)} == {(s.nodes, s.members) for s in group}


@pytest.mark.parametrize(
    ("part", "left"),
    [
        (lambda s: s.cables.stiffness, 1),
        (lambda s: s.cables.rest_length, 1),
        (lambda s: s.struts.damping, 4),
        (lambda s: s.node_mass, 2),
    ],
    ids=["cable stiffness", "cable rest length", "strut damping", "node mass"],
)
def test_one_part_that_differs_leaves_fewer(reference, part, left):
    """Those that leave the part in its place: no two do so with a cable, and a mirror through it with a node."""
    changed = np.array(part(reference.structure))
    changed[0] *= 1 + 1e-6
    assert len(symmetries(eqx.tree_at(part, reference.structure, changed))) == left


def test_a_strut_that_is_stuck_stays_in_its_place(reference):
    structure = reference.structure
    stuck = dataclasses.replace(structure, struts=dataclasses.replace(structure.struts, stuck=(2,)))
    assert all(s.members[2] == 2 for s in symmetries(stuck))
    assert len(symmetries(stuck)) == 4


def test_prism_has_no_mirrors():
    """Turns by 120 degrees, each also upside down; only the turns leave it standing."""
    prism = prism_tower(3, exact=False)
    assert len(symmetries(prism.structure)) == len(symmetries(prism.structure, mirrors=False)) == 6
    assert len(standing_symmetries(prism)) == 3


def test_positions_have_to_decide_the_map():
    flat = Structure(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), np.ones(4))
    with pytest.raises(InputError, match="plane"):
        symmetries(flat)
    double = Structure(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1]]), np.ones(5))
    with pytest.raises(InputError, match="one place"):
        symmetries(double)


def test_standing_leaves_what_acts_from_outside(reference):
    """Up on level ground, the slope too on an incline, and nodes that friction or damping single out."""
    assert len(standing_symmetries(reference)) == 3
    standing = on_strut("reference")
    assert [round(np.linalg.det(s.matrix)) for s in standing_symmetries(standing)] == [1, 1, -1, -1]
    slope = dataclasses.replace(standing, ground=dataclasses.replace(standing.ground, incline=0.1))
    (_, mirror) = standing_symmetries(slope)
    np.testing.assert_allclose(mirror.matrix, np.diag([1, -1, 1]), atol=1e-14)
    assert len(standing_symmetries(eqx.tree_at(lambda s: s.node_damping, reference, np.arange(12.0)))) == 1
    assert len(standing_symmetries(eqx.tree_at(lambda s: s.friction.mu, reference, np.arange(12.0)))) == 1
    nothing = eqx.tree_at(lambda s: (s.gravity, s.ground, s.friction), reference, (None, None, None))
    assert len(standing_symmetries(nothing)) == 24
    tilted = np.array([np.sin(0.1), 0, np.cos(0.1)])
    leaning = eqx.tree_at(lambda s: s.up, standing, tilted, is_leaf=lambda x: x is None)
    assert len(standing_symmetries(leaning)) == 2


@pytest.mark.parametrize("pose", ["face", "strut"])
@pytest.mark.slow
def test_image_rolls_elsewhere(exact, pose):
    """Turned by 120 degrees and back on a face; on a strut by 180 degrees, and mirrored twice.

    Rounding alone tells the motions apart, 1e-15 m or so at first. Disturbances grow, in these 3 s to less than
    1e-13 m; 1e-9 m leaves room for other processors, and is far below the displacement of some tenths of a metre.
    """
    scene = exact if pose == "face" else on_strut("exact")
    # as many on a face as on a strut, with one twice, so that the program is compiled once
    standing = (standing_symmetries(scene) * 2)[:4]
    gait = random_gait(scene.gait.members)
    gaits = together([image(gait, s) for s in standing])
    outcomes = simulate_population(scene, gaits, 3.0, options=SolverOptions(dt=5e-3))
    moved = np.asarray(outcomes.com_end - outcomes.com_start)
    assert np.linalg.norm(moved[0, :2]) > 0.1
    np.testing.assert_allclose(moved, [s.matrix @ moved[0] for s in standing], rtol=0, atol=1e-9)
    nodes = np.asarray(outcomes.positions) - np.asarray(outcomes.com_start)[:, None]
    for s, found in zip(standing, nodes):
        np.testing.assert_allclose(found[list(s.nodes)], nodes[0] @ s.matrix.T, rtol=0, atol=1e-9)


def test_image_of_an_image_is_the_image_under_both(group):
    """In every array of the gait, and for a population as for one; whatever the order of its members."""
    gait = random_gait((3, 1, 0, 5, 2, 4))
    known = {s.nodes: s for s in group}
    for a in group[::5]:
        for b in group[::3]:
            both = image(gait, known[tuple(a.nodes[i] for i in b.nodes)])
            twice = image(image(gait, b), a)
            assert eqx.tree_equal(twice, both)
            many = image(image(together([gait, gait]), b), a)
            assert eqx.tree_equal(many, together([both, both]))
            values = dict(zip(both.members, both.phase))
            for k, phase in zip(gait.members, gait.phase):
                assert values[a.members[b.members[k]]] == phase
    assert both.members == gait.members
    assert both.start == gait.start


def test_image_that_actuates_other_members_is_refused(reference, group):
    """One cable of the 24: only the identity leaves it in its place."""
    gait = random_gait((6,))
    turned = standing_symmetries(reference)[1]
    with pytest.raises(InputError, match=rf"actuates members \[{turned.members[6]}\]; expected \[6\]"):
        image(gait, turned)
    assert eqx.tree_equal(image(gait, group[0]), gait)


def test_gene_permutations_are_those_of_images(reference, group):
    """Each once, without those that would move actuation to other members."""
    standing = standing_symmetries(reference)
    members = reference.gait.members
    permutations = gene_permutations(members, standing)
    gait = random_gait(members)
    for p, s in zip(permutations, standing, strict=True):
        np.testing.assert_array_equal(gait.phase[..., list(p)], image(gait, s).phase)
    assert len(gene_permutations(members, group)) == 24
    assert len(gene_permutations((0, 1), group)) == 2
    assert gene_permutations((6,), group) == ((0,),)
    assert gene_permutations((7, 2), standing) == ((0, 1),)


def test_a_ball_at_a_joint_turns_with_one_body_alone():
    """So two equal bodies that share it are not images of each other, if the ball has a radius and stands on ground."""
    spread = np.array([[0.5, 0.05, 0], [0.3, 0.4, 0.1], [0.2, -0.1, 0.6]])
    up = np.array([0.0, 0.0, 0.1])
    nodes = up + np.array([np.zeros(3), *spread, *(spread * [-1, -1, 1])])
    inertia, half_turn = np.diag([0.02, 0.03, 0.025]), np.array([-1.0, -1.0, 1.0])
    centre, points = np.array([0.3, 0.1, 0.2]), ([0, 1, 2, 3], [0, 4, 5, 6])
    bodies = joined_bodies(
        points,
        (),
        lambda k, basic: rigid_body(nodes, points[k], 1.0, inertia, half_turn**k * centre + up, basic=basic),
    )
    free = Scene(Structure(nodes, np.zeros(7), bodies=bodies), 9.81)
    standing = dataclasses.replace(free, ground=ExactGround(balls=Balls((0,), [0.1])), friction=ConeFriction(0.9))
    assert len(standing_symmetries(free)) == 2
    assert len(standing_symmetries(standing)) == 1

"""Forms from struts and cables without coordinates: closed forms, symmetry, and topologies that have none."""

import jaxtyping
import numpy as np
import pytest

from jaxgrity import InputError, Members, Structure, edge_lengths
from jaxgrity.model import symmetries
from jaxgrity.statics import alike_members, equilibrium_matrix, form_of_topology, stress_matrix, super_stable
from jaxgrity.structures import Geometry, ball, icosahedron, planar_spine, prism, random_tensegrity, tower

SIDES, DIAGONALS = ((0, 1), (1, 2), (2, 3), (3, 0)), ((0, 2), (1, 3))


def assert_stands(nodes, edges, q, first, dimensions=3):
    """Balanced to rounding, super-stable, of the least rank, with signs as they are to be."""
    np.testing.assert_allclose(equilibrium_matrix(nodes, edges) @ q, 0, atol=1e-13)
    assert np.all(q[:first] < 0)
    assert np.all(q[first:] > 0)
    assert q.max() == 1
    assert edge_lengths(nodes, edges[:first]).mean() == pytest.approx(1, rel=1e-12)
    assert edge_lengths(nodes, edges).min() > 1e-3
    assert super_stable(nodes, edges, q)
    values = np.linalg.eigvalsh(stress_matrix(q, edges, len(nodes)).toarray())
    assert np.sum(np.abs(values) > 1e-9 * values[-1]) == len(nodes) - 1 - dimensions
    spread = np.linalg.svd(nodes - nodes.mean(0))[1]
    np.testing.assert_allclose(spread, [spread[0]] * dimensions + [0.0] * (3 - dimensions), atol=1e-12)


@pytest.mark.parametrize("n", [*range(3, 9), 12, 20])
def test_prisms(n):
    """Twist pi/2 + pi/n from strut to strut, or its mirror image; q_vertical/q_polygon = 2 sin(pi/n) = -q_strut."""
    _, struts, cables = prism(n)
    nodes, q = form_of_topology(struts, cables)
    assert_stands(nodes, struts + cables, q, n)
    np.testing.assert_allclose(q[3 * n :] / q[n], 2 * np.sin(np.pi / n), rtol=1e-12)
    np.testing.assert_allclose(q[:n] / q[3 * n :], -1, rtol=1e-12)
    low, high = nodes[:n] - nodes[:n].mean(0), nodes[n:] - nodes[n:].mean(0)
    turn = np.arccos((low * high).sum(1) / np.linalg.norm(low, axis=1) / np.linalg.norm(high, axis=1))
    np.testing.assert_allclose(turn, np.pi / 2 + np.pi / n, rtol=1e-12)


def test_icosahedron():
    """q_strut = -3/2 q_cable; with second moments alike, the shape is the catalogue's."""
    given, struts, cables = icosahedron(1.0)
    nodes, q = form_of_topology(struts, cables)
    assert_stands(nodes, struts + cables, q, 6)
    np.testing.assert_allclose(q[:6], -1.5, rtol=1e-14)
    x, y = nodes - nodes.mean(0), given - given.mean(0)
    np.testing.assert_allclose(x @ x.T, y @ y.T, atol=1e-14)


def test_truncated_tetrahedron():
    """The determinant of a node's equilibrium is 0 at 4 w^2 + 11 w + 5 = 0, with w of struts and 1 of all cables."""
    _, struts, cables = ball(6)
    nodes, q = form_of_topology(struts, cables)
    assert_stands(nodes, struts + cables, q, 6)
    np.testing.assert_allclose(q[:6], (np.sqrt(41) - 11) / 8, rtol=1e-14)
    groups = alike_members(struts, cables)
    assert [len(group) for group in groups] == [6, 12, 6]


def test_cross_in_a_square():
    """In a plane, with rank nodes - 3."""
    nodes, q = form_of_topology(DIAGONALS, SIDES, dimensions=2)
    assert_stands(nodes, DIAGONALS + SIDES, q, 2, dimensions=2)
    np.testing.assert_allclose(q, [-1, -1, 1, 1, 1, 1], rtol=1e-14)


def test_random_starts_find_forms_where_the_first_has_none():
    """In a plane the icosahedron's symmetry has no form: it needs three dimensions alike."""
    _, struts, cables = icosahedron()
    with pytest.raises(InputError, match=r"no super-stable form from 1 starts: 1 reached no stress matrix of rank"):
        form_of_topology(struts, cables, dimensions=2, starts=1)
    found = [form_of_topology(struts, cables, dimensions=2, seed=seed) for seed in (0, 0, 1)]
    for nodes, q in found:
        assert_stands(nodes, struts + cables, q, 6, dimensions=2)
    np.testing.assert_array_equal(found[0][1], found[1][1])
    assert np.abs(found[0][1] - found[2][1]).max() > 0.01


@pytest.mark.parametrize("seed", range(3))
def test_forms_of_random_topologies(seed):
    """Those of structures that stand elsewhere; nothing of their coordinates is known here."""
    _, struts, cables = random_tensegrity(5, seed)
    nodes, q = form_of_topology(struts, cables)
    assert_stands(nodes, struts + cables, q, 5)


def test_groups_share_their_force_densities():
    """A tower of three stages: members of a group are alike in length, too, as the shape has the same symmetries."""
    _, struts, cables = tower(3, 3)
    edges, groups = struts + cables, alike_members(struts, cables)
    nodes, q = form_of_topology(struts, cables, groups=groups)
    assert_stands(nodes, edges, q, len(struts))
    length = edge_lengths(nodes, edges)
    for group in map(list, groups):
        np.testing.assert_allclose(q[group], q[group[0]], rtol=1e-15)
        np.testing.assert_allclose(length[group], length[group[0]], rtol=1e-12)


@pytest.mark.parametrize("geometry", [prism(5), icosahedron(), ball(12)], ids=["prism", "icosahedron", "ball"])
def test_topologies_have_the_symmetries_of_their_most_regular_shape(geometry):
    """Groups of members by the topology alone, beside those by rotations and mirrorings of the shape."""
    nodes, struts, cables = Geometry(*geometry)
    strong, weak = (Members(edges, np.ones(len(edges)), np.ones(len(edges))) for edges in (struts, cables))
    moves = symmetries(Structure(nodes, np.ones(len(nodes)), strong, weak))
    by_shape = {tuple(sorted({move.members[k] for move in moves})) for k in range(len(struts + cables))}
    assert set(alike_members(struts, cables)) == by_shape


def test_a_strut_more_breaks_the_symmetry():
    """A chain whose ends differ has no two members alike."""
    assert alike_members(((0, 3),), ((0, 1), (1, 2), (2, 3), (1, 3))) == ((0,), (1,), (2,), (3,), (4,))
    assert alike_members(DIAGONALS, SIDES) == ((0, 1), (2, 3, 4, 5))


SPINE = planar_spine(2)


@pytest.mark.parametrize(
    ("struts", "cables", "options", "reason"),
    [
        # a hexagon of cables cannot hold three struts in space
        (
            ((0, 1), (2, 3), (4, 5)),
            ((0, 2), (2, 4), (4, 1), (1, 3), (3, 5), (5, 0)),
            {"starts": 3},
            r"no super-stable form from 3 starts: .*\. An eigenvalue that must be 0 came down to \de-\d+",
        ),
        (DIAGONALS, SIDES, {}, "4 nodes: expected at least 5, as the stress matrix of fewer is 0"),
        (SPINE.struts, SPINE.cables, {"dimensions": 2}, r"cables do not lead from node 0 to node \d: expected one net"),
        ((), SIDES, {}, r"struts = \(\): expected at least one"),
        (((0, 1.5),), SIDES, {}, "expected two nodes, as whole numbers"),
        (((0, 1),), SIDES, {}, r"topology.cables\[0\] = \[0, 1\]: struts\[0\] joins these nodes already"),
        (DIAGONALS, SIDES, {"dimensions": 4}, r"dimensions = 4: expected 3 \(space\) or 2 \(plane\)"),
        (DIAGONALS, SIDES, {"dimensions": 2, "groups": [[1, 2]]}, r"groups\[0\] = \[1, 2\]: expected struts alone"),
        (DIAGONALS, SIDES, {"dimensions": 2, "groups": [[6]]}, r"groups\[0\]\[0\] = 6: expected a whole number"),
        (DIAGONALS, SIDES, {"dimensions": 2, "groups": [[0], [0]]}, "expected each number once"),
        (DIAGONALS, SIDES, {"dimensions": 2, "starts": 0}, "starts = 0: expected a whole number, at least 1"),
    ],
)
def test_topologies_that_cannot_stand(struts, cables, options, reason):
    """Refused in one line, which says why or how near the starts came; users have no checks of annotations."""
    jaxtyping.config.update("jaxtyping_disable", True)  # of this test alone: conftest.py sets it anew for each
    with pytest.raises(InputError, match=reason) as caught:
        form_of_topology(struts, cables, **options)
    assert "\n" not in str(caught.value)

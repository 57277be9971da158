"""The catalogue: what each structure is made of, that it carries a stress, and that its struts do not touch."""

import itertools

import jaxtyping
import numpy as np
import pytest

from jaxgrity import InputError, Members, Structure, edge_lengths
from jaxgrity.model import symmetries
from jaxgrity.model.structure import check_edges
from jaxgrity.statics import prestress, statics_of, super_stable
from jaxgrity.structures import (
    ball,
    d_bar,
    grid,
    icosahedron,
    planar_spine,
    prism,
    random_tensegrity,
    t_bar,
    tetrahedral_spine,
    three_strut_robot,
    tower,
)

STRUCTURES = {
    "prism": (prism(7, 0.3, 0.5, 0.2), 14, 7, 21),
    "three_strut_robot": (three_strut_robot(1.5), 6, 3, 9),
    "tower": (tower(4, 3, 0.4), 24, 12, 52),
    "stacked prisms": (tower(3, 4, 0.0), 15, 12, 27),
    "ball of 6": (ball(6), 12, 6, 18),
    "ball of 12": (ball(12), 24, 12, 36),
    "ball of 30": (ball(30), 60, 30, 90),
    "tetrahedral_spine": (tetrahedral_spine(4), 16, 24, 24),
    "planar_spine": (planar_spine(4), 12, 12, 12),
    "d_bar": (d_bar(4), 6, 8, 5),
    "plane d_bar": (d_bar(2), 4, 4, 2),
    "t_bar": (t_bar(3), 6, 5, 6),
    "grid": (grid(2, 3), 29, 24, 65),
}
SUPER_STABLE = ("prism", "three_strut_robot", "tower", "ball of 6", "ball of 12", "ball of 30", "tetrahedral_spine")


@pytest.mark.parametrize("name", STRUCTURES)
def test_structure_is_made_of_so_many_parts_and_carries_a_stress(name):
    """Each cable in tension, and a robot's struts in compression; no member twice, none without length."""
    (nodes, struts, cables), *counts = STRUCTURES[name]
    assert [len(nodes), len(struts), len(cables)] == counts
    check_edges(nodes, struts, cables)
    forces = prestress(nodes, struts, cables, 1.0) * edge_lengths(nodes, struts + cables)
    assert forces[len(struts) :].min() > 0.01
    if "spine" not in name:
        assert forces[: len(struts)].max() < -0.01
    assert super_stable(nodes, struts + cables, forces / edge_lengths(nodes, struts + cables)) == (name in SUPER_STABLE)


@pytest.mark.parametrize("name", [name for name in STRUCTURES if name != "planar_spine"])
def test_struts_do_not_pass_through_each_other(name):
    """Those that share no node stay apart, as the closest points of their lines say; in a plane, vertebrae have to."""
    nodes, struts, _ = STRUCTURES[name][0]
    for (a, b), (c, d) in itertools.combinations(struts, 2):
        if not {a, b} & {c, d}:
            assert distance(nodes[a], nodes[b], nodes[c], nodes[d]) > 0.02, (a, b, c, d)


def distance(a, b, c, d) -> float:
    """Between two segments: where both parameters, clipped in turn, come to rest."""
    u, v, s = b - a, d - c, 0.5
    for _ in range(50):
        t = np.clip((a + s * u - c) @ v / (v @ v), 0, 1)
        s = np.clip((c + t * v - a) @ u / (u @ u), 0, 1)
    return float(np.linalg.norm(a + s * u - c - t * v))


@pytest.mark.parametrize("struts", [6, 12, 30])
def test_balls_have_all_their_symmetries(struts):
    """As many rotations as nodes, which lie on a sphere; struts have the length that is asked for."""
    nodes, rods, cables = ball(struts, strut_length=2.5)
    np.testing.assert_allclose(edge_lengths(nodes, rods), 2.5, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(nodes, axis=1), np.linalg.norm(nodes[0]), rtol=1e-12)
    parts = [Members(edges, np.ones(len(edges)), np.ones(len(edges))) for edges in (rods, cables)]
    assert len(symmetries(Structure(nodes, np.ones(len(nodes)), *parts), mirrors=False)) == 2 * struts
    found = statics_of(nodes, rods + cables)
    assert found.self_stress.shape[1] == 1


def test_three_strut_robot_has_cables_of_one_length():
    """And struts of the length asked for."""
    nodes, struts, cables = three_strut_robot(0.8)
    np.testing.assert_allclose(edge_lengths(nodes, struts), 0.8, rtol=1e-12)
    np.testing.assert_allclose(np.ptp(edge_lengths(nodes, cables)), 0, atol=1e-12)


def test_tower_reaches_into_itself_as_far_as_asked():
    """Stages overlap by the share of their height that is given; none where prisms share their rings."""
    nodes = tower(3, 3, 0.25, stage_height=0.8).nodes
    heights = nodes[:, 2].reshape(3, 2, 3)
    np.testing.assert_allclose(np.ptp(heights, axis=2), 0, atol=1e-12)
    np.testing.assert_allclose(heights[:-1, 1, 0] - heights[1:, 0, 0], 0.25 * 0.8, rtol=1e-12)
    assert np.ptp(tower(3, 3, 0.0, stage_height=0.8).nodes[:, 2]) == pytest.approx(2.4)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: prism(2), "struts = 2: expected a whole number, at least 3"),
        (lambda: prism(3.5), "struts = 3.5: expected a whole number, at least 3"),
        (lambda: prism("3"), "struts = '3': expected a whole number, at least 3"),
        (lambda: prism(height=-0.6), "height = -0.6 m: expected a positive number"),
        (lambda: tower(3, 2, radius=0.0), "radius = 0 m: expected a positive number"),
        (lambda: icosahedron(-1.0), "strut_length = -1 m: expected a positive number"),
        (lambda: ball(30, "1"), "strut_length = '1' m: expected a positive number"),
        (lambda: random_tensegrity(6, seed="one"), "seed = 'one': expected a whole number, at least 0"),
        (lambda: random_tensegrity(6, strut_length=-1.0), "strut_length = -1 m: expected a positive number"),
        (lambda: grid(2, 2, side=-1.0), "side = -1 m: expected a positive number"),
        (lambda: t_bar(3, -1.0), "length = -1 m: expected a positive number"),
        (lambda: tetrahedral_spine(3, spacing=0.0), "spacing = 0 m: expected a positive number"),
        (lambda: tower(3, 0), "stages = 0: expected a whole number, at least 1"),
        (lambda: tower(3, 2, 1.0), "overlap = 1.0: expected a share"),
        (lambda: tower(3, 20, 0.3), "overlap = 0.3: no twist of the stages carries a stress"),
        (lambda: tower(3, 101, 0.3), "stages = 101: expected at most 100"),
        (lambda: tower(10_000, 10_000, 0.0), "stages = 10000: expected at most 5"),
        (lambda: grid(10_000, 10_000), "columns = 10000: expected at most 1"),
        (lambda: ball(13), "struts = 13: expected 6, 12 or 30"),
        (lambda: tetrahedral_spine(1), "vertebrae = 1: expected a whole number, at least 2"),
        (lambda: planar_spine(1), "vertebrae = 1: expected a whole number, at least 2"),
        (lambda: d_bar(1), "sides = 1: expected a whole number, at least 2"),
        (lambda: t_bar(1), "sides = 1: expected a whole number, at least 2"),
        (lambda: grid(0, 2), "rows = 0: expected a whole number, at least 1"),
    ],
)
def test_numbers_that_make_no_structure_are_refused(make, message):
    """In one line, with the value received."""
    jaxtyping.config.update("jaxtyping_disable", True)  # which users do not have; of this test alone
    with pytest.raises(InputError, match=message):
        make()

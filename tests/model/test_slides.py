"""Sliding nodes as a part of a scene: refusals, scene files, symmetries, and who does not know them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import InputError, Members, Scene, SolverOptions, Structure, describe, parse_scene, simulate, with_terms
from jaxgrity.formats import save_mjcf, save_urdf
from jaxgrity.io.scene_writing import scene_toml
from jaxgrity.model import Slides, rigid_body
from jaxgrity.model.laws import Symmetry
from jaxgrity.model.slides import known_lines
from jaxgrity.statics import inspect_structure, least_mass
from jaxgrity.stepping import resolve

NODES = np.array([[0, 0, 0], [0.8, 0, 0.6], [0.4, 0, 0.3], [0, 0.5, 0.2], [0.3, 0.5, 0.9], [0.6, 1, 0.1]])
TEXT = """
[structure]
kind = "custom"
nodes = [[0, 0, 0], [0.8, 0, 0.6], [0.4, 0, 0.3], [0, 0.5, 0.2], [0.3, 0.5, 0.9], [0.6, 1, 0.1]]
node_mass = [1, 1, 1, 1, 1, 1]
struts = [[0, 1], [3, 4]]
pose = "face"
height = 0.2
[struts]
stiffness = 100.0
[[slides]]
node = 2
along = [0, 1]
[wind]
velocity = [1.0, 0, 0]
drag = 0.1
"""


def scene_of(slides: Slides, nodes: np.ndarray = NODES, **other) -> Scene:
    struts = Members(((0, 1), (3, 4)), [100.0] * 2, [1.0, np.linalg.norm(NODES[3] - NODES[4])])
    return Scene(Structure(nodes, np.ones(len(nodes)), struts, **other), terms=(slides,))


@pytest.mark.parametrize(
    ("nodes", "along", "words"),
    [
        ((), (), "slides: nodes = \\(\\), along = \\(\\): expected two nodes for each node"),
        ((2, 3), ((0, 1),), "expected two nodes for each node"),
        ((2,), ((0, 1, 3),), "expected two nodes for each node"),
        ((2,), ((0, 2),), "node 2 along \\[0, 2\\]: expected three different nodes, from 0 on"),
        ((-1,), ((0, 1),), "node -1 along \\[0, 1\\]: expected three different nodes, from 0 on"),
        ((2, 2), ((0, 1), (1, 0)), "expected each slide once"),
        ((2,), ((0, 9),), "slides name node 9; expected 0 to 5"),
        ((2,), ((0, 3),), "node 2 along \\[0, 3\\]: no strut or rigid body joins nodes \\[0, 3\\]; expected both ends"),
    ],
)
def test_what_is_no_slide_is_refused(nodes, along, words):
    with pytest.raises(InputError, match=words):
        scene_of(Slides(nodes, along))


def test_a_body_does_not_slide_along_itself_and_one_law_has_all_slides():
    body = rigid_body(NODES, (0, 1, 2), 1.0, rod_inertia(NODES[1]))
    with pytest.raises(InputError, match="all three are points of one rigid body"):
        scene_of(Slides((2,), ((0, 1),)), bodies=(body,))
    with pytest.raises(InputError, match="terms have 2 laws of sliding nodes; expected one"):
        with_terms(scene_of(Slides((2,), ((0, 1),))), Slides((5,), ((3, 4),)))


def rod_inertia(end: np.ndarray) -> np.ndarray:
    return (end @ end * np.eye(3) - np.outer(end, end)) / 12


def test_a_start_beside_the_line_is_refused():
    """Also beyond its ends, where the line goes on."""
    off, beyond = NODES.copy(), NODES.copy()
    off[2] += [-0.006, 0, 0.008]
    beyond[2] = -2 * NODES[1]
    with pytest.raises(InputError, match=r"node 2 starts 0\.01 m beside the line through nodes \[0, 1\]; expected on"):
        resolve(scene_of(Slides((2,), ((0, 1),)), off), options=SolverOptions(dt=1e-3))
    np.testing.assert_allclose(Slides((2,), ((0, 1),)).gaps(beyond, 0.0), 0, atol=1e-15)
    np.testing.assert_allclose(Slides((2,), ((0, 1),)).gaps(jnp.asarray(off), 0.0), 0.01, atol=1e-7)


@pytest.mark.parametrize("node", [2, 5])
def test_lines_have_the_derivatives_of_the_constraint(node):
    """n·e = 0 with s of the place itself: its derivative has the fixed weights of e, wherever the node is."""
    slides, q = Slides((node,), ((0, 1),)), NODES.copy()
    q[node] = 0.3 * q[1]
    lines, rng = known_lines(slides, q), np.random.default_rng(0)

    def beside(q):
        """Along both n, of the place at this q, with s of this q."""
        line, to = q[1] - q[0], q[node] - q[0]
        u = lines.along[0]
        return lines.across @ (to - (to @ u) / (line @ u) * line)

    slope = jax.jacfwd(beside)(jnp.asarray(q))
    np.testing.assert_allclose(slope, lines.weights[:, :, None] * lines.across[:, None], atol=1e-14)
    np.testing.assert_allclose(lines.weights @ q, 0, atol=1e-15)
    np.testing.assert_allclose(lines.weights.sum(1), 0, atol=1e-15)
    moved = rng.normal(size=q.shape)
    found = slides.directions(q, 1.0) @ moved.ravel()
    np.testing.assert_allclose(found, np.einsum("rn,rk,nk->r", lines.weights, lines.across, moved), atol=1e-12)


def test_a_symmetry_has_to_map_slides_on_slides():
    both, turned = Slides((2, 5), ((0, 1), (4, 3))), Symmetry((3, 4, 5, 0, 1, 2), np.eye(3), ())
    assert both.keeps(turned)
    assert not Slides((2,), ((0, 1),)).keeps(turned)
    assert not Slides((2, 5), ((0, 1), (0, 1))).keeps(turned)


def test_files_have_slides():
    """Written as they are read, with the node on its line in any pose."""
    scene = parse_scene(TEXT)
    assert scene.terms[0] == Slides((2,), ((0, 1),))
    assert scene.terms[0].gaps(np.asarray(scene.structure.nodes), 0.0) < 1e-15
    assert scene_toml(parse_scene(scene_toml(scene))) == scene_toml(scene)
    assert parse_scene(scene_toml(scene)).terms[0] == scene.terms[0]
    assert "sliding nodes        1: node 2 along [0, 1]" in describe(scene)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("along = [0, 1]", "along = [0, 3]", r"scene: slides: node 2 along \[0, 3\]: no strut or rigid body joins"),
        ("along = [0, 1]", "along = [0]", r"slides\[0\].along"),
        ("node = 2\nalong", "node = 2.5\nalong", r"slides\[0\].node = 2.5: expected"),
        ("node = 2\nalong", "nodes = 2\nalong", r"slides\[0\]"),
    ],
)
def test_bad_tables_are_refused(old, new, words):
    assert old in TEXT
    with pytest.raises(InputError, match=words):
        parse_scene(TEXT.replace(old, new))


@pytest.mark.parametrize(
    ("does", "words"),
    [
        (inspect_structure, "inspect_structure: knows no sliding nodes yet, here \\[2\\]; expected a scene without"),
        (lambda scene: least_mass(scene, "steel", "steel"), r"least_mass: .* let their cables end at nodes"),
        (lambda scene: save_mjcf(scene, "never.xml"), "knows no sliding nodes yet.*let their cables end"),
        (lambda scene: save_urdf(scene, "never.urdf"), "knows no sliding nodes yet.*let their cables end"),
        (
            lambda scene: simulate(scene, 0.1, options=SolverOptions(method="complementarity", coupled=False)),
            "sweeps handle no .*slides",
        ),
        (
            lambda scene: simulate(scene, 0.1, options=SolverOptions(method="verlet")),
            "method = 'verlet': this scene has sliding nodes; expected 'complementarity'",
        ),
    ],
)
def test_what_knows_no_slides_refuses_them(does, words):
    """In one line, before anything compiles."""
    with pytest.raises(InputError, match=words):
        does(dataclasses.replace(parse_scene(TEXT), terms=(Slides((2,), ((0, 1),)),)))

"""Scenes written as scene files are read as the same scenes, to the last bit."""

import dataclasses
from pathlib import Path
from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    ExactGround,
    ForceTable,
    HeightFunction,
    InputError,
    Overtone,
    PenaltyGround,
    Push,
    Scene,
    Slope,
    Stairs,
    Structure,
    as_dtype,
    force_limit,
    load_scene,
    parse_scene,
    save_scene,
    scene_names,
    wind,
    with_gait,
    with_terms,
)
from jaxgrity.io.scene_writing import scene_toml
from jaxgrity.io.structure_tables import CatalogueTable

BODY = """
[structure]
kind = "{kind}"
mass = 2.0
prestress = 50.0
pose = "face"
height = 0.1
[struts]
stiffness = 2e4
mass = 0.3
[cables]
stiffness = 2e3
damping = 1.0
"""
PARTS = {
    "spring struts, supports, damage": """
[structure]
kind = "custom"
nodes = [[0, 0, 0.1], [1e-7, 1, 0], [0.1, 0.2, 1e22], [-0.0, 3, 3]]
struts = [[0, 1]]
cables = [[1, 2], [2, 3], [3, 0]]
node_mass = [0.1, 0.2, 0.30000000000000004, 1]
fixed = [1, { node = 2, axes = "zx" }]
[struts]
stiffness = 7
stuck = [0]
mass = 0.1
[cables]
stiffness = [1, 2, 3]
damping = [0, 0.1, 0]
rest_length = [0.3, 0.1, 0.2]
broken = [1]
stuck = [2]
[damping]
node = [0.1, 0.2, 0.3, 0]
""",
    "switch, wind and pushes on stairs": """
[structure]
kind = "icosahedron"
mass = 6
[struts]
stiffness = 2e4
[cables]
stiffness = 600
prestrain = [{prestrain}]
[gravity]
[ground]
stiffness = 1e4
surface = { kind = "stairs", rise = 0.1, run = 0.4, steps = 3, turn = 0.3, rounding = 0.01 }
[friction]
kind = "switch"
mu_static = [{mu}]
mu_kinetic = 0.5
slip_speed = 0.01
[wind]
velocity = [1, 2, 0]
drag = 0.1
[[pushes]]
nodes = [3, 1]
force = [1, 0, 0]
start = 1
duration = 0.5
[[pushes]]
nodes = [0]
force = [0, 0, 1]
start = 2
duration = 0.5
ramp = 0.02
[gait]
members = { random = 0.3, seed = 1 }
phase = { seed = 2 }
frequency = 0.7
""".replace("{prestrain}", ", ".join(str(0.01 * k) for k in range(24))).replace(
        "{mu}", ", ".join(str(0.6 + 0.01 * k) for k in range(12))
    ),
    "obstacles on a slope": """
[structure]
kind = "prism"
mass = 1
[struts]
rigid = true
[ground]
contact = "complementarity"
incline = 0.1
restitution = 0.3
obstacles = [
    { kind = "box", centre = [1, 0, 0], size = [1, 1, 1], turn = 0.1, rounding = 0.05 },
    { kind = "box", centre = [5, 0, 0], size = [1, 2, 1], turn = [0.1, 0.7, -0.3] },
    { kind = "sphere", centre = [0, 1, 0], radius = 0.2 },
    { kind = "cylinder", start = [0, 0, 0], end = [0, 1, 0], radius = 0.2 },
]
[friction]
kind = "cone"
mu = 0.5
""",
    "bumps with an obstacle": """
[structure]
kind = "prism"
mass = 1
[ground]
stiffness = 100
surface = { kind = "bumps", deviation = 0.03, length = 0.8, seed = 4 }
obstacles = [{ kind = "sphere", centre = [0, 1, 0], radius = 0.2 }]
""",
    "bowl": """
[structure]
kind = "prism"
mass = 1
[ground]
stiffness = 100
surface = { kind = "bowl", radius = 2.5 }
""",
    "measured heights": """
[structure]
kind = "prism"
mass = 1
[ground]
stiffness = 100
dissipation = 2
surface = { kind = "heights", size = [1, 2], values = [[0, 1, 2, 0], [3, 1, 2, 1], [0, 0.1, 0, 0], [0, 1, 0, 2]] }
""",
}


def same(first: Scene, second: Scene) -> bool:
    """Whether both have the same parts, and every number the same bits."""
    (left, tree), (right, other) = (jax.tree.flatten(scene) for scene in (first, second))
    return tree == other and all(np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in zip(left, right))


def written_again(scene: Scene) -> Scene:
    return parse_scene(scene_toml(scene))


@pytest.mark.parametrize("name", scene_names())
def test_scenes_of_the_library(name, tmp_path):
    """Each of them, by way of a file."""
    scene = load_scene(name)
    save_scene(scene, tmp_path / "scene.toml")
    assert same(load_scene(tmp_path / "scene.toml"), scene)


@pytest.mark.parametrize("table", get_args(CatalogueTable))
def test_every_kind_of_structure(table):
    """With supports, rods that have mass, and rest lengths that put it under stress."""
    scene = parse_scene(BODY.format(kind=table.__struct_config__.tag))
    again = written_again(scene)
    assert same(again, scene)
    assert len(again.structure.nodes) == len(scene.structure.nodes) > 3


@pytest.mark.parametrize("text", PARTS.values(), ids=PARTS)
def test_every_part(text):
    """And writing what was read gives the same text."""
    scene = parse_scene(text)
    assert same(written_again(scene), scene)
    assert scene_toml(written_again(scene)) == scene_toml(scene)


def test_a_difference_of_one_bit_is_seen(reference):
    """Else none of these tests could fail."""
    nodes = reference.structure.nodes.copy()
    nodes[3, 1] = np.nextafter(nodes[3, 1], 1)
    other = dataclasses.replace(reference, structure=dataclasses.replace(reference.structure, nodes=nodes))
    assert not same(other, reference)
    assert same(written_again(other), other)


def test_overtones(reference):
    """Gaits that are found by a search may have them."""
    overtones = (Overtone(np.full(6, 0.1), np.arange(6.0)), Overtone(np.zeros(6), np.ones(6)))
    scene = with_gait(reference, dataclasses.replace(reference.gait, overtones=overtones))
    assert same(written_again(scene), scene)


def test_the_file_is_short_and_plain(reference):
    """What is alike for all members is one number; rows of nodes are lines."""
    text = scene_toml(reference)
    assert "stiffness = 600.0\n" in text
    assert len(text.splitlines()) < 90
    assert max(map(len, text.splitlines())) < 250


REFUSED = {
    "a law of one's own": (
        lambda scene: with_terms(scene, Push((0, 1), np.eye(3)[:2], 1.0, 1.0)),
        "terms[0] is a Push; expected a part for which scene files have a key",
    ),
    "laws in another order": (
        lambda scene: with_terms(scene, force_limit(scene.structure.cables, 90.0), wind([1.0, 0, 0], 0.1, nodes=12)),
        "terms are largest force of cables, wind; expected in this order slides, a wind, pushes, a table or",
    ),
    "gravity that leans": (
        lambda scene: dataclasses.replace(scene, up=np.array([0.6, 0.0, 0.8])),
        "scene.up leans",
    ),
    "a function": (
        lambda scene: dataclasses.replace(scene, ground=PenaltyGround(1e4, surface=HeightFunction(np.sin))),
        "ground.surface is a HeightFunction; expected a part for which scene files have a key",
    ),
    "a slope that is a surface": (
        lambda scene: dataclasses.replace(scene, friction=None, ground=ExactGround(surface=Slope(0.1))),
        "ground.surface is a Slope",
    ),
    "not a number": (
        lambda scene: dataclasses.replace(scene, gravity=jnp.asarray(np.nan)),
        "gravity.g = nan: expected a finite number",
    ),
    "a stiffness of 0": (
        lambda scene: dataclasses.replace(
            scene,
            structure=dataclasses.replace(
                scene.structure, struts=dataclasses.replace(scene.structure.struts, stiffness=np.zeros(6))
            ),
        ),
        "struts: stiffness of [0, 1, 2, 3, 4, 5] is 0",
    ),
}


def _cables(scene, **numbers):
    cables = dataclasses.replace(scene.structure.cables, **numbers)
    return dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, cables=cables))


REFUSED |= {
    "dampers without springs": (
        lambda scene: _cables(scene, stiffness=np.zeros(24), damping=np.ones(24)),
        "cables: [0, 1, 2,",
    ),
    "a table of other cables": (
        lambda scene: with_terms(_cables(scene, stiffness=np.full(24, 500.0)), ForceTable([0, 0.1, 0.2], [0, 60, 90])),
        "cables: stiffness is not 600 N/m, the first slope of their table",
    ),
    "ground that differs": (
        lambda scene: dataclasses.replace(scene, ground=PenaltyGround(np.arange(1.0, 13.0))),
        "ground.stiffness has shape (12,); expected one number",
    ),
}


def test_numbers_of_jax_are_written_too(tmp_path):
    """Those of ground with a surface, as identification leaves them."""
    scene = as_dtype(
        Scene(Structure([[0.0, 0, 1.0]], [1.0]), ground=ExactGround(surface=Stairs(0.1, 0.3, 2))), "float64"
    )
    save_scene(scene, tmp_path / "scene.toml")
    assert float(load_scene(tmp_path / "scene.toml").ground.surface.rise) == pytest.approx(0.1)


@pytest.mark.parametrize(("change", "reason"), REFUSED.values(), ids=REFUSED)
def test_what_has_no_key_is_refused(change, reason, reference, tmp_path):
    """In one line, and no file is left."""
    with pytest.raises(InputError) as caught:
        save_scene(change(reference), tmp_path / "scene.toml")
    assert str(caught.value).startswith(reason)
    assert str(caught.value).isprintable()
    assert list(Path(tmp_path).iterdir()) == []

"""Sizes and load cases in a scene file."""

import dataclasses
import re

import jax
import numpy as np
import pytest

from jaxgrity import InputError, load_scene, parse_scene, save_scene, simulate
from jaxgrity.model import sized_members
from jaxgrity.statics import member_forces, resting_shape

PRISM = """
[structure]
kind = "prism"
prestress = 400.0
fixed = [0, 1, 2]
[struts]
material = "aluminium"
diameter = 0.02
wall = 0.001
[cables]
material = "uhmwpe"
area = 1e-6
yield_stress = 1e9
[[loads]]
name = "down"
nodes = [3, 4]
force = [0.0, 0.0, -50.0]
[[loads]]
name = "side"
nodes = [5]
force = [20.0, 0.0, 0.0]
[[loads]]
name = "down"
nodes = [5]
force = [0.0, 0.0, -60.0]
"""


def test_members_have_what_their_sizes_say():
    """At the rest lengths that the prestress needs: K = EA/L there, and the shape stays where it was."""
    structure = parse_scene(PRISM).structure
    for members, expected in (
        (
            structure.struts,
            sized_members(structure.struts.edges, structure.struts.rest_length, "aluminium", diameter=0.02, wall=0.001),
        ),
        (structure.cables, sized_members(structure.cables.edges, structure.cables.rest_length, "uhmwpe", area=1e-6)),
    ):
        for name in ("stiffness", "mass", "bending_stiffness"):
            np.testing.assert_allclose(getattr(members, name), getattr(expected, name), rtol=1e-12)
    np.testing.assert_allclose(structure.cables.yield_force, 1e9 * 1e-6, rtol=1e-12)
    np.testing.assert_allclose(member_forces(structure, structure.nodes)[3:].max(), 400.0, rtol=1e-9)
    scene = dataclasses.replace(parse_scene(PRISM), gravity=None)
    np.testing.assert_allclose(resting_shape(scene).q, structure.nodes, atol=1e-9)


def test_tables_of_one_name_are_one_load_case():
    down, side = parse_scene(PRISM).loads
    assert (down.name, down.nodes, side.name, side.nodes) == ("down", (3, 4, 5), "side", (5,))
    np.testing.assert_array_equal(down.on_nodes(6)[:, 2], [0, 0, 0, -50, -50, -60])


def test_saved_scenes_keep_strength_and_loads(tmp_path):
    """To the last bit, as stiffness, mass and strength."""
    scene = parse_scene(PRISM)
    save_scene(scene, tmp_path / "prism.toml")
    again = load_scene(tmp_path / "prism.toml")
    assert jax.tree.structure(again) == jax.tree.structure(scene)
    assert jax.tree.all(jax.tree.map(np.array_equal, scene, again))


@pytest.mark.campaign
def test_motions_ignore_loads_and_strength():
    """The same motion, bit for bit, with them and without."""
    scene = parse_scene(PRISM.replace("fixed = [0, 1, 2]", ""))
    struts, cables = (
        dataclasses.replace(members, yield_force=None, bending_stiffness=None)
        for members in (scene.structure.struts, scene.structure.cables)
    )
    bare = dataclasses.replace(
        scene, loads=(), structure=dataclasses.replace(scene.structure, struts=struts, cables=cables)
    )
    ends = [simulate(each, 0.001).positions for each in (scene, bare)]
    np.testing.assert_array_equal(*ends)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "diameter = 0.02",
            "diameter = 0.02\nstiffness = 1e5",
            "struts.stiffness = 100000.0: it follows from diameter",
        ),
        ("diameter = 0.02", "diameter = 0.02\nmass = 0.1", "struts.mass = 0.1: it follows from diameter"),
        ("area = 1e-6", "area = 1e-6\nyield_force = 9.0", "cables.yield_force = 9.0: it follows from area"),
        ("area = 1e-6", "area = 1e-6\nforce = { stretch = [0, 1], force = [0, 1] }", "cables.force: it follows from"),
        ("area = 1e-6", "", "cables.diameter: missing; expected"),
        ('material = "uhmwpe"', "", "cables.material: missing; expected a material, or youngs_modulus"),
        ('"uhmwpe"', '"nylon"', "cables.material = 'nylon': unknown; expected one of steel, aluminium"),
        ("wall = 0.001", "wall = 0.02", "struts.wall: 0.02 m at member 0; expected at most half"),
        ("nodes = [3, 4]", "nodes = [3, 9]", r"loads\[0\].nodes = \[3, 9\]: expected numbers from 0 to 5"),
        ('name = "side"', "", r"loads\[1\].name: missing; expected a string"),
        ('name = "side"', 'name = ""', "load_case.name = '': expected a name"),
        (
            "force = [20.0, 0.0, 0.0]",
            "force = [nan, 0.0, 0.0]",
            r"loads\[1\].force\[0\] = nan: expected a finite number",
        ),
    ],
)
def test_contradictions_are_refused(old, new, words):
    """In one line, with the key."""
    assert old in PRISM
    with pytest.raises(InputError, match=words) as refused:
        parse_scene(re.sub(re.escape(old), new, PRISM, count=1))
    assert "\n" not in str(refused.value)


def test_rigid_struts_have_sizes_too():
    """Their mass and strength, but no stiffness."""
    text = PRISM.replace("wall = 0.001", "wall = 0.001\nrigid = true")
    rigid, sprung = (parse_scene(each).structure.struts for each in (text, PRISM))
    assert rigid.stiffness is None
    np.testing.assert_allclose(rigid.mass, sprung.mass, rtol=1e-3)
    np.testing.assert_array_equal(rigid.yield_force, sprung.yield_force)

"""What NTRT's builder makes of rods, boxes, spheres and strings: masses, inertias, rest lengths, computed here anew."""

import math
from pathlib import Path

import numpy as np
import pytest

from jaxgrity import edge_lengths
from jaxgrity.formats import read_ntrt
from jaxgrity.model import body_moments

DATA = Path(__file__).parents[1] / "data" / "ntrt"
LINE = "{class: tgBasicActuatorInfo, parameters: {stiffness: 100, damping: 5, pretension: 20}}"


def scene_of(folder, text: str, unit: float = 1.0, **keywords):
    (folder / "robot.yaml").write_text(text)
    return read_ntrt(folder / "robot.yaml", unit, **keywords).scene


def box(sides: np.ndarray, mass: float) -> np.ndarray:
    """Principal moments of a solid box."""
    a, b, c = sides**2
    return mass / 12 * np.array([b + c, a + c, a + b])


def test_a_rod_is_a_cylinder_with_strings_on_its_side(tmp_path):
    """m = pi r^2 l, I = m (3 r^2 + l^2)/12 across and m r^2/2 along; strings end at the radius, facing each other."""
    scene = scene_of(
        tmp_path,
        "nodes: {a: [0, 0, 0], b: [0, 4, 0], c: [3, 0, 0], d: [3, 4, 0]}\n"
        "pair_groups: {bar: [[a, b], [c, d]], line: [[a, c], [d, b]]}\n"
        f"builders: {{bar: {{class: tgRodInfo, parameters: {{density: 2, radius: 0.5}}}}, line: {LINE}}}",
    )
    structure = scene.structure
    mass = 2 * math.pi * 0.25 * 4
    for body, x in zip(structure.bodies, (0, 3)):
        own, centre, inertia = body_moments(body, structure.nodes)
        assert float(own) == pytest.approx(mass)
        # the lowest ball, of radius 0.5, stands on the ground: the lower ends are 0.5 above it
        np.testing.assert_allclose(centre, [x, 0, 2.5], atol=1e-12)
        across = mass * (3 * 0.25 + 16) / 12
        np.testing.assert_allclose(inertia, np.diag([across, across, mass * 0.25 / 2]), atol=1e-9)
    ends = {tuple(structure.nodes[node].round(9).tolist()) for edge in structure.cables.edges for node in edge}
    assert ends == {(0.5, 0, 0.5), (2.5, 0, 0.5), (0.5, 0, 4.5), (2.5, 0, 4.5)}
    np.testing.assert_allclose(structure.cables.rest_length, 2 - 20 / 100)
    np.testing.assert_allclose(scene.ground.balls.radius, 0.5)
    assert len(scene.ground.balls.nodes) == 4


def test_where_a_string_is_fixed(tmp_path):
    """At the node where the file says so; turned about the axis by an angle; on a sphere, towards the other end."""
    scene = scene_of(
        tmp_path,
        "nodes: {a: [0, 0, 0], b: [0, 4, 0], ball: [3, 0, 0]}\n"
        "pair_groups: {bar: [[a, b]], left: [[a, ball]], right: [[a, ball]]}\n"
        "builders:\n"
        "  bar: {class: tgRodInfo, parameters: {radius: 0.5}}\n"
        "  ball: {class: tgSphereInfo, parameters: {radius: 0.25, density: 3}}\n"
        f"  left: {LINE.replace('pretension', f'rotation: {math.pi / 2}, pretension')}\n"
        f"  right: {LINE.replace('pretension', 'moveCablePointAToEdge: No, pretension')}\n",
    )
    structure = scene.structure
    # in NTRT the axis is y: a quarter turn about it takes x to -z, which is y here
    turned, straight = (structure.nodes[list(edge)] for edge in structure.cables.edges)
    low = 0.5
    assert {tuple(x) for x in turned.round(9).tolist()} == {(0, 0.5, low), (2.75, 0, low)}
    assert {tuple(x) for x in straight.round(9).tolist()} == {(0, 0, low), (2.75, 0, low)}
    np.testing.assert_allclose(
        structure.cables.rest_length, edge_lengths(structure.nodes, structure.cables.edges) - 0.2
    )
    mass, centre, inertia = body_moments(structure.bodies[0], structure.nodes)
    assert float(mass) == pytest.approx(3 * 4 / 3 * math.pi * 0.25**3)
    np.testing.assert_allclose(inertia, 0.4 * float(mass) * 0.25**2 * np.eye(3), atol=1e-12)
    np.testing.assert_allclose(centre, [3, 0, low], atol=1e-12)


def test_shapes_that_share_nodes_are_one_box_to_bullet(tmp_path):
    """Mass and centre are those of the parts with mass; the inertia is that of the box about all, those without too.

    The default builder of boxes makes the second part: 2 by 2 and as long as the nodes are apart, of density 1.
    """
    for order in ("[hub, high], [hub, far]", "[hub, far], [hub, high]"):
        scene = scene_of(
            tmp_path,
            "nodes: {hub: [0, 0, 0], far: [6, 0, 0], high: [0, 5, 0], off: [0, 0, -3], end: [0, 9, 9]}\n"
            f"pair_groups: {{light: [{order}], box: [[hub, off]]}}\n"
            "builders: {light: {class: tgRodInfo, parameters: {density: 0, radius: 0.5}}}",
        )
        (body,) = scene.structure.bodies
        mass, centre, inertia = body_moments(body, scene.structure.nodes)
        assert float(mass) == pytest.approx(2 * 2 * 3)
        # in NTRT's axes: the box reaches from (-1, -1, -3) to (1, 1, 0), the rods to x = 6 and y = 5, with radius 0.5
        sides = np.array([6 + 1, 3 + 0.5, 5 + 1])  # z of the file is -y here
        np.testing.assert_allclose(inertia, np.diag(box(sides, 12)), atol=1e-9)
        middle = np.mean(scene.structure.nodes[[0, 3]], axis=0)
        np.testing.assert_allclose(centre, middle, atol=1e-9)


def test_what_has_no_mass_does_not_move(tmp_path):
    """Alone it is a support, with the strings' ends on its surface."""
    structure = scene_of(
        tmp_path,
        "nodes: {low: [0, 0, 0], top: [0, 20, 0], one: [5, 12, 0], two: [5, 6, 1]}\n"
        "pair_groups: {post: [[low, top]], bar: [[one, two]], line: [[top, one], [low, two]]}\n"
        "builders:\n  post: {class: tgRodInfo, parameters: {density: 0, radius: 0.5}}\n"
        f"  bar: {{class: tgRodInfo, parameters: {{density: 0.5, radius: 0.2}}}}\n  line: {LINE}",
    ).structure
    held = np.array([node for node, axes in structure.fixed if axes == "xyz"])
    np.testing.assert_allclose(sorted(structure.nodes[held][:, 2]), [0, 0, 20, 20], atol=1e-12)
    assert len(structure.bodies) == 1
    assert float(structure.mass) == pytest.approx(0.5 * math.pi * 0.04 * math.sqrt(36 + 1))


def test_flat_and_straight_bodies_are_read(tmp_path):
    """Three rods in a plane, and two in a line: in Bullet both have a thickness."""
    structure = scene_of(
        tmp_path,
        "nodes: {hub: [0, 0, 0], a: [6, 0, 0], b: [-4, 4, 0], c: [-4, -4, 0],\n"
        "  d: [9, 9, 9], e: [9, 9, 12], f: [9, 9, 15]}\n"
        "pair_groups: {rod: [[hub, a], [hub, b], [hub, c], [d, e], [e, f]]}",
        drop=["radius"],
    ).structure
    flat, straight = structure.bodies
    mass, _, inertia = body_moments(flat, structure.nodes)
    thick = [6 + 4, 4 + 4, 1]  # and what a tilted rod of radius 0.5 reaches beyond its ends: 0.5 (|R_xx| + |R_xz|)
    assert float(mass) == pytest.approx(math.pi * 0.25 * (6 + 2 * math.sqrt(32)))
    assert inertia[2, 2] > inertia[0, 0] > 0.9 * float(mass) / 12 * (thick[1] ** 2 + thick[2] ** 2)
    mass, _, inertia = body_moments(straight, structure.nodes)
    np.testing.assert_allclose(inertia, np.diag(box(np.array([1, 6, 1]), float(mass))), atol=1e-9)


BUILDERS = {
    "the last one that matches": ("line: *b, left: *b, thin line: *a", "thin line", 2.0),
    "one for a part's name": ("left: *b, wide line: *a", "thin line", 3.0),
    "one for a tag": ("line: *a", "line", 2.0),
}


@pytest.mark.parametrize(("builders", "tags", "stiffness"), BUILDERS.values(), ids=BUILDERS)
def test_builders(builders, tags, stiffness, tmp_path):
    """Bonds have the names of both parts as tags; aliases are what they stand for; a tab is a space."""
    (tmp_path / "piece.yaml").write_text("nodes: {a: [0, 0, 0], b: [0, 10, 0]}\npair_groups: {rod: [[a, b]]}")
    scene = scene_of(
        tmp_path,
        "substructures:\n  left: {path: piece.yaml}\n  right: {path: piece.yaml,\ttranslation: [6, 0, 0]}\n"
        f"bond_groups:\n  {tags}:\n    left/right/node_node: [[a, a]]\n"
        "builders: {unused: &a {class: tgBasicActuatorInfo, parameters: {stiffness: 2}},\n"
        f"  other: &b {{class: tgBasicActuatorInfo, parameters: {{stiffness: 3}}}}, {builders}}}",
    )
    assert scene.structure.cables.stiffness.tolist() == [stiffness]


def test_friction_is_the_files_times_that_of_the_ground(tmp_path):
    """One coefficient where all have the same; else one for each node, or 0.5 everywhere where that is dropped."""
    text = (
        "nodes: {a: [0, 0, 0], b: [0, 4, 0], c: [3, 0, 0], d: [3, 4, 0]}\npair_groups: {bar: [[a, b]], rod: [[c, d]]}\n"
        "builders: {bar: {class: tgRodInfo, parameters: {friction: 0.2}}}"
    )
    np.testing.assert_allclose(scene_of(tmp_path, text, drop=["radius"]).friction.mu, [0.1, 0.1, 0.5, 0.5])
    assert scene_of(tmp_path, text, drop=["radius", "friction"]).friction.mu == 0.5

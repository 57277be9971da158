"""Structures written for NTRT: what is read again is what was written, and the rest is named or refused."""

import dataclasses

import numpy as np
import pytest

from jaxgrity import ConeFriction, ExactGround, InputError, Members, Scene, Structure
from jaxgrity.formats import read_ntrt, save_ntrt
from jaxgrity.model import Balls, rigid_body
from jaxgrity.structures import random_tensegrity


def robot(seed: int) -> Scene:
    """A random structure of rods with mass on the ground; a third of its cables are slack."""
    shape, random = random_tensegrity(4, seed), np.random.default_rng(seed)
    length = {
        kind: np.linalg.norm(np.diff(shape.nodes[np.array(edges)], axis=1)[:, 0], axis=1)
        for kind, edges in (("rods", shape.struts), ("cables", shape.cables))
    }
    count = len(shape.cables)
    rods = Members(shape.struts, None, length["rods"], mass=random.uniform(0.1, 1, 4))
    rest = length["cables"] * random.choice([0.8, 0.95, 1.1], count)
    cables = Members(shape.cables, random.uniform(100, 900, count), rest, damping=random.uniform(1, 9, count))
    structure = Structure(shape.nodes - [0, 0, shape.nodes[:, 2].min()], np.zeros(8), rods, cables)
    return Scene(structure, 9.81, ground=ExactGround(), friction=ConeFriction(0.7))


@pytest.mark.parametrize(("seed", "unit"), [(0, 0.1), (1, 1.0)])
def test_what_is_written_is_read(seed, unit, tmp_path):
    """Rods and cables to rounding, in any unit; friction, too."""
    scene = robot(seed)
    notes = save_ntrt(scene, tmp_path / "robot.yaml", unit)
    assert notes == ("not written, since such a file holds the structure alone: gravity, ground",)
    found = read_ntrt(tmp_path / "robot.yaml", unit, drop=["radius"]).scene
    np.testing.assert_allclose(found.structure.nodes, scene.structure.nodes, atol=1e-12)
    assert not np.any(found.structure.node_mass)
    for kind in ("struts", "cables"):
        given, read = getattr(scene.structure, kind), getattr(found.structure, kind)
        order = [[set(edge) for edge in read.edges].index(set(edge)) for edge in given.edges]
        for name in ("rest_length", "stiffness", "damping", "mass"):
            if getattr(given, name) is not None:
                np.testing.assert_allclose(getattr(read, name)[order], getattr(given, name), rtol=1e-11)
    np.testing.assert_allclose(found.friction.mu, 0.7, rtol=1e-12)


def test_rods_are_as_thick_as_the_balls_at_their_ends(tmp_path):
    """So they touch the ground as here; point masses are spread along them, and a note says so."""
    scene = robot(2)
    structure = dataclasses.replace(scene.structure, node_mass=np.full(8, 0.2))
    ground = ExactGround(balls=Balls(tuple(range(8)), np.repeat([0.01, 0.03], 4)))
    notes = save_ntrt(dataclasses.replace(scene, structure=structure, ground=ground), tmp_path / "robot.yaml")
    assert notes[0] == "masses of nodes and cables are spread along the rods there, which turn more easily"
    found = read_ntrt(tmp_path / "robot.yaml").scene
    np.testing.assert_allclose(sorted(found.ground.balls.radius), np.repeat([0.01, 0.03], 4), rtol=1e-12)
    masses = [float(np.sum(body.matrix)) for body in found.structure.bodies]
    np.testing.assert_allclose(masses, np.asarray(structure.struts.mass) + 0.4, rtol=1e-9)


def test_single_nodes_are_spheres(tmp_path):
    """One of density 0 where a support holds it: a mass that hangs on a cable."""
    cable = Members(((0, 1),), [50.0], [0.4])
    hung = Structure([[0.1, 0.2, 1], [0.1, 0.2, 0.5]], [0.0, 3.0], cables=cable, fixed=((0, "xyz"),))
    save_ntrt(Scene(hung), tmp_path / "hung.yaml")
    found = read_ntrt(tmp_path / "hung.yaml").scene.structure
    assert found.fixed == hung.fixed
    np.testing.assert_allclose(found.node_mass, [0, 3], rtol=1e-12)
    np.testing.assert_allclose(found.cables.rest_length, [0.4], rtol=1e-12)
    np.testing.assert_allclose(np.diff(found.nodes, axis=0), [[0, 0, -0.5]], atol=1e-12)


X = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
ROD, TWO = Members(((0, 1),), None, [1.0], mass=[1.0]), Members(((0, 1), (0, 2)), None, [1.0, 1.0], mass=[1.0, 1.0])
ROPE = Members(((0, 1), (1, 2)), [1.0, 1.0], [0.5, 0.5], clusters=((0, 1),))


@pytest.mark.parametrize(
    ("structure", "reason"),
    [
        (Structure(X, np.ones(4), TWO), "node 0: 2 struts end there"),
        (Structure(X, np.ones(4), ROD, fixed=((0, "xyz"),)), "node 0: NTRT supports no rod at its end"),
        (
            Structure(X, np.ones(4), ROD, fixed=((3, "xy"),)),
            "node 3: NTRT supports no node along single",
        ),
        (Structure(X, np.ones(4), cables=ROPE), "NTRT has no cables through several nodes"),
        (Structure(X, np.ones(4), bodies=(rigid_body(X, (0, 1, 2, 3), 1.0, [1, 1, 1.0]),)), "rigid bodies are not"),
    ],
)
def test_what_ntrt_cannot_hold_is_refused(structure, reason, tmp_path):
    with pytest.raises(InputError, match=f"robot.yaml: {reason}"):
        save_ntrt(Scene(structure), tmp_path / "robot.yaml")


def test_a_rod_has_the_mean_friction_of_its_ends(tmp_path):
    """And a note says so where the two differ."""
    scene = robot(3)
    mu = np.linspace(0.1, 0.8, 8)
    notes = save_ntrt(dataclasses.replace(scene, friction=ConeFriction(mu)), tmp_path / "robot.yaml")
    assert "rods have the mean friction coefficient of their two ends there" in notes
    found = read_ntrt(tmp_path / "robot.yaml", drop=["radius"]).scene
    order = {frozenset(edge): mu[[*edge]].mean() for edge in scene.structure.struts.edges}
    for edge in found.structure.struts.edges:
        np.testing.assert_allclose(found.friction.mu[[*edge]], order[frozenset(edge)], rtol=1e-12)

"""Shapes, stresses and vibrations that are known in closed form or from other programs."""

import json
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxgrity import Members, Scene, Structure, load_scene
from jaxgrity.formats import read_ntrt
from jaxgrity.statics import (
    form_of_topology,
    member_forces,
    prestressed,
    resting_shape,
    statics_of,
    vibration_modes,
)
from jaxgrity.structures import ball, icosahedron, prism

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"
RODS = json.loads((DATA / "rod_answers.json").read_text(encoding="utf-8"))
STATIC = json.loads((DATA / "static_answers.json").read_text(encoding="utf-8"))
TSGFEM, MOTES = "TsgFEM (MPL-2.0)", "MOTES (MPL-2.0)"
NTRT = "NTRT (Apache-2.0), by hand"
CLOSED = "closed form"


class Case(NamedTuple):
    """One number that is known from elsewhere."""

    case: str
    source: str
    theirs: float
    ours: float
    unit: str = ""


def statics_cases(quick: bool) -> Iterator[Case]:
    """All of them."""
    return chain(prisms(quick), icosahedra(), tower(), reference_scene(), ntrt())


def prisms(quick: bool) -> Iterator[Case]:
    """Twist from a disturbed start, force densities, ranks."""
    for n in (3, 4) if quick else range(3, 13):
        nodes, struts, cables = prism(n, 0.7, 1.1)
        spoilt = nodes + 0.01 * np.random.default_rng(3).normal(size=nodes.shape)
        found = np.asarray(resting_shape(Scene(sprung(nodes, struts, cables)), spoilt).q)
        yield Case(
            f"prism of {n}, twist found from a disturbed start", CLOSED, np.pi / 2 + np.pi / n, twist(found, n), "rad"
        )
        drawn = counterclockwise(form_of_topology(struts, cables)[0], n)
        yield Case(
            f"prism of {n}, twist found without coordinates", CLOSED, np.pi / 2 + np.pi / n, twist(drawn, n), "rad"
        )
        ratio = 2 * np.sin(np.pi / n)
        own = statics_of(nodes, (*struts, *cables))
        stress = own.self_stress[:, 0]
        yield Case(
            f"prism of {n}, ratio of force densities, sides to polygons",
            CLOSED,
            ratio,
            stress[3 * n] / stress[n],
        )
        yield Case(f"prism of {n}, rank of the equilibrium matrix", CLOSED, 4 * n - 1, own.rank)
        yield Case(f"prism of {n}, mechanisms", CLOSED, 2 * n - 5, len(own.mechanisms))


def sprung(nodes: np.ndarray, struts: tuple, cables: tuple) -> Structure:
    """Springs that are prestressed in this shape."""
    strong, weak = (
        Members(edges, np.full(len(edges), k), np.ones(len(edges))) for edges, k in ((struts, 2e4), (cables, 600.0))
    )
    return prestressed(Structure(nodes, np.full(len(nodes), 0.1), strong, weak), 50.0)


def counterclockwise(nodes: np.ndarray, n: int) -> np.ndarray:
    """The shape or its mirror image: that whose lower nodes run counterclockwise, seen from the upper ones."""
    return nodes * np.sign(np.linalg.det([nodes[0] - nodes[2], nodes[1] - nodes[2], nodes[n:].mean(0) - nodes[2]]))


def twist(nodes: np.ndarray, n: int) -> float:
    """rad, between the two polygons about the line of their centres, of that pair of nodes that is furthest off."""
    low, high = nodes[:n] - nodes[:n].mean(0), nodes[n:] - nodes[n:].mean(0)
    axis = nodes[n:].mean(0) - nodes[:n].mean(0)
    turns = np.arctan2(np.cross(low, high) @ axis / np.linalg.norm(axis), (low * high).sum(1)) % (2 * np.pi)
    return float(turns[np.abs(turns - np.pi / 2 - np.pi / n).argmax()])


def icosahedra() -> Iterator[Case]:
    nodes, struts, cables = icosahedron(1.0)
    found = statics_of(nodes, (*struts, *cables))
    q = found.self_stress[:, 0]
    yield Case("icosahedron, ratio of force densities, struts to cables", CLOSED, -1.5, q[0] / q[6])
    yield Case("icosahedron, rank of the equilibrium matrix", CLOSED, 29, found.rank)
    yield Case("icosahedron, states of self-stress", CLOSED, 1, found.self_stress.shape[1])
    yield Case("icosahedron, mechanisms", CLOSED, 1, len(found.mechanisms))
    q = form_of_topology(struts, cables)[1]
    yield Case("icosahedron without coordinates, ratio of force densities", CLOSED, -1.5, q[0] / q[6])
    _, struts, cables = ball(6)
    q = form_of_topology(struts, cables)[1]
    equal = (np.sqrt(41) - 11) / 8  # at a node of the truncated tetrahedron, with one force density in all cables
    yield Case("truncated tetrahedron without coordinates, ratio of force densities", CLOSED, equal, q[0] / q[6])


def published_tower() -> Structure:
    """A tower of two prisms on three supports, whose struts and cables have mass."""
    given = RODS["tower"]
    struts, cables = (tuple(map(tuple, given[kind])) for kind in ("struts", "cables"))
    rest, mass = np.array(given["rest_length_m"]), np.array(given["mass_kg"])
    stiffness, first = np.array(given["EA_N"]) / rest, len(struts)
    members = [
        Members(edges, stiffness[part], rest[part], mass=mass[part])
        for edges, part in ((struts, slice(first)), (cables, slice(first, None)))
    ]
    fixed = tuple((node, "xyz") for node in given["fixed_nodes"])
    return Structure(np.array(given["nodes_m"]), np.zeros(9), *members, fixed=fixed)


def tower() -> Iterator[Case]:
    """Its natural frequencies, as TsgFEM gives them."""
    structure, published = published_tower(), RODS["tower"]["natural_frequencies_Hz"]
    modes = vibration_modes(Scene(structure), structure.nodes, count=18)
    for k, (theirs, ours) in enumerate(zip(published, modes.frequency, strict=True), start=1):
        yield Case(f"tower of two prisms, natural frequency {k}", TSGFEM, theirs, float(ours), "Hz")


def reference_scene() -> Iterator[Case]:
    """The prestress of the reference robot as it is built."""
    structure = load_scene("reference").structure
    force = 600 * 0.3 * np.sqrt(6) / 4
    ours = float(member_forces(structure, structure.nodes)[6])
    yield Case("reference scene, tension of a cable as built", CLOSED, force, ours, "N")


def ntrt() -> Iterator[Case]:
    """Counts, masses and rest lengths of NASA's structure files, from what is written there."""
    section = np.pi * 0.31**2 * 0.688  # kg/dm
    super_ball = read_ntrt(DATA / "ntrt" / "nasa" / "SuperBall.yaml", drop=["radius"]).scene.structure
    yield Case("SuperBall.yaml, strings", NTRT, 24, len(super_ball.cables.edges))
    yield Case("SuperBall.yaml, mass", NTRT, 6 * 16.84 * section, float(super_ball.mass), "kg")
    length = np.sqrt(7.5**2 + 0.92**2 + 8.42**2)
    yield Case("SuperBall.yaml, rest length", NTRT, (length - 4) / 10, float(super_ball.cables.rest_length[0]), "m")
    spine = read_ntrt(DATA / "ntrt" / "nasa" / "TetrahedralSpine.yaml").scene.structure
    rods = 6 * 4 * np.pi * 0.5**2 * 0.014 * np.sqrt(300)
    yield Case("TetrahedralSpine.yaml, strings", NTRT, 5 * 8, len(spine.cables.edges))
    yield Case("TetrahedralSpine.yaml, mass", NTRT, rods, float(spine.mass), "kg")
    double = read_ntrt(DATA / "ntrt" / "nasa" / "Double3Prism.yaml").scene.structure
    long, short = np.sqrt(10**2 + 5**2), np.sqrt(5**2 + 8.66**2 + 5**2)
    yield Case("Double3Prism.yaml, strings", NTRT, 2 * (9 - 4) + 8, len(double.cables.edges))
    yield Case("Double3Prism.yaml, mass", NTRT, 2 * section * (long + 2 * short), float(double.mass), "kg")

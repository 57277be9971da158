"""Rods of a scene, along which bodies touch, as capsules of a MuJoCo model."""

from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from jaxgrity.formats.foreign import add_element
from jaxgrity.formats.links import Link
from jaxgrity.formats.mjcf_ground import parts_of_ground
from jaxgrity.formats.mjcf_plan import Plan, geom_friction
from jaxgrity.model.rod_contact import radii_along_struts
from jaxgrity.model.rods import rods_of
from jaxgrity.model.scene import Scene
from jaxgrity.model.strut_contact import strut_contact


class WrittenRod(NamedTuple):
    """A rod of a link."""

    name: str
    link: int
    ends: tuple[int, ...]
    """nodes"""
    radius: float
    """m"""
    grounded: bool
    """whether it touches the ground"""


class WrittenRods(NamedTuple):
    """All rods that touch something."""

    each: list[WrittenRod]
    pairs: list[tuple[str, str]]
    """names of those that touch each other"""
    instead: set[int]
    """nodes whose balls are ends of capsules"""
    left: int
    """number of rods that belong to no link, and are left out"""


def written_rods(scene: Scene, plan: Plan, links: list[Link]) -> WrittenRods:
    """The capsules along which the links of a scene touch the ground, and each other."""
    bodies = scene.structure.bodies
    owners = [None] * scene.structure.first_cable + [n for n, body in enumerate(bodies) for _ in body.rods]
    rods, found, left = rods_of(scene.structure), dict[tuple[int, bool], WrittenRod](), set[int]()
    ground = bool(parts_of_ground(scene))
    law = strut_contact(scene)
    wanted = {(k, True): radius + plan.larger for k, radius in radii_along_struts(scene).items() if ground}
    if law is not None:
        for pair, radii in zip(law.between.pairs, np.asarray(law.between.radius, float).tolist()):
            wanted |= {(k, False): radius for k, radius in zip(pair, radii)}
    for (k, grounded), radius in wanted.items():
        held_by = (n for n, link in enumerate(links) if {*rods[k]} <= {*link.nodes})
        link = next(held_by, None) if owners[k] is None else owners[k]  # links begin with the bodies
        if link is None:
            left.add(k)
        elif grounded and radius > 0:
            found[k, True] = WrittenRod(f"rod{k}", link, rods[k], radius, True)
        elif not grounded:
            same = found.get((k, True))
            alike = same is not None and same.radius == radius
            found[k, False] = same if same and alike else WrittenRod(f"inner{k}", link, rods[k], radius, False)
    pairs = [] if law is None else [tuple(found.get((k, False)) for k in pair) for pair in law.between.pairs]
    instead = {
        node
        for (_, grounded), each in found.items()
        for node in each.ends
        if grounded and plan.larger + plan.balls.get(node, 0.0) == each.radius
    }
    each = list({capsule.name: capsule for capsule in found.values()}.values())
    return WrittenRods(each, [(a.name, b.name) for a, b in pairs if a and b], instead, len(left))


def add_rod(body: ElementTree.Element, plan: Plan, capsule: WrittenRod, x: np.ndarray) -> None:
    """A rod between nodes at `x`, m, in the frame of its body."""
    ends = np.concatenate([x[node] for node in capsule.ends])
    touches = {"contype": int(capsule.grounded), "conaffinity": 0, **geom_friction(plan, list(capsule.ends))}
    add_element(body, "geom", name=capsule.name, type="capsule", fromto=ends, size=[capsule.radius], mass=0, **touches)


def add_pairs(root: ElementTree.Element, plan: Plan, rods: WrittenRods, friction: float, spring: Any) -> None:
    """Contact of rods with each other: with the mean coefficient of their ends, or else with the one of all nodes."""
    if not rods.pairs:
        return
    contact, ends = add_element(root, "contact"), {capsule.name: capsule.ends for capsule in rods.each}
    for one, other in rods.pairs:
        mu = float(np.mean([plan.friction.get(node, friction) for node in (*ends[one], *ends[other])]))
        law = {"condim": 3, "friction": [mu, mu, 0.0, 0.0, 0.0], "solref": spring}
        add_element(contact, "pair", geom1=one, geom2=other, **law)

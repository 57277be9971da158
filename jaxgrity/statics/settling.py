"""A robot in its resting shape, set down on its ground. Files of other programs rarely start there."""

import dataclasses
from typing import NamedTuple

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import Edges
from jaxgrity.model.laws import EnergyTerm
from jaxgrity.model.rod_contact import set_down
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import Slides
from jaxgrity.model.springs import as_springs
from jaxgrity.model.structure import Structure, edge_lengths
from jaxgrity.statics.equilibrium import resting_shape
from jaxgrity.statics.slide_springs import apart
from jaxgrity.statics.spring_struts import with_spring_struts

ROUNDS = 8
"""Number of rounds in which springs that replace rigid struts are lengthened by what they were compressed."""
STRUTS_WITHIN = 1e-10
"""Largest error of a rigid strut's length, as a share of its length; of a sliding node's place, of the robot's size."""


class Settled(NamedTuple):
    """The result of `settled`."""

    scene: Scene
    moved: float
    """m, the largest distance that a node moved with respect to the others' mean"""


@typed
def settled(scene: Scene) -> Settled:
    """The scene with its structure at rest without gravity, ground and gait, and set down on its ground.

    Rigid struts and bodies keep their shapes, and sliding nodes their lines; supports hold; measured forces of cables,
    limits and your own terms of U act. With supports, or without ground, nothing is set down.

    Args:
        scene: the scene to settle.

    Returns:
        The scene at rest, and how far the nodes moved.

    Raises:
        InputError: no resting shape is found, or rigid struts cannot keep their lengths there.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> f"{jaxgrity.statics.settled(scene).moved:.0e}"  # m, to rounding: it is at rest already
        '1e-16'
    """
    structure = scene.structure
    given = np.asarray(structure.nodes, float)
    terms = tuple(term for term in scene.terms if isinstance(term, (EnergyTerm, Slides)))
    nodes = _at_rest(Scene(structure, terms=terms))
    moved = nodes - given
    if not structure.fixed:
        moved = moved - moved.mean(0)
        nodes = given + moved
        if scene.ground is not None:
            weight = float(structure.mass) * float(scene.gravity or 0.0)
            size = float(length_scale(scene))
            nodes = set_down(scene, nodes, scene.ground.touching_depth(weight, 3, size))
    largest = float(np.linalg.norm(moved, axis=1).max())
    return Settled(dataclasses.replace(scene, structure=dataclasses.replace(structure, nodes=nodes)), largest)


def _at_rest(alone: Scene) -> np.ndarray:
    """Positions at rest, m: in each round springs in place of what is rigid are set against what they gave way."""
    structure, held = alone.structure, apart(with_spring_struts(alone))[1]
    springs, count = as_springs(structure)
    nodes = np.asarray(resting_shape(alone).q, float)
    edges: Edges = ()
    wanted = np.zeros(0)
    if count:
        assert springs.struts is not None, "as_springs made them"
        edges, wanted = springs.struts.edges[-count:], np.asarray(springs.struts.rest_length, float)[-count:]
    given = wanted
    for _ in range(ROUNDS):
        missing = wanted - edge_lengths(nodes, edges)
        beside = np.zeros((0, 3)) if held is None else held.slides.offsets(nodes)
        most = float(np.linalg.norm(np.ptp(nodes, axis=0)))
        if np.all(np.abs(missing) <= STRUTS_WITHIN * wanted) and np.all(np.abs(beside) <= STRUTS_WITHIN * most):
            return nodes
        given = given + missing
        again = dataclasses.replace(alone, structure=_with_lengths(structure, nodes, dict(zip(edges, given))))
        if held is not None:
            held = dataclasses.replace(held, offset=held.offset - beside)
            others = (term for term in alone.terms if not isinstance(term, Slides))
            again = dataclasses.replace(again, terms=(*others, held))
        nodes = np.asarray(resting_shape(again).q, float)
    off = np.concatenate([np.abs(missing), np.abs(beside).ravel()]).max()
    raise InputError(
        f"rigid struts or sliding nodes are off by {off:.3g} m at rest; expected lengths that fit together"
    )


def _with_lengths(structure: Structure, nodes: np.ndarray, given: dict[tuple[int, int], float]) -> Structure:
    """The structure at `nodes` whose rigid struts and bodies have these lengths, m."""
    struts = structure.struts
    if struts is not None and struts.rigid:
        struts = dataclasses.replace(struts, rest_length=np.array([given[edge] for edge in struts.edges]))
    by_ends = {frozenset(edge): length for edge, length in given.items()}
    bodies = tuple(
        dataclasses.replace(body, lengths=np.array([by_ends[frozenset(edge)] for edge in body.edges]))
        for body in structure.bodies
    )
    return dataclasses.replace(structure, nodes=nodes, struts=struts, bodies=bodies)

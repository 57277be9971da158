"""A robot in its resting shape, set down on its ground. Files of other programs rarely start there."""

import dataclasses
from typing import NamedTuple

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.model.laws import EnergyTerm
from jaxgrity.model.rod_contact import set_down
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import check_no_slides
from jaxgrity.model.springs import as_springs
from jaxgrity.model.structure import Structure, edge_lengths
from jaxgrity.statics.equilibrium import resting_shape

ROUNDS = 8
"""Number of rounds in which springs that replace rigid struts are lengthened by what they were compressed."""
STRUTS_WITHIN = 1e-10
"""Largest error of a rigid strut's length, as a share of its length."""


class Settled(NamedTuple):
    """The result of `settled`."""

    scene: Scene
    moved: float
    """m, the largest distance that a node moved with respect to the others' mean"""


@typed
def settled(scene: Scene) -> Settled:
    """The scene with its structure at rest without gravity, ground and gait, and set down on its ground.

    Rigid struts and bodies keep their shapes; supports hold; measured forces of cables, limits and your own terms of U
    act. With supports, or without ground, nothing is set down.

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
    check_no_slides(scene, "settled")
    structure = scene.structure
    given = np.asarray(structure.nodes, float)
    nodes = _at_rest(Scene(structure, terms=tuple(term for term in scene.terms if isinstance(term, EnergyTerm))))
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
    structure = alone.structure
    springs, count = as_springs(structure)
    nodes = np.asarray(resting_shape(alone).q, float)
    if not count:
        return nodes
    assert springs.struts is not None, "as_springs made them"
    edges, wanted = springs.struts.edges[-count:], np.asarray(springs.struts.rest_length, float)[-count:]
    given = wanted
    for _ in range(ROUNDS):
        missing = wanted - edge_lengths(nodes, edges)
        if np.all(np.abs(missing) <= STRUTS_WITHIN * wanted):
            return nodes
        given = given + missing
        longer = _with_lengths(structure, nodes, dict(zip(edges, given)))
        nodes = np.asarray(resting_shape(dataclasses.replace(alone, structure=longer)).q, float)
    raise InputError(
        f"rigid struts are off by {np.abs(missing).max():.3g} m at rest; expected lengths that fit together"
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

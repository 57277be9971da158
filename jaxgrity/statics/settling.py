"""A robot in the shape in which it rests, set down on its ground: what files of other programs rarely hold."""

import dataclasses
from typing import NamedTuple

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.springs import as_springs
from jaxgrity.model.structure import Structure, edge_lengths
from jaxgrity.statics.equilibrium import resting_shape

ROUNDS = 8
"""Number of rounds in which springs that replace rigid struts are lengthened by what they were compressed."""
STRUTS_WITHIN = 1e-10
"""Largest error of a rigid strut's length, as a share of its length."""


class Settled(NamedTuple):
    """What `settled` returns."""

    scene: Scene
    moved: float
    """m, the largest distance that a node moved with respect to the others' mean"""


@typed
def settled(scene: Scene) -> Settled:
    """The scene with its structure at rest without gravity, ground and gait, and set down on its ground.

    Rigid struts keep their lengths; supports hold. Where there are supports, or no ground, nothing is set down.

    Args:
        scene: what is to start at rest.

    Returns:
        The same scene from there, and how far the nodes moved.

    Raises:
        InputError: the structure finds no rest, or rigid struts cannot keep their lengths there.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> f"{jaxgrity.statics.settled(scene).moved:.0e}"  # m, to rounding: it is at rest already
        '1e-16'
    """
    structure = scene.structure
    given = np.asarray(structure.nodes, float)
    nodes = _at_rest(structure)
    moved = nodes - given
    if not structure.fixed:
        moved = moved - moved.mean(0)
        nodes = given + moved
        if scene.ground is not None:
            weight = float(structure.mass) * float(scene.gravity or 0.0)
            size = float(length_scale(scene))
            nodes = scene.ground.set_down(nodes, scene.ground.touching_depth(weight, 3, size), size)
    largest = float(np.linalg.norm(moved, axis=1).max())
    return Settled(dataclasses.replace(scene, structure=dataclasses.replace(structure, nodes=nodes)), largest)


def _at_rest(structure: Structure) -> np.ndarray:
    springs, count = as_springs(structure)
    nodes = np.asarray(resting_shape(Scene(springs)).q, float)
    if not count:
        return nodes
    assert springs.struts is not None, "as_springs made them"
    wanted = np.asarray(springs.struts.rest_length, float)
    for _ in range(ROUNDS):
        missing = wanted - edge_lengths(nodes, springs.struts.edges)
        if np.all(np.abs(missing) <= STRUTS_WITHIN * wanted):
            return nodes
        longer = dataclasses.replace(springs.struts, rest_length=springs.struts.rest_length + missing)
        springs = dataclasses.replace(springs, nodes=nodes, struts=longer)
        nodes = np.asarray(resting_shape(Scene(springs)).q, float)
    raise InputError(
        f"rigid struts are off by {np.abs(missing).max():.3g} m at rest; expected lengths that fit together"
    )

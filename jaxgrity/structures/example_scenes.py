"""Scenes from functions instead of files: structures of any size."""

import numpy as np

from jaxgrity.model.actuation import Gait
from jaxgrity.model.friction import ConeFriction, Friction, SmoothFriction
from jaxgrity.model.ground import ExactGround, Ground, PenaltyGround
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure, edge_lengths
from jaxgrity.structures.catalogue import prism_tower_geometry


def prism_tower(struts: int, exact: bool, prestrain: float = 0.02) -> Scene:
    """A tower of three-strut prisms on level ground, all struts actuated: for the cost of size.

    Args:
        struts: their number, a multiple of 3, three for each prism.
        exact: rigid struts and exact contact, instead of springs and penalty contact.
        prestrain: of the cables, whose rest lengths are (1 - prestrain) times their lengths.

    Returns:
        The scene, with the nodes of the lowest prism at z = 0.

    Raises:
        InputError: a number of struts that is not a multiple of 3.

    Example:
        >>> scene = jaxgrity.structures.prism_tower(12, exact=True)
        >>> scene.structure.nodes.shape  # (nodes, 3), m
        (24, 3)
    """
    nodes, rods, cables = prism_tower_geometry(struts)
    rigid, rest = edge_lengths(nodes, rods), (1 - prestrain) * edge_lengths(nodes, cables)
    structure = Structure(
        nodes,
        np.full(len(nodes), 0.5),
        Members(rods, None if exact else np.full(len(rods), 2e4), rigid),
        Members(cables, np.full(len(cables), 2e3), rest, np.full(len(cables), 10.0)),
    )
    gait = Gait(tuple(range(len(rods))), np.zeros(len(rods)), np.full(len(rods), 0.05), np.full(len(rods), 0.5))
    ground: Ground = ExactGround() if exact else PenaltyGround(1e4, 1.0)
    friction: Friction = ConeFriction(0.5) if exact else SmoothFriction(0.5, 0.01)
    return Scene(structure, 9.81, np.full(len(nodes), 0.5), ground, friction, gait)

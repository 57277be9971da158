"""A tower of three-strut prisms, as tall as one likes: a structure of any size, to see what size costs."""

import numpy as np

from jaxgrity import Gait, Members, Scene, Structure
from jaxgrity.model.friction import ConeFriction, SmoothFriction
from jaxgrity.model.ground import Ground

RADIUS, HEIGHT, GAP = 0.3, 0.6, 0.05
"""m"""
TWIST = 5 * np.pi / 6
"""rad, between a prism's triangles: the angle at which it can be prestressed"""


def tower(struts: int, exact: bool, prestrain: float = 0.02) -> Scene:
    """`struts`/3 prisms on top of each other, each tied to the next by six cables; all struts are actuated.

    With rigid struts and exact contact, or with springs and penalty contact.
    """
    stages = struts // 3
    around = 2 * np.pi / 3 * np.arange(3)
    nodes, rods, cables = [], [], []
    for k in range(stages):
        low, high = 6 * k, 6 * k + 3
        for turn, level in ((0.0, 0.0), (TWIST, HEIGHT)):
            z = np.full(3, k * (HEIGHT + GAP) + level)
            nodes.append(np.stack([RADIUS * np.cos(around + turn), RADIUS * np.sin(around + turn), z], axis=1))
        for a in range(3):
            b = (a + 1) % 3
            rods.append((low + a, high + a))
            cables += [(low + a, low + b), (high + a, high + b), (low + a, high + (a + 2) % 3)]
            if k + 1 < stages:
                cables += [(high + a, low + 6 + a), (high + a, low + 6 + b)]
    positions = np.concatenate(nodes)
    lengths = [np.linalg.norm(np.subtract(*positions[list(edge)])) for edge in rods + cables]
    rigid, rest = lengths[: len(rods)], (1 - prestrain) * np.array(lengths[len(rods) :])
    many = len(cables)
    structure = Structure(
        positions,
        np.full(len(positions), 0.5),
        Members(tuple(rods), None if exact else np.full(len(rods), 2e4), np.array(rigid)),
        Members(tuple(cables), np.full(many, 2e3), rest, np.full(many, 10.0)),
    )
    gait = Gait(tuple(range(len(rods))), np.zeros(len(rods)), np.full(len(rods), 0.05), np.full(len(rods), 0.5))
    ground = Ground(None if exact else 1e4, None if exact else 1.0)
    friction = ConeFriction(0.5) if exact else SmoothFriction(0.5, 0.01)
    return Scene(structure, 9.81, np.full(len(positions), 0.5), ground, friction, gait)

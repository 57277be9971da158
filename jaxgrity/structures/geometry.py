"""The geometry of the catalogue's structures: nodes, pairs joined by struts and cables, and rigid bodies."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrity.core.arguments import check_count, check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import Edges
from jaxgrity.model.balls import Balls
from jaxgrity.model.bodies import Bodies


class Geometry(NamedTuple):
    """A structure without masses and springs."""

    nodes: Float[np.ndarray, "nodes 3"]
    """m"""
    struts: Edges
    cables: Edges


class RobotGeometry(NamedTuple):
    """A structure with rigid bodies, without springs."""

    nodes: Float[np.ndarray, "nodes 3"]
    """m"""
    struts: Edges
    cables: Edges
    bodies: Bodies = ()
    balls: Balls | None = None
    """the nodes that touch the ground; None: all do"""


def ring(count: int, radius: float, turn: float, height: float) -> np.ndarray:
    """`count` nodes (count, 3) evenly on a circle about z, the first at the angle `turn`, rad."""
    angles = turn + 2 * np.pi / count * np.arange(count)
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, height)], axis=1)


def joined(first: int, second: int, count: int, step: int = 0) -> Edges:
    """Node i of a ring that starts at number `first` to node i + `step` of one that starts at `second`, for all i."""
    return tuple((first + i, second + (i + step) % count) for i in range(count))


def at_most(name: str, value: int, most: int) -> None:
    """Raises `InputError` for a number of a structure above its limit."""
    if value > most:
        raise InputError(f"{name} = {value}: expected at most {most}")


def at_least(name: str, value: int, least: int) -> None:
    """Raises `InputError` for a number of a structure that is not whole, or below its limit."""
    check_count(name, value, least)


def check_positive(**values: float) -> None:
    """Raises `InputError` for a length, m, or a mass, kg, that is not positive."""
    for name, value in values.items():
        check_number(name, value, above=0.0, unit="kg" if name.endswith("mass") else "m")

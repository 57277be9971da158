"""Obstacles: discs on the ground, a robot's distance from them, and ways round them to a goal."""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.model.ground import Ground
from jaxgrity.model.height_fields import HeightField
from jaxgrity.model.rigidity import lines_between_points
from jaxgrity.model.rod_contact import radii_along_struts
from jaxgrity.model.rods import rods_of
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.solids import Box, Cylinder, Sphere
from jaxgrity.model.surface import Slope

GRID_STEPS = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2))
"""Steps on a grid in 8 directions. With their opposites, ways are at most 2.8 % longer than straight ones."""
CLOSE = 8.0
"""Factor on the length of a way along which the robot would just touch an obstacle."""
REACH = 0.6
"""Default distance from a robot's centre to its outermost point, m, for the library's robots of one metre."""
COMFORT, SPACING = 0.4, 0.1
"""Default room beyond the reach, m for a robot of one metre: with less, ways count as longer. Then the default spacing
of the grid, m for the same robot."""
MOST_POINTS = 1_000_000
"""Most points of a grid of ways: a gigabyte of links between them."""
SAME_REACH = 1e-6
"""Relative amount by which rounding may make a given reach smaller than the robot's own."""


class Discs(NamedTuple):
    """The areas, seen from above, that a robot shall not touch."""

    centres: np.ndarray
    """(discs, 2), m"""
    radii: np.ndarray
    """(discs,), m"""


@typed
def discs_of(ground: Ground | None) -> Discs:
    """The discs about the obstacles of a scene's ground, seen from above; about a box the disc through its corners.

    Planes and height fields are ground: bumps and hills are no obstacles. Raises `InputError` without a ground. All
    other parts of the surface must be boxes, balls or cylinders.
    """
    if ground is None:
        raise InputError("ground: there is none; expected that of a scene with [ground]")
    parts = () if ground.surface is None else ground.surface.solids
    moved = np.zeros(3) if ground.offset is None else np.asarray(ground.offset, float)
    if moved.ndim > 1:
        raise InputError("ground.offset: that of many robots; expected the ground of one")
    found = []
    for part in parts:
        if isinstance(part, Cylinder):
            ends = np.array([np.asarray(part.start), np.asarray(part.end)], float)[:, :2]
            found.append((*ends.mean(0), float(part.radius) + np.linalg.norm(ends[1] - ends[0]) / 2))
        elif isinstance(part, Box):
            middle, corners = (np.asarray(x, float)[..., :2] for x in (part.centre, part.corners))
            found.append((*middle, np.linalg.norm(corners - middle, axis=1).max()))
        elif isinstance(part, Sphere) and not part.hollow:
            found.append((*np.asarray(part.centre, float)[:2], float(part.radius)))
        elif not isinstance(part, Slope | HeightField):
            raise InputError(
                f"ground: {type(part).__name__} is nothing to go round, nor to roll on; "
                "expected planes, height fields, boxes, balls and cylinders"
            )
    table = np.array(found, float).reshape(-1, 3)
    return Discs(table[:, :2] + moved[:2], table[:, 2])


@typed
def reach_of(scene: Scene) -> float:
    """Distance, m, of the farthest node or ball from the centre of mass. It does not depend on the robot's
    orientation."""
    q = np.asarray(scene.structure.nodes, float)
    mass = np.asarray(scene.structure.lumped_mass, float)
    away = np.linalg.norm(q - mass @ q / mass.sum(), axis=1)
    if scene.ground is not None and scene.ground.balls is not None:
        away[list(scene.ground.balls.nodes)] += np.asarray(scene.ground.balls.radius, float)
    return float(away.max())


@typed
def room(discs: Discs, places: np.ndarray) -> np.ndarray:
    """Distance (...,), m, of each of `places` (..., 2) from the edge of the nearest disc. It is negative inside, and
    infinite without discs."""
    if not len(discs.radii):
        return np.full(places.shape[:-1], np.inf)
    away = np.linalg.norm(places[..., None, :] - discs.centres, axis=-1)
    return np.asarray((away - discs.radii).min(-1))


@typed
def gap(discs: Discs, scene: Scene, q: np.ndarray) -> np.ndarray:
    """Distance (...,), m, seen from above, of a robot at `q` (..., nodes, 3) from the nearest disc. A touch is
    negative.

    The robot is all its struts and cables, as straight lines, lines between all points of a rigid body, and its balls.
    Struts and rods of bodies that touch the ground between their ends have the radius with which they do. A disc
    between the robot's members counts by its distance from those: nothing gets there without a touch.
    """
    if np.shape(q)[-2:] != scene.structure.nodes.shape:
        raise InputError(f"q has shape {np.shape(q)}; expected (..., {len(scene.structure.nodes)}, 3)")
    if not len(discs.radii):
        return np.full(q.shape[:-2], np.inf)
    structure, balls = scene.structure, None if scene.ground is None else scene.ground.balls
    edges = [*rods_of(structure), *(edge for members in structure.members for edge in members.edges)]
    if not (edges := [*edges, *lines_between_points(structure.bodies)]):
        raise InputError("the robot has neither members nor bodies; expected some, to be kept from discs")
    (i, j), along_struts = np.array(edges).T, radii_along_struts(scene)
    thick = np.array([along_struts.get(k, 0.0) for k in range(len(edges))])
    least = np.full(q.shape[:-2], np.inf)
    for centre, radius in zip(discs.centres, discs.radii):
        least = np.minimum(least, (_away_from_lines(centre, q[..., i, :2], q[..., j, :2]) - thick).min(-1) - radius)
        if balls is not None:
            away = np.linalg.norm(q[..., list(balls.nodes), :2] - centre, axis=-1) - np.asarray(balls.radius)
            least = np.minimum(least, away.min(-1) - radius)
    return np.asarray(least)


def _away_from_lines(place: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Distance (...,), m, of a place (2,) from the straight lines between two places (..., 2) each."""
    along = ends - starts
    share = ((place - starts) * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-12)
    return np.asarray(np.linalg.norm(starts + np.clip(share, 0, 1)[..., None] * along - place, axis=-1))


class WayMap(NamedTuple):
    """The distance to a goal from everywhere, round all discs. Made by `way_map`."""

    discs: Discs
    goal: np.ndarray
    """(2,), m"""
    corner: np.ndarray
    """(2,), m, of the first point of the grid"""
    spacing: float
    """m"""
    reach: float
    """m, from the robot's centre of mass to its farthest node"""
    distance: np.ndarray
    """(points along x, points along y), m. Metres near an obstacle count up to `CLOSE` times. Infinite if no way leads
    to the goal"""
    onward: np.ndarray
    """(points along x, points along y), number of the next point on the way; negative where there is none"""

    def to_go(self, places: np.ndarray) -> np.ndarray:
        """Way (...,), m, from each of `places` (..., 2) to the goal, interpolated in `distance`.

        Outside the arena a metre counts `CLOSE` times. If no way leads to the goal, it is three times the longest one.
        """
        places, finite = np.asarray(places, float), np.isfinite(self.distance)
        table = np.where(finite, self.distance, 3 * self.distance[finite].max(initial=self.spacing))
        where = ((places - self.corner) / self.spacing).reshape(-1, 2).T
        inside = np.stack([np.clip(w, 0, n - 1.0) for w, n in zip(where, table.shape)])
        beyond = self.spacing * np.linalg.norm(where - inside, axis=0)
        return (map_coordinates(table, inside, order=1) + CLOSE * beyond).reshape(places.shape[:-1])

    def way(self, start: np.ndarray) -> np.ndarray:
        """A way (points, 2), m, from `start` (2,) to the goal, at most 3 % longer than the shortest.

        It is `start` alone if there is no way. Raises `InputError` if `start` is no place."""
        if np.shape(start) != (2,) or not np.isfinite(start).all():
            raise InputError(f"start = {np.asarray(start).tolist()}: expected a place (x, y), m")
        here = np.rint((np.asarray(start) - self.corner) / self.spacing).astype(int)
        here = np.clip(here, 0, np.array(self.distance.shape) - 1)
        found, onward = [np.asarray(start, float)], int(self.onward[tuple(here)])
        while onward >= 0:
            found.append(self.corner + self.spacing * np.array(np.unravel_index(onward, self.distance.shape)))
            onward = int(self.onward.flat[onward])
        return np.array(found)


class StraightWay(NamedTuple):
    """The distance to a goal where there is nothing to go round."""

    goal: np.ndarray
    """(2,), m"""
    discs: Discs = Discs(np.zeros((0, 2)), np.zeros(0))
    reach: float = 0.0
    """m, as nothing can be touched"""

    def to_go(self, places: np.ndarray) -> np.ndarray:
        """(...,), m, from each of `places` (..., 2)."""
        return np.asarray(np.linalg.norm(places - self.goal, axis=-1))


Way = WayMap | StraightWay
"""The distance to a goal from everywhere."""


@typed
def way_map(
    discs: Discs,
    goal: np.ndarray,
    arena: tuple[float, float, float, float],
    *,
    robot: Scene | None = None,
    reach: float | None = None,
    comfort: float | None = None,
    spacing: float | None = None,
) -> WayMap:
    """Distances to a goal round all discs, by Dijkstra's method on a grid of 16 directions.

    Args:
        discs: what to keep clear of.
        goal: (2,), m.
        arena: least x, least y, largest x and largest y of ways, m.
        robot: the robot on the way; ways too narrow for it are refused.
        reach: least distance of a way from a disc, m: from the robot's centre of mass to its farthest node. By default
            the robot's own (`reach_of`), or `REACH` without a robot.
        comfort: distance beyond the reach, m. Nearer ways count as longer, up to `CLOSE` times. By default `COMFORT` at
            the robot's size.
        spacing: of the grid, m, at most half of `reach`. By default `SPACING` at the robot's size.

    Returns:
        The distances, infinite where no way leads to the goal.

    Raises:
        InputError: a goal outside the arena or too near to a disc. Numbers that are not positive, or a reach below the
            robot's own. Discs that are not (discs, 2) centres and as many radii.
    """
    reach, size = _reach_for(robot, reach), 1.0 if robot is None else float(length_scale(robot))
    comfort, spacing = (
        own * size if given is None else given for given, own in ((comfort, COMFORT), (spacing, SPACING))
    )
    _check_discs(discs)
    if np.shape(arena) != (4,) or not np.isfinite(arena).all():
        raise InputError(f"arena = {arena}: expected four numbers: the least x and y, and the largest x and y, m")
    low, high = np.array(arena[:2], float), np.array(arena[2:], float)
    if np.shape(goal) != (2,) or not np.all((low < goal) & (goal < high)):
        raise InputError(f"goal = {np.asarray(goal).tolist()}: expected one inside the arena {arena}")
    if not ((np.array([reach, comfort, spacing]) > 0).all() and spacing <= reach / 2):
        found = f"reach, comfort, spacing = {reach}, {comfort}, {spacing} m"
        raise InputError(f"{found}: expected positive numbers, and a spacing of at most half of reach")
    shape = tuple((np.ceil((high - low) / spacing) + 1).astype(int))
    if np.prod(shape, dtype=float) > MOST_POINTS:
        found = f"arena = {tuple(arena)}: a grid of {shape[0]} times {shape[1]} points {spacing:g} m apart"
        raise InputError(f"{found}; expected at most {MOST_POINTS:,}, by a smaller arena or a wider spacing")
    x, y = (low[k] + spacing * np.arange(shape[k]) for k in range(2))
    free = room(discs, np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)) - reach
    weight = np.where(free > 0, 1 + (CLOSE - 1) * np.clip(1 - free / comfort, 0, 1), np.inf)
    nearest = np.rint((np.asarray(goal) - low) / spacing).astype(int)
    if not np.isfinite(weight[tuple(nearest)]):
        near = float(free[tuple(nearest)]) + reach
        raise InputError(
            f"goal = {np.asarray(goal).tolist()}: {near:.2g} m from a disc; expected more than reach, {reach:g} m"
        )
    wide = Discs(np.asarray(discs.centres) - low, np.asarray(discs.radii) + reach)
    index = int(np.ravel_multi_index(tuple(nearest), shape))
    found = dijkstra(_links(free, weight, spacing, wide), directed=False, indices=index, return_predecessors=True)
    return WayMap(discs, np.asarray(goal, float), low, spacing, reach, *(each.reshape(shape) for each in found))


def _links(free: np.ndarray, weight: np.ndarray, spacing: float, wide: Discs) -> csr_matrix:
    """The length of each step between points of the grid, m, by their numbers; each metre counts with its weight.
    No step leads through the `wide` discs, with the reach about them. Points are `free` by so much, m."""
    ends, costs, number = [], [], np.arange(weight.size).reshape(weight.shape)
    for step in GRID_STEPS:
        (a, b), length = _shifted(number, step), spacing * np.hypot(*step)
        cost = length * (weight.ravel()[a] + weight.ravel()[b]) / 2
        near = np.flatnonzero(free.ravel()[a] < length)
        lines = [spacing * np.stack(np.unravel_index(each[near], number.shape), axis=-1) for each in (a, b)]
        for centre, radius in zip(wide.centres, wide.radii):
            cost[near[_away_from_lines(centre, *lines) <= radius]] = np.inf
        ends.append(np.stack([a, b])[:, np.isfinite(cost)])
        costs.append(cost[np.isfinite(cost)])
    (a, b), cost = np.concatenate(ends, axis=1), np.concatenate(costs)
    return coo_matrix((cost, (a, b)), shape=(weight.size, weight.size)).tocsr()


def _reach_for(robot: Scene | None, reach: float | None) -> float:
    """The reach of ways, m. Raises `InputError` where it is below the robot's own."""
    own = 0.0 if robot is None else reach_of(robot)
    reach = (own or REACH) if reach is None else reach
    if reach < own * (1 - SAME_REACH):
        raise InputError(f"reach = {reach:g} m: the robot sticks out {own:.3g} m; expected at least that")
    return reach


def _check_discs(discs: Discs) -> None:
    """Raise `InputError` for other shapes, or radii that are not positive."""
    count, shapes = np.size(discs.radii), (np.shape(discs.centres), np.shape(discs.radii))
    if shapes != ((count, 2), (count,)) or np.any(np.asarray(discs.radii) <= 0):
        found = f"discs: centres of shape {shapes[0]}, radii {np.asarray(discs.radii).tolist()} m"
        raise InputError(f"{found}; expected (discs, 2), and as many positive numbers")


def _shifted(number: np.ndarray, step: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """The points of a grid and those one step further, where both exist."""
    (i, j), (m, n) = step, number.shape
    first = number[: m - i, max(0, -j) : n - max(0, j)]
    second = number[i:, max(0, j) : n + min(0, j)]
    return first.ravel(), second.ravel()

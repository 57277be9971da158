"""Nodes that meet edges: the face that their way enters first is the one that holds them, on either side of it."""

import numpy as np
import pytest

from jaxgrity import (
    Box,
    ConeFriction,
    Cylinder,
    ExactGround,
    Scene,
    Slope,
    SolverOptions,
    Sphere,
    Stairs,
    Structure,
    Union,
    simulate,
)

G, DT = 9.81, 5e-3
CORNER = 1e-9
"""m: nodes that pass an edge within this meet either face"""


def paths(surface, starts, velocities=None, friction=None, duration=0.4):
    """(times, nodes, 3), m: positions after each step of nodes that know nothing of each other."""
    body = Structure(np.asarray(starts, float), np.ones(len(starts)))
    scene = Scene(body, G, ground=ExactGround(surface=surface), friction=friction)
    options = SolverOptions(dt=DT, any_step=True)
    found = simulate(scene, duration, options=options, velocities=velocities, frame_rate=1 / DT)
    assert not found.failed
    return np.asarray(found.positions)


class Block:
    """A convex body with flat faces: n·x <= d for all of them, and what a line meets of it."""

    def __init__(self, normals, distances):
        self.normals, self.distances = np.asarray(normals, float), np.asarray(distances, float)

    def entered(self, start, way):
        """For each line the share at which it enters, infinite where it does not, its face, and whether it is a tie."""
        gap, rate = self.distances - start @ self.normals.T, way @ self.normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            at = gap / rate
        first = np.where(rate < 0, at, np.where((rate == 0) & (gap < 0), np.inf, -np.inf))
        last = np.where(rate > 0, at, np.inf).min(1)
        order = np.sort(first, axis=1)
        size = np.linalg.norm(way, axis=1)
        tie = (order[:, -1] - order[:, -2]) * size < CORNER
        grazes = abs(order[:, -1] - last) * size < 1e-7
        share = order[:, -1]
        hit = (share <= last) & (share >= 0) & (share < 1)
        return np.where(hit, share, np.inf), self.normals[first.argmax(1)], tie | grazes


def box_block(centre, size, turn=0.0):
    axes = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    normals = np.vstack([axes, -axes])
    return Box(np.asarray(centre), np.asarray(size), turn), Block(normals, normals @ centre + np.tile(size, 2) / 2)


FLOOR = Slope(), Block([[0, 0, 1.0], [0, 0, 1.0]], [0.0, 1.0])
FIRST, SECOND = box_block([0.0, 0, 0.1], [0.4, 4.0, 0.2]), box_block([0.25, 0, 0.15], [0.12, 0.3, 0.3], 0.5)
THIN = box_block([0.0, 0, 0.25], [0.3, 4.0, 0.02])
TREADS = [Block([[-1.0, 0, 0], [0, 0, 1.0]], [-0.1 - 0.2 * k, 0.15 * (k + 1)]) for k in range(3)]
GROUNDS = {
    "stairs": (Stairs(0.15, 0.2, 3, start=0.1), [*TREADS, FLOOR[1]], [0.1, 0.3, 0.5]),
    "box": (Union((FIRST[0], FLOOR[0])), [FIRST[1], FLOOR[1]], [-0.2, 0.2]),
    "boxes that meet": (Union((FIRST[0], SECOND[0], FLOOR[0])), [FIRST[1], SECOND[1], FLOOR[1]], [0.2, 0.25]),
    "a thin shelf": (Union((THIN[0], FLOOR[0])), [THIN[1], FLOOR[1]], [-0.15, 0.15]),
}


def drops(rims, count, seed=0):
    """Starts about rims, m, and velocities, m/s."""
    draw = np.random.default_rng(seed)
    x = draw.choice(rims, count) + draw.uniform(-0.03, 0.03, count)
    starts = np.stack([x, draw.uniform(-0.2, 0.2, count), draw.uniform(0.6, 1.0, count)], 1)
    velocities = draw.normal(0, 0.7, (count, 3)) * (draw.uniform(size=count) < 0.7)[:, None]
    return starts, velocities


def check_sides(ground, count):
    """Each node that enters the ground in a step ends it where the face that it met first leaves it.

    Without friction that is its free motion, less what leads into that face.
    """
    surface, blocks, rims = ground
    starts, velocities = drops(rims, count)
    q = paths(surface, starts, velocities)
    met = 0
    for before, now, after in zip(q, q[1:], q[2:]):
        way = now - before
        outside = ExactGround(surface=surface).measured(now[None]).distance[0] > CORNER
        share, normal, tie = (np.stack(x, 1) for x in zip(*(block.entered(now, way) for block in blocks)))
        first = share.argmin(1)
        rows = np.arange(len(first))
        others = np.sort(share, axis=1)[:, 1]
        close = (others - share[rows, first]) * np.linalg.norm(way, axis=1) < CORNER
        hit = outside & np.isfinite(share[rows, first]) & ~tie[rows, first] & ~close
        n, free = normal[rows, first], now + way - [0, 0, G * DT**2]
        place = now + np.where(hit, share[rows, first], 0)[:, None] * way
        deep = np.minimum(np.sum(n * (free - place), axis=1), 0)
        expected = free - deep[:, None] * n
        off = np.linalg.norm(after - expected, axis=1) * hit
        assert off.max() < 1e-7, (now[off.argmax()], way[off.argmax()], n[off.argmax()])
        met += int(hit.sum())
    return met

"""Rods thrown at a post and at each other, on exact contact: how deep they enter, and how much energy grows.

Rods have a length of 1 m, and steps of 5 ms.
"""

from collections.abc import Iterator

import numpy as np
from measurements.measurement import Record, measurement
from measurements.pages import columns

import jaxgrity
from jaxgrity import ConeFriction, ExactGround, Members, Scene, SolverOptions, Structure, with_contact_along_struts
from jaxgrity.model import with_contact_between_struts
from jaxgrity.populations import rod_depths

RADIUS = 0.02
"""Radius of the rods that are thrown at each other, m."""
POST = jaxgrity.Box((0.0, 0.0, 0.0), (0.2, 2.0, 0.6))
"""Post with edges along y at the height 0.3 m."""
STEP = SolverOptions(dt=5e-3)
"""The default step of robots of this size on exact contact, s."""
PLACES = 127
"""Number of places between the ends of a rod at which its depth in the post is looked up: one each 8 mm."""
MASSES = (1.0, 2.0, 0.5, 1.0)
"""Masses of the ends of two rods that are thrown at each other, kg: unequal, so that impacts turn them."""


@measurement(page="terrain.md", quick={"count": 6})
def thrown_rods(count: int = 200) -> Iterator[Record]:
    """A row for each kind of throw.

    Args:
        count: number of throws at the post, and of pairs
    """
    yield {"thrown": "thin rods, at a post", **summary([at_post(k) for k in range(count)])}
    for name, chosen in (("pairs that cross", crossing), ("nearly parallel pairs", nearly_parallel)):
        yield {"thrown": name, **summary([at_each_other(k) for k in range(count) if chosen(k)])}


def summary(throws: list[dict]) -> dict:
    """The overlaps of all throws, m, and the largest growth of energy."""
    overlap = np.array([each["overlap"] for each in throws])
    return {
        "count": len(throws),
        "most": float(np.quantile(overlap, 0.95)),
        "largest": float(overlap.max()),
        "growth": max(each["growth"] for each in throws) if "growth" in throws[0] else None,
    }


def nearly_parallel(number: int) -> bool:
    """Whether this pair is: every third."""
    return number % 3 == 0


def crossing(number: int) -> bool:
    return not nearly_parallel(number)


def thrown_at_post(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Ends of a random rod above the post, m, and their velocities, m/s."""
    rng = np.random.default_rng(number)
    u, spin = rng.normal(size=3), 3 * rng.normal(size=3)
    u /= np.linalg.norm(u)
    middle, v = rng.uniform([-0.5, -0.3, 0.9], [0.5, 0.3, 1.1]), rng.normal(size=3) * [1.0, 0.3, 0.0] - [0.0, 0.0, 1.0]
    arms = np.stack([-u / 2, u / 2])
    return middle + arms, v + np.cross(spin, arms)


def thrown_pair(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Ends of two random rods beside each other, on their way to meet, and their velocities."""
    rng = np.random.default_rng(number)
    u = rng.normal(size=(2, 3))
    if nearly_parallel(number):
        u[1] = u[0] + 0.01 * u[1]
    u /= np.linalg.norm(u, axis=1)[:, None]
    n = np.cross(u[0], rng.normal(size=3) if nearly_parallel(number) else u[1])
    n /= np.linalg.norm(n)
    middles = np.array([-0.15 * n, 0.15 * n]) + 0.2 * rng.uniform(-1, 1, (2, 1)) * u
    q = (middles[:, None] + np.array([-0.5, 0.5])[:, None] * u[:, None]).reshape(4, 3)
    drift, spin = np.array([1.5 * n, -1.5 * n]) + 0.3 * rng.normal(size=(2, 3)), 2 * rng.normal(size=(2, 3))
    v = (drift[:, None] + np.array([-0.5, 0.5])[:, None] * np.cross(spin, u)[:, None]).reshape(4, 3)
    return q, v


def at_post(number: int) -> dict:
    """How deep a rod of 2 kg enters the post in 1 s, m."""
    nodes = np.array([[-0.5, 0.0, 0.31], [0.5, 0.0, 0.31]])
    rod = Structure(nodes, [1.0, 1.0], Members(((0, 1),), None, [1.0]))
    scene = with_contact_along_struts(Scene(rod, 9.81, None, ExactGround(surface=POST), ConeFriction(0.4)), 1)
    q, v = thrown_at_post(number)
    motion = jaxgrity.simulate(scene, 1.0, positions=q, velocities=v, options=STEP, frame_rate=200.0)
    return {"overlap": float(rod_depths(scene, motion, PLACES)[0])}


def at_each_other(number: int) -> dict:
    """How deep two rods enter each other in 0.4 s, m, and the largest growth of energy in a step, as a share of it."""
    nodes = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.1, -0.5, 0.09], [0.1, 0.5, 0.09]])
    rods = Structure(nodes, MASSES, Members(((0, 1), (2, 3)), None, [1.0, 1.0]))
    scene = with_contact_between_struts(Scene(rods), RADIUS)
    q, v = thrown_pair(number)
    motion = jaxgrity.simulate(scene, 0.4, positions=q, velocities=v, options=STEP, frame_rate=200.0)
    energy = (np.array(MASSES)[:, None] * np.asarray(motion.velocities) ** 2).sum((1, 2)) / 2
    overlap = max(0.0, 2 * RADIUS - min(apart(*ends) for ends in np.asarray(motion.positions)))
    return {"overlap": overlap, "growth": float(np.diff(energy).max() / energy[0])}


def apart(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> float:
    """The distance, m, of the segments from a to b and from c to d, which are not parallel."""
    u, w, r = b - a, d - c, a - c
    normal = np.cross(u, w)
    square = normal @ normal
    s, t = np.cross(w, r) @ normal / square, np.cross(u, r) @ normal / square
    if 0 <= s <= 1 and 0 <= t <= 1:
        return abs(float(r @ normal)) / float(np.linalg.norm(normal))
    return min(to_point(c, a, u), to_point(d, a, u), to_point(a, c, w), to_point(b, c, w))


def to_point(x: np.ndarray, start: np.ndarray, along: np.ndarray) -> float:
    """The distance, m, of a point from a segment."""
    share = np.clip((x - start) @ along / (along @ along), 0.0, 1.0)
    return float(np.linalg.norm(x - start - share * along))


@thrown_rods.table
def words(record: Record) -> str:
    """How deep rods enter, and how much energy grows."""
    growth = lambda row: "-" if row["growth"] is None else f"{100 * row['growth']:.1f}"  # noqa: E731
    cells = {
        "thrown": "{thrown}",
        "throws": "{count}",
        "95 % overlap by at most, mm": lambda row: f"{1e3 * row['most']:.2f}",
        "largest overlap, mm": lambda row: f"{1e3 * row['largest']:.2f}",
        "energy grows per step by at most, %": growth,
    }
    return columns(record["rows"], cells)

"""Small scenes of every kind that together show every pair of kinds, at three sizes that move alike.

The sizes are similar by Froude's rule: with lengths times s, times go as s^(1/2), masses and forces as s^3. Where the
library decides by a number of metres or seconds of its own, they move otherwise.
"""

import itertools
import random
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity import (
    Box,
    ConeFriction,
    ExactGround,
    Gait,
    HeightFunction,
    Members,
    Motor,
    Overtone,
    PenaltyGround,
    Push,
    Scene,
    Shaking,
    Slope,
    SmoothFriction,
    Sphere,
    Stairs,
    Structure,
    SwitchFriction,
    Union,
    bumps,
    edge_lengths,
    force_limit,
    force_table,
    height_map,
    wind,
    with_contact_along_struts,
    with_terms,
)

KINDS: dict[str, tuple[Any, ...]] = {
    "ground": ("none", "plane", "incline", "bumps", "heights", "function", "stairs", "union", "bowl", "moved"),
    "contact": ("smooth", "switch", "exact"),
    "struts": ("springs", "rigid", "heavy springs", "heavy rods", "points"),
    "cables": ("springs", "limits", "table", "cluster"),
    "beside": ("nothing", "motor", "supports", "shaking", "wind"),
    "gait": ("none", "struts", "cables", "overtones"),
    "size": (0.05, 1.0, 20.0),
    "dtype": ("float32", "float64"),
}
"""What a scene is made of; `contact` is "smooth" or "switch" friction on penalty ground, or "exact"."""
NODES = np.array([[0.0, 0.0, 0.0], [0.8, 0.0, 0.6], [0.5, 0.6, 0.2], [0.3, -0.5, 0.7]])
STRUTS, CABLES = ((0, 1), (2, 3)), ((0, 2), (1, 2), (0, 3), (1, 3))
"""Positions, in units of the size, and members: two struts, and four cables that join them."""
GAP, MOTION = 0.01, 0.1
"""How far above the ground the scene starts, and how long it moves, at size 1: so long that it touches the ground."""

Row = dict[str, Any]
"""a kind of each aspect"""


IMPOSSIBLE = {
    (("contact", "switch"), ("struts", "points")),
    (("ground", "none"), ("struts", "points")),
}
"""Pairs that are refused where the scene is made."""
LATER = {(("contact", "exact"), ("struts", "points"))}
"""A pair that was refused when the first rows were drawn: the last rows show it, so that the first stay."""


def pairs(row: Row) -> set[tuple]:
    """The pairs of kinds that a row shows."""
    return set(itertools.combinations(row.items(), 2))


def covering(kinds: dict[str, tuple[Any, ...]], seed: int = 0, tries: int = 100) -> list[Row]:
    """Few rows that show every pair of kinds: each is the one of some random ones that shows the most new pairs."""
    rng, rows = random.Random(seed), list[Row]()
    for missing in (IMPOSSIBLE | LATER, IMPOSSIBLE):
        left = {
            ((a, x), (b, y))
            for (a, kinds_a), (b, kinds_b) in itertools.combinations(kinds.items(), 2)
            for x in kinds_a
            for y in kinds_b
        }.difference(missing, *map(pairs, rows))
        while left:
            ordered = sorted(left, key=str)
            made = (
                {name: rng.choice(each) for name, each in kinds.items()} | dict(rng.choice(ordered))
                for _ in range(tries)
            )
            rows.append(max((row for row in made if not pairs(row) & missing), key=lambda row: len(pairs(row) & left)))
            left -= pairs(rows[-1])
    return rows


class Units(NamedTuple):
    """What is 1 at size 1."""

    length: float
    time: float
    mass: float

    @property
    def speed(self) -> float:
        return self.length / self.time

    @property
    def force(self) -> float:
        return self.mass * self.length / self.time**2

    @property
    def stiffness(self) -> float:
        return self.force / self.length

    @property
    def damping(self) -> float:
        return self.force / self.speed


def units_of(row: Row) -> Units:
    """Those of the row's size."""
    size = row["size"]
    return Units(size, size**0.5, size**3)


def turn_about_z(turn: float) -> np.ndarray:
    """(3, 3), a rotation by so many rad."""
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def scene_of(row: Row, turn: float = 0.0, shift: tuple[float, float] = (0.0, 0.0)) -> Scene:
    """The scene of a row, turned (rad) about the vertical through the origin and then moved (units of the size)."""
    at = units_of(row)
    moved = at.length * np.array([*shift, 0.0])
    rotation = turn_about_z(turn)
    ground, friction = ground_of_row(row, at, turn, moved)
    scene = Scene(
        structure_of(row, at, at.length * NODES @ rotation.T + moved),
        gravity=9.81,
        node_damping=np.array([0.1, 0.2, 0.3, 0.1]) * at.damping,
        ground=ground,
        friction=friction,
        gait=gait_of(row, at),
        shaking=Shaking(rotation @ [0.01 * at.length, 0.0, 0.005 * at.length], 3.0 / at.time, ramp=0.05 * at.time)
        if row["beside"] == "shaking"
        else None,
    )
    if ground is not None:
        placed = np.asarray(ground.set_above(jnp.asarray(scene.structure.nodes, float), GAP * at.length))
        scene = eqx.tree_at(lambda s: s.structure.nodes, scene, placed)
    scene = with_terms(scene, *laws_of(row, at, scene, rotation))
    return with_contact_along_struts(scene, 3) if row["struts"] == "points" else scene


def structure_of(row: Row, at: Units, nodes: np.ndarray) -> Structure:
    """The struts, the cables, and what is beside them."""
    rigid = row["struts"] in ("rigid", "heavy rods")
    struts = Members(
        STRUTS,
        None if rigid else np.full(2, 5e3 * at.stiffness),
        edge_lengths(nodes, STRUTS),
        damping=None if rigid else np.full(2, 10.0 * at.damping),
        mass=np.full(2, 0.3 * at.mass) if row["struts"].startswith("heavy") else None,
    )
    motor = Motor(1, [0.0, 0.05 * at.time], [0.55 * at.length, 0.65 * at.length], 1.0 * at.speed, 0.02 * at.time)
    clustered = row["cables"] == "cluster"
    cables = Members(
        CABLES,
        np.full(4, 300.0 * at.stiffness),
        np.full(4, 0.6 * at.length),
        damping=np.full(4, 5.0 * at.damping),
        clusters=((0, 1),) if clustered else (),
        motors=(motor,) if row["beside"] == "motor" else (),
    )
    held = ((1, "xyz"),) if row["beside"] in ("supports", "shaking") else ()
    return Structure(nodes, np.array([1.0, 2.0, 0.5, 0.8]) * at.mass, struts, cables, fixed=held)


def gait_of(row: Row, at: Units) -> Gait | None:
    """What actuates the first strut or the first cable, which a motor does not wind."""
    if row["gait"] == "none":
        return None
    members = (0,) if row["gait"] == "struts" else (2,)
    overtones = (Overtone([0.3], [1.0]),) if row["gait"] == "overtones" else ()
    return Gait(members, [0.3], [0.1], [2.0 / at.time], start=0.0, ramp=0.1 * at.time, overtones=overtones)


def laws_of(row: Row, at: Units, scene: Scene, rotation: np.ndarray) -> list:
    """What acts beside the structure's own laws, in the order of scene files."""
    cables = scene.structure.cables
    assert cables is not None, "every row has cables"
    found: list = []
    if row["beside"] == "wind":
        found.append(wind(rotation @ [3.0 * at.speed, 1.0 * at.speed, 0.0], 0.1 * at.mass / at.length, 4))
        push = (rotation @ [4.0 * at.force, 0.0, 2.0 * at.force])[None]
        found.append(Push((2,), push, 0.02 * at.time, 0.05 * at.time, 0.02 * at.time))
    if row["cables"] == "limits":
        found.append(force_limit(cables, 20.0 * at.force))
    if row["cables"] == "table":
        stretch, force = np.array([0.0, 0.05, 0.1]) * at.length, np.array([0.0, 15.0, 50.0]) * at.force
        found.append(force_table(cables, stretch.tolist(), force.tolist()))
    return found


def ground_of_row(row: Row, at: Units, turn: float, moved: np.ndarray) -> tuple[Any, Any]:
    """The ground and the friction on it."""
    if row["ground"] == "none":
        return None, None
    where: dict[str, Any] = {"incline": 0.2} if row["ground"] == "incline" else {}
    if row["ground"] not in ("plane", "incline"):
        where["surface"] = surface_of(row["ground"], at, turn)
        offset = moved.copy()
        if row["ground"] == "moved":
            offset += at.length * np.array([0.3 * np.cos(turn), 0.3 * np.sin(turn), 0.1])
        if row["ground"] == "moved" or np.any(moved):
            where["offset"] = offset
    if row["contact"] == "exact":
        return ExactGround(**where), ConeFriction(0.5)
    friction = SmoothFriction(0.5, 0.05 * at.speed)
    if row["contact"] == "switch":
        friction = SwitchFriction(0.6, 0.5, 0.05 * at.speed)
    return PenaltyGround(5e3 * at.stiffness, 1.0 / at.speed, **where), friction


def surface_of(kind: str, at: Units, turn: float) -> Any:
    """The surface of a kind of ground that is no plane, turned about the vertical through the origin."""
    L = at.length
    place = lambda *x: turn_about_z(turn) @ x * L  # noqa: E731
    if kind in ("bumps", "moved"):
        found = bumps(0.02 * L, 0.6 * L, 1)
        return eqx.tree_at(lambda waves: waves.direction, found, found.direction + turn)
    if kind == "heights":
        x, y = np.meshgrid(np.linspace(-2, 2, 9), np.linspace(-2, 2, 9), indexing="ij")
        return height_map(0.05 * L * np.sin(1.5 * x + y), (4 * L, 4 * L))
    if kind == "function":
        across = place(1.0, 0.5, 0.0) / L
        return HeightFunction(lambda x, y: 0.03 * L * jnp.sin(2 * (x * across[0] + y * across[1]) / L))
    if kind == "stairs":
        return Stairs(0.1 * L, 0.4 * L, 3, start=0.3 * L, rounding=0.02 * L, turn=turn)
    if kind == "union":
        return Union((Slope(), Box(place(0.5, 0.6, 0.0), np.array([0.3, 0.3, 0.2]) * L, turn, 0.01 * L)))
    return Sphere(place(0.0, 0.0, 2.0), 2.0 * L, hollow=True)


def turnable(row: Row) -> bool:
    """Whether the ground can be turned about the vertical: planes fall towards x, and height maps keep their axes."""
    return row["ground"] not in ("incline", "heights")

"""Structures of NASA's Tensegrity Robotics Toolkit (NTRT): its YAML files as scenes."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import Edges
from jaxgrity.formats.compounds import bracing
from jaxgrity.formats.foreign import Imported, not_negative, positive
from jaxgrity.formats.ntrt_tree import RIGID, Assembly, Pair, Part, table
from jaxgrity.model.friction import ConeFriction
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure, check_edges, edge_lengths

DECIMETRE = 0.1
"""Default unit of length of NTRT's files, m."""
GROUND_FRICTION, GRAVITY = 0.5, 9.81
"""Friction coefficient of the ground, and gravity (m/s^2): the files describe neither."""
SAME_PLACE = 1e-6
"""Largest distance between nodes that count as one, in the file's unit of length."""
CABLES = (
    "tgBasicActuatorInfo",
    "tgBasicContactCableInfo",
    "tgKinematicActuatorInfo",
    "tgKinematicContactCableInfo",
)
DEFAULTS: dict[str, dict[str, float]] = {
    "tgRodInfo": {"radius": 0.5, "density": 1.0},
    "tgBoxInfo": {"width": 1.0, "height": 1.0, "density": 1.0},
    "tgSphereInfo": {"radius": 0.5, "density": 1.0},
    **{kind: {"stiffness": 1000.0, "damping": 10.0, "pretension": 0.0} for kind in CABLES},
}
"""NTRT's own defaults of the parameters that are used, in its units."""
UNUSED = {
    "friction", "roll_friction", "restitution", "history", "max_tension", "target_velocity", "min_actual_length",
    "min_rest_length", "rotation", "moveCablePointAToEdge", "moveCablePointBToEdge", "radius", "motor_friction",
    "motor_inertia", "back_drivable",
}  # fmt: skip
"""Parameters of contact, motors and cables' ends that have no counterpart here."""


class Builder(NamedTuple):
    """How NTRT makes a rod, a string or a sphere of pairs and nodes with certain tags."""

    kind: str
    given: dict[str, float]


class Made(NamedTuple):
    """Pairs of which the same kind of member is made."""

    edges: Edges
    builders: tuple[Builder, ...]


@typed
def read_ntrt(path: str | Path, unit: float = DECIMETRE) -> Imported:
    """A structure file of NTRT (YAML), with all files that it names, as a scene on level ground.

    Rods are rigid and have mass; those that share nodes are one rigid body, as in NTRT, held in shape by struts without
    mass. A string of stiffness K and pretension P has the rest length l - P/K. y is up in the file, z here:
    (x, y, z) becomes (x, -z, y).

    Args:
        path: of the file.
        unit: m, of the file's unit of length; NTRT's examples use decimetres.

    Returns:
        The scene, with gravity, exact contact and Coulomb friction (which the files leave to the program that reads
        them), and what was read how.

    Raises:
        InputError: one line with the file, and what is wrong, missing or not supported.

    Example:
        >>> jaxgrity.formats.read_ntrt("SuperBall.yaml").scene  # doctest: +SKIP
    """
    unit = positive(unit, "unit")
    assembly = Assembly()
    part = assembly.read(Path(path))
    try:
        return _imported(assembly, part, unit)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _imported(assembly: Assembly, part: Part, unit: float) -> Imported:
    builders = {tag: _builder(tag, given) for tag, given in assembly.builders.items()}
    builders = {"rod": Builder("tgRodInfo", DEFAULTS["tgRodInfo"])} | builders
    builders = {"string": Builder("tgBasicActuatorInfo", DEFAULTS["tgBasicActuatorInfo"])} | builders
    notes, place = list(dict.fromkeys(assembly.notes)), _merged(assembly.x)
    rods, strings, unbuilt = _made(part, builders, place)
    if unbuilt:
        notes.append(f"pairs that no builder matches are left out, as NTRT does: {', '.join(sorted(unbuilt))}")
    mass = _sphere_masses(part, builders, place)
    used = sorted({node for made in (rods, strings) for edge in made.edges for node in edge} | set(mass))
    if not used:
        raise InputError("no rod, string or sphere is built; expected some")
    number = {node: k for k, node in enumerate(used)}
    x = assembly.x[used]
    nodes = np.stack([x[:, 0], -x[:, 2], x[:, 1]], axis=1) * unit
    edges, cables = (tuple((number[i], number[j]) for i, j in made.edges) for made in (rods, strings))
    extra = bracing(nodes, edges)
    check_edges(nodes, (*edges, *extra), cables)
    structure = Structure(
        nodes - [0.0, 0.0, nodes[:, 2].min()],
        np.array([mass.get(node, 0.0) for node in used]),
        _struts(nodes, edges, extra, rods.builders, unit),
        _cables(nodes, cables, strings.builders, unit),
    )
    scene = Scene(structure, GRAVITY, None, ExactGround(), ConeFriction(GROUND_FRICTION))
    return Imported(scene, (*_conventions(unit, len(edges), len(extra), len(cables)), *notes))


def _conventions(unit: float, rods: int, extra: int, cables: int) -> list[str]:
    found = [
        f"one unit of length is {unit:g} m, kg and s are as they are; y, which is up in the file, is z here",
        f"{rods} rods are rigid struts with mass, thin, and touch the ground at their ends",
        f"{cables} strings are cables",
        f"gravity ({GRAVITY:g} m/s^2), level ground and friction ({GROUND_FRICTION:g}) are added, which such files "
        "leave to a program; the lowest node stands on the ground",
        "friction, restitution and limits of motors in the file are not used; cables end at the nodes",
    ]
    return [*found, f"{extra} struts without mass keep rods that share nodes in shape"] if extra else found


def _builder(tag: str, given: dict[str, Any]) -> Builder:
    kind = given.get("class")
    if kind not in DEFAULTS:
        raise InputError(f"builders.{tag}.class = {kind!r}: expected one of {', '.join(DEFAULTS)}")
    parameters = table(given.get("parameters"), f"builders.{tag}.parameters")
    found = dict(DEFAULTS[kind])
    for name, value in parameters.items():
        if name in found:
            check = not_negative if name in ("pretension", "damping") else positive
            found[name] = check(value, f"builders.{tag}.parameters.{name}")
        elif name not in UNUSED:
            raise InputError(f"builders.{tag}.parameters has {name!r}; expected one of {', '.join(found)}")
    return Builder(kind, found)


def _matching(tags: str, builders: dict[str, Builder], where: str) -> Builder | None:
    """The one builder all of whose tags are among these."""
    found = [tag for tag in builders if set(tag.split()) <= set(tags.split())]
    if len(found) > 1:
        raise InputError(f"{where}: the builders {', '.join(found)} match the tags {tags!r}; expected one")
    return builders[found[0]] if found else None


def _made(part: Part, builders: dict[str, Builder], place: np.ndarray) -> tuple[Made, Made, set[str]]:
    """Rods, strings, and the tags that no builder matches. Two equal strings side by side are one."""
    rods: dict[tuple[int, int], Builder] = {}
    strings: dict[tuple[int, int], Builder] = {}
    unbuilt = set()
    for pair in (pair for each in part.parts() for pair in each.pairs):
        builder = _matching(pair.tags, builders, "builders")
        if builder is None:
            unbuilt.add(pair.tags)
            continue
        edge = _edge(pair, place)
        made = rods if builder.kind in RIGID else strings
        made[edge] = _doubled(made[edge], builder, pair) if edge in made else builder
    return Made(tuple(rods), tuple(rods.values())), Made(tuple(strings), tuple(strings.values())), unbuilt


def _edge(pair: Pair, place: np.ndarray) -> tuple[int, int]:
    i, j = sorted((int(place[pair.first]), int(place[pair.second])))
    return i, j


def _doubled(first: Builder, second: Builder, pair: Pair) -> Builder:
    """Two equal strings side by side: twice as stiff, and as tight each."""
    if first.kind not in CABLES or first.given["pretension"] * second.given["stiffness"] != (
        second.given["pretension"] * first.given["stiffness"]
    ):
        raise InputError(f"a pair tagged {pair.tags!r} is there twice; expected one member between two nodes")
    return Builder(first.kind, {name: value + second.given[name] for name, value in first.given.items()})


def _merged(x: np.ndarray) -> np.ndarray:
    """(nodes,), for each the first node in its place."""
    rounded = np.round(x / SAME_PLACE)
    _, first, where = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    return first[where.ravel()]


def _sphere_masses(part: Part, builders: dict[str, Builder], place: np.ndarray) -> dict[int, float]:
    """kg: a node whose name is the tag of a sphere's builder is one."""
    found: dict[int, float] = {}
    for name, node in ((name, node) for each in part.parts() for name, node in each.nodes.items()):
        builder = builders.get(name)
        if builder is not None and builder.kind == "tgSphereInfo":
            r, density = builder.given["radius"], builder.given["density"]
            found[int(place[node])] = found.get(int(place[node]), 0.0) + 4 / 3 * math.pi * r**3 * density
    return found


def _struts(
    nodes: np.ndarray, edges: Edges, extra: Edges, builders: tuple[Builder, ...], unit: float
) -> Members | None:
    if not edges:
        return None
    section = [
        math.pi * b.given["radius"] ** 2 if b.kind == "tgRodInfo" else 4 * b.given["width"] * b.given["height"]
        for b in builders
    ]
    density = np.array([b.given["density"] for b in builders])
    mass = density * section * edge_lengths(nodes, edges) / unit
    every = (*edges, *extra)
    return Members(every, None, edge_lengths(nodes, every), mass=np.r_[mass, np.zeros(len(extra))])


def _cables(nodes: np.ndarray, edges: Edges, builders: tuple[Builder, ...], unit: float) -> Members | None:
    if not edges:
        return None
    stiffness, damping, tension = (np.array([b.given[n] for b in builders]) for n in DEFAULTS[CABLES[0]])
    rest = edge_lengths(nodes, edges) - tension * unit / stiffness
    if not np.all(rest > 0):
        k = int(np.argmin(rest))
        raise InputError(
            f"a string of {edge_lengths(nodes, edges)[k]:.4g} m needs a rest length of {rest[k]:.4g} m for its "
            "pretension; expected less pretension or a stiffer string"
        )
    return Members(edges, stiffness, rest, damping=damping if damping.any() else None)

"""Structures of NASA's Tensegrity Robotics Toolkit (NTRT): its YAML files as scenes."""

from collections.abc import Collection, Sized
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.formats.compounds import spanning_points
from jaxgrity.formats.foreign import Imported, Losses, positive
from jaxgrity.formats.ntrt_bodies import Group, Shape, groups_of, moments_of, on_surface, shape_of
from jaxgrity.formats.ntrt_builders import CABLES, NTRT_BUILDERS, RIGID_BUILDERS, WRAPPING, Builder, builder_of
from jaxgrity.formats.ntrt_tree import Assembly, Part
from jaxgrity.model.balls import Balls
from jaxgrity.model.bodies import Body, rigid_body
from jaxgrity.model.friction import ConeFriction
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure, check_edges, edge_lengths

DECIMETRE = 0.1
"""Default unit of length of NTRT's files, m."""
GROUND_FRICTION, GRAVITY = 0.5, 9.81
"""Friction of NTRT's ground, with which Bullet multiplies that of a rod, and gravity (m/s^2): files have neither."""
SAME_PLACE = 1e-6
"""Largest distance between nodes that count as one, in the file's unit of length."""
NTRT_DROPPABLE = {
    "radius": "rods and boxes are lines, to which strings are tied at the nodes",
    "wrapping": "strings that bodies deflect run straight through them",
    "friction": "coefficients of the file",
}
"""What callers may drop although it changes the motion, with a description of each."""


class Cable(NamedTuple):
    """A string: its builder, and the nodes at its ends."""

    builder: Builder
    ends: tuple[int, int]


@dataclass
class Built:
    """What is put together of bodies and strings."""

    x: np.ndarray
    """(nodes, 3), m, z up"""
    mass: dict[int, float] = field(default_factory=dict)
    """kg, of nodes"""
    fixed: list[int] = field(default_factory=list)
    rods: list[Shape] = field(default_factory=list)
    bodies: list[Body] = field(default_factory=list)
    balls: dict[int, tuple[float, float]] = field(default_factory=dict)
    """radius, m, and friction of what touches the ground, by its node"""

    def add(self, points: np.ndarray) -> list[int]:
        """Further nodes, and their numbers."""
        first = len(self.x)
        self.x = np.concatenate([self.x, np.reshape(points, (-1, 3))])
        return list(range(first, len(self.x)))


@typed
def read_ntrt(path: str | Path, unit: float = DECIMETRE, drop: Collection[str] = ()) -> Imported:
    """A structure file of NTRT (YAML), with all files that it names, as a scene on level ground.

    Rods, boxes and spheres are rigid bodies with the masses and inertias that NTRT gives them; those that share nodes
    are one body, and one of density 0 is a support. A string of stiffness K and pretension P is fixed to the surfaces
    of what it joins, as in NTRT, and has the rest length l - P/K. y is up in the file, z here: (x, y, z) becomes
    (x, -z, y). With drop=["radius"] rods are struts, and strings end at the nodes: fewer nodes, and faster.

    Args:
        path: of the file.
        unit: m, of the file's unit of length; NTRT's examples use decimetres.
        drop: kinds of what may be lost, of "radius", "wrapping" and "friction".

    Returns:
        The scene, with gravity, exact contact and Coulomb friction (which the files leave to the program that reads
        them), and what was read how.

    Raises:
        InputError: one line with the file, and what is wrong, missing or not supported.

    Example:
        >>> jaxgrity.formats.read_ntrt("SuperBall.yaml").scene  # doctest: +SKIP
    """
    unit = positive(unit, "unit")
    losses = Losses(drop, NTRT_DROPPABLE, [])
    assembly = Assembly()
    part = assembly.read(Path(path))
    losses.notes += dict.fromkeys(assembly.notes)
    try:
        with losses:
            return _imported(assembly, part, unit, losses)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _imported(assembly: Assembly, part: Part, unit: float, losses: Losses) -> Imported:
    place = _merged(assembly.x)
    x = np.stack([assembly.x[:, 0], -assembly.x[:, 2], assembly.x[:, 1]], axis=1) * unit
    shapes, strings = _built(part, assembly.builders, place, losses)
    groups = groups_of([shape_of(builder, nodes, x, unit) for builder, nodes in shapes], len(x))
    if not groups:
        raise InputError("no rod, box or sphere is built; expected some")
    robot, thin = Built(x), "radius" in losses.drop
    cables = _tied(robot, groups, strings, thin, losses)
    for group in groups:
        _add_body(robot, group, thin)
    ends = {node for cable in cables for node in cable.ends}
    used = sorted({*ends, *robot.mass, *robot.fixed, *(k for body in robot.bodies for k in body.points)} | {
        node for rod in robot.rods for node in rod.nodes
    })  # fmt: skip
    return Imported(_scene(robot, cables, used, unit, losses), (*_conventions(robot, cables, unit), *losses.notes))


def _conventions(robot: Built, cables: list[Cable], unit: float) -> list[str]:
    counts: dict[str, Sized] = {"rods are struts, thin, with mass": robot.rods, "bodies are rigid": robot.bodies}
    thick = any(radius for radius, _ in robot.balls.values())
    contact = "with balls as thick as these" if thick else "as points"
    return [
        f"one unit of length is {unit:g} m, kg and s are as they are; y, which is up in the file, is z here",
        *(f"{len(found)} {what}" for what, found in counts.items() if found),
        f"{len(cables)} strings are cables",
        f"gravity ({GRAVITY:g} m/s^2), level ground and its friction ({GROUND_FRICTION:g}) are added, which such files "
        "leave to a program; the lowest point stands on the ground",
        f"the ends of rods and boxes touch the ground {contact}; bodies do not touch each other",
    ]


def _merged(x: np.ndarray) -> np.ndarray:
    """(nodes,), for each the first node in its place."""
    rounded = np.round(x / SAME_PLACE)
    _, first, where = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    return first[where.ravel()]


def _built(
    part: Part, builders: list[Builder], place: np.ndarray, losses: Losses
) -> tuple[list[tuple[Builder, tuple[int, ...]]], list[Cable]]:
    """Shapes with their nodes, and strings: what NTRT's builders make of nodes and pairs."""
    shapes: list[tuple[Builder, tuple[int, ...]]] = []
    strings: list[Cable] = []
    unbuilt: set[str] = set()
    for each in part.parts():
        for name, node in each.nodes.items():
            builder = builder_of(builders, frozenset(name.split()), each.tags, ("tgSphereInfo",))
            if builder is not None:
                shapes.append((builder, (int(place[node]),)))
        for pair in each.pairs:
            ends = int(place[pair.first]), int(place[pair.second])
            if (builder := builder_of(builders, pair.tags, each.tags, RIGID_BUILDERS)) is not None:
                shapes.append((builder, ends))
            elif (builder := builder_of(builders, pair.tags, each.tags, CABLES)) is not None:
                if ends[0] == ends[1]:
                    raise InputError(f"a string tagged {' '.join(sorted(pair.tags))!r} has no length; expected some")
                strings.append(Cable(builder, ends))
            else:
                unbuilt.add(" ".join(sorted(pair.tags)))
    if unbuilt:
        losses.note(f"pairs that no builder matches are left out, as NTRT does: {', '.join(sorted(unbuilt))}")
    used = {builder.tags for builder in (*(builder for builder, _ in shapes), *(cable.builder for cable in strings))}
    if idle := sorted({_tags(each) for each in builders if each not in NTRT_BUILDERS and each.tags not in used}):
        losses.note(f"builders that match nothing have no effect: {', '.join(idle)}")
    if wrapping := [cable.builder for cable in strings if cable.builder.kind in WRAPPING]:
        which = f"(builders.{_tags(wrapping[0])}.class = {wrapping[0].kind!r})"
        losses.lose("wrapping", f"{len(wrapping)} strings are deflected by bodies {which}")
    return shapes, strings


def _tags(builder: Builder) -> str:
    return " ".join(sorted(builder.tags))


def _tied(robot: Built, groups: list[Group], strings: list[Cable], thin: bool, losses: Losses) -> list[Cable]:
    """The strings, from the surface of one shape to that of another: new nodes, of these shapes' bodies."""
    at: dict[int, list[tuple[Group, Shape]]] = {}
    for group in groups:
        for shape in group.shapes:
            for node in shape.nodes:
                at.setdefault(node, []).append((group, shape))
    found, moved = [], 0
    for builder, pair in strings:
        ends = list(pair)
        for side, flag in enumerate(("moveCablePointAToEdge", "moveCablePointBToEdge")):
            node, other = robot.x[pair[side]], robot.x[pair[1 - side]]
            if pair[side] not in at:
                place = (node.round(6) + 0.0).tolist()
                raise InputError(
                    f"a string ends at {place} m, where nothing is built; expected a rod, a box or a sphere"
                )
            group, shape = min(at[pair[side]], key=lambda each: np.linalg.norm(each[1].centre - node))
            if shape.half[0] > 0 and (builder.given[flag] or builder.kind in WRAPPING):
                moved += 1
                if not thin:
                    ends[side] = robot.add(on_surface(shape, node, other, builder.given["rotation"]))[0]
                    group.nodes.append(ends[side])
        found.append(Cable(builder, (ends[0], ends[1])))
    if thin:
        losses.note(f"dropped: the radius of rods and boxes; {moved} ends of strings are at nodes, not on surfaces")
    return found


def _add_body(robot: Built, group: Group, thin: bool) -> None:
    """A support, a rod, a node with mass, or a rigid body; and where it touches the ground."""
    first, mass = group.shapes[0], group.mass
    single = len(group.shapes) == 1
    if not mass > 0:
        robot.fixed += group.nodes
        return
    for shape in group.shapes:
        for node in shape.nodes:
            radius = 0.0 if thin else float(shape.half[:2].min())
            robot.balls[node] = max(robot.balls.get(node, (0.0, 0.0)), (radius, shape.builder.given["friction"]))
    if len(group.nodes) == 1:
        robot.mass[group.nodes[0]] = mass
    elif single and thin:
        robot.rods.append(first)
    else:
        centre, inertia = moments_of(group)
        if single and len(group.nodes) == 2 and len(first.nodes) == 2:
            axis = first.turn[:, 2]  # all that acts on it acts on its axis, about which it need not turn
            inertia = (np.trace(inertia) - axis @ inertia @ axis) / 2 * (np.eye(3) - np.outer(axis, axis))
        else:
            group.nodes.extend(robot.add(spanning_points(robot.x[group.nodes])))
        robot.bodies.append(rigid_body(robot.x, group.nodes, mass, inertia, centre))


def _scene(robot: Built, cables: list[Cable], used: list[int], unit: float, losses: Losses) -> Scene:
    number = {node: k for k, node in enumerate(used)}
    x = robot.x[used]
    edges = tuple((number[i], number[j]) for i, j in (rod.nodes for rod in robot.rods))
    rods = Members(edges, None, edge_lengths(x, edges), mass=np.array([r.mass for r in robot.rods])) if edges else None
    touching = {number[node]: found for node, found in robot.balls.items()}
    low = [x[node, 2] - radius for node, (radius, _) in touching.items()] + [x[number[k], 2] for k in robot.fixed]
    structure = Structure(
        x - [0.0, 0.0, min(low)],
        np.array([robot.mass.get(node, 0.0) for node in used]),
        rods,
        _cables(x, cables, number, unit),
        fixed=tuple((number[node], "xyz") for node in robot.fixed),
        bodies=tuple(_renumbered(body, number) for body in robot.bodies),
    )
    all_alike = touching.keys() | {node for node, _ in structure.fixed} == set(range(len(used)))
    radii = np.array([radius for radius, _ in touching.values()])
    balls = None if all_alike and not radii.any() else Balls(tuple(touching), radii)
    return Scene(structure, GRAVITY, None, ExactGround(balls=balls), _friction(touching, len(used), losses))


def _renumbered(body: Body, number: dict[int, int]) -> Body:
    points, rods = tuple(number[k] for k in body.points), tuple((number[i], number[j]) for i, j in body.rods)
    pinned = tuple(tuple(number[k] for k in pin) for pin in body.pinned)
    return Body(points, body.matrix, body.weights, body.lengths, rods, pinned)


def _friction(touching: dict[int, tuple[float, float]], nodes: int, losses: Losses) -> ConeFriction:
    """One coefficient where all are equal; else one for each node."""
    each = np.full(nodes, GROUND_FRICTION)
    for node, (_, mu) in touching.items():
        each[node] *= mu
    if "friction" in losses.drop:
        losses.note(f"dropped: coefficients of friction in the file; it is {GROUND_FRICTION:g} everywhere")
        return ConeFriction(GROUND_FRICTION)
    here = each[list(touching)]
    return ConeFriction(float(here[0])) if len(here) and np.all(here == here[0]) else ConeFriction(each)


def _cables(x: np.ndarray, cables: list[Cable], number: dict[int, int], unit: float) -> Members | None:
    if not cables:
        return None
    edges, given = _side_by_side([(tuple(sorted(number[k] for k in ends)), b.given) for b, ends in cables])
    stiffness, damping, tension = (np.array([g[n] for g in given]) for n in ("stiffness", "damping", "pretension"))
    check_edges(x, (), edges)
    rest = edge_lengths(x, edges) - tension * unit / stiffness
    if not np.all(rest > 0):
        k = int(np.argmin(rest))
        raise InputError(
            f"a string of {edge_lengths(x, edges)[k]:.4g} m needs a rest length of {rest[k]:.4g} m for its "
            "pretension; expected less pretension or a stiffer string"
        )
    return Members(edges, stiffness, rest, damping=damping if damping.any() else None)


def _side_by_side(strings: list[tuple[tuple[int, ...], dict[str, float]]]) -> tuple[tuple, list[dict[str, float]]]:
    """Edges and parameters; strings between the same two nodes that are stretched alike are one, as stiff as both."""
    found: dict[tuple[int, ...], dict[str, float]] = {}
    for edge, given in strings:
        if edge in found:
            first = found[edge]
            if first["pretension"] * given["stiffness"] != given["pretension"] * first["stiffness"]:
                raise InputError("two strings between the same two nodes differ in stretch; expected one")
            given = {name: value + first[name] for name, value in given.items()}
        found[edge] = given
    return tuple(found), list(found.values())

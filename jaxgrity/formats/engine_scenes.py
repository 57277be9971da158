"""JSON files of the differentiable engines of Chen and others: rods, sites and cables as scenes."""

from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.formats.compounds import spanning_points
from jaxgrity.formats.engine_cables import EngineCable, Sites, cable_of, sites_of
from jaxgrity.formats.engine_rods import Rod, rod_of
from jaxgrity.formats.engine_tables import ROBOTS, number_in, parsed, parts_in, table_of, taken, vector_of
from jaxgrity.formats.foreign import MOST_NODES, Imported, Losses, positive, some_of
from jaxgrity.model.balls import Balls
from jaxgrity.model.bodies import BESIDE_POINTS, rigid_body
from jaxgrity.model.force_laws import cable_dampers
from jaxgrity.model.friction import ConeFriction
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure, check_edges

GRAVITY = [0.0, 0.0, -9.81]
"""Gravity of a file that names none, in units of length per s^2."""
CONTACT = {"restitution": 0.7, "baumgarte": 0.1, "friction": 0.5, "friction_damping": 0.5, "rolling_friction": 0.0}
"""What the engines take for numbers of contact that a file leaves out."""
SAME_PLACE = 1e-9
"""Largest distance between a site and an end of its rod, as a share of its length, at which they are one node."""
DEEP = 0.02
"""Share of a rod's length up to which a robot that starts inside the ground is raised."""
FAR = 2.0
"""Radii of end caps beyond which a note names a site so far from its rod, which may be left from another start."""
ENGINE_DROPPABLE = {
    "velocity": "velocities at the start: the robot starts at rest",
    "rolling": "what the engine takes of the spin of rods about their axes in each step",
    "radius": "rims of cylinders that touch the ground before end caps do",
    "contact": "a start deep inside the ground, and numbers of contact beyond 0 to 1",
}
"""What callers may drop although it changes the motion, with a description of each."""


@typed
def read_engine(path: str | Path, unit: float = 1.0, drop: Collection[str] = ()) -> Imported:
    """A robot from a JSON file of the differentiable engines of Chen and others, as a scene on level ground.

    A rod with its end caps and motors is one rigid body, with the mass and inertia that these engines give it. Its end
    caps touch the ground as balls. A cable of stiffness K, damping c and rest length L pulls with
    K max(0, l - L) + c l', so its damper acts while it is slack, too. L is `rest_length` less `init_act_length`.

    Args:
        path: of the file.
        unit: m, of the file's unit of length. The files do not name it: a gravity of 9.81 fits metres.
        drop: kinds of what may be lost, of "velocity", "rolling", "radius" and "contact".

    Returns:
        The scene, with gravity, exact contact and Coulomb friction, and what was read how.

    Raises:
        InputError: one line with the file, and what is wrong, missing or not supported.

    Example:
        >>> jaxgrity.formats.read_engine("3_bar_tensegrity.json").scene  # doctest: +SKIP
    """
    unit = positive(unit, "unit")
    losses = Losses(drop, ENGINE_DROPPABLE, [])
    content = parsed(path)
    try:
        with losses:
            return _imported(content, unit, losses)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _imported(content: dict[str, Any], unit: float, losses: Losses) -> Imported:
    key = next(name for name in ROBOTS if name in content)
    robot, contact = table_of(content[key], key), _contact_of(content, losses)
    gravity = vector_of(content.get("gravity", GRAVITY), "gravity")
    if gravity[2] > 0 or np.any(gravity[:2]):
        raise InputError(f"gravity = {gravity.tolist()}: expected it along -z, towards the ground")
    rods = [rod_of(each, f"rods[{k}]", losses) for k, each in enumerate(parts_in(robot, "rods", key))]
    strings = enumerate(parts_in(robot, ROBOTS[key], key))
    cables = [cable_of(each, f"{ROBOTS[key]}[{k}]") for k, each in strings]
    for parts in (rods, cables):
        name, count = Counter(each.name for each in parts).most_common(1)[0]
        if count > 1:
            raise InputError(f"{name!r} is the name of {count} parts, of which engines keep one; expected other names")
    topology = table_of(taken(robot, "system_topology", key), "system_topology")
    sites = sites_of(rods, cables, table_of(taken(topology, "sites", "system_topology"), "system_topology.sites"))
    if sum(4 + len(own) for own in sites) > MOST_NODES:
        raise InputError(f"{len(rods)} rods, {len(cables)} cables; expected at most {MOST_NODES} nodes")
    if all(rod.fixed for rod in rods):
        raise InputError("all rods are fixed; expected one that moves")
    _note_far_sites(rods, sites, losses)
    spins = _spins(rods, sites, contact["rolling_friction"], losses)
    structure, ends = _structure(rods, cables, sites, (unit, _lift(rods, unit, losses), spins))
    radii = np.repeat([rod.radius * unit for rod in rods if not rod.fixed], 2)
    mu = contact["friction"] if contact["friction_damping"] else 0.0
    dampers = [cable.damping for cable in cables]
    assert structure.cables is not None, "a file without cables is refused"
    scene = Scene(
        structure,
        -float(gravity[2]) * unit or None,
        ground=ExactGround(restitution=contact["restitution"] or None, balls=Balls(ends, radii)),
        friction=ConeFriction(mu) if mu else None,
        terms=(cable_dampers(structure.cables, dampers),) if any(dampers) else (),
    )
    return Imported(scene, (*_conventions(scene, unit), *_conditions(cables, contact), *losses.notes))


def _contact_of(content: dict[str, Any], losses: Losses) -> dict[str, float]:
    """The numbers of contact, all there. Loses what no contact has, such as a negative restitution that was fitted."""
    table = table_of(taken(content, "contact_params", "the file"), "contact_params")
    table = CONTACT | table_of(table.get("default", table), "contact_params.default")
    found = {name: number_in(table, name, "contact_params") for name in CONTACT}
    for name in CONTACT:
        most = np.inf if name == "friction" else 1.0
        if not 0 <= found[name] <= most:
            losses.lose("contact", f"contact_params.{name} = {found[name]:g}, which is not from 0 to {most:g}")
            found[name] = float(np.clip(found[name], 0.0, most))
    return found


def _note_far_sites(rods: list[Rod], sites: Sites, losses: Losses) -> None:
    far: dict[str, float] = {}
    for rod, own in zip(rods, sites):
        for name, place in own.items():
            along = float(np.clip((place - rod.ends[0]) @ rod.axis, 0.0, rod.length))
            away = float(np.linalg.norm(place - rod.ends[0] - along * rod.axis))
            if away > FAR * rod.radius:
                far[name] = away / rod.length
    if far:
        losses.note(
            f"{len(far)} sites are up to {max(far.values()):.0%} of a rod's length away from their rods, and "
            f"move with them all the same, as there: {some_of([*far])}"
        )


def _spins(rods: list[Rod], sites: Sites, share: float, losses: Losses) -> bool:
    """Whether rods turn about their axes: not where the engine stops that, and nothing else needs it."""
    if not share:
        return True
    beside = [
        name
        for rod, own in zip(rods, sites)
        for name, place in own.items()
        if np.linalg.norm(np.cross(place - rod.ends[0], rod.axis)) > BESIDE_POINTS * rod.length / 2
    ]
    if share == 1 and not beside:
        losses.note("rods do not turn about their axes (rolling_friction): end caps slide or stick, and do not roll")
        return False
    why = f", and site {beside[0]} is beside its rod's axis" if share == 1 else ""
    what = f"contact_params.rolling_friction = {share:g} takes this share of rods' spin about their axes in each step"
    losses.lose("rolling", f"{what}{why}")
    return True


def _lift(rods: list[Rod], unit: float, losses: Losses) -> float:
    """By how much the robot is raised, in the file's unit of length, so that it starts on the ground."""
    deepest = max((rod for rod in rods if not rod.fixed), key=_depth)
    deep = _depth(deepest)
    if deep <= 0:
        return 0.0
    where = f"{deepest.name} starts {deep * unit:.3g} m inside the ground"
    if deep > DEEP * deepest.length:
        losses.lose("contact", f"{where}, and is pushed out of it")
    else:
        losses.note(f"{where}; here the robot starts on it")
    return deep


def _depth(rod: Rod) -> float:
    return rod.radius - float(rod.ends[:, 2].min())


def _structure(
    rods: list[Rod], cables: list[EngineCable], sites: Sites, how: tuple[float, float, bool]
) -> tuple[Structure, tuple[int, ...]]:
    """The structure, and the nodes of end caps that move. `how`: unit of length, lift, whether rods spin."""
    unit, lift, spins = how
    places: list[np.ndarray] = []
    number: dict[str, int] = {}
    moving, fixed, touching = list[tuple[Rod, list[int]]](), list[int](), list[int]()
    for rod, own in zip(rods, sites):
        points = [len(places), len(places) + 1]
        places += [*rod.ends]
        for name, place in own.items():
            gaps = np.linalg.norm(rod.ends - place, axis=1)
            if gaps.min() <= SAME_PLACE * rod.length:
                number[name] = points[int(gaps.argmin())]
            else:
                number[name] = len(places)
                points.append(len(places))
                places.append(place)
        if rod.fixed:
            fixed += points
            continue
        touching += points[:2]
        if spins:
            more = spanning_points(np.array([places[k] for k in points]))
            points += range(len(places), len(places) + len(more))
            places += [*more]
        moving.append((rod, points))
    x = np.add(places, [0.0, 0.0, lift]) * unit
    bodies = []
    for rod, points in moving:
        axis = np.outer(rod.axis, rod.axis)
        inertia = rod.across * (np.eye(3) - axis) + spins * rod.along * axis
        bodies.append(rigid_body(x, points, rod.mass, inertia * unit**2, x[points[:2]].mean(0)))
    edges = tuple((number[cable.ends[0]], number[cable.ends[1]]) for cable in cables)
    check_edges(x, (), edges)
    members = Members(
        edges,
        np.array([cable.stiffness for cable in cables]),
        np.array([cable.rest_length for cable in cables]) * unit,
    )
    supports = tuple((node, "xyz") for node in fixed)
    return Structure(x, np.zeros(len(x)), None, members, fixed=supports, bodies=tuple(bodies)), tuple(touching)


def _conventions(scene: Scene, unit: float) -> list[str]:
    held, g = len(scene.structure.fixed), scene.gravity or 0.0
    return [
        f"one unit of length is {unit:g} m, kg and s are as they are, z is up, gravity is {g:g} m/s^2",
        f"{len(scene.structure.bodies)} rods are rigid bodies with their end caps, which touch the ground as balls",
        *([f"{held} nodes of fixed rods do not move"] if held else []),
        "the dampers of cables act while they are slack, too, as there",
    ]


def _conditions(cables: list[EngineCable], contact: dict[str, float]) -> list[str]:
    """What the file leaves to a program, and where contact differs."""
    slip, out = contact["friction_damping"], contact["baumgarte"]
    driven = [k for k, cable in enumerate(cables) if cable.driven]
    without = "" if slip else ": so there is no friction"
    motors = (
        f"motors wind {len(driven)} cables by controls, which such files leave to a program: [gait] members = {driven}"
    )
    return [
        f"contact is exact here; there a step takes {slip:.0%} of slip (friction_damping){without}, and {out:.0%} of "
        "the depth in the ground (baumgarte). A network in place of such contact is no part of the file",
        *([motors] if driven else []),
    ]

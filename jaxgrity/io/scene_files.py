"""Scene files: TOML, SI units, radians; every key is checked, and errors name their place."""

import dataclasses
import math
import re
import tomllib
from pathlib import Path

import msgspec
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.io.added import added_masses, with_added_parts, with_own_numbers
from jaxgrity.io.bodies import bodies_tables, build_bodies, build_hinges, build_slides
from jaxgrity.io.files import found_file, read_text, shipped
from jaxgrity.io.grounds import build_ground
from jaxgrity.io.member_sizes import has_sizes, with_sizes_kept
from jaxgrity.io.members import build_members, cable_laws, member_numbers
from jaxgrity.io.scene_tables import (
    FrictionTable,
    GaitTable,
    RandomMembers,
    RandomPhases,
    SceneFile,
)
from jaxgrity.io.structure_tables import CustomTable, StructureTable
from jaxgrity.io.validation import explain, not_finite, shown
from jaxgrity.model.actuation import Gait, Overtone, random_members, random_phases
from jaxgrity.model.balls import Balls
from jaxgrity.model.external import Push, wind
from jaxgrity.model.friction import ConeFriction, Friction, SmoothFriction, SwitchFriction
from jaxgrity.model.ground import Ground
from jaxgrity.model.laws import Law
from jaxgrity.model.load_cases import LoadCase
from jaxgrity.model.rod_contact import with_contact_along_struts
from jaxgrity.model.scene import Scene
from jaxgrity.model.shaking import Shaking
from jaxgrity.model.structure import Structure, per_member
from jaxgrity.model.strut_contact import with_contact_between_struts
from jaxgrity.statics.prestressing import prestressed
from jaxgrity.structures.catalogue import rest_on_face
from jaxgrity.structures.geometry import RobotGeometry

DEEPEST = 50
"""Most parts of a key: far more than the keys of any scene file have."""
DEEP_KEY = re.compile(rf"(?:[\w-]+\.){{{DEEPEST}}}")
"""Pattern of keys with too many parts: the TOML reader would take minutes, and gigabytes, for one."""


def scene_names() -> tuple[str, ...]:
    """The names of the library's scenes."""
    return tuple(shipped("scenes"))


@typed
def scene_text(scene: str | Path) -> str:
    """The text of a scene file: one of the library's by its name, or any by its path.

    Raises `InputError` for an unknown name, or a file that cannot be read.
    """
    return read_text(found_file("scene", "scenes", scene))


@typed
def load_scene(scene: str | Path) -> Scene:
    """Read a scene: one of the library's by its name, or any scene file (TOML, SI units, radians) by its path.

    Args:
        scene: a name, such as "reference", or the path of a file.

    Returns:
        The scene, every number as a NumPy array in float64.

    Raises:
        InputError: one line with the file, the key, the value received and what was expected.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> scene.structure.nodes.shape  # (nodes, 3), m
        (12, 3)
    """
    return parse_scene(scene_text(scene), str(scene))


@typed
def parse_scene(text: str, name: str = "scene") -> Scene:
    """The scene of a scene file's text; `name` stands for the file in errors, as for `load_scene`."""
    if DEEP_KEY.search(text):
        raise InputError(f"{name}: a key has more than {DEEPEST} parts; expected one of a scene file's")
    try:
        tables = tomllib.loads(text)
        where, value = next(not_finite(tables), ("", None))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: not TOML: {error}") from error
    if where:
        raise InputError(f"{name}: {where} = {shown(value)}: expected a finite number")
    try:
        return build_scene(msgspec.convert(tables, SceneFile, strict=True), Path(name).parent)
    except msgspec.ValidationError as error:
        raise InputError(f"{name}: {explain(str(error), tables, SceneFile)}") from error
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def build_scene(file: SceneFile, folder: Path) -> Scene:
    """The scene of a validated scene file; names of other files are relative to the `folder`.

    Raises `InputError` for parts that contradict each other.
    """
    kind = _geometry(file.structure)
    robot = with_added_parts(file.added, file.structure, kind)
    file = msgspec.structs.replace(file, cables=with_own_numbers(file.cables, file.added, len(kind.cables)))
    ground = build_ground(file.ground, folder, robot.balls)
    structure = _structure(file, robot, ground)
    damping = per_member(file.damping.node, len(structure.nodes), "damping.node") if file.damping else None
    scene = Scene(
        structure=structure,
        gravity=file.gravity.g if file.gravity else None,
        node_damping=damping,
        ground=ground,
        friction=_friction(file.friction, len(structure.nodes)),
        gait=_gait(file.gait, structure),
        loads=_loads(file, len(structure.nodes)),
        shaking=Shaking(**msgspec.structs.asdict(file.shaking)) if file.shaking else None,
        terms=(
            *build_slides(file.slides),
            *_forces_from_outside(file, len(structure.nodes)),
            *cable_laws(file.cables, structure.cables),
            *build_hinges(file.hinges, np.asarray(structure.nodes)),
        ),
    )
    if file.ground is not None and (keys := file.ground.along_struts) is not None:
        chosen = None if keys.struts is None else tuple(keys.struts)
        scene = with_contact_along_struts(scene, keys.count, chosen, keys.radius)
        if np.any(keys.radius):
            scene = _on_its_struts(scene, file.structure, file.ground.incline)
    tables = (file.touching, None if file.struts is None else file.struts.touching)
    if None not in tables:
        raise InputError("touching: struts.touching is given too; expected one of them")
    if (touching := tables[0] or tables[1]) is None:
        return scene
    pairs = None if touching.pairs is None else tuple(touching.pairs)
    return with_contact_between_struts(scene, touching.radius, pairs, touching.at_once)


def _structure(file: SceneFile, robot: RobotGeometry, ground: Ground | None) -> Structure:
    table, nodes, own = file.structure, robot.nodes, bodies_tables(robot.bodies, robot.nodes)
    # the basic points follow from joints and supports, as those of the file's own bodies
    bodies = [*(msgspec.structs.replace(body, basic=[]) for body in own), *file.bodies]
    # on ground with obstacles the plane is one of its parts, and the ground's own incline is 0
    posed = _posed(robot, table, ground, file.ground.incline if file.ground else 0.0)
    over = file.cables is not None and file.cables.pulleys  # axes are those of the robot in its pose
    parts = {
        "struts": build_members(file.struts, robot.struts, nodes, "struts"),
        "cables": build_members(file.cables, robot.cables, posed if over else nodes, "cables"),
    }
    massive = bool(bodies) or any(m is not None and m.mass is not None for m in parts.values())
    fixed = tuple((each, "xyz") if isinstance(each, int) else (each.node, each.axes) for each in table.fixed)
    extra = added_masses(file.added, len(nodes), parts["cables"], [node for node, _ in fixed])
    mass = np.append(_node_mass(table, len(nodes) - len(extra), massive), extra)
    made = build_bodies(bodies, nodes, fixed)
    found = Structure(posed, mass, parts["struts"], parts["cables"], fixed=fixed, bodies=made)
    if table.prestress is None:
        return found
    for kind, members in (("struts", file.struts), ("cables", file.cables)):
        if members is not None and (members.prestrain is not None or members.rest_length is not None):
            given = f"structure.prestress = {table.prestress:g} decides all rest lengths"
            raise InputError(f"{given}; expected neither {kind}.prestrain nor {kind}.rest_length")
    found = prestressed(found, table.prestress)
    kept = [
        with_sizes_kept(members, posed) if members is not None and has_sizes(table) else members
        for members, table in ((found.struts, file.struts), (found.cables, file.cables))
    ]
    return dataclasses.replace(found, struts=kept[0], cables=kept[1])


def _geometry(table: StructureTable) -> RobotGeometry:
    if isinstance(table, CustomTable):
        return RobotGeometry(*table.geometry())
    try:
        return RobotGeometry(*table.geometry())
    except InputError as error:
        raise InputError(f"structure.{error}") from error  # it begins with the key


def _node_mass(table: StructureTable, count: int, massive: bool) -> np.ndarray:
    if table.mass is None and table.node_mass is None:
        if massive:
            return np.zeros(count)
        raise InputError("structure.mass: missing; expected mass (of all nodes) or node_mass (a list, one for each)")
    if table.mass is not None and table.node_mass is not None:
        raise InputError(f"structure.mass = {table.mass}: node_mass is given too; expected one of them")
    if table.node_mass is not None and len(table.node_mass) != count:
        raise InputError(f"structure.node_mass has {len(table.node_mass)} numbers; expected {count}, one for each node")
    return np.full(count, table.mass / count) if table.mass is not None else np.array(table.node_mass, float)


def _posed(robot: RobotGeometry, table: StructureTable, ground: Ground | None, incline: float) -> np.ndarray:
    nodes = rest_on_face(robot.nodes) if table.pose == "face" else robot.nodes
    if table.aligned and ground is not None:
        cosine, sine = math.cos(incline), math.sin(incline)
        nodes = nodes @ np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
    return _at_height(nodes, table.height, ground, robot.balls if ground is None else ground.balls, incline)


def _at_height(
    nodes: np.ndarray, height: float | None, ground: Ground | None, balls: Balls | None, incline: float
) -> np.ndarray:
    """Nodes (m) moved up or down until the lowest of them, or of their balls, has that height (m) above the ground."""
    if height is None:
        return nodes
    if balls is not None:
        balls.check(len(nodes))
    above = nodes[:, 2] if ground is None else nodes[:, 2] - ground.height(nodes[:, 0], nodes[:, 1])
    lowest = above.min() if balls is None else balls.gaps(above * math.cos(incline)).min() / math.cos(incline)
    return nodes + np.array([0.0, 0.0, height - lowest])


def _on_its_struts(scene: Scene, table: StructureTable, incline: float) -> Scene:
    """The scene at its height with the balls that struts with a radius have at their ends."""
    ground, nodes = scene.ground, np.asarray(scene.structure.nodes)
    nodes = _at_height(nodes, table.height, ground, None if ground is None else ground.balls, incline)
    return dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, nodes=nodes))


def _forces_from_outside(file: SceneFile, nodes: int) -> tuple[Law, ...]:
    """The wind and the pushes."""
    found: list[Law] = []
    if file.wind is not None:
        found.append(wind(file.wind.velocity, per_member(file.wind.drag, nodes, "wind.drag"), nodes))
    for k, table in enumerate(file.pushes):
        rows = member_numbers(table.nodes, nodes, f"pushes[{k}].nodes")
        found.append(Push(rows, np.tile(table.force, (len(rows), 1)), table.start, table.duration, table.ramp))
    return tuple(found)


def _loads(file: SceneFile, nodes: int) -> tuple[LoadCase, ...]:
    """The load cases, in the order of their names' first tables."""
    rows: dict[str, list[tuple[int, tuple[float, float, float]]]] = {}
    for k, table in enumerate(file.loads):
        chosen = member_numbers(table.nodes, nodes, f"loads[{k}].nodes")
        rows.setdefault(table.name, []).extend((node, table.force) for node in chosen)
    return tuple(
        LoadCase(name, tuple(node for node, _ in each), np.array([force for _, force in each]))
        for name, each in rows.items()
    )


def _friction(table: FrictionTable | None, nodes: int) -> Friction | None:
    if table is None:
        return None
    switch = ["mu_static", "mu_kinetic", "slip_speed"]
    names = {"smooth": ["mu", "slip_speed"], "switch": switch, "cone": ["mu"]}[table.kind]
    given = [n for n in ("mu", "mu_static", "mu_kinetic", "slip_speed") if getattr(table, n) is not None]
    if given != names:
        raise InputError(
            f"friction.kind = {table.kind!r} comes with {', '.join(given) or 'no keys'}; expected {', '.join(names)}"
        )
    kinds: dict[str, type[Friction]] = {"smooth": SmoothFriction, "switch": SwitchFriction, "cone": ConeFriction}
    values = {name: getattr(table, name) for name in names}
    lists = {name: per_member(x, nodes, f"friction.{name}") for name, x in values.items() if isinstance(x, list)}
    return kinds[table.kind](**values | lists)


def _gait(table: GaitTable | None, structure: Structure) -> Gait | None:
    if table is None:
        return None
    members = _actuated(table.members, structure)
    count = len(members)
    if isinstance(table.phase, RandomPhases):
        phase = random_phases(1, count, table.phase.seed)[0]
    elif len(table.phase) == count:
        phase = np.array(table.phase, float)
    else:
        raise InputError(f"gait.phase has {len(table.phase)} numbers; expected {count}, one for each actuated member")
    return Gait(
        members=members,
        phase=phase,
        amplitude=per_member(table.amplitude, count, "gait.amplitude"),
        frequency=per_member(table.frequency, count, "gait.frequency"),
        start=table.start,
        ramp=table.ramp,
        overtones=tuple(Overtone(np.array(each.size, float), np.array(each.phase, float)) for each in table.overtones),
    )


def _actuated(chosen: str | list[int] | RandomMembers, structure: Structure) -> tuple[int, ...]:
    if isinstance(chosen, list):
        if len(set(chosen)) != len(chosen) or not chosen:
            raise InputError(f"gait.members = {shown(chosen)}: expected at least one member, and none twice")
        return tuple(chosen)
    struts, cables = (len(m.edges) if m else 0 for m in (structure.struts, structure.cables))
    kind = chosen if isinstance(chosen, str) else chosen.of
    members = range(struts) if kind == "struts" else range(struts, struts + cables)
    if not members:
        raise InputError(f"gait.members: {kind!r} is chosen, but none are modelled; expected a [{kind}] table")
    return tuple(members) if isinstance(chosen, str) else random_members(members, chosen.random, chosen.seed)

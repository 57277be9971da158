"""Scenes as scene files: `load_scene` reads the same scene, to the last bit."""

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import msgspec
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.io.bodies import bodies_tables, hinges_tables, slides_tables
from jaxgrity.io.files import write_whole
from jaxgrity.io.ground_tables import (
    BowlTable,
    BoxTable,
    CylinderTable,
    SphereTable,
    SplineTable,
    StairsTable,
    SurfaceTable,
    WavesTable,
)
from jaxgrity.io.members import force_keys, members_table, one_or_all, touching_keys
from jaxgrity.io.scene_tables import (
    AlongStrutsKeys,
    BallsKeys,
    CablesTable,
    DampingTable,
    FrictionTable,
    GaitTable,
    GravityTable,
    GroundTable,
    LoadTable,
    OvertoneTable,
    PushTable,
    SceneFile,
    ShakingTable,
    StrutsTable,
    WindTable,
)
from jaxgrity.io.structure_tables import CustomTable, FixedAxes
from jaxgrity.io.validation import not_finite
from jaxgrity.model.actuation import Gait
from jaxgrity.model.external import Push, Wind
from jaxgrity.model.force_laws import CableDampers, DeadBand, ForceLimit, ForceTable
from jaxgrity.model.friction import ConeFriction, Friction, SmoothFriction, SwitchFriction
from jaxgrity.model.ground import ExactGround, Ground, PenaltyGround
from jaxgrity.model.height_fields import HeightMap, HeightWaves
from jaxgrity.model.hinges import HingeDampers, HingeSprings
from jaxgrity.model.pulls import CommandedPull
from jaxgrity.model.rod_contact import ALONG_STRUTS, laws_along, radii_along_struts
from jaxgrity.model.scene import Scene
from jaxgrity.model.shaking import Shaking, SupportMotion
from jaxgrity.model.slides import Slides
from jaxgrity.model.solids import Box, Cylinder, Sphere, Stairs
from jaxgrity.model.stiffening import PolynomialStiffness
from jaxgrity.model.structure import Structure
from jaxgrity.model.strut_contact import BETWEEN_STRUTS
from jaxgrity.model.surface import Slope, Surface
from jaxgrity.model.unions import Union

WIDTH = 120
"""Most characters in a line of lists. A longer list of lists takes one line for each."""
OBSTACLES = {Box: BoxTable, Sphere: SphereTable, Cylinder: CylinderTable}
ORDER_OF_TERMS: dict[type, int] = {Slides: 0, Wind: 1, Push: 2, ForceTable: 3, ForceLimit: 3, DeadBand: 4}
ORDER_OF_TERMS |= {CableDampers: 5, CommandedPull: 6, PolynomialStiffness: 7, HingeSprings: 8, HingeDampers: 9}
ORDER_OF_TERMS |= dict.fromkeys(ALONG_STRUTS, 10) | dict.fromkeys(BETWEEN_STRUTS, 11)
"""Order in which `load_scene` adds terms; of each of the first ten kinds but pushes it adds one at most."""
FRICTIONS = {SmoothFriction: "smooth", SwitchFriction: "switch", ConeFriction: "cone"}


@typed
def save_scene(scene: Scene, path: str | Path) -> None:
    """Write a scene as a scene file (TOML), which `load_scene` reads as the same scene, to the last bit.

    Rigid bodies are the same to rounding.

    Structures of every kind are written with all nodes and members, and random ground with its waves. So the file needs
    no other, and does not depend on a formula of the library.

    Args:
        scene: the scene to write.
        path: the file, written whole or not at all.

    Raises:
        InputError: the scene has a part without a key in scene files, such as a user's own law; the path is a folder.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> jaxgrity.save_scene(scene, "my_robot.toml")
        >>> again = jaxgrity.load_scene("my_robot.toml")
        >>> bool((again.structure.nodes == scene.structure.nodes).all())
        True
    """
    text = scene_toml(scene)
    write_whole(path, lambda file: file.write(text.encode()))


def scene_toml(scene: Scene) -> str:
    """The text of the scene file that `save_scene` writes. Raises as it does."""
    tables = msgspec.to_builtins(scene_file(scene))
    return "\n".join(_lines({name: table for name, table in tables.items() if table not in (None, [])})) + "\n"


def scene_file(scene: Scene) -> SceneFile:
    """The tables of the scene file. Raises as `save_scene` does."""
    if scene.up is not None:
        raise InputError("scene.up leans: expected a scene whose ground says how it is inclined (ground.incline)")
    structure, (wind, pushes, forces) = scene.structure, _laws(scene)
    file = SceneFile(
        structure=_structure(structure),
        struts=members_table(structure.struts, StrutsTable, "struts", {}),
        cables=members_table(structure.cables, CablesTable, "cables", forces),
        gravity=None if scene.gravity is None else GravityTable(float(scene.gravity)),
        damping=None if scene.node_damping is None else DampingTable(one_or_all(scene.node_damping)),
        ground=_ground(scene.ground, _along_struts(scene)),
        friction=_friction(scene.friction),
        wind=wind,
        pushes=pushes,
        shaking=_shaking(scene.shaking),
        touching=touching_keys(scene),
        bodies=bodies_tables(structure.bodies, structure.nodes),
        slides=slides_tables(scene),
        hinges=hinges_tables(scene),
        gait=_gait(scene.gait),
        loads=[
            LoadTable(case.name, [node], tuple(row))
            for case in scene.loads
            for node, row in zip(case.nodes, np.asarray(case.force, float).tolist())
        ],
    )
    tables = msgspec.to_builtins(file)
    for where, value in not_finite(tables):
        raise InputError(f"{where} = {value}: expected a finite number, as scene files have")
    try:
        return msgspec.convert(tables, SceneFile)
    except msgspec.ValidationError as error:
        raise InputError(f"the scene does not fit into a scene file: {error}") from error


def _structure(structure: Structure) -> CustomTable:
    struts, cables = ([] if m is None else list(m.edges) for m in (structure.struts, structure.cables))
    return CustomTable(
        nodes=[tuple(row) for row in np.asarray(structure.nodes, float).tolist()],
        node_mass=np.asarray(structure.node_mass, float).tolist(),
        fixed=[node if axes == "xyz" else FixedAxes(node, axes) for node, axes in structure.fixed],
        struts=struts,
        cables=cables,
    )


def _along_struts(scene: Scene) -> AlongStrutsKeys | None:
    if not (radii := radii_along_struts(scene)):
        return None
    each, laws = np.array([*radii.values()]), tuple(law for law in scene.terms if isinstance(law, ALONG_STRUTS))
    count = len(laws[0].points.struts) // len(radii) if laws else scene.ground.capsules.parts  # type: ignore[union-attr]
    if laws and not eqx.tree_equal(laws_along(scene, count, tuple(radii), each), laws):
        raise InputError("contact along struts: expected evenly spaced points, as many on each strut, as files have")
    return AlongStrutsKeys(count, list(radii), one_or_all(each))


def _ground(ground: Ground | None, along_struts: AlongStrutsKeys | None) -> GroundTable | None:
    if ground is None:
        return None
    if ground.offset is not None:
        raise InputError("ground.offset: the surface has been moved; expected one that has not, as scene files do")
    balls = None
    if ground.balls is not None:
        balls = BallsKeys(list(ground.balls.nodes), one_or_all(ground.balls.radius))
    given = {"incline": ground.incline, "balls": balls, "along_struts": along_struts, **_where(ground.surface)}
    if type(ground) is ExactGround:
        e = None if ground.restitution is None else _scalar("ground.restitution", ground.restitution)
        return GroundTable(contact="complementarity", restitution=e, **given)
    if type(ground) is PenaltyGround:
        alpha = None if ground.dissipation is None else _scalar("ground.dissipation", ground.dissipation)
        return GroundTable(
            contact="penalty", stiffness=_scalar("ground.stiffness", ground.stiffness), dissipation=alpha, **given
        )
    raise _no_key("ground", ground)


def _where(surface: Surface | None) -> dict[str, Any]:
    """The keys of the ground's place."""
    if surface is None:
        return {}
    if type(surface) is not Union:
        return {"surface": _surface(surface)}
    first, *others = surface.parts
    obstacles = [OBSTACLES[type(part)](**_numbers(part)) for part in others if type(part) in OBSTACLES]
    if len(obstacles) < len(others):
        raise _no_key("ground.surface", surface)
    base = {"incline": first.incline} if isinstance(first, Slope) else {"surface": _surface(first)}
    return {**base, "obstacles": obstacles}


def _surface(surface: Surface) -> SurfaceTable:
    if type(surface) is Stairs:
        return StairsTable(**_numbers(surface), steps=surface.steps)
    if type(surface) is Sphere and surface.hollow and list(surface.centre) == [0.0, 0.0, float(surface.radius)]:
        return BowlTable(float(surface.radius))
    for kind, table in ((HeightWaves, WavesTable), (HeightMap, SplineTable), *OBSTACLES.items()):
        if type(surface) is kind:
            return table(**_numbers(surface))
    raise _no_key("ground.surface", surface)


def _numbers(part: Any) -> dict[str, Any]:
    """The array fields of a part, as plain numbers and lists."""
    if getattr(part, "hollow", False):
        raise _no_key("ground.obstacles", part)
    values = ((field.name, getattr(part, field.name)) for field in dataclasses.fields(part))
    return {name: np.asarray(x).tolist() for name, x in values if isinstance(x, np.ndarray | jax.Array)}


def _friction(friction: Friction | None) -> FrictionTable | None:
    if friction is None:
        return None
    if type(friction) not in FRICTIONS:
        raise _no_key("friction", friction)
    given = {name: one_or_all(value) for name, value in vars(friction).items()}
    return FrictionTable(kind=FRICTIONS[type(friction)], **given)  # type: ignore[arg-type]


def _scalar(name: str, value: Any) -> float:
    if np.ndim(value):
        raise InputError(f"{name} has a number for each node; expected one for all, as scene files do")
    return float(value)


def _gait(gait: Gait | None) -> GaitTable | None:
    if gait is None:
        return None
    return GaitTable(
        members=list(gait.members),
        phase=np.asarray(gait.phase, float).tolist(),
        amplitude=one_or_all(gait.amplitude),
        frequency=one_or_all(gait.frequency),
        start=float(gait.start),
        ramp=float(gait.ramp),
        overtones=[OvertoneTable(np.asarray(o.size).tolist(), np.asarray(o.phase).tolist()) for o in gait.overtones],
    )


def _shaking(motion: SupportMotion | None) -> ShakingTable | None:
    if motion is None:
        return None
    if type(motion) is not Shaking:
        raise _no_key("shaking", motion)
    return ShakingTable(**{name: np.asarray(value).tolist() for name, value in vars(motion).items()})


def _laws(scene: Scene) -> tuple[WindTable | None, list[PushTable], dict[str, Any]]:
    """The wind, the pushes, and keys of the cables; in that order, as files are read."""
    wind, pushes = None, []
    forces: dict[str, Any] = {}
    places = [ORDER_OF_TERMS[type(term)] for term in scene.terms if type(term) in ORDER_OF_TERMS]
    if places != sorted(places) or any(places.count(place) > 1 for place in (0, 1, 3, 4, 5, 6, 7, 8, 9)):
        told = "slides, a wind, pushes, a table or largest force of cables, dead bands, dampers, pulls, polynomials"
        told += ", hinges, contact"
        raise InputError(f"terms are {', '.join(term.name for term in scene.terms)}; expected in this order {told}")
    for number, term in enumerate(scene.terms):
        if type(term) is Wind:
            wind = WindTable(tuple(np.asarray(term.velocity).tolist()), one_or_all(term.drag))
        elif type(term) is Push and np.ptp(term.force, axis=0).max() == 0:
            times = (float(value) for value in (term.start, term.duration, term.ramp))
            pushes.append(PushTable(list(term.nodes), tuple(np.asarray(term.force)[0].tolist()), *times))
        elif keys := force_keys(term):
            forces |= keys
        elif type(term) is Push or type(term) not in ORDER_OF_TERMS:
            raise _no_key(f"terms[{number}]", term)
    return wind, pushes, forces


def _no_key(where: str, part: Any) -> InputError:
    return InputError(f"{where} is a {type(part).__name__}; expected a part for which scene files have a key")


def _lines(tables: dict[str, Any]) -> Iterator[str]:
    for name, table in tables.items():
        for part in table if isinstance(table, list) else [table]:
            yield f"[[{name}]]" if isinstance(table, list) else f"[{name}]"
            yield from (f"{key} = {_value(value)}" for key, value in part.items() if value not in (None, []))
            yield ""


def _value(value: Any) -> str:
    """A value in TOML, with numbers, strings, true and false as in JSON."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_value(item)}' for key, item in value.items() if item is not None)} }}"
    if not isinstance(value, (list, tuple)):
        return json.dumps(value, ensure_ascii=False)
    items = [_value(item) for item in value]
    flat = f"[{', '.join(items)}]"
    nested = any(isinstance(item, (list, tuple, dict)) for item in value)
    return flat if len(flat) < WIDTH or not nested else "[\n" + "".join(f"    {item},\n" for item in items) + "]"

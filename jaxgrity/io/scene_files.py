"""Scene files: TOML, SI units, radians; every key checked, and errors that say where they are."""

import math
import tomllib
from importlib import resources
from pathlib import Path

import msgspec
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import Edges
from jaxgrity.io.files import read_text
from jaxgrity.io.scene_tables import (
    CablesTable,
    FrictionTable,
    GaitTable,
    GroundTable,
    RandomMembers,
    RandomPhases,
    SceneFile,
    StructureTable,
    StrutsTable,
)
from jaxgrity.io.validation import explain, not_finite, shown
from jaxgrity.model.actuation import Gait, random_members, random_phases
from jaxgrity.model.catalogue import rest_on_face
from jaxgrity.model.friction import ConeFriction, Friction, SmoothFriction, SwitchFriction
from jaxgrity.model.ground import ExactGround, Ground, PenaltyGround
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure, edge_lengths, per_member

SHIPPED = resources.files("jaxgrity") / "data" / "scenes"


def scene_names() -> tuple[str, ...]:
    """The scenes that come with the library."""
    names = (entry.name for entry in SHIPPED.iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))


def scene_text(scene: str | Path) -> str:
    """What is written in a scene file: one of the library's by its name, or any by its path.

    Raises `InputError` where there is none, or it cannot be read.
    """
    if str(scene) in scene_names():
        return (SHIPPED / f"{scene}.toml").read_text(encoding="utf-8")
    if not Path(scene).exists():
        raise InputError(f"scene {str(scene)!r}: unknown; expected a file, or one of {', '.join(scene_names())}")
    return read_text(scene)


def load_scene(scene: str | Path) -> Scene:
    """Read a scene: one of the library's by its name, or any scene file (TOML, SI units, radians) by its path.

    Args:
        scene: such as "reference", or the path of a file.

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


def parse_scene(text: str, name: str = "scene") -> Scene:
    """The scene that a scene file's text describes; `name` stands for the file in errors, as for `load_scene`."""
    try:
        tables = tomllib.loads(text)
        where, value = next(not_finite(tables), ("", None))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: not TOML: {error}") from error
    if where:
        raise InputError(f"{name}: {where} = {shown(value)}: expected a finite number")
    try:
        return build_scene(msgspec.convert(tables, SceneFile, strict=True))
    except msgspec.ValidationError as error:
        raise InputError(f"{name}: {explain(str(error), tables, SceneFile)}") from error
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def build_scene(file: SceneFile) -> Scene:
    """The scene of a validated scene file. Raises `InputError` where its parts do not fit each other."""
    structure = _structure(file)
    damping = per_member(file.damping.node, len(structure.nodes), "damping.node") if file.damping else None
    return Scene(
        structure=structure,
        gravity=file.gravity.g if file.gravity else None,
        node_damping=damping,
        ground=_ground(file.ground),
        friction=_friction(file.friction),
        gait=_gait(file.gait, structure),
    )


def _structure(file: SceneFile) -> Structure:
    table = file.structure
    nodes, struts, cables = table.geometry()
    parts = {
        "struts": _members(file.struts, struts, nodes, "struts"),
        "cables": _members(file.cables, cables, nodes, "cables"),
    }
    return Structure(nodes=_posed(nodes, table, file.ground), node_mass=_node_mass(table, len(nodes)), **parts)


def _node_mass(table: StructureTable, count: int) -> np.ndarray:
    if table.mass is None and table.node_mass is None:
        raise InputError("structure.mass: missing; expected mass (of all nodes) or node_mass (a list, one for each)")
    if table.mass is not None and table.node_mass is not None:
        raise InputError(f"structure.mass = {table.mass}: node_mass is given too; expected one of them")
    if table.node_mass is not None and len(table.node_mass) != count:
        raise InputError(f"structure.node_mass has {len(table.node_mass)} numbers; expected {count}, one for each node")
    return np.full(count, table.mass / count) if table.mass is not None else np.array(table.node_mass, float)


def _posed(nodes: np.ndarray, table: StructureTable, ground: GroundTable | None) -> np.ndarray:
    if table.pose == "face":
        nodes = rest_on_face(nodes)
    if table.aligned and ground is not None:
        cosine, sine = math.cos(ground.incline), math.sin(ground.incline)
        nodes = nodes @ np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
    if table.height is None:
        return nodes
    slope = math.tan(ground.incline) if ground else 0.0
    above = nodes[:, 2] + slope * nodes[:, 0]
    return nodes + np.array([0.0, 0.0, table.height - above.min()])


def _members(table: StrutsTable | CablesTable | None, edges: Edges, nodes: np.ndarray, kind: str) -> Members | None:
    if not edges:
        if table is not None:
            raise InputError(f"{kind}: the structure has none; expected no [{kind}] table")
        return None
    if table is None:
        return None
    rigid = isinstance(table, StrutsTable) and table.rigid
    if rigid and (table.stiffness is not None or np.any(_or_zero(table.damping))):
        raise InputError("struts.rigid = true: a rigid strut has no spring; expected neither stiffness nor damping")
    if table.stiffness is None and not rigid:
        raise InputError("struts.stiffness: missing; expected a stiffness (N/m) or rigid = true")
    if table.prestrain is not None and table.rest_length is not None:
        given = f"{kind}.prestrain = {shown(table.prestrain)}"
        raise InputError(f"{given}: rest_length is given too; expected one of them")
    count = len(edges)
    if table.rest_length is not None:
        rest = per_member(table.rest_length, count, f"{kind}.rest_length")
    else:
        prestrain = per_member(_or_zero(table.prestrain), count, f"{kind}.prestrain")
        rest = (1 - prestrain) * edge_lengths(nodes, edges)
    damping = per_member(_or_zero(table.damping), count, f"{kind}.damping")
    stiffness = None if table.stiffness is None else per_member(table.stiffness, count, f"{kind}.stiffness")
    broken = _numbers(table.broken, count, "cables.broken") if isinstance(table, CablesTable) else ()
    if stiffness is not None and broken:
        damping[list(broken)] = stiffness[list(broken)] = 0.0
    return Members(
        edges=edges,
        stiffness=stiffness,
        rest_length=rest,
        damping=damping if damping.any() else None,
        stuck=_numbers(table.stuck, count, f"{kind}.stuck"),
    )


def _numbers(chosen: list[int], count: int, where: str) -> tuple[int, ...]:
    """Which of `count` members, in ascending order."""
    if len(set(chosen)) != len(chosen) or any(k >= count for k in chosen):
        raise InputError(f"{where} = {shown(chosen)}: expected numbers from 0 to {count - 1}, none twice")
    return tuple(sorted(chosen))


def _or_zero(value: float | list[float] | None) -> float | list[float]:
    return 0.0 if value is None else value


def _ground(table: GroundTable | None) -> Ground | None:
    if table is None:
        return None
    if table.contact == "complementarity":
        if table.stiffness is not None or table.dissipation is not None:
            raise InputError(
                "ground.contact = 'complementarity' is no spring; expected neither stiffness nor dissipation"
            )
        return ExactGround(table.incline, table.restitution)
    if table.stiffness is None:
        raise InputError("ground.stiffness: missing; expected a stiffness (N/m) for penalty contact")
    if table.restitution is not None:
        given = f"ground.restitution = {table.restitution}"
        raise InputError(f"{given} goes with contact = 'complementarity'; expected dissipation instead")
    return PenaltyGround(table.stiffness, table.dissipation or None, table.incline)


def _friction(table: FrictionTable | None) -> Friction | None:
    if table is None:
        return None
    names = {
        "smooth": ["mu", "slip_speed"],
        "switch": ["mu_static", "mu_kinetic", "slip_speed"],
        "cone": ["mu"],
    }[table.kind]
    given = [n for n in ("mu", "mu_static", "mu_kinetic", "slip_speed") if getattr(table, n) is not None]
    if given != names:
        raise InputError(
            f"friction.kind = {table.kind!r} comes with {', '.join(given) or 'no keys'}; expected {', '.join(names)}"
        )
    kinds: dict[str, type[Friction]] = {"smooth": SmoothFriction, "switch": SwitchFriction, "cone": ConeFriction}
    return kinds[table.kind](*(getattr(table, name) for name in names))


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

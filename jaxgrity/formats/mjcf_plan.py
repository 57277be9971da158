"""What of a scene becomes rigid bodies, point masses and tendons in MuJoCo, and how its actuators are moved."""

from typing import Any, NamedTuple

import jax
import numpy as np

from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import Times
from jaxgrity.formats.compounds import bodies, is_rigid
from jaxgrity.model.actuation import Gait, rest_length
from jaxgrity.model.bodies import Bodies
from jaxgrity.model.clusters import cables_of
from jaxgrity.model.contact_twin import penalty_twin
from jaxgrity.model.friction import friction_at_nodes
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import check_no_slides
from jaxgrity.model.structure import Members, Structure

RADIUS = 1e-3
"""Radius of the spheres at nodes, m for a body of one metre."""


class Plan(NamedTuple):
    """Which struts are parts of rigid bodies, and what is left for nodes and tendons."""

    structure: Structure
    """struts that are no part of a body are springs"""
    rigid: frozenset[int]
    """struts"""
    bodies: tuple[np.ndarray, ...]
    """nodes of the bodies that struts form"""
    node_mass: np.ndarray
    """kg, without the rods of bodies"""
    actuated: tuple[int, ...]
    """members that a gait moves; of a cluster the first one"""
    balls: dict[int, float]
    """radius, m, of each node that can touch the ground"""
    radius: float
    """m, of spheres at nodes without a ball"""
    larger: float
    """m, by which balls are larger, and the ground lies lower: 0 where each has a radius of its own"""
    friction: dict[int, float]
    """coefficient of each node, where they differ; else nothing, and the ground has the one of all"""


@typed
def mjcf_controls(scene: Scene, times: Times, gait: Gait | None = None) -> np.ndarray:
    """(times, actuators): the changes of rest length, m, that the scene's gait, or another, asks of its MuJoCo model.

    `times` (s) are those of the steps' starts. Rows are for `data.ctrl`; further actuators of the model, which damp
    nodes, need none.
    """
    structure, moved = scene.structure, scene.gait if gait is None else gait
    if moved is None:
        return np.zeros((len(times), 0))
    own = amplitudes(scene.gait)
    beyond = {k for k, size in amplitudes(moved).items() if size > (1 + 1e-6) * own.get(k, 0.0)}
    if gait is not None and beyond:
        raise InputError(
            f"gait: members {sorted(beyond)} move beyond what the scene's own gait, and so its model, allows"
        )
    columns: dict[int, np.ndarray] = {}
    for _, members, first in structure.numbered:
        lengths = np.asarray(jax.vmap(lambda t, m=members, k=first: rest_length(m, moved, t, k))(np.asarray(times)))
        change = np.broadcast_to(lengths, (len(times), len(members.edges))) - np.asarray(members.rest_length)
        cords = cables_of(members.clusters, len(members.edges))
        columns |= {first + min(cord): change[:, list(cord)].sum(1) for cord in cords}
    return np.stack([columns[k] for k in actuated_members(structure, moved)], axis=1)


def actuated_members(structure: Structure, gait: Gait | None) -> tuple[int, ...]:
    """Members that a gait moves, but for those that are stuck, in ascending order; the first one of a cluster."""
    found: set[int] = set()
    chosen = () if gait is None else gait.members
    for _, members, first in structure.numbered:
        moved = {k - first for k in chosen} - set(members.stuck)
        found |= {first + min(cord) for cord in cables_of(members.clusters, len(members.edges)) if moved & {*cord}}
    return tuple(sorted(found))


def plan_of(scene: Scene) -> tuple[Plan, list[str]]:
    """The plan, and notes on what differs. Rigid bodies of the structure are no part of it."""
    structure, struts = scene.structure, scene.structure.struts
    if structure.driven:
        raise InputError(f"members {list(structure.driven)} have motors, which MuJoCo models lack; expected a gait")
    if structure.cables is not None and structure.cables.pulleys:
        pairs = [list(pulley.between) for pulley in structure.cables.pulleys]
        raise InputError(f"pulleys between cables {pairs}: their wraps cannot be written; expected clusters without")
    check_no_slides(scene, "this format")
    actuated = actuated_members(structure, scene.gait)
    notes: list[str] = []
    mass, radius = np.asarray(structure.node_mass, float), RADIUS * float(length_scale(scene))
    balls = _balls(scene)
    touching = (balls, radius, 0.0 if balls and all(balls.values()) else radius, _frictions(scene))
    nodes, held = np.asarray(structure.nodes, float), {node for node, _ in structure.fixed}
    if struts is None:
        heavy = _with_halves(mass, structure.cables)
        return Plan(structure, frozenset(), (), heavy, actuated, *touching), _on_balls(balls, [], structure.bodies)
    rod = np.zeros(len(struts.edges)) if struts.mass is None else np.asarray(struts.mass, float)
    may = [
        k for k in range(len(rod)) if (struts.rigid or rod[k]) and k not in actuated and not held & {*struts.edges[k]}
    ]
    rigid: set[int] = set()
    found = []
    for body in bodies(tuple(struts.edges[k] for k in may), len(mass)):
        own = [k for k in may if struts.edges[k][0] in body]
        place = {int(node): k for k, node in enumerate(body)}
        inside = tuple((place[i], place[j]) for i, j in (struts.edges[k] for k in own))
        if is_rigid(nodes[body], inside):
            rigid |= set(own)
            found.append(body)
    others = [k for k in range(len(rod)) if k not in rigid]
    if struts.rigid and others:
        struts = penalty_twin(scene).structure.struts
        assert struts is not None, "it has those of the scene"
        assert struts.stiffness is not None, "as springs"
        notes.append(f"{len(others)} rigid struts are springs of {in_digits(np.max(struts.stiffness), 4)} N/m there")
    elif rigid and not struts.rigid:
        notes.append(f"{len(rigid)} struts with mass do not stretch there, as their ends belong to one body")
    kept = _some(struts, others)
    if _has_mass(kept) or _has_mass(structure.cables):
        notes.append("the mass of cables, and of struts that are springs there, is at their ends, half at each")
    mass = _with_halves(_with_halves(mass, kept), structure.cables)
    springs = Structure(nodes, np.ones(len(mass)), struts, structure.cables, fixed=structure.fixed)
    notes += _on_balls(balls, found, structure.bodies)
    return Plan(springs, frozenset(rigid), tuple(found), mass, actuated, *touching), notes


def _frictions(scene: Scene) -> dict[int, float]:
    mu = friction_at_nodes(scene.friction, len(scene.structure.nodes))
    return dict(enumerate(mu.tolist())) if np.ptp(mu) else {}


def geom_friction(plan: Plan, nodes: list[int]) -> dict[str, Any]:
    """The largest coefficient of some nodes as a geom's own, where the nodes differ.

    Of the ground and a geom of the same priority, MuJoCo takes the larger coefficient: so the ground has the smallest
    one. With `solmix` 0 the ground's spring counts.
    """
    if not plan.friction:
        return {}
    return {"priority": 1, "friction": [max(plan.friction[node] for node in nodes), 0.0, 0.0], "solmix": 0.0}


def _balls(scene: Scene) -> dict[int, float]:
    balls = None if scene.ground is None else scene.ground.balls
    if balls is None:
        return dict.fromkeys(range(len(scene.structure.nodes)), 0.0)
    return dict(zip(balls.nodes, np.asarray(balls.radius, float).tolist()))


def _on_balls(balls: dict[int, float], rods: list[np.ndarray], bodies: Bodies) -> list[str]:
    thin = [[int(node) for node in rod] for rod in rods] + [[*each.points] for each in bodies if len(each.basic) < 4]
    turning = any(balls.get(node) for nodes in thin for node in nodes)
    return ["balls at the ends of rods turn with these there, and slide here"] if turning else []


def _has_mass(members: Members | None) -> bool:
    return members is not None and members.mass is not None and bool(np.any(np.asarray(members.mass)))


def _some(members: Members, chosen: list[int]) -> Members | None:
    if not chosen:
        return None
    mass = None if members.mass is None else np.asarray(members.mass)[chosen]
    return Members(tuple(members.edges[k] for k in chosen), None, np.asarray(members.rest_length)[chosen], mass=mass)


def _with_halves(mass: np.ndarray, members: Members | None) -> np.ndarray:
    found = mass.copy()
    if members is not None and members.mass is not None:
        for ends in zip(*members.edges):
            np.add.at(found, list(ends), np.asarray(members.mass) / 2)
    return found


def amplitudes(gait: Gait | None) -> dict[int, float]:
    """The amplitude of each member that a gait moves."""
    return {} if gait is None else {k: float(a) for k, a in zip(gait.members, np.asarray(gait.amplitude))}

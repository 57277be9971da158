"""Scenes as structure files of NASA's Tensegrity Robotics Toolkit (NTRT)."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.formats.foreign import positive
from jaxgrity.formats.matlab import beside_the_structure
from jaxgrity.formats.ntrt import DECIMETRE, GROUND_FRICTION
from jaxgrity.io.files import write_whole
from jaxgrity.model.friction import friction_at_nodes
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Structure, edge_lengths

THIN = 1e-3
"""Radius of rods and of single nodes that touch as points here, as a share of the structure's size."""


@typed
def save_ntrt(scene: Scene, path: str | Path, unit: float = DECIMETRE) -> tuple[str, ...]:
    """Write the struts and cables of a scene as YAML for NTRT.

    A strut is a rod (`tgRodInfo`) with the radius of the balls at its ends. A cable is a string (`tgBasicActuatorInfo`)
    between nodes, with the pretension K (l - L). Any other node is a sphere, of density 0 where supports hold it. z is
    up here, y in the file: (x, y, z) becomes (x, z, -y).

    Args:
        scene: struts that share no node, and cables that are springs.
        path: of the file.
        unit: m, the file's unit of length; NTRT's examples use decimetres.

    Returns:
        Sentences on what moves otherwise in NTRT, or is not written.

    Raises:
        InputError: rigid bodies, struts that share nodes, cables over several nodes, supports of struts, or supports
            that leave an axis free.
    """
    path, structure, unit = Path(path), scene.structure, positive(unit, "unit")
    _check(path, structure)
    x = np.asarray(structure.nodes, float)
    places = (x[:, [0, 2, 1]] * [1, 1, -1] / unit + 0.0).tolist()
    names = [f"n{k}" for k in range(len(x))]
    pairs, builders = _strings(structure, x, unit)
    for tag, nodes, kind, given in _solids(scene, x, unit):
        if len(nodes) == 2:
            pairs.append(_pair(tag, *nodes))
        else:
            names[nodes[0]] += f" {tag}"
        builders.append(_builder(tag, kind, given))
    at = [f"  {name}: {place}" for name, place in zip(names, places)]
    text = "\n".join(["nodes:", *at, "pair_groups:", *pairs, "builders:", *builders, ""])
    write_whole(path, lambda file: file.write(text.encode()))
    return _notes(scene)


def _check(path: Path, structure: Structure) -> None:
    if structure.bodies:
        raise InputError(
            f"{path}: rigid bodies are not written for NTRT; expected struts, or another format (.toml, .xml)"
        )
    if structure.cables is not None and structure.cables.clusters:
        raise InputError(f"{path}: NTRT has no cables through several nodes; expected a cable for each segment")
    ends = [] if structure.struts is None else [node for edge in structure.struts.edges for node in edge]
    for node in range(len(structure.nodes)):
        count, free = ends.count(node), structure.free[node]
        if count > 1:
            raise InputError(f"{path}: node {node}: {count} struts end there, one body in NTRT; expected struts apart")
        if count and not free.all():
            raise InputError(f"{path}: node {node}: NTRT supports no rod at its end; expected supports of single nodes")
        if free.any() and not free.all():
            raise InputError(f"{path}: node {node}: NTRT supports no node along single axes; expected all three")


def _strings(structure: Structure, x: np.ndarray, unit: float) -> tuple[list[str], list[str]]:
    """Pairs and builders of the cables."""
    cables, pairs, builders = structure.cables, [], []
    if cables is None:
        return [], []
    stretch = (edge_lengths(x, cables.edges) - np.asarray(cables.rest_length, float)) / unit
    damping = np.zeros(len(stretch)) if cables.damping is None else np.asarray(cables.damping, float)
    for k, (edge, K) in enumerate(zip(cables.edges, np.asarray(cables.stiffness, float))):
        law = {"stiffness": K, "damping": damping[k], "pretension": K * stretch[k]}
        ends = {f"moveCablePoint{end}ToEdge": "false" for end in "AB"}
        pairs.append(_pair(f"string{k}", *edge))
        builders.append(_builder(f"string{k}", "tgBasicActuatorInfo", {**law, **ends}))
    return pairs, builders


def _solids(scene: Scene, x: np.ndarray, unit: float) -> Iterator[tuple[str, tuple[int, ...], str, dict[str, Any]]]:
    """Tag, nodes, class and parameters of rods, and of spheres at the other nodes."""
    structure, mass = scene.structure, np.asarray(scene.structure.lumped_mass, float)
    radius = np.full(len(x), THIN * float(np.linalg.norm(np.ptp(x, axis=0))) / unit)
    if (balls := getattr(scene.ground, "balls", None)) is not None:
        own = np.asarray(balls.radius, float) / unit
        radius[list(balls.nodes)] = np.where(own > 0, own, radius[list(balls.nodes)])
    mu = friction_at_nodes(scene.friction, len(x))

    def friction(*nodes: int) -> dict[str, float]:
        return {} if scene.friction is None else {"friction": float(mu[[*nodes]].mean()) / GROUND_FRICTION}

    edges = () if structure.struts is None else structure.struts.edges
    for k, (i, j) in enumerate(edges):
        r = max(radius[i], radius[j])
        volume = np.pi * r**2 * np.linalg.norm(x[i] - x[j]) / unit
        yield f"rod{k}", (i, j), "tgRodInfo", {"radius": r, "density": (mass[i] + mass[j]) / volume, **friction(i, j)}
    for k in sorted({*range(len(x))} - {node for edge in edges for node in edge}):
        density = mass[k] / (4 / 3 * np.pi * radius[k] ** 3) if structure.free[k].all() else 0.0
        yield f"ball{k}", (k,), "tgSphereInfo", {"radius": radius[k], "density": density, **friction(k)}


def _pair(tag: str, first: int, second: int) -> str:
    return f"  {tag}: [[n{first}, n{second}]]"


def _builder(tag: str, kind: str, given: dict[str, Any]) -> str:
    numbers = (f"{name}: {value if isinstance(value, str) else repr(float(value))}" for name, value in given.items())
    return f"  {tag}: {{class: {kind}, parameters: {{{', '.join(numbers)}}}}}"


def _notes(scene: Scene) -> tuple[str, ...]:
    struts, cables = scene.structure.struts, scene.structure.cables
    said = []
    if struts is not None:
        if not struts.rigid:
            said.append("struts are rigid there")
        ends = np.asarray(scene.structure.node_mass, float)[np.asarray(struts.edges, int)].any()
        if ends or (cables is not None and cables.mass is not None):
            said.append("masses of nodes and cables are spread along the rods there, which turn more easily")
        mu = friction_at_nodes(scene.friction, len(scene.structure.nodes))
        if np.ptp(mu[np.asarray(struts.edges, int)], axis=1).any():
            said.append("rods have the mean friction coefficient of their two ends there")
    return (*said, *beside_the_structure(dataclasses.replace(scene, friction=None)))

"""The robot with each cable broken and each strut stuck in turn, and the gaits that it may still have."""

from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from jaxgrity import (
    Gait,
    InputError,
    Scene,
    gait_names,
    gait_record,
    image,
    load_gait,
    standing_symmetries,
    with_gait,
)


def damaged(scene: Scene) -> dict[str, Scene]:
    """The scene with each cable broken, and with each actuated strut stuck."""
    cables, struts = scene.structure.cables, scene.structure.struts
    found = {}
    for k in range(len(cables.edges)):
        whole = np.ones(len(cables.edges))
        whole[k] = 0
        parts = [part * whole for part in (cables.stiffness, cables.damping) if part is not None]
        where = lambda s: [p for p in (s.structure.cables.stiffness, s.structure.cables.damping) if p is not None]  # noqa: E731
        found[f"cable {k}"] = eqx.tree_at(where, scene, parts)
    for k in range(0 if struts is None else len(struts.edges)):
        if k in scene.gait.members:
            # a strut whose amplitude is zero keeps its length: without a program of its own for every case
            found[f"strut {k}"] = scene if k in struts.stuck else with_gait(scene, stuck(scene.gait, k))
    return found


def stuck(gait: Gait, member: int) -> Gait:
    """The gait without one member's motion."""
    still = np.asarray(gait.members) == member
    return eqx.tree_at(lambda g: g.amplitude, gait, np.where(still, 0.0, gait.amplitude))


def known_gaits(scene: Scene, scene_name: str, own: str) -> dict[str, list[Gait]]:
    """By its name the intact robot's `own` gait, and the library's others that fit the scene, with their images."""
    found = {own: load_gait(own)}
    for name in gait_names():
        record = gait_record(name)
        if Path(record["scene"]).stem == Path(scene_name).stem and tuple(record["members"]) == scene.gait.members:
            found[name] = load_gait(name)
    if any(gait.members != scene.gait.members for gait in found.values()):
        raise InputError(f"{own}: actuates other members than {scene_name}; expected the same")
    if found[own].overtones:
        raise InputError(f"{own}: has overtones; expected a gait of one sine for each member")
    plain = {name: gait for name, gait in found.items() if not gait.overtones}
    return {name: [image(gait, symmetry) for symmetry in standing_symmetries(scene)] for name, gait in plain.items()}


def together(gaits: list[Gait]) -> Gait:
    """Gaits as one population."""
    return jax.tree.map(lambda *rows: np.stack(rows) if np.ndim(rows[0]) else rows[0], *gaits)


def still(scene: Scene, gaits: Gait) -> Gait:
    """The gaits without the motion of what is stuck in the scene."""
    moves = np.asarray(scene.gait.amplitude) > 0
    return eqx.tree_at(lambda g: g.amplitude, gaits, np.where(moves, gaits.amplitude, 0.0))

"""Bodies of a MuJoCo model that touch each other: along rods here, too. What else touches there is lost, or named."""

import dataclasses
import itertools
from typing import Any, NamedTuple

import lazy_loader
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import Losses
from jaxgrity.formats.mjcf_contact import SAME_PLACE, GroundFound
from jaxgrity.formats.mjcf_joints import Shared, own_nodes
from jaxgrity.formats.mjcf_losses import bounces, name_of, watched
from jaxgrity.formats.mjcf_solids import lose_length
from jaxgrity.formats.mjcf_touched import LEAST_FRICTION, as_found, friction_of, rod_geoms
from jaxgrity.model.bodies import Body
from jaxgrity.model.friction import friction_at_nodes
from jaxgrity.model.rod_contact import with_contact_along_struts
from jaxgrity.model.rods import free_pairs, rods_of
from jaxgrity.model.scene import Scene
from jaxgrity.model.strut_contact import with_contact_between_struts

mujoco: Any = lazy_loader.load("mujoco")

SAME_FRICTION = 1e-6
"""Largest difference of friction coefficients that count as the same."""


class _Rod(NamedTuple):
    """A capsule between two nodes of its body."""

    points: frozenset[int]
    """nodes of its body"""
    ends: frozenset[int]
    radius: float
    """m"""


class _Met(NamedTuple):
    """Two geoms that touch."""

    time: float
    """s, when they first do"""
    contact: Any
    """as `as_found` has it"""


Pair = tuple[int, int]
"""Two geoms, in ascending order."""


def touching_along_rods(
    model: Any,
    data: Any,
    scene: Scene,
    at: tuple[np.ndarray, np.ndarray, list[Shared]],
    found: GroundFound,
    losses: Losses,
) -> Scene:
    """The scene, whose bodies have capsules as `rods`, and touch each other along them if they do so in MuJoCo.

    `at` has nodes, their bodies and joints. Raises `InputError` where bodies touch in other ways, unless the caller
    drops it.
    """
    size = float(np.ptp(at[0], axis=0).max())
    rods = _rods(model, data, at, SAME_PLACE * size)
    bodies = tuple(_with_rods(body, rods) for body in scene.structure.bodies)
    scene = dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, bodies=bodies))
    struts = scene.structure.struts
    owners = [] if struts is None else list(map(frozenset, struts.edges))
    owners += [frozenset(body.points) for body in bodies for _ in body.rods]
    number = {(own, frozenset(edge)): k for k, (own, edge) in enumerate(zip(owners, rods_of(scene.structure)))}
    known = {geom: number[rod[:2]] for geom, rod in rods.items() if rod[:2] in number}
    # of geoms between the same nodes the thickest touches
    if along := dict(sorted((known[geom], radius) for geom, radius in found.along.items() if geom in known)):
        parts = 2 if len(found.solids) > 1 else 1  # such as edges of two steps
        scene = with_contact_along_struts(scene, parts, tuple(along), list(along.values()))
    if found.solids:
        for geom in found.along:
            if geom not in known and model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_SPHERE:
                lose_length(model, geom, losses)
    radius = {geom: rods[geom].radius for geom in known}
    return _with_pairs(model, data, scene, (known, radius), (size, set(found.solids)), losses)


def _with_pairs(
    model: Any,
    data: Any,
    scene: Scene,
    rods: tuple[dict[int, int], dict[int, float]],
    sizes: tuple[float, set[int]],
    losses: Losses,
) -> Scene:
    """The scene, in which rods touch each other: numbers of geoms' `rods`, and radii, m.

    `sizes` are the robot's, m, and the geoms that are its ground beside the plane.
    """
    (known, radius), (size, ground) = rods, sizes
    free, given = set(map(frozenset, free_pairs(scene.structure))), _given(model)
    pairs = {
        (a, b): both
        for a, b in itertools.combinations(sorted(known), 2)
        if (both := frozenset((known[a], known[b]))) in free and ((a, b) in given or _may_touch(model, a, b))
    }
    struts = scene.structure.struts
    soft = scene.ground is None and struts is not None and not struts.rigid
    met, between = _met(model, data, ground, losses), dict[Pair, _Met]()
    own = {pair: _coefficients(scene, [known[geom] for geom in pair]) for pair in pairs}
    for pair in dict.fromkeys((*met, *pairs)):
        each = met.get(pair) or given.get(pair) or _by_rule(model, *pair)
        alike = pair in pairs and not soft and not each.contact[2] and not bounces(each.contact[3])
        if alike and (pair in met or np.abs(own[pair] - _sliding(each.contact)).max() <= SAME_FRICTION):
            between |= {pair: each} if pair in met or pair in given else {}
            continue
        if pair in met:
            a, b = (name_of(model, "body", int(model.geom_bodyid[geom])) for geom in pair)
            when = f"{each.time:.3g} s after the start" if each.time else "at the start"
            losses.lose(
                "contact", f"bodies {a} and {b} touch each other {when}; here they would pass through each other"
            )
        pairs.pop(pair, None)
    if not between:
        return scene
    for pair in [pair for pair in between if pair in met]:
        _check_friction(model, pair, between[pair], own[pair], (size, losses))
    thickest = dict(sorted((known[geom], radius[geom]) for pair in pairs for geom in pair))
    every = [thickest.get(k, next(iter(thickest.values()))) for k in range(len(rods_of(scene.structure)))]
    chosen = tuple(sorted({(min(both), max(both)) for both in pairs.values()}))
    try:
        scene = with_contact_between_struts(scene, every, chosen)
    except InputError as error:  # rods that start in each other
        losses.lose("contact", str(error))
        return scene
    losses.note(f"{len(chosen)} pairs of rods can touch each other, without a rebound; other parts of bodies cannot")
    return scene


def _rods(model: Any, data: Any, at: tuple[np.ndarray, np.ndarray, list[Shared]], within: float) -> dict[int, _Rod]:
    """The geoms that touch something as capsules with nodes at both ends."""
    (x, carrier, shared), found = at, {}
    for geom, (body, ends, radius) in rod_geoms(model, data).items():
        if len(own := own_nodes(carrier, shared, body)):
            apart = np.linalg.norm(x[own] - ends[:, None], axis=2)
            nodes = frozenset(own[apart.argmin(1)].tolist())
            if len(nodes) == 2 and apart.min(1).max() <= within:
                found[geom] = _Rod(frozenset(own.tolist()), nodes, radius)
    return found


def _with_rods(body: Body, rods: dict[int, _Rod]) -> Body:
    own = {(min(rod.ends), max(rod.ends)) for rod in rods.values() if rod.points == {*body.points}}
    return dataclasses.replace(body, rods=tuple(sorted(own)))


def _given(model: Any) -> dict[Pair, _Met]:
    """The pairs of geoms that the model itself names."""
    found: dict[Pair, _Met] = {}
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return found
    for k, (a, b) in enumerate(zip(model.pair_geom1.tolist(), model.pair_geom2.tolist())):
        contact = int(model.pair_dim[k]), model.pair_friction[k], float(model.pair_margin[k]), model.pair_solref[k]
        found[min(a, b), max(a, b)] = _Met(0.0, contact)
    return found


def _by_rule(model: Any, a: int, b: int) -> _Met:
    """What MuJoCo makes of two geoms that have not met: of the one with priority, or else of both together."""
    first, second = (model.geom_priority[geom] for geom in (a, b))
    geoms = [a, b] if first == second else [a if first > second else b]
    friction = np.max(model.geom_friction[geoms], axis=0)[[0, 0, 1, 2, 2]]
    springs, weights = model.geom_solref[geoms], np.maximum(model.geom_solmix[geoms], mujoco.mjMINVAL)
    mixed = weights @ springs / weights.sum() if np.all(springs[:, 0] > 0) else springs.min(0)
    return _Met(np.inf, (int(max(model.geom_condim[geoms])), friction, float(max(model.geom_margin[[a, b]])), mixed))


def _coefficients(scene: Scene, rods: list[int]) -> np.ndarray:
    """Friction coefficients of the ends of two rods."""
    mu, edges = friction_at_nodes(scene.friction, len(scene.structure.nodes)), rods_of(scene.structure)
    return mu[[node for k in rods for node in edges[k]]]


def _sliding(contact: Any) -> float:
    return 0.0 if contact[0] == 1 or contact[1][0] <= LEAST_FRICTION else float(max(contact[1][:2]))


def _check_friction(model: Any, pair: Pair, each: _Met, own: np.ndarray, sizes: tuple[float, Losses]) -> None:
    """Loses friction of two rods with each other that is not that of their ends."""
    size, losses = sizes
    mu = friction_of(model, pair[0], each.contact, size, losses)
    if np.abs(own - mu).max() > SAME_FRICTION:
        names = " and ".join(name_of(model, "geom", geom) for geom in pair)
        here = f"{own.min():g}" + f" to {own.max():g}" * bool(np.ptp(own))
        losses.lose("friction", f"geoms {names} touch each other with friction {mu:g}, where nodes have {here}")


def _met(model: Any, data: Any, ground: set[int], losses: Losses) -> dict[Pair, _Met]:
    """Which geoms of different bodies touch each other, at the start or while MuJoCo moves the robot for a while."""
    body, found = _bodies(model), dict[Pair, _Met]()
    plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    plane[[*ground]] = True
    masks = np.stack([model.geom_contype, model.geom_conaffinity, body, model.geom_bodyid], 1)
    standing = np.unique(masks[(body == 0) & ~plane], axis=0)
    moving = np.unique(masks[body != 0], axis=0)
    given = [pair for pair in _given(model) if not plane[[*pair]].any()]
    if any(not body[[*pair]].all() for pair in given) or any(_meets(model, one, moving) for one in standing):
        losses.lose("contact", "bodies touch what stands beside the plane")
    may = bool(given) or any(_meets(model, one, moving[k + 1 :]) for k, one in enumerate(moving))
    for time, moved in itertools.chain([(0.0, data)], ((moved.time, moved) for moved in watched(data) if may)):
        pairs = np.sort(moved.contact.geom, axis=1)
        for k in np.flatnonzero((body[pairs] > 0).all(1) & (body[pairs[:, 0]] != body[pairs[:, 1]])).tolist():
            if (pair := tuple(pairs[k].tolist())) not in found:
                found[pair] = _Met(time, as_found(moved.contact[k]))
    if may and not found:
        losses.note("bodies that meet each other touch there; here they pass through each other")
    return found


def _bodies(model: Any) -> np.ndarray:
    """The body of each geom; 0 of what stands still, as do bodies that only a program moves."""
    body = model.body_weldid[model.geom_bodyid]
    return np.where(model.body_mocapid[body] >= 0, 0, body)


def _may_touch(model: Any, one: int, other: int) -> bool:
    """Whether MuJoCo lets two geoms of different bodies touch."""
    a, b = (int(model.geom_bodyid[geom]) for geom in (one, other))
    rows = np.stack([model.geom_contype, model.geom_conaffinity, _bodies(model), model.geom_bodyid], 1)[[one, other]]
    return _meets(model, rows[0], rows[1:]) and a != b


def _meets(model: Any, one: np.ndarray, others: np.ndarray) -> bool:
    """Whether masks let a body touch one of others."""
    others = others[others[:, 2] != one[2]]
    low, high = np.minimum(others[:, 3], one[3]), np.maximum(others[:, 3], one[3])
    excluded = np.isin((low.astype(int) << 16) + high, model.exclude_signature.astype(int))
    return bool(np.any((((one[0] & others[:, 1]) | (others[:, 0] & one[1])) != 0) & ~excluded))

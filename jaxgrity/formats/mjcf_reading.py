"""MuJoCo models (MJCF) of tensegrity robots as scenes: free bodies, point masses and spatial tendons. Extra: `peer`."""

import importlib.util
import io
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import lazy_loader
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import MOST_NODES, Imported, read_limited
from jaxgrity.formats.mjcf_bodies import carried, rod_members
from jaxgrity.model.friction import ConeFriction
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure, check_edges, edge_lengths

mujoco: Any = lazy_loader.load("mujoco")

REFUSED = (
    *("include", "replicate", "composite", "flexcomp", "flex", "hfield", "mesh", "skin", "plugin", "extension"),
    *("equality", "size", "attach", "model"),
)
"""elements that name other files, make many parts of one, hold memory, or constrain what struts cannot"""
DEEPEST = 50
"""elements within each other"""


class Spring(NamedTuple):
    """A tendon, as a member."""

    kind: str
    """strut: it pushes, too; cable: it does not"""
    ends: tuple[int, int]
    """sites, later nodes"""
    stiffness: float
    rest_length: float
    damping: float


class _Nodes(NamedTuple):
    """Sites at which tendons end, and further ones of the bodies that carry those."""

    sites: list[int]
    x: np.ndarray
    """(nodes, 3), m"""
    carrier: np.ndarray
    """the body that each moves with; 0: the world"""


def read_mjcf(path: str | Path) -> Imported:
    """A MuJoCo model of a tensegrity robot as a scene: what `save_mjcf` writes, and others of this kind.

    Sites at which tendons end, and others of the same bodies, become nodes. A free body becomes rigid struts between
    its nodes, with the body's mass as point masses and thin rods; a body on three slides a point mass; what does not
    move a support. A tendon whose spring range begins at 0, or whose actuator only pulls, is a cable, another one with
    a spring a strut.

    Args:
        path: of the file (.xml). MuJoCo itself reads it.

    Returns:
        The scene, with gravity, the plane and its friction where the model has them, and what was read how.

    Raises:
        InputError: one line with the file and what is wrong, or has no counterpart; MuJoCo is not installed.

    Example:
        >>> jaxgrity.read_mjcf("my_robot.xml").scene  # doctest: +SKIP
    """
    if importlib.util.find_spec("mujoco") is None:
        raise InputError(f"{path}: reading MuJoCo models needs mujoco; expected: pip install 'jaxgrity[peer]'")
    text = read_limited(path)
    try:
        _check_elements(text)
        model = mujoco.MjModel.from_xml_string(text)
        return _imported(model)
    except (ValueError, RuntimeError) as error:  # InputError is a ValueError; MuJoCo raises both
        raise InputError(f"{path}: {' '.join(str(error).split())}") from error


def _check_elements(text: str) -> None:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError("has a document type or entities; expected plain elements")
    depth = 0
    try:
        for event, element in ElementTree.iterparse(io.StringIO(text), ("start", "end")):
            depth += 1 if event == "start" else -1
            if depth > DEEPEST:
                raise InputError(f"elements within each other, more than {DEEPEST} levels deep")
            if element.tag in REFUSED:
                raise InputError(f"has <{element.tag}>, which is not read; expected bodies, sites, tendons, actuators")
    except ElementTree.ParseError as error:
        raise InputError(f"not XML: {error}") from error


def _imported(model: Any) -> Imported:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    notes: list[str] = []
    tendons = _tendons(model, data, notes)
    nodes = _nodes(model, data, [site for tendon in tendons for site in tendon.ends])
    number = {site: k for k, site in enumerate(nodes.sites)}
    merged = _same_places(nodes)
    used = sorted(set(merged))
    place = {node: k for k, node in enumerate(used)}
    x = nodes.x[used]
    springs = [
        tendon._replace(ends=(place[merged[number[tendon.ends[0]]]], place[merged[number[tendon.ends[1]]]]))
        for tendon in tendons
    ]
    masses, fixed, rods = carried(model, data, x, nodes.carrier[used], notes)
    pushing = [spring for spring in springs if spring.kind == "strut"]
    if pushing and rods:
        springs, pushing = _as_cables(springs, x, notes), []
    elif pushing:
        notes.append(f"{len(pushing)} tendons push as well as pull, and are struts")
    struts = _members(pushing) if pushing else rod_members(x, rods)
    cables = _members([spring for spring in springs if spring.kind == "cable"])
    check_edges(x, () if struts is None else struts.edges, () if cables is None else cables.edges)
    drag = _drag(model, nodes, merged, place)
    ground, friction, lift = _ground(model, data, x, notes)
    structure = Structure(x - lift, masses, struts, cables, fixed=fixed)
    g = _gravity(model)
    damping = drag if drag.any() else None
    scene = Scene(structure, g or None, damping, ground, None if ground is None else friction)
    return Imported(scene, ("SI units, z up, as in MuJoCo", *notes))


def _tendons(model: Any, data: Any, notes: list[str]) -> list[Spring]:
    """Kind, sites, K (N/m), L (m) and c (N s/m) of each spatial tendon that is a spring or has an actuator."""
    if not model.ntendon:
        raise InputError("has no tendons; expected spatial tendons between sites")
    driven = _actuators(model, notes)
    found, idle = [], []
    for t in range(model.ntendon):
        first, count = model.tendon_adr[t], model.tendon_num[t]
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TENDON, t) or str(t)
        wraps = range(first, first + count)
        if count != 2 or any(model.wrap_type[w] != mujoco.mjtWrap.mjWRAP_SITE for w in wraps):
            raise InputError(f"tendon {name}: expected two sites, and nothing that it wraps about")
        ends = (int(model.wrap_objid[first]), int(model.wrap_objid[first + 1]))
        K, (low, high), c = model.tendon_stiffness[t], model.tendon_lengthspring[t], model.tendon_damping[t]
        K, c = float(np.ravel(K)[0]), float(np.ravel(c)[0])
        if t in driven and K:
            raise InputError(f"tendon {name}: has a spring and an actuator with one; expected one of them")
        if t in driven:
            kind, stiffness, rest, damping = driven[t]
            found.append(Spring(kind, ends, stiffness, rest, damping))
        elif not K:
            idle.append(name)
        elif low == high or low == 0:
            found.append(Spring("strut" if low == high else "cable", ends, K, float(high), c))
        else:
            raise InputError(f"tendon {name}: springlength {low:g} to {high:g}; expected one length, or from 0 on")
    if idle:
        notes.append(
            f"{len(idle)} tendons without a spring are left out: {', '.join(idle[:5])}{'...' * (len(idle) > 5)}"
        )
    return found


def _actuators(model: Any, notes: list[str]) -> dict[int, tuple[str, float, float, float]]:
    """Of each tendon with an affine actuator: its kind, K, L where the control is 0, and c."""
    found: dict[int, tuple[str, float, float, float]] = {}
    others = 0
    for a in range(model.nu):
        if model.actuator_trntype[a] != mujoco.mjtTrn.mjTRN_TENDON:
            continue
        gain, bias, tendon = model.actuator_gainprm[a], model.actuator_biasprm[a], int(model.actuator_trnid[a, 0])
        affine = model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE and np.isclose(gain[0], -bias[1], rtol=1e-9)
        if not affine or gain[0] <= 0 or bias[0] <= 0 or tendon in found or model.actuator_gear[a, 0] != 1:
            others += 1
            continue
        pulls = model.actuator_forcelimited[a] and model.actuator_forcerange[a, 1] <= 0
        found[tendon] = "cable" if pulls else "strut", float(gain[0]), float(bias[0] / gain[0]), float(max(0, -bias[2]))
    if found:
        notes.append(
            f"{len(found)} actuators are springs whose rest length their control changes; the gait is not read"
        )
    if others:
        notes.append(f"{others} actuators that are no springs with a rest length are left out")
    return found


def _nodes(model: Any, data: Any, sites: list[int]) -> _Nodes:
    carriers = {int(model.body_weldid[model.site_bodyid[site]]) for site in sites} - {0}
    every = range(model.nsite)
    found = set(sites) | {k for k in every if model.body_weldid[model.site_bodyid[k]] in carriers}
    chosen = sorted(found, key=lambda site: (_number(model, site), site))
    if len(chosen) > MOST_NODES:
        raise InputError(f"{len(chosen)} sites with tendons; expected at most {MOST_NODES}")
    body = model.body_weldid[model.site_bodyid[chosen]]
    return _Nodes(chosen, data.site_xpos[chosen].copy(), body)


def _number(model: Any, site: int) -> int:
    """Of a site that `save_mjcf` named by the number of its node; others come first, in their own order."""
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SITE, site) or ""
    return int(name[1:]) if name.startswith("n") and name[1:].isdecimal() and len(name) < 10 else -1


def _same_places(nodes: _Nodes) -> list[int]:
    """For each node the first one of the same body in its place."""
    seen: dict[tuple, int] = {}
    keys = [(int(b), *np.round(x / 1e-9).astype(int).tolist()) for b, x in zip(nodes.carrier, nodes.x)]
    return [seen.setdefault(key, k) for k, key in enumerate(keys)]


def _as_cables(springs: list[Spring], x: np.ndarray, notes: list[str]) -> list[Spring]:
    """Springs both ways beside rigid bodies: cables where they are stretched."""
    pushing = [spring for spring in springs if spring.kind == "strut"]
    for spring in pushing:
        if edge_lengths(x, (spring.ends,))[0] < spring.rest_length:
            raise InputError("a tendon that pushes is compressed at the start, beside free bodies; expected it to pull")
    notes.append(f"{len(pushing)} tendons would push, too, if they went slack; here they are cables, which do not")
    return [spring._replace(kind="cable") for spring in springs]


def _members(springs: list[Spring]) -> Members | None:
    if not springs:
        return None
    K, L, c = (np.array([spring[k] for spring in springs], float) for k in (2, 3, 4))
    return Members(tuple(spring.ends for spring in springs), K, L, damping=c if c.any() else None)


def _drag(model: Any, nodes: _Nodes, merged: list[int], place: dict[int, int]) -> np.ndarray:
    """N s/m, of slides, and of actuators that push against the velocity of a site."""
    drag = np.zeros(len(place))
    for k, body in enumerate(nodes.carrier):
        joints = np.flatnonzero(model.body_weldid[model.jnt_bodyid] == body)
        if body and len(joints) and model.jnt_type[joints[0]] == mujoco.mjtJoint.mjJNT_SLIDE:
            drag[place[merged[k]]] = np.ravel(model.dof_damping[model.jnt_dofadr[joints[0]]])[0]
    known = {site: k for k, site in enumerate(nodes.sites)}
    for a in np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_SITE):
        site, bias = int(model.actuator_trnid[a, 0]), model.actuator_biasprm[a]
        if site in known and bias[2] < 0:
            drag[place[merged[known[site]]]] = -bias[2]
    return drag


def _gravity(model: Any) -> float:
    x, y, z = model.opt.gravity
    if x or y or z > 0:
        raise InputError(f"gravity is {[x, y, z]} m/s^2; expected it along -z")
    return float(-z)


def _ground(
    model: Any, data: Any, x: np.ndarray, notes: list[str]
) -> tuple[ExactGround | None, ConeFriction, np.ndarray]:
    """The plane, its friction, and by what all nodes move so that it goes through the origin and meets nodes alone."""
    planes = np.flatnonzero((model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_bodyid == 0))
    balls = np.flatnonzero((model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE) & (model.geom_bodyid != 0))
    if len(planes) != 1:
        if len(planes):
            raise InputError(f"has {len(planes)} planes; expected one, or none")
        return None, ConeFriction(0.0), np.zeros(3)
    (plane,) = planes
    n = data.geom_xmat[plane].reshape(3, 3)[:, 2]
    if abs(n[1]) > 1e-9 or n[2] <= 0:
        raise InputError(f"the plane's normal is {n.round(4).tolist()}; expected one that falls along x, or none")
    radius = float(model.geom_size[balls, 0].max()) if len(balls) else 0.0
    own = float(model.geom_friction[plane, 0])
    others = [] if model.geom_priority[plane] > 0 else model.geom_friction[balls, 0].tolist()
    away = min(n @ data.geom_xpos[plane] + radius, float((x @ n).min()))
    notes.append(
        f"contact is between nodes and the plane, which is moved by {away:.4g} m for the spheres' radius; it is exact, "
        "where MuJoCo's is soft"
    )
    away = away * n
    return ExactGround(float(np.arctan2(n[0], n[2]))), ConeFriction(max([own, *others])), away

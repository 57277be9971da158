"""MuJoCo models (MJCF) of tensegrity robots as scenes: free bodies, point masses and spatial tendons. Extra: `peer`."""

import importlib.util
import itertools
import shlex
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, NamedTuple

import lazy_loader
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import Edges
from jaxgrity.formats.foreign import MOST_NODES, Imported, Losses, read_limited, some_of, together
from jaxgrity.formats.mjcf_bodies import carried, is_free, rigid_bodies, rod_members
from jaxgrity.formats.mjcf_contact import touched_plane
from jaxgrity.formats.mjcf_drag import drag_of
from jaxgrity.formats.mjcf_hinges import hinge_laws, with_nodes_of_the_world
from jaxgrity.formats.mjcf_joints import joints_of, merge_welded, shared_nodes
from jaxgrity.formats.mjcf_losses import DROPPABLE, check_losses, check_timestep, gravity_of, name_of, unlogged
from jaxgrity.formats.mjcf_meeting import touching_along_rods
from jaxgrity.formats.mjcf_rolling import touched_by_balls
from jaxgrity.formats.mjcf_tendons import Spring, laws_of, pushing_cable, slack, springs_of, with_others_beside
from jaxgrity.formats.mjcf_text import mjcf_text, with_element_lines
from jaxgrity.formats.mjcf_turning import turned_upright
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure, check_edges, edge_lengths

mujoco: Any = lazy_loader.load("mujoco")


class _Nodes(NamedTuple):
    """Sites at which tendons end, and further ones of the bodies that carry those."""

    sites: list[int]
    x: np.ndarray
    """(nodes, 3), m"""
    carrier: np.ndarray
    """the body that each moves with; 0: the world"""


@typed
def read_mjcf(path: str | Path, drop: Collection[str] = (), keyframe: str = "") -> Imported:
    """A MuJoCo model of a tensegrity robot as a scene: what `save_mjcf` writes, and others of this kind.

    Sites at which tendons end, and others of the same bodies, become nodes. A free body with two of them becomes a
    rigid strut, with the body's mass as point masses and a thin rod; one with more a rigid body, whose balls have
    their radii and roll. Ball joints and hinges become shared points of bodies, or supports. Welded bodies become one
    body. A body on three slides becomes a point mass; what does not move a support. A tendon whose spring has a range,
    or whose actuator only pulls, is a cable, which pushes below a range that begins above 0. Another one with a spring
    is a strut. A motor on a tendon without a spring makes it a cable that pulls at any length
    (`jaxgrity.model.commanded_pull`). A cable over several sites slides over their nodes (`Members.clusters`). Hinges
    keep their springs and dampers. Spheres, capsules and boxes that touch the plane are those of nodes, with one radius
    for all. Capsules of bodies are their `rods`, which touch each other if they do so in MuJoCo within a second. If
    gravity leans, robot and plane are turned together.

    What would make the robot move otherwise is refused, unless `drop` names its kind: then it is left out, and a note
    says so.

    Args:
        path: the file (.xml), which MuJoCo itself reads.
        drop: parts that you let go, any of "contact", "radius", "friction", "limits", "damping", "actuators", "air"
            and "forces".
        keyframe: name of the keyframe in which the robot starts, at rest, with its controls. Without it, bodies start
            where the model places them, and controls are 0.

    Returns:
        The scene, with gravity, the plane and its friction where the model has them, and what was read how.

    Raises:
        InputError: one line with the file and what is wrong, or would be lost; MuJoCo is not installed.

    Example:
        >>> jaxgrity.formats.read_mjcf("my_robot.xml").scene  # doctest: +SKIP
    """
    if importlib.util.find_spec("mujoco") is None:
        raise InputError(f"{path}: reading MuJoCo models needs mujoco; expected: pip install 'jaxgrity[peer]'")
    read_limited(path)  # what it refuses has the file's name already
    text = ""
    try:
        text = mjcf_text(Path(path))
        with unlogged():
            model = mujoco.MjModel.from_xml_string(text)
        check_timestep(model)
        with Losses(drop, DROPPABLE, []) as losses:
            return _imported(model, losses, keyframe)
    except (ValueError, RuntimeError) as error:  # InputError is a ValueError; MuJoCo raises both
        raise InputError(f"{path}: {with_element_lines(' '.join(str(error).split()), text)}") from error


def _imported(model: Any, losses: Losses, keyframe: str) -> Imported:
    data, notes = mujoco.MjData(model), losses.notes
    _set_start(model, data, keyframe, losses)
    model = merge_welded(model, data, losses)
    check_losses(model, data, losses)
    tendons = springs_of(model, data, losses)
    joints = joints_of(model, data, losses)
    joined = {body for joint in joints for body in joint.bodies if body}
    nodes = _nodes(model, data, [site for tendon in tendons for site in tendon.path], joined)
    number = {site: k for k, site in enumerate(nodes.sites)}
    merged = _same_places(nodes)
    _note_left_out(model, nodes.carrier, losses)
    used = sorted(set(merged))
    place = {node: k for k, node in enumerate(used)}
    x = nodes.x[used]
    carrier, found = nodes.carrier[used], None
    springs = [_along([place[merged[number[site]]] for site in each.path], each, x, carrier) for each in tendons]
    x, carrier, shared = shared_nodes(x, carrier, joints)
    x, carrier = with_nodes_of_the_world(model, x, carrier, joints)
    if any(is_free(model, body) for body in carrier.tolist()):
        rest = {each.name: each.rest_length for each in tendons}
        springs = _as_cables(springs, x, lambda names: slack(model, data, {k: rest[k] for k in names}), notes)
    springs = [pushing_cable(each, 0.0) if each.kind == "strut" and len(each.path) > 2 else each for each in springs]
    springs = with_others_beside(springs)
    pushing = [spring for spring in springs if spring.kind == "strut"]
    # rods are rigid struts, beside which no strut is a spring, and no cable runs along one: these rods are bodies, too
    solid = set(carrier.tolist()) if pushing else _crossed(springs, carrier)
    many = rigid_bodies(model, data, (x, carrier), shared, solid)
    if many:
        found = touched_by_balls(model, data, (x, carrier), shared, many, losses)
        x, carrier = np.concatenate([x, found.more]), np.r_[carrier, found.carrier]
        place |= {k: k for k in range(len(used), len(x))}
    hinges = hinge_laws(model, data, (x, carrier), joints, shared, losses)
    balls_of = {} if found is None else dict(found.turning)
    masses, fixed, rods, rigid = carried(model, data, (x, carrier), shared, balls_of, losses)
    if pushing:
        notes.append(f"{len(pushing)} tendons push as well as pull, and are struts")
    pulling = [spring for spring in springs if spring.kind == "cable"]
    _refuse_shared_pairs(springs)
    check_edges(x, _segments(pushing) or tuple(edge for edge, _ in rods), _segments(pulling))
    struts, cables = _members(pushing, x) if pushing else rod_members(x, rods), _members(pulling, x)
    _note_controls([*pushing, *pulling], 0 if pushing or struts is None else len(struts.edges), notes)
    drag = drag_of(model, {site: place[merged[k]] for site, k in number.items()}, len(x), losses)
    found = found or touched_plane(model, data, x, carrier, losses)
    scene = Scene(
        Structure(x - found.lift, masses, struts, cables, fixed=fixed, bodies=rigid),
        gravity_of(model) or None,
        drag if drag.any() else None,
        found.ground,
        found.friction,
        terms=(*laws_of(pulling, cables, notes), *hinges),
    )
    touching = touching_along_rods(model, data, scene, (x, carrier, shared), found, losses)
    upright = turned_upright(model, touching, found, losses)
    return Imported(upright, together(["SI units, z up, as in MuJoCo", *notes]))


def _set_start(model: Any, data: Any, keyframe: str, losses: Losses) -> None:
    """Where the bodies are placed, or where a keyframe has them."""
    names = [name_of(model, "key", k) for k in range(model.nkey)]
    if keyframe:
        if keyframe not in names:
            raise InputError(f"keyframe = {keyframe!r}: expected one of {', '.join(names) or 'none: there is none'}")
        mujoco.mj_resetDataKeyframe(model, data, names.index(keyframe))
        if np.any(data.qvel):
            losses.note(f"keyframe {keyframe}: its bodies move there; here they start at rest")
    elif names:
        placed = f"{len(names)} keyframes are not read, and bodies start where they are placed: {some_of(names)}"
        usual = ", at the controls nearest to 0" if model.nu else ""
        losses.note(f"{placed}{usual}; --keyframe {shlex.quote(names[0])} starts in that one, with its controls")
    mujoco.mj_forward(model, data)


def _nodes(model: Any, data: Any, sites: list[int], joined: set[int]) -> _Nodes:
    carriers = {int(model.body_weldid[model.site_bodyid[site]]) for site in sites} - {0} | joined
    every = range(model.nsite)
    found = set(sites) | {k for k in every if model.body_weldid[model.site_bodyid[k]] in carriers}
    chosen = sorted(found, key=lambda site: (_number(model, site), site))
    if len(chosen) > MOST_NODES:
        raise InputError(f"{len(chosen)} sites with tendons; expected at most {MOST_NODES}")
    body = model.body_weldid[model.site_bodyid[chosen]]
    return _Nodes(chosen, data.site_xpos[chosen].copy(), body)


def _note_left_out(model: Any, carrier: np.ndarray, losses: Losses) -> None:
    """Bodies that move, and to which no tendon or joint leads."""
    moving = set(model.body_weldid[model.body_mocapid[model.body_weldid] < 0].tolist()) - {0}
    if alone := sorted(moving - set(carrier.tolist())):
        names = some_of([name_of(model, "body", body) for body in alone])
        losses.note(f"{len(alone)} bodies that no tendon moves are left out: {names}")


def _number(model: Any, site: int) -> int:
    """Of a site that `save_mjcf` named by the number of its node; others come first, in their own order."""
    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SITE, site) or ""
    return int(name[1:]) if name.startswith("n") and name[1:].isdecimal() and len(name) < 10 else -1


def _same_places(nodes: _Nodes) -> list[int]:
    """For each node the first one of the same body in its place."""
    seen: dict[tuple, int] = {}
    keys = [(int(b), *np.round(x / 1e-9).astype(int).tolist()) for b, x in zip(nodes.carrier, nodes.x)]
    return [seen.setdefault(key, k) for k, key in enumerate(keys)]


def _along(path: list[int], spring: Spring, x: np.ndarray, carrier: np.ndarray) -> Spring:
    """A tendon over the nodes of its sites, without segments of length 0, and without those within its end bodies."""
    nodes, rest = [path[0], *(b for a, b in itertools.pairwise(path) if a != b)], spring.rest_length
    nodes = nodes if len(nodes) > 1 else path[:2]
    for _ in range(2):  # at the start, then at the end
        while len(nodes) > 2 and carrier[nodes[0]] == carrier[nodes[1]]:
            within = float(edge_lengths(x, ((nodes[0], nodes[1]),))[0])
            if within >= rest:
                break
            nodes, rest = nodes[1:], rest - within
        nodes = nodes[::-1]
    return spring._replace(path=tuple(nodes), rest_length=rest)


def _crossed(springs: list[Spring], carrier: np.ndarray) -> set[int]:
    """The bodies that tendons run through from one node to another."""
    pairs = {pair for spring in springs if len(spring.path) > 2 for pair in itertools.pairwise(spring.path)}
    return {int(carrier[a]) for a, b in pairs if carrier[a] == carrier[b]}


def _segments(springs: list[Spring]) -> Edges:
    return tuple(pair for spring in springs for pair in itertools.pairwise(spring.path))


def _refuse_shared_pairs(springs: list[Spring]) -> None:
    """Raises `InputError`, with names, where two tendons, or two parts of one, join the same nodes."""
    seen: dict[frozenset[int], str] = {}
    for spring in springs:
        for pair in map(frozenset, _segments([spring])):
            if pair in seen:
                raise InputError(
                    f"tendon {spring.name}: joins two sites that tendon {seen[pair]} joins, too; expected one of them"
                )
            seen[pair] = spring.name


def _as_cables(
    springs: list[Spring], x: np.ndarray, short: Callable[[list[str]], set[str]], notes: list[str]
) -> list[Spring]:
    """Springs both ways beside rigid bodies: cables where they are stretched, which push if they go `short` there."""
    ways = (spring for spring in springs if spring.kind == "strut")
    stretched = [each for each in ways if edge_lengths(x, _segments([each])).sum() >= each.rest_length]
    pushing = short([each.name for each in stretched])
    if taut := len(stretched) - len(pushing):
        notes.append(f"{taut} tendons would push, too, if they went slack; here they are cables, which do not")
    cables = {
        each.name: pushing_cable(each, 0.0) if each.name in pushing else each._replace(kind="cable")
        for each in stretched
    }
    return [cables.get(spring.name, spring) for spring in springs]


def _members(springs: list[Spring], x: np.ndarray) -> Members | None:
    """Tendons over several nodes have segments in series, which stretch alike: shares of rest length as of length."""
    laws: list[np.ndarray] = []
    clusters = []
    for spring in springs:
        lengths = edge_lengths(x, _segments([spring]))
        if len(lengths) > 1:
            clusters.append(tuple(range(len(laws), len(laws) + len(lengths))))
        share = lengths / lengths.sum()
        laws += list(np.stack([spring.stiffness / share, spring.rest_length * share, spring.damping / share], 1))
    if not springs:
        return None
    K, L, c = np.array(laws).T
    return Members(_segments(springs), K, L, damping=c if c.any() else None, clusters=tuple(clusters))


def _note_controls(springs: list[Spring], first: int, notes: list[str]) -> None:
    """Which members controls move, as a gait names them, and how far; `first` is the number of the first spring."""
    members, forced, most = list[int](), list[int](), 0.0
    low, high = 0.0, 0.0
    for spring in springs:
        count = len(spring.path) - 1
        if any(spring.change):
            members += range(first, first + count)
            low, high = (f(end, x / spring.rest_length) for f, end, x in zip((min, max), (low, high), spring.change))
        elif spring.reach:
            forced += range(first, first + count)
            most = max(most, spring.reach)
        first += count
    if forced:
        notes.append(
            f"controls set the pull of {len(forced)} members at any length: shortening by a share s adds s times "
            f"up to {most:g} N: [gait] members = {forced}"
        )
    if members:
        reach = f"by {low:.0%} to {high:.0%}" if np.isfinite(high) else "without a limit"
        notes.append(f"controls change the rest lengths of {len(members)} members {reach}: [gait] members = {members}")

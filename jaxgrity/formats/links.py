"""Rigid bodies and rods of a scene as links: masses, centres and inertias, and joints at the nodes that links share."""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, eigh

from jaxgrity.core.errors import InputError
from jaxgrity.formats.mjcf_plan import Plan
from jaxgrity.model.bodies import BESIDE_POINTS, Bodies, body_moments

THICKNESS = 0.01
"""Radius of a rod over its length, for pictures and for its moment of inertia about its own axis."""
WORLD = -1
"""In the place of a link's number: what does not move."""


class Link(NamedTuple):
    """One rigid body, or the rods that form one."""

    name: str
    nodes: tuple[int, ...]
    mass: float
    """kg, with that of its nodes; a shared node's is in the first link"""
    centre: np.ndarray
    """m: centre of mass, and origin of the link's frame"""
    inertia: np.ndarray
    """kg m^2, (3, 3), about the centre; about the line of a rod that of `THICKNESS`"""
    bars: tuple[tuple[np.ndarray, np.ndarray], ...]
    """ends, m, of bars that show the body"""


class LinkJoint(NamedTuple):
    """How a link moves on its parent."""

    link: int
    parent: int
    nodes: tuple[int, ...]
    """shared with the parent; none for a link that moves freely"""


Part = tuple[float, np.ndarray, np.ndarray]
"""Mass in kg, centre in m, and the integral of d d' dm about it in kg m^2."""


def links_of(plan: Plan, bodies: Bodies) -> list[Link]:
    """The rigid `bodies`, and those that struts of the plan form."""
    x, struts = np.asarray(plan.structure.nodes, float), plan.structure.struts
    found: list[Link] = []
    left = dict(enumerate(plan.node_mass.tolist()))

    def add(nodes: tuple[int, ...], parts: list[Part], bars: list, straight: bool) -> None:
        points = [(left.pop(node, 0.0), x[node], np.zeros((3, 3))) for node in nodes]
        mass, centre, inertia = _together([*parts, *points])
        if straight:
            d = x[nodes[1]] - x[nodes[0]]
            inertia = inertia + mass / 2 * THICKNESS**2 * np.outer(d, d)
        bars = [(centre if start is None else start, end) for start, end in bars]
        found.append(Link(f"body{len(found)}", nodes, mass, centre, inertia, tuple(bars)))

    for body in bodies:
        mass, centre, inertia = (np.asarray(part, float) for part in body_moments(body, x))
        own = (float(mass), centre, np.trace(inertia) / 2 * np.eye(3) - inertia)
        add(body.points, [own], [(None, x[node]) for node in body.points], len(body.basic) == 2)
    for nodes in plan.bodies:
        assert struts is not None, "such a body is made of struts"
        rods = [k for k in sorted(plan.rigid) if struts.edges[k][0] in nodes]
        ends = [(x[i], x[j]) for i, j in (struts.edges[k] for k in rods)]
        mass = np.zeros(len(struts.edges)) if struts.mass is None else np.asarray(struts.mass, float)
        parts = [(float(mass[k]), (a + b) / 2, mass[k] / 12 * np.outer(b - a, b - a)) for k, (a, b) in zip(rods, ends)]
        add(tuple(nodes.tolist()), parts, ends, len(nodes) == 2)
    return found


def joints_between(links: list[Link], held: set[int]) -> tuple[list[LinkJoint], list[tuple[int, int, int]]]:
    """The joints of a tree of links, parents first, and the nodes at which its loops close, each with two links.

    Nodes that are `held` belong to the world.
    """
    own = {WORLD: held} | {k: set(link.nodes) for k, link in enumerate(links)}
    joints: list[LinkJoint] = []
    left = list(range(len(links)))
    for root in own:
        if root != WORLD:
            if root not in left:
                continue
            left.remove(root)
            joints.append(LinkJoint(root, WORLD, ()))
        queue = [root]
        for parent in queue:
            for k in [k for k in left if own[parent] & own[k]]:
                left.remove(k)
                joints.append(LinkJoint(k, parent, tuple(sorted(own[parent] & own[k]))))
                queue.append(k)
    loops = []
    for node in sorted(set().union(*own.values())):
        # a link whose parent has the node follows it there
        first, *others = ([WORLD] if node in held else []) + [
            joint.link for joint in joints if node in own[joint.link] and node not in joint.nodes
        ]
        loops += [(node, other, first) for other in others]
    return joints, loops


def axis_of(joint: LinkJoint, links: list[Link], x: np.ndarray) -> np.ndarray | None:
    """The axis about which a link turns on its parent, m. It is 0 for a ball joint, None if the link cannot turn."""
    shared, own = (x[list(nodes)] - x[joint.nodes[0]] for nodes in (joint.nodes, links[joint.link].nodes))
    within = BESIDE_POINTS * np.linalg.norm(own, axis=1).max()
    spread = np.linalg.matrix_rank(shared, tol=within)
    if spread > 1 or (spread and np.linalg.matrix_rank(own, tol=within) == 1):
        return None
    return shared[np.linalg.norm(shared, axis=1).argmax()]


def _together(parts: list[Part]) -> Part:
    """Mass, centre, and moments of inertia about it, of all parts."""
    mass = sum(m for m, _, _ in parts)
    if not mass > 0:
        raise InputError("a rigid body has no mass; expected some, since other programs move no body without")
    centre = sum((m * c for m, c, _ in parts), np.zeros(3)) / mass
    second = sum((own + m * np.outer(c - centre, c - centre) for m, c, own in parts), np.zeros((3, 3)))
    return float(mass), centre, np.trace(second) * np.eye(3) - second


def safe_step(plan: Plan, links: list[Link], longest: float) -> float:
    """s, up to `longest`: an eighth of the period of the stiffest node or body, with all springs along a direction."""
    x, pull, structure = np.asarray(plan.structure.nodes, float), np.zeros(len(plan.node_mass)), plan.structure
    for members in structure.members:
        if members.stiffness is None:
            continue
        for k, edge in enumerate(members.edges):
            pull[list(edge)] += 0.0 if members is structure.struts and k in plan.rigid else members.stiffness[k]
    alone = np.setdiff1d(np.flatnonzero(plan.node_mass), [node for link in links for node in link.nodes])
    squares = list(pull[alone] / plan.node_mass[alone])
    for link in links:
        nodes, turned = list(link.nodes), np.cross(np.eye(3)[:, None], x[list(link.nodes)] - link.centre)
        moved = np.r_[np.broadcast_to(np.eye(3)[:, None], turned.shape), turned]  # (motions, nodes, 3)
        K = np.einsum("anx,n,bnx->ab", moved, pull[nodes], moved)
        squares.append(eigh(K, block_diag(link.mass * np.eye(3), link.inertia), eigvals_only=True)[-1])
    fastest = math.sqrt(2 * max(squares, default=0))
    return float(min(longest, 2 * math.pi / fastest / 8 if fastest else longest))

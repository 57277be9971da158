"""Contact along struts, between their ends; and the laws of penalty contact at points there."""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_count, check_each
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import place_rows, take_rows
from jaxgrity.core.tracing import evaluated
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeVectors, Scalar
from jaxgrity.model.balls import Balls
from jaxgrity.model.capsules import Capsules, depths
from jaxgrity.model.friction import SmoothFriction
from jaxgrity.model.ground import ExactGround, Ground, PenaltyGround, contact_dissipation, contact_energy, normal_force
from jaxgrity.model.laws import Configuration, DissipationTerm, EnergyTerm, ForceLaw, Motion
from jaxgrity.model.placing import SETTLED_WITHIN
from jaxgrity.model.rigid_struts import LARGEST_GAP
from jaxgrity.model.rods import rods_of, turned
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene, as_dtype, with_terms
from jaxgrity.model.structure import per_member


class Points(eqx.Module):
    """Points x_p = (1 - s) x_i + s x_j along struts and rods of bodies. Positions and forces use the same weights."""

    struts: tuple[int, ...] = eqx.field(static=True)
    """strut of each point, or rod of a body: numbers as in `rods.py`"""
    ends: tuple[tuple[int, ...], tuple[int, ...]] = eqx.field(static=True)
    """nodes i and j of each point"""
    share: AnyArray
    """(points,), position s along the strut, from 0 to 1"""
    strength: AnyArray
    """(points,), factor of the ground's stiffness"""
    radius: AnyArray
    """(points,), m, of the strut at the point"""

    def of(self, x: NodeVectors) -> AnyArray:
        """(points, 3), positions or velocities of the points, from those of the nodes."""
        i, j = (take_rows(x, ends) for ends in self.ends)
        return i + self.share[:, None] * (j - i)

    def on_nodes(self, force: AnyArray, nodes: int) -> NodeVectors:
        """(nodes, 3), forces on the nodes that do the same work as those on the points, N."""
        at_j = self.share[:, None] * force
        return place_rows(force - at_j, self.ends[0], nodes) + place_rows(at_j, self.ends[1], nodes)

    def distances(self, ground: PenaltyGround, x: AnyArray) -> AnyArray:
        """(points,), m, of the struts from the `ground`, where points of their axes are at x."""
        return ground.signed_distance(x) - self.radius

    def names(self, what: str) -> tuple[str, ...]:
        return tuple(f"{what} rod {k} at {s:.2g} of its length" for k, s in zip(self.struts, np.asarray(self.share)))

    def times(self, factors: AnyArray) -> "Points":
        return eqx.tree_at(lambda p: p.strength, self, self.strength * factors)


def ground_beside_nodes(scene: Scene, strength: AnyArray) -> PenaltyGround | None:
    """The scene's ground with its stiffness times `strength`, without balls, which are at nodes; None if a report has
    removed it."""
    if not isinstance(scene.ground, PenaltyGround):
        return None
    stiffness = jnp.broadcast_to(scene.ground.stiffness, ()) * strength
    return eqx.tree_at(lambda g: g.stiffness, dataclasses.replace(scene.ground, balls=None), stiffness)


class RodContact(EnergyTerm):
    """Penalty contact at points along struts: U = sum_p k_p/2 min(0, phi(x_p) - r_p)^2.

    x_p is a point on the axis of a strut of radius r_p (m), and phi its distance from the ground (m). k_p (N/m) is the
    stiffness of the ground, divided by the number of points on the strut. Made by `with_contact_along_struts`.
    """

    points: Points
    name: ClassVar[str] = "penalty contact along struts"

    def energy(self, at: Configuration) -> Scalar:
        ground = ground_beside_nodes(at.scene, self.points.strength)
        if ground is None:
            return jnp.zeros((), at.q.dtype)
        return contact_energy(ground, self.points.distances(ground, self.points.of(at.q)))

    def parts(self, scene):
        return self.points.names("contact of")

    def scaled(self, factors):
        return RodContact(self.points.times(factors))


class RodContactDissipation(DissipationTerm):
    """Dissipation R at the points, like `ContactDissipation` at the nodes."""

    points: Points
    name: ClassVar[str] = "contact dissipation along struts"
    cause: ClassVar[str] = "contact"

    def dissipation(self, motion: Motion) -> Scalar:
        ground = ground_beside_nodes(motion.at.scene, self.points.strength)
        if ground is None or ground.dissipation is None:
            return jnp.zeros((), motion.v.dtype)
        x, v = self.points.of(motion.at.q), self.points.of(motion.v)
        return contact_dissipation(ground, jnp.sum(v * _normals(ground, x), axis=1), self.points.distances(ground, x))

    def parts(self, scene):
        return self.points.names("contact dissipation of")

    def scaled(self, factors):
        return RodContactDissipation(self.points.times(factors))


class RodFriction(ForceLaw):
    """Smooth friction at the points: F_t = -mu F_n v_t/sqrt(|v_t|^2 + eps^2), with mu interpolated between the ends."""

    points: Points
    name: ClassVar[str] = "smooth friction along struts"
    cause: ClassVar[str] = "friction"

    def force(self, motion: Motion, other_forces: NodeVectors) -> NodeVectors:
        # no term of R, where F_n has to be held fixed: `Motion` has it for nodes, not for these points
        scene, nodes = motion.at.scene, len(motion.v)
        ground = ground_beside_nodes(scene, self.points.strength)
        if ground is None or scene.friction is None:
            return jnp.zeros_like(motion.v)
        x, v = self.points.of(motion.at.q), self.points.of(motion.v)
        normals = _normals(ground, x)
        v_n = jnp.sum(v * normals, axis=1)
        spun = turned(scene.structure, self.points.struts, -self.points.radius[:, None] * normals, motion.at.q)
        slip = v - v_n[:, None] * normals + (0.0 if spun is None else spun @ motion.v)
        pressed = normal_force(ground, self.points.distances(ground, x), v_n)
        mu = self.points.of(jnp.broadcast_to(scene.friction.mu, (nodes,))[:, None] * jnp.ones((1, 3), x.dtype))[:, 0]
        force = -(mu * pressed / jnp.sqrt(jnp.sum(slip * slip, axis=1) + scene.friction.slip_speed**2))[:, None] * slip
        return self.points.on_nodes(force, nodes) + (0.0 if spun is None else spun.T @ force)


ALONG_STRUTS = RodContact, RodContactDissipation, RodFriction
"""The laws of contact along struts."""


@typed
def with_contact_along_struts(
    scene: Scene, count: int, struts: tuple[int, ...] | None = None, radius: Scalar | Sequence[float] = 0.0
) -> Scene:
    """The scene whose struts, and rods of bodies, touch the ground between their ends, too.

    So a rod touches edges, posts and crests between its nodes (docs/terrain.md). A strut with a radius r is a capsule:
    all that is within r of it. Its axis has the distance phi = r from the ground where it touches. Its ends become
    balls of that radius. Both ends get the force on a point x = (1 - s) x_i + s x_j by the same weights. The `rods` of
    bodies count on after the struts. Those of bodies with four basic points can roll, others slide.

    - Penalty contact acts at `count` evenly spaced points between the ends, with the ground's stiffness divided by
      `count`.
    - Exact contact acts at points that move along the strut: each of `count` equal parts has the nearest one to the
      ground, found anew in each step. Where the strut lies along a face, it has the other end of what lies there, too.
      All struts and contacts are then solved together. On a plane the ends touch first, so nothing is added.

    Args:
        scene: a scene with ground; on penalty contact with smooth friction or none.
        count: number of points, or parts, per strut.
        struts: numbers of the struts, and of rods of bodies; by default all.
        radius: r, m, of all of them or of each; 0: a thin rod.

    Returns:
        The scene whose ground has `capsules` (exact contact), or the scene with `RodContact`, and with dissipation and
        friction at the points if the scene has them (penalty contact).

    Raises:
        InputError: no ground, another friction law, less than one point; struts that are not there, or have such
            contact already; a radius that is negative, or not one for each strut.

    Example:
        >>> scene = jaxgrity.with_contact_along_struts(jaxgrity.load_scene("reference"), 3)
        >>> [law.name for law in scene.terms][0]
        'penalty contact along struts'
    """
    chosen = _chosen_struts(scene, count, struts)
    edges, ground = rods_of(scene.structure), cast(Ground, scene.ground)
    radii = per_member(radius, len(chosen), "radius")
    check_each("radius", radii, least=0.0, unit="m")
    ends = tuple(edges[k][0] for k in chosen), tuple(edges[k][1] for k in chosen)
    if radii.any():
        ground = dataclasses.replace(ground, balls=_balls(ground.balls, ends, radii, len(scene.structure.nodes)))
    if isinstance(ground, ExactGround):
        ground = dataclasses.replace(ground, capsules=Capsules(chosen, ends, count, radii))
    scene = dataclasses.replace(scene, ground=ground)
    return scene if ground.impulsive else with_terms(scene, *laws_along(scene, count, chosen, radii))


def laws_along(scene: Scene, count: int, struts: tuple[int, ...], radii: np.ndarray) -> tuple[Any, ...]:
    """The laws of penalty contact at `count` evenly spaced points along each of these struts."""
    edges, ground = rods_of(scene.structure), cast(PenaltyGround, scene.ground)
    each = tuple(k for k in struts for _ in range(count))
    share = np.tile(np.arange(1, count + 1) / (count + 1), len(struts))
    i, j = (tuple(edges[k][end] for k in each) for end in (0, 1))
    points = Points(each, (i, j), share, np.full(len(each), 1 / count), np.repeat(radii, count))
    return (
        RodContact(points),
        *([] if ground.dissipation is None else [RodContactDissipation(points)]),
        *([] if scene.friction is None else [RodFriction(points)]),
    )


def radii_along_struts(scene: Scene) -> dict[int, float]:
    """Radius, m, of each strut, or rod of a body, that touches the ground between its ends."""
    capsules = getattr(scene.ground, "capsules", None)
    pairs = [] if capsules is None else [(capsules.struts, capsules.radius)]
    pairs += [(law.points.struts, law.points.radius) for law in scene.terms if isinstance(law, RodContact)]
    return {k: float(r) for struts, radii in pairs for k, r in zip(struts, np.asarray(radii))}


def strut_distances(scene: Scene, q: NodeVectors) -> AnyArray:
    """m, from the ground, of the struts that touch it between their ends, at positions q, m; infinite last.

    On penalty contact there is a number for each point, on exact contact one for each strut: infinite where an end is
    nearer.
    """
    ground, found = scene.ground, list[AnyArray]()
    if isinstance(ground, ExactGround) and ground.capsules is not None and ground.surface is not None:
        found.append(-depths(ground, q))
    for points in (law.points for law in scene.terms if isinstance(law, RodContact)):
        at_points = ground_beside_nodes(scene, points.strength)
        found += [] if at_points is None else [points.distances(at_points, points.of(q))]
    return jnp.concatenate([*found, jnp.full(1, jnp.inf, q.dtype)])


def set_above(scene: Scene, q: NodeVectors, distance: Scalar) -> NodeVectors:
    """As `Ground.set_above`; struts that touch the ground between their ends count like nodes."""
    beside = jax.tree_util.Partial(strut_distances, scene) if _touches_along_struts(scene) else None
    return cast(Ground, scene.ground).set_above(q, distance, beside)


def set_down(scene: Scene, q: np.ndarray, depth: float) -> np.ndarray:
    """Positions q, m, set down as by `Ground.set_down`; `lifted` if a strut is then deeper."""
    moved = cast(Ground, scene.ground).set_down(q, depth, float(length_scale(scene)))
    return np.asarray(lifted(scene, moved, depth))


def lifted(scene: Scene, q: NodeVectors, depth: float) -> NodeVectors:
    """Positions q, m, moved up until no strut that touches the ground between its ends is deeper in it than `depth`.

    Raises `InputError` where that does not end.
    """
    if not _touches_along_struts(scene):
        return q
    within, missing = LARGEST_GAP / 10 * float(length_scale(scene)), np.inf
    with jax.enable_x64(True), evaluated():
        known = as_dtype(scene, "float64")
        # several times: on a slope or a curve, rising by the depth leaves the strut in the ground
        for _ in range(SETTLED_WITHIN):
            missing = -depth - float(jnp.min(strut_distances(known, jnp.asarray(q, float))))
            if missing <= within:
                return q
            q = q + np.array([0.0, 0.0, missing])
    raise InputError(f"ground: a rod is {missing:.3g} m too deep in it; expected a pose that stands on the ground")


def _touches_along_struts(scene: Scene) -> bool:
    """Whether a strut touches the ground between its ends."""
    capsules = getattr(scene.ground, "capsules", None)
    return capsules is not None or any(isinstance(law, RodContact) for law in scene.terms)


def _chosen_struts(scene: Scene, count: int, struts: tuple[int, ...] | None) -> tuple[int, ...]:
    """The struts of `with_contact_along_struts`, which are refused as it says."""
    ground = scene.ground
    if not isinstance(ground, PenaltyGround | ExactGround):
        raise InputError("contact along struts needs a ground; expected a scene with penalty or exact contact")
    if not ground.impulsive and scene.friction is not None and not isinstance(scene.friction, SmoothFriction):
        raise InputError(f"friction: {type(scene.friction).__name__} along struts; expected smooth friction, or none")
    known = range(len(rods_of(scene.structure)))
    chosen = tuple(known) if struts is None else tuple(struts)
    if not chosen or not set(chosen) <= set(known) or len(set(chosen)) < len(chosen):
        raise InputError(f"struts = {list(chosen)}: expected some of {len(known)} struts and rods of bodies, each once")
    check_count("count", count, 1)
    had = radii_along_struts(scene)
    if twice := sorted(set(chosen) & set(had)):
        raise InputError(f"struts = {list(chosen)}: the scene has contact along {twice} already; expected others")
    if had and ground.impulsive:
        raise InputError(f"struts = {list(chosen)}: the scene has contact along others already; expected all at once")
    return chosen


def _balls(balls: Balls | None, ends: tuple[tuple[int, ...], ...], radii: np.ndarray, nodes: int) -> Balls:
    """The balls of a ground, and those at the `ends` of capsules."""
    found = dict.fromkeys(range(nodes), 0.0) if balls is None else dict(zip(balls.nodes, np.asarray(balls.radius)))
    for node, radius in zip(ends[0] + ends[1], np.tile(radii, 2)):
        found[node] = max(found.get(node, 0.0), radius)
    return Balls(tuple(found), np.array(list(found.values())))


def _normals(ground: PenaltyGround, x: AnyArray) -> AnyArray:
    """(points, 3)."""
    return jnp.broadcast_to(jnp.asarray(ground.frame(x).normal, x.dtype), x.shape)

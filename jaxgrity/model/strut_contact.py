"""Contact between struts, and its laws on penalty contact."""

import dataclasses
from collections.abc import Sequence
from typing import ClassVar, cast

import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_count, check_each
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import dot, scale
from jaxgrity.core.tracing import traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import Edges, NodeVectors, Scalar
from jaxgrity.model.friction import SmoothFriction
from jaxgrity.model.ground import PenaltyGround, contact_dissipation, contact_energy, normal_force
from jaxgrity.model.laws import Configuration, DissipationTerm, EnergyTerm, ForceLaw, Motion
from jaxgrity.model.rigid_struts import LARGEST_GAP
from jaxgrity.model.rod_contact import ground_beside_nodes
from jaxgrity.model.rods import free_pairs, rods_of
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene, with_terms
from jaxgrity.model.structure import Structure, per_member
from jaxgrity.model.strut_pairs import (
    DEEP,
    ExactStrutContact,
    StrutPairs,
    difference,
    known_nearest,
    overlap,
    turned_between,
)

AT_ONCE = 8
"""Default number of pairs that a step solves on exact contact. A robot of six struts has 15, of which few are near."""


class StrutContact(EnergyTerm):
    """U = sum k_n/2 min(0, g)^2, with the gap g = |x - y| - r_i - r_j between the nearest points of two struts."""

    between: StrutPairs
    name: ClassVar[str] = "penalty contact between struts"

    def energy(self, at: Configuration) -> Scalar:
        ground = ground_beside_nodes(at.scene, self.between.strength)
        if ground is None:
            return jnp.zeros((), at.q.dtype)
        return contact_energy(ground, self.between.nearest(at.q).gap)

    def keeps(self, symmetry):
        return self.between.keep(symmetry)

    def parts(self, scene):
        return self.between.names("contact of")

    def scaled(self, factors):
        return StrutContact(self.between.times(factors))


class StrutContactDissipation(DissipationTerm):
    """Dissipation R at the nearest points, like `ContactDissipation` at the nodes."""

    between: StrutPairs
    name: ClassVar[str] = "contact dissipation between struts"
    cause: ClassVar[str] = "contact"

    def dissipation(self, motion: Motion) -> Scalar:
        ground = ground_beside_nodes(motion.at.scene, self.between.strength)
        if ground is None or ground.dissipation is None:
            return jnp.zeros((), motion.v.dtype)
        share, normal, gap = self.between.nearest(motion.at.q)
        v = difference(self.between.at_ends(motion.v), share)
        return contact_dissipation(ground, dot(v, normal), gap)

    def keeps(self, symmetry):
        return self.between.keep(symmetry)

    def parts(self, scene):
        return self.between.names("contact dissipation of")

    def scaled(self, factors):
        return StrutContactDissipation(self.between.times(factors))


class StrutFriction(ForceLaw):
    """Smooth friction at the nearest points: F_t = -mu F_n v_t/sqrt(|v_t|^2 + eps^2), with the mean mu of both."""

    between: StrutPairs
    name: ClassVar[str] = "smooth friction between struts"
    cause: ClassVar[str] = "friction"

    def force(self, motion: Motion, other_forces: NodeVectors) -> NodeVectors:
        scene, nodes = motion.at.scene, len(motion.v)
        ground = ground_beside_nodes(scene, self.between.strength)
        if ground is None or scene.friction is None:
            return jnp.zeros_like(motion.v)
        share, normal, gap = self.between.nearest(motion.at.q)
        v = difference(self.between.at_ends(motion.v), share)
        v_n, spun = dot(v, normal), turned_between(scene.structure, self.between, normal, motion.at.q)
        slip, pressed = v - scale(normal, v_n), normal_force(ground, gap, v_n)
        slip = slip if spun is None else slip + spun @ motion.v
        mu = self.between.mean(scene.friction.mu * jnp.ones_like(motion.v[:, 0]), share)
        speed = jnp.sqrt(dot(slip, slip) + scene.friction.slip_speed**2)
        force = scale(slip, -mu * pressed / speed)
        return self.between.on_nodes(force, share, nodes) + (0.0 if spun is None else spun.T @ force)

    def keeps(self, symmetry):
        return self.between.keep(symmetry)


BETWEEN_STRUTS = StrutContact, StrutContactDissipation, StrutFriction, ExactStrutContact
"""The laws of contact between struts."""


@typed
def with_contact_between_struts(
    scene: Scene, radius: Scalar | Sequence[float], pairs: Edges | None = None, at_once: int | None = None
) -> Scene:
    """The scene whose struts, and rods of bodies, touch each other.

    Each strut is a capsule: all that is within its radius r of its axis. Two struts touch where their axes come as near
    as r_i + r_j. The force acts along the shortest distance, on the axes. Ends get it by the position of the point.

    - On penalty contact, stiffness, dissipation and smooth friction are those of the ground, once for each pair.
    - On exact contact, and for rigid struts without ground, no impulse pulls, and none rebounds. Friction is a cone
      with the scene's mu. Where struts are nearly parallel, each pair has a second point. Struts and contacts are then
      solved together.

    The `rods` of bodies count on after the struts. Those of bodies with four basic points can roll, others slide.

    Args:
        scene: a scene with ground, or without spring struts; on penalty contact with smooth friction or none.
        radius: r, m, of all struts or of each strut; it may differ from the radius of contact with the ground.
        pairs: numbers of the two struts of each pair; by default all that no node or body joins.
        at_once: on exact contact, the number of pairs that a step solves: the nearest ones. A motion fails if more
            than that may touch in a step. By default up to 8.

    Returns:
        The scene with `StrutContact`, and with dissipation and friction if it has them (penalty contact), or with
        `ExactStrutContact` (exact contact), among its terms.

    Raises:
        InputError: no two struts without a common node. A radius that is not positive. Pairs that do not exist,
            share a node, or come twice. Spring struts without a ground, or another friction law. Struts that overlap at
            the start. A scene that has such contact already.

    Example:
        >>> scene = jaxgrity.model.with_contact_between_struts(jaxgrity.load_scene("exact"), radius=0.01)
        >>> scene.terms[0].name, len(scene.terms[0].between.pairs)
        ('exact contact between struts', 15)
    """
    members, ground, edges = scene.structure.struts, scene.ground, rods_of(scene.structure)
    if strut_contact(scene) is not None:
        raise InputError("contact between struts: the scene has it already; expected a scene without")
    chosen = _chosen_pairs(scene.structure, pairs)
    exact = ground.impulsive if ground is not None else members is None or members.rigid
    if not exact and not isinstance(ground, PenaltyGround):
        raise InputError("contact between struts has the ground's stiffness; expected a ground, or no spring struts")
    if not exact and scene.friction is not None and not isinstance(scene.friction, SmoothFriction):
        raise InputError(f"friction: {type(scene.friction).__name__} between struts; expected smooth friction, or none")
    radii = per_member(radius, len(edges), "radius")
    check_each("radius", radii, above=0.0, unit="m")
    if at_once is not None:
        check_count("at_once", at_once, 1)
    ends = tuple(tuple(edges[pair[strut]][end] for pair in chosen) for strut in (0, 1) for end in (0, 1))
    between = StrutPairs(chosen, ends, radii[np.array(chosen)], np.ones(len(chosen)))
    _check_apart(scene, between)
    if exact:
        return with_terms(scene, ExactStrutContact(between, min(len(chosen), at_once or AT_ONCE)))
    return with_terms(
        scene,
        StrutContact(between),
        *([] if cast(PenaltyGround, ground).dissipation is None else [StrutContactDissipation(between)]),
        *([] if scene.friction is None else [StrutFriction(between)]),
    )


def strut_contact(scene: Scene) -> StrutContact | ExactStrutContact | None:
    """The law by which struts of the scene touch each other; None: they do not."""
    return next((law for law in scene.terms if isinstance(law, StrutContact | ExactStrutContact)), None)


def exact_strut_contact(scene: Scene) -> ExactStrutContact | None:
    """The same on exact contact."""
    return next((law for law in scene.terms if isinstance(law, ExactStrutContact)), None)


def without_strut_contact(scene: Scene) -> Scene:
    """The scene whose struts pass through each other."""
    if strut_contact(scene) is None:
        return scene
    return dataclasses.replace(scene, terms=tuple(law for law in scene.terms if not isinstance(law, BETWEEN_STRUTS)))


def touching_like(scene: Scene, other: Scene) -> Scene:
    """The scene, whose struts do not touch each other, with contact between the same struts as in `other`."""
    law = strut_contact(other)
    if law is None:
        return scene
    at_once = law.at_once if isinstance(law, ExactStrutContact) else None
    return with_contact_between_struts(scene, radius_of_struts(scene, law.between), law.between.pairs, at_once)


def radius_of_struts(scene: Scene, between: StrutPairs) -> list[float]:
    """Radius of each strut, m; of a strut without a pair that of another one."""
    radii = np.asarray(between.radius, float)
    known = dict(zip(np.array(between.pairs).ravel().tolist(), radii.ravel().tolist()))
    return [known.get(k, float(radii.flat[0])) for k in range(len(rods_of(scene.structure)))]


def _chosen_pairs(structure: Structure, pairs: Edges | None) -> Edges:
    """The pairs of `with_contact_between_struts`, which are refused as it says."""
    edges, free = rods_of(structure), free_pairs(structure)
    if pairs is None and not free:
        found = f"contact between struts: the scene's {len(edges)} have no two without a common node"
        raise InputError(f"{found}; expected struts, or rods of bodies, that may touch")
    if pairs is None:
        return free
    owner = [None] * structure.first_cable + [k for k, body in enumerate(structure.bodies) for _ in body.rods]
    for pair in pairs:
        known = pair[0] != pair[1] and set(pair) <= set(range(len(edges)))
        if not known or set(edges[pair[0]]) & set(edges[pair[1]]) or owner[pair[0]] == owner[pair[1]] is not None:
            found = f"pairs has {list(pair)}: expected two of {len(edges)} struts and rods of bodies"
            raise InputError(f"{found}, without a common node, and not of one body")
    if not pairs or len(set(map(frozenset, pairs))) < len(pairs):
        raise InputError(f"pairs = {list(map(list, pairs))}: expected at least one, and each once")
    return tuple(pairs)


def _check_apart(scene: Scene, between: StrutPairs) -> None:
    if traced((scene, between)):
        return
    q, size = np.asarray(scene.structure.nodes, float), float(length_scale(scene))
    gap = known_nearest(between, q).gap
    if gap.min() < -(LARGEST_GAP + DEEP) * size:
        raise InputError(overlap(between, q, int(gap.argmin())))

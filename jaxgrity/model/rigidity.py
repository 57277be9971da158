"""What keeps its distance: the ends of rigid struts, the basic points of rigid bodies, and their pinned nodes."""

import itertools
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from jaxgrity.core.primitives import edge_vectors, length
from jaxgrity.core.types import Edges, NodeVectors, PerMember, Scalar, namespace_of
from jaxgrity.model.actuation import rest_length
from jaxgrity.model.bodies import Bodies, Body, body_moments
from jaxgrity.model.body_points import body_pairs, carrying, following, independent_nodes
from jaxgrity.model.laws import SAME, Constraint, SceneParts, Symmetry
from jaxgrity.model.rigid_struts import RigidStruts, directions_between
from jaxgrity.model.slides import Slides, slides_of
from jaxgrity.model.structure import edge_lengths


class RigidBodies(Constraint):
    """The basic points of a body, and its pinned nodes, keep their distances; its other points follow."""

    bodies: Bodies
    nodes: NodeVectors
    """m, at the start"""
    name: ClassVar[str] = "rigid bodies"

    @classmethod
    def of(cls, scene: SceneParts) -> "RigidBodies | None":
        return cls(scene.structure.bodies, scene.structure.nodes) if scene.structure.bodies else None

    def keeps(self, symmetry):
        places = {frozenset(body.points): body for body in self.bodies}
        return all(_same(body, places, symmetry, np.asarray(self.nodes, float)) for body in self.bodies)

    def directions(self, q, size):
        return directions_between(q, body_pairs(self.bodies)[0])

    def gaps(self, q, t):
        (edges, lengths), xp = body_pairs(self.bodies), namespace_of(q)
        if xp is jnp:
            now, off = length(edge_vectors(q, edges)), q - following(self.bodies, q)
        else:
            carry, lengths = (np.asarray(x, float) for x in (carrying(self.bodies, len(q)), lengths))
            now, off = edge_lengths(q, edges), q - carry @ q[np.array(independent_nodes(self.bodies, len(q)))]
        return xp.concatenate([xp.abs(now - lengths), xp.sqrt((off * off).sum(1))])

    def complaint(self, q, t, part):
        edges, lengths = body_pairs(self.bodies)
        if part < len(edges):
            found = edge_lengths(q, edges)[part]
            return (
                f"nodes {list(edges[part])} of a rigid body start {found:.6g} m apart; expected {lengths[part]:.6g} m"
            )
        return f"node {part - len(edges)} starts beside the place that its rigid body has for it; expected it there"


RIGID = (RigidStruts, RigidBodies)
"""The constraints on distances."""
LINKS = (*RIGID, Slides)
"""The constraints between nodes, which multipliers keep too."""


def rigid_pairs(scene: SceneParts) -> Edges:
    """The pairs of nodes whose distance is a constraint: the rigid struts, then those of bodies."""
    structure = scene.structure
    struts = structure.struts.edges if structure.struts is not None and structure.struts.rigid else ()
    return (*struts, *body_pairs(structure.bodies, structure.fixed)[0]) if structure.bodies else struts


def rigid_lengths(scene: SceneParts, t: Scalar) -> PerMember:
    """Their distances at the time t, m."""
    structure, parts = scene.structure, []
    if structure.struts is not None and structure.struts.rigid:
        parts.append(rest_length(structure.struts, scene.gait, t, 0))
    if not structure.bodies:
        return parts[0]
    return jnp.concatenate([*parts, body_pairs(structure.bodies, structure.fixed)[1]])


def linked(scene: SceneParts) -> bool:
    """Whether there are any `LINKS`."""
    return bool(rigid_pairs(scene)) or slides_of(scene) is not None


def lines_between_points(bodies: Bodies) -> Edges:
    """The lines between all points of each body: what figures and distances from obstacles take for the body."""
    return tuple(pair for body in bodies for pair in itertools.combinations(body.points, 2))


def _same(body: Body, places: dict[frozenset[int], Body], symmetry: Symmetry, x: np.ndarray) -> bool:
    """Whether the body whose place this one takes has the same points, and the same inertia about them.

    Which of the points are basic, and which pinned, changes no motion.
    """
    nodes, turn = symmetry.nodes, symmetry.matrix
    other = places.get(frozenset(nodes[k] for k in body.points))
    if other is None or {frozenset(nodes[k] for k in rod) for rod in body.rods} != set(map(frozenset, other.rods)):
        return False
    # the mean of all nodes stays where it is
    moments = (tuple(np.asarray(part, float) for part in body_moments(each, x - x.mean(0))) for each in (body, other))
    (mass, centre, inertia), (other_mass, other_centre, other_inertia) = moments
    pairs = (mass, other_mass), (turn @ centre, other_centre), (turn @ inertia @ turn.T, other_inertia)
    scales = mass, np.abs(x - x.mean(0)).max(), np.abs(inertia).max()
    return all(np.allclose(*pair, rtol=0, atol=SAME * scale) for pair, scale in zip(pairs, scales))

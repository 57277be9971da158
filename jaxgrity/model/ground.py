"""The ground: how it pushes back, as a spring or as a constraint, where its plane or its surface is."""

import math
from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar

import equinox as eqx
import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxgrity.core.arguments import check_all_finite
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import along, component, half_squares, inner, ones, positive_part
from jaxgrity.core.tracing import as_incline
from jaxgrity.core.types import AnyArray, NodeVectors, PerNode, Scalar, Vector, as_float, as_float_or_none
from jaxgrity.model.balls import Balls, refuse_balls
from jaxgrity.model.laws import Configuration, Constraint, DissipationTerm, EnergyTerm, Law, Motion, node_names
from jaxgrity.model.placing import above, check_placed, down
from jaxgrity.model.rigid_struts import LARGEST_GAP
from jaxgrity.model.surface import AXES, DistanceAndAxes, Frame, Slope, Surface, height_at, measured_at

UnitVector = tuple[float, float, float]

ROUNDING = 1e-12
"""Depth added to that of a node at rest on penalty ground, m for a body of one metre: rounding must not lift it."""
TOUCHING = 1e-6
"""Largest gap at which exact ground holds a node at rest, m for a body of one metre."""


class Ground(eqx.Module):
    """A plane through the origin, level or falling towards +x: phi(x) = n·x, n = (sin theta, 0, cos theta).

    Or any other `Surface` in its place. Raises `InputError` where a surface comes with an incline.
    """

    if TYPE_CHECKING:  # type checkers would take an abstract variable for the first field of every ground

        @property
        def incline(self) -> float: ...
    else:
        incline: eqx.AbstractVar[float]
        """theta, rad"""
    surface: Surface | None = eqx.field(default=None, kw_only=True)
    """where the ground is; None: the plane"""
    offset: Vector | None = eqx.field(converter=as_float_or_none, default=None, kw_only=True)
    """m, (3,): how far the surface has been moved; None: not at all"""
    balls: Balls | None = eqx.field(default=None, kw_only=True)
    """the nodes that touch it, and their radii; None: all nodes, themselves"""
    impulsive: eqx.AbstractClassVar[bool]
    """whether it pushes by impulses, as a constraint, or by forces, as a spring"""
    touched_below: eqx.AbstractClassVar[float]
    """m: a node of a body of one metre touches the ground, in the frames of a trajectory, where phi is less"""

    def __check_init__(self):
        check_all_finite(self, "ground")
        if self.surface is not None and self.incline:
            raise InputError(f"ground.incline = {self.incline}: it is that of the plane; expected none with a surface")
        if self.surface is None and self.offset is not None:
            raise InputError("ground.offset moves a surface; expected none on the plane")
        if self.balls is not None:
            self.balls.check_ground(self.surface)
        if np.shape(self.offset) not in ((), (3,)):  # () is that of None
            raise InputError(f"ground.offset has shape {np.shape(self.offset)}; expected (3,)")

    @property
    def normal(self) -> UnitVector:
        """Outward unit normal n of the plane. Raises `InputError` on a surface, where it varies: see `frame`."""
        if self.surface is not None:
            raise InputError("the normal of this ground differs from place to place; expected a plane")
        return (math.sin(self.incline), 0.0, math.cos(self.incline))

    @property
    def tangents(self) -> tuple[UnitVector, UnitVector]:
        """Two unit vectors in the plane: down the slope, and level."""
        return (math.cos(self.incline), 0.0, -math.sin(self.incline)), (0.0, 1.0, 0.0)

    def signed_distance(self, q: NodeVectors) -> PerNode:
        """phi, m: height of each node, or ball, along the ground's normal, negative inside; infinite of what passes."""
        phi = component(q, self.normal) if self.surface is None else self.surface.signed_distance(self.relative(q))
        return phi if self.balls is None else self.balls.gaps(phi)

    def frame(self, q: NodeVectors) -> Frame:
        """The normal and two tangents: constants on the plane, a row for each of the nodes at q on a surface."""
        if self.surface is None:
            return Frame(self.normal, self.tangents)
        return self.surface.frame(self.relative(q))

    def relative(self, q: NodeVectors) -> NodeVectors:
        """The nodes q, m, as the surface that is not moved sees them."""
        return q if self.offset is None else q - along(ones(component(q, AXES[0])), self.offset)

    def height(self, x: ArrayLike, y: ArrayLike) -> np.ndarray:
        """m, z of the ground at places x, y, m; -infinity where there is none. For use before and after rollouts."""
        surface = Slope(self.incline) if self.surface is None else self.surface
        moved = np.zeros(3) if self.offset is None else np.asarray(self.offset, float)
        return height_at(surface, np.asarray(x, float) - moved[0], np.asarray(y, float) - moved[1]) + moved[2]

    def measured(self, q: np.ndarray) -> DistanceAndAxes:
        """Distances and frames at positions `q` (..., nodes, 3), m, in float64: for use before and after rollouts."""
        if self.surface is None:
            axes = np.array([self.normal, *self.tangents])
            phi = q @ axes[0] if self.balls is None else np.asarray(self.balls.gaps(q @ axes[0]))
            return DistanceAndAxes(phi, np.broadcast_to(axes, (*q.shape[:-1], 3, 3)))
        return measured_at(self, np.asarray(q, float))

    def set_down(self, q: np.ndarray, depth: float, size: float = 1.0) -> np.ndarray:
        """(nodes, 3): the nodes q, m, of a body of `size` (`length_scale`), moved along the lowest one's normal until
        that is so deep (m) in the ground.

        Where normals push it to and fro, as at an edge, it moves up or down. `InputError` where that does not help.
        """
        moved, ended = down(np.asarray(q, float), depth, LARGEST_GAP / 10 * size, self.measured, self.surface is None)
        if not ended:
            with jax.enable_x64(True):
                moved = np.asarray(self.set_above(jax.numpy.asarray(q, float), -depth))
            check_placed(self.measured(moved).distance, depth, size)
        return moved

    def set_above(self, q: NodeVectors, distance: Scalar) -> NodeVectors:
        """The nodes q, m, moved up or down until the nearest is `distance` (m) from the ground; it can be traced."""
        refuse_balls(self.balls)
        surface, moved = Slope(self.incline) if self.surface is None else self.surface, self.relative(q)
        return q + above(moved, distance, surface.signed_distance, surface.height) - moved

    def keeps(self, symmetry) -> bool:
        """Whether the ground is the same after the map; of surfaces only what leaves every place where it is."""
        axes = [self.normal] if self.surface is None else AXES
        return all(map(symmetry.leaves, axes)) and (self.balls is None or self.balls.keep(symmetry.nodes))

    @abstractmethod
    def laws(self) -> tuple[Law, ...]:
        """What the ground does to the nodes; friction is not among it."""

    @abstractmethod
    def normal_force(self, q: NodeVectors, v: NodeVectors) -> PerNode | None:
        """F_n >= 0, N, by which it presses on each node, where the state of the nodes says so; None: by impulses."""

    @abstractmethod
    def resting_depth(self, weight: float, nodes: int) -> float:
        """How deep, m, so many nodes stand in it that carry the weight (N)."""

    def touching_depth(self, weight: float, nodes: int, size: float) -> float:
        """The same, m, of a body of `size` (`length_scale`); where ground pushes back, so deep that it is touched."""
        return self.resting_depth(weight, nodes) + (0.0 if self.impulsive else ROUNDING * size)


class PenaltyGround(Ground):
    """A ground that pushes back as a spring: F_n = k_n pen max(0, 1 - alpha v_n), pen = max(0, -phi).

    Raises `InputError` where stiffness or dissipation is not positive; None for a dissipation that is not modelled.
    """

    stiffness: Scalar = eqx.field(converter=as_float)
    """k_n, N/m, per node"""
    dissipation: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """alpha of Hunt and Crossley's law, s/m; None: not modelled"""
    incline: float = eqx.field(static=True, converter=as_incline, default=0.0)
    impulsive: ClassVar[bool] = False
    touched_below: ClassVar[float] = 0.0

    def __check_init__(self):
        for name in ("stiffness", "dissipation"):
            value = getattr(self, name)
            if isinstance(value, np.ndarray) and not np.all(value > 0):
                absent = ", or None where it is not modelled" if name == "dissipation" else ""
                raise InputError(f"ground.{name} = {value}: expected a positive number{absent}")

    def laws(self):
        return (PenaltyContact(self), *([] if self.dissipation is None else [ContactDissipation(self)]))

    def normal_force(self, q, v):
        v_n = None if self.dissipation is None else component(v, self.frame(q).normal)
        return normal_force(self, self.signed_distance(q), v_n)

    def resting_depth(self, weight, nodes):
        return weight / float(self.stiffness) / nodes


class ExactGround(Ground):
    """A ground that no node enters: phi >= 0, p_n >= 0, p_n phi = 0 (Signorini), p_n its impulses."""

    incline: float = eqx.field(static=True, converter=as_incline, default=0.0)
    restitution: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """e: a node that hits the ground at speed v leaves it at e v; None: it stays"""
    impulsive: ClassVar[bool] = True
    touched_below: ClassVar[float] = 2e-3

    def __check_init__(self):
        e = self.restitution
        if isinstance(e, np.ndarray) and not np.all((e >= 0) & (e <= 1)):
            raise InputError(f"ground.restitution = {e}: expected a number from 0 to 1")

    def laws(self):
        return (ExactContact(self),)

    def normal_force(self, q, v):
        return None

    def resting_depth(self, weight, nodes):
        return 0.0


class PenaltyContact(EnergyTerm):
    """U = sum k_n/2 min(0, phi)^2."""

    ground: PenaltyGround
    name: ClassVar[str] = "penalty contact"

    def energy(self, at: Configuration) -> Scalar:
        return contact_energy(self.ground, self.ground.signed_distance(at.q))

    def keeps(self, symmetry):
        return self.ground.keeps(symmetry)

    def parts(self, scene):
        return node_names("contact of", scene)


class ContactDissipation(DissipationTerm):
    """R whose gradient turns k_n pen into Hunt and Crossley's k_n pen max(0, 1 - alpha v_n)."""

    ground: PenaltyGround
    name: ClassVar[str] = "contact dissipation"
    cause: ClassVar[str] = "contact"

    def dissipation(self, motion: Motion) -> Scalar:
        v_n = component(motion.v, self.ground.frame(motion.at.q).normal)
        return contact_dissipation(self.ground, v_n, self.ground.signed_distance(motion.at.q))

    def keeps(self, symmetry):
        return self.ground.keeps(symmetry)

    def parts(self, scene):
        return node_names("contact dissipation of", scene)


class ExactContact(Constraint):
    """phi >= 0 for every node, by impulses along the normal that only push."""

    ground: ExactGround
    name: ClassVar[str] = "exact contact"

    def keeps(self, symmetry):
        return self.ground.keeps(symmetry)

    def directions(self, q, size):
        return held_directions(self.ground, slice(1), q, size)

    def gaps(self, q, t):
        known = isinstance(q, np.ndarray)
        return -(self.ground.measured(q).distance if known else self.ground.signed_distance(q))

    def complaint(self, q, t, part):
        depth = -self.ground.measured(q).distance[part]
        return f"node {part} starts {depth:.3g} m below the ground; expected: on exact contact, on or above it"


def held_directions(ground: Ground, axes: slice, q: np.ndarray, size: float) -> np.ndarray:
    """(constraints, nodes, 3): some of the normal and the two tangents, for each node that touches the ground."""
    rows, (distance, frames) = [], ground.measured(q)
    for node in np.flatnonzero(distance <= TOUCHING * size):
        for direction in frames[node, axes]:
            rows.append(np.zeros(q.shape))
            rows[-1][node] = direction
    return np.array(rows).reshape(-1, *q.shape)


def contact_energy(ground: PenaltyGround, phi: PerNode) -> Scalar:
    """U = sum k_n/2 min(0, phi)^2, J."""
    return half_squares(ground.stiffness, positive_part(-phi))


def contact_dissipation(ground: PenaltyGround, v_n: PerNode, phi: PerNode) -> Scalar:
    """R = sum k_n pen (alpha/2 c^2 + v_n - c), W, with c = min(v_n, 1/alpha) and pen = max(0, -phi).

    Its gradient in v_n is k_n pen min(alpha v_n, 1): past 1/alpha the contact lets go, it never pulls. Hunt and
    Crossley 1975, doi:10.1115/1.3423596.
    """
    alpha = ground.dissipation
    assert alpha is not None, "a ground without dissipation has no R"
    released = positive_part(v_n - 1 / alpha)
    closing = v_n - released
    elastic = ground.stiffness * positive_part(-phi)
    return half_squares(alpha * elastic, closing) + inner(elastic, released)


def normal_force(ground: PenaltyGround, phi: PerNode, v_n: PerNode | None) -> PerNode:
    """F_n = -dU/dphi - dR/dv_n >= 0, N: what friction is proportional to. `v_n` counts where the ground dissipates."""
    elastic: AnyArray = jax.grad(contact_energy, argnums=1)(ground, phi)
    if ground.dissipation is None:
        return -elastic
    return -elastic - jax.grad(contact_dissipation, argnums=1)(ground, v_n, phi)

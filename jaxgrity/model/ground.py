"""The ground: a plane or a surface that pushes back as a spring or as a constraint."""

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar

import equinox as eqx
import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxgrity.core.arguments import as_table, check_all_finite, check_each, check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import along, component, half_squares, inner, ones, positive_part
from jaxgrity.core.tracing import as_incline
from jaxgrity.core.types import AnyArray, NodeVectors, PerNode, Scalar, Vector, as_float, as_float_or_none
from jaxgrity.model.balls import Balls
from jaxgrity.model.capsules import Capsules, and_of_struts
from jaxgrity.model.laws import Configuration, Constraint, DissipationTerm, EnergyTerm, Law, Motion, node_names
from jaxgrity.model.placing import above, check_placed, down, held_directions
from jaxgrity.model.rigid_struts import LARGEST_GAP
from jaxgrity.model.surface import AXES, DistanceAndAxes, Frame, Slope, Surface, height_at, measured_at

UnitVector = tuple[float, float, float]

DEEPER_BY = 1e-12
"""Depth added to that of a node at rest on penalty ground, m for a body of one metre, so rounding does not lift it."""
DEEP_ON_CURVES = 5e-4
"""Depth in curved ground at which nodes may start, m for a body of one metre. Steps of 10 ms end 4e-5 deep in bowls.
Struts too may start at that depth in edges."""


class Ground(eqx.Module):
    """Interface of grounds: a plane through the origin that falls towards +x, or another `Surface`.

    The plane is phi(x) = n·x with n = (sin theta, 0, cos theta). Raises `InputError` for a surface with an incline.
    """

    if TYPE_CHECKING:  # type checkers would take an abstract variable for the first field of every ground

        @property
        def incline(self) -> float: ...
    else:
        incline: eqx.AbstractVar[float]
        """angle theta of the plane, rad"""
    surface: Surface | None = eqx.field(default=None, kw_only=True)
    """shape of the ground; None: the plane"""
    offset: Vector | None = eqx.field(converter=as_float_or_none, default=None, kw_only=True)
    """(3,), shift of the surface, m; None: no shift"""
    balls: Balls | None = eqx.field(default=None, kw_only=True)
    """nodes that touch the ground, with their radii; None: all nodes, as points"""
    impulsive: eqx.AbstractClassVar[bool]
    """whether the ground pushes by impulses (a constraint) or by forces (a spring)"""
    touched_below: eqx.AbstractClassVar[float]
    """distance phi below which a node counts as touching in the frames of a motion, m for a body of one metre"""

    def __check_init__(self):
        check_all_finite(self, "ground")
        if self.surface is not None and self.incline:
            raise InputError(f"ground.incline = {self.incline}: it is that of the plane; expected none with a surface")
        if self.surface is None and self.offset is not None:
            raise InputError("ground.offset moves a surface; expected none on the plane")
        check_each("ground.offset", self.offset, shape=(3,))

    @property
    def normal(self) -> UnitVector:
        """Outward unit normal n of the plane. Raises `InputError` for a surface, whose normal varies (`frame`)."""
        if self.surface is not None:
            raise InputError("the normal of this ground differs from place to place; expected a plane")
        return (math.sin(self.incline), 0.0, math.cos(self.incline))

    @property
    def tangents(self) -> tuple[UnitVector, UnitVector]:
        """Two unit vectors in the plane: down the slope, and level."""
        return (math.cos(self.incline), 0.0, -math.sin(self.incline)), (0.0, 1.0, 0.0)

    def signed_distance(self, q: NodeVectors) -> PerNode:
        """(nodes,), distance phi of each node or ball from the ground, m, negative inside; infinite for nodes that
        pass."""
        phi = component(q, self.normal) if self.surface is None else self.surface.signed_distance(self.relative(q))
        return phi if self.balls is None else self.balls.gaps(phi)

    def frame(self, q: NodeVectors) -> Frame:
        """Normal and two tangents: constant for the plane, one row per node for a surface."""
        if self.surface is None:
            return Frame(self.normal, self.tangents)
        return self.surface.frame(self.relative(q))

    def relative(self, q: NodeVectors) -> NodeVectors:
        """Positions q relative to the shifted surface, m."""
        return q if self.offset is None else q - along(ones(component(q, AXES[0])), self.offset)

    def height(self, x: ArrayLike, y: ArrayLike) -> np.ndarray:
        """Height z of the ground at x, y, m; -infinity without ground. Do not use it in rollouts."""
        if self.surface is None:
            return Slope(self.incline).height(*np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float)))
        moved = np.zeros(3) if self.offset is None else np.asarray(self.offset, float)
        return height_at(self.surface, np.asarray(x, float) - moved[0], np.asarray(y, float) - moved[1]) + moved[2]

    def measured(self, q: np.ndarray) -> DistanceAndAxes:
        """Distances and frames at positions `q` (..., nodes, 3), m, in float64. Do not use it in rollouts."""
        if self.surface is None:
            axes = np.array([self.normal, *self.tangents])
            phi = q @ axes[0] if self.balls is None else np.asarray(self.balls.gaps(q @ axes[0]))
            return DistanceAndAxes(phi, np.broadcast_to(axes, (*q.shape[:-1], 3, 3)))
        return measured_at(self, np.asarray(q, float))

    def set_down(self, q: np.ndarray, depth: float, size: float = 1.0) -> np.ndarray:
        """(nodes, 3), positions of a body set down, m: moved along the lowest node's normal until that node has
        `depth`, m.

        `size` is the body's `length_scale`. At an edge, where normals push it to and fro, the body moves up or down.
        Raises `InputError` if that does not help, and for positions and depths that are no numbers.
        """
        q, depth = as_table("q", q), check_number("depth", depth, unit="m")
        moved, ended = down(q, depth, LARGEST_GAP / 10 * size, self.measured, self.surface is None)
        if not ended:
            with jax.enable_x64(True):
                moved = np.asarray(self.set_above(jax.numpy.asarray(q), -depth))
            check_placed(self.measured(moved).distance, depth, size)
        return moved

    def set_above(
        self, q: NodeVectors, distance: Scalar, beside: Callable[[NodeVectors], AnyArray] | None = None
    ) -> NodeVectors:
        """Positions q moved up or down until the nearest node or ball has `distance` (m) from the ground; traceable.

        `beside` is a function of positions. Its distances, m, count like those of nodes.
        """
        return above(q, distance, self, beside)

    def keeps(self, symmetry) -> bool:
        """Whether the symmetry maps the ground on itself; for surfaces, only the identity does."""
        axes = [self.normal] if self.surface is None else AXES
        return all(map(symmetry.leaves, axes)) and (self.balls is None or self.balls.keep(symmetry.nodes))

    @abstractmethod
    def laws(self) -> tuple[Law, ...]:
        """Contact laws of the ground, without friction."""

    @abstractmethod
    def normal_force(self, q: NodeVectors, v: NodeVectors) -> PerNode | None:
        """(nodes,), normal force F_n >= 0 on each node, N; None if contact acts by impulses."""

    @abstractmethod
    def resting_depth(self, weight: float, nodes: int) -> float:
        """Depth of `nodes` nodes that carry the weight (N), m."""

    def touching_depth(self, weight: float, nodes: int, size: float) -> float:
        """The same depth, m, for a body of `size` (`length_scale`), deep enough that the nodes count as touching."""
        return self.resting_depth(weight, nodes) + (0.0 if self.impulsive else DEEPER_BY * size)


class PenaltyGround(Ground):
    """Penalty contact: the ground is a spring, F_n = k_n pen max(0, 1 - alpha v_n), pen = max(0, -phi).

    Raises `InputError` if stiffness or dissipation is not positive.
    """

    stiffness: Scalar = eqx.field(converter=as_float)
    """stiffness k_n per node, N/m"""
    dissipation: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """dissipation alpha of Hunt and Crossley's law, s/m; None: no dissipation"""
    incline: float = eqx.field(static=True, converter=as_incline, default=0.0)
    impulsive: ClassVar[bool] = False
    touched_below: ClassVar[float] = 0.0

    def __check_init__(self):
        check_each("ground.stiffness", self.stiffness, shape=(), above=0.0, unit="N/m")
        if isinstance(self.dissipation, np.ndarray) and self.dissipation.ndim == 0 and self.dissipation == 0:
            raise InputError("ground.dissipation = 0 s/m: expected a positive number, or None where it is not modelled")
        check_each("ground.dissipation", self.dissipation, shape=(), above=0.0, unit="s/m")

    def laws(self):
        return (PenaltyContact(self), *([] if self.dissipation is None else [ContactDissipation(self)]))

    def normal_force(self, q, v):
        v_n = None if self.dissipation is None else component(v, self.frame(q).normal)
        return normal_force(self, self.signed_distance(q), v_n)

    def resting_depth(self, weight, nodes):
        return weight / float(self.stiffness) / nodes


class ExactGround(Ground):
    """Exact contact: no node enters the ground. phi >= 0, p_n >= 0, p_n phi = 0 (Signorini), with impulses p_n."""

    incline: float = eqx.field(static=True, converter=as_incline, default=0.0)
    restitution: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """coefficient e: a node that hits the ground at speed v leaves it at e v; None: 0"""
    capsules: Capsules | None = eqx.field(default=None, kw_only=True)
    """struts that touch uneven ground between their ends; None: none does"""
    impulsive: ClassVar[bool] = True
    touched_below: ClassVar[float] = 2e-3

    def __check_init__(self):
        check_each("ground.restitution", self.restitution, shape=(), least=0.0, most=1.0)

    def keeps(self, symmetry):
        return super().keeps(symmetry) and (self.capsules is None or self.capsules.keep(symmetry.nodes))

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
    """Dissipation of penalty contact: with it, the force is k_n pen max(0, 1 - alpha v_n) (Hunt and Crossley)."""

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
    """phi >= 0 for every node, by impulses along the normal that never pull."""

    ground: ExactGround
    name: ClassVar[str] = "exact contact"

    def keeps(self, symmetry):
        return self.ground.keeps(symmetry)

    def directions(self, q, size):
        return held_directions(self.ground, slice(1), q, size)

    def gaps(self, q, t):
        phi = self.ground.measured(q).distance if isinstance(q, np.ndarray) else self.ground.signed_distance(q)
        return and_of_struts(-phi, self.ground, q)

    @property
    def left_by_steps(self) -> float:
        surface, capsules = self.ground.surface, self.ground.capsules
        curved = surface is not None and any(solid.curved for solid in surface.solids)
        return DEEP_ON_CURVES if curved or capsules is not None else 0.0

    def complaint(self, q, t, part):
        if part >= len(q):
            rod, depth = self.ground.capsules.struts[part - len(q)], self.gaps(q, t)[part]
            return f"rod {rod} starts {depth:.3g} m in the ground between its ends; expected: above it, or on it"
        depth = -self.ground.measured(q).distance[part]
        wanted = "on exact contact, on or above it, as from ground.set_down(positions, 0.0)"
        return f"node {part} starts {depth:.3g} m below the ground; expected: {wanted}"


def contact_energy(ground: PenaltyGround, phi: PerNode) -> Scalar:
    """U = sum k_n/2 min(0, phi)^2, J."""
    return half_squares(ground.stiffness, positive_part(-phi))


def contact_dissipation(ground: PenaltyGround, v_n: PerNode, phi: PerNode) -> Scalar:
    """R = sum k_n pen (alpha/2 c^2 + v_n - c), W, with c = min(v_n, 1/alpha) and pen = max(0, -phi).

    Its slope in v_n is k_n pen min(alpha v_n, 1): contact never pulls. Hunt and Crossley 1975, doi:10.1115/1.3423596.
    """
    alpha = ground.dissipation
    assert alpha is not None, "a ground without dissipation has no R"
    released = positive_part(v_n - 1 / alpha)
    closing = v_n - released
    elastic = ground.stiffness * positive_part(-phi)
    return half_squares(alpha * elastic, closing) + inner(elastic, released)


def normal_force(ground: PenaltyGround, phi: PerNode, v_n: PerNode | None) -> PerNode:
    """Normal force F_n = -dU/dphi - dR/dv_n >= 0, N; friction is proportional to it. `v_n` matters with dissipation."""
    elastic: AnyArray = jax.grad(contact_energy, argnums=1)(ground, phi)
    damped = 0.0 if ground.dissipation is None else jax.grad(contact_dissipation, argnums=1)(ground, v_n, phi)
    return -elastic - damped

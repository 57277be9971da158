"""Friction on the ground: smoothed Coulomb friction, the static/kinetic switch, and the exact cone."""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_each
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import along, component, inner, inverse, root
from jaxgrity.core.types import NodeVectors, PerNode, Scalar, as_float
from jaxgrity.model.balls import touching_velocities
from jaxgrity.model.ground import Ground
from jaxgrity.model.laws import Constraint, DissipationTerm, ForceLaw, Law, Motion, node_names, unchanged_per_node
from jaxgrity.model.placing import held_directions
from jaxgrity.model.surface import Direction, length_of

Tangents = tuple[Direction, Direction]


class Friction(eqx.Module):
    """Interface of friction laws."""

    impulsive: eqx.AbstractClassVar[bool]
    """whether it acts by impulses (with exact contact) or by forces (with penalty contact)"""
    name: eqx.AbstractClassVar[str]
    """name in `describe`"""

    @abstractmethod
    def law(self, ground: Ground) -> Law:
        """The law of this friction on a ground."""

    @property
    @abstractmethod
    def sliding_mu(self) -> PerNode | Scalar:
        """Friction coefficient of sliding nodes."""


def friction_at_nodes(friction: Friction | None, nodes: int) -> np.ndarray:
    """(nodes,), `sliding_mu` of each node; 0 without friction."""
    return np.zeros(nodes) + (0.0 if friction is None else np.asarray(friction.sliding_mu, float))


class SmoothFriction(Friction):
    """F_t = -mu F_n v_t / sqrt(|v_t|^2 + eps^2): Coulomb's law, smoothed below a slip speed of about eps."""

    mu: PerNode | Scalar = eqx.field(converter=as_float)
    slip_speed: Scalar = eqx.field(converter=as_float)
    """slip speed eps, m/s"""
    impulsive: ClassVar[bool] = False
    name: ClassVar[str] = "smooth friction"

    def __check_init__(self):
        check_each("friction.slip_speed", self.slip_speed, shape=(), above=0.0, unit="m/s")
        check_each("friction.mu", self.mu, least=0.0)

    def law(self, ground):
        return SlipDissipation(self, ground)

    @property
    def sliding_mu(self):
        return self.mu


class SwitchFriction(Friction):
    """Static or kinetic Coulomb friction, chosen by speed and force (Appendix B of the paper behind this project).

    The law compares friction with the sum of the other forces on a node, but does not know those of rigid struts and
    bodies. So nodes of rigid struts and bodies creep at up to the slip speed when they should stick, as with smooth
    friction. To avoid that, use springs in their place, or exact contact.

    Raises `InputError` if mu_static is smaller than mu_kinetic.
    """

    mu_static: PerNode | Scalar = eqx.field(converter=as_float)
    mu_kinetic: PerNode | Scalar = eqx.field(converter=as_float)
    slip_speed: Scalar = eqx.field(converter=as_float)
    """speed eps below which a node may stick, m/s"""
    impulsive: ClassVar[bool] = False
    name: ClassVar[str] = "Coulomb switch"

    def __check_init__(self):
        check_each("friction.slip_speed", self.slip_speed, shape=(), above=0.0, unit="m/s")
        check_each("friction.mu_static", self.mu_static, least=0.0)
        check_each("friction.mu_kinetic", self.mu_kinetic, least=0.0)
        known = isinstance(self.mu_static, np.ndarray) and isinstance(self.mu_kinetic, np.ndarray)
        if known and not np.all(self.mu_static >= self.mu_kinetic):
            sticking, sliding = np.broadcast_arrays(self.mu_static, self.mu_kinetic)
            k = int(np.argmax(np.ravel(sliding > sticking)))
            node = f"[{k}]" if sticking.ndim else ""
            raise InputError(
                f"friction.mu_static{node} = {np.ravel(sticking)[k]:g}: expected at least "
                f"mu_kinetic{node} = {np.ravel(sliding)[k]:g}, since friction does not grow as a node begins to slide"
            )

    def law(self, ground):
        if ground.balls is not None:
            raise InputError("friction.kind = 'switch' knows no balls yet; expected smooth friction, or exact contact")
        return CoulombSwitch(self, ground)

    @property
    def sliding_mu(self):
        return self.mu_kinetic


class ConeFriction(Friction):
    """Coulomb's cone for the impulses of exact contact: |p_t| <= mu p_n; nodes stick if they can."""

    mu: PerNode | Scalar = eqx.field(converter=as_float)
    impulsive: ClassVar[bool] = True
    name: ClassVar[str] = "Coulomb cone"

    def __check_init__(self):
        check_each("friction.mu", self.mu, least=0.0)

    def law(self, ground):
        return CoulombCone(self, ground)

    @property
    def sliding_mu(self):
        return self.mu


class SlipDissipation(DissipationTerm):
    """R = sum mu F_n sqrt(|v_t|^2 + eps^2), with F_n held fixed."""

    friction: SmoothFriction
    ground: Ground
    name: ClassVar[str] = SmoothFriction.name
    cause: ClassVar[str] = "friction"

    def dissipation(self, motion: Motion) -> Scalar:
        assert motion.normal_force is not None, "penalty contact presses on nodes by forces"
        tangents = self.ground.frame(motion.at.q).tangents
        v = touching_velocities(self.ground, motion.at.scene.structure.bodies, motion.at.q, motion.v)
        return slip_dissipation(self.friction, tangents, v, motion.normal_force)

    def keeps(self, symmetry):
        alike = unchanged_per_node(self.friction.mu, symmetry)
        return alike and self.ground.keeps(symmetry)

    def parts(self, scene):
        return node_names("friction at", scene)


class CoulombSwitch(ForceLaw):
    """F_switch: see `switch_force`."""

    friction: SwitchFriction
    ground: Ground
    name: ClassVar[str] = SwitchFriction.name
    cause: ClassVar[str] = "friction"

    def force(self, motion: Motion, other_forces: NodeVectors) -> NodeVectors:
        assert motion.normal_force is not None, "penalty contact presses on nodes by forces"
        tangents = self.ground.frame(motion.at.q).tangents
        return switch_force(self.friction, tangents, motion.v, motion.normal_force, other_forces)

    def keeps(self, symmetry):
        alike = (unchanged_per_node(mu, symmetry) for mu in (self.friction.mu_static, self.friction.mu_kinetic))
        return all(alike) and self.ground.keeps(symmetry)


class CoulombCone(Constraint):
    """|p_t| <= mu p_n for every node."""

    friction: ConeFriction
    ground: Ground
    name: ClassVar[str] = ConeFriction.name

    def keeps(self, symmetry):
        alike = unchanged_per_node(self.friction.mu, symmetry)
        return alike and self.ground.keeps(symmetry)

    def directions(self, q, size):
        return held_directions(self.ground, slice(1, 3), q, size)

    def gaps(self, q, t):
        # no start violates the cone: it bounds impulses, not positions
        return q[:0, 0]

    def complaint(self, q, t, part):
        return ""


def slip_dissipation(friction: SmoothFriction, tangents: Tangents, v: NodeVectors, normal_force: PerNode) -> Scalar:
    """R = sum mu F_n sqrt(|v_t|^2 + eps^2), W, with F_n held fixed."""
    slip, sideways = (jnp.square(component(v, tangent)) for tangent in tangents)
    speed = root(slip + sideways + jnp.square(friction.slip_speed))
    return inner(friction.mu * normal_force, speed)


def switch_force(
    friction: SwitchFriction, tangents: Tangents, v: NodeVectors, normal_force: PerNode, other_forces: NodeVectors
) -> NodeVectors:
    """(nodes, 3), F_switch, N. A node sticks while |v_t| < eps and the force that would hold it is at most mu_s F_n.

    A sticking node gets this force, the opposite of the tangential part of `other_forces`, so it keeps its speed below
    eps. Any other node gets mu_k F_n against its slip. Below eps, it acts against the slip that `other_forces` would
    cause.
    """
    slip = [component(v, tangent) for tangent in tangents]
    push = [component(other_forces, tangent) for tangent in tangents]
    speed, needed = (length_of(*pair) for pair in (slip, push))
    slow = (speed < friction.slip_speed).astype(speed.dtype)
    stick = slow * (needed <= friction.mu_static * normal_force).astype(speed.dtype)
    against_slip = (1 - slow) * friction.mu_kinetic * normal_force * inverse(speed)
    against_push = stick + (slow - stick) * friction.mu_kinetic * normal_force * inverse(needed)
    parts = [along(-against_slip * s - against_push * p, tangent) for s, p, tangent in zip(slip, push, tangents)]
    return parts[0] + parts[1]

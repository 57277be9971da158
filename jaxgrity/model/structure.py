"""Nodes and the members that join them, checked."""

import zlib
from collections.abc import Sequence

import equinox as eqx
import numpy as np

from jaxgrity.core.arguments import check_each, is_count, known_ends
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import accumulate, edge_vectors, place_rows
from jaxgrity.core.tracing import traced
from jaxgrity.core.types import (
    AnyArray,
    AnyPerNode,
    Edges,
    Mobility,
    NodeVectors,
    PerMember,
    PerNode,
    Supports,
    VectorsByKind,
    as_float,
    as_float_or_none,
)
from jaxgrity.model.bodies import Bodies
from jaxgrity.model.body_points import lumped, shared_evenly
from jaxgrity.model.clusters import Clusters, check_clusters
from jaxgrity.model.joints import check_bodies
from jaxgrity.model.motors import Motor
from jaxgrity.model.pulleys import Pulley, check_pulleys, check_wraps


class Members(eqx.Module):
    """All struts, which push and pull, or all cables, which only pull.

    Raises `InputError` if there are no members, or if an array does not have one number per member.
    """

    edges: Edges = eqx.field(static=True)
    """(i, j) for each member: the nodes at its ends"""
    stiffness: PerMember | None = eqx.field(converter=as_float_or_none)
    """stiffness K of each member, N/m; None: rigid, so that |x_i - x_j| = L(t) is a constraint"""
    rest_length: PerMember = eqx.field(converter=as_float)
    """rest length L of each member without actuation, m"""
    damping: PerMember | None = eqx.field(converter=as_float_or_none, default=None)
    """damping c along each member, N s/m; None: no damping"""
    stuck: tuple[int, ...] = eqx.field(static=True, default=())
    """numbers (from 0) of the members that ignore the gait and keep their rest length"""
    mass: PerMember | None = eqx.field(converter=as_float_or_none, default=None)
    """mass of each member, kg, spread evenly along it; None: no mass"""
    clusters: Clusters = eqx.field(static=True, default=())
    """cables that slide through several nodes: for each, the numbers (from 0) of its segments in order"""
    motors: tuple[Motor, ...] = ()
    """motors that wind members"""
    pulleys: tuple[Pulley, ...] = ()
    """pulleys over which cables in clusters run"""
    yield_force: PerMember | None = eqx.field(converter=as_float_or_none, default=None)
    """force at which each member yields, N, for margins in statics; None: no limit"""
    bending_stiffness: PerMember | None = eqx.field(converter=as_float_or_none, default=None)
    """bending stiffness EI of each member, N m^2, for struts' margins to Euler's load; None: they do not buckle"""

    def __check_init__(self):
        if not self.edges:
            raise InputError("members: there are no edges; expected at least one, or None where there are no members")
        for k, edge in enumerate(self.edges):
            if len(edge) != 2 or not all(isinstance(node, int | np.integer) for node in edge) or edge[0] == edge[1]:
                raise InputError(f"members.edges[{k}] = {edge}: expected two nodes, as whole numbers")
        for name in ("stiffness", "rest_length", "damping", "mass", "yield_force", "bending_stiffness"):
            value = getattr(self, name)
            if value is not None and np.shape(value) != (len(self.edges),):
                expected = f"expected ({len(self.edges)},), one number for each member"
                raise InputError(f"members.{name} has shape {np.shape(value)}; {expected}")
            check_each(f"members.{name}", value, least=0.0)
        _check_clusters_and_motors(self)

    @property
    def rigid(self) -> bool:
        """Whether the members are constraints instead of springs."""
        return self.stiffness is None


class Structure(eqx.Module):
    """Nodes with their masses and initial positions, and the struts and cables between them.

    Raises `InputError` if the arrays do not fit each other, or a member joins a missing node.
    """

    nodes: NodeVectors = eqx.field(converter=as_float)
    """(nodes, 3), initial positions, m"""
    node_mass: PerNode = eqx.field(converter=as_float)
    """(nodes,), mass of each node, kg; it may be 0 if a member there has mass, or if the node is fixed"""
    struts: Members | None = None
    cables: Members | None = None
    fixed: Supports = eqx.field(static=True, default=())
    """supports: (node, "xyz") for a fixed node, (node, "xz") for a node that moves along y only"""
    bodies: Bodies = ()
    """rigid bodies, from `rigid_body`, to which nodes are fixed"""
    mobility: Mobility | None = None
    """response of independent nodes to forces, computed once for a rollout; None: it is computed when needed"""

    def __check_init__(self):
        shape, count = np.shape(self.nodes), np.shape(self.node_mass)
        if len(shape) != 2 or shape[1] != 3 or shape[0] == 0:
            raise InputError(f"structure.nodes has shape {shape}; expected (nodes, 3), at least one node")
        if count != shape[:1]:
            raise InputError(f"structure.node_mass has shape {count}; expected ({shape[0]},), one mass for each node")
        check_each("structure.nodes", self.nodes)
        check_each("structure.node_mass", self.node_mass, least=0.0, unit="kg")
        for name, members, _ in self.numbered:
            for k, edge in enumerate(members.edges):
                if not all(0 <= node < shape[0] for node in edge):
                    raise InputError(f"structure.{name}[{k}] = {list(edge)}: expected nodes from 0 to {shape[0] - 1}")
        if self.struts is not None and self.struts.clusters:
            raise InputError("structure.struts: struts cannot slide through nodes; expected clusters of cables only")
        _check_supports(self.fixed, shape[0])
        check_wraps(self.cables, self.nodes)
        check_bodies(self.bodies, shape[0], self.fixed)
        _check_masses(self)

    @property
    def numbered(self) -> "tuple[tuple[str, Members, int], ...]":
        """The kinds of members that there are: name, members, and the first one's number in a gait."""
        kinds = (("struts", self.struts, 0), ("cables", self.cables, self.first_cable))
        return tuple((name, members, first) for name, members, first in kinds if members is not None)

    @property
    def members(self) -> "tuple[Members, ...]":
        """The struts and the cables, where there are any."""
        return tuple(members for _, members, _ in self.numbered)

    @property
    def mass(self):
        """Total mass, kg."""
        return self.lumped_mass.sum()

    @property
    def rod_masses(self) -> tuple[tuple[AnyArray, Edges], ...]:
        """Masses, kg, and edges of the members that have mass, first of struts, then of cables."""
        return tuple((m.mass, m.edges) for m in self.members if m.mass is not None)

    @property
    def needs_mobility(self) -> bool:
        """Whether accelerations are not F_i/m_i: the mass matrix is not diagonal, or a node is fixed."""
        return bool(self.rod_masses or self.fixed or self.bodies)

    @property
    def of_points(self) -> bool:
        """Whether all mass is at the nodes."""
        return not (self.rod_masses or self.bodies)

    @property
    def lumped_mass(self) -> AnyPerNode:
        """`mass_beside_bodies` and the masses from `lumped`, which may be negative: weight, momentum, centre."""
        mass = self.mass_beside_bodies
        return mass + lumped(self.bodies, len(self.nodes)) if self.bodies else mass

    @property
    def mass_beside_bodies(self) -> AnyPerNode:
        """Mass of each node plus half of each member's mass there, kg, without rigid bodies."""
        mass = self.node_mass
        for rod_mass, edges in self.rod_masses:
            for ends in zip(*edges):
                mass = mass + place_rows(rod_mass / 2, ends, len(self.nodes))
        return mass

    @property
    def borne_mass(self) -> AnyPerNode:
        """(nodes,), positive, kg: mass that converts impulses to velocities in reports. Bodies share theirs evenly."""
        mass = self.mass_beside_bodies
        return mass + shared_evenly(self.bodies, len(self.nodes)) if self.bodies else mass

    @property
    def free(self) -> np.ndarray:
        """(nodes, 3), whether a coordinate may move."""
        free = np.ones((len(self.nodes), 3), bool)
        for node, axes in self.fixed:
            free[node, ["xyz".index(axis) for axis in axes]] = False
        return free

    @property
    def supported(self) -> np.ndarray:
        """(nodes, 3), whether a support holds a coordinate."""
        return ~self.free

    @property
    def kinds(self) -> "dict[str, Members]":
        """Kinds of members with forces along them. Rigid members without damping are constraints, and left out."""
        return {name: m for name, m, _ in self.numbered if not (m.rigid and m.damping is None)}

    @property
    def damped(self) -> "dict[str, Members]":
        """Kinds of members with dampers, or friction on pulleys."""
        return {name: members for name, members in self.kinds.items() if members.damping is not None or members.pulleys}

    @property
    def member_count(self) -> int:
        """Number of struts and cables."""
        return sum(len(m.edges) for m in self.members)

    @property
    def robot(self) -> str:
        """Fingerprint of the robot: its numbers of nodes and members, and a checksum of its connections."""
        struts, cables = (() if members is None else members.edges for members in (self.struts, self.cables))
        joined = repr([[[int(i), int(j)] for i, j in edges] for edges in (struts, cables)])
        joined += repr([body.points for body in self.bodies]) if self.bodies else ""
        number = zlib.crc32(joined.encode())
        return f"{len(self.nodes)} nodes, {len(struts)} struts, {len(cables)} cables ({number:08x})"

    @property
    def driven(self) -> tuple[int, ...]:
        """Numbers of the members with motors, struts first."""
        return tuple(first + motor.member for _, members, first in self.numbered for motor in members.motors)

    @property
    def first_cable(self) -> int:
        """Number of the first cable in a gait, where struts count first."""
        return len(self.struts.edges) if self.struts is not None else 0


def _check_clusters_and_motors(members: Members) -> None:
    check_clusters(members.clusters, members.edges)
    check_pulleys(members)
    sliding = [k for cluster in members.clusters for k in cluster]
    if sliding and isinstance(members.mass, np.ndarray) and np.any(members.mass[sliding]):
        raise InputError("members.mass: a sliding cable moves its mass along; expected 0 for cables in clusters")
    driven = [motor.member for motor in members.motors]
    if len(set(driven)) < len(driven) or not all(0 <= k < len(members.edges) for k in driven):
        raise InputError(f"motors of members {driven}: expected members from 0 to {len(members.edges) - 1}, each once")
    if set(driven) & set(members.stuck):
        raise InputError(f"stuck = {list(members.stuck)}: expected no members with motors, which are {driven}")


def _check_supports(fixed: Supports, nodes: int) -> None:
    for support in fixed:
        if np.ndim(support) != 1 or len(support) != 2 or not is_count(support[0], 0) or not isinstance(support[1], str):
            raise InputError(f"structure.fixed has {support!r}; expected a node and its axes, such as (0, 'xyz')")
        node, axes = support
        if not 0 <= node < nodes:
            raise InputError(f"structure.fixed names node {node}; expected 0 to {nodes - 1}")
        if not axes or set(axes) - set("xyz") or len(set(axes)) < len(axes):
            raise InputError(f"structure.fixed: node {node} is fixed along {axes!r}; expected some of x, y and z")
    if len({node for node, _ in fixed}) < len(fixed):
        raise InputError(f"structure.fixed = {[node for node, _ in fixed]}: expected each node once")


def _check_masses(structure: Structure) -> None:
    masses = [structure.node_mass, *(mass for mass, _ in structure.rod_masses)]
    if traced(structure.bodies) or not all(isinstance(mass, np.ndarray) for mass in masses):
        return
    idle = structure.free.any(1) & (np.asarray(structure.borne_mass) <= 0)
    if idle.any():
        node = int(np.argmax(idle))
        raise InputError(f"structure.node_mass[{node}] = 0: no member there has mass either; expected some mass")


def member_vectors(x: NodeVectors, kinds: dict[str, Members]) -> VectorsByKind:
    """x_i - x_j of every member (i, j): of positions, d; of velocities, d'."""
    return {name: edge_vectors(x, members.edges) for name, members in kinds.items()}


def onto_nodes(forces: VectorsByKind, kinds: dict[str, Members], nodes: int) -> NodeVectors:
    """The transpose of `member_vectors`: adds each member's force to its first node, subtracts it from the second."""
    placed = [accumulate(forces[name], members.edges, nodes) for name, members in kinds.items()]
    return sum(placed[1:], placed[0])


def edge_lengths(nodes: NodeVectors, edges: Edges) -> np.ndarray:
    """Distance between the ends of each edge, m; NumPy, for use before a simulation."""
    i, j = known_ends(edges, len(nodes)).T
    return np.linalg.norm(np.asarray(nodes)[i] - np.asarray(nodes)[j], axis=1)


def check_edges(nodes: np.ndarray, struts: Edges, cables: Edges, where: str = "structure") -> None:
    """Raises `InputError` if a member ends at a missing node, has no length, or joins the same nodes as another one."""
    seen: dict[tuple[int, int], str] = {}
    for kind, edges in (("struts", struts), ("cables", cables)):
        for k, (i, j) in enumerate(edges):
            place, pair = f"{where}.{kind}[{k}]", (min(i, j), max(i, j))
            for node in (i, j):
                if not 0 <= node < len(nodes):
                    raise InputError(f"{place} = [{i}, {j}]: there is no node {node}; expected 0 to {len(nodes) - 1}")
            if i == j or np.array_equal(nodes[i], nodes[j]):
                raise InputError(f"{place} = [{i}, {j}]: the member has no length; expected two nodes apart")
            if pair in seen:
                raise InputError(
                    f"{place} = [{i}, {j}]: {seen[pair]} joins these nodes already; expected one member per pair"
                )
            seen[pair] = f"{kind}[{k}]"


def per_member(value: float | Sequence[float] | AnyArray, count: int, where: str) -> np.ndarray:
    """An array of `count` numbers, from one number for all members or a list with one per member.

    Raises `InputError` if a list has another length.
    """
    array = np.asarray(value, float)
    if array.ndim and array.shape != (count,):
        raise InputError(f"{where} has {array.size} numbers; expected one, or {count} (one each)")
    return np.broadcast_to(array, (count,)).copy()
